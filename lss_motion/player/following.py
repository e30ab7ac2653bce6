"""What the readings of one joint say: are they believable, how far off is it, what corrects it.

A bus without checksums can deliver a wrong number that looks right, so a reading passes a gate
first. What then remains between the reading and the response model is taken as a slowly changing
disturbance (load, backlash, a bent linkage), estimated, and offered as a bounded offset.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

JUMP_MARGIN_DEG: Final = 5.0
"""Besides what its speed allows, a horn may seem to jump this far: noise, backlash and lag."""
ESTIMATE_S: Final = 0.18
"""Time constant of the estimate, however often there are readings: what many readings in a row
have in common, such as one wrong instant, counts once. Chosen: what moved more slowly than this
is a disturbance, and 22 readings a second then count a quarter each."""
GAIN_MAX: Final = 0.25
"""But no reading counts more than this. Chosen: four readings make a correction."""
GAIN_HALF_SPEED_DEG_S: Final = 30.0
"""At this speed a reading counts half: a lag wrong by 10 ms already looks like 0.3 deg there."""
OFFSET_MAX_DEG: Final = 3.0
"""A correction is never larger (FACTS.md A20)."""
OFFSET_RATE_DEG_S: Final = 10.0
"""A correction never changes faster: a tenth of an ordinary move's speed."""


@dataclass(slots=True)
class Following:
    """The estimate for one joint, in servo degrees; times in seconds on one clock."""

    speed_max_deg_s: float
    standing_deg: float | None = None
    """Where the horn was before the first reading, if that is known."""
    disturbance_deg: float = 0.0
    offset_deg: float = 0.0
    readings: int = 0
    rejected: int = 0
    square_sum_deg2: float = 0.0
    error_deg: float = 0.0
    error_max_deg: float = 0.0
    offset_max_deg: float = 0.0
    measured_deg: float | None = None
    read_s: float | None = None
    _suspect: tuple[float, float] | None = field(default=None, repr=False)

    def take(
        self,
        measured_deg: float,
        read_s: float,
        *,
        expected_deg: float,
        wanted_deg: float,
        speed_deg_s: float,
        learns: bool = True,
    ) -> bool:
        """Use a reading taken at `read_s`; return whether it was believed.

        `expected_deg` is where the response model puts the horn after all that was sent,
        `wanted_deg` where the plan wants it. One from which nothing `learns` is only counted.
        """
        if not self._is_plausible(measured_deg, read_s):
            self.rejected += 1
            return False
        is_first = self.read_s is None
        elapsed_s = 0.0 if self.read_s is None else read_s - self.read_s
        self.measured_deg, self.read_s = measured_deg, read_s
        self.readings += 1
        self.error_deg = wanted_deg - measured_deg
        self.square_sum_deg2 += self.error_deg * self.error_deg
        self.error_max_deg = max(self.error_max_deg, abs(self.error_deg))
        if not learns:
            return True
        gain = GAIN_MAX if is_first else min(GAIN_MAX, elapsed_s / ESTIMATE_S)
        gain /= 1.0 + abs(speed_deg_s) / GAIN_HALF_SPEED_DEG_S
        self.disturbance_deg += gain * (expected_deg - measured_deg - self.disturbance_deg)
        self._correct(OFFSET_RATE_DEG_S * elapsed_s)
        return True

    def rest(self, disturbance_deg: float) -> None:
        """Note what is known for sure: so far from its profile a horn comes to rest."""
        self.disturbance_deg = disturbance_deg
        self._correct(math.inf)

    def _correct(self, most_deg: float) -> None:
        """Bring the offset to what is disturbed, by `most_deg` and within its bounds."""
        change_deg = min(max(self.disturbance_deg, -OFFSET_MAX_DEG), OFFSET_MAX_DEG)
        change_deg -= self.offset_deg
        self.offset_deg += min(max(change_deg, -most_deg), most_deg)
        self.offset_max_deg = max(self.offset_max_deg, abs(self.offset_deg))

    def stand(self, standing_deg: float) -> None:
        """Begin to read anew, with a horn that stands there; what was learnt is kept."""
        self.standing_deg = standing_deg
        self.measured_deg = self.read_s = self._suspect = None

    @property
    def error_rms_deg(self) -> float:
        return (self.square_sum_deg2 / self.readings) ** 0.5 if self.readings else 0.0

    def _is_plausible(self, measured_deg: float, read_s: float) -> bool:
        """Return whether to believe a reading.

        What could have been reached since the last that was believed, or what a second reading
        confirms: a hand may have moved the horn.
        """
        if self.measured_deg is None or self.read_s is None:
            if self._suspect is None and self.standing_deg is not None:
                self._suspect = (self.standing_deg, read_s)
            elif self._suspect is None:
                return True
        elif self._could_reach(self.measured_deg, self.read_s, measured_deg, read_s):
            self._suspect = None
            return True
        suspect, self._suspect = self._suspect, (measured_deg, read_s)
        return suspect is not None and self._could_reach(*suspect, measured_deg, read_s)

    def _could_reach(self, from_deg: float, from_s: float, to_deg: float, to_s: float) -> bool:
        reach_deg = self.speed_max_deg_s * max(to_s - from_s, 0.0) + JUMP_MARGIN_DEG
        return abs(to_deg - from_deg) <= reach_deg
