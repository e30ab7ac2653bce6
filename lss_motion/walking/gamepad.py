"""A gamepad as the Linux joystick interface delivers it: two sticks that say where to.

Eight bytes an event: ms, value, kind, number (linux/joystick.h). No library is needed for it.
"""

from __future__ import annotations

import os
import struct
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

EVENT: Final = struct.Struct("<IhBB")
EVENTS_MAX: Final = 64
AXIS: Final = 0x02
INITIAL: Final = 0x80
"""Set on the events that tell the state at the start."""
VALUE_MAX: Final = 32_767
DEAD_RATIO: Final = 0.12
"""A stick this near to its middle is let go. Chosen: worn sticks rest up to a tenth off."""
LEFT_X: Final = 0
LEFT_Y: Final = 1
RIGHT_X: Final = 3
"""The axes of an ordinary pad: left stick, and the right stick's to and fro."""


class Gamepad:
    """Left stick: forward and sideways; right stick: turn. A context manager."""

    def __init__(self, path: Path) -> None:
        """Open the device; raises `InputError` if there is none."""
        try:
            self._fd: int | None = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise InputError(
                f"cannot be opened as a gamepad: {error.strerror}; on Linux it is /dev/input/js0",
                path=path,
            ) from error
        self._rest = b""
        self._axes: dict[int, float] = {}

    def __enter__(self) -> Gamepad:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close()

    def filenos(self) -> list[int]:
        return [] if self._fd is None else [self._fd]

    def stick(self) -> tuple[float, float, float] | None:
        """Return forward, left and turn to the left, each -1 to 1, if something has changed.

        A pad that is unplugged lets go of both sticks.
        """
        if self._fd is None:
            return None
        try:
            data = os.read(self._fd, EVENTS_MAX * EVENT.size)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if not data:
            self._close()
            return (0.0, 0.0, 0.0)
        self._rest += data
        whole = len(self._rest) - len(self._rest) % EVENT.size
        for _, value, kind, number in EVENT.iter_unpack(self._rest[:whole]):
            if kind & ~INITIAL == AXIS:
                ratio = max(-1.0, value / VALUE_MAX)
                self._axes[number] = 0.0 if abs(ratio) < DEAD_RATIO else ratio
        self._rest = self._rest[whole:]
        return (
            -self._axes.get(LEFT_Y, 0.0),
            -self._axes.get(LEFT_X, 0.0),
            -self._axes.get(RIGHT_X, 0.0),
        )

    def _close(self) -> None:
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
