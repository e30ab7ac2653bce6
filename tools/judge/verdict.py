"""All rules, applied to one recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from judge.horns import about_horn, about_rest
from judge.rules import about_end, about_moves, about_writes, told

if TYPE_CHECKING:
    from judge.recording import Recording
    from judge.rules import Objection


def objections(recording: Recording) -> list[Objection]:
    """Return everything that the rules object to in a run, in order of time."""
    found: list[Objection] = []
    servos = {(one.bus, one.servo_id): one for one in recording.servos}
    for name, bus in recording.buses.items():
        on_bus = [joint for joint in recording.joints if joint.bus == name]
        found += about_writes(name, bus, on_bus)
        for joint in on_bus:
            servo = servos[name, joint.servo_id]
            received = told(joint, servo, bus)
            found += about_moves(joint, servo, received)
            found += about_end(recording, joint)
            found += about_horn(joint, servo, received)
            if received.foreign_s > recording.end_s and not received.gaps:
                found += about_rest(joint, servo, recording.end_s)
    return sorted(found, key=lambda one: one.at_s)
