"""The motion of joints as the motion of the servos behind them: the one function that maps it.

Everything that follows, from the compiler to the player and the simulator, knows servos only
(`Robot.servo_robot`). A trajectory of a robot without mechanisms is that of its servos already.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Pass, Trajectory
    from lss_motion.robot.mechanism import Mechanism
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]


class ServoColumns(Struct, frozen=True):
    """Servos behind some joints: the columns of a mechanism, or of one joint that is its servo."""

    servos: tuple[str, ...]
    columns: tuple[int, ...]
    mechanism: Mechanism | None


class ServoPass(Struct, frozen=True, kw_only=True):
    """A pass of servos, in degrees of ideal servos."""

    of: Pass
    groups: tuple[ServoColumns, ...]

    @property
    def duration_s(self) -> float:
        return self.of.duration_s

    @property
    def knots_s(self) -> FloatArray:
        return self.of.knots_s

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        return ()

    @property
    def seams_s(self) -> FloatArray:
        return self.of.seams_s

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        """Return deg, deg/s or deg/s² for order 0, 1, 2, (n, servos); see `Pass`."""
        of_joints = [self.of.sample(times_s, lower) for lower in range(order + 1)]
        found = []
        for group in self.groups:
            own = [values[:, list(group.columns)] for values in of_joints]
            if group.mechanism is None:
                found.append(own[order])
            elif order == 0:
                found.append(group.mechanism.transmission.servo_deg(own[0]))
            else:
                found.append(group.mechanism.derivatives(*own)[-1])
        return np.concatenate(found, axis=1)


def servo_name(servo: str) -> str:
    """Return how a servo is called beside joints, of which one may have the same name."""
    return f"servo:{servo}"


def with_servos(trajectory: Trajectory, robot: Robot) -> Trajectory:
    """Return the trajectory of the joints and of the servos behind mechanisms (`servo_name`)."""
    own = [ServoColumns((name,), (i,), None) for i, name in enumerate(trajectory.joints)]
    behind = [
        replace(group, servos=tuple(map(servo_name, group.servos)))
        for group in servo_columns(trajectory.joints, robot)
        if group.mechanism is not None
    ]
    return _mapped(trajectory, (*own, *behind))


def servo_motion(trajectory: Trajectory, robot: Robot) -> Trajectory:
    """Return the trajectory of the servos of `robot`; marks, cues and times stay."""
    if not robot.servos:
        return trajectory
    return _mapped(trajectory, servo_columns(trajectory.joints, robot))


def _mapped(trajectory: Trajectory, groups: tuple[ServoColumns, ...]) -> Trajectory:
    made: dict[int, Pass] = {}
    for motion in (trajectory.first, trajectory.middle, trajectory.last):
        made.setdefault(id(motion), ServoPass(of=motion, groups=groups))
    return replace(
        trajectory,
        joints=tuple(servo for group in groups for servo in group.servos),
        first=made[id(trajectory.first)],
        middle=made[id(trajectory.middle)],
        last=made[id(trajectory.last)],
    )


def servo_columns(joints: Sequence[str], robot: Robot) -> tuple[ServoColumns, ...]:
    """Return the servos behind joints, in the order of the robot."""
    by_servo = {servo: m for m in robot.mechanisms.values() for servo in m.servos}
    groups: list[ServoColumns] = []
    for name in robot.servos:
        mechanism = by_servo.get(name)
        if mechanism is None and name in joints:
            groups.append(ServoColumns((name,), (joints.index(name),), None))
        elif (
            mechanism is not None and name == mechanism.servos[0] and mechanism.joints[0] in joints
        ):
            columns = tuple(joints.index(joint) for joint in mechanism.joints)
            groups.append(ServoColumns(mechanism.servos, columns, mechanism))
    return tuple(groups)


def joints_and_servos(
    names: Sequence[str], servo_deg: FloatArray, robot: Robot
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the columns of `with_servos` that follow from ideal servos, (n, servos)."""
    joints, angles = joint_angles(names, servo_deg, robot)
    behind = {servo for mechanism in robot.mechanisms.values() for servo in mechanism.servos}
    own = [column for column, name in enumerate(names) if name in behind]
    found = (*joints, *(servo_name(names[column]) for column in own))
    return found, np.column_stack([angles, servo_deg[:, own]])


def joint_angles(
    names: Sequence[str], servo_deg: FloatArray, robot: Robot
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the joints that follow from ideal servos, (n, servos), in the order of the robot."""
    found: dict[str, FloatArray] = {}
    by_joint = {joint: m for m in robot.mechanisms.values() for joint in m.joints}
    for name in robot.joints:
        mechanism = by_joint.get(name)
        if mechanism is None and name in names:
            found[name] = servo_deg[:, names.index(name)]
        elif mechanism is not None and name not in found and set(mechanism.servos) <= {*names}:
            own = servo_deg[:, [names.index(servo) for servo in mechanism.servos]]
            angles = mechanism.transmission.joint_deg(own)
            found |= dict(zip(mechanism.joints, angles.T, strict=True))
    order = tuple(name for name in robot.joints if name in found)
    columns = [found[name] for name in order]
    return order, np.column_stack(columns) if columns else np.empty((len(servo_deg), 0))
