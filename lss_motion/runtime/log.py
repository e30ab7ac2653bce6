r"""Every byte both ways with its instant, one line each, in a file that survives a crash.

    # lss_motion log 1
    0.001234 main > #5QD
    0.004100 main < *5QD132

Seconds since the run began; `>` to the servos, `<` from them; a line of the log is what was
written or arrived at once, carriage returns as `\r`, other odd bytes as `\xNN`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

FIRST_LINE: Final = "# lss_motion log 1"
BUFFER_BYTES: Final = 64 * 1024
"""Handed to the system in such portions, so that a write rarely waits for a disk."""


class ByteLog:
    """A `Tap` that writes to a file; use it as a context manager."""

    def __init__(self, path: Path) -> None:
        self._start_ns = 0
        try:
            self._file = path.open("w", encoding="ascii", buffering=BUFFER_BYTES)
        except OSError as error:
            raise InputError(f"cannot write the log: {error.strerror}", path=path) from error
        self._file.write(FIRST_LINE + "\n")

    def started(self, start_ns: int) -> ByteLog:
        """Count the seconds from `start_ns`."""
        self._start_ns = start_ns
        return self

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:
        self._line(bus, ">", data, now_ns)

    def received(self, bus: str, data: bytes, now_ns: int) -> None:
        self._line(bus, "<", data, now_ns)

    def _line(self, bus: str, way: str, data: bytes, now_ns: int) -> None:
        text = data.decode("latin-1").encode("unicode_escape").decode("ascii")
        self._file.write(f"{s_from_ns(now_ns - self._start_ns):.6f} {bus} {way} {text}\n")

    def __enter__(self) -> ByteLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
