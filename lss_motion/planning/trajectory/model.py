"""Trajectories: where every joint is at every instant, in every pass. The result of planning.

A pass is a path and a clock that follows it (`PathMotion`), a part of another pass (`LoopedSpan`),
or made of several trajectories (`tracks.ParallelPass`, `playlist.PlayListPass`).
"""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal, Protocol

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from lss_motion.errors import InputError
from lss_motion.files.texts import counted, duration_text
from lss_motion.planning.trajectory.curves import Path
from lss_motion.robot.on_fault import Escalations
from lss_motion.show.model import Cue, Sequence, Wait
from lss_motion.show.splines import distinct

FloatArray = NDArray[np.float64]

JOINT_SECONDS_MAX: Final = 500_000
"""Seconds of a plan times its joints: seven hours of 18 joints. More takes minutes to verify, and
more than 0.8 GB to compile. A loop counts as what is written of it."""

SEAM_DEG: Final = 0.001
"""Largest difference of a joint's angle between both ends of a looped span. Chosen: a tenth
of the finest unit of a servo; keys that are rounded to 1e-5 deg stay far below."""

SEAM_DEG_S: Final = 0.5
"""The same for its speed. Chosen: half of 1 deg/s, above which a seam can be seen."""


class SlowSpan(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A span that is slower than authored, because of a limit. Times are planned times."""

    from_s: float
    to_s: float
    by_s: float
    joint: str
    limit: Literal["speed", "acceleration", "jerk"]
    authored: float
    """The largest speed (deg/s), acceleration (deg/s²) or jerk (deg/s³) that the authored times
    need."""
    allowed: float
    """The limit of the joint, in the same unit."""
    servo: str = ""
    """The servo that has the limit, as a person calls it; empty: the joint has it."""
    at_deg: tuple[tuple[str, float], ...] = ()
    """Then, where the joints are at which most is needed."""

    @property
    def unit(self) -> str:
        """The unit of `authored` and `allowed`."""
        return {"speed": "deg/s", "acceleration": "deg/s²", "jerk": "deg/s³"}[self.limit]

    @property
    def owner(self) -> str:
        """What has the limit, and where: a joint, or a servo."""
        if not self.servo:
            return f"joint {self.joint!r}"
        return f"{self.servo}, at {', '.join(f'{name} {deg:.0f}' for name, deg in self.at_deg)},"

    @property
    def text(self) -> str:
        """How much longer the span takes than the file sets, and why."""
        return (
            f"{self.from_s:.3f} s to {self.to_s:.3f} s takes {self.by_s:.3f} s longer: "
            f"{self.owner} would need {self.limit} {self.authored:.0f} {self.unit}, "
            f"allowed {self.allowed:g} {self.unit}"
        )


class MissedKey(Struct, frozen=True, kw_only=True):
    """A key at which a joint that keeps its time should turn or stay, and its angle there."""

    at_s: float
    label: str
    asked_deg: float
    given_deg: float


class GivenUp(Struct, frozen=True, kw_only=True):
    """A span in which a joint that keeps its time gives up angle. Times are planned times."""

    from_s: float
    to_s: float
    joint: str
    by_deg: float
    """The largest difference between the angle that is asked for and the one that is given."""
    at_s: float
    """Where it is that large."""
    rms_deg: float
    missed: tuple[MissedKey, ...] = ()

    @property
    def text(self) -> str:
        """By how much the joint is off, and when."""
        return (
            f"{self.from_s:.3f} s to {self.to_s:.3f} s joint {self.joint!r} is up to "
            f"{self.by_deg:.1f} deg off (at {self.at_s:.3f} s), {self.rms_deg:.1f} deg RMS"
        )

    def later(self, by_s: float) -> GivenUp:
        """Return the span with its times moved by `by_s`."""
        return replace(
            self,
            from_s=self.from_s + by_s,
            to_s=self.to_s + by_s,
            at_s=self.at_s + by_s,
            missed=tuple(replace(key, at_s=key.at_s + by_s) for key in self.missed),
        )


class AskedSpan(Struct, frozen=True, kw_only=True):
    """The angles that the author asks for where a plan gives up angle, at equal steps."""

    from_s: float
    to_s: float
    joint: str
    deg: tuple[float, ...]

    def later(self, by_s: float) -> AskedSpan:
        """Return the span with its times moved by `by_s`."""
        return replace(self, from_s=self.from_s + by_s, to_s=self.to_s + by_s)


class CommandedMove(Struct, frozen=True, kw_only=True):
    """A move that the plan leaves to the servo: one command with this target and T."""

    at_s: float
    joint: str
    deg: float
    duration_s: float

    def later(self, by_s: float) -> CommandedMove:
        """Return the move with its time moved by `by_s`."""
        return replace(self, at_s=self.at_s + by_s)


class Mark(Struct, frozen=True, kw_only=True):
    """A keyframe in the plan: its authored time (None: not given) and when it is reached.

    `hold_s` is how long the author holds it, `held_s` how long it is held in the plan. `rest_s` and
    `rested_s` are the same for a rest of all joints of the track from there to the next keyframe.
    """

    label: str
    authored_s: float | None
    planned_s: float
    is_anchor: bool
    hold_s: float = 0.0
    held_s: float = 0.0
    rest_s: float = 0.0
    rested_s: float = 0.0
    hold_may_shrink: bool = False
    kept: tuple[str, ...] = ()
    """Joints of the keyframe that keep their time: they are there at `authored_s`."""
    is_kept: bool = False
    """All joints of the keyframe keep their time."""
    is_exact: bool = False
    weight: float = 1.0
    place: str = ""
    """Name of the file and line of the keyframe, such as `wave.yaml:6`; empty if not known."""
    beyond_deg: Mapping[str, float] = {}
    """How far joints go beyond this key and those around it, by the slope that the author gives."""

    def later(self, by_s: float) -> Mark:
        """Return the mark with both times moved by `by_s`."""
        authored_s = None if self.authored_s is None else self.authored_s + by_s
        return replace(self, planned_s=self.planned_s + by_s, authored_s=authored_s)


class Smoothing(Struct, frozen=True, kw_only=True):
    """How the acceleration of a joint is kept from jumping, and what that costs."""

    joint: str
    window_s: float
    """Time over which the motion is averaged."""
    jerk_max_deg_s3: float
    """Limit of the jerk; 0: the joint has none, but moves with others that have one."""
    by_s: float
    """How much longer the first pass of the track takes than without."""
    key_error_deg: float
    """Largest distance of the joint from a key when that is reached."""
    away_deg: float | None
    """Largest distance from the motion without smoothing; None if that takes another time."""


class Pass(Protocol):
    """The motion of all joints from 0 s to `duration_s`; all times count from its start."""

    @property
    def duration_s(self) -> float: ...

    @property
    def knots_s(self) -> FloatArray:
        """The instants between which every joint follows one polynomial, ends included."""
        ...

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        """The trajectories that it is made of; no two move the same joint at the same instant."""
        ...

    @property
    def seams_s(self) -> FloatArray:
        """The instants at which one part follows another."""
        ...

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        """Return deg, deg/s or deg/s² for order 0, 1, 2, (n, joints).

        Outside of the pass the angle is that of the nearer end, and nothing moves.
        """
        ...


class WaitPoint(Struct, frozen=True, kw_only=True):
    """An instant at which every joint rests and the show waits before it goes on.

    With idle motion (`back_s` above 0) the show does not stand: it waits from `back_s` before that
    instant on, where every joint rests at the same angle, and goes back there until it is over.
    """

    at_s: float
    wait: Wait
    back_s: float = 0.0


class Summand(Struct, frozen=True, kw_only=True):
    """A trajectory that a show with layers is the sum of, from `from_s` to `to_s`.

    All times are those before the sum is slowed.
    """

    trajectory: Trajectory
    from_s: float
    to_s: float


class Trajectory(Struct, frozen=True, kw_only=True):
    """All passes of a sequence, from rest to rest, within the limits of the robot.

    `first` is the pass that starts from rest, `last` the one that ends at rest and `middle` every
    pass between them; where all joints rest between passes, the three are the same object, and
    so they are when there is only one pass. `is_periodic`: the passes join in motion, with equal
    velocity at the seam. `marks` are those of the first pass. `stretched` covers the first pass
    and, where passes differ, one middle and the last pass after it, in show time.
    """

    name: str
    joints: tuple[str, ...]
    """The order of the columns: that of the robot, only joints that the sequence keys."""
    first: Pass
    middle: Pass
    last: Pass
    loop: int | None = 1
    """Number of passes; None: without end, and then `last` is never reached."""
    is_periodic: bool = False
    stretched: tuple[SlowSpan, ...] = ()
    given_up: tuple[GivenUp, ...] = ()
    """Where joints that keep their time give up angle; it covers the same passes as `stretched`."""
    asked: tuple[AskedSpan, ...] = ()
    """What the author asks for in these spans, for a picture."""
    commands: tuple[CommandedMove, ...] = ()
    """Moves whose commands the author gives (`ease: command`), of a show that is played once."""
    marks: tuple[Mark, ...] = ()
    cues: tuple[Cue, ...] = ()
    summands: tuple[Summand, ...] = ()
    """Of a show with layers: the show itself and each of its layers."""
    smoothing: tuple[Smoothing, ...] = ()
    """The joints whose acceleration does not jump; the verifier checks their jerk."""
    waits: tuple[WaitPoint, ...] = ()
    """Waits of the first pass. Like `cues`, at planned times."""
    on_fault: Escalations = field(default_factory=dict)
    """Reactions to faults that differ from those of the robot file."""

    def __repr__(self) -> str:
        """Return one line: name, duration and counts."""
        duration = duration_text(self.duration_s)
        counts = f"{counted(self.joints, 'joint')}, {counted(self.marks, 'keyframe')}"
        return f"Trajectory({self.name!r}, {duration}, {counts})"

    @property
    def duration_s(self) -> float:
        """Duration of all passes; `math.inf` for a loop that never ends."""
        return math.inf if self.loop is None else self.pass_start_s(self.loop)

    def motion_of(self, index: int) -> Pass:
        """Return the motion of pass `index`, counted from 0."""
        if index == 0:
            return self.first
        return self.last if self.loop is not None and index == self.loop - 1 else self.middle

    def pass_start_s(self, index: int) -> float:
        """Return when pass `index` starts; `index == loop` gives the end of the show."""
        if index == 0:
            return 0.0
        if self.loop is not None and index >= self.loop > 1:
            middles = self.loop - 2
            return self.first.duration_s + middles * self.middle.duration_s + self.last.duration_s
        return self.first.duration_s + (index - 1) * self.middle.duration_s

    def knots_until(self, end_s: float) -> FloatArray:
        """Return the knots of all passes that begin before `end_s`, in show time."""
        found = [self.first.knots_s]
        index = 1
        while (self.loop is None or index < self.loop) and self.pass_start_s(index) < end_s:
            found.append(self.pass_start_s(index) + self.motion_of(index).knots_s)
            index += 1
        return np.concatenate(found)

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        """Return deg, deg/s or deg/s² for order 0, 1, 2, (n, joints), over all passes.

        `times_s` is anything that is one number or a row of them; one number gives one row. Outside
        of the show the angle is that of the nearer end, and nothing moves. Raises `InputError` for
        what is no number, and for another order.
        """
        try:
            times_s = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
        except (TypeError, ValueError):
            raise InputError(
                f"times_s is {times_s!r:.60}; it must be numbers, in seconds"
            ) from None
        if order not in {0, 1, 2}:
            raise InputError(f"order is {order!r:.60}; it must be 0, 1 or 2")
        if times_s.ndim != 1 or np.isnan(times_s).any():
            raise InputError("times_s must be one row of numbers, none of them NaN")
        passes = self._passes_of(times_s)
        found = distinct(passes).tolist()
        if len(found) == 1:  # The usual case; selecting rows would double the time.
            values = self._sample_pass(found[0], times_s, order)
        else:
            values = np.empty((len(times_s), len(self.joints)))
            for index in found:
                chosen = passes == index
                values[chosen] = self._sample_pass(index, times_s[chosen], order)
        if order > 0:
            values[(times_s < 0.0) | (times_s > self.duration_s)] = 0.0
        return values

    def _sample_pass(self, index: int, times_s: FloatArray, order: int) -> FloatArray:
        motion = self.motion_of(index)
        local_s = np.clip(times_s - self.pass_start_s(index), 0.0, motion.duration_s)
        return motion.sample(local_s, order)

    def _passes_of(self, times_s: FloatArray) -> NDArray[np.intp]:
        """Return the pass of every instant; a seam belongs to the pass that it starts."""
        later_s = times_s - self.first.duration_s
        period_s = self.middle.duration_s
        if period_s == 0.0:
            return np.zeros(len(times_s), dtype=np.intp)
        passes = np.where(later_s < 0.0, 0, 1 + np.floor(later_s / period_s)).astype(np.intp)
        return passes if self.loop is None else np.minimum(passes, self.loop - 1)


class PathMotion(Struct, frozen=True, kw_only=True):
    """One pass of a single track: a path and the clock that follows it."""

    path: Path
    clock: PathClock

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        return ()

    @property
    def seams_s(self) -> FloatArray:
        return np.zeros(0)

    @property
    def duration_s(self) -> float:
        return self.clock.duration_s

    @property
    def knots_s(self) -> FloatArray:
        """The instants between which every joint follows one polynomial, ends included."""
        inner_s = self.clock.times_of(self.path.knots_s - self.path.knots_s[0])
        return distinct(np.concatenate([self.clock.times_s, inner_s]))

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        """Return deg, deg/s or deg/s² for order 0, 1, 2, (n, joints).

        Outside of the pass the angle is that of the nearer end, and nothing moves.
        """
        times_s = np.asarray(times_s, dtype=np.float64)
        inside_s = np.clip(times_s, 0.0, self.duration_s)
        offset_s, rates, slopes = self.clock.positions(inside_s)
        path_s = offset_s + self.path.knots_s[0]
        if order == 0:
            return self.path.evaluate(path_s)
        first, second = self.path.slopes(path_s)
        match order:
            case 1:
                value = first * rates[:, None]
            case 2:
                value = second * (rates**2)[:, None]
                value += first * slopes[:, None]
            case _:
                raise ValueError(f"order {order} is not 0, 1 or 2")
        value[(times_s < 0.0) | (times_s > self.duration_s)] = 0.0
        return value


def motions_of(trajectory: Trajectory) -> tuple[PathMotion, PathMotion, PathMotion]:
    """Return first, middle and last pass of a trajectory of a single track (no parts)."""
    first, middle, last = trajectory.first, trajectory.middle, trajectory.last
    assert isinstance(first, PathMotion), "made of parts"
    assert isinstance(middle, PathMotion), "made of parts"
    assert isinstance(last, PathMotion), "made of parts"
    return first, middle, last


class PathClock(Struct, frozen=True, kw_only=True):
    """Path position over time, piecewise parabolas. Piece i starts at `times_s[i]`, `path_s[i]`.

    `rates[i]` is the rate at its start (1: one path second a second), `rate_slopes[i]` the
    derivative of the rate. `times_s` and `path_s` have one entry more: the end. Rates may jump
    where every joint rests.
    """

    times_s: FloatArray
    path_s: FloatArray
    rates: FloatArray
    rate_slopes: FloatArray

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    def positions(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return path position, rate and slope of the rate at times within the duration."""
        pieces = np.searchsorted(self.times_s, times_s, side="right") - 1
        pieces = np.clip(pieces, 0, len(self.rates) - 1)
        local_s = times_s - self.times_s[pieces]
        rates, slopes = self.rates[pieces], self.rate_slopes[pieces]
        path_s = self.path_s[pieces] + local_s * (rates + 0.5 * slopes * local_s)
        # Rounding must not move a position into the next cubic, which is a different curve.
        path_s = np.minimum(path_s, self.path_s[pieces + 1])
        return path_s, rates + slopes * local_s, slopes

    def times_of(self, path_s: FloatArray) -> FloatArray:
        """Return when each path position is first reached."""
        pieces = np.searchsorted(self.path_s[1:], path_s, side="left")
        pieces = np.clip(pieces, 0, len(self.rates) - 1)
        distance_s = path_s - self.path_s[pieces]
        rates = self.rates[pieces]
        end_rates = np.sqrt(np.maximum(rates**2 + 2.0 * self.rate_slopes[pieces] * distance_s, 0.0))
        mean_rates = 0.5 * (rates + end_rates)
        is_moving = (mean_rates > 0.0) & (distance_s > 0.0)
        spent_s = np.where(is_moving, distance_s / np.where(is_moving, mean_rates, 1.0), 0.0)
        return np.minimum(self.times_s[pieces] + spent_s, self.times_s[pieces + 1])

    def cut(self, from_s: float, to_s: float) -> PathClock:
        """Return the part between two path positions that are boundaries, starting at 0 and 0."""
        first = int(np.argmin(np.abs(self.path_s[:-1] - from_s)))
        last = len(self.path_s) - 1 - int(np.argmin(np.abs(self.path_s[:0:-1] - to_s)))
        return PathClock(
            times_s=self.times_s[first : last + 1] - self.times_s[first],
            path_s=self.path_s[first : last + 1] - self.path_s[first],
            rates=self.rates[first:last],
            rate_slopes=self.rate_slopes[first:last],
        )


def steady_clock(length_s: float) -> PathClock:
    """Return the clock that follows a path of that length at rate 1."""
    return PathClock(
        times_s=np.array([0.0, length_s]),
        path_s=np.array([0.0, length_s]),
        rates=np.ones(1),
        rate_slopes=np.zeros(1),
    )


class LoopedSpan(Struct, frozen=True, kw_only=True):
    """A pass that is a part of the only pass of `whole`; joints may move at its ends."""

    whole: Trajectory
    from_s: float
    to_s: float

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        return (self.whole,)

    @property
    def seams_s(self) -> FloatArray:
        return np.zeros(0)

    @property
    def duration_s(self) -> float:
        return self.to_s - self.from_s

    @property
    def knots_s(self) -> FloatArray:
        knots_s = self.whole.first.knots_s
        inner_s = knots_s[(knots_s > self.from_s) & (knots_s < self.to_s)]
        return np.concatenate([[0.0], inner_s - self.from_s, [self.duration_s]])

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        """Return deg, deg/s or deg/s² for order 0, 1, 2, (n, joints); see `Pass`."""
        times_s = np.asarray(times_s, dtype=np.float64)
        inside_s = np.clip(times_s, 0.0, self.duration_s)
        values = self.whole.sample(self.from_s + inside_s, order)
        if order > 0:
            values[(times_s < 0.0) | (times_s > self.duration_s)] = 0.0
        return values


def with_looped_span(sequence: Sequence, whole: Trajectory) -> Trajectory:
    """Return `whole`, one pass of all keyframes of `sequence`, with its `loop_span_s` looped.

    Raises `InputError` if angle or speed of a joint differ between both ends of the span.
    """
    assert sequence.loop_span_s is not None
    authored_s = np.array([0.0, *(mark.authored_s or 0.0 for mark in whole.marks)])
    planned_s = np.array([0.0, *(mark.planned_s for mark in whole.marks)])
    from_s, to_s = np.interp(sequence.loop_span_s, authored_s, planned_s).tolist()
    if not from_s < to_s:
        reason = f"the part that is looped lies after the end, at {whole.duration_s:.3f} s"
        raise InputError(reason, path=sequence.path)
    return with_span(sequence, whole, (from_s, to_s), sequence.loop)


def with_span(
    sequence: Sequence, whole: Trajectory, span_s: tuple[float, float], loop: int | None
) -> Trajectory:
    """Return `whole`, a single pass, with the span from `span_s[0]` to `span_s[1]` looped.

    Raises `InputError` if angle or speed of a joint differ between both ends of the span.
    """
    from_s, to_s = span_s
    _check_seam(sequence, whole, from_s, to_s)
    if loop == 1:
        return whole
    skipped_s = 0.0 if loop is None else (loop - 1) * (to_s - from_s)
    return replace(
        whole,
        first=LoopedSpan(whole=whole, from_s=0.0, to_s=to_s),
        middle=LoopedSpan(whole=whole, from_s=from_s, to_s=to_s),
        last=LoopedSpan(whole=whole, from_s=from_s, to_s=whole.duration_s),
        loop=loop,
        is_periodic=True,
        marks=tuple(
            replace(mark, planned_s=mark.planned_s + (skipped_s if mark.planned_s > to_s else 0.0))
            for mark in whole.marks
            if mark.planned_s <= to_s or loop is not None
        ),
    )


def _check_seam(sequence: Sequence, whole: Trajectory, from_s: float, to_s: float) -> None:
    ends_s = np.array([from_s, to_s])
    for order, allowed, unit in ((0, SEAM_DEG, "deg"), (1, SEAM_DEG_S, "deg/s")):
        first, last = whole.sample(ends_s, order)
        worst = int(np.argmax(np.abs(last - first)))
        if abs(last[worst] - first[worst]) > allowed:
            raise InputError(
                f"the part that is looped must end as it begins, but joint "
                f"{whole.joints[worst]!r} is at {first[worst]:.3f} {unit} at its beginning and at "
                f"{last[worst]:.3f} {unit} at its end",
                path=sequence.path,
            )
