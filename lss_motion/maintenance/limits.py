"""Limits that a robot file leaves to its servos: what to ask, and the robot that comes of it.

`speed_max_deg_s: servo` is what SD is set to, `accel_max_deg_s2: servo` the smaller of AA and AD.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, InputError
from lss_motion.player.transactions import Item
from lss_motion.protocol.codec import storable
from lss_motion.protocol.line import Command

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from lss_motion.maintenance.backup import ServoBackup
    from lss_motion.robot.model import Joint, Robot

    Answers = Mapping[tuple[str, int, str], int | str | None]

SETTINGS: Final = {"speed_max_deg_s": ("SD",), "accel_max_deg_s2": ("AA", "AD")}
"""The settings behind a limit; the least of them is it."""


def questions(robot: Robot) -> list[Item]:
    """Return what to ask: the limits that servos go by now."""
    return [
        Item(bus=joint.bus, command=Command(joint.servo_id, f"Q{name}"), is_query=True)
        for joint in robot.unread
        for limit in sorted(joint.unread)
        for name in SETTINGS[limit]
    ]


def robot_from_answers(robot: Robot, answers: Answers) -> Robot:
    """Return the robot with the limits that its servos said.

    Raises `BusError` naming those that did not, `InputError` for a limit that allows nothing.
    """

    def wire(joint: Joint, name: str) -> int | None:
        value = answers.get((joint.bus, joint.servo_id, f"Q{name}"))
        return value if isinstance(value, int) else None

    known = with_limits(robot, _physical(robot, wire))
    if known.unread:
        named = ", ".join(
            f"{joint.name} (id {joint.servo_id} on bus {joint.bus!r})" for joint in known.unread
        )
        raise BusError(
            f"the robot file leaves limits to servos that do not say them: {named}. Check power "
            f"and wiring, or give numbers",
            url=robot.buses[known.unread[0].bus].port,
        )
    return known


def robot_from_backup(robot: Robot, kept: Iterable[ServoBackup], path: Path) -> Robot:
    """Return the robot with the limits that its servos stored when the backup was made.

    Raises `InputError` for a servo that is not in it, and for a limit that allows nothing.
    """
    stored = {(servo.bus, servo.servo_id): servo.settings for servo in kept}

    def wire(joint: Joint, name: str) -> int | None:
        return stored.get((joint.bus, joint.servo_id), {}).get(name)

    known = with_limits(robot, _physical(robot, wire))
    for joint in known.unread:
        raise InputError(
            f"holds no {' and '.join(n for key in sorted(joint.unread) for n in SETTINGS[key])} of "
            f"servo {joint.servo_id} on bus {joint.bus!r} (joint {joint.name!r}); make it again",
            path=path,
        )
    return known


def with_limits(robot: Robot, limits: Mapping[str, Mapping[str, float]]) -> Robot:
    """Return the robot with those of the limits by joint and name that its file leaves open.

    None is more than what the model can.
    """
    joints = dict(robot.joints)
    for joint in robot.unread:
        said = {
            key: min(value, getattr(joint, key))
            for key, value in limits.get(joint.name, {}).items()
            if key in joint.unread
        }
        for key, value in said.items():
            if value <= 0.0:
                raise InputError(
                    f"joint {joint.name!r}: {key} is left to servo {joint.servo_id}, and its "
                    f"{' or '.join(SETTINGS[key])} is 0; configure it, or give a number",
                    path=robot.path,
                )
        joints[joint.name] = replace(joint, unread=joint.unread - said.keys(), **said)
    asked = {**robot.read_limits, **{name: dict(values) for name, values in limits.items()}}
    return replace(robot, joints=joints, read_limits=asked)


def _physical(
    robot: Robot, wire_of: Callable[[Joint, str], int | None]
) -> dict[str, dict[str, float]]:
    """Return the limits that are known by joint and name, in degrees of the horn."""
    limits: dict[str, dict[str, float]] = {}
    for joint in robot.unread:
        rows = storable(joint.model.family)
        for key in joint.unread:
            wires = [wire_of(joint, name) for name in SETTINGS[key]]
            values = [
                rows[name].physical(wire)
                for name, wire in zip(SETTINGS[key], wires, strict=True)
                if wire is not None
            ]
            if len(values) < len(wires):
                continue
            # The ramps are `ramp_ratio` times what AA and AD say.
            ratio = 1.0 if key == "speed_max_deg_s" else joint.response.ramp_ratio
            limits.setdefault(joint.name, {})[key] = ratio * min(values)
    return limits
