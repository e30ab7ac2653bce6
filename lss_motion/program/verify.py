"""The last word on a program: the motion that its bytes ask for, held against every limit.

What the bus carries is rounded: angles to tenths or hundredths, times to milliseconds. So the
profile that the servos make of the very bytes is looked at again, piece by piece, with formulas of
its own and without a word from planner or fit. A program that a person has edited comes here too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import PlanningError
from lss_motion.program.predict import driven, profiles
from lss_motion.program.step import PULSE_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from lss_motion.program.model import Program
    from lss_motion.program.response import Reference
    from lss_motion.robot.model import Joint, Robot

EXCESS_MAX_RATIO: Final = 1.001
"""A limit may be exceeded by 0.1 % (FACTS.md A19)."""
JUMP_MAX_DEG: Final = 1e-6
"""Pieces that follow one another must meet: rounding of numbers, far below the wire's unit."""


def verify_program(program: Program, robot: Robot) -> None:
    """Raise `PlanningError` where the profile of a servo breaks a limit of its joint.

    Position: outside of the range by more than one wire unit. Speed and acceleration: more than
    0.1 % above the limit. A profile that jumps is a fault too. The error names joint and time.

    A streamed joint has no ramps: its steps keep the speed limit but for what the wire rounds, and
    what bounds its acceleration is the plan that it follows. A stepped one jumps, so its jumps are
    held against the speed limit and the time since the one before.
    """
    verify_profiles(profiles(program, robot), driven(robot, program))


def verify_profiles(references: Mapping[str, Reference], robot: Robot) -> None:
    """Raise what `verify_program` raises, for profiles by joint."""
    for name, reference in references.items():
        if robot.joints[name].drive == "stepped":
            _check_jumps(robot.joints[name], *reference.table[:2])
        else:
            _check(robot.joints[name], *reference.table)


def _check_jumps(
    joint: Joint, start_s: NDArray[np.float64], position_deg: NDArray[np.float64]
) -> None:
    """Look at a staircase: where its steps are, and how high for the time that they had."""
    _check_range(joint, start_s, position_deg[None, :])
    passed_s = np.maximum(np.diff(start_s), PULSE_S)
    allowed_deg = joint.unit_deg + EXCESS_MAX_RATIO * joint.speed_max_deg_s * passed_s
    is_bad = np.abs(np.diff(position_deg)) > allowed_deg
    _refuse(joint, is_bad, start_s[1:], f"would jump faster than {joint.speed_max_deg_s:g} deg/s")


def _check_range(
    joint: Joint, start_s: NDArray[np.float64], extreme_deg: NDArray[np.float64]
) -> None:
    """Look at the places, (any, pieces), that a profile comes to."""
    unit_deg = joint.unit_deg
    ends_deg = sorted(map(joint.servo_deg, (joint.position_min_deg, joint.position_max_deg)))
    outside = (extreme_deg < ends_deg[0] - unit_deg) | (extreme_deg > ends_deg[1] + unit_deg)
    worst_deg = extreme_deg[outside].flat[0] if outside.any() else 0.0
    _refuse(
        joint,
        np.any(outside, axis=0),
        start_s,
        f"would be at {joint.joint_deg(float(worst_deg)):.2f} deg, allowed "
        f"{joint.position_min_deg:g} to {joint.position_max_deg:g} deg",
    )


def _check(
    joint: Joint,
    start_s: NDArray[np.float64],
    position_deg: NDArray[np.float64],
    speed_deg_s: NDArray[np.float64],
    accel_deg_s2: NDArray[np.float64],
) -> None:
    """Look at one profile: pieces of constant acceleration, the last one at rest for good."""
    lasts_s = np.diff(start_s)
    lasts_s[~np.isfinite(lasts_s)] = 0.0
    lasts_s = np.append(lasts_s, 0.0)
    end_speed = speed_deg_s + accel_deg_s2 * lasts_s
    end_deg = position_deg + 0.5 * (speed_deg_s + end_speed) * lasts_s
    with np.errstate(divide="ignore", invalid="ignore"):
        turn_s = -speed_deg_s / accel_deg_s2
    turns = (turn_s > 0.0) & (turn_s < lasts_s)
    turn_deg = np.where(turns, position_deg + 0.5 * speed_deg_s * np.where(turns, turn_s, 0.0), 0.0)
    extreme_deg = np.stack([position_deg, end_deg, np.where(turns, turn_deg, position_deg)])

    jumps_deg = np.abs(np.append(position_deg[1:] - end_deg[:-1], 0.0))
    _refuse(joint, jumps_deg > JUMP_MAX_DEG, start_s + lasts_s, "would jump")
    _check_range(joint, start_s, extreme_deg)
    rounded_deg_s = 0.0
    if joint.drive == "streamed":
        rounded_deg_s = 0.5 * joint.unit_deg / (joint.filter_count * joint.response.filter_s)
    speeds = np.maximum(np.abs(speed_deg_s), np.abs(end_speed))
    _refuse(
        joint,
        speeds > EXCESS_MAX_RATIO * joint.speed_max_deg_s + rounded_deg_s,
        start_s,
        f"would reach {speeds.max():.6g} deg/s, allowed {joint.speed_max_deg_s:g} deg/s",
    )
    accels = np.abs(accel_deg_s2)
    _refuse(
        joint,
        accels > EXCESS_MAX_RATIO * joint.accel_max_deg_s2,
        start_s,
        f"would reach {accels.max():.6g} deg/s², allowed {joint.accel_max_deg_s2:g} deg/s²",
    )


def _refuse(
    joint: Joint, is_bad: NDArray[np.bool_] | np.bool_, times_s: NDArray[np.float64], what: str
) -> None:
    if is_bad.any():
        at_s = float(times_s[int(np.argmax(is_bad))])
        raise PlanningError(
            f"joint {joint.name!r} {what} at {at_s:.3f} s of the compiled program",
            joint=joint.name,
            time_s=at_s,
        )
