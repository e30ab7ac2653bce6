"""Layers: sequences on top of a show, blended in; the limits hold for the sum.

The show and its layers are first summed as if there were no limits (`LayeredSum`), then followed
by cubics, then slowed where the sum exceeds a limit.
"""

from __future__ import annotations

import hashlib
import math
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.trajectory import explain
from lss_motion.planning.trajectory.curves import Path, cubics
from lss_motion.planning.trajectory.dues import Dues
from lss_motion.planning.trajectory.kept_plans import kept_plan
from lss_motion.planning.trajectory.keys import SAME_INSTANT_S
from lss_motion.planning.trajectory.model import PathMotion, Summand, Trajectory, with_span
from lss_motion.planning.trajectory.playlist import all_cues, all_marks
from lss_motion.planning.trajectory.retime import (
    authored_clock,
    rate_task,
    timed_windows,
    united,
    with_reserve,
)
from lss_motion.planning.trajectory.smoothing import even_clock, jerk_limits, limited, smooth_too
from lss_motion.planning.trajectory.tracks import PERIOD_MAX_S, common_period_s
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.parts import time_keepers
from lss_motion.show.splines import distinct
from lss_motion.units import significant

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Mark, PathClock, SlowSpan
    from lss_motion.planning.trajectory.solver import RateTask, RateWindow
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Cue, Layer, Sequence

    FloatArray = NDArray[np.float64]


JUMP_DEG: Final = 1e-6
JUMP_DEG_S: Final = 1e-3
"""Angles and speeds on both sides of an instant are equal if they differ by less: rounding."""

SIDE_S: Final = 1e-9
"""Distance of the samples on both sides of an instant."""

KNOTS_MAX: Final = 400_000
"""Polynomials of a layered show. Chosen: an hour of lively show, 250 MB with 18 joints."""

ACCEL_ERROR_RATIO: Final = 1e-4
"""The acceleration of the cubics differs from that of the sum by less than this share of the limit:
a tenth of what the verifier allows."""

SMOOTH_ERROR_RATIO: Final = 1e-5
"""The same where the jerk is limited: errors of the acceleration are jumps of it."""

CELLS_MIN: Final = 2
"""Grid cells of a polynomial, at least. Chosen: where it matters, polynomials are a few ms long."""

STEP_MIN_S: Final = 5e-4
"""Shorter polynomials are not divided: half of the 1 ms unit of a timed move."""

OFFSET_REACH_DEG: Final = 36_000.0
"""Range of angles that are added to others: a hundred turns, as in robot files."""


def layered(
    base: Trajectory,
    show: Sequence,
    robot: Robot,
    plan: Callable[[Sequence, Robot], Trajectory],
) -> Trajectory:
    """Return `base` with the layers of `show` on top, slowed only where the sum exceeds a limit.

    A show that never ends repeats what follows the layers that end. Raises
    `InputError` where a layer would make a joint jump, `PlanningError` for a missed anchor or a sum
    that leaves a joint's range.
    """
    if base.waits:
        raise InputError(
            "a show with layers cannot wait for a sensor, since the layers would have to stand "
            "still as well; put the layers into the parts that it plays",
            path=show.path,
        )
    layers = tuple(_placed(layer, base, show, robot, plan) for layer in show.layers)
    if base.loop is None:
        return _forever(base, layers, show, robot)
    return _summed(layered_sum(base, layers, robot), show, robot)


def _summed(total: LayeredSum, show: Sequence, robot: Robot) -> Trajectory:
    """Return the sum within all limits."""
    check_jumps(total, show)
    is_smooth = bool(np.isfinite(jerk_limits(show, robot, total.joints)).any())
    path = _as_cubics(total, robot, show, is_smooth=is_smooth)
    summands = (
        Summand(trajectory=total.base, from_s=0.0, to_s=total.duration_s),
        *(Summand(trajectory=p.trajectory, from_s=p.from_s, to_s=p.to_s) for p in total.layers),
    )
    try:
        if kept := time_keepers(show) & {*total.joints}:
            return replace(_with_kept(path, total, show, robot, kept), summands=summands)
        return replace(_slowed(path, total, show, robot), summands=summands)
    except PlanningError as error:
        if error.joint is None:
            raise
        place = "" if show.path is None else f"{show.path}: "
        raise PlanningError(
            f"{place}with the layers, {error.reason}. Lower a weight, fade longer, or move less in "
            "one of them",
            joint=error.joint,
            time_s=error.time_s,
        ) from error


def _forever(
    base: Trajectory, layers: tuple[PlacedLayer, ...], show: Sequence, robot: Robot
) -> Trajectory:
    """Return an endless show with its layers: a show that ends, of which a span is looped.

    The span is the common period of all that never ends. It begins with a pass of the show, when
    the other layers are over.
    """
    lasting = [placed for placed in layers if math.isinf(placed.to_s)]
    loops = [base, *(placed.trajectory for placed in lasting)]
    for loop in loops:
        if np.abs(loop.last.sample(np.array([loop.last.duration_s]), 1)).max() > JUMP_DEG_S:
            raise InputError(
                f"layers on a show that never ends: the tracks of {loop.name!r} never rest "
                "together; loop one sequence of keyframes forever, and put the tracks into layers",
                path=show.path,
            )
    period_s = common_period_s(loops, "the show and its layers")
    over_s = [
        placed.from_s + placed.trajectory.first.duration_s + placed.layer.fade_s
        if math.isinf(placed.to_s)
        else placed.to_s
        for placed in layers
    ]
    first_s, pass_s = base.first.duration_s, base.middle.duration_s
    from_s = first_s + pass_s * math.ceil(max(0.0, max(over_s) - first_s) / pass_s)
    to_s = from_s + period_s
    if from_s > max(first_s, PERIOD_MAX_S):
        raise InputError(
            f"the layers end {from_s:,.0f} s after the start of a show that never ends; "
            f"at most {PERIOD_MAX_S:g} s can be planned before it repeats",
            path=show.path,
        )
    ends_s = to_s + pass_s + max(placed.layer.fade_s for placed in layers)
    finite = _until(base, ends_s)
    parts = [replace(p, trajectory=_until(p.trajectory, ends_s - p.from_s)) for p in lasting]
    ends_s = max([finite.duration_s, *(p.from_s + p.trajectory.duration_s for p in parts)])
    lasts = iter([replace(part, to_s=ends_s) for part in parts])
    placed = tuple(next(lasts) if math.isinf(p.to_s) else p for p in layers)
    total = layered_sum(finite, placed, robot)
    whole = _summed(total, show, robot)
    whole = replace(
        whole,
        marks=_moved(_marks(total, in_all_passes=True), whole),
        cues=_cues(base, layers, whole, to_s),
    )
    span_s = _show_times(whole, [from_s, to_s])
    return with_span(show, whole, (span_s[0], span_s[1]), None)


def _cues(
    base: Trajectory, layers: tuple[PlacedLayer, ...], whole: Trajectory, end_s: float
) -> tuple[Cue, ...]:
    """Return the cues of the show and of its layers up to `end_s`, at their times in the plan."""
    found = [*all_cues(base, end_s)]
    for placed in layers:
        until_s = min(placed.to_s, end_s) - placed.from_s
        own = all_cues(placed.trajectory, until_s) if until_s > 0.0 else ()
        found += [replace(cue, at_s=placed.from_s + cue.at_s) for cue in own if cue.at_s <= until_s]
    found = [cue for cue in found if cue.at_s <= end_s]
    times_s = _show_times(whole, [cue.at_s for cue in found])
    return tuple(replace(cue, at_s=at_s) for cue, at_s in zip(found, times_s, strict=True))


def _until(trajectory: Trajectory, end_s: float) -> Trajectory:
    """Return an endless trajectory with so many passes that it ends after `end_s`."""
    passes = math.ceil((end_s - trajectory.first.duration_s) / trajectory.middle.duration_s)
    return replace(trajectory, loop=max(2, 2 + passes))


def _show_times(layered: Trajectory, times_s: list[float]) -> list[float]:
    """Return when instants of the sum, which has no limits, are reached in the plan."""
    if not isinstance(layered.first, PathMotion):
        return times_s  # Joints that keep their time are beside others, which are late by nothing.
    return [float(at_s) for at_s in layered.first.clock.times_of(np.array(times_s))]


def _moved(marks: list[Mark], whole: Trajectory) -> tuple[Mark, ...]:
    """Return marks of the sum at their times in the plan."""
    at_s = _show_times(whole, [mark.planned_s for mark in marks])
    ends_s = _show_times(whole, [mark.planned_s + mark.held_s for mark in marks])
    return tuple(
        replace(mark, planned_s=start_s, held_s=end_s - start_s)
        for mark, start_s, end_s in zip(marks, at_s, ends_s, strict=True)
    )


def _with_kept(
    path: Path, total: LayeredSum, show: Sequence, robot: Robot, kept: set[str]
) -> Trajectory:
    """Return the sum: some joints keep their time and give up angle, the others are slowed."""
    from lss_motion.planning.trajectory.keep_time import beside, sum_kept

    def part(names: set[str]) -> tuple[Path, tuple[str, ...]]:
        columns = [column for column, name in enumerate(total.joints) if name in names]
        own = Path(knots_s=path.knots_s, coefficients=path.coefficients[:, :, columns])
        return own, tuple(total.joints[column] for column in columns)

    own_path, names = part(kept)
    in_passes = _marks(total, in_all_passes=True)
    own = kept_plan(
        _kept_name(own_path, names, in_passes, show, robot),
        lambda: sum_kept(own_path, names, robot, marks=in_passes, show=show),
        robot,
    )
    below = [(0.0, total.base), *((placed.from_s, placed.trajectory) for placed in total.layers)]
    given_up = [span.later(from_s) for from_s, under in below for span in under.given_up]
    own = replace(
        own,
        given_up=tuple(sorted((*own.given_up, *given_up), key=lambda span: span.from_s)),
        asked=(*own.asked, *(s.later(from_s) for from_s, under in below for s in under.asked)),
        marks=tuple(_marks(total)),
    )
    others = {*total.joints} - kept
    if not others:
        return own
    slow_path, slow_names = part(others)
    slow = _slowed(slow_path, replace(total, joints=slow_names), show, robot)
    trajectory = beside(slow, own, robot, [mark.is_kept for mark in own.marks])
    verify(trajectory, robot, has_parts=False)
    return trajectory


def _kept_name(
    path: Path, names: tuple[str, ...], marks: list[Mark], show: Sequence, robot: Robot
) -> str:
    digest = hashlib.sha256()
    for array in (path.knots_s, path.coefficients):
        digest.update(np.ascontiguousarray(array).tobytes())
    joints = [replace(robot.joints[name], settings={}) for name in names]
    digest.update(repr((show.name, "kept", show.smooth_s, marks, joints)).encode())
    return digest.hexdigest()


def _slowed(path: Path, total: LayeredSum, show: Sequence, robot: Robot) -> Trajectory:
    """Return the sum along its path, slowed only where it exceeds a limit."""
    jerk_max = jerk_limits(show, robot, total.joints)
    task = rate_task(path, total.joints, robot, knot_caps={}, cells_min=CELLS_MIN)
    if task.servos is not None and np.isfinite(jerk_max).any():
        raise InputError(
            "a show with layers cannot keep a jerk limit of joints that stand behind a linkage or "
            "a differential; remove jerk_max_deg_s3 or smooth_s, or the layers",
            path=show.path,
        )
    trajectory = kept_plan(
        _cache_name(task, show, total, robot),
        lambda: _retimed(task, total, show, robot, jerk_max),
        robot,
    )
    _check_anchors(trajectory, show)
    return trajectory


def _placed(
    layer: Layer,
    base: Trajectory,
    show: Sequence,
    robot: Robot,
    plan: Callable[[Sequence, Robot], Trajectory],
) -> PlacedLayer:
    sequence = smooth_too(layer.sequence, show.smooth_s)
    trajectory = plan(sequence, _unbounded(robot) if layer.mode == "add" else robot)
    end_s = layer.from_s + trajectory.duration_s
    if trajectory.loop is None:
        end_s = max(base.duration_s, layer.from_s)
    to_s = end_s if layer.to_s is None else layer.to_s
    is_smooth = bool(np.isfinite(jerk_limits(show, robot, tuple(robot.joints))).any())
    return PlacedLayer(layer, trajectory, layer.from_s, to_s, is_smooth)


def _unbounded(robot: Robot) -> Robot:
    """Return the robot without ranges and mechanisms: the limits of the sum are checked instead."""
    joints = {
        name: replace(joint, position_min_deg=-OFFSET_REACH_DEG, position_max_deg=OFFSET_REACH_DEG)
        for name, joint in robot.joints.items()
    }
    return replace(robot, joints=joints, mechanisms={}, servos={})


def _knots_count(total: LayeredSum) -> float:
    """Return how many knots the show and its layers have, all passes included."""
    spans = [(total.base, total.duration_s)]
    spans += [(placed.trajectory, placed.to_s - placed.from_s) for placed in total.layers]
    found = 0.0
    for trajectory, span_s in spans:
        period_s = max(trajectory.middle.duration_s, 1e-3)
        passes = min(trajectory.loop or math.inf, 1.0 + span_s / period_s)
        found += passes * len(trajectory.middle.knots_s)
    return found


def _too_many(end_s: float, show: Sequence) -> InputError:
    return InputError(
        f"layers over {end_s:.0f} s come to more than {KNOTS_MAX:,} polynomials; layer the parts "
        "of the show instead",
        path=show.path,
    )


def _as_cubics(total: LayeredSum, robot: Robot, show: Sequence, *, is_smooth: bool) -> Path:
    """Return the sum as cubics, divided until their acceleration error is below the limit."""
    end_s = total.duration_s
    if _knots_count(total) > KNOTS_MAX:  # Before they are made: a loop can have a million passes.
        raise _too_many(end_s, show)
    knots = [total.base.knots_until(end_s), np.array([0.0, end_s])]
    for placed in total.layers:
        fade_s = placed.layer.fade_s
        inner_s = placed.from_s + placed.trajectory.knots_until(placed.to_s - placed.from_s)
        knots += [
            inner_s[(inner_s > placed.from_s) & (inner_s < placed.to_s)],
            np.array([placed.from_s, placed.from_s + fade_s, placed.to_s - fade_s, placed.to_s]),
        ]
    knots_s = distinct(np.clip(np.concatenate(knots), 0.0, end_s))
    # Of knots at one instant the last is kept, so that the last knot is exactly `end_s`.
    knots_s = knots_s[np.append(np.diff(knots_s) > SAME_INSTANT_S, True)]
    knots_s[0] = 0.0
    share = SMOOTH_ERROR_RATIO if is_smooth else ACCEL_ERROR_RATIO
    allowed = share * np.array([robot.joints[n].accel_max_deg_s2 for n in total.joints])
    while True:
        if len(knots_s) > KNOTS_MAX:
            raise _too_many(end_s, show)
        path = cubics(knots_s, *total.at(knots_s))
        steps_s = path.segment_lengths_s
        is_bad = np.zeros(len(steps_s), dtype=np.bool_)
        for share in (0.25, 0.5):
            at_s = knots_s[:-1] + share * steps_s
            error_deg = np.abs(path.evaluate(at_s) - total.at(at_s)[0])
            # At x in a step h, the error of a Hermite cubic is x² (h - x)² / 24 times the fourth
            # derivative; the error of its second derivative is h² / 12 times it.
            bend = error_deg * (2.0 / (share * (1.0 - share) * steps_s[:, None]) ** 2)
            is_bad |= (bend > allowed).any(axis=1)
        is_bad &= steps_s > 2.0 * STEP_MIN_S
        if not is_bad.any():
            return path
        middles_s = 0.5 * (knots_s[:-1] + knots_s[1:])[is_bad]
        knots_s = np.sort(np.concatenate([knots_s, middles_s]))


def _cache_name(task: RateTask, show: Sequence, total: LayeredSum, robot: Robot) -> str:
    digest = hashlib.sha256()
    for array in (task.path.knots_s, task.path.coefficients):
        digest.update(np.ascontiguousarray(array).tobytes())
    joints = [replace(joint, settings={}) for joint in robot.joints.values()]
    joints += [replace(servo, settings={}) for servo in robot.servos.values()]
    parts = [total.base, *(placed.trajectory for placed in total.layers)]
    found = [(part.marks, part.stretched) for part in parts]
    digest.update(
        repr((show.name, show.smooth_s, found, joints, *robot.mechanisms.values())).encode()
    )
    return digest.hexdigest()


def _retimed(
    task: RateTask, total: LayeredSum, show: Sequence, robot: Robot, jerk_max: FloatArray
) -> Trajectory:
    """Return the sum at its own times, slowed where it exceeds a limit."""
    slowed: SlowSpan | None = None
    windows: list[RateWindow] = []
    dues = Dues(
        authored=lambda path_s: path_s,
        keys_s=_keys_s(total),
        held=_held(total),
        anchors_s=_anchors_s(total),
    )
    if np.isfinite(jerk_max).any():
        clock, slowed = even_clock(task, total.joints, jerk_max)
    else:

        def follow(task: RateTask, _: object) -> tuple[list[RateWindow], PathClock]:
            found = timed_windows(task, dues)
            return found, authored_clock(task.path, found, (), dues)

        met = partial(explain.is_met, dues)
        task, (windows, clock) = with_reserve(task, follow, is_met=met)
    motion = PathMotion(path=task.path, clock=clock)

    def moved(times_s: list[float]) -> list[float]:
        return [float(at_s) for at_s in clock.times_of(np.array(times_s))]

    marks = _marks(total)
    ends_s = moved([mark.planned_s + mark.held_s for mark in marks])
    stretched = [*explain.slow_spans(task, total.joints, windows, clock, dues)]
    if slowed is not None:
        stretched.append(slowed)
    below = [(0.0, total.duration_s, total.base)]
    below += [(placed.from_s, placed.to_s, placed.trajectory) for placed in total.layers]
    for start_s, end_s, part in below:
        for stretch in part.stretched:
            if start_s + stretch.from_s < end_s:
                from_s, to_s = moved([start_s + stretch.from_s, start_s + stretch.to_s])
                stretched.append(replace(stretch, from_s=from_s, to_s=to_s))
    trajectory = Trajectory(
        name=show.name,
        joints=total.joints,
        first=motion,
        middle=motion,
        last=motion,
        stretched=tuple(sorted(stretched, key=lambda stretch: stretch.from_s)),
        marks=tuple(
            sorted(
                (
                    replace(mark, planned_s=at_s, held_s=end_s - at_s)
                    for mark, at_s, end_s in zip(
                        marks, moved([mark.planned_s for mark in marks]), ends_s, strict=True
                    )
                ),
                key=lambda mark: mark.planned_s,
            )
        ),
        smoothing=limited(total.joints, jerk_max),
    )
    verify(trajectory, robot)
    return trajectory


def _marks(total: LayeredSum, *, in_all_passes: bool = False) -> list[Mark]:
    """Return the keyframes of the show and of its layers, in order, before the sum is slowed."""
    sources = [(0.0, total.base, total.duration_s)]
    sources += [(placed.from_s, placed.trajectory, placed.to_s) for placed in total.layers]
    found = []
    for from_s, trajectory, to_s in sources:
        marks = all_marks(trajectory, to_s - from_s) if in_all_passes else trajectory.marks
        later = [mark.later(from_s) for mark in marks]
        found += [m for m in later if trajectory is total.base or m.planned_s <= to_s]
    return sorted(found, key=lambda mark: mark.planned_s)


def _held(total: LayeredSum) -> FloatArray:
    """Return from when to when a hold of the show or of a layer must be kept, (n, 2)."""
    spans = []
    sources = [(0.0, total.base, total.duration_s)]
    sources += [(placed.from_s, placed.trajectory, placed.to_s) for placed in total.layers]
    for from_s, trajectory, to_s in sources:
        for mark in all_marks(trajectory, to_s - from_s):
            start_s = from_s + mark.planned_s
            must_hold = mark.hold_s > 0.0 and not (mark.hold_may_shrink or mark.is_kept)
            if must_hold and start_s < to_s:
                spans.append([start_s, min(start_s + mark.held_s, to_s)])
    return united(np.array(spans).reshape(-1, 2))


def _keys_s(total: LayeredSum) -> FloatArray:
    """Return when keys of the show and of its layers are reached and left, before the sum."""
    marks = _marks(total, in_all_passes=True)
    ends_s = [(mark.planned_s, mark.planned_s + mark.held_s) for mark in marks]
    found = distinct(np.array(ends_s, dtype=np.float64).ravel())
    return np.asarray(found[found <= total.duration_s])


def _anchors_s(total: LayeredSum) -> tuple[float, ...]:
    """Return when anchors of the show and of its layers are planned before they are added up."""
    marks = _marks(total, in_all_passes=True)
    found = [mark.planned_s for mark in marks if mark.is_anchor and not mark.is_kept]
    return tuple(sorted({at_s for at_s in found if at_s <= total.duration_s}))


def _check_anchors(trajectory: Trajectory, show: Sequence) -> None:
    place = "" if show.path is None else f"{show.path}: "
    for mark in trajectory.marks:
        if not mark.is_anchor or mark.authored_s is None or mark.is_kept:
            continue
        late_s = mark.planned_s - mark.authored_s
        if abs(late_s) > explain.ANCHOR_TOLERANCE_S:
            name = f" {mark.label!r}" if mark.label else ""
            raise explain.MissedUnderLayersError(
                f"{place}anchor{name} at {mark.authored_s:g} s cannot be met with the layers, it "
                f"would be {late_s:.3f} s late",
                time_s=mark.authored_s,
            )


class PlacedLayer(Struct, frozen=True):
    """One layer with its plan, in the show from `from_s` to `to_s`."""

    layer: Layer
    trajectory: Trajectory
    from_s: float
    to_s: float
    is_smooth: bool
    """It fades without jumps of the acceleration."""

    def weights(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weight of the layer at each instant, and the derivative of the weight."""
        fade_s = self.layer.fade_s
        rise, rise_slope = _step(times_s - self.from_s, fade_s, is_smooth=self.is_smooth)
        fall, fall_slope = _step(self.to_s - times_s, fade_s, is_smooth=self.is_smooth)
        weight = self.layer.weight
        return weight * rise * fall, weight * (rise_slope * fall - rise * fall_slope)


def _step(since_s: FloatArray, fade_s: float, *, is_smooth: bool) -> tuple[FloatArray, FloatArray]:
    """Return a step from 0 to 1 within `fade_s`, and its derivative.

    `is_smooth`: its second derivative does not jump, for which it is steeper in the middle.
    """
    if fade_s <= 0.0:
        return np.where(since_s >= 0.0, 1.0, 0.0), np.zeros_like(since_s)
    share = np.clip(since_s / fade_s, 0.0, 1.0)
    left = 1.0 - share
    if is_smooth:
        value = share**3 * (10.0 - share * (15.0 - 6.0 * share))
        return value, 30.0 * (share * left) ** 2 / fade_s
    return share * share * (3.0 - 2.0 * share), 6.0 * share * left / fade_s


class LayeredSum(Struct, frozen=True):
    """The show and its layers added up, as if there were no limits."""

    joints: tuple[str, ...]
    base: Trajectory
    layers: tuple[PlacedLayer, ...]
    rest_deg: FloatArray
    """Angles of joints that only layers move, before their layer starts."""

    @property
    def duration_s(self) -> float:
        return max([self.base.duration_s, *(placed.to_s for placed in self.layers)])

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angles and speeds, (n, joints)."""
        deg = np.tile(self.rest_deg, (len(times_s), 1))
        speed = np.zeros_like(deg)
        columns = [self.joints.index(name) for name in self.base.joints]
        deg[:, columns] = self.base.sample(times_s)
        speed[:, columns] = self.base.sample(times_s, 1)
        for placed in self.layers:
            rows = np.flatnonzero((times_s >= placed.from_s) & (times_s <= placed.to_s))
            if len(rows):
                self._add_layer(placed, times_s[rows], rows, (deg, speed))
        return deg, speed

    def _add_layer(
        self,
        placed: PlacedLayer,
        times_s: FloatArray,
        rows: NDArray[np.intp],
        below: tuple[FloatArray, FloatArray],
    ) -> None:
        own = [k for k, name in enumerate(placed.trajectory.joints) if name in placed.layer.joints]
        columns = [self.joints.index(placed.trajectory.joints[k]) for k in own]
        place = np.ix_(rows, np.array(columns, dtype=np.intp))
        top_deg = placed.trajectory.sample(times_s - placed.from_s)[:, own]
        top_speed = placed.trajectory.sample(times_s - placed.from_s, 1)[:, own]
        if placed.layer.mode == "override":
            top_deg -= below[0][place]
            top_speed -= below[1][place]
        weight, growth = (value[:, None] for value in placed.weights(times_s))
        below[0][place] += weight * top_deg
        below[1][place] += weight * top_speed + growth * top_deg


def layered_sum(base: Trajectory, layers: tuple[PlacedLayer, ...], robot: Robot) -> LayeredSum:
    """Return the sum.

    Raises `InputError` for a layer that adds to a joint to which nothing below gives an angle.
    """
    rest_deg: dict[str, float] = {}
    for placed in layers:
        if placed.layer.mode == "override":
            start_deg = placed.trajectory.sample(np.zeros(1))[0].tolist()
            for name, angle_deg in zip(placed.trajectory.joints, start_deg, strict=True):
                if name in placed.layer.joints:
                    rest_deg.setdefault(name, angle_deg)
    moved = {*base.joints}
    for placed in layers:
        own = {*placed.trajectory.joints} & {*placed.layer.joints}
        if placed.layer.mode == "add" and (alone := sorted(own - moved - {*rest_deg})):
            raise InputError(
                f"a layer adds to joint {alone[0]!r}, but nothing below it moves that joint",
                path=placed.layer.sequence.path,
                line=placed.layer.line,
            )
        moved |= own
    joints = tuple(name for name in robot.joints if name in moved)
    return LayeredSum(joints, base, layers, np.array([rest_deg.get(name, 0.0) for name in joints]))


def check_jumps(total: LayeredSum, show: Sequence) -> None:
    """Raise `InputError` where a layer begins or ends with a jump of angle or speed."""
    for placed in total.layers:
        for at_s in (placed.from_s, placed.to_s):
            if not 0.0 < at_s < total.duration_s:
                continue
            sides = at_s + SIDE_S * np.array([-2.0, -1.0, 1.0, 2.0])
            # Both sides are extrapolated to the instant, so that curvature does not count.
            deg, speed = (
                np.abs(2.0 * value[2] - value[3] - 2.0 * value[1] + value[0])
                for value in total.at(sides)
            )
            if deg.max() > JUMP_DEG or speed.max() > JUMP_DEG_S:
                column = int((deg + speed).argmax())
                raise InputError(
                    f"layer {placed.layer.sequence.name!r} would make joint "
                    f"{total.joints[column]!r} jump by {significant(deg[column], 3)} deg and "
                    f"{significant(speed[column], 3)} deg/s at {at_s:g} s; give it a fade_s",
                    path=show.path,
                    line=placed.layer.line,
                )
