"""From rest to rest as quickly as the limits allow: ours, ruckig, and the closed form.

The closed form is the trapezoid of the joint that takes longest; nothing can be quicker. ruckig
(state to state, no jerk limit, never its cloud) is the usual tool for one such move, and stops at
every keyframe of a show; toppra, and so ours, goes through.
"""

from __future__ import annotations

import statistics
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from benches.plan import empty_cache
from benches.shows import ACCEL_MAX_DEG_S2, RANGE_DEG, SPEED_MAX_DEG_S, lively_show, robot_of
from benches.table import Row, interleaved
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Keyframe, Sequence, Timing

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]
    Ruckig = Callable[[FloatArray, FloatArray], float]

JOINTS = 18
MOVES = 20
SMALLEST_RATIO = 0.01
"""Moves reach from the whole range down to this much of it."""
SHOW_S = 60.0
REPEATS = 5
DURATION_TARGET = 1.01


def measure() -> list[Row]:
    """Return durations and processor time of single moves, and the duration of a whole show."""
    robot = robot_of(JOINTS)
    random = np.random.default_rng(2)
    sizes = RANGE_DEG * np.geomspace(1.0, SMALLEST_RATIO, MOVES)
    targets = [size * random.uniform(-1.0, 1.0, JOINTS) for size in sizes]
    shows = [_move(robot, target_deg) for target_deg in targets]
    ruckig = _ruckig()
    start = np.zeros(JOINTS)
    with empty_cache():
        ours_s = np.array([plan(show, robot).duration_s for show in shows])
    shortest_s = np.array([closed_form_s(float(np.abs(target).max())) for target in targets])
    rows = [
        Row(
            what=f"{MOVES} moves of {JOINTS} joints, rest to rest",
            ours=f"{ours_s.mean():.4f} s in the mean",
            reference=f"{shortest_s.mean():.4f} s, closed form",
            ratio=float((ours_s / shortest_s).max()),
            target=f"<= {DURATION_TARGET:g}, each",
            is_met=bool((ours_s <= DURATION_TARGET * shortest_s).all()),
        )
    ]
    if ruckig is None:
        return [*rows, Row(what="the same, ruckig", ours="", reference="ruckig is not installed")]
    theirs_s = np.array([ruckig(start, target) for target in targets])
    cost_s = interleaved(
        lambda: [_cold(show, robot) for show in shows],
        lambda: [ruckig(start, target) for target in targets],
        repeats=REPEATS,
    )
    return [
        *rows,
        Row(
            what="  the same, ruckig",
            ours=f"{ours_s.mean():.4f} s in the mean",
            reference=f"{theirs_s.mean():.4f} s",
            ratio=float((ours_s / theirs_s).max()),
            target=f"<= {DURATION_TARGET:g}, each",
            is_met=bool((ours_s <= DURATION_TARGET * theirs_s).all()),
        ),
        Row(
            what="  time to find one (ours: any path, verified at 1 kHz)",
            ours=f"{1e3 * cost_s[0] / MOVES:.2f} ms",
            reference=f"{1e3 * cost_s[1] / MOVES:.3f} ms, ruckig",
            ratio=cost_s[0] / cost_s[1],
        ),
        _through_or_stopping(robot, ruckig),
    ]


def closed_form_s(distance_deg: float) -> float:
    """Return the shortest time from rest to rest with the limits of the bench's joints."""
    if distance_deg > SPEED_MAX_DEG_S**2 / ACCEL_MAX_DEG_S2:
        return distance_deg / SPEED_MAX_DEG_S + SPEED_MAX_DEG_S / ACCEL_MAX_DEG_S2
    return 2.0 * (distance_deg / ACCEL_MAX_DEG_S2) ** 0.5


def _move(robot: Robot, target_deg: FloatArray) -> Sequence:
    frames = [dict.fromkeys(robot.joints, 0.0), dict(zip(robot.joints, target_deg, strict=True))]
    keyframes = tuple(Keyframe(deg=deg) for deg in frames)
    return Sequence(name="move", keyframes=keyframes, timing=Timing.FASTEST)


def _cold(show: Sequence, robot: Robot) -> None:
    with empty_cache():
        plan(show, robot)


def _through_or_stopping(robot: Robot, ruckig: Ruckig) -> Row:
    """Compare a whole show: through its keyframes, or from one to the next with a stop at each."""
    show = lively_show(robot, SHOW_S, seed=1)
    show = Sequence(name=show.name, keyframes=show.keyframes, timing=Timing.FASTEST)
    with empty_cache():
        trajectory = plan(show, robot)
    angles_deg = trajectory.sample(np.array([mark.planned_s for mark in trajectory.marks]))
    stopping_s = [ruckig(before, after) for before, after in pairwise(angles_deg)]
    return Row(
        what=f"fastest through {len(angles_deg)} keyframes",
        ours=f"{trajectory.duration_s:.1f} s",
        reference=f"{sum(stopping_s):.1f} s, ruckig, {statistics.mean(stopping_s):.2f} s a move",
        ratio=trajectory.duration_s / sum(stopping_s),
        target="< 1",
        is_met=trajectory.duration_s < sum(stopping_s),
    )


def _ruckig() -> Ruckig | None:
    """Return what ruckig takes from one place to another, all joints arriving together."""
    try:
        from ruckig import InputParameter, Result, Ruckig, Trajectory
    except ImportError:
        return None

    def duration_s(from_deg: FloatArray, to_deg: FloatArray) -> float:
        question = InputParameter(JOINTS)
        question.current_position, question.target_position = from_deg.tolist(), to_deg.tolist()
        question.max_velocity = [SPEED_MAX_DEG_S] * JOINTS
        question.max_acceleration = [ACCEL_MAX_DEG_S2] * JOINTS
        answer = Trajectory(JOINTS)
        assert Ruckig(JOINTS).calculate(question, answer) == Result.Working
        return float(answer.duration)

    return duration_s
