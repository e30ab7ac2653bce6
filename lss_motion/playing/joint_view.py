"""What servos do, as that of the joints of a robot with mechanisms, while it plays.

The angles are mapped as in every other place (`planning.trajectory.servo_motion`). A robot without
mechanisms is seen as it is.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from lss_motion.planning.trajectory.servo_motion import joint_angles

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.playing.player.events import Faulted
    from lss_motion.robot.mechanism import Mechanism
    from lss_motion.robot.model import Robot

Angles = tuple[float, float, float]


class JointView:
    """The joints of `robot`; what is given is by its servos, in degrees of ideal servos."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        known = robot.mechanisms.values() if robot.servos else ()
        self._by_servo = {servo: one for one in known for servo in one.servos}
        self._by_joint = {joint: one for one in known for joint in one.joints}

    @property
    def is_plain(self) -> bool:
        """Whether every joint is its servo."""
        return not self.robot.servos

    def joints_of(self, servos: Iterable[str]) -> tuple[str, ...]:
        """Return the joints that these servos move, in the order of the robot."""
        known = tuple(servos)
        if self.is_plain:
            return known
        return tuple(name for name in self.robot.joints if {*self.servos_of(name)} <= {*known})

    def mechanism_of(self, joint: str) -> Mechanism | None:
        """Return what stands between a joint and its servos; None: nothing."""
        return self._by_joint.get(joint)

    def mechanism_of_servo(self, servo: str) -> Mechanism | None:
        """Return what stands between a servo and its joints; None: nothing."""
        return self._by_servo.get(servo)

    def servo_deg(self, joint_deg: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of the servos of which all joints are known."""
        found: dict[str, float] = {}
        for name, deg in joint_deg.items():
            mechanism = self._by_joint.get(name)
            if mechanism is None:
                found[name] = deg
            elif name == mechanism.joints[0] and {*mechanism.joints} <= joint_deg.keys():
                row = np.array([[joint_deg[joint] for joint in mechanism.joints]])
                servos = mechanism.transmission.servo_deg(row)[0].tolist()
                found |= dict(zip(mechanism.servos, servos, strict=True))
        return found

    def servos_of(self, joint: str) -> tuple[str, ...]:
        """Return the servos that move a joint."""
        mechanism = self._by_joint.get(joint)
        return (joint,) if mechanism is None else mechanism.servos

    def mates_of(self, joint: str) -> tuple[str, ...]:
        """Return the joints that the same servos move, this one among them."""
        mechanism = self._by_joint.get(joint)
        return (joint,) if mechanism is None else mechanism.joints

    def angles(self, names: Sequence[str], angles: Sequence[Angles]) -> Sequence[Angles]:
        """Return angles of servos as those of `joints_of`; an angle that is not known is NaN."""
        if self.is_plain:
            return angles
        rows = np.array(angles).T
        is_known = np.isfinite(rows)
        found = joint_angles(names, np.where(is_known, rows, 0.0), self.robot)[1]
        joints = self.joints_of(names)
        for column, joint in enumerate(joints):
            own = [names.index(servo) for servo in self.servos_of(joint)]
            found[~is_known[:, own].all(axis=1), column] = math.nan
        return [(a, b, c) for a, b, c in found.T.tolist()]

    def joint_deg(self, servo_deg: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of the joints of which all servos are known."""
        if self.is_plain:
            return dict(servo_deg)
        names = [name for name in self.robot.servos if name in servo_deg]
        joints, deg = joint_angles(
            names, np.array([[servo_deg[name] for name in names]]), self.robot
        )
        return dict(zip(joints, deg[0].tolist(), strict=True))

    def label(self, servo: str) -> tuple[str, str]:
        """Return the joint that a servo moves, and what to say besides: which servo it is."""
        mechanism = self._by_servo.get(servo)
        if mechanism is None or servo in self.robot.joints:
            return servo, ""
        return mechanism.joints[0], f"{mechanism.servo_label(servo)}: "

    def ratio(self, servo: str) -> float:
        """Return how many degrees of the servo one degree of a joint counts as an error."""
        return self.robot.servos[servo].tolerance_ratio if servo in self.robot.servos else 1.0

    def fault(self, event: Faulted) -> Faulted:
        """Return a fault of a servo as one of its joint."""
        joint, which = self.label(event.joint)
        return replace(event, joint=joint, cause=which + event.cause) if which else event
