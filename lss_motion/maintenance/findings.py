"""What a scan has to say to a person: what is wrong, and the command that mends it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.maintenance.look import HOT_C, SUPPLY_MAX_V, SUPPLY_MIN_V
from lss_motion.protocol.constants import SafeModeCause, Status
from lss_motion.protocol.family import Family
from lss_motion.robot.models import other_model

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from lss_motion.maintenance.look import Look
    from lss_motion.robot.model import Bus, Robot

REMEDIES = {
    SafeModeCause.NONE: "find the cause",
    SafeModeCause.CURRENT: "something blocked it or it carries too much",
    SafeModeCause.INPUT_VOLTAGE: "check battery, supply and plugs",
    SafeModeCause.TEMPERATURE: "let it cool, and give it less to carry",
}

NOBODY = (
    "nobody answered at any baud rate that was tried. Check that the servos have power of their "
    "own (USB gives them none) and that the adapter is on the bus's connector. A servo in RC mode "
    "is deaf: hold its button at power-up to end that. To try without a robot: `lss-motion sim`"
)


def unreachable(bus: Bus, looks: Sequence[Look]) -> Iterator[str]:
    """Say which servos cannot be worked with as they are: shared ids, several rates."""
    where = f"--port {bus.port}"
    for look in looks:
        if look.present.is_shared:
            yield (
                f"id {look.servo_id} at {look.baud_bps} bps: several servos answer at once, so "
                f"their answers are garbled. Connect one of them alone and give it an id of its "
                f"own, then the next: lss-motion configure {where} --baud {look.baud_bps} "
                f"--id {look.servo_id} --new-id N"
            )
    counts: dict[int, list[int]] = {}
    for look in looks:
        counts.setdefault(look.baud_bps, []).append(look.servo_id)
    if len(counts) < 2:
        return
    main_bps = max(counts, key=lambda rate: len(counts[rate]))
    for rate_bps, ids in counts.items():
        for servo_id in ids if rate_bps != main_bps else ():
            yield (
                f"servo {servo_id} listens at {rate_bps} bps, the others at {main_bps}: a line "
                f"carries one rate. lss-motion configure {where} --baud {rate_bps} "
                f"--id {servo_id} --new-baud {main_bps} --force"
            )


def differences(robot: Robot, bus: Bus, looks: Sequence[Look]) -> Iterator[str]:
    """Say where the servos of a bus are not those of the robot file."""
    found = {look.servo_id: look for look in looks}
    joints = {joint.servo_id: joint for joint in robot.joints.values() if joint.bus == bus.name}
    for servo_id, joint in joints.items():
        look = found.get(servo_id)
        if look is None:
            yield (
                f"joint {joint.name!r}: servo {servo_id} does not answer on bus {bus.name!r}. "
                f"Check its plug and its power; has it another id?"
            )
        elif look.present.model and not look.present.model.startswith(joint.model.name):
            yield f"joint {joint.name!r}: {other_model(joint, look.present.model)}"
        elif look.baud_bps != bus.baud_bps and not look.present.is_shared:
            yield (
                f"joint {joint.name!r}: servo {servo_id} listens at {look.baud_bps} bps, the "
                f"robot file says {bus.baud_bps}"
            )


def warnings(looks: Sequence[Look], where: str) -> Iterator[str]:
    """Say which servos answer but are not well. `where` is how a command names the port."""
    for look in looks:
        if look.status is Status.SAFE_MODE:
            cause = "" if look.cause is None else look.cause.name.lower().replace("_", " ")
            remedy = "find the cause" if look.cause is None else REMEDIES[look.cause]
            yield (
                f"servo {look.servo_id} is in safe mode{f' ({cause})' if cause else ''}: {remedy}, "
                f"then lss-motion send {where} --id {look.servo_id} RESET"
            )
        if look.temperature_c is not None and look.temperature_c >= HOT_C:
            yield (
                f"servo {look.servo_id} is hot: {look.temperature_c:.0f} °C; at 85 °C it lets go. "
                f"Give it a rest, less load or a lower holding stiffness (AH)"
            )
        if look.voltage_v is not None and not SUPPLY_MIN_V <= look.voltage_v <= SUPPLY_MAX_V:
            yield (
                f"servo {look.servo_id} has {look.voltage_v:.1f} V; {SUPPLY_MIN_V:g} to "
                f"{SUPPLY_MAX_V:g} V are allowed. Check battery and supply"
            )


def unnamed(robot: Robot, bus: Bus, looks: Sequence[Look]) -> Iterator[str]:
    """Say which servos answer that the robot file does not name."""
    joints = {joint.servo_id for joint in robot.joints.values() if joint.bus == bus.name}
    pins = [look for look in looks if look.present.family is Family.IO2]
    for look in looks:
        if look.servo_id not in joints and look not in pins:
            yield f"servo {look.servo_id} ({look.present.model}) is not in the robot file"


def table(looks: Sequence[Look], names: Mapping[int, str]) -> list[str]:
    """Return the rows of what was found, aligned, the head first."""
    head = ("id", "model", "firmware", "serial number", "position", "supply", "heat", "status")
    rows = [("joint", *head) if names else head]
    for look in looks:
        present = look.present
        cells = (
            str(look.servo_id),
            "several at once" if present.is_shared else present.model or "-",
            _said(look.firmware, "{:d}"),
            present.serial_number or "-",
            _said(look.position_deg, "{:z.1f} deg"),
            _said(look.voltage_v, "{:.1f} V"),
            _said(look.temperature_c, "{:.0f} °C"),
            look.status.value if look.status is not None else "-",
        )
        rows.append((names.get(look.servo_id, "-"), *cells) if names else cells)
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [_aligned(row, widths) for row in rows]


def _aligned(row: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()


def _said(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
