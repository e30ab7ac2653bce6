"""Windows: motion between two boundary states, at which the joints may be in motion.

`planned_window` is the one entry for motion that continues another one: the next part of a walk, a
splice, and the part of a show that an edit changes (`edited_window`).
"""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.planning.trajectory import explain
from lss_motion.planning.trajectory.curves import Path
from lss_motion.planning.trajectory.model import (
    Mark,
    PathMotion,
    SlowSpan,
    Trajectory,
    steady_clock,
)
from lss_motion.planning.trajectory.retime import (
    REST_RATIO,
    laid_out,
    rate_task,
    timed,
    with_reserve,
)
from lss_motion.planning.trajectory.solver import RATE_SLACK
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.keyframes import at_speed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.dues import Dues
    from lss_motion.planning.trajectory.retime import Layout
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence as Show

    FloatArray = NDArray[np.float64]

SAME_S: Final = 1e-5
SAME_DEG: Final = 0.001
SAME_DEG_S: Final = 0.01
"""Ends that differ by less are the same: a hundredth of a millisecond, a tenth of the finest unit
of a servo, and a speed that comes to less than that in 0.1 s."""


def planned_window(
    name: str,
    joints: Sequence[str],
    robot: Robot,
    path: Path,
    *,
    dues: Dues | None = None,
    is_to_rest: bool = True,
) -> Trajectory:
    """Return the verified motion along a path, from its slopes at the start to those at the end.

    With `dues` it is slowed where limits bind and makes up for lateness, also for what it begins
    with; without, it keeps its times. `joints` has the order of the columns of `path`; that of the
    result is the robot's. Raises `PlanningError` where the motion exceeds a limit.
    """
    order = [joint for joint in robot.joints if joint in joints]
    columns = [joints.index(joint) for joint in order]
    path = Path(knots_s=path.knots_s, coefficients=path.coefficients[:, :, columns])
    clock = steady_clock(path.length_s)
    stretched: tuple[SlowSpan, ...] = ()
    if dues is not None:
        task = rate_task(path, order, robot, knot_caps={})
        task, (windows, along) = with_reserve(
            task, partial(timed, dues, ()), is_met=partial(explain.is_met, dues)
        )
        stretched = explain.slow_spans(task, order, windows, along, dues)
        clock = along.cut(*path.knots_s[[0, -1]].tolist())
    motion = PathMotion(path=path, clock=clock)
    trajectory = Trajectory(
        name=name,
        joints=tuple(order),
        first=motion,
        middle=motion,
        last=motion,
        stretched=stretched,
    )
    verify(trajectory, robot, is_from_rest=False, is_to_rest=is_to_rest)
    return trajectory


class EditedWindow(Struct, frozen=True, kw_only=True):
    """The motion of an edited show between two instants; before and after it the whole plan holds.

    All times but those of `trajectory`, which begins at 0, are show times of the edited show.
    """

    trajectory: Trajectory
    from_s: float
    to_s: float
    marks: tuple[Mark, ...]
    """The keyframes from `from_s` to `to_s`; how late each is: `planned_s - authored_s`."""
    stretched: tuple[SlowSpan, ...]
    """The spans that are slower than authored, each with the joint and the limit that bind."""
    later_s: float
    """What comes after the window is so much later than in the whole plan."""
    is_joined: bool
    """Both ends are as in the whole plan: angles, speeds and instants. Else only a plan of the
    whole can tell what the edit does."""


def edited_window(
    sequence: Show, robot: Robot, whole: Trajectory, from_s: float, to_s: float
) -> EditedWindow | None:
    """Return the motion around an edit, planned without what lies far from it.

    `sequence` is edited between its times `from_s` and `to_s`; `whole` is the plan before that. The
    window is widened to keyframes at which the motion is on time or rests, until its ends are those
    of the whole plan, at last to the whole show. What follows the edit may be moved as a whole.
    Raises `InputError` and `PlanningError` as `planner.plan`, but none for a missed anchor: see
    `marks`. None where there is nothing but a plan of the whole: shows of tracks, parts or layers
    (a track alone has its own), without times, with joints that keep their time or whose
    acceleration must not jump, and loops in motion.
    """
    sequence = at_speed(sequence)
    if not _is_plain(sequence, robot, whole):
        return None
    layout = laid_out(sequence, robot)
    if len(layout.paths) != 1 or not layout.is_timed:
        return None
    found = None
    for start, end in _widened(_Places(layout, whole), from_s, to_s):
        found = _between(layout, whole, start, end)
        if found.is_joined:
            break
    return found


def _is_plain(sequence: Show, robot: Robot, whole: Trajectory) -> bool:
    """Return whether both are one path and its clock."""
    keyed = {name for frame in sequence.keyframes for name in frame.deg}
    is_smooth = sequence.smooth_s > 0.0 or any(
        math.isfinite(robot.joints[name].jerk_max_deg_s3) for name in keyed & {*robot.joints}
    )
    has_more = sequence.tracks or sequence.play or sequence.layers or sequence.loop_span_s
    is_kept = keyed & sequence.keeps_time
    is_path = isinstance(whole.first, PathMotion) and whole.first is whole.middle
    is_fitted = sequence.fit_duration_s is not None
    return is_path and not (has_more or is_kept or is_smooth or is_fitted)


class _Boundary(Struct, frozen=True):
    """A place of the edited show and when the whole plan is there; `later_s`: the edit moved it."""

    path_s: float
    authored_s: float
    whole_s: float
    later_s: float = 0.0


class _Places:
    """The places before and behind an edit at which the whole plan is on time or rests."""

    def __init__(self, layout: Layout, whole: Trajectory) -> None:
        self.length_s = layout.spacing.length_s
        frames, marks = layout.sequence.keyframes, whole.marks
        authored_s = np.array([frame.at_s or 0.0 for frame in frames])
        before_s = np.array([mark.authored_s or 0.0 for mark in marks])
        count = min(len(frames), len(marks))
        is_steady = _steady(whole)
        is_same = np.abs(authored_s[:count] - before_s[:count]) < SAME_S
        firsts = itertools.takewhile(is_same.__getitem__, range(count))
        reached_s = layout.spacing.reached_s.tolist()
        planned_s = [mark.planned_s for mark in marks]
        end_s = float(layout.authored(np.array([self.length_s]))[0])
        self.before = [_Boundary(0.0, 0.0, 0.0)] + [
            _Boundary(reached_s[k], float(authored_s[k]), planned_s[k])
            for k in firsts
            if is_steady[k]
        ]
        later_s = authored_s[-count:] - before_s[-count:]
        is_same = np.abs(later_s - later_s[-1]) < SAME_S
        lasts = itertools.takewhile(lambda k: bool(is_same[-k]), range(1, count + 1))
        by_s = float(later_s[-1])
        self.behind = [_Boundary(self.length_s, end_s, whole.first.duration_s, by_s)] + [
            _Boundary(reached_s[-k], float(authored_s[-k]), planned_s[-k], by_s)
            for k in lasts
            if is_steady[-k]
        ]


def _steady(whole: Trajectory) -> NDArray[np.bool_]:
    """Return for each keyframe whether the motion is on time at rate 1 there, or rests."""
    assert isinstance(whole.first, PathMotion)
    planned_s = np.array([mark.planned_s for mark in whole.marks])
    late_s = planned_s - np.array([mark.authored_s or 0.0 for mark in whole.marks])
    rates = whole.first.clock.positions(planned_s)[1]
    still = np.abs(whole.sample(planned_s, 1)).max(axis=1) <= REST_RATIO
    return np.asarray(still | ((np.abs(late_s) <= SAME_S) & (np.abs(rates - 1.0) <= RATE_SLACK)))


def _widened(places: _Places, from_s: float, to_s: float) -> Iterator[tuple[_Boundary, _Boundary]]:
    """Yield ends around an edit, each further out by as much as the window before was long."""
    while True:
        start = max(
            (place for place in places.before if place.authored_s < from_s),
            key=lambda place: place.path_s,
            default=places.before[0],
        )
        end = min(
            (place for place in places.behind if place.authored_s > to_s),
            key=lambda place: place.path_s,
            default=places.behind[0],
        )
        yield start, end
        if start is places.before[0] and end is places.behind[0]:
            return
        by_s = max(end.authored_s - start.authored_s, 1.0)
        from_s, to_s = start.authored_s - by_s, end.authored_s + by_s


def _between(layout: Layout, whole: Trajectory, start: _Boundary, end: _Boundary) -> EditedWindow:
    late_s = max(0.0, start.whole_s - start.authored_s)
    dues = layout.dues().between(start.path_s, end.path_s, late_s)
    path = layout.paths[0].between(start.path_s, end.path_s)
    is_end = end.path_s >= layout.spacing.length_s
    trajectory = planned_window(
        layout.sequence.name, tuple(layout.keys), layout.robot, path, dues=dues, is_to_rest=is_end
    )
    assert isinstance(trajectory.first, PathMotion)
    clock = trajectory.first.clock
    clock = replace(clock, path_s=clock.path_s + path.knots_s[0])
    to_s = start.whole_s + trajectory.duration_s
    marks = explain.marks(
        layout.sequence.keyframes,
        layout.spacing,
        clock,
        is_timed=True,
        path=layout.paths[0],
        joints=tuple(layout.keys),
    )
    reached_s = layout.spacing.reached_s.tolist()
    ends = ((0.0, start.whole_s), (trajectory.duration_s, end.whole_s))
    is_same = [_is_same(trajectory, whole, *at_s) for at_s in (ends[:1] if is_end else ends)]
    return EditedWindow(
        trajectory=trajectory,
        from_s=start.whole_s,
        to_s=to_s,
        marks=tuple(
            replace(mark, planned_s=mark.planned_s + start.whole_s)
            for mark, at_s in zip(marks, reached_s, strict=True)
            if start.path_s <= at_s <= end.path_s
        ),
        stretched=tuple(
            replace(span, from_s=span.from_s + start.whole_s, to_s=span.to_s + start.whole_s)
            for span in trajectory.stretched
        ),
        later_s=end.later_s,
        is_joined=all(is_same) and (is_end or abs(to_s - end.whole_s - end.later_s) <= SAME_S),
    )


def _is_same(trajectory: Trajectory, whole: Trajectory, own_s: float, whole_s: float) -> bool:
    """Return whether angles and speeds of both agree at an instant."""
    if {*trajectory.joints} != {*whole.joints}:
        return False
    return all(
        bool(np.abs(_at(trajectory, own_s, order) - _at(whole, whole_s, order)).max() <= most)
        for order, most in ((0, SAME_DEG), (1, SAME_DEG_S))
    )


def _at(trajectory: Trajectory, at_s: float, order: int) -> FloatArray:
    return np.asarray(trajectory.sample(np.array([at_s]), order)[0])
