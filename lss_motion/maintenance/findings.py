"""What a scan reports: problems, remedies and a first robot file.

What a scan has to say to a person: what is wrong, and the command that mends it.

A robot file to begin with, from what a scan found: valid, sober, and full of hints.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.maintenance.discovery import HOT_C, SUPPLY_MAX_V, SUPPLY_MIN_V
from lss_motion.protocol.constants import Family, SafeModeCause, Status
from lss_motion.robot.servo_models import SERVO_MODELS, model_mismatch_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from lss_motion.maintenance.discovery import ServoCondition
    from lss_motion.robot.model import Bus, Robot


REMEDIES = {
    SafeModeCause.NONE: "find the cause",
    SafeModeCause.CURRENT: "something blocked it or it carries too much",
    SafeModeCause.INPUT_VOLTAGE: "check battery, supply and plugs",
    SafeModeCause.TEMPERATURE: "let it cool, and give it less to carry",
}

NO_ANSWER = (
    "nobody answered at any baud rate that was tried. Check that the servos have power of their "
    "own (USB gives them none) and that the adapter is on the bus's connector. A servo in RC mode "
    "is deaf: hold its button at power-up to end that. To try without a robot: `lss-motion sim`"
)


def unreachable(bus: Bus, looks: Sequence[ServoCondition]) -> Iterator[str]:
    """Say which servos cannot be worked with as they are: shared ids, several rates."""
    where = f"--port {bus.port}"
    for look in looks:
        if look.identity.is_shared:
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


def differences(robot: Robot, bus: Bus, looks: Sequence[ServoCondition]) -> Iterator[str]:
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
        elif look.identity.model and not look.identity.model.startswith(joint.model.name):
            yield f"joint {joint.name!r}: {model_mismatch_text(joint, look.identity.model)}"
        elif look.baud_bps != bus.baud_bps and not look.identity.is_shared:
            yield (
                f"joint {joint.name!r}: servo {servo_id} listens at {look.baud_bps} bps, the "
                f"robot file says {bus.baud_bps}"
            )


def warnings(looks: Sequence[ServoCondition], where: str) -> Iterator[str]:
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


def unnamed(robot: Robot, bus: Bus, looks: Sequence[ServoCondition]) -> Iterator[str]:
    """Say which servos answer that the robot file does not name."""
    joints = {joint.servo_id for joint in robot.joints.values() if joint.bus == bus.name}
    pins = [look for look in looks if look.identity.family is Family.IO2]
    for look in looks:
        if look.servo_id not in joints and look not in pins:
            yield f"servo {look.servo_id} ({look.identity.model}) is not in the robot file"


def table(looks: Sequence[ServoCondition], names: Mapping[int, str]) -> list[str]:
    """Return the rows of what was found, aligned, the head first."""
    head = ("id", "model", "firmware", "serial number", "position", "supply", "heat", "status")
    rows = [("joint", *head) if names else head]
    for look in looks:
        present = look.identity
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


SPEED_DEG_S: Final = 90
ACCEL_DEG_S2: Final = 300
RANGE_DEG: Final = 45
"""Sober limits for a robot that nobody has measured yet. Chosen."""

_HEAD: Final = """\
# What lss-motion scan found; a start, not the end. Before anything moves:
#   1. give the joints names: elbow instead of joint_3
#   2. turn each by hand to the ends of its mechanics and write them into range_deg
#   3. direction: -1 where the servo turns the other way, zero_deg where the joint's 0 is elsewhere
#   4. lss-motion schema robot tells your editor everything else that may stand here

robot: {name}

buses:
  main: {{port: "{port}", baud_bps: {baud_bps}, firmware: {firmware}}}

defaults:
  model: {model}
  speed_max_deg_s: {speed}      # sober: every servo can do more
  accel_max_deg_s2: {accel}
  range_deg: [-{range}, {range}]

joints:
"""


def starter_file(name: str, bus: Bus, looks: Sequence[ServoCondition]) -> str | None:
    """Return the text of a robot file; None if no servo was found that one could name.

    What is no joint, listens at another rate, or shares its id stands in a comment.
    """
    main_bps = bus.baud_bps
    usable: list[ServoCondition] = []
    left: list[ServoCondition] = []
    for look in looks:
        is_good = look.baud_bps == main_bps and not look.identity.is_shared
        model = _model(look)
        (usable if is_good and model is not None else left).append(look)
    if not usable:
        return None
    models = [_model(look) or "" for look in usable]
    model = max(set(models), key=models.count)
    firmwares = [
        look.firmware
        for look in usable
        if look.firmware is not None and look.identity.family is Family.LSS
    ]
    text = _HEAD.format(
        name=name,
        port=bus.port,
        baud_bps=main_bps,
        firmware=max(set(firmwares), key=firmwares.count) if firmwares else bus.firmware,
        model=model,
        speed=SPEED_DEG_S,
        accel=ACCEL_DEG_S2,
        range=RANGE_DEG,
    )
    for look, own in zip(usable, models, strict=True):
        fields = [f"id: {look.servo_id}"] + ([f"model: {own}"] if own != model else [])
        text += f"  joint_{look.servo_id}: {{{', '.join(fields)}}}{_seen(look)}\n"
    for look in left:
        text += f"  # not used: id {look.servo_id}, {_why(look, main_bps)}\n"
    return text


def _model(look: ServoCondition) -> str | None:
    """Return the model as robot files name it; None where they cannot."""
    named = (name for name in SERVO_MODELS if look.identity.model.startswith(name))
    is_pin = look.identity.family is Family.IO2 and "-D" not in look.identity.model
    return None if is_pin else max(named, key=len, default=None)


def _seen(look: ServoCondition) -> str:
    stands = "" if look.position_deg is None else f", stood at {look.position_deg:z.1f} deg"
    number = look.identity.serial_number
    return f"    # {look.identity.model}{f', serial number {number}' if number else ''}{stands}"


def _why(look: ServoCondition, main_bps: int) -> str:
    if look.identity.is_shared:
        return "which several servos share"
    if look.baud_bps != main_bps:
        return f"{look.identity.model} at {look.baud_bps} bps"
    return f"{look.identity.model or 'no model known'}, which no joint of a robot file can be"
