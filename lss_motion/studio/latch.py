"""The stop that is kept until it is armed again: one byte, which outlives the process that owns it.

Only the process that stops (`stop`) writes it; the server reads it. Where that process is started
again, it finds what it has kept.
"""

from __future__ import annotations

import mmap
import tempfile
from typing import IO, Final, Literal

StopKind = Literal["stop", "estop"]
KINDS: Final[tuple[StopKind | None, ...]] = (None, "stop", "estop")
"""By the byte."""


def latch_file() -> IO[bytes]:
    """Return the memory of a new latch, for both processes: a file without a name."""
    file = tempfile.TemporaryFile()  # noqa: SIM115  (open as long as the server)
    file.truncate(1)
    return file


class Latch:
    """The byte, by the file number of its memory."""

    def __init__(self, fileno: int) -> None:
        self._memory = mmap.mmap(fileno, 1)

    @property
    def kind(self) -> StopKind | None:
        """The stop that is kept; None: players may start."""
        return KINDS[self._memory[0]]

    def keep(self, kind: StopKind) -> None:
        """Keep a stop; an emergency stop is not lessened."""
        if self.kind != "estop":
            self._memory[0] = KINDS.index(kind)

    def clear(self) -> None:
        """Let players start again."""
        self._memory[0] = 0
