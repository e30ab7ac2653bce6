"""What an experiment has measured: what was said and read in each trial, and when."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from lss_motion.maintenance.identify.motion import Order
    from lss_motion.maintenance.identify.plan import Kind, Window

SETTLE_S: Final = 0.3
"""A horn rests when two halves of this long agree, after its profile has ended."""
SETTLED_DEG: Final = 0.12
"""How well they agree: one tenth is what a reading scatters (FACTS.md E7)."""
FAST_S: Final = 0.05
"""A speed is a difference over this long: the scatter of two readings is 4 deg/s of it."""


@dataclass(slots=True)
class Trial:
    """From rest to rest. Servo degrees; seconds since the trial began."""

    kind: Kind
    began_s: float
    """On the clock of the run."""
    start_deg: float
    """The target on which the servo rested before."""
    orders: list[Order] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    """When the servo had each question complete, which is when it is taken to look."""
    readings_deg: list[float] = field(default_factory=list)

    def is_settled(self, now_s: float) -> bool:
        """Return whether the horn has not moved during the last `SETTLE_S`."""
        late = self._between(now_s - 0.5 * SETTLE_S, now_s)
        early = self._between(now_s - SETTLE_S, now_s - 0.5 * SETTLE_S)
        if not late or not early:
            return False
        return abs(float(np.median(late)) - float(np.median(early))) < SETTLED_DEG

    def rest_deg(self) -> float:
        """Return where the horn rests at the end; there is at least one reading."""
        last_s = self.times_s[-1]
        return float(np.mean(self._between(last_s - 0.5 * SETTLE_S, last_s)))

    def fastest_deg_s(self) -> float:
        """Return the fastest that the horn turned over `FAST_S`; 0 without enough readings."""
        fastest, first = 0.0, 0
        for last, time_s in enumerate(self.times_s):
            while first < last and time_s - self.times_s[first + 1] >= FAST_S:
                first += 1
            if (passed_s := time_s - self.times_s[first]) >= FAST_S:
                turned_deg = self.readings_deg[last] - self.readings_deg[first]
                fastest = max(fastest, abs(turned_deg) / passed_s)
        return fastest

    def rest_variance_deg2(self) -> float:
        """Return how much the readings scatter at the end."""
        last_s = self.times_s[-1]
        return float(np.var(self._between(last_s - 0.5 * SETTLE_S, last_s)))

    def last_way(self) -> float:
        """Return which way the horn moved last: 1 or -1; 0 if it was not sent anywhere."""
        ways_deg = [
            order.target_deg - before
            for before, order in zip(self._legs(), self.orders, strict=True)
        ]
        return float(np.sign(ways_deg[-1])) if ways_deg else 0.0

    def _legs(self) -> list[float]:
        """Return about where each order found the horn: an interrupted move was half-way."""
        legs_deg = [self.start_deg]
        for order in self.orders[:-1]:
            legs_deg.append(0.5 * (legs_deg[-1] + order.target_deg))
        return legs_deg[: len(self.orders)]

    def _between(self, from_s: float, to_s: float) -> list[float]:
        return [
            reading_deg
            for time_s, reading_deg in zip(self.times_s, self.readings_deg, strict=True)
            if from_s < time_s <= to_s
        ]


@dataclass(slots=True)
class Recording:
    """All trials of one joint, and how fast its servo answered."""

    window: Window
    ramp_deg_s2: float
    """What AA and AD were set to."""
    speed_max_deg_s: float
    """What SD was set to."""
    trials: list[Trial] = field(default_factory=list)
    turnarounds_s: list[float] = field(default_factory=list)
    """From the end of each question to the start of its answer, as the host sees it."""
