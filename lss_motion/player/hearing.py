"""Whether a servo heard its last moves: it is asked for its target, and where the horn is tells.

A line without acknowledgement loses a command now and then, and the servo goes on with the one
before. So after every move to another target the servo is asked for it (QDT, FACTS.md C2: "the
target angle during and after an action"): one that names the target before has missed the move.
And besides the profile after all that was said, those without one of the last moves are kept until
a target or the readings have decided: they tell as well once the courses part.
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
ASKS_MAX: Final = 3
"""A servo is asked so often for the target of one move: then the readings decide. Chosen: two
questions that are not answered take so long that they will have."""
DENIALS_MAX: Final = 6
"""A servo that names another target so often in a row means something else by it, such as limits
of its own, and is not asked any more: a line that loses every fifth command does so once in 15000
moves."""
TAKEN_UP_LOOPS: Final = 1.5
"""So many control ticks after it heard a move a servo names its target. Assumed, with half a tick
to spare: no document says from when on (FACTS.md C2)."""
SAME_UNITS: Final = 1.5
"""Targets that differ by no more units of the wire than this are the same: a servo that counts in
its own units may be one off."""


@dataclass(slots=True)
class Last:
    """The last move that a servo was told, and its profile before that."""

    before: Profile
    heard_s: float
    target_deg: float
    duration_s: float | None
    asks_left: int
    strange_deg: float | None = None
    """A target that nobody told it, as it said once."""


@dataclass(slots=True)
class Other:
    """A profile without one of the last moves."""

    profile: Profile
    since_s: float | None = None
    """Since when every reading has spoken for it."""


@dataclass(slots=True)
class Hearing:
    """What one servo may have missed."""

    unit_deg: float
    """One unit of the wire."""
    loop_s: float
    """A servo takes up a move at its next control tick (`Response.loop_s`)."""
    others: list[Other] = field(default_factory=list)
    last: Last | None = None
    denials: int = 0
    """How often in a row the servo named another target than it was told."""
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
        is_telling = self._differs(before.target_deg, target_deg) and self.denials < DENIALS_MAX
        asks = ASKS_MAX if is_telling else 0
        self.last = Last(before.copy(), heard_s, target_deg, duration_s, asks)

    def wants_target(self, now_s: float) -> bool:
        """Return whether the servo is to be asked for its target."""
        last = self.last
        return last is not None and last.asks_left > 0 and now_s >= self._taken_up_s(last)

    def asks_target(self) -> None:
        """Note that the servo is asked for its target now."""
        assert self.last is not None
        self.last.asks_left -= 1

    def named(self, at_s: float, target_deg: float) -> Profile | None:
        """Take the target that a servo named at `at_s`; return as `judge` does.

        One that nobody told it must be named twice: it may be the answer that was damaged.
        """
        last = self.last
        if last is None or at_s < self._taken_up_s(last):
            return None
        if not self._differs(target_deg, last.target_deg):
            self.denials, last.asks_left = 0, 0
            self.others = [o for o in self.others if not self._parts(o.profile)]
            return None
        self.denials += 1
        course = last.before
        if self._differs(target_deg, course.target_deg):
            if last.strange_deg is None or self._differs(target_deg, last.strange_deg):
                last.strange_deg = target_deg
                return None
            course.retarget(last.heard_s, target_deg, last.duration_s)
        self.others, self.last = [], None
        return course

    def _taken_up_s(self, last: Last) -> float:
        return last.heard_s + TAKEN_UP_LOOPS * self.loop_s

    def _parts(self, other: Profile) -> bool:
        """Return whether `other` has another target than the servo was told last."""
        return self.last is None or self._differs(other.target_deg, self.last.target_deg)

    def _differs(self, one_deg: float, other_deg: float) -> bool:
        return abs(one_deg - other_deg) > SAME_UNITS * self.unit_deg

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
