"""How much later than assumed the horn of one joint follows its servo's profile.

What a horn lags by grows with its speed, and what a load pulls it by does not: the slope of what
is missing over the speed, through the readings of the last seconds of motion, is the lag.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

LAG_MAX_S: Final = 0.06
"""An estimate is never larger, either way: three times what is assumed of a servo (`lag_s`).
Chosen; what lags more than this does not lag but is held up."""
MEMORY_S: Final = 3.0
"""Seconds of motion after which a reading counts a third. Chosen: a few moves of a show."""
SPEED_DEG_S: Final = 20.0
"""At this speed and above a reading says all that it can about the lag, below less."""
PRIOR_DEG2_S: Final = 100.0
"""Weight of the assumption that nothing is wrong: a second at 10 deg/s to and fro. Chosen: a
single slow move changes little, and a quick one is believed (measured: with three times as much,
horns with a wrong lag stray 8 % further in 20 s)."""
DEAD_S: Final = 0.004
"""A smaller difference is left alone: commands would leave their places on the line for nothing.
Chosen: on simulated servos that lag as assumed the estimate stays within 3 ms (measured). One of
twice as much counts whole."""


@dataclass(slots=True)
class Lag:
    """Sums over readings of one joint, weighted by time and forgotten with motion."""

    _weight: float = 0.0
    _speed: float = 0.0
    _speed2: float = 0.0
    _missing: float = 0.0
    _product: float = 0.0

    def take(self, missing_deg: float, speed_deg_s: float, elapsed_s: float) -> None:
        """Use a reading: how far the horn was behind a profile without any more lag.

        `elapsed_s` is the time since the reading before, for which it stands.
        """
        weight = min(elapsed_s, MEMORY_S) * min(1.0, abs(speed_deg_s) / SPEED_DEG_S)
        keep = math.exp(-weight / MEMORY_S)
        self._weight = keep * self._weight + weight
        self._speed = keep * self._speed + weight * speed_deg_s
        self._speed2 = keep * self._speed2 + weight * speed_deg_s * speed_deg_s
        self._missing = keep * self._missing + weight * missing_deg
        self._product = keep * self._product + weight * missing_deg * speed_deg_s

    @property
    def estimate_s(self) -> float:
        """The lag besides the assumed one, within `LAG_MAX_S`."""
        if self._weight <= 0.0:
            return 0.0
        spread = self._speed2 - self._speed * self._speed / self._weight
        common = self._product - self._speed * self._missing / self._weight
        return min(max(common / (spread + PRIOR_DEG2_S), -LAG_MAX_S), LAG_MAX_S)

    @property
    def extra_s(self) -> float:
        """What commands are early by for it: the estimate, unless it is better left alone."""
        estimate_s = self.estimate_s
        return estimate_s * min(max(0.0, abs(estimate_s) / DEAD_S - 1.0), 1.0)
