"""Joint limits that a robot file leaves to its servos: the queries, and the robot with the answers.

`speed_max_deg_s: servo` is the setting SD, `accel_max_deg_s2: servo` the smaller of AA and AD.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.errors import BusError, InputError
from lss_motion.playing.player.handshake import Item
from lss_motion.protocol.codec import storable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.model import Joint, Robot

SETTINGS: Final = {"speed_max_deg_s": ("SD",), "accel_max_deg_s2": ("AA", "AD")}
"""The settings behind a limit; the smallest of them is the limit."""


def questions(robot: Robot) -> list[Item]:
    """Return the queries for the open limits, as they are in this session."""
    return [
        Item.to(joint, f"Q{name}")
        for joint in robot.unread
        for limit in sorted(joint.unread)
        for name in SETTINGS[limit]
    ]


def robot_from_answers(robot: Robot, answers: Answers) -> Robot:
    """Return the robot with the limits that its servos answered.

    Raises `BusError` naming the servos without an answer, `InputError` for a limit of 0.
    """

    def wire(joint: Joint, name: str) -> int | None:
        value = answers.get((joint.bus, joint.servo_id, f"Q{name}"))
        return value if isinstance(value, int) else None

    known = with_limits(robot, physical_limits(robot, wire))
    if known.unread:
        named = ", ".join(
            f"{joint.name} (id {joint.servo_id} on bus {joint.bus!r})" for joint in known.unread
        )
        raise BusError(
            f"the robot file leaves limits to servos that do not answer: {named}. Check power "
            f"and wiring, or give numbers",
            url=robot.buses[known.unread[0].bus].port,
        )
    return known


def with_limits(robot: Robot, limits: Mapping[str, Mapping[str, float]]) -> Robot:
    """Return the robot with `limits`, by joint and name, where its file leaves them open.

    No limit exceeds that of the servo model.
    """
    joints = dict(robot.joints)
    for joint in robot.unread:
        read = {
            key: min(value, getattr(joint, key))
            for key, value in limits.get(joint.name, {}).items()
            if key in joint.unread
        }
        for key, value in read.items():
            if value <= 0.0:
                raise InputError(
                    f"joint {joint.name!r}: {key} is left to servo {joint.servo_id}, and its "
                    f"{' or '.join(SETTINGS[key])} is 0; configure it, or give a number",
                    path=robot.path,
                )
        joints[joint.name] = replace(joint, unread=joint.unread - read.keys(), **read)
    asked = {**robot.read_limits, **{name: dict(values) for name, values in limits.items()}}
    return replace(robot, joints=joints, read_limits=asked)


def physical_limits(
    robot: Robot, wire_of: Callable[[Joint, str], int | None]
) -> dict[str, dict[str, float]]:
    """Return the known limits by joint and name, in horn degrees."""
    limits: dict[str, dict[str, float]] = {}
    for joint in robot.unread:
        rows = storable(joint.model.language)
        for key in joint.unread:
            wires = [wire_of(joint, name) for name in SETTINGS[key]]
            values = [
                rows[name].physical(wire)
                for name, wire in zip(SETTINGS[key], wires, strict=True)
                if wire is not None
            ]
            if len(values) < len(wires):
                continue
            # The ramps are `ramp_ratio` times the values of AA and AD.
            ratio = 1.0 if key == "speed_max_deg_s" else joint.ramp_ratio
            limits.setdefault(joint.name, {})[key] = ratio * min(values)
    return limits
