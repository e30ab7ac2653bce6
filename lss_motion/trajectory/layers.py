"""Layers: sequences on top of a show, blended in; the limits hold for the sum."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError, PlanningError
from lss_motion.trajectory import explain
from lss_motion.trajectory.blend import Sheet, check_jumps, summed
from lss_motion.trajectory.cache import PLANNER_VERSION, remembered
from lss_motion.trajectory.keys import SAME_INSTANT_S
from lss_motion.trajectory.model import Motion, Trajectory
from lss_motion.trajectory.path import Path, cubics
from lss_motion.trajectory.retime import slowed_windows
from lss_motion.trajectory.solve import Task
from lss_motion.trajectory.timeline import authored_clock
from lss_motion.trajectory.verify import verify

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Layer, Sequence
    from lss_motion.trajectory.blend import Sum

    FloatArray = NDArray[np.float64]

KNOTS_MAX: Final = 400_000
"""Polynomials of a layered show. Chosen: an hour of lively show, 250 MB with 18 joints."""

ACCEL_ERROR_RATIO: Final = 1e-4
"""Between knots the sum is followed so closely that its acceleration errs by less than this share
of the limit: a tenth of what the verifier allows."""

CELLS_MIN: Final = 2
"""Grid cells of a polynomial, at least. Chosen: where it matters, polynomials are a few ms long."""

STEP_MIN_S: Final = 5e-4
"""Shorter polynomials are not divided: half of what the line can express."""

OFFSET_REACH_DEG: Final = 36_000.0
"""Range of angles that are added to others: a hundred turns, as in robot files."""


def layered(
    base: Trajectory,
    show: Sequence,
    robot: Robot,
    plan: Callable[[Sequence, Robot], Trajectory],
) -> Trajectory:
    """Return `base` with the layers of `show` on top, slower only where the sum asks too much.

    Raises `InputError` where a layer would make a joint jump, `PlanningError` for a missed anchor
    or a sum that leaves a joint's range.
    """
    if base.loop is None:
        raise InputError("layers need a show that ends", path=show.path)
    if base.waits:
        raise InputError(
            "a show with layers cannot wait for a sensor, since the layers would have to stand "
            "still as well; put the layers into the parts that it plays",
            path=show.path,
        )
    sheets = tuple(_sheet(layer, base, robot, plan) for layer in show.layers)
    total = summed(base, sheets, robot)
    check_jumps(total, show)
    path = _followed(total, robot, show)
    limits = [robot.joints[name] for name in total.joints]
    task = Task(
        path=path,
        speed_max_deg_s=np.array([joint.speed_max_deg_s for joint in limits]),
        accel_max_deg_s2=np.array([joint.accel_max_deg_s2 for joint in limits]),
        knot_caps={},
        cells_min=CELLS_MIN,
    )
    trajectory = remembered(
        _name_of(task, show, base, robot), lambda: _retimed(task, total, show, robot)
    )
    _check_anchors(trajectory, show)
    return trajectory


def _sheet(
    layer: Layer, base: Trajectory, robot: Robot, plan: Callable[[Sequence, Robot], Trajectory]
) -> Sheet:
    trajectory = plan(layer.sequence, _unbounded(robot) if layer.mode == "add" else robot)
    end_s = layer.from_s + trajectory.duration_s
    if trajectory.loop is None:
        end_s = max(base.duration_s, layer.from_s)
    return Sheet(layer, trajectory, layer.from_s, end_s if layer.to_s is None else layer.to_s)


def _unbounded(robot: Robot) -> Robot:
    """Return the robot without ranges: offsets are judged when they have been added."""
    joints = {
        name: replace(joint, position_min_deg=-OFFSET_REACH_DEG, position_max_deg=OFFSET_REACH_DEG)
        for name, joint in robot.joints.items()
    }
    return replace(robot, joints=joints)


def _followed(total: Sum, robot: Robot, show: Sequence) -> Path:
    """Return the sum as cubics: exact where it is one, else divided until it is followed."""
    end_s = total.duration_s
    knots = [total.base.knots_until(end_s), np.array([0.0, end_s])]
    for sheet in total.sheets:
        fade_s = sheet.layer.fade_s
        inner_s = sheet.from_s + sheet.trajectory.knots_until(sheet.to_s - sheet.from_s)
        knots += [
            inner_s[(inner_s > sheet.from_s) & (inner_s < sheet.to_s)],
            np.array([sheet.from_s, sheet.from_s + fade_s, sheet.to_s - fade_s, sheet.to_s]),
        ]
    knots_s = np.unique(np.clip(np.concatenate(knots), 0.0, end_s))
    # Of those that are one instant the last is kept, so that the end is the end.
    knots_s = knots_s[np.append(np.diff(knots_s) > SAME_INSTANT_S, True)]
    knots_s[0] = 0.0
    allowed = ACCEL_ERROR_RATIO * np.array([robot.joints[n].accel_max_deg_s2 for n in total.joints])
    while True:
        if len(knots_s) > KNOTS_MAX:
            raise InputError(
                f"layers over {end_s:.0f} s come to more than {KNOTS_MAX:,} polynomials; layer "
                "the parts of the show instead",
                path=show.path,
            )
        path = cubics(knots_s, *total.at(knots_s))
        steps_s = path.segment_lengths_s
        is_bad = np.zeros(len(steps_s), dtype=np.bool_)
        for share in (0.25, 0.5):
            at_s = knots_s[:-1] + share * steps_s
            error_deg = np.abs(path.evaluate(at_s) - total.at(at_s)[0])
            # A cubic through ends and slopes errs by x² (h - x)² / 24 of the fourth derivative,
            # and its bend by h² / 12 of it.
            bend = error_deg * (2.0 / (share * (1.0 - share) * steps_s[:, None]) ** 2)
            is_bad |= (bend > allowed).any(axis=1)
        is_bad &= steps_s > 2.0 * STEP_MIN_S
        if not is_bad.any():
            return path
        middles_s = 0.5 * (knots_s[:-1] + knots_s[1:])[is_bad]
        knots_s = np.sort(np.concatenate([knots_s, middles_s]))


def _name_of(task: Task, show: Sequence, base: Trajectory, robot: Robot) -> str:
    digest = hashlib.sha256()
    for array in (task.path.knots_s, task.path.coefficients):
        digest.update(np.ascontiguousarray(array).tobytes())
    joints = [replace(joint, settings={}) for joint in robot.joints.values()]
    digest.update(repr((PLANNER_VERSION, show.name, base.marks, base.stretched, joints)).encode())
    return digest.hexdigest()


def _retimed(task: Task, total: Sum, show: Sequence, robot: Robot) -> Trajectory:
    """Return the sum at its own times, slower where a limit binds."""
    windows = slowed_windows(task)
    clock = authored_clock(task.path, windows, (), lambda path_s: path_s)
    motion = Motion(path=task.path, clock=clock)

    def moved(times_s: list[float]) -> list[float]:
        return [float(at_s) for at_s in clock.times_of(np.array(times_s))]

    marks = [*total.base.marks]
    for sheet in total.sheets:
        marks += [
            replace(
                mark,
                planned_s=mark.planned_s + sheet.from_s,
                authored_s=None if mark.authored_s is None else mark.authored_s + sheet.from_s,
            )
            for mark in sheet.trajectory.marks
            if mark.planned_s + sheet.from_s <= sheet.to_s
        ]
    stretched = [*explain.stretches(task, total.joints, windows, clock, lambda path_s: path_s)]
    for stretch in total.base.stretched:
        from_s, to_s = moved([stretch.from_s, stretch.to_s])
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
                    replace(mark, planned_s=at_s)
                    for mark, at_s in zip(
                        marks, moved([mark.planned_s for mark in marks]), strict=True
                    )
                ),
                key=lambda mark: mark.planned_s,
            )
        ),
    )
    verify(trajectory, robot)
    return trajectory


def _check_anchors(trajectory: Trajectory, show: Sequence) -> None:
    place = "" if show.path is None else f"{show.path}: "
    for mark in trajectory.marks:
        if not mark.is_anchor or mark.authored_s is None:
            continue
        late_s = mark.planned_s - mark.authored_s
        if abs(late_s) > explain.ANCHOR_TOLERANCE_S:
            name = f" {mark.label!r}" if mark.label else ""
            raise PlanningError(
                f"{place}anchor{name} at {mark.authored_s:g} s cannot be met with the layers, it "
                f"would be {late_s:.3f} s late; lower a weight, or fade longer",
                time_s=mark.authored_s,
            )
