"""Results of planning compared with the author's times: slowed spans, marks, missed anchors."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.curves import out_of_range
from lss_motion.planning.trajectory.keys import SAME_INSTANT_S
from lss_motion.planning.trajectory.model import Mark, SlowSpan
from lss_motion.show.splines import distinct, runs
from lss_motion.units import significant

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.curves import Path
    from lss_motion.planning.trajectory.dues import Dues
    from lss_motion.planning.trajectory.keys import Spacing
    from lss_motion.planning.trajectory.model import PathClock
    from lss_motion.planning.trajectory.solver import RateTask, RateWindow
    from lss_motion.show.model import Keyframe
    from lss_motion.show.model import Sequence as Show

    FloatArray = NDArray[np.float64]

ANCHOR_TOLERANCE_S: Final = 0.001
"""An anchor is met to the millisecond: the finest that a command can express."""

KEY_S: Final = 1e-8
"""A grid point that is nearer to a key is at it: rounding."""

BEYOND_MIN_DEG: Final = 0.05
"""A joint that goes beyond its keys by less is not reported: about half a unit of a servo."""

STRETCH_MIN_S: Final = 1e-5
"""Spans slowed by less are not reported: a hundredth of a millisecond."""


class MissedAnchorError(PlanningError):
    """An anchor is `late_s` late; more time is needed before keyframe `index`."""

    def __init__(
        self, reason: str, *, joint: str | None, time_s: float | None, index: int, late_s: float
    ) -> None:
        super().__init__(reason, joint=joint, time_s=time_s)
        self.index = index
        self.late_s = late_s


class MissedUnderLayersError(PlanningError):
    """An anchor is late because of layers: there is no key that alone could have more time."""


def slow_spans(
    task: RateTask,
    joints: Sequence[str],
    windows: Sequence[RateWindow],
    clock: PathClock,
    dues: Dues,
) -> tuple[SlowSpan, ...]:
    """Return every span in which the path takes longer than authored, in planned time.

    What is slow between two keys and made up for before the second one is none.
    """
    found = []
    for window in windows:
        spent_s = window.spent_s
        lost_s = spent_s - np.diff(dues.authored(window.grid_s))
        for first, end, by_s in _late_cells(window.grid_s, lost_s, spent_s, dues.keys_s):
            cells = slice(first, end)
            column, limit, needed, at_s = _worst_limit(
                task, window.grid_s[first : end + 1], spent_s[cells], lost_s[cells]
            )
            from_s, to_s = clock.times_of(window.grid_s[[first, end]]).tolist()
            limits = task.speed_max_deg_s if limit == "speed" else task.accel_max_deg_s2
            found.append(
                SlowSpan(
                    from_s=from_s,
                    to_s=to_s,
                    by_s=by_s,
                    limit=limit,
                    authored=needed,
                    allowed=float(limits[column]),
                    **_owner(task, joints, column, at_s),
                )
            )
    return tuple(found)


def _owner(task: RateTask, joints: Sequence[str], column: int, at_s: float) -> dict[str, Any]:
    """Return what has the limit of a column, at a position of the path, as `SlowSpan` names it."""
    if column < len(joints):
        return {"joint": joints[column]}
    assert task.servos is not None, "further columns are those of servos"
    row = column - len(joints)
    joint, servo = task.servos.labels()[row]
    place = task.servos.place(row, task.path.evaluate(np.array([at_s]))[0])
    return {"joint": joint, "servo": servo, "at_deg": tuple(place)}


def _late_cells(
    grid_s: FloatArray, lost_s: FloatArray, spent_s: FloatArray, keys_s: FloatArray
) -> list[tuple[int, int, float]]:
    """Return the slow cells, from where to where, and by how much they are, in spans that are late.

    Slow cells on both sides of a key that both are late are one.
    """
    near = np.searchsorted(grid_s, keys_s[(keys_s > grid_s[0]) & (keys_s < grid_s[-1])] - KEY_S)
    edges = [0, *distinct(near).tolist(), len(lost_s)]
    found: list[tuple[int, int, float]] = []
    for low, high in itertools.pairwise(edges):
        own = runs(lost_s[low:high] > 1e-6 * spent_s[low:high])
        over_s = sum(float(lost_s[low + first : low + end].sum()) for first, end in own)
        net_s = min(float(lost_s[low:high].sum()), over_s)
        if net_s < STRETCH_MIN_S:
            continue
        for first, end in own:
            by_s = float(lost_s[low + first : low + end].sum()) * net_s / over_s
            if found and found[-1][1] == low + first:
                found[-1] = found[-1][0], low + end, found[-1][2] + by_s
            else:
                found.append((low + first, low + end, by_s))
    return [span for span in found if span[2] >= STRETCH_MIN_S]


def _worst_limit(
    task: RateTask, grid_s: FloatArray, spent_s: FloatArray, lost_s: FloatArray
) -> tuple[int, Literal["speed", "acceleration"], float, float]:
    """Return what is exceeded most: column, limit, authored value and position.

    Speed is proportional to the rate and acceleration to its square; the square root of the
    acceleration ratio makes both comparable.
    """
    steps_s = np.diff(grid_s)
    authored_rates = (steps_s / np.maximum(spent_s - lost_s, 1e-9))[:, None]
    # Slightly inside of both ends: at a knot the second derivative has two values.
    at_s = np.concatenate([grid_s[:-1] + share * steps_s for share in (0.001, 0.5, 0.999)])
    rates = np.tile(authored_rates, (3, 1))
    first, second = task.slopes(at_s)
    speeds, accels = np.abs(first) * rates, np.abs(second) * rates**2
    speed_ratios = (speeds / task.speed_max_deg_s).max(axis=0)
    accel_ratios = np.sqrt((accels / task.accel_max_deg_s2).max(axis=0))
    by_speed, by_accel = int(speed_ratios.argmax()), int(accel_ratios.argmax())
    if speed_ratios[by_speed] >= accel_ratios[by_accel]:
        most = int(speeds[:, by_speed].argmax())
        return by_speed, "speed", float(speeds[most, by_speed]), float(at_s[most])
    most = int(accels[:, by_accel].argmax())
    return by_accel, "acceleration", float(accels[most, by_accel]), float(at_s[most])


def marks(
    keyframes: Sequence[Keyframe],
    spacing: Spacing,
    clock: PathClock,
    *,
    is_timed: bool,
    kept: frozenset[str] = frozenset(),
    path: Path | None = None,
    joints: Sequence[str] = (),
) -> tuple[Mark, ...]:
    """Return the mark of each keyframe: its authored time and when the first pass reaches it.

    Without `path`, the motion is never late and rests as long as the author wants. `joints` has the
    order of its columns.
    """
    planned_s = clock.times_of(spacing.reached_s).tolist()
    held_s = (clock.times_of(spacing.left_s) - planned_s).tolist()
    rests = np.zeros((len(planned_s), 2))
    if path is not None and is_timed:
        rests[:-1] = _rests(spacing, clock, path)
    return tuple(
        Mark(
            label=keyframe.label,
            authored_s=keyframe.at_s,
            planned_s=at_s,
            is_anchor=keyframe.is_anchor,
            hold_s=keyframe.hold_s,
            held_s=kept_s if is_timed else keyframe.hold_s,
            rest_s=rest_s,
            rested_s=rested_s,
            hold_may_shrink=keyframe.hold_may_shrink,
            kept=tuple(name for name in keyframe.deg if name in kept),
            is_kept=bool(keyframe.deg) and kept.issuperset(keyframe.deg),
            is_exact=keyframe.is_exact,
            weight=keyframe.weight,
            beyond_deg={} if path is None else _beyond(keyframes, index, spacing, path, joints),
        )
        for index, (keyframe, at_s, kept_s, (rest_s, rested_s)) in enumerate(
            zip(keyframes, planned_s, held_s, rests.tolist(), strict=True)
        )
    )


def _beyond(
    keyframes: Sequence[Keyframe],
    index: int,
    spacing: Spacing,
    path: Path,
    joints: Sequence[str],
) -> dict[str, float]:
    """Return how far joints with a slope at a keyframe go beyond it and the keys around it."""
    found = {}
    for name in keyframes[index].slope_deg_s:
        own = [k for k, frame in enumerate(keyframes) if name in frame.deg]
        place = own.index(index)
        around = own[max(place - 1, 0) : place + 2]
        degs = [keyframes[k].deg[name] for k in around]
        from_s, to_s = spacing.left_s[around[0]], spacing.reached_s[around[-1]]
        between = path.between(float(from_s), float(to_s))
        out = out_of_range(between, joints.index(name), (min(degs), max(degs)))
        if (most_deg := max((deg for _, deg in out), default=0.0)) > BEYOND_MIN_DEG:
            found[name] = most_deg
    return found


def _rests(spacing: Spacing, clock: PathClock, path: Path) -> FloatArray:
    """Return how long all joints rest before the next keyframe, (n, 2): authored and planned."""
    from_s, to_s = spacing.left_s[:-1], spacing.reached_s[1:]
    resting_s = np.append(0.0, np.cumsum(path.segment_lengths_s * path.rests))
    at_s = np.interp([from_s, to_s], path.knots_s, resting_s)
    is_rest = (to_s > from_s) & (at_s[1] - at_s[0] > to_s - from_s - SAME_INSTANT_S)
    spent_s = [
        spacing.authored(to_s) - spacing.authored(from_s),
        clock.times_of(to_s) - clock.times_of(from_s),
    ]
    return np.where(is_rest, spent_s, 0.0).T


def is_met(dues: Dues, clock: PathClock) -> NDArray[np.bool_]:
    """Return which anchors are met to the millisecond."""
    anchors_s = np.asarray(dues.anchors_s)
    late_s = clock.times_of(anchors_s) - dues.authored(anchors_s)
    return np.asarray(late_s <= ANCHOR_TOLERANCE_S)


def check_anchors(
    show: Show,
    spacing: Spacing,
    clock: PathClock,
    authored: Callable[[FloatArray], FloatArray],
    stretched: Sequence[SlowSpan],
) -> None:
    """Raise `PlanningError` for the first anchor that is not met, in any pass that `clock` spans.

    In a show with several passes each pass must also end on time, so that later anchors are met.
    """
    anchors = [index for index, keyframe in enumerate(show.keyframes) if keyframe.is_anchor]
    if not anchors:
        return
    length_s = spacing.length_s
    passes = round(float(clock.path_s[-1]) / length_s) if length_s > 0.0 else 1
    for count in range(passes):
        at_s = spacing.reached_s[anchors] + count * length_s
        due_s, planned_s = authored(at_s), clock.times_of(at_s)
        for index, due, planned in zip(anchors, due_s, planned_s, strict=True):
            if abs(planned - due) > ANCHOR_TOLERANCE_S:
                raise _missed(show, index, float(due), float(planned), stretched)
    late_s = clock.duration_s - float(authored(clock.path_s[-1:])[0])
    if show.loop != 1 and late_s > ANCHOR_TOLERANCE_S:
        last = len(show.keyframes) - 1
        raise _missed(show, anchors[0], 0.0, late_s, stretched, after=" in each pass", needs=last)


def place_of(show: Show, keyframe: Keyframe) -> str:
    """Return file and line of a keyframe as messages begin; empty where they are not known."""
    is_unknown = show.path is None or keyframe.line is None
    return "" if is_unknown else f"{show.path}:{keyframe.line}: "


def _missed(
    show: Show,
    index: int,
    due_s: float,
    planned_s: float,
    stretched: Sequence[SlowSpan],
    *,
    after: str = "",
    needs: int | None = None,
) -> MissedAnchorError:
    keyframe = show.keyframes[index]
    place = place_of(show, keyframe)
    name = f" {keyframe.label!r}" if keyframe.label else ""
    late_s = planned_s - due_s
    earlier = [stretch for stretch in stretched if stretch.from_s < planned_s] or [*stretched]
    why, joint = "", None
    if earlier:
        worst = max(earlier, key=lambda stretch: stretch.by_s)
        joint = worst.joint
        why = (
            f": joint {worst.joint!r} would need {worst.limit} {significant(worst.authored)} "
            f"{worst.unit} between {worst.from_s:.3f} s and {worst.to_s:.3f} s, allowed "
            f"{worst.allowed:g} {worst.unit}"
        )
    return MissedAnchorError(
        f"{place}anchor{name} at {keyframe.at_s:g} s cannot be met{after}, it would be "
        f"{late_s:.3f} s late{why}",
        joint=joint,
        time_s=keyframe.at_s,
        index=index if needs is None else needs,
        late_s=late_s,
    )
