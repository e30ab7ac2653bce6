"""What a person wants of a walking robot: keys and sticks become a velocity of the body."""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.gait.walker import STILL, Twist

if TYPE_CHECKING:
    from collections.abc import Mapping

STEP_RATIO: Final = 0.25
"""One press of a key is a quarter of the most: four presses from a stand to the fastest."""
SPEED_LEAST_RATIO: Final = 0.25

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
"""Forward, left, turn to the left, for every key; arrows are what terminals send for them."""


@dataclass(slots=True)
class Wishes:
    """Ratios of the most, from -1 to 1; `speed_ratio` is of all together."""

    top: Twist
    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    speed_ratio: float = 1.0
    is_sitting: bool = False
    has_ended: bool = False

    def press(self, keys: str) -> None:
        """Take in keys as the terminal sent them."""
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
                    self.speed_ratio = max(self.speed_ratio - STEP_RATIO, SPEED_LEAST_RATIO)
                case known if known in _MOVES:
                    ahead, left, turn = (STEP_RATIO * way for way in _MOVES[known])
                    self.steer(self.forward + ahead, self.left + left, self.turn + turn)
                case _:
                    pass

    def steer(self, forward: float, left: float, turn: float) -> None:
        """Set the ratios; more than all is all."""
        self.forward, self.left, self.turn = (
            min(max(ratio, -1.0), 1.0) for ratio in (forward, left, turn)
        )

    def twist(self) -> Twist:
        """Return the velocity that is wanted; one who sits wants none."""
        if self.is_sitting or (self.forward, self.left, self.turn) == (0.0, 0.0, 0.0):
            return STILL
        return Twist(
            forward_mm_s=self.speed_ratio * self.forward * self.top.forward_mm_s,
            left_mm_s=self.speed_ratio * self.left * self.top.left_mm_s,
            turn_deg_s=self.speed_ratio * self.turn * self.top.turn_deg_s,
        )
