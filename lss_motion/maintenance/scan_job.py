"""Finds the servos of a robot for a client of another process; nothing moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import LssMotionError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.live_end import live_state

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.playing.connection import Connection
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.robot.model import Robot


class ScanJob(Struct, frozen=True, kw_only=True):
    """The buses of a robot, each at the rate of the robot file; `lss-motion scan` tries all."""

    robot: Robot

    def run(self, operator: Operator) -> None:
        """Send what was found; then the last event."""
        from lss_motion.playing.connection import connect

        robot = self.robot

        def progress(text: str) -> None:
            state = live_state(robot, {}, set(), is_ready=False)
            operator.offer(replace(state, text=text))

        try:
            with connect(robot.buses, robot=robot) as connection:
                found = [found_on(connection, robot, name, progress) for name in robot.buses]
        except LssMotionError as failed:
            operator.send(m.Ended(outcome="fault", error=str(failed), report=None))
            return
        operator.send(
            m.Scanned(
                servos=tuple(servo for servos, _ in found for servo in servos),
                problems=tuple(text for _, texts in found for text in texts),
            )
        )
        operator.send(m.Ended(outcome="finished", error=None, report=None))


def found_on(
    connection: Connection, robot: Robot, bus_name: str, progress: Callable[[str], None]
) -> tuple[list[m.FoundServo], list[str]]:
    """Return the servos of one bus, and what a person should mend."""
    from lss_motion.maintenance import findings
    from lss_motion.maintenance.survey import survey, unreadable

    bus = robot.buses[bus_name]
    names = {j.servo_id: j.name for j in robot.joints.values() if j.bus == bus_name}
    looks = survey(connection, bus, bus.baud_bps, progress)
    servos = [
        m.FoundServo(
            bus=bus_name,
            id=look.servo_id,
            model=look.identity.model,
            joint=names.get(look.servo_id),
            firmware=look.firmware,
            voltage_v=look.voltage_v,
            temperature_c=look.temperature_c,
            status=None if look.status is None else look.status.value,
            is_shared=look.identity.is_shared,
        )
        for look in looks
    ]
    others = unreadable(connection, bus)
    if not looks:
        return servos, [*others, f"bus {bus_name}: {findings.NO_ANSWER}"]
    problems = [
        *others,
        *findings.unreachable(bus, looks),
        *findings.differences(robot, bus, looks),
        *findings.warnings(looks, f"--port {bus.port}"),
        *findings.unnamed(robot, bus, looks),
    ]
    return servos, problems
