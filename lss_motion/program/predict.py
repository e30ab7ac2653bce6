"""Where every servo of a program will be: its commands, through the response model of its drive."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from lss_motion.program.columns import columns_of
from lss_motion.program.course import LimitArrays, servo_limits
from lss_motion.program.filtered import FilterProfile
from lss_motion.program.model import TIMED, ramp_deg_s2
from lss_motion.program.moves import followed, from_rest
from lss_motion.program.response import Profile, Reference
from lss_motion.program.step import StepProfile
from lss_motion.units import US_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.program.batch import FloatArray
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
    columns = columns_of(program.moves, robot)
    columns = columns.take(np.argsort(columns.joint, kind="stable"))
    heard_s = columns.heard_us / US_PER_S
    begins_deg = np.zeros(len(robot.joints))
    limits = [servo_limits(joint, program.tolerance_deg) for joint in robot.joints.values()]
    slices = {}
    for index, (name, joint) in enumerate(robot.joints.items()):
        own = slice(*np.searchsorted(columns.joint, (index, index + 1)).tolist())
        heard_s[own] = np.maximum.accumulate(heard_s[own])
        if name in program.start_deg:
            start_deg = joint.servo_deg(program.start_deg[name])
            begins_deg[index] = round(start_deg / joint.unit_deg) * joint.unit_deg
            slices[name] = index, own
    is_timed = np.array([joint.drive == "timed" for joint in robot.joints.values()], dtype=bool)
    some = np.flatnonzero(is_timed[columns.joint])
    timed = columns.take(some)
    moves = followed(
        timed.joint,
        heard_s[some],
        timed.target_wire,
        timed.duration_ms,
        begins_deg,
        LimitArrays(limits),
    )
    found, made = {}, from_rest(moves, limits, begins_deg)
    for name, (index, own) in slices.items():
        if is_timed[index]:
            found[name] = made[index]
        else:
            targets_deg = columns.target_wire[own] / limits[index].wire_per_deg
            begin_deg = float(begins_deg[index])
            found[name] = _replayed(robot.joints[name], begin_deg, heard_s[own], targets_deg)
    return found


def _replayed(
    joint: Joint, begin_deg: float, heard_s: FloatArray, targets_deg: FloatArray
) -> Reference:
    """Return the profile that bare moves make of one servo, which stands at `begin_deg`."""
    profile = make_profile(joint, begin_deg)
    for at_s, target_deg in zip(heard_s.tolist(), targets_deg.tolist(), strict=True):
        profile.retarget(at_s, target_deg, None)
    return Reference(profile.pieces())
