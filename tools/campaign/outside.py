"""What an independent judge (`tools/judge`) is given of a run: plain values, nothing of ours.

The robot goes over as the text of a robot file, the run as what a JSON file could hold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from judge.recording import recording_of
from judge.verdict import objections

from campaign.allowances import BODY_KINDS, STEP_NS
from lss_motion.protocol.codec import FAMILY_TABLES
from lss_motion.protocol.constants import Family
from lss_motion.sim.bus import servos_of, set_up_settings
from lss_motion.sim.faults import RESTARTING, FaultKind
from lss_motion.units import NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from campaign.witness import Witness
    from lss_motion.playing.run import Result
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sim.faults import Fault

EXCUSES: Final = {*BODY_KINDS, FaultKind.WRONG_SCALE}
"""With these a horn does what motor or servo make of a right command."""
KEPT: Final = ("SD", "AA", "AD", "EM", "FPC", "G", "O", "AR")


def objections_to(
    robot: Robot, faults: Sequence[Fault], witness: Witness, result: Result
) -> list[str]:
    """Return what the independent judge objects to in a run."""
    record = record_of(robot, faults, witness, result)
    own = robot_of(robot, result.player.program.tolerance_deg)
    return [str(one) for one in objections(recording_of(own, record))]


def robot_of(robot: Robot, tolerance_deg: float) -> dict[str, Any]:
    """Return a robot as its file holds it, as the judge reads it, with the fit's tolerance."""
    return {
        "buses": {name: {"baud_bps": bus.baud_bps} for name, bus in robot.buses.items()},
        "joints": {
            joint.name: {
                "id": joint.servo_id,
                "bus": joint.bus,
                "model": joint.model.name,
                "range_deg": [joint.position_min_deg, joint.position_max_deg],
                "speed_max_deg_s": joint.speed_max_deg_s,
                "accel_max_deg_s2": joint.accel_max_deg_s2,
                "direction": joint.direction,
                "zero_deg": joint.zero_deg,
                "tolerance_deg": tolerance_deg,
                "stored": {name: joint.stored[name] for name in ("G", "O") if name in joint.stored},
            }
            for joint in robot.joints.values()
        },
    }


def record_of(
    robot: Robot, faults: Sequence[Fault], witness: Witness, result: Result
) -> dict[str, Any]:
    """Return a run as JSON holds it."""
    end_ns = witness.end_ns + NS_PER_S
    return {
        "end_s": s_from_ns(end_ns),
        "buses": {
            name: {
                "baud_bps": bus.baud_bps,
                "written": _rows(witness.writes.get(name, [])),
                "gone": [
                    [s_from_ns(a), s_from_ns(b)] for a, b in [*bus.outages_ns(), *bus.blocks_ns()]
                ],
            }
            for name, bus in result.simulated.items()
        },
        "servos": [
            one for name in result.simulated for one in _servos(robot, name, faults, result, end_ns)
        ],
    }


def _servos(
    robot: Robot, bus_name: str, faults: Sequence[Fault], result: Result, end_ns: int
) -> list[Mapping[str, Any]]:
    bus = result.simulated[bus_name]
    seen_deg = bus.horn_deg(np.arange(0, end_ns, STEP_NS))
    rows = []
    for index, name in enumerate(servos_of(robot, bus_name)):
        joint = robot.joints[name]
        own = [f for f in faults if f.servo_id in (None, joint.servo_id)]
        body = [f"{f.kind} {f.setting}".strip() for f in own if f.kind in EXCUSES]
        gyre, origin_deg = joint.stored.get("G") or 1.0, joint.stored.get("O") or 0.0
        rows.append(
            {
                "bus": bus_name,
                "id": joint.servo_id,
                "stored": _stored(joint),
                "changes": [
                    [s_from_ns(at_ns), _known(joint, settings)]
                    for at_ns, settings in bus.stored_ns[index]
                ],
                "received": _rows(bus.received[index]),
                "restarts": [s_from_ns(at_ns) for at_ns in bus.restarts_ns[index]],
                "back": [
                    [s_from_ns(at_ns), f.at_s + f.deaf_s]
                    for at_ns in bus.restarts_ns[index]
                    for f in own
                    if f.kind in RESTARTING and ns_from_s(f.at_s) == at_ns
                ],
                "step_s": s_from_ns(STEP_NS),
                "horn_deg": (gyre * seen_deg[:, index] + origin_deg).tolist(),
                "excuse": ", ".join(body),
            }
        )
    return rows


def _stored(joint: Joint) -> dict[str, int]:
    """Return what a servo has stored at power-up, in wire units.

    No document says what the factory SD of an LSS-PRO is; the servo reports it.
    """
    table = FAMILY_TABLES[joint.model.family]
    own = set_up_settings(joint)
    if joint.model.family is Family.LSS_PRO:
        own = {"SD": table.row("SD").wire(joint.model.speed_max_deg_s), **own}
    return _known(joint, own)


def _known(joint: Joint, settings: Mapping[str, int]) -> dict[str, int]:
    """Return the settings that the judge follows, as far as the servo of a joint has them."""
    words = FAMILY_TABLES[joint.model.family].by_keyword
    return {name: wire for name, wire in settings.items() if name in KEPT and f"Q{name}" in words}


def _rows(lines: Sequence[tuple[int, bytes]]) -> list[tuple[float, str]]:
    return [
        (s_from_ns(at_ns), line.decode("latin-1"))
        for at_ns, data in lines
        for line in data.splitlines(keepends=True)
    ]
