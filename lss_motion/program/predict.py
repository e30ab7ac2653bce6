"""Where every servo of a program will be: its commands, through the response model of its drive."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.program.filtered import FilterProfile
from lss_motion.program.model import TIMED, heard_us, ramp_deg_s2, target_deg
from lss_motion.program.response import Profile, Reference
from lss_motion.program.step import StepProfile
from lss_motion.units import s_from_ms, s_from_us

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.program.model import Program
    from lss_motion.program.response import Piece
    from lss_motion.robot.model import Joint, Robot

SPREAD_RATIO: Final = 0.6180339887498949
"""The golden ratio: multiples of it spread any number of servos evenly over one filter period."""


class ServoProfile(Protocol):
    """What every response model offers; all of it in servo degrees and seconds."""

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at `time_s`."""
        ...

    def retarget(self, heard_s: float, target_deg: float, duration_s: float | None) -> None:
        """Take up `D target [T duration]` at `heard_s`."""
        ...

    def forget_before(self, time_s: float) -> None:
        """Drop history that ends before `time_s`."""
        ...

    def pieces(self) -> Iterator[Piece]:
        """Yield the whole history."""
        ...


def driven(robot: Robot, program: Program) -> Robot:
    """Return `robot` with the joints of `program` commanded as the program says."""
    joints = dict(robot.joints)
    for name in program.start_deg:
        driving = program.drives.get(name, TIMED)
        count = driving.filter_count or joints[name].filter_count
        joints[name] = replace(joints[name], drive=driving.drive, filter_count=count)
    return replace(robot, joints=joints)


def make_profile(joint: Joint, position_deg: float, *, origin_s: float = 0.0) -> ServoProfile:
    """Return the response model of a joint whose servo stands at `position_deg`.

    `origin_s` is when the show time is 0, on the clock of the instants that the model is told.
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

    When a servo's filter steps nobody knows. The instants assumed are those for which the joint's
    own commands are sent; they differ from joint to joint, so that the line is used evenly.
    """
    period_s = joint.response.filter_s
    return FilterProfile(
        position_deg,
        count=joint.filter_count,
        response=joint.response,
        step_s=origin_s + period_s * (joint.servo_id * SPREAD_RATIO % 1.0),
    )


def profiles(program: Program, robot: Robot) -> dict[str, Reference]:
    """Return where each servo's profile is at any show time, if every move is heard when due."""
    robot = driven(robot, program)
    by_address = {(j.bus, j.servo_id): j for j in robot.joints.values()}
    running: dict[str, ServoProfile] = {}
    for name, joint_deg in program.start_deg.items():
        joint = robot.joints[name]
        start_deg = round(joint.servo_deg(joint_deg) / joint.unit_deg) * joint.unit_deg
        running[name] = make_profile(joint, start_deg)
    for move in program.moves:
        joint = by_address[move.bus, move.servo_id]
        running[joint.name].retarget(
            s_from_us(heard_us(move, robot.buses[move.bus].baud_bps)),
            target_deg(joint, move.target_wire),
            None if move.duration_ms is None else s_from_ms(move.duration_ms),
        )
    return {name: Reference(profile.pieces()) for name, profile in running.items()}
