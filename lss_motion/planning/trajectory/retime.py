"""How fast a path is followed: the layout of a sequence, and the clock that follows its path.

A path whose position is the authored time is followed at rate 1 wherever that breaks no limit. Only
windows around the segments where it does are given to the solver. They are widened until rate 1 is
reached at both of their ends, so that the result is that of solving the whole path.

`Layout` holds the paths of all passes that differ. `authored_clock` and `stopping_clock` turn rates
into a clock. `slowed_to` and `scaled` serve durations that the author gives.

`with_reserve` keeps a part of the acceleration free where a joint would use all of it for long: a
servo whose ramps are no steeper than its plan cannot make up for what its control loop and its line
add to each turn, and its horn falls behind after some seconds. Short motions, and what is feasible
at the times of the author, stay.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.trajectory.braking import hasty_square, square_at
from lss_motion.planning.trajectory.catch_up import LATE_MIN_S, PACE_MAX, made_up
from lss_motion.planning.trajectory.curves import (
    JointKeys,
    Path,
    build_path,
    concatenate,
    joint_keys,
    seam_slope_deg_s,
    with_longer_rests,
)
from lss_motion.planning.trajectory.dues import Dues
from lss_motion.planning.trajectory.keys import (
    NO_MARGINS,
    SAME_INSTANT_S,
    Margins,
    Spacing,
    authored_spacing,
    is_timed,
    keys_by_joint,
    spacing_of,
)
from lss_motion.planning.trajectory.model import PathClock, PathMotion, Trajectory, motions_of
from lss_motion.planning.trajectory.servo_rows import servo_rows
from lss_motion.planning.trajectory.solver import (
    FEASIBLE_RATIO,
    RATE_FREE,
    RATE_SLACK,
    RateTask,
    slow_outline,
    solve,
)
from lss_motion.show.splines import distinct, near_runs, runs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.solver import RateWindow
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence as Show

    FloatArray = NDArray[np.float64]
    BoolArray = NDArray[np.bool_]
    Timed = tuple[list[RateWindow], PathClock]

WINDOW_MIN_S: Final = 0.2
"""Least growth of a window. Chosen: braking from rate 1 takes a few tenths of a second."""

REST_RATIO: Final = 1e-9
"""A path is at rest where its slopes are below this share of the speed limits: rounding."""

FIT_TOLERANCE_S: Final = 0.001
"""A fitted pass is as long as requested, to the millisecond."""


class Layout(Struct, frozen=True, kw_only=True):
    """A checked sequence and the paths of its passes: one, or the two or three that differ."""

    sequence: Show
    robot: Robot
    keys: Mapping[str, JointKeys]
    spacing: Spacing
    paths: tuple[Path, ...]
    is_timed: bool
    margins: Margins = NO_MARGINS

    def authored(self, path_s: FloatArray) -> FloatArray:
        """Return the authored time of positions along all passes."""
        length_s = self.spacing.length_s
        if len(self.paths) == 1 or length_s == 0.0:
            return self.spacing.authored(path_s)
        passes = np.clip(np.floor(path_s / length_s), 0, len(self.paths) - 1)
        period_s = float(self.spacing.authored_s[-1])
        return passes * period_s + self.spacing.authored(path_s - passes * length_s)

    def seams(self) -> tuple[int, ...]:
        """Return the knots of the joined path where one pass ends and the next starts."""
        counts = np.cumsum([len(path.knots_s) - 1 for path in self.paths])
        return tuple(counts[:-1].tolist())

    def dues(self) -> Dues:
        """Return what the author wants along all passes."""
        frames, spacing = self.sequence.keyframes, self.spacing
        starts_s = spacing.length_s * np.arange(len(self.paths))
        keep = np.array([frame.hold_s > 0.0 and not frame.hold_may_shrink for frame in frames])
        own = np.stack([spacing.reached_s, spacing.left_s], axis=1)[keep]
        rests = np.concatenate([np.zeros((0, 2)), *self._longer_rests_s()])
        rests = (starts_s[:, None, None] + rests).reshape(-1, 2)
        is_anchor = np.array([frame.is_anchor for frame in frames])
        anchors_s = (starts_s[:, None] + spacing.reached_s[is_anchor]).ravel()
        if is_anchor.any() and self.sequence.loop != 1:
            # Anchors of the next pass can be met only if this one ends on time.
            anchors_s = np.append(anchors_s, starts_s + spacing.length_s)
        keys_s = np.concatenate([spacing.reached_s, spacing.left_s])
        seams_s = concatenate(self.paths).knots_s[list(self.seams())]
        held = united(np.concatenate([(starts_s[:, None, None] + own).reshape(-1, 2), rests]))
        return Dues(
            authored=self.authored,
            keys_s=distinct(_at_seams((starts_s[:, None] + keys_s).ravel(), seams_s)),
            held=_at_seams(held, seams_s),
            rests=_at_seams(rests, seams_s),
            anchors_s=tuple(distinct(_at_seams(anchors_s, seams_s)).tolist()),
            seams_s=tuple(seams_s.tolist()),
        )

    def _longer_rests_s(self) -> list[FloatArray]:
        """Return what each joint rests more than the author wants: that must not be shortened."""
        found = []
        for name, half_s in self.margins.half_s.items():
            own = self.keys[name]
            more = with_longer_rests(own, half_s)
            found.append(np.stack([own.left_s, more.left_s], axis=1))
            found.append(np.stack([more.reached_s, own.reached_s], axis=1))
        return found

    def task(self, caps: Mapping[int, float]) -> RateTask:
        return rate_task(
            concatenate(self.paths),
            tuple(self.keys),
            self.robot,
            rate_max=1.0 if self.is_timed else RATE_FREE,
            knot_caps=caps,
        )


CELLS_MIN_GEARED: Final = 128
"""Least number of cells of a segment of a robot with mechanisms. Short moves whose limits change on
the way are then up to 2 % slower than on a fine grid, 7 % with 32 (measured: `tests.geared`)."""


def rate_task(path: Path, joints: Sequence[str], robot: Robot, **details: Any) -> RateTask:  # noqa: ANN401
    """Return the task of a path of joints, with the limits of joints and servos."""
    limits = [robot.joints[name] for name in joints]
    rows = servo_rows(joints, robot) if robot.servos else None
    speed = np.array([joint.speed_max_deg_s for joint in limits])
    accel = np.array([joint.accel_max_deg_s2 for joint in limits])
    if rows is not None:
        speed = np.concatenate([speed, rows.speed_max_deg_s])
        accel = np.concatenate([accel, rows.accel_max_deg_s2])
    if robot.servos:
        details.setdefault("cells_min", CELLS_MIN_GEARED)
    return RateTask(
        path=path, speed_max_deg_s=speed, accel_max_deg_s2=accel, servos=rows, **details
    )


def laid_out(
    sequence: Show,
    robot: Robot,
    margins: Margins = NO_MARGINS,
    *,
    may_flow: bool = True,
    keeps_time: bool = False,
) -> Layout:
    """Return the layout of a sequence; `may_flow` False lets every pass end at rest.

    `keeps_time`: path positions are the authored times, also where keys are too close together.
    """
    checked = keys_by_joint(sequence, robot)
    if not checked:
        raise InputError("the sequence moves no joint", path=sequence.path)
    if margins is not NO_MARGINS:
        checked = {name: margins.applied(name, own) for name, own in checked.items()}
    spacing = (
        authored_spacing(sequence) if keeps_time else spacing_of(sequence, checked, robot, margins)
    )
    keys = {name: joint_keys(own, spacing) for name, own in checked.items()}
    length_s = spacing.length_s
    slopes: dict[str, float] = {}
    if sequence.loop != 1 and may_flow:
        slopes = {name: seam_slope_deg_s(own, length_s) for name, own in keys.items()}

    def path(*, is_first: bool, is_last: bool) -> Path:
        rested = {
            name: with_longer_rests(
                own,
                margins.half_s.get(name, 0.0),
                is_from_rest=is_first or not slopes.get(name),
                is_to_rest=is_last or not slopes.get(name),
            )
            for name, own in keys.items()
        }
        return build_path(
            rested,
            robot,
            length_s,
            start_slopes={} if is_first else slopes,
            end_slopes={} if is_last else slopes,
        )

    if not any(slopes.values()):
        paths: tuple[Path, ...] = (path(is_first=True, is_last=True),)
    else:
        first, last = path(is_first=True, is_last=False), path(is_first=False, is_last=True)
        if sequence.loop == 2:
            paths = (first, last)
        else:
            paths = (first, path(is_first=False, is_last=False), last)
    return Layout(
        sequence=sequence,
        robot=robot,
        keys=keys,
        spacing=spacing,
        paths=paths,
        is_timed=is_timed(sequence),
        margins=margins,
    )


def _at_seams(path_s: FloatArray, seams_s: FloatArray) -> FloatArray:
    """Return positions of which those at seams, but for rounding, are exactly there."""
    for seam_s in seams_s.tolist():
        path_s = np.where(np.abs(path_s - seam_s) < SAME_INSTANT_S, seam_s, path_s)
    return path_s


def united(spans: FloatArray) -> FloatArray:
    """Return spans, (n, 2), in order, with those that overlap or touch made one."""
    found: list[list[float]] = []
    for from_s, to_s in sorted(spans.tolist()):
        if found and from_s <= found[-1][1]:
            found[-1][1] = max(found[-1][1], to_s)
        elif to_s > from_s:
            found.append([from_s, to_s])
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def segments_over_limits(task: RateTask) -> NDArray[np.bool_]:
    """Return which segments exceed a limit at rate 1."""
    speed, accel = task.peaks()
    is_fast = np.any(speed > task.speed_max_deg_s * FEASIBLE_RATIO, axis=1)
    return np.asarray(is_fast | np.any(accel > task.accel_max_deg_s2 * FEASIBLE_RATIO, axis=1))


def stops(task: RateTask) -> NDArray[np.bool_]:
    """Return for each knot whether no joint moves there, so that the rate may jump."""
    path = task.path
    segments = np.arange(len(path.knots_s) - 1)
    still = REST_RATIO * task.speed_max_deg_s
    starts, ends = (
        np.all(np.abs(task.slopes(at_s, segments)[0]) <= still, axis=1)
        for at_s in (path.knots_s[:-1], path.knots_s[1:])
    )
    is_stop: NDArray[np.bool_] = np.append(starts, True) & np.append(True, ends)
    return is_stop


def timed(
    dues: Dues, seams: Sequence[int], task: RateTask, _: object
) -> tuple[list[RateWindow], PathClock]:
    """Return the windows in which the rate is not 1, and the clock, with boundaries at `seams`."""
    path = task.path
    is_late = dues.begins_late_s(float(path.knots_s[0])) > 0.0
    if not (is_late or task.knot_caps or segments_over_limits(task).any()):
        return [], authored_clock(path, [], seams, dues)
    windows = timed_windows(task, dues)
    clock = authored_clock(path, windows, seams, dues)
    if dues.seams_s and clock.duration_s > float(dues.authored(path.knots_s[-1:])[0]) + LATE_MIN_S:
        hasty = timed_windows(task, dues, is_hasty=True)
        faster = authored_clock(path, hasty, seams, dues)
        if faster.duration_s < clock.duration_s - LATE_MIN_S:
            return hasty, faster
    return windows, clock


def timed_windows(task: RateTask, dues: Dues, *, is_hasty: bool = False) -> list[RateWindow]:
    """Return the windows in which the rate is not 1: slow where limits bind, fast while late.

    Where rates at seams differ, they are only slow: the next attempt caps them. `is_hasty`: seams
    are passed as fast as limits allow, not at most at the author's pace.
    """
    is_stop = stops(task)
    stops_s = task.path.knots_s[is_stop]
    outlines = slowed_windows(task, is_stop, is_outline=not dues.seams_s)
    if is_hasty:
        squares = [hasty_square(task, stops_s, seam_s, PACE_MAX) for seam_s in dues.seams_s]
    else:
        squares = [square_at(outlines, seam_s) for seam_s in dues.seams_s]
        if max(squares, default=1.0) - min(squares, default=1.0) > RATE_SLACK:
            return outlines
    square = min(squares, default=1.0)
    found = made_up(task, outlines, stops_s, dues, seam_square=square)
    return slowed_windows(task, is_stop, is_outline=False) if found is None else found


def slowed_windows(
    task: RateTask, is_stop: NDArray[np.bool_], *, is_outline: bool
) -> list[RateWindow]:
    """Return the windows in which the rate is below 1, in order; none if the path is legal.

    `is_outline`: on the coarse grid alone, as `catch_up.made_up` needs them.
    """
    solver = slow_outline if is_outline else solve
    path = task.path
    is_active = segments_over_limits(task)
    for knot, cap in task.knot_caps.items():
        if cap < 1.0:
            is_active[knot - 1 : knot + 1] = True
    solved: dict[tuple[int, int], RateWindow] = {}
    for run in _spans(is_active, is_stop):
        for step in (-1, +1):
            _widen(is_active, is_stop, path, run, step)
    while pending := [run for run in _spans(is_active, is_stop) if run not in solved]:
        for first, end in pending:
            window = solver(task, float(path.knots_s[first]), float(path.knots_s[end]))
            solved[first, end] = window
            if window.squares[0] < 1.0:
                _widen(is_active, is_stop, path, (first, end), -1)
            if window.squares[-1] < 1.0:
                _widen(is_active, is_stop, path, (first, end), +1)
    return [solved[run] for run in _spans(is_active, is_stop)]


def _spans(is_active: NDArray[np.bool_], is_stop: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the runs of active segments, cut where no joint moves."""
    is_cut = is_stop[1:-1] & is_active[1:] & is_active[:-1]
    cuts = 1 + np.flatnonzero(is_cut)
    found = runs(is_active)
    bounds = distinct(np.concatenate([np.array(found, dtype=np.intp).ravel(), cuts])).tolist()
    return [(low, high) for low, high in itertools.pairwise(bounds) if is_active[low]]


def _widen(
    is_active: NDArray[np.bool_],
    is_stop: NDArray[np.bool_],
    path: Path,
    run: tuple[int, int],
    step: int,
) -> None:
    """Activate segments before (`step` -1) or after a run, up to the next stop or active one.

    The run grows by `WINDOW_MIN_S` or half of its length, whichever is more. Where it meets another
    run, both become one. At a stop the rate may jump instead.
    """
    first, end = run
    wanted_s = max(WINDOW_MIN_S, 0.5 * float(path.knots_s[end] - path.knots_s[first]))
    segment = first - 1 if step < 0 else end
    while wanted_s > 0.0 and 0 <= segment < len(is_active):
        if is_stop[segment + 1 if step < 0 else segment] or is_active[segment]:
            return
        wanted_s -= float(path.knots_s[segment + 1] - path.knots_s[segment])
        is_active[segment] = True
        segment += step


class _ClockPieces:
    """Collects the pieces of a clock in order."""

    def __init__(self) -> None:
        self.path_s: list[FloatArray] = []
        self.spent_s: list[FloatArray] = []
        self.rates: list[FloatArray] = []
        self.slopes: list[FloatArray] = []
        self.now_s = 0.0

    def follow(self, window: RateWindow) -> None:
        rates = np.sqrt(window.squares[:-1])
        slopes = np.diff(window.squares) / (2.0 * np.diff(window.grid_s))
        self._add(window.grid_s[:-1], window.spent_s, rates, slopes)

    def go(self, from_s: float, to_s: float, spent_s: float) -> None:
        """Follow the path at a constant rate, for `spent_s`."""
        rate = (to_s - from_s) / spent_s if spent_s > 0.0 else 0.0
        self._add(np.array([from_s]), np.array([spent_s]), np.array([rate]), np.zeros(1))

    def _add(
        self, path_s: FloatArray, spent_s: FloatArray, rates: FloatArray, slopes: FloatArray
    ) -> None:
        self.path_s.append(path_s)
        self.spent_s.append(spent_s)
        self.rates.append(rates)
        self.slopes.append(slopes)
        self.now_s += float(spent_s.sum())

    def clock(self, end_s: float) -> PathClock:
        if not self.spent_s:
            self.go(end_s, end_s, 0.0)
        spent_s = np.concatenate(self.spent_s)
        return PathClock(
            times_s=np.concatenate([[0.0], np.cumsum(spent_s)]),
            path_s=np.append(np.concatenate(self.path_s), end_s),
            rates=np.concatenate(self.rates),
            rate_slopes=np.concatenate(self.slopes),
        )


def authored_clock(
    path: Path, windows: Sequence[RateWindow], seams: Sequence[int], dues: Dues
) -> PathClock:
    """Return the clock with rate 1 outside of `windows`, with a piece boundary at all `seams`.

    A rest is shortened by as much as the motion is late in its pass, except where it is held.
    """
    is_rest = path.rests
    changes = 1 + np.flatnonzero(np.diff(is_rest))
    knots = distinct(
        np.concatenate([[0], changes, np.asarray(seams, dtype=np.intp), [len(is_rest)]])
    )
    edges_s = path.knots_s[knots]
    is_resting = np.append(is_rest, False)[knots]
    seams_s = set(path.knots_s[list(seams)].tolist())
    following = {window.from_s: window for window in windows}
    if windows:
        ends_s = np.array([[window.from_s, window.to_s] for window in windows]).ravel()
        bounds_s = np.union1d(edges_s, ends_s)
        is_resting = is_resting[np.searchsorted(edges_s, bounds_s, side="right") - 1]
        edges_s = bounds_s
    pieces = _ClockPieces()
    pass_start_s = reached_s = 0.0
    for (from_s, to_s), rests in zip(
        itertools.pairwise(edges_s.tolist()), is_resting.tolist(), strict=False
    ):
        if from_s < reached_s:
            continue
        if from_s in seams_s:
            pass_start_s = pieces.now_s - float(dues.authored(np.array([from_s]))[0])
        if window := following.get(from_s):
            pieces.follow(window)
            reached_s = window.to_s
        elif rests:
            _rest(pieces, (from_s, to_s), dues, pass_start_s)
        else:
            pieces.go(from_s, to_s, to_s - from_s)
    return pieces.clock(float(path.knots_s[-1]))


def _rest(pieces: _ClockPieces, rest: tuple[float, float], dues: Dues, pass_start_s: float) -> None:
    """Rest until the motion is no longer late, at least as long as it is held."""
    cuts_s = np.array(rest)
    if pieces.now_s - (float(dues.authored(cuts_s[:1])[0]) + pass_start_s) > SAME_INSTANT_S:
        inner_s = dues.held[(dues.held > rest[0]) & (dues.held < rest[1])]
        cuts_s = distinct(np.concatenate([cuts_s, inner_s]))
    due_s = (dues.authored(cuts_s) + pass_start_s).tolist()
    for part, (from_s, to_s) in enumerate(itertools.pairwise(cuts_s.tolist())):
        spent_s = to_s - from_s
        is_late = pieces.now_s - due_s[part] > SAME_INSTANT_S
        if is_late and not dues.is_held(from_s, to_s):
            spent_s = max(0.0, due_s[part + 1] - pieces.now_s)
        pieces.go(from_s, to_s, spent_s)


def stopping_clock(
    windows: Sequence[RateWindow], pauses_s: Mapping[float, float], end_s: float
) -> PathClock:
    """Return the clock that follows `windows` and stops at the path positions in `pauses_s`."""
    pieces = _ClockPieces()
    for window in windows:
        _pause(pieces, float(window.grid_s[0]), pauses_s)
        pieces.follow(window)
    _pause(pieces, end_s, pauses_s)
    return pieces.clock(end_s)


def _pause(pieces: _ClockPieces, at_s: float, pauses_s: Mapping[float, float]) -> None:
    if (pause_s := pauses_s.get(at_s, 0.0)) > 0.0:
        pieces.go(at_s, at_s, pause_s)


def slowed_clock(clock: PathClock, ratio: float) -> PathClock:
    """Return the clock with all motion slowed by `ratio`; pauses keep their length."""
    is_pause = (clock.rates == 0.0) & (clock.rate_slopes == 0.0)
    spent_s = np.diff(clock.times_s) * np.where(is_pause, 1.0, ratio)
    return PathClock(
        times_s=np.concatenate([[0.0], np.cumsum(spent_s)]),
        path_s=clock.path_s,
        rates=clock.rates / ratio,
        rate_slopes=clock.rate_slopes / ratio**2,
    )


def pause_s(clock: PathClock) -> float:
    """Return the sum of the times in which the clock stands still."""
    is_pause = (clock.rates == 0.0) & (clock.rate_slopes == 0.0)
    return float(np.diff(clock.times_s)[is_pause].sum())


def slowed_to(trajectory: Trajectory, wanted_s: float) -> Trajectory:
    """Return a fastest trajectory, slowed so that one pass takes `wanted_s`; not its holds."""
    motions = motions_of(trajectory)
    clock = motions[1].clock
    paused_s = pause_s(clock)
    moving_s = clock.duration_s - paused_s
    if clock.duration_s > wanted_s + FIT_TOLERANCE_S:
        raise PlanningError(
            f"one pass cannot be done in {wanted_s:g} s: the fastest takes "
            f"{clock.duration_s:.3f} s, of which {paused_s:g} s are holds"
        )
    if moving_s <= 0.0:
        raise PlanningError(
            f"nothing moves, so that {wanted_s:g} s cannot be filled; give a hold of that length"
        )
    ratio = max(1.0, (wanted_s - paused_s) / moving_s)
    return _reclocked(trajectory, lambda clock: slowed_clock(clock, ratio))


def at_ratio(trajectory: Trajectory, ratio: float) -> Trajectory:
    """Return a fastest trajectory slowed to `ratio` of its speed, pauses included."""
    return _reclocked(
        trajectory,
        lambda clock: PathClock(
            times_s=clock.times_s / ratio,
            path_s=clock.path_s,
            rates=clock.rates * ratio,
            rate_slopes=clock.rate_slopes * ratio**2,
        ),
    )


def _reclocked(trajectory: Trajectory, change: Callable[[PathClock], PathClock]) -> Trajectory:
    """Return the trajectory with changed clocks on the same paths; equal passes stay one object."""
    motions = motions_of(trajectory)
    changed = {id(m): PathMotion(path=m.path, clock=change(m.clock)) for m in motions}
    first, middle, last = (changed[id(motion)] for motion in motions)
    reached_s = [mark.planned_s for mark in trajectory.marks]
    moved_s = np.interp(reached_s, motions[0].clock.times_s, first.clock.times_s).tolist()
    return replace(
        trajectory,
        first=first,
        middle=middle,
        last=last,
        marks=tuple(
            replace(mark, planned_s=at_s)
            for mark, at_s in zip(trajectory.marks, moved_s, strict=True)
        ),
    )


def scaled(sequence: Show, wanted_s: float) -> Show:
    """Return the sequence with times and holds scaled so that it lasts `wanted_s`."""
    lasts_s = max(((frame.at_s or 0.0) + frame.hold_s for frame in sequence.keyframes), default=0.0)
    if not lasts_s > 0.0:
        raise InputError("all times are 0 s: there is nothing to fit", path=sequence.path)
    ratio = wanted_s / lasts_s
    return replace(
        sequence,
        keyframes=tuple(
            replace(
                frame,
                at_s=None if frame.at_s is None else frame.at_s * ratio,
                hold_s=frame.hold_s * ratio,
                slope_deg_s={name: one / ratio for name, one in frame.slope_deg_s.items()},
            )
            for frame in sequence.keyframes
        ),
    )


RELENTLESS_S: Final = 2.5
RELENTLESS_SHARE: Final = 0.995
RELENTLESS_LONG_S: Final = 8.0
RELENTLESS_SHARE_KEPT: Final = 0.98
"""Where the acceleration is at its limit for longer than 2.5 s, 99.5 % of it are used, and 98 % for
longer than 8 s by motions that keep their time.

Measured in the simulator with 12 motions of 10 to 40 s, of LSS and LSS-PRO, 90 to 360 deg/s, 300 to
900 deg/s², turns every 0.32 to 0.9 s, with and without feedback. Largest distance of a horn from
its plan: slowed motions 0.8 deg with 98 %, 1.1 deg with 99.5 %; motions that keep their time 0.6
deg with 98 %, 13 deg with 99.5 %. Measured before with 8 such motions: up to 10 deg (slowed) and
12 deg (keep: time) with all of the limit, 10 deg with 99 % (keep: time). Up to 2 s all are alike.
Of the two that fall behind with 99.5 %, the horns are within 0.5 deg for 11 s, and then go off.
Full acceleration in between, with less for half a second, is worse."""

AT_LIMIT_RATIO: Final = 0.97
"""An acceleration above this share of its limit is at it: less than all shares above."""

BREAK_S: Final = 0.1
"""A shorter time below the limit is no break. Measured with a cruise between the turns: with 50 ms
the horn is 9.9 deg off after 20 s, with 100 ms 0.7 deg. 10 to 20 ms at both ends of a cruise have
less than the limit."""

STEP_S: Final = 0.025
"""Step in which a motion is sampled: a quarter of a break."""

ROUNDS_MAX: Final = 4
"""With less acceleration in one stretch, the next one may become longer. Measured: one round."""


def with_reserve(
    task: RateTask,
    follow: Callable[[RateTask, Sequence[RateWindow]], Timed],
    *,
    seams_s: Sequence[float] = (),
    loop: int | None = 1,
    is_met: Callable[[PathClock], BoolArray],
) -> tuple[RateTask, Timed]:
    """Return the task with its reserves, and how `follow` times it then.

    `follow` gets the windows that it found with fewer reserves, at first none. At the positions
    `seams_s` passes begin; those amid them are repeated, as `loop` says. `is_met` returns which
    anchors are met: none is given up for a reserve.
    """
    timed = first = follow(task, ())
    met = is_met(timed[1])
    reserved = task
    for _ in range(ROUNDS_MAX):
        shares = _shares(reserved, timed, seams_s, loop)
        if shares is None:
            break
        reserved = replace(reserved, accel_shares=shares)
        timed = follow(reserved, timed[0])
    if (met & ~is_met(timed[1])).any():
        return task, first
    return reserved, timed


def _shares(
    task: RateTask, timed: Timed, seams_s: Sequence[float], loop: int | None
) -> FloatArray | None:
    """Return the shares of the limits of each segment and joint; None: nothing changes."""
    windows, clock = timed
    if not windows or (loop == 1 and clock.duration_s <= RELENTLESS_S):
        return None
    times_s = np.arange(0.5 * STEP_S, clock.duration_s, STEP_S)
    order = _played(times_s, clock.times_of(np.asarray(seams_s)), clock.duration_s, loop)
    path_s, rates, slopes = clock.positions(times_s)
    ends_s = np.array([(window.from_s, window.to_s) for window in windows]).ravel()
    is_inside = np.searchsorted(ends_s, path_s) % 2 == 1
    near = np.unique(_relentless(is_inside[order, None], order)[0])
    if not len(near):
        return None
    first, second = task.slopes(path_s[near])
    accel = np.abs(second * rates[near, None] ** 2 + first * slopes[near, None])
    is_at_limit = np.zeros((len(times_s), accel.shape[1]), dtype=np.bool_)
    is_at_limit[near] = accel > AT_LIMIT_RATIO * task.accel_max_deg_s2
    samples, joints = _relentless(is_at_limit[order], order)
    if not len(samples):
        return None
    segments = task.path.segments_of(path_s[samples])
    before = task.accel_shares
    shares = np.ones((len(task.path.knots_s) - 1, accel.shape[1])) if before is None else before
    shares = shares.copy()
    shares[segments, joints] = RELENTLESS_SHARE
    return None if before is not None and np.array_equal(shares, before) else shares


def _played(
    times_s: FloatArray, seams_s: FloatArray, duration_s: float, loop: int | None
) -> NDArray[np.intp]:
    """Return the samples in the order of play, with the repeated pass as often as it matters."""
    edges = [0, *np.searchsorted(times_s, seams_s).tolist(), len(times_s)]
    passes = [np.arange(low, high) for low, high in itertools.pairwise(edges)]
    if loop == 1 or len(passes) == 2:
        return np.arange(len(times_s))
    middle = len(passes) // 2
    count = math.ceil(RELENTLESS_S / duration_s * len(passes)) + 1
    if loop is not None:
        count = min(count, loop - len(passes) + 1)
    return np.concatenate([*passes[:middle], np.tile(passes[middle], count), *passes[middle + 1 :]])


def _relentless(
    flags: BoolArray, order: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return samples and columns of the runs of set flags that last too long without a break."""
    least, gap = round(RELENTLESS_S / STEP_S), round(BREAK_S / STEP_S)
    found = [
        (order[first:end], np.full(end - first, column))
        for column in range(flags.shape[1])
        for first, end in near_runs(flags[:, column], gap)
        if end - first > least
    ]
    if not found:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    samples, columns = zip(*found, strict=True)
    return np.concatenate(samples), np.concatenate(columns)
