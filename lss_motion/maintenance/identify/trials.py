"""The trials of an identification: their plan inside a window of angles, and their measurements.

`make_window` and `make_trials` plan small moves, each of which shows one property of the servo.
`Trial` and `Recording` hold what was sent and read, and when.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.robot.profile import ramp_deg_s2
from lss_motion.units import MS_PER_S, s_from_ms

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lss_motion.robot.model import Joint


SETTLE_S: Final = 0.3
"""A horn rests when two halves of this time agree, after the end of its profile."""
SETTLED_DEG: Final = 0.12
"""How well they agree: a reading scatters by a tenth of a degree (FACTS.md E7)."""
FAST_S: Final = 0.05
"""A speed is a difference over this time: the scatter of two readings is 4 deg/s of it."""
SPAN_DEG: Final = 20.0
"""Default distance to either side of the present angle. Chosen: a servo of the desk arm reaches two
thirds of its speed limit there."""
SPAN_LEAST_DEG: Final = 5.0
ROOM_LEAST_DEG: Final = 8.0
"""In less room, moves are too short to separate ramp and lag: 0.2 s at 600 deg/s²."""
MARGIN_RATIO: Final = 0.08
"""Share of the room left free at either end, for load and overshoot."""
MARGIN_LEAST_DEG: Final = 0.5
SWEEP_RATIOS: Final = (0.25, 0.4, 0.6)
"""Speeds of the sweeps, as shares of the speed that the room and the ramps allow. Below 0.6 of a
speed that it has reached, a servo follows its profile all the way."""
PAIR_RATIO: Final = 0.45
"""Speed at which a move is interrupted: it stops within a tenth of the room."""
STEP_RATIO: Final = 0.45
"""Speed of the steps between rests, as a share of what a quarter of the room allows."""

LEAST_DEG: Final = 1.0
"""Shorter moves are left out, since they show nothing."""


class SentMove(NamedTuple):
    """A `D target T duration` whose last byte the servo received at `received_s`."""

    received_s: float
    target_deg: float
    duration_s: float


class TrialKind(StrEnum):
    """The purpose of a trial."""

    REACH = "reach"
    SWEEP = "sweep"
    STEP = "step"
    PAIR = "pair"
    FAST = "fast"


class PlannedMove(Struct, frozen=True):
    """A `D…T…` that is sent `at_s` after its trial began. Servo degrees."""

    at_s: float
    target_deg: float
    duration_ms: int


class TrialPlan(Struct, frozen=True):
    """From rest to rest: one move, or two of which the second interrupts the first."""

    kind: TrialKind
    moves: tuple[PlannedMove, ...]
    end_s: float
    """The latest end of the servo's profile under every meaning of T, without lag."""


class MotionWindow(Struct, frozen=True):
    """The range of the horn during an identification, in servo degrees."""

    low_deg: float
    high_deg: float

    @property
    def room_deg(self) -> float:
        return self.high_deg - self.low_deg

    def margin_deg(self) -> float:
        return max(MARGIN_LEAST_DEG, MARGIN_RATIO * self.room_deg)


@dataclass(slots=True)
class Trial:
    """From rest to rest. Servo degrees; seconds since the trial began."""

    kind: TrialKind
    began_s: float
    """On the clock of the run."""
    start_deg: float
    """The target of the rest before."""
    sent: list[SentMove] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    """When the servo received each query completely, taken as the instant of its reading."""
    readings_deg: list[float] = field(default_factory=list)

    def is_settled(self, now_s: float) -> bool:
        """Return whether the horn has not moved during the last `SETTLE_S`."""
        late = self._between(now_s - 0.5 * SETTLE_S, now_s)
        early = self._between(now_s - SETTLE_S, now_s - 0.5 * SETTLE_S)
        if not late or not early:
            return False
        return abs(float(np.median(late)) - float(np.median(early))) < SETTLED_DEG

    def rest_deg(self) -> float:
        """Return the angle of rest at the end; there is at least one reading."""
        last_s = self.times_s[-1]
        return float(np.mean(self._between(last_s - 0.5 * SETTLE_S, last_s)))

    def fastest_deg_s(self) -> float:
        """Return the highest speed over `FAST_S`; 0 without enough readings."""
        fastest, first = 0.0, 0
        for last, time_s in enumerate(self.times_s):
            while first < last and time_s - self.times_s[first + 1] >= FAST_S:
                first += 1
            if (passed_s := time_s - self.times_s[first]) >= FAST_S:
                turned_deg = self.readings_deg[last] - self.readings_deg[first]
                fastest = max(fastest, abs(turned_deg) / passed_s)
        return fastest

    def rest_variance_deg2(self) -> float:
        """Return the variance of the readings at the end."""
        last_s = self.times_s[-1]
        return float(np.var(self._between(last_s - 0.5 * SETTLE_S, last_s)))

    def last_direction(self) -> float:
        """Return the direction of the last move: 1 or -1; 0 without a move."""
        legs_turned_deg = [
            move.target_deg - before for before, move in zip(self._legs(), self.sent, strict=True)
        ]
        return float(np.sign(legs_turned_deg[-1])) if legs_turned_deg else 0.0

    def _legs(self) -> list[float]:
        """Return about where each move started; an interrupted one was half-way."""
        legs_deg = [self.start_deg]
        for move in self.sent[:-1]:
            legs_deg.append(0.5 * (legs_deg[-1] + move.target_deg))
        return legs_deg[: len(self.sent)]

    def _between(self, from_s: float, to_s: float) -> list[float]:
        return [
            reading_deg
            for time_s, reading_deg in zip(self.times_s, self.readings_deg, strict=True)
            if from_s < time_s <= to_s
        ]


@dataclass(slots=True)
class Recording:
    """All trials of one joint, and the reply latencies of its servo."""

    window: MotionWindow
    ramp_deg_s2: float
    """The setting of AA and AD."""
    speed_max_deg_s: float
    """The setting of SD."""
    trials: list[Trial] = field(default_factory=list)
    turnarounds_s: list[float] = field(default_factory=list)
    """From the end of each query to the start of its answer, at the host."""


def make_window(joint: Joint, standing_deg: float, span_deg: float) -> MotionWindow:
    """Return the window of the horn: `span_deg` around `standing_deg`, inside the joint's range.

    Raises `InputError` where the joint stands outside its range or has no room to move.
    """
    if not span_deg >= SPAN_LEAST_DEG:  # True for NaN as well.
        raise InputError(
            f"--span-deg {span_deg:g} is too little to measure anything; "
            f"at least {SPAN_LEAST_DEG:g}"
        )
    ends = joint.servo_range_deg
    at_deg = joint.joint_deg(standing_deg)
    allowed = f"{joint.position_min_deg:g} to {joint.position_max_deg:g} deg"
    if not ends[0] <= standing_deg <= ends[1]:
        raise InputError(
            f"joint {joint.name!r} stands at {at_deg:.1f} deg, outside its range of {allowed}; "
            f"move it inside by hand or with lss-motion send"
        )
    window = MotionWindow(
        max(ends[0], standing_deg - span_deg),
        min(ends[1], standing_deg + span_deg),
    )
    if window.room_deg < ROOM_LEAST_DEG:
        raise InputError(
            f"joint {joint.name!r} stands at {at_deg:.1f} deg and may move {window.room_deg:.1f} "
            f"deg only (range {allowed}, --span-deg {span_deg:g}); at least {ROOM_LEAST_DEG:g} deg "
            f"are needed. Move it away from its limit, or give a larger --span-deg"
        )
    return window


def make_trials(
    joint: Joint,
    window: MotionWindow,
    standing_deg: float,
    *,
    droop_deg: float = 0.0,
    top_deg_s: float = math.inf,
) -> list[TrialPlan]:
    """Return the trials from `standing_deg` and back; each begins where the one before ended.

    `droop_deg` is how far the horn stands below its target: targets are shifted away from the end
    that it would otherwise pass. No move is faster than the joint's own limits. The fast trials
    come first; the others stay well below `top_deg_s`, the measured top speed, on which their
    number does not depend.
    """
    margin_deg = window.margin_deg()
    low_deg = window.low_deg + margin_deg + max(0.0, droop_deg)
    high_deg = window.high_deg - margin_deg + min(0.0, droop_deg)
    if high_deg - low_deg < 0.5 * ROOM_LEAST_DEG:
        raise InputError(
            f"joint {joint.name!r}: its load pulls it {abs(droop_deg):.1f} deg from where it "
            f"should stand, which leaves no room inside {window.room_deg:.1f} deg. Take the load "
            f"off, or give a larger --span-deg"
        )
    planner = _TrialPlanner(joint, low_deg, high_deg, standing_deg, top_deg_s)
    return list(planner.trials())


def estimated_duration_s(trials: Sequence[TrialPlan]) -> float:
    """Return the approximate duration of the trials, with a pause to settle after each."""
    return sum(trial.end_s + SETTLE_S for trial in trials)


class _TrialPlanner:
    """Makes the trials between two angles."""

    def __init__(
        self,
        joint: Joint,
        low_deg: float,
        high_deg: float,
        standing_deg: float,
        top_deg_s: float,
    ) -> None:
        self._ramp_deg_s2 = float(ramp_deg_s2(joint))
        self._speed_max_deg_s = joint.speed_max_deg_s
        self._seen_deg_s = top_deg_s
        self._low_deg, self._high_deg = low_deg, high_deg
        self._at_deg = self._standing_deg = standing_deg

    def trials(self) -> Iterator[TrialPlan]:
        room_deg = self._high_deg - self._low_deg
        if abs(self._at_deg - self._low_deg) > LEAST_DEG:
            yield self._single(
                TrialKind.REACH, self._low_deg, PAIR_RATIO * self._limit_deg_s(room_deg)
            )
        self._at_deg = self._low_deg
        for target_deg in (self._high_deg, self._low_deg):
            yield self._fast(target_deg)
        for ratio in SWEEP_RATIOS:
            speed_deg_s = ratio * self._top_deg_s(room_deg)
            yield self._single(TrialKind.SWEEP, self._high_deg, speed_deg_s)
            yield self._single(TrialKind.SWEEP, self._low_deg, speed_deg_s)
        yield from self._steps(room_deg)
        yield from self._pairs(PAIR_RATIO * self._top_deg_s(room_deg), room_deg)
        if abs(self._at_deg - self._standing_deg) > LEAST_DEG:
            speed_deg_s = PAIR_RATIO * self._top_deg_s(0.5 * room_deg)
            yield self._single(TrialKind.STEP, self._standing_deg, speed_deg_s)

    def _steps(self, room_deg: float) -> Iterator[TrialPlan]:
        """Go up and down a stair: rest at every height, reached from below and from above."""
        speed_deg_s = STEP_RATIO * self._top_deg_s(room_deg / 4.0)
        for quarter in (1, 2, 3, 4, 3, 2, 1, 0):
            target_deg = self._low_deg + room_deg * quarter / 4.0
            yield self._single(TrialKind.STEP, target_deg, speed_deg_s)

    def _pairs(self, speed_deg_s: float, room_deg: float) -> Iterator[TrialPlan]:
        """Interrupt moves: to go further, turn back, go faster, go slower; in both directions."""
        ends = (self._low_deg, self._high_deg)
        slow_deg_s = 0.6 * speed_deg_s
        for here_deg, there_deg in (ends, ends[::-1]):
            direction = math.copysign(1.0, there_deg - here_deg)
            further = here_deg + direction * 0.65 * room_deg
            yield self._pair(further, speed_deg_s, there_deg, speed_deg_s)
            yield self._pair(here_deg, speed_deg_s, there_deg, speed_deg_s)  # Turn back half-way.
            yield self._pair(here_deg, slow_deg_s, here_deg, speed_deg_s)
            yield self._pair(there_deg, speed_deg_s, there_deg, 0.5 * speed_deg_s)

    def _top_deg_s(self, distance_deg: float) -> float:
        """Return the speed that ramps reach half-way, at most the measured top speed."""
        return min(self._seen_deg_s, self._limit_deg_s(distance_deg))

    def _limit_deg_s(self, distance_deg: float) -> float:
        """Return the speed that ramps reach half-way, at most the joint's limit."""
        return min(self._speed_max_deg_s, math.sqrt(self._ramp_deg_s2 * distance_deg))

    def _duration_ms(self, distance_deg: float, speed_deg_s: float) -> int:
        """Return a T at which no meaning of T makes the servo faster than `speed_deg_s`."""
        duration_s = distance_deg / speed_deg_s + speed_deg_s / self._ramp_deg_s2
        return math.ceil(MS_PER_S * duration_s)

    def _single(self, kind: TrialKind, target_deg: float, speed_deg_s: float) -> TrialPlan:
        duration_ms = self._duration_ms(abs(target_deg - self._at_deg), speed_deg_s)
        self._at_deg = target_deg
        move = PlannedMove(0.0, target_deg, duration_ms)
        return TrialPlan(kind, (move,), s_from_ms(duration_ms) + self._ramp_s(speed_deg_s))

    def _pair(
        self, first_deg: float, first_deg_s: float, second_deg: float, second_deg_s: float
    ) -> TrialPlan:
        """Interrupt a move to `first_deg` half-way by one to `second_deg`."""
        first_ms = self._duration_ms(abs(first_deg - self._at_deg), first_deg_s)
        middle_deg = 0.5 * (self._at_deg + first_deg)
        second_ms = self._duration_ms(abs(second_deg - middle_deg), second_deg_s)
        at_s = 0.5 * s_from_ms(first_ms)
        self._at_deg = second_deg
        return TrialPlan(
            TrialKind.PAIR,
            (
                PlannedMove(0.0, first_deg, first_ms),
                PlannedMove(at_s, second_deg, second_ms),
            ),
            at_s + s_from_ms(second_ms) + 2.0 * self._ramp_s(max(first_deg_s, second_deg_s)),
        )

    def _fast(self, target_deg: float) -> TrialPlan:
        """Move as fast as the joint may."""
        distance_deg = abs(target_deg - self._at_deg)
        duration_ms = math.ceil(MS_PER_S * distance_deg / self._speed_max_deg_s)
        self._at_deg = target_deg
        longest_s = 2.0 * math.sqrt(distance_deg / self._ramp_deg_s2)
        move = PlannedMove(0.0, target_deg, duration_ms)
        ends_s = s_from_ms(duration_ms) + self._ramp_s(self._speed_max_deg_s)
        return TrialPlan(TrialKind.FAST, (move,), max(longest_s, ends_s))

    def _ramp_s(self, speed_deg_s: float) -> float:
        return speed_deg_s / self._ramp_deg_s2
