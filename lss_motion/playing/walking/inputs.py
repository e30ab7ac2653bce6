"""Keys and gamepad of the operator → commanded velocity of the body of a walking robot.

`OperatorInput` holds the commanded velocity as ratios of the largest one; keys change it in steps,
a stick sets it. `Gamepad` reads the Linux joystick interface, eight bytes an event: time in ms,
value, kind, number (linux/joystick.h). No library is needed for that.
"""

from __future__ import annotations

import os
import re
import struct
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.show.gait.stepping import STILL, Twist

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


STEP_RATIO: Final = 0.25
"""One press of a key adds a quarter: four presses from a stand to the largest velocity."""
SPEED_MIN_RATIO: Final = 0.25

_KEY: Final = re.compile(r"\x1b\[[A-D]|\x1b|.", re.DOTALL)
_MOVES: Final[Mapping[str, tuple[int, int, int]]] = MappingProxyType(
    {
        "w": (1, 0, 0),
        "\x1b[A": (1, 0, 0),
        "s": (-1, 0, 0),
        "\x1b[B": (-1, 0, 0),
        "a": (0, 1, 0),
        "d": (0, -1, 0),
        "\x1b[D": (0, 0, 1),
        "\x1b[C": (0, 0, -1),
    }
)
"""Steps forward, to the left, and of the turn to the left. Escape sequences are arrow keys."""


@dataclass(slots=True)
class OperatorInput:
    """The commanded velocity as ratios of `top`, each from -1 to 1, times `speed_ratio`.

    `is_sitting`: the robot shall sit. `has_ended`: the operator has ended the walk.
    """

    top: Twist
    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    speed_ratio: float = 1.0
    is_sitting: bool = False
    has_ended: bool = False

    def press(self, keys: str) -> None:
        """Apply keys as the terminal sent them; unknown keys have no effect."""
        for key in _KEY.findall(keys):
            match key.lower() if len(key) == 1 else key:
                case " ":
                    self.steer(0.0, 0.0, 0.0)
                case "q":
                    self.has_ended = True
                    self.steer(0.0, 0.0, 0.0)
                case "x":
                    self.is_sitting = not self.is_sitting
                    self.steer(0.0, 0.0, 0.0)
                case "+" | "=":
                    self.speed_ratio = min(self.speed_ratio + STEP_RATIO, 1.0)
                case "-" | "_":
                    self.speed_ratio = max(self.speed_ratio - STEP_RATIO, SPEED_MIN_RATIO)
                case known if known in _MOVES:
                    ahead, left, turn = (STEP_RATIO * step for step in _MOVES[known])
                    self.steer(self.forward + ahead, self.left + left, self.turn + turn)
                case _:
                    pass

    def steer(self, forward: float, left: float, turn: float) -> None:
        """Set the ratios; each is clipped to -1 to 1."""
        self.forward, self.left, self.turn = (
            min(max(ratio, -1.0), 1.0) for ratio in (forward, left, turn)
        )

    def twist(self) -> Twist:
        """Return the commanded velocity; `STILL` while the robot sits."""
        if self.is_sitting or (self.forward, self.left, self.turn) == (0.0, 0.0, 0.0):
            return STILL
        return Twist(
            forward_mm_s=self.speed_ratio * self.forward * self.top.forward_mm_s,
            left_mm_s=self.speed_ratio * self.left * self.top.left_mm_s,
            turn_deg_s=self.speed_ratio * self.turn * self.top.turn_deg_s,
        )


EVENT: Final = struct.Struct("<IhBB")
EVENTS_MAX: Final = 64
AXIS: Final = 0x02
INITIAL: Final = 0x80
"""Set in the events that report the state when the device is opened."""
VALUE_MAX: Final = 32_767
DEAD_RATIO: Final = 0.12
"""A stick this near to its middle counts as released. Chosen: worn sticks rest up to 0.1 off."""
LEFT_X: Final = 0
LEFT_Y: Final = 1
RIGHT_X: Final = 3
"""The axes of a common pad: both of the left stick, the horizontal one of the right stick."""


class Gamepad:
    """Left stick: forward and sideways; right stick: turn. A context manager."""

    def __init__(self, path: Path) -> None:
        """Open the device; raises `InputError` if that fails."""
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

    def __exit__(self, *_error: object) -> None:
        self._close()

    def filenos(self) -> list[int]:
        """Return what becomes readable when a stick moves; nothing after the pad was unplugged."""
        return [] if self._fd is None else [self._fd]

    def stick(self) -> tuple[float, float, float] | None:
        """Return forward, left and turn to the left, each -1 to 1; None if nothing has changed.

        When the pad is unplugged, both sticks count as released.
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
