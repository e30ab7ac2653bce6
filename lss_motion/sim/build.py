"""From a robot file to simulated buses: which servo hangs on which line, and how it starts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import Physics, ServoSpec

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.robot.model import Robot
    from lss_motion.sim.faults import Fault
    from lss_motion.sim.hand import Hand


def bus_from_robot(  # noqa: PLR0913  (the knobs of one bus)
    robot: Robot,
    bus_name: str,
    *,
    seed: int = 0,
    start_deg: Mapping[str, float] | None = None,
    physics: Physics | None = None,
    faults: Sequence[Fault] = (),
    usb_latency_ns: int = 0,
    hand: Hand | None = None,
    droop_deg: Mapping[str, float] | None = None,
) -> SimBus:
    """Return one bus of `robot`, its servos in the order of `servos_of`.

    `start_deg` gives joint angles at power-up by joint name. A joint left out stands at 0, or at
    the end of its range that is nearest to 0. Of `faults`, those of other buses are left out.
    `hand` leads the joints that it names, and `droop_deg` is what hangs on them (`ServoSpec`).
    """
    bus = robot.buses[bus_name]
    asked_deg = start_deg or {}
    specs = [
        ServoSpec(
            servo_id=joint.servo_id,
            model=joint.model,
            start_deg=joint.servo_deg(
                asked_deg.get(
                    joint.name, min(max(0.0, joint.position_min_deg), joint.position_max_deg)
                )
            ),
            hand=None if hand is None else hand.led(joint),
            droop_deg=(droop_deg or {}).get(joint.name, 0.0),
        )
        for joint in (robot.joints[name] for name in servos_of(robot, bus_name))
    ]
    return SimBus(
        specs,
        baud_bps=bus.baud_bps,
        firmware=bus.firmware,
        seed=seed,
        physics=physics,
        faults=[fault for fault in faults if fault.bus in (None, bus_name)],
        usb_latency_ns=usb_latency_ns,
        inputs=[one.servo_id for one in robot.sensors.values() if one.bus == bus_name],
    )


def servos_of(robot: Robot, bus_name: str) -> list[str]:
    """Return the names of the joints on a bus, in the order of the robot file."""
    return [joint.name for joint in robot.joints.values() if joint.bus == bus_name]
