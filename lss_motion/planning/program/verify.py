"""Predicts the motion of the compiled bytes, and checks it against every limit.

The prediction: the commands of a program through the response model of each joint's drive.

The check: the bus carries rounded values, angles in tenths or hundredths and times in milliseconds.
So the profiles that the servos make of the bytes are checked piece by piece, with formulas of their
own and no result of planner or fit. Programs edited by hand pass through here too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import LineLoadError, PlanningError
from lss_motion.planning.program.line import with_phases
from lss_motion.planning.program.model import TIMED
from lss_motion.planning.program.move_table import columns_of
from lss_motion.planning.program.moves import profiles_from_rest, replayed, standing_wire
from lss_motion.planning.program.reference_grid import LimitArrays, servo_limits
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.streamed import PULSE_S, FilterProfile, StepProfile, filter_accel
from lss_motion.robot.profile import Profile, ramp_deg_s2
from lss_motion.units import US_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.program.response import FloatArray
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.robot.profile import Piece

EXCESS_MAX_RATIO: Final = 1.001
"""A limit may be exceeded by 0.1 % (FACTS.md A19)."""
JUMP_MAX_DEG: Final = 1e-6
"""Successive pieces must meet within this: rounding of numbers, far below one wire unit."""


class ServoProfile(Protocol):
    """The interface of every response model, in servo degrees and seconds."""

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at `time_s`."""
        ...

    def retarget(self, received_s: float, target_deg: float, duration_s: float | None) -> None:
        """Apply `D target [T duration]` received at `received_s`."""
        ...

    def forget_before(self, time_s: float) -> None:
        """Drop history that ends before `time_s`."""
        ...

    def pieces(self) -> Iterator[Piece]:
        """Yield the whole history."""
        ...


def driven(robot: Robot, program: Program) -> Robot:
    """Return `robot` with the drives that `program` sets for its joints."""
    joints = dict(robot.joints)
    for name in program.start_deg:
        driving = program.drives.get(name, TIMED)
        count = driving.filter_count or joints[name].filter_count
        joints[name] = replace(joints[name], drive=driving.drive, filter_count=count)
    return with_phases(replace(robot, joints=joints))


def make_profile(joint: Joint, position_deg: float, *, origin_s: float = 0.0) -> ServoProfile:
    """Return the response model of a joint whose servo stands at `position_deg`.

    `origin_s` is the instant of show time 0 on the clock of the instants that the model receives.
    """
    if joint.drive == "stepped":
        return StepProfile(position_deg)
    if joint.drive == "streamed":
        return filter_profile(joint, position_deg, origin_s=origin_s)
    return Profile(
        position_deg,
        ramp_deg_s2=ramp_deg_s2(joint),
        speed_max_deg_s=joint.speed_max_deg_s,
        response=joint.response,
    )


def filter_profile(joint: Joint, position_deg: float, *, origin_s: float = 0.0) -> FilterProfile:
    """Return the model of a streamed joint; see `make_profile`.

    The instants at which a servo's filter steps are unknown. The assumed ones are those at which
    the joint's own commands aim (`with_phases`).
    """
    return FilterProfile(
        position_deg,
        count=joint.filter_count,
        response=joint.response,
        step_s=origin_s + joint.response.filter_s * joint.filter_phase_ratio,
    )


def profiles(program: Program, robot: Robot) -> dict[str, PiecewiseProfile]:
    """Return each servo's profile over show time, if servos receive every move when it is due."""
    robot = driven(robot.servo_robot, program)
    columns = columns_of(program.moves, robot)
    columns = columns.take(np.argsort(columns.joint, kind="stable"))
    received_s = columns.received_us / US_PER_S
    begins_deg = np.zeros(len(robot.joints))
    limits = [servo_limits(joint, program.tolerance_deg) for joint in robot.joints.values()]
    slices = {}
    for index, (name, joint) in enumerate(robot.joints.items()):
        own = slice(*np.searchsorted(columns.joint, (index, index + 1)).tolist())
        received_s[own] = np.maximum.accumulate(received_s[own])
        if name in program.start_deg:
            start_deg = joint.servo_deg(program.start_deg[name])
            begins_deg[index] = standing_wire(start_deg, limits[index]) / limits[index].wire_per_deg
            slices[name] = index, own
    is_timed = np.array([joint.drive == "timed" for joint in robot.joints.values()], dtype=bool)
    some = np.flatnonzero(is_timed[columns.joint])
    timed = columns.take(some)
    moves = replayed(
        timed.joint,
        received_s[some],
        timed.target_wire,
        timed.duration_ms,
        begins_deg,
        LimitArrays(limits),
    )
    found, made = {}, profiles_from_rest(moves, limits, begins_deg)
    for name, (index, own) in slices.items():
        if is_timed[index]:
            found[name] = made[index]
        else:
            targets_deg = columns.target_wire[own] / limits[index].wire_per_deg
            begin_deg = float(begins_deg[index])
            found[name] = _replayed(robot.joints[name], begin_deg, received_s[own], targets_deg)
    return found


def _replayed(
    joint: Joint, begin_deg: float, received_s: FloatArray, targets_deg: FloatArray
) -> PiecewiseProfile:
    """Return the profile that bare moves make of one servo, which stands at `begin_deg`."""
    profile = make_profile(joint, begin_deg)
    for at_s, target_deg in zip(received_s.tolist(), targets_deg.tolist(), strict=True):
        profile.retarget(at_s, target_deg, None)
    return PiecewiseProfile(profile.pieces())


def verify_program(program: Program, robot: Robot) -> None:
    """Raise `PlanningError` where the profile of a servo breaks a limit of its joint.

    Position: outside of the range by more than one wire unit. Speed and acceleration: more than 0.1
    % above the limit. A profile that jumps is a fault too. The error names joint and time.

    A streamed joint has no ramps: its steps keep the speed limit except for the rounding of the
    wire, and its acceleration depends on when its targets come. If the line cannot carry them
    evenly enough, `LineLoadError` is raised. A stepped joint jumps: each jump is checked against
    the speed limit and the time since the jump before.
    """
    robot = robot.servo_robot
    if program.repeat is not None and program.repeat.times is not None:
        program = program.repeated(2)  # Every kind of seam, in a time that does not depend on it.
    verify_profiles(profiles(program, robot), driven(robot, program))
    _check_filters(program, driven(robot, program))


def _check_filters(program: Program, robot: Robot) -> None:
    """Check the acceleration of streamed joints, whenever their filters step."""
    names = [name for name in program.start_deg if robot.joints[name].drive == "streamed"]
    if not names:
        return
    columns = columns_of(program.moves, robot)
    for name in names:
        joint = robot.joints[name]
        own = columns.take(np.flatnonzero(columns.joint == list(robot.joints).index(name)))
        received_s = np.maximum.accumulate(own.received_us / US_PER_S)
        limits = servo_limits(joint, program.tolerance_deg)
        start_wire = standing_wire(joint.servo_deg(program.start_deg[name]), limits)
        begin_deg = start_wire / limits.wire_per_deg
        targets_deg = own.target_wire / joint.model.wire_per_deg
        accel_deg_s2, at_s = filter_accel(received_s, targets_deg, begin_deg, joint)
        room_deg = limits.tolerance_deg
        allowed_deg_s2 = joint.accel_max_deg_s2 + room_deg / joint.response.filter_s**2
        if accel_deg_s2 > allowed_deg_s2:
            raise _uneven_error(program, robot, joint, accel_deg_s2, allowed_deg_s2, at_s)


def _uneven_error(
    program: Program,
    robot: Robot,
    joint: Joint,
    accel_deg_s2: float,
    allowed_deg_s2: float,
    at_s: float,
) -> LineLoadError:
    bus, use = robot.buses[joint.bus], program.line_use.get(joint.bus)
    count = math.ceil(joint.filter_count * accel_deg_s2 / allowed_deg_s2)
    return LineLoadError(
        f"joint {joint.name!r} would brake or catch up with {accel_deg_s2:.0f} deg/s² at "
        f"{at_s:.3f} s, allowed {allowed_deg_s2:.0f}: bus {bus.name!r} at {bus.baud_bps} bps "
        f"cannot carry its targets evenly, or they cannot lie beyond its range, and the filter of "
        f"a streamed joint brakes by itself when its target is late or near. What would help: "
        f"a faster baud rate, fewer streamed joints on the bus, a lower speed_max_deg_s, "
        f"`filter_count: {count}`, or `drive: timed`",
        bus=bus.name,
        utilisation_ratio=0.0 if use is None else use.utilisation_ratio,
    )


def verify_profiles(profiles_by_joint: Mapping[str, PiecewiseProfile], robot: Robot) -> None:
    """Raise the errors of `verify_program`, for profiles by joint."""
    for name, profile in profiles_by_joint.items():
        if robot.joints[name].drive == "stepped":
            _check_jumps(robot.joints[name], *profile.table[:2])
        else:
            _check(robot.joints[name], *profile.table)


def _check_jumps(
    joint: Joint, start_s: NDArray[np.float64], position_deg: NDArray[np.float64]
) -> None:
    """Check a staircase: the range of its steps, and their height for the time between them."""
    _check_range(joint, start_s, position_deg[None, :])
    passed_s = np.maximum(np.diff(start_s), PULSE_S)
    allowed_deg = joint.unit_deg + EXCESS_MAX_RATIO * joint.speed_max_deg_s * passed_s
    is_bad = np.abs(np.diff(position_deg)) > allowed_deg
    _refuse(joint, is_bad, start_s[1:], f"would jump faster than {joint.speed_max_deg_s:g} deg/s")


def _check_range(
    joint: Joint, start_s: NDArray[np.float64], extreme_deg: NDArray[np.float64]
) -> None:
    """Check that the positions, (any, pieces), are within the range of the joint."""
    unit_deg = joint.unit_deg
    ends_deg = joint.servo_range_deg
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
    """Check one profile: pieces of constant acceleration, the last one at rest for good."""
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
    """Raise `PlanningError` for the first piece that is bad."""
    if is_bad.any():
        at_s = float(times_s[int(np.argmax(is_bad))])
        raise PlanningError(
            f"joint {joint.name!r} {what} at {at_s:.3f} s of the compiled program",
            joint=joint.name,
            time_s=at_s,
        )
