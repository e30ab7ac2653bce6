"""One track: from keyframes to a verified motion of the joints that they key."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import PlanningError
from lss_motion.sequence.model import Timing
from lss_motion.trajectory import explain
from lss_motion.trajectory.fit import FIT_TOLERANCE_S, least_fit_s, scaled, slowed_to
from lss_motion.trajectory.keys import is_timed, named
from lss_motion.trajectory.layout import Layout, laid_out
from lss_motion.trajectory.model import Motion, Trajectory
from lss_motion.trajectory.retime import slowed_windows, strained
from lss_motion.trajectory.solve import solve
from lss_motion.trajectory.timeline import authored_clock, stopping_clock
from lss_motion.trajectory.verify import verify
from lss_motion.units import significant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Sequence
    from lss_motion.trajectory.clock import Clock
    from lss_motion.trajectory.solve import Task, Window

    FloatArray = NDArray[np.float64]

SEAM_ROUNDS_MAX: Final = 8
"""Solves until the rates at both seams agree. Measured: two are enough."""

SEAM_RATE_SLACK: Final = 1e-7
"""Rates at seams that differ by less are equal: 360 deg/s times this, within a millisecond, is
0.04 deg/s²."""

REST_RATIO: Final = 1e-9
"""A path rests where its slopes are below this share of the speed limits: rounding."""


def planned_track(sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of the keyframes of `sequence` alone; it has passed the verifier."""
    if sequence.timing is Timing.FIT and is_timed(sequence):
        return _fitted(sequence, robot)
    return _verified(_planned(laid_out(sequence, robot)), sequence, robot)


def _verified(trajectory: Trajectory, sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the trajectory if it passes, else say between which keyframes it does not."""
    try:
        verify(trajectory, robot)
    except PlanningError as error:
        passed_s = (error.time_s or 0.0) % (trajectory.first.duration_s or 1.0)
        later = [index for index, mark in enumerate(trajectory.marks) if mark.planned_s >= passed_s]
        keyframe = sequence.keyframes[min(later, default=len(sequence.keyframes) - 1)]
        place = (
            ""
            if sequence.path is None or keyframe.line is None
            else f"{sequence.path}:{keyframe.line}: "
        )
        raise PlanningError(
            f"{place}on the way to keyframe {named(keyframe)}: {error.reason}. "
            "Move the keyframe, or choose another ease",
            joint=error.joint,
            time_s=error.time_s,
        ) from error
    return trajectory


def _planned(layout: Layout) -> Trajectory:
    """Return the trajectory; where the seams of a loop find no common speed, with rests there."""
    caps: dict[int, float] = {}
    for _ in range(SEAM_ROUNDS_MAX):
        task = layout.task(caps)
        windows, clock = _timed(layout, task) if layout.is_timed else _free(layout, task)
        rates = _seam_rates(layout, clock)
        if max(rates, default=1.0) - min(rates, default=1.0) <= SEAM_RATE_SLACK:
            return _assembled(layout, task, windows, clock)
        caps = dict.fromkeys(layout.seams(), min(rates) ** 2)
    return _planned(laid_out(layout.sequence, layout.robot, may_flow=False))


def _seam_rates(layout: Layout, clock: Clock) -> list[float]:
    seams_s = [count * layout.spacing.length_s for count in range(1, len(layout.paths))]
    times_s = clock.times_of(np.array(seams_s))
    return [float(rate) for rate in clock.positions(times_s)[1]]


def _timed(layout: Layout, task: Task) -> tuple[list[Window], Clock]:
    windows: list[Window] = []
    if strained(task).any() or task.knot_caps:
        windows = slowed_windows(task)
    return windows, authored_clock(task.path, windows, layout.seams(), layout.authored)


def _free(layout: Layout, task: Task) -> tuple[list[Window], Clock]:
    """Time-optimal between the holds, at which everything rests."""
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
    legs = list(zip(knots[:-1], knots[1:], stop_max[:-1], stop_max[1:], strict=True))
    windows = [
        solve(task, first, end, start_max=before, end_max=after)
        for first, end, before, after in legs
    ]
    return windows, stopping_clock(windows, pauses_s, end_s)


def _stop_square(task: Task, knot: int) -> float:
    """Return the squared rate allowed at a stop: any where the path itself rests, else 0."""
    slopes = np.abs(task.path.slopes(task.path.knots_s[knot : knot + 1])[0])
    return math.inf if np.all(slopes <= REST_RATIO * task.speed_max_deg_s) else 0.0


def _assembled(layout: Layout, task: Task, windows: list[Window], clock: Clock) -> Trajectory:
    sequence, spacing = layout.sequence, layout.spacing
    stretched = (
        explain.stretches(task, tuple(layout.keys), windows, clock, layout.authored)
        if layout.is_timed
        else ()
    )
    if layout.is_timed:
        explain.check_anchors(sequence, spacing, clock, layout.authored, stretched)
    marks = explain.marks(sequence.keyframes, spacing, clock)
    motions = [
        Motion(path=path, clock=clock.cut(start_s, start_s + path.length_s))
        for path, start_s in zip(
            layout.paths,
            [count * spacing.length_s for count in range(len(layout.paths))],
            strict=True,
        )
    ]
    trajectory = Trajectory(
        name=sequence.name,
        joints=tuple(layout.keys),
        first=motions[0],
        middle=motions[len(motions) // 2],
        last=motions[-1],
        loop=sequence.loop,
        is_periodic=len(motions) > 1,
        stretched=stretched,
        marks=marks,
    )
    if sequence.timing is Timing.FIT and not layout.is_timed:
        return slowed_to(trajectory, sequence.fit_duration_s or 0.0)
    return trajectory


def _fitted(sequence: Sequence, robot: Robot) -> Trajectory:
    """Scale the author's times to the wanted duration; it is met exactly or refused."""
    wanted_s = sequence.fit_duration_s or 0.0
    layout = laid_out(scaled(sequence, wanted_s), robot)
    trajectory = _planned(layout)
    if any(
        abs(motion.duration_s - wanted_s) > FIT_TOLERANCE_S
        for motion in (trajectory.first, trajectory.middle, trajectory.last)
    ):
        least_s = least_fit_s(sequence, robot)
        worst = max(trajectory.stretched, key=lambda stretch: stretch.by_s)
        unit = "deg/s" if worst.limit == "speed" else "deg/s²"
        raise PlanningError(
            f"one pass cannot be done in {wanted_s:g} s with the author's proportions: joint "
            f"{worst.joint!r} would need {worst.limit} {significant(worst.authored)} {unit}, "
            f"allowed {worst.allowed:g} {unit}; the least duration is {least_s:.3f} s",
            joint=worst.joint,
            time_s=worst.from_s,
        )
    return _verified(trajectory, sequence, robot)
