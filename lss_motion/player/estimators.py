"""Estimators for one joint from its readings: load, lag, and lost moves.

A bus without checksums can deliver a wrong number that looks right, so `DisturbanceEstimator` first
checks that a reading is plausible. The remaining difference between reading and response model is
treated as a slowly changing disturbance (load, backlash, a bent linkage), which is estimated and
offered as a bounded offset.

`LagEstimator` estimates how much later than assumed the horn follows the profile. A position error
by lag grows with the speed, an error by load does not. So the slope of the error over the speed,
through the readings of the last seconds of motion, is the lag.

`LostMoveDetector` detects moves that the servo did not receive. A line without acknowledgement
loses a command now and then, and the servo goes on with the one before. So after every move to
another target the servo is polled for its target (QDT, FACTS.md C2: "the target angle during and
after an action"). An answer with the target before means that the move was lost. Besides, for each
of the last moves the profile without it is kept until a reported target or the readings decide:
they tell the profiles apart once these diverge.

`Trace` keeps readings for a picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from lss_motion.robot.profile import Profile


JUMP_MARGIN_DEG: Final = 5.0
"""A horn may seem to jump this far beyond what its speed allows: noise, backlash and lag."""
ESTIMATE_S: Final = 0.18
"""Time constant of the estimate, whatever the rate of readings: an error that many readings in a
row share, such as one wrong instant, counts once. Chosen: slower changes are a disturbance, and
at 22 readings a second each then counts a quarter."""
GAIN_MAX: Final = 0.25
"""No reading counts more than this. Chosen: four readings make a correction."""
GAIN_HALF_SPEED_DEG_S: Final = 30.0
"""At this speed a reading counts half: a lag that is wrong by 10 ms causes 0.3 deg there."""
OFFSET_MAX_DEG: Final = 3.0
"""Largest correction (FACTS.md A20)."""
OFFSET_RATE_DEG_S: Final = 10.0
"""Fastest change of a correction: a tenth of the speed of an ordinary move."""


@dataclass(slots=True)
class DisturbanceEstimator:
    """Estimate for one joint, in servo degrees; times in seconds on one clock."""

    speed_max_deg_s: float
    standing_deg: float | None = None
    """Horn angle before the first reading, if it is known."""
    step_max_deg: float = math.inf
    """One reading changes the correction by no more than this."""
    estimate_deg: float = 0.0
    offset_deg: float = 0.0
    readings: int = 0
    rejected: int = 0
    square_sum_deg2: float = 0.0
    error_deg: float = 0.0
    """Distance of the plan from the last reading."""
    model_error_deg: float = 0.0
    """Distance of the response model from the last reading."""
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
        """Use a reading that was taken at `read_s`; return whether it was accepted.

        `expected_deg` is the horn angle of the response model after all that was sent,
        `planned_deg` that of the plan. Without `learns`, an accepted reading counts for the errors
        only.
        """
        if not self._is_plausible(measured_deg, read_s):
            self.rejected += 1
            return False
        is_first = self.read_s is None
        elapsed_s = 0.0 if self.read_s is None else read_s - self.read_s
        self.measured_deg, self.read_s = measured_deg, read_s
        self.readings += 1
        self.error_deg = planned_deg - measured_deg
        self.model_error_deg = expected_deg - measured_deg
        self.square_sum_deg2 += self.error_deg * self.error_deg
        self.error_max_deg = max(self.error_max_deg, abs(self.error_deg))
        if not learns:
            return True
        gain = GAIN_MAX if is_first else min(GAIN_MAX, elapsed_s / ESTIMATE_S)
        gain /= 1.0 + abs(speed_deg_s) / GAIN_HALF_SPEED_DEG_S
        self.estimate_deg += gain * (expected_deg - measured_deg - self.estimate_deg)
        self._correct(min(OFFSET_RATE_DEG_S * elapsed_s, self.step_max_deg))
        return True

    def rest(self, estimate_deg: float) -> None:
        """Set the disturbance to the known distance of a horn at rest from its profile."""
        self.estimate_deg = estimate_deg
        self._correct(math.inf)

    def _correct(self, most_deg: float) -> None:
        """Move the offset towards the estimate, by `most_deg` at most, within its bounds."""
        change_deg = min(max(self.estimate_deg, -OFFSET_MAX_DEG), OFFSET_MAX_DEG)
        change_deg -= self.offset_deg
        self.offset_deg += min(max(change_deg, -most_deg), most_deg)
        self.offset_max_deg = max(self.offset_max_deg, abs(self.offset_deg))

    def stand_at(self, standing_deg: float) -> None:
        """Start anew with a horn that stands at `standing_deg`; the estimate is kept."""
        self.standing_deg = standing_deg
        self.measured_deg = self.read_s = self._suspect = None

    def take_over(self, earlier: DisturbanceEstimator) -> None:
        """Take over the estimate of the same joint."""
        self.estimate_deg, self.offset_deg = earlier.estimate_deg, earlier.offset_deg

    @property
    def last_deg(self) -> float | None:
        """The last horn angle that is known."""
        return self.standing_deg if self.measured_deg is None else self.measured_deg

    @property
    def error_rms_deg(self) -> float:
        return (self.square_sum_deg2 / self.readings) ** 0.5 if self.readings else 0.0

    def _is_plausible(self, measured_deg: float, read_s: float) -> bool:
        """Return whether a reading is accepted.

        It is if the horn can have reached it since the last accepted one, or if a second reading
        confirms it: a hand may have moved the horn.
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
"""Largest estimate in both directions: three times the lag that is assumed of a servo (`lag_s`).
Chosen: a horn that lags more is held up by something."""
MEMORY_S: Final = 3.0
"""Seconds of motion after which the weight of a reading has dropped to a third. Chosen: a few moves
of a show."""
SPEED_DEG_S: Final = 20.0
"""At this speed and above a reading has its full weight for the lag, below less."""
PRIOR_DEG2_S: Final = 100.0
"""Weight of the assumption that the lag is as assumed: a second at 10 deg/s to and fro. Chosen: a
single slow move changes little, and a quick one much (measured: with three times as much, horns
with a wrong lag deviate 8 % more in 20 s)."""
DEAD_S: Final = 0.004
"""A smaller difference is not corrected, since commands would lose their slots on the line for
nothing. Chosen: on simulated servos that lag as assumed the estimate stays within 3 ms
(measured). A difference of twice as much is corrected fully."""


@dataclass(slots=True)
class LagEstimator:
    """Sums over the readings of one joint, weighted by time; motion lets old ones fade."""

    _weight: float = 0.0
    _speed: float = 0.0
    _speed2: float = 0.0
    _missing: float = 0.0
    _product: float = 0.0

    def take(self, missing_deg: float, speed_deg_s: float, elapsed_s: float) -> None:
        """Use a reading: `missing_deg` is how far the horn was behind a profile without extra lag.

        `elapsed_s` is the time since the reading before.
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
        """Lag besides the assumed one, within `LAG_MAX_S`."""
        if self._weight <= 0.0:
            return 0.0
        spread = self._speed2 - self._speed * self._speed / self._weight
        common = self._product - self._speed * self._missing / self._weight
        return min(max(common / (spread + PRIOR_DEG2_S), -LAG_MAX_S), LAG_MAX_S)

    @property
    def extra_s(self) -> float:
        """By how much commands are sent earlier: the estimate, or 0 if it is small."""
        estimate_s = self.estimate_s
        return estimate_s * min(max(0.0, abs(estimate_s) / DEAD_S - 1.0), 1.0)


PARTED_DEG: Final = 1.0
"""The horn must be nearer to one profile than to the other by this: ten times the noise of a
reading, and the effect of a lag that is wrong by 10 ms at 100 deg/s. Chosen."""
NEAR_DEG: Final = 0.6
NEAR_RATIO: Final = 0.3
"""The horn may be no further from the other profile than `NEAR_DEG`, or than this share of its
distance from its own: a lag that is not known yet, or a weak motor, leads it away from both."""
SURE_S: Final = 0.01
"""The readings must agree for this long: a horn that only crosses another profile is soon
elsewhere."""
OTHERS_MAX: Final = 3
"""Number of moves that are in doubt at once; the oldest counts as received."""
QUERIES_MAX: Final = 3
"""Queries for the target of one move; after that the readings decide. Chosen: two unanswered
queries take long enough for them."""
MISMATCHES_MAX: Final = 6
"""A servo that reports another target this often in a row means something else by it, such as
limits of its own, and is not polled for it any more. A line that loses every fifth command
causes this once in 15000 moves."""
REPORTED_LOOPS: Final = 1.5
"""Number of control ticks after a move has arrived until a servo reports its target. Assumed, with
half a tick to spare: no document says when it does (FACTS.md C2)."""
SAME_UNITS: Final = 1.5
"""Targets that differ by no more wire units than this are the same, since a servo that counts in
its own units may be one off."""


@dataclass(slots=True)
class LastMove:
    """The last move that was sent to a servo, and its profile before that."""

    before: Profile
    arrival_s: float
    target_deg: float
    duration_s: float | None
    queries_left: int
    unknown_deg: float | None = None
    """A target that was never sent, but that the servo reported once."""


@dataclass(slots=True)
class Alternative:
    """The profile of a servo that has lost one of the last moves."""

    profile: Profile
    since_s: float | None = None
    """Instant since which all readings have matched this profile."""


@dataclass(slots=True)
class LostMoveDetector:
    """Detects which moves one servo has lost."""

    unit_deg: float
    """One wire unit."""
    loop_s: float
    """Period of the servo's control tick, at which it starts a move (`Response.loop_s`)."""
    alternatives: list[Alternative] = field(default_factory=list)
    last: LastMove | None = None
    mismatches: int = 0
    """How often in a row the servo reported another target than the one that was sent."""
    is_doubtful: bool = False
    """Whether the last reading matched another profile: then nothing else is learnt from it."""

    def commanded(
        self, before: Profile, arrival_s: float, target_deg: float, duration_s: float | None
    ) -> None:
        """Note a new move; `before` is a copy of the profile before it."""
        for other in self.alternatives:
            other.profile.retarget(arrival_s, target_deg, duration_s)
            other.since_s = None
        self.alternatives = [*self.alternatives[-(OTHERS_MAX - 1) :], Alternative(before)]
        is_conclusive = (
            self._differs(before.target_deg, target_deg) and self.mismatches < MISMATCHES_MAX
        )
        queries = QUERIES_MAX if is_conclusive else 0
        self.last = LastMove(before.copy(), arrival_s, target_deg, duration_s, queries)

    def take_over(self, earlier: LostMoveDetector) -> None:
        """Take over whether the servo reports its targets as they were sent."""
        self.mismatches = earlier.mismatches

    @property
    def target_due_s(self) -> float:
        """Instant from which the servo must be polled for its target; infinite: it need not be."""
        last = self.last
        return self._reported_s(last) if last is not None and last.queries_left > 0 else math.inf

    def count_target_query(self) -> None:
        """Note that the servo is polled for its target now."""
        assert self.last is not None
        self.last.queries_left -= 1

    def target_reported(self, at_s: float, target_deg: float) -> Profile | None:
        """Use the target that a servo reported at `at_s`; return as `judge` does.

        A target that was never sent must be reported twice, since the answer may be damaged.
        """
        last = self.last
        if last is None or at_s < self._reported_s(last):
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

    def _reported_s(self, last: LastMove) -> float:
        return last.arrival_s + REPORTED_LOOPS * self.loop_s

    def _parts(self, other: Profile) -> bool:
        """Return whether `other` has another target than the last one that was sent."""
        return self.last is None or self._differs(other.target_deg, self.last.target_deg)

    def _differs(self, one_deg: float, other_deg: float) -> bool:
        return abs(one_deg - other_deg) > SAME_UNITS * self.unit_deg

    def judge(self, at_s: float, expected_deg: float, free_deg: float) -> Profile | None:
        """Return the profile that the servo really follows; None: its own, as far as is known.

        `expected_deg` is the angle of its profile at `at_s` (on the time of the profile, lag taken
        off), `free_deg` the measured angle without the disturbance.
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


POINTS_MAX: Final = 1000
"""Chosen: one point for every pixel of a wide picture."""


@dataclass(slots=True)
class Trace:
    """Accepted readings, as `(seconds, planned angle, measured angle)` of the joint.

    Every `stride`-th is kept. When there are too many, every other one is dropped, so the points
    always cover the whole show evenly, and their number does not grow with it.
    """

    points: list[tuple[float, float, float]] = field(default_factory=list)
    stride: int = 1
    _count: int = 0

    def add(self, at_s: float, planned_deg: float, measured_deg: float) -> None:
        """Add the next reading; `at_s` counts from the start of the show, pauses included."""
        if self._count % self.stride == 0:
            self.points.append((at_s, planned_deg, measured_deg))
        self._count += 1
        if len(self.points) > POINTS_MAX:
            del self.points[1::2]
            self.stride *= 2
