"""What the readings of one joint say about it: offset, lag, lost moves.

What the readings of one joint say: are they believable, how far off is it, what corrects it.

A bus without checksums can deliver a wrong number that looks right, so a reading passes a gate
first. What then remains between the reading and the response model is taken as a slowly changing
disturbance (load, backlash, a bent linkage), estimated, and offered as a bounded offset.

How much later than assumed the horn of one joint follows its servo's profile.

What a horn lags by grows with its speed, and what a load pulls it by does not: the slope of what
is missing over the speed, through the readings of the last seconds of motion, is the lag.

Whether a servo heard its last moves: it is asked for its target, and where the horn is tells.

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
class DisturbanceEstimator:
    """The estimate for one joint, in servo degrees; times in seconds on one clock."""

    speed_max_deg_s: float
    standing_deg: float | None = None
    """Where the horn was before the first reading, if that is known."""
    estimate_deg: float = 0.0
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
        planned_deg: float,
        speed_deg_s: float,
        learns: bool = True,
    ) -> bool:
        """Use a reading taken at `read_s`; return whether it was believed.

        `expected_deg` is where the response model puts the horn after all that was sent,
        `planned_deg` where the plan wants it. One from which nothing `learns` is only counted.
        """
        if not self._is_plausible(measured_deg, read_s):
            self.rejected += 1
            return False
        is_first = self.read_s is None
        elapsed_s = 0.0 if self.read_s is None else read_s - self.read_s
        self.measured_deg, self.read_s = measured_deg, read_s
        self.readings += 1
        self.error_deg = planned_deg - measured_deg
        self.square_sum_deg2 += self.error_deg * self.error_deg
        self.error_max_deg = max(self.error_max_deg, abs(self.error_deg))
        if not learns:
            return True
        gain = GAIN_MAX if is_first else min(GAIN_MAX, elapsed_s / ESTIMATE_S)
        gain /= 1.0 + abs(speed_deg_s) / GAIN_HALF_SPEED_DEG_S
        self.estimate_deg += gain * (expected_deg - measured_deg - self.estimate_deg)
        self._correct(OFFSET_RATE_DEG_S * elapsed_s)
        return True

    def rest(self, estimate_deg: float) -> None:
        """Note what is known for sure: so far from its profile a horn comes to rest."""
        self.estimate_deg = estimate_deg
        self._correct(math.inf)

    def _correct(self, most_deg: float) -> None:
        """Bring the offset to what is disturbed, by `most_deg` and within its bounds."""
        change_deg = min(max(self.estimate_deg, -OFFSET_MAX_DEG), OFFSET_MAX_DEG)
        change_deg -= self.offset_deg
        self.offset_deg += min(max(change_deg, -most_deg), most_deg)
        self.offset_max_deg = max(self.offset_max_deg, abs(self.offset_deg))

    def stand_at(self, standing_deg: float) -> None:
        """Begin to read anew, with a horn that stands there; what was learnt is kept."""
        self.standing_deg = standing_deg
        self.measured_deg = self.read_s = self._suspect = None

    def take_over(self, earlier: DisturbanceEstimator) -> None:
        """Take over the estimate of the same joint."""
        self.estimate_deg, self.offset_deg = earlier.estimate_deg, earlier.offset_deg

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
class LagEstimator:
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
QUERIES_MAX: Final = 3
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
class LastMove:
    """The last move that a servo was told, and its profile before that."""

    before: Profile
    arrival_s: float
    target_deg: float
    duration_s: float | None
    queries_left: int
    unknown_deg: float | None = None
    """A target that nobody told it, as it said once."""


@dataclass(slots=True)
class Alternative:
    """A profile without one of the last moves."""

    profile: Profile
    since_s: float | None = None
    """Since when every reading has spoken for it."""


@dataclass(slots=True)
class LostMoveDetector:
    """What one servo may have missed."""

    unit_deg: float
    """One unit of the wire."""
    loop_s: float
    """A servo takes up a move at its next control tick (`Response.loop_s`)."""
    alternatives: list[Alternative] = field(default_factory=list)
    last: LastMove | None = None
    mismatches: int = 0
    """How often in a row the servo named another target than it was told."""
    is_doubtful: bool = False
    """Whether the last reading spoke for another course: nothing else can be learnt from it."""

    def commanded(
        self, before: Profile, arrival_s: float, target_deg: float, duration_s: float | None
    ) -> None:
        """Note a new move, and a copy of the profile `before` it."""
        for other in self.alternatives:
            other.profile.retarget(arrival_s, target_deg, duration_s)
            other.since_s = None
        self.alternatives = [*self.alternatives[-(OTHERS_MAX - 1) :], Alternative(before)]
        is_telling = self._differs(before.target_deg, target_deg) and self.mismatches < DENIALS_MAX
        asks = QUERIES_MAX if is_telling else 0
        self.last = LastMove(before.copy(), arrival_s, target_deg, duration_s, asks)

    def take_over(self, earlier: LostMoveDetector) -> None:
        """Take over whether the servo reports its targets as they were sent."""
        self.mismatches = earlier.mismatches

    def needs_target(self, now_s: float) -> bool:
        """Return whether the servo is to be asked for its target."""
        last = self.last
        return last is not None and last.queries_left > 0 and now_s >= self._taken_up_s(last)

    def count_target_query(self) -> None:
        """Note that the servo is asked for its target now."""
        assert self.last is not None
        self.last.queries_left -= 1

    def target_reported(self, at_s: float, target_deg: float) -> Profile | None:
        """Take the target that a servo named at `at_s`; return as `judge` does.

        One that nobody told it must be named twice: it may be the answer that was damaged.
        """
        last = self.last
        if last is None or at_s < self._taken_up_s(last):
            return None
        if not self._differs(target_deg, last.target_deg):
            self.mismatches, last.queries_left = 0, 0
            self.alternatives = [o for o in self.alternatives if not self._parts(o.profile)]
            return None
        self.mismatches += 1
        course = last.before
        if self._differs(target_deg, course.target_deg):
            if last.unknown_deg is None or self._differs(target_deg, last.unknown_deg):
                last.unknown_deg = target_deg
                return None
            course.retarget(last.arrival_s, target_deg, last.duration_s)
        self.alternatives, self.last = [], None
        return course

    def _taken_up_s(self, last: LastMove) -> float:
        return last.arrival_s + TAKEN_UP_LOOPS * self.loop_s

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
        nears = [(abs(free_deg - other.profile.at(at_s)[0]), other) for other in self.alternatives]
        nears = [near for near in nears if near[0] - off_deg <= PARTED_DEG]
        self.alternatives = [other for _, other in nears]
        near_deg, likely = min(nears, key=lambda near: near[0], default=(math.inf, None))
        if off_deg - near_deg < PARTED_DEG or near_deg > max(NEAR_DEG, NEAR_RATIO * off_deg):
            likely = None
        for other in self.alternatives:
            if other is not likely:
                other.since_s = None
        self.is_doubtful = likely is not None
        if likely is None:
            return None
        if likely.since_s is None:
            likely.since_s = at_s
        if at_s - likely.since_s < SURE_S:
            return None
        self.alternatives = []
        return likely.profile
