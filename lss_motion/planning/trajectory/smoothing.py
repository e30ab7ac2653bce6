"""Motion whose acceleration does not jump: the plan of a track, smoothed within all limits.

A plan within speed and acceleration limits has jumps of the acceleration: at keys, and where a
limit begins to bind. Here each joint is averaged over a window and becomes a uniform cubic B-spline
whose control points are these averages. Both are weighted means of the plan at nearby instants, so
speed and acceleration stay within their limits, the angle within what the plan reaches nearby, and
the jerk is at most twice the acceleration limit over the window, whatever the plan is.

An average would shorten rests and cut corners. The track is therefore planned again with rests that
are longer by what the average takes from them, and with keys that are shifted by what it takes from
each, until the smoothed motion is where the author wants it (`keys.Margins`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.curves import Path, out_of_range, peaks
from lss_motion.planning.trajectory.keys import Margins, is_timed, keys_by_joint, rests_at
from lss_motion.planning.trajectory.model import (
    PathClock,
    PathMotion,
    SlowSpan,
    Smoothing,
    Trajectory,
    motions_of,
    steady_clock,
)
from lss_motion.planning.trajectory.retime import FIT_TOLERANCE_S, laid_out, scaled
from lss_motion.planning.trajectory.servo_rows import with_servo_room
from lss_motion.planning.trajectory.tracks import planned_layout, planned_track, verified
from lss_motion.planning.trajectory.verify import RANGE_SLACK_DEG
from lss_motion.show.model import Timing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.solver import RateTask
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence as Show

    FloatArray = NDArray[np.float64]
    Limit = Literal["speed", "acceleration", "jerk"]
    _Place = tuple[str, int]
    """A joint and its keyframe."""

WINDOW_MIN_S: Final = 0.04
"""Shortest window. Chosen: a shorter one needs more polynomials and cannot be seen."""

STEPS_PER_WINDOW: Final = 8
"""Knots of the B-spline in the shortest window. Its own rounding then takes a tenth of what the
window takes (the squares of both widths count)."""

STEP_MAX_S: Final = 0.02
"""Longest distance of knots, so that a slow window does not hide what lies between them."""

ROUNDS_MAX: Final = 12
"""Plans of a track until keys and jerk are right. Measured: three or four."""

ACCEL_SHARES: Final = (0.5, 0.25, 0.125)
"""Shares of the acceleration limit that are tried where smoothing makes a track longer, until it
is no shorter. Measured for single moves against the least duration with a jerk limit: 2 deg at 2000
deg/s³ 2.2 times as long without, 1.4 times with it."""

KEY_ERROR_DEG: Final = 0.002
"""Keys this close are met. Chosen: a fiftieth of the unit of most servos."""

EDGE_DEG: Final = 0.5
"""A key so close to the end of its range is at the end: a smoothed turn that lies beside its key
goes beyond it by less (measured: 0.04 deg)."""

TURN_STEP_S: Final = 0.001
"""Turns are searched in steps of this: at 1000 deg/s² the error is 0.0001 deg."""

STOP_RATIO: Final = 0.7
"""If a round leaves more than this of the error of a key, the joint stops there instead."""

JERK_MARGIN: Final = 1.01
"""A window that is too short becomes longer by this more than needed, and by as much more again in
each round, so that few rounds do."""

JERK_SLACK: Final = 1.0 - 1e-3
"""Share of the jerk limit that is used, so that the rounding of the verifier's differences fits."""

CAP_SLACK: Final = 0.995
"""No window is longer than keeps this share of the jerk limit whatever the plan is: the plan may
exceed the acceleration limit by 0.1 %."""

KNOTS_MAX: Final = 400_000
"""Knots of a smoothed track. Chosen: an hour with windows of 0.1 s, 250 MB with 18 joints."""

LIMIT_SHARE: Final = 1.0 + 1e-4
EVEN_JERK_SHARE: Final = 0.99
"""Shares of the limits that a sum of smoothed motions may use; differences of angles add rounding
to the jerk."""

SLOWEST_RATIO: Final = 2.0
"""A show with layers is not slowed by more. Chosen: it would no longer be the author's."""

JUMP_STEP_S: Final = 0.001
BLOCK: Final = 8192
"""Sampling of jumps, as in `verify`."""

ANGLE_DECIMALS: Final = 10
"""Control points are rounded to this, so that a rest is a rest."""


def smooth_track(sequence: Show, robot: Robot) -> Trajectory:
    """Return the verified plan of the keyframes of `sequence`, smoothed where that is wanted.

    Joints with `jerk_max_deg_s3` get the shortest window that keeps it. With `smooth_s` every
    joint of the track has at least this window.
    """
    plain = planned_track(sequence, robot)
    jerk_max = jerk_limits(sequence, robot, plain.joints)
    if not np.isfinite(jerk_max).any():
        return plain
    roomy = with_servo_room(robot)
    best = _attempt(sequence, roomy, plain, jerk_max)
    for share in ACCEL_SHARES:
        slower_s = math.inf if isinstance(best, PlanningError) else best.smoothing[0].by_s
        if slower_s <= FIT_TOLERANCE_S:
            break
        found = _attempt(sequence, _gentler(roomy, share), plain, jerk_max)
        if isinstance(found, PlanningError) or found.smoothing[0].by_s >= slower_s:
            break
        best = found
    if isinstance(best, PlanningError):
        raise best
    return verified(best, sequence, robot)


def _attempt(
    sequence: Show, robot: Robot, plain: Trajectory, jerk_max: FloatArray
) -> Trajectory | PlanningError:
    """Return the smoothed plan, not yet verified, or why there is none."""
    try:
        try:
            return _Rounds(sequence, robot, plain, jerk_max).smoothed()
        except _SeamError:
            # The passes of a loop are not of equal length, or differ at their seams.
            return _Rounds(sequence, robot, plain, jerk_max, may_flow=False).smoothed()
    except PlanningError as error:
        return error


def _gentler(robot: Robot, share: float) -> Robot:
    """Return the robot with less acceleration of joints with a jerk limit.

    A short move never reaches the whole acceleration within that limit, and is done sooner if it
    is planned with less and averaged over a shorter window.
    """
    return replace(
        robot,
        joints={
            name: replace(joint, accel_max_deg_s2=share * joint.accel_max_deg_s2)
            if math.isfinite(joint.jerk_max_deg_s3)
            else joint
            for name, joint in robot.joints.items()
        },
    )


def jerk_limits(sequence: Show, robot: Robot, joints: tuple[str, ...]) -> FloatArray:
    """Return the largest jerk of each joint; infinite where the acceleration may jump."""
    own = np.array([robot.joints[name].jerk_max_deg_s3 for name in joints])
    if sequence.smooth_s > 0.0:
        accel_max = np.array([robot.joints[name].accel_max_deg_s2 for name in joints])
        own = np.minimum(own, 2.0 * accel_max / sequence.smooth_s)
    return own


class _SeamError(Exception):
    """The passes of a loop cannot be smoothed across their seams."""


@dataclass(slots=True)
class _SmoothedPlan:
    """A smoothed plan, with the largest jerk of each joint and the errors of each passed key.

    `aside_s` has how much later than its key a joint turns at the end of its range, in path
    seconds, `off_deg` how far it then is from the key when that is reached, `out_deg` how far
    joints are out of their ranges near keys.
    """

    trajectory: Trajectory
    jerk: FloatArray
    errors_deg: dict[_Place, float]
    aside_s: dict[_Place, float]
    off_deg: dict[_Place, float]
    out_deg: dict[_Place, float]

    def is_right(self) -> bool:
        """Return whether all keys are met, and no joint leaves its range near one."""
        return (
            max(map(abs, self.errors_deg.values()), default=0.0) <= 0.5 * KEY_ERROR_DEG
            and max(self.off_deg.values(), default=0.0) <= KEY_ERROR_DEG
            and max(self.out_deg.values(), default=0.0) <= RANGE_SLACK_DEG
        )


class _Rounds:
    """Plans a track again and again until its smoothed motion meets keys and jerk limits."""

    def __init__(
        self,
        sequence: Show,
        robot: Robot,
        plain: Trajectory,
        jerk_max: FloatArray,
        *,
        may_flow: bool = True,
    ) -> None:
        self.sequence, self.robot, self.plain, self.jerk_max = sequence, robot, plain, jerk_max
        self.may_flow = may_flow
        self.timed = _timed(sequence, plain)
        self.accel_max = np.array([robot.joints[n].accel_max_deg_s2 for n in plain.joints])
        self.speed_max = np.array([robot.joints[n].speed_max_deg_s for n in plain.joints])
        self.windows_s = self._first_windows_s()
        self.more = 1.0
        self.shifts_deg: dict[_Place, float] = {}
        self.delays_s: dict[_Place, float] = {}
        self.stops: set[_Place] = set()
        self.passed = _passed_keys(self.timed, robot)

    def smoothed(self) -> Trajectory:
        """Return the plan; raises `PlanningError` where it misses an anchor or a duration."""
        before: _SmoothedPlan | None = None
        found = self._planned()
        for _ in range(ROUNDS_MAX):
            is_over = found.jerk > self.jerk_max
            if found.is_right() and not is_over.any():
                break
            if is_over.any():
                self._lengthen(is_over, found.jerk)
                before = None  # With other windows errors cannot be compared.
            else:
                self._stop(found, before)
                before = found
            for corrections, errors in (
                (self.shifts_deg, found.errors_deg),
                (self.delays_s, found.aside_s),
            ):
                for key in errors.keys() - self.stops:
                    corrections[key] = corrections.get(key, 0.0) - errors[key]
            found = self._planned()
        trajectory = self._explained(found)
        if self.sequence.timing is Timing.FIT:
            _check_fit(self.sequence, trajectory)
        return trajectory

    def _first_windows_s(self) -> FloatArray:
        """Return windows that spread each joint's largest jump of the acceleration enough."""
        jumps = _accel_jumps(self.plain)
        needed_s = np.where(np.isfinite(self.jerk_max), jumps / (JERK_SLACK * self.jerk_max), 0.0)
        needed_s = np.where(np.isfinite(self.jerk_max), np.maximum(needed_s, WINDOW_MIN_S), 0.0)
        return self._joined(np.maximum(needed_s, self.sequence.smooth_s))

    def _joined(self, windows_s: FloatArray) -> FloatArray:
        """Return the windows, equal where joints move along a straight line together."""
        windows_s = np.minimum(
            windows_s, np.maximum(2.0 * self.accel_max / (CAP_SLACK * self.jerk_max), WINDOW_MIN_S)
        )
        windows_s = np.maximum(windows_s, self.sequence.smooth_s)
        if any(frame.ease == "linear" for frame in self.sequence.keyframes):
            return np.full(len(windows_s), windows_s.max())
        return windows_s

    def _lengthen(self, is_over: NDArray[np.bool_], jerk: FloatArray) -> None:
        self.more *= JERK_MARGIN
        ratios = np.where(is_over, self.more * jerk / self.jerk_max, 1.0)
        self.windows_s = self._joined(self.windows_s * ratios)

    def _stop(self, found: _SmoothedPlan, before: _SmoothedPlan | None) -> None:
        """Let joints rest at keys that no shift brings nearer: they are too close together."""
        for what, least_deg in (
            ("errors_deg", KEY_ERROR_DEG),
            ("off_deg", KEY_ERROR_DEG),
            ("out_deg", RANGE_SLACK_DEG),
        ):
            then_deg = {} if before is None else getattr(before, what)
            for key, error_deg in getattr(found, what).items():
                limit_deg = STOP_RATIO * abs(then_deg.get(key, math.inf))
                if abs(error_deg) > max(least_deg, limit_deg):
                    self.stops.add(key)
                    self.shifts_deg.pop(key, None)
                    self.delays_s.pop(key, None)
        for name, own in self.passed.items():
            self.passed[name] = [key for key in own if (name, key.index) not in self.stops]

    def _step_s(self) -> float:
        """Return the longest distance of knots."""
        return min(float(self.windows_s[self.windows_s > 0.0].min()) / STEPS_PER_WINDOW, STEP_MAX_S)

    def _planned(self) -> _SmoothedPlan:
        """Return the plan with the present windows and shifts, smoothed."""
        step_s = self._step_s()
        half_s = dict(
            zip(self.plain.joints, (0.5 * self.windows_s + 2.0 * step_s).tolist(), strict=True)
        )
        margins = Margins(half_s, self.shifts_deg, frozenset(self.stops), self.delays_s)
        try:
            base = planned_layout(laid_out(self.timed, self.robot, margins, may_flow=self.may_flow))
        except PlanningError as error:
            error.reason += (
                ". That is because of smooth_s or jerk_max_deg_s3: without, the motion is possible"
            )
            error.args = (error.reason,)
            raise
        if base.middle.duration_s / step_s > KNOTS_MAX:
            raise PlanningError(
                f"smoothing needs more than {KNOTS_MAX:,} polynomials; use a longer smooth_s or "
                "smaller jerk_max_deg_s3, or divide the keyframes into a play list"
            )
        trajectory = smoothed(base, self.windows_s, step_s)
        jerk = np.max(
            [
                np.abs(6.0 * motion.path.coefficients[:, 3]).max(axis=0)
                for motion in motions_of(trajectory)
            ],
            axis=0,
        )
        found = _SmoothedPlan(trajectory, jerk / JERK_SLACK, {}, {}, {}, {})
        self._measure_keys(found, motions_of(base)[0].clock)
        return found

    def _measure_keys(self, found: _SmoothedPlan, clock: PathClock) -> None:
        """Measure the errors of all keys that are passed in motion.

        Where the joint turns at the end of its range that of the angle is that of the turn, which
        may lie beside the key, and the aim is slightly inside: the turn must not be out of range.
        """
        trajectory = found.trajectory
        for column, name in enumerate(trajectory.joints):
            own = self.passed[name]
            at_s = np.array([trajectory.marks[key.index].planned_s for key in own])
            # The spline rounds each turn, also that of a joint without a window.
            reach_s = 0.5 * self.windows_s[column] + 2.0 * self._step_s()
            count = math.ceil(reach_s / TURN_STEP_S)
            around_s = TURN_STEP_S * np.arange(-count, count + 1)
            near_s = (at_s[:, None] + around_s).ravel()
            near_deg = trajectory.sample(near_s)[:, column].reshape(-1, len(around_s))
            joint = self.robot.joints[name]
            range_deg = (joint.position_min_deg, joint.position_max_deg)
            outside = out_of_range(motions_of(trajectory)[0].path, column, range_deg)
            for knot_s, out_deg in outside if own else ():
                place = name, own[int(np.abs(at_s - knot_s).argmin())].index
                found.out_deg[place] = max(found.out_deg.get(place, 0.0), out_deg)
            rates = clock.positions(at_s)[1]
            for k, key in enumerate(own):
                place, deg = (name, key.index), float(near_deg[k, count])
                found.errors_deg[place] = deg - key.deg
                if key.turn:
                    turn = int((key.turn * near_deg[k]).argmax())
                    turn_deg = float(near_deg[k, turn])
                    found.errors_deg[place] = turn_deg - key.deg + 0.5 * key.turn * KEY_ERROR_DEG
                    found.aside_s[place] = float(around_s[turn] * rates[k])
                    found.off_deg[place] = abs(turn_deg - deg)

    def _explained(self, found: _SmoothedPlan) -> Trajectory:
        """Return the plan with what smoothing cost, and without times that are not the author's."""
        plain, trajectory = self.plain, found.trajectory
        errors_deg = dict.fromkeys(plain.joints, 0.0)
        at_s = np.array([mark.planned_s for mark in trajectory.marks])
        reached_deg = trajectory.sample(at_s)
        for column, name in enumerate(trajectory.joints):
            own = keys_by_joint(self.timed, self.robot)[name]
            off_deg = [abs(float(reached_deg[key.index, column]) - key.deg) for key in own]
            errors_deg[name] = max(off_deg)
        by_s = trajectory.first.duration_s - plain.first.duration_s
        away_deg = _away_deg(plain, trajectory) if abs(by_s) < FIT_TOLERANCE_S else None
        given = np.where(np.isfinite(self.jerk_max), self.jerk_max, 0.0).tolist()
        smoothing = tuple(
            Smoothing(
                joint=name,
                window_s=window_s,
                jerk_max_deg_s3=given[column],
                by_s=by_s,
                key_error_deg=errors_deg[name],
                away_deg=None if away_deg is None else float(away_deg[column]),
            )
            for column, (name, window_s) in enumerate(
                zip(plain.joints, self.windows_s.tolist(), strict=True)
            )
        )
        stretched, marks = trajectory.stretched, trajectory.marks
        if not is_timed(self.sequence):
            stretched = ()
            marks = tuple(replace(mark, authored_s=None) for mark in marks)
        return replace(trajectory, smoothing=smoothing, stretched=stretched, marks=marks)


def _timed(sequence: Show, plain: Trajectory) -> Show:
    """Return the sequence with a time for each keyframe, planned again as the author's.

    Where the author gives none, these are the times of the plan that is not smoothed.
    """
    if sequence.timing is Timing.FIT and is_timed(sequence):
        sequence = scaled(sequence, sequence.fit_duration_s or 0.0)
    elif not is_timed(sequence):
        frames = tuple(
            replace(frame, at_s=mark.planned_s)
            for frame, mark in zip(sequence.keyframes, plain.marks, strict=True)
        )
        sequence = replace(sequence, keyframes=frames)
    return replace(sequence, timing=Timing.AUTHORED, fit_duration_s=None)


def _check_fit(sequence: Show, trajectory: Trajectory) -> None:
    wanted_s = sequence.fit_duration_s or 0.0
    late_s = trajectory.middle.duration_s - wanted_s
    if late_s > FIT_TOLERANCE_S:
        raise PlanningError(
            f"one pass cannot be done in {wanted_s:g} s with an acceleration that does not jump: "
            f"it takes {late_s:.3f} s more. Use a longer duration_s, a shorter smooth_s, or a "
            "larger jerk_max_deg_s3"
        )


class _PassedKey(Struct, frozen=True):
    """A key that is passed in motion.

    `turn` is 1 where the joint turns at the upper end of its range, -1 at the lower end, else 0.
    """

    index: int
    deg: float
    turn: int


def _passed_keys(sequence: Show, robot: Robot) -> dict[str, list[_PassedKey]]:
    """Return the keys of each joint that are passed in motion, but for the ends of a pass."""
    found = {}
    for name, every in keys_by_joint(sequence, robot).items():
        left_s = [-1.0, *((sequence.keyframes[k.index].at_s or 0.0) + k.hold_s for k in every)]
        # Keys at one instant, or under a hold, are one; as in `curves.joint_keys`.
        own = [
            key
            for key, before_s in zip(every, itertools.accumulate(left_s, max), strict=False)
            if (sequence.keyframes[key.index].at_s or 0.0) > before_s
        ]
        deg = np.array([key.deg for key in own])
        is_held = np.array([key.hold_s > 0.0 for key in own])
        slopes = np.array([key.slope_deg_s for key in own])
        is_rest = rests_at(deg, is_held, tuple(key.ease for key in own), slopes)
        signs = np.sign(np.diff(deg))
        turns = np.zeros(len(own), dtype=np.int64)
        turns[1:-1] = (signs[:-1] - signs[1:]) / 2
        joint = robot.joints[name]
        turns[(turns > 0) & (deg < joint.position_max_deg - EDGE_DEG)] = 0
        turns[(turns < 0) & (deg > joint.position_min_deg + EDGE_DEG)] = 0
        found[name] = [
            _PassedKey(key.index, key.deg, int(turns[k]))
            for k, key in enumerate(own)
            if not is_rest[k]
        ]
    return found


def _accel_jumps(trajectory: Trajectory) -> FloatArray:
    """Return the largest jump of each joint's acceleration, at any knot and at both ends."""
    largest = np.zeros(len(trajectory.joints))
    for motion in {id(motion): motion for motion in motions_of(trajectory)}.values():
        knots_s = motion.knots_s
        steps_s = np.minimum(np.diff(knots_s), 1e-3)
        after = motion.sample(knots_s[:-1] + 1e-3 * steps_s, 2)
        before = motion.sample(knots_s[1:] - 1e-3 * steps_s, 2)
        still = np.zeros((1, after.shape[1]))
        jumps = np.abs(np.concatenate([after, still]) - np.concatenate([still, before]))
        largest = np.maximum(largest, jumps.max(axis=0))
    return largest


def smoothed(base: Trajectory, windows_s: FloatArray, step_s: float) -> Trajectory:
    """Return a plan of a single track, averaged over the window of each joint, as a B-spline.

    It must rest for half a window and two steps at both ends. Raises `_SeamError` for a loop in
    motion whose passes have no common step.
    """
    first, middle, last = motions_of(base)
    count = math.ceil(middle.duration_s / step_s)
    if count == 0:
        return base
    step_s = middle.duration_s / count
    made: dict[int, PathMotion] = {}
    for motion in (first, middle, last):
        steps = round(motion.duration_s / step_s)
        if abs(steps * step_s - motion.duration_s) > 1e-9 * max(1.0, motion.duration_s):
            raise _SeamError
        if id(motion) not in made:
            before = middle if base.is_periodic and motion is not first else None
            after = middle if base.is_periodic and motion is not last else None
            if base.is_periodic and base.loop == 2:
                before, after = (None, last) if motion is first else (first, None)
            path = _spline_of(_Extended(before, motion, after), windows_s, steps, step_s)
            made[id(motion)] = PathMotion(path=path, clock=steady_clock(path.length_s))
    result = replace(base, first=made[id(first)], middle=made[id(middle)], last=made[id(last)])
    _check_seams(result)
    return result


class _Extended(Struct, frozen=True):
    """A pass with what comes before and after it: another pass in motion, or rest."""

    before: PathMotion | None
    own: PathMotion
    after: PathMotion | None

    def sample(self, times_s: FloatArray) -> FloatArray:
        """Return the angles at times that may lie before the pass and after it."""
        angles_deg = self.own.sample(times_s)
        if self.before is not None:
            early = times_s < 0.0
            angles_deg[early] = self.before.sample(self.before.duration_s + times_s[early])
        if self.after is not None:
            late = times_s > self.own.duration_s
            angles_deg[late] = self.after.sample(times_s[late] - self.own.duration_s)
        return angles_deg


def _spline_of(motion: _Extended, windows_s: FloatArray, count: int, step_s: float) -> Path:
    """Return the B-spline over `count` steps whose control points are averages of the motion."""
    reach = math.ceil(0.5 * float(windows_s.max()) / step_s + 0.5) + 1
    first = -1 - reach
    times_s = step_s * np.arange(first, count + 2 + reach, dtype=np.float64)
    angles_deg = motion.sample(times_s)
    points_deg = np.empty((count + 3, len(windows_s)))
    for column, window_s in enumerate(windows_s.tolist()):
        weights = _box(window_s / step_s, reach)
        points_deg[:, column] = np.convolve(angles_deg[:, column], weights, mode="valid")
    points_deg = np.round(points_deg, ANGLE_DECIMALS)
    return _bspline(points_deg, step_s)


def _box(width: float, reach: int) -> FloatArray:
    """Return the weights of a window over samples a step apart; `width` is in steps."""
    centres = np.arange(-reach, reach + 1)
    low = np.maximum(centres - 0.5, -0.5 * width)
    high = np.minimum(centres + 0.5, 0.5 * width)
    weights = np.maximum(high - low, 0.0)
    total = float(weights.sum())
    return weights / total if total > 0.0 else np.asarray(centres == 0, dtype=np.float64)


def _bspline(points: FloatArray, step_s: float) -> Path:
    """Return the uniform cubic B-spline over its control points; rests become one segment each."""
    before, start, end, after = points[:-3], points[1:-2], points[2:-1], points[3:]
    is_rest = ((before == start) & (start == end) & (end == after)).all(axis=1)
    coefficients = np.stack(
        [
            (before + 4.0 * start + end) / 6.0,
            (end - before) / (2.0 * step_s),
            (before - 2.0 * start + end) / (2.0 * step_s**2),
            (3.0 * (start - end) + after - before) / (6.0 * step_s**3),
        ],
        axis=1,
    )
    coefficients[is_rest] = 0.0
    coefficients[is_rest, 0] = start[is_rest]
    is_kept = np.append(True, ~(is_rest[1:] & is_rest[:-1]))
    knots_s = step_s * np.arange(len(start) + 1)
    return Path(
        knots_s=np.append(knots_s[:-1][is_kept], knots_s[-1]), coefficients=coefficients[is_kept]
    )


def _check_seams(trajectory: Trajectory) -> None:
    """Raise `_SeamError` if one pass does not continue where another ends."""
    first, middle, last = motions_of(trajectory)
    for before, after in ((first, middle), (middle, middle), (middle, last)):
        if not trajectory.is_periodic or (trajectory.loop == 2 and before is after):
            continue
        for order, slack in ((0, 1e-7), (1, 1e-5), (2, 1e-2)):
            end = before.sample(np.array([before.duration_s]), order)
            start = after.sample(np.zeros(1), order)
            if np.abs(end - start).max() > slack:
                raise _SeamError


def _away_deg(plain: Trajectory, trajectory: Trajectory) -> FloatArray:
    """Return how far each joint is from where it would be without smoothing, at 100 Hz."""
    end_s = trajectory.first.duration_s
    times_s = np.linspace(0.0, end_s, max(2, math.ceil(100.0 * end_s)))
    apart_deg = np.abs(trajectory.first.sample(times_s) - plain.first.sample(times_s))
    return np.asarray(apart_deg.max(axis=0))


def smooth_too(sequence: Show, smooth_s: float) -> Show:
    """Return the sequence with at least that `smooth_s`, its tracks and parts too."""
    if smooth_s <= 0.0:
        return sequence
    return replace(
        sequence,
        smooth_s=max(sequence.smooth_s, smooth_s),
        tracks=tuple(smooth_too(track, smooth_s) for track in sequence.tracks),
        play=tuple(
            step
            if step.sequence is None
            else replace(step, sequence=smooth_too(step.sequence, smooth_s))
            for step in sequence.play
        ),
        layers=tuple(
            replace(layer, sequence=smooth_too(layer.sequence, smooth_s))
            for layer in sequence.layers
        ),
    )


def limited(joints: tuple[str, ...], jerk_max: FloatArray) -> tuple[Smoothing, ...]:
    """Return the jerk limits of a sum of smoothed motions, for the verifier and for people."""
    return tuple(
        Smoothing(
            joint=name,
            window_s=0.0,
            jerk_max_deg_s3=limit,
            by_s=0.0,
            key_error_deg=0.0,
            away_deg=None,
        )
        for name, limit in zip(joints, jerk_max.tolist(), strict=True)
        if math.isfinite(limit)
    )


def even_clock(
    task: RateTask, joints: tuple[str, ...], jerk_max: FloatArray
) -> tuple[PathClock, SlowSpan | None]:
    """Return a clock of one rate that keeps all limits on a path that is smooth itself.

    A rate that changes would make the acceleration jump. Raises `PlanningError` where the rate
    would be below half of the authored one: a fade is too short, or does not exist.
    """
    found = _peaks(task.path)
    limits: tuple[tuple[Limit, FloatArray, float], ...] = (
        ("speed", task.speed_max_deg_s * LIMIT_SHARE, 1.0),
        ("acceleration", task.accel_max_deg_s2 * LIMIT_SHARE, 0.5),
        ("jerk", jerk_max * EVEN_JERK_SHARE, 1.0 / 3.0),
    )
    slowest, column, which = 1.0, 0, 0
    for order, (values, (_, allowed, power)) in enumerate(zip(found, limits, strict=True)):
        ratios = (values / allowed) ** power
        if ratios.max() > slowest:
            slowest, column, which = float(ratios.max()), int(ratios.argmax()), order
    if slowest == 1.0:
        return steady_clock(task.path.length_s), None
    limit = limits[which][0]
    needed, most = float(found[which][column]), float(limits[which][1][column])
    if slowest > SLOWEST_RATIO:
        raise PlanningError(
            f"joint {joints[column]!r} would need {limit} {needed:.0f}, allowed {most:.0f}, in "
            "degrees and seconds",
            joint=joints[column],
        )
    length_s = task.path.length_s
    clock = PathClock(
        times_s=np.array([0.0, slowest * length_s]),
        path_s=np.array([0.0, length_s]),
        rates=np.array([1.0 / slowest]),
        rate_slopes=np.zeros(1),
    )
    span = SlowSpan(
        from_s=0.0,
        to_s=slowest * length_s,
        by_s=(slowest - 1.0) * length_s,
        joint=joints[column],
        limit=limit,
        authored=needed,
        allowed=most,
    )
    return clock, span


def _peaks(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the largest speed, acceleration and jerk of each joint along a path at rate 1.

    The jerk is that of differences over a millisecond, in which a jump of the acceleration shows.
    """
    speed, accel = peaks(path)
    count = math.ceil(path.length_s / JUMP_STEP_S) + 4
    jerk = np.zeros(speed.shape[1])
    for first in range(0, count, BLOCK):
        steps = np.arange(first - 2, min(first + BLOCK, count) + 2)
        at_s = path.knots_s[0] + np.clip(JUMP_STEP_S * steps, 0.0, path.length_s)
        found = np.abs(np.diff(path.evaluate(at_s), n=3, axis=0)).max(axis=0, initial=0.0)
        jerk = np.maximum(jerk, found / JUMP_STEP_S**3)
    return speed.max(axis=0), accel.max(axis=0), jerk
