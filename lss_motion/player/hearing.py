"""Whether a servo heard its last moves: where the horn is tells, once the courses part.

A line without acknowledgement loses a command now and then, and the servo goes on with the one
before. So besides the profile after all that was said, those without one of the last moves are kept
until the readings have decided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from lss_motion.program.response import Profile

PARTED_DEG: Final = 1.0
"""The horn must be nearer to one course than to the other by this: ten times the noise of a
reading, and what a lag wrong by 10 ms makes at 100 deg/s. Chosen."""
NEAR_DEG: Final = 0.6
NEAR_RATIO: Final = 0.3
"""And no further from the other course than this, or than this share of what it is off its own: a
lag that is not known yet, or a weak motor, leads it away from either. Chosen."""
SURE_S: Final = 0.01
"""For so long: one reading is no proof, and a horn that only crosses a course is soon elsewhere."""
OTHERS_MAX: Final = 3
"""More moves than this are not doubted at once; the oldest counts as heard."""


@dataclass(slots=True)
class Other:
    """A profile without one of the last moves."""

    profile: Profile
    since_s: float | None = None
    """Since when every reading has spoken for it."""


@dataclass(slots=True)
class Hearing:
    """What one servo may have missed."""

    others: list[Other] = field(default_factory=list)
    is_doubtful: bool = False
    """Whether the last reading spoke for another course: nothing else can be learnt from it."""

    def told(
        self, before: Profile, heard_s: float, target_deg: float, duration_s: float | None
    ) -> None:
        """Note a new move, and a copy of the profile `before` it."""
        for other in self.others:
            other.profile.retarget(heard_s, target_deg, duration_s)
            other.since_s = None
        self.others = [*self.others[-(OTHERS_MAX - 1) :], Other(before)]

    def judge(self, at_s: float, expected_deg: float, free_deg: float) -> Profile | None:
        """Return the course that the servo is really on; None: as far as can be told, its own.

        `expected_deg` is where its profile has the horn at `at_s` (of the profile, lag taken off),
        `free_deg` where the horn was, less what else pulls at it.
        """
        off_deg = abs(free_deg - expected_deg)
        nears = [(abs(free_deg - other.profile.at(at_s)[0]), other) for other in self.others]
        nears = [near for near in nears if near[0] - off_deg <= PARTED_DEG]
        self.others = [other for _, other in nears]
        near_deg, likely = min(nears, key=lambda near: near[0], default=(math.inf, None))
        if off_deg - near_deg < PARTED_DEG or near_deg > max(NEAR_DEG, NEAR_RATIO * off_deg):
            likely = None
        for other in self.others:
            if other is not likely:
                other.since_s = None
        self.is_doubtful = likely is not None
        if likely is None:
            return None
        if likely.since_s is None:
            likely.since_s = at_s
        if at_s - likely.since_s < SURE_S:
            return None
        self.others = []
        return likely.profile
