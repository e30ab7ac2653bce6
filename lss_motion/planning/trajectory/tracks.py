"""Tracks: from keyframes to verified motion, for one track and for several tracks in parallel.

`planned_track` plans the keyframes of one track. `planned_tracks` plays tracks of different joints
at the same time.
"""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory import explain
from lss_motion.planning.trajectory.keys import is_timed, named
from lss_motion.planning.trajectory.model import PathMotion, Trajectory
from lss_motion.planning.trajectory.retime import (
    FIT_TOLERANCE_S,
    REST_RATIO,
    Layout,
    laid_out,
    scaled,
    slowed_to,
    stopping_clock,
    timed,
    with_reserve,
)
from lss_motion.planning.trajectory.solver import solve
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Timing
from lss_motion.show.splines import distinct
from lss_motion.units import significant

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.dues import Dues
    from lss_motion.planning.trajectory.model import PathClock
    from lss_motion.planning.trajectory.solver import RateTask, RateWindow
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence as Show

    FloatArray = NDArray[np.float64]


SEAM_ROUNDS_MAX: Final = 8
"""Solves until the rates at both seams agree. Measured: two are enough."""

SEAM_RATE_SLACK: Final = 1e-7
"""Rates at seams that differ by less are equal: at 360 deg/s, within a millisecond, this is an
acceleration of 0.04 deg/s²."""

PERIOD_MAX_S: Final = 600.0
"""Longest common period of tracks that loop forever. Chosen: the whole period is compiled."""

PERIOD_UNIT_S: Final = 1e-6
"""Passes are compared in whole microseconds, the unit of a program's instants."""

PERIOD_SLACK_S: Final = 1e-9
"""Rounding error of a pass in whole units; a larger remainder would add up over the passes."""


def planned_track(sequence: Show, robot: Robot) -> Trajectory:
    """Return the plan of the keyframes of `sequence` alone; it has passed the verifier."""
    if sequence.timing is Timing.FIT and is_timed(sequence):
        return _fitted(sequence, robot)
    return verified(planned_layout(laid_out(sequence, robot)), sequence, robot)


def verified(trajectory: Trajectory, sequence: Show, robot: Robot) -> Trajectory:
    """Return the trajectory if it passes `verify`; else raise with the keyframe after the fault."""
    try:
        verify(trajectory, robot)
    except PlanningError as error:
        passed_s = (error.time_s or 0.0) % (trajectory.first.duration_s or 1.0)
        later = [index for index, mark in enumerate(trajectory.marks) if mark.planned_s >= passed_s]
        keyframe = sequence.keyframes[min(later, default=len(sequence.keyframes) - 1)]
        place = explain.place_of(sequence, keyframe)
        is_sloped = any(frame.slope_deg_s for frame in sequence.keyframes)
        slope = " or a smaller slope_deg_s" if is_sloped else ""
        raise PlanningError(
            f"{place}on the way to keyframe {named(keyframe)}: {error.reason}. "
            f"Move the keyframe, or choose another ease{slope}",
            joint=error.joint,
            time_s=error.time_s,
        ) from error
    return trajectory


def planned_layout(layout: Layout) -> Trajectory:
    """Return the trajectory, which is not verified yet.

    If the seams of a loop find no common rate, passes end at rest.
    """
    caps: dict[int, float] = {}
    dues = layout.dues()
    for _ in range(SEAM_ROUNDS_MAX):
        task, (windows, clock) = with_reserve(
            layout.task(caps),
            partial(timed, dues, layout.seams()) if layout.is_timed else partial(_free, layout),
            seams_s=dues.seams_s,
            loop=layout.sequence.loop,
            is_met=partial(explain.is_met, dues),
        )
        rates = _seam_rates(layout, clock)
        if max(rates, default=1.0) - min(rates, default=1.0) <= SEAM_RATE_SLACK:
            return _assembled(layout, dues, task, windows, clock)
        caps = dict.fromkeys(layout.seams(), min(rates) ** 2)
    return planned_layout(laid_out(layout.sequence, layout.robot, layout.margins, may_flow=False))


def _seam_rates(layout: Layout, clock: PathClock) -> list[float]:
    seams_s = [count * layout.spacing.length_s for count in range(1, len(layout.paths))]
    times_s = clock.times_of(np.array(seams_s))
    return [float(rate) for rate in clock.positions(times_s)[1]]


def _free(
    layout: Layout, task: RateTask, before: Sequence[RateWindow]
) -> tuple[list[RateWindow], PathClock]:
    """Return the time-optimal windows and clock between holds, at which every joint rests.

    `before` has the windows without the reserves of the task, if they are known.
    """
    pauses_s: dict[float, float] = {}
    for count in range(len(layout.paths)):
        for keyframe, at_s in zip(
            layout.sequence.keyframes, layout.spacing.reached_s.tolist(), strict=True
        ):
            if keyframe.hold_s > 0.0:
                place_s = at_s + count * layout.spacing.length_s
                nearest = int(np.argmin(np.abs(task.path.knots_s - place_s)))
                knot_s = float(task.path.knots_s[nearest])
                pauses_s[knot_s] = pauses_s.get(knot_s, 0.0) + keyframe.hold_s
    end_s = float(task.path.knots_s[-1])
    stops_s = sorted({0.0, *pauses_s, end_s})
    knots = np.searchsorted(task.path.knots_s, stops_s).tolist()
    stop_max = [_stop_square(task, knot) for knot in knots]
    legs = list(zip(stops_s[:-1], stops_s[1:], stop_max[:-1], stop_max[1:], strict=True))
    windows = [
        solve(task, from_s, to_s, start_max=start, end_max=end, known=known)
        for (from_s, to_s, start, end), known in zip(
            legs, before or itertools.repeat(None, len(legs)), strict=True
        )
    ]
    return windows, stopping_clock(windows, pauses_s, end_s)


def _stop_square(task: RateTask, knot: int) -> float:
    """Return the largest squared rate at a stop: infinite where the path is at rest, else 0."""
    slopes = np.abs(task.slopes(task.path.knots_s[knot : knot + 1])[0])
    return math.inf if np.all(slopes <= REST_RATIO * task.speed_max_deg_s) else 0.0


def _assembled(
    layout: Layout, dues: Dues, task: RateTask, windows: list[RateWindow], clock: PathClock
) -> Trajectory:
    sequence, spacing = layout.sequence, layout.spacing
    stretched = (
        explain.slow_spans(task, tuple(layout.keys), windows, clock, dues)
        if layout.is_timed
        else ()
    )
    if layout.is_timed:
        explain.check_anchors(sequence, spacing, clock, layout.authored, stretched)
    marks = explain.marks(
        sequence.keyframes,
        spacing,
        clock,
        is_timed=layout.is_timed,
        path=task.path,
        joints=tuple(layout.keys),
    )
    motions = [
        PathMotion(path=path, clock=clock.cut(start_s, start_s + path.length_s))
        for path, start_s in zip(
            layout.paths,
            [count * spacing.length_s for count in range(len(layout.paths))],
            strict=True,
        )
    ]
    trajectory = of_passes(layout, motions, stretched=stretched, marks=marks)
    if sequence.timing is Timing.FIT and not layout.is_timed:
        return slowed_to(trajectory, sequence.fit_duration_s or 0.0)
    return trajectory


def of_passes(layout: Layout, motions: Sequence[PathMotion], **details: Any) -> Trajectory:  # noqa: ANN401
    """Return the trajectory of a sequence by the motions of its passes that differ."""
    return Trajectory(
        name=layout.sequence.name,
        joints=tuple(layout.keys),
        first=motions[0],
        middle=motions[len(motions) // 2],
        last=motions[-1],
        loop=layout.sequence.loop,
        is_periodic=len(motions) > 1,
        **details,
    )


def _fitted(sequence: Show, robot: Robot) -> Trajectory:
    """Return the plan with the author's times scaled to the duration, which is met or refused."""
    wanted_s = sequence.fit_duration_s or 0.0
    trajectory = _lasting(sequence, robot, wanted_s)
    if not _lasts(trajectory, wanted_s):
        least_s = _least_fit_s(sequence, robot)
        worst = max(trajectory.stretched, key=lambda stretch: stretch.by_s)
        raise PlanningError(
            f"one pass cannot be done in {wanted_s:g} s with the author's proportions: joint "
            f"{worst.joint!r} would need {worst.limit} {significant(worst.authored)} "
            f"{worst.unit}, allowed {worst.allowed:g} {worst.unit}; "
            f"the least duration is {least_s:.3f} s",
            joint=worst.joint,
            time_s=worst.from_s,
        )
    return verified(trajectory, sequence, robot)


def _lasting(sequence: Show, robot: Robot, wanted_s: float) -> Trajectory:
    return planned_layout(laid_out(scaled(sequence, wanted_s), robot))


def _lasts(trajectory: Trajectory, wanted_s: float) -> bool:
    """Return whether every pass is as long as wanted."""
    return all(
        abs(motion.duration_s - wanted_s) <= FIT_TOLERANCE_S
        for motion in (trajectory.first, trajectory.middle, trajectory.last)
    )


def _least_fit_s(sequence: Show, robot: Robot) -> float:
    """Return a duration that was planned with, the least one to a millisecond, rounded up."""

    def is_feasible(duration_ms: int) -> bool:
        duration_s = duration_ms / 1000.0
        return _lasts(_lasting(sequence, robot, duration_s), duration_s)

    high = max(1, math.ceil(1000.0 * (sequence.fit_duration_s or 0.0)))
    low = 0
    while not is_feasible(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if is_feasible(middle) else (middle, high)
    return high / 1000.0


class ParallelPass(Struct, frozen=True, kw_only=True):
    """A pass in which tracks move in parallel: show times from `from_s` on."""

    joints: tuple[str, ...]
    parts: tuple[Trajectory, ...]
    from_s: float
    duration_s: float

    @property
    def seams_s(self) -> FloatArray:
        return np.zeros(0)

    @property
    def knots_s(self) -> FloatArray:
        end_s = self.from_s + self.duration_s
        knots_s = np.concatenate([track.knots_until(end_s) for track in self.parts]) - self.from_s
        inside_s = knots_s[(knots_s > 0.0) & (knots_s < self.duration_s)]
        return distinct(np.concatenate([[0.0], inside_s, [self.duration_s]]))

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        times_s = np.asarray(times_s, dtype=np.float64)
        show_s = self.from_s + np.clip(times_s, 0.0, self.duration_s)
        values = np.empty((len(times_s), len(self.joints)))
        for track in self.parts:
            columns = [self.joints.index(name) for name in track.joints]
            values[:, columns] = track.sample(show_s, order)
        if order > 0:
            values[(times_s < 0.0) | (times_s > self.duration_s)] = 0.0
        return values


def planned_tracks(
    show: Show,
    tracks: Sequence[Show],
    robot: Robot,
    plan: Callable[[Show, Robot], Trajectory],
) -> Trajectory:
    """Return the tracks played at the same time.

    The show lasts as long as its longest finite track. A track that loops forever is played as
    often as it fits into that, at least once. If the keyframes outside of tracks loop forever, or
    all tracks do, the show loops forever.
    """
    planned = [plan(track, robot) for track in tracks]
    is_endless = show.loop is None if show.keyframes else all(t.loop is None for t in planned)
    if is_endless:
        return _endless(show, planned, robot)
    length_s = max(track.duration_s for track in planned if track.loop is not None)
    finite = [
        track if track.loop is not None else _fitting(source, track, length_s, robot, plan)
        for source, track in zip(tracks, planned, strict=True)
    ]
    whole = ParallelPass(
        joints=_joints(finite, robot),
        parts=tuple(finite),
        from_s=0.0,
        duration_s=max(track.duration_s for track in finite),
    )
    return _merged(show, finite, whole, whole, loop=1)


def _fitting(
    source: Show,
    track: Trajectory,
    length_s: float,
    robot: Robot,
    plan: Callable[[Show, Robot], Trajectory],
) -> Trajectory:
    """Return an endless track with as many passes as fit into `length_s`."""
    ends_s = track.first.duration_s + track.last.duration_s
    if track.first.parts:  # Its last pass is that of the number of passes it was planned for.
        count = 2 + math.floor((length_s - ends_s) / track.middle.duration_s + 1e-9)
        return plan(replace(source, loop=max(1, count)), robot)
    count = 2 + math.floor((length_s - ends_s) / track.middle.duration_s + 1e-9)
    if count >= 2 or not track.is_periodic:
        return replace(track, loop=max(1, count))
    return plan(replace(source, loop=1), robot)


def _endless(show: Show, tracks: Sequence[Trajectory], robot: Robot) -> Trajectory:
    looped = [track for track in tracks if track.loop is None]
    begun_s = max(
        track.first.duration_s if track.loop is None else track.duration_s for track in tracks
    )
    joints, parts = _joints(tracks, robot), tuple(tracks)
    period_s = common_period_s(looped)
    first = ParallelPass(joints=joints, parts=parts, from_s=0.0, duration_s=begun_s)
    cycle = ParallelPass(joints=joints, parts=parts, from_s=begun_s, duration_s=period_s)
    return _merged(show, tracks, first, cycle, loop=None)


def common_period_s(looped: Sequence[Trajectory], what: str = "the tracks") -> float:
    """Return the least common period of all loops; `what` names them in the error."""
    periods_s = [track.middle.duration_s for track in looped]
    if max(periods_s) - min(periods_s) <= PERIOD_SLACK_S:
        return periods_s[0]
    units = [round(period_s / PERIOD_UNIT_S) for period_s in periods_s]
    is_whole = all(
        abs(unit * PERIOD_UNIT_S - period_s) <= PERIOD_SLACK_S
        for unit, period_s in zip(units, periods_s, strict=True)
    )
    common_s = math.lcm(*units) * PERIOD_UNIT_S
    if is_whole and common_s <= PERIOD_MAX_S:
        return common_s
    passes = ", ".join(f"{t.name!r} {s:.6g} s" for t, s in zip(looped, periods_s, strict=True))
    raise PlanningError(
        f"{what} loop forever, but their passes ({passes}) do not meet again within "
        f"{PERIOD_MAX_S:g} s; make one pass a multiple of the other, or give loops a count"
    )


def _joints(tracks: Sequence[Trajectory], robot: Robot) -> tuple[str, ...]:
    keyed = {name for track in tracks for name in track.joints}
    return tuple(name for name in robot.joints if name in keyed)


def _merged(
    show: Show,
    tracks: Sequence[Trajectory],
    first: ParallelPass,
    cycle: ParallelPass,
    *,
    loop: int | None,
) -> Trajectory:
    return Trajectory(
        name=show.name,
        joints=first.joints,
        first=first,
        middle=cycle,
        last=cycle,
        loop=loop,
        is_periodic=loop is None,
        stretched=tuple(
            sorted((s for track in tracks for s in track.stretched), key=lambda s: s.from_s)
        ),
        given_up=tuple(
            sorted((s for track in tracks for s in track.given_up), key=lambda s: s.from_s)
        ),
        asked=tuple(span for track in tracks for span in track.asked),
        commands=tuple(move for track in tracks for move in track.commands),
        marks=tuple(sorted((m for t in tracks for m in t.marks), key=lambda m: m.planned_s)),
        smoothing=tuple(part for track in tracks for part in track.smoothing),
    )
