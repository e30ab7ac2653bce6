"""The analog inputs that a robot file names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.robot.model import Sensor
from lss_motion.spelling import known_names
from lss_motion.yaml_source import Problem

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.robot.file import SensorEntry
    from lss_motion.robot.model import Joint


def sensors_of(
    entries: Mapping[str, SensorEntry], buses: Iterable[str], joints: Mapping[str, Joint]
) -> tuple[dict[str, Sensor], list[Problem]]:
    """Return the sensors by name, and what is wrong with them."""
    known = list(buses)
    owners = {(joint.bus, joint.servo_id): f"joint {name!r}" for name, joint in joints.items()}
    sensors: dict[str, Sensor] = {}
    problems = []
    for name, entry in entries.items():
        place = ("sensors", name)
        bus = entry.bus or (known[0] if len(known) == 1 else None)
        if bus is None:
            reason = f"sensor {name!r} has no 'bus', and there are several: {', '.join(known)}"
            problems.append(Problem((*place, "bus"), reason))
        elif bus not in known:
            reason = f"unknown bus {bus!r}; {known_names(bus, known)}"
            problems.append(Problem((*place, "bus"), reason))
        elif (
            owner := owners.setdefault((bus, entry.id), f"sensor {name!r}")
        ) != f"sensor {name!r}":
            reason = f"{owner} and sensor {name!r} both have id {entry.id} on bus {bus!r}"
            problems.append(Problem((*place, "id"), reason))
        else:
            sensors[name] = Sensor(name=name, servo_id=entry.id, bus=bus, kind=entry.kind)
    return sensors, problems
