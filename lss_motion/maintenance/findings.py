"""The report of a scan to a person: problems and remedies, a table, a first robot file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.files.texts import aligned
from lss_motion.playing.discovery import HOT_C, SUPPLY_MAX_V, SUPPLY_MIN_V
from lss_motion.playing.player.unasked import unasked_text, unreadable_text
from lss_motion.protocol.constants import Family, SafeModeCause, Status
from lss_motion.robot.servo_models import SERVO_MODELS, model_mismatch_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from lss_motion.playing.discovery import ServoCondition, Unasked
    from lss_motion.robot.model import Bus, Robot


REMEDIES: Final = {
    SafeModeCause.NONE: "find the cause",
    SafeModeCause.CURRENT: "something blocked it or it carries too much",
    SafeModeCause.INPUT_VOLTAGE: "check battery, supply and plugs",
    SafeModeCause.TEMPERATURE: "let it cool, and give it less to carry",
}

NO_ANSWER: Final = (
    "no servo answered at any baud rate that was tried. Check that the servos have power of their "
    "own (USB gives them none) and that the adapter is on the bus's connector. A servo in RC mode "
    "receives nothing: hold its button at power-up to end that. To try without a robot: "
    "`lss-motion sim`"
)


SPEED_DEG_S: Final = 90
ACCEL_DEG_S2: Final = 300
RANGE_DEG: Final = 45
"""Low limits for a robot whose own are unknown. Chosen."""

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


def unreachable(bus: Bus, servos: Sequence[ServoCondition]) -> Iterator[str]:
    """Yield the servos that cannot be used as they are: shared ids, several rates."""
    where = f"--port {bus.port}"
    for servo in servos:
        if servo.identity.is_shared:
            yield (
                f"id {servo.servo_id} at {servo.baud_bps} bps: several servos answer at once, so "
                f"their answers are garbled. Connect one of them alone and give it an id of its "
                f"own, then the next: lss-motion configure {where} --baud {servo.baud_bps} "
                f"--id {servo.servo_id} --new-id N"
            )
        if servo.identity.is_doubtful:
            yield doubtful_text(servo.servo_id)
    counts: dict[int, list[int]] = {}
    for servo in servos:
        counts.setdefault(servo.baud_bps, []).append(servo.servo_id)
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


def differences(robot: Robot, bus: Bus, servos: Sequence[ServoCondition]) -> Iterator[str]:
    """Yield where the servos of a bus differ from the robot file."""
    found = {servo.servo_id: servo for servo in servos}
    joints = {joint.servo_id: joint for joint in robot.joints.values() if joint.bus == bus.name}
    for servo_id, joint in joints.items():
        servo = found.get(servo_id)
        if servo is None:
            yield (
                f"joint {joint.name!r}: servo {servo_id} does not answer on bus {bus.name!r}. "
                f"Check its plug and its power; has it another id?"
            )
        elif servo.identity.model and not servo.identity.model.startswith(joint.model.name):
            yield f"joint {joint.name!r}: {model_mismatch_text(joint, servo.identity.model)}"
        elif servo.baud_bps != bus.baud_bps and servo.identity.is_single:
            yield (
                f"joint {joint.name!r}: servo {servo_id} listens at {servo.baud_bps} bps, the "
                f"robot file says {bus.baud_bps}"
            )


def warnings(servos: Sequence[ServoCondition], where: str) -> Iterator[str]:
    """Yield the servos that answer but have a problem. `where` names the port in a command."""
    if replies := {servo.servo_id: servo.unasked for servo in servos if servo.unasked}:
        yield unasked_text(replies)
    for servo in servos:
        if servo.status is Status.SAFE_MODE:
            cause = "" if servo.cause is None else servo.cause.name.lower().replace("_", " ")
            remedy = "find the cause" if servo.cause is None else REMEDIES[servo.cause]
            yield (
                f"servo {servo.servo_id} is in safe mode{f' ({cause})' if cause else ''}: "
                f"{remedy}, then lss-motion send {where} --id {servo.servo_id} RESET"
            )
        if servo.temperature_c is not None and servo.temperature_c >= HOT_C:
            yield (
                f"servo {servo.servo_id} is hot: {servo.temperature_c:.0f} °C; at 85 °C it lets "
                f"go. Give it a rest, less load or a lower holding stiffness (AH)"
            )
        if servo.voltage_v is not None and not SUPPLY_MIN_V <= servo.voltage_v <= SUPPLY_MAX_V:
            yield (
                f"servo {servo.servo_id} has {servo.voltage_v:.1f} V; {SUPPLY_MIN_V:g} to "
                f"{SUPPLY_MAX_V:g} V are allowed. Check battery and supply"
            )


def doubtful_text(servo_id: int) -> str:
    """Return the text for an id that cannot be judged while another host disturbs the bus."""
    return (
        f"id {servo_id}: its queries are regularly answered by unreadable bytes: several servos "
        f"share this id, or its replies collide with those that another host asks for. Stop the "
        f"other host, then scan again"
    )


def other_hosts(where: str, unasked: Unasked) -> Iterator[str]:
    """Yield what a bus shows of another host, for commands that do not print every servo."""
    if unasked.unreadable_bytes:
        yield unreadable_text(where)
    if unasked.replies:
        yield unasked_text(unasked.replies)


def unnamed(robot: Robot, bus: Bus, servos: Sequence[ServoCondition]) -> Iterator[str]:
    """Yield the servos that answer and are not in the robot file."""
    joints = {joint.servo_id for joint in robot.joints.values() if joint.bus == bus.name}
    pins = [servo for servo in servos if servo.identity.family is Family.IO2]
    for servo in servos:
        is_named = servo.servo_id in joints or servo in pins or servo.identity.is_doubtful
        if not is_named:
            yield f"servo {servo.servo_id} ({servo.identity.model}) is not in the robot file"


def table(servos: Sequence[ServoCondition], names: Mapping[int, str]) -> list[str]:
    """Return the table of the servos, a text a row, aligned, with its head."""
    head = ("id", "model", "firmware", "serial number", "position", "supply", "heat", "status")
    rows = [("joint", *head) if names else head]
    for servo in servos:
        present = servo.identity
        cells = (
            str(servo.servo_id),
            _kind(servo),
            _cell(servo.firmware, "{:d}"),
            present.serial_number or "-",
            _cell(servo.position_deg, "{:z.1f} deg"),
            _cell(servo.voltage_v, "{:.1f} V"),
            _cell(servo.temperature_c, "{:.0f} °C"),
            servo.status.value if servo.status is not None else "-",
        )
        rows.append((names.get(servo.servo_id, "-"), *cells) if names else cells)
    return aligned(rows)


def _kind(servo: ServoCondition) -> str:
    if servo.identity.is_doubtful:
        return "unreadable"
    return "several at once" if servo.identity.is_shared else servo.identity.model or "-"


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def starter_file(name: str, bus: Bus, servos: Sequence[ServoCondition]) -> str | None:
    """Return the text of a robot file; None if no servo was found that it can name.

    A servo that cannot be a joint, has another rate or shares its id stands in a comment.
    """
    main_bps = bus.baud_bps
    usable: list[ServoCondition] = []
    left: list[ServoCondition] = []
    for servo in servos:
        is_good = servo.baud_bps == main_bps and servo.identity.is_single
        model = _model(servo)
        (usable if is_good and model is not None else left).append(servo)
    if not usable:
        return None
    models = [_model(servo) or "" for servo in usable]
    model = max(set(models), key=models.count)
    firmwares = [
        servo.firmware
        for servo in usable
        if servo.firmware is not None and servo.identity.family is Family.LSS
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
    for servo, own in zip(usable, models, strict=True):
        fields = [f"id: {servo.servo_id}"] + ([f"model: {own}"] if own != model else [])
        text += f"  joint_{servo.servo_id}: {{{', '.join(fields)}}}{_comment(servo)}\n"
    for servo in left:
        text += f"  # not used: id {servo.servo_id}, {_reason(servo, main_bps)}\n"
    return text


def _model(servo: ServoCondition) -> str | None:
    """Return the model as robot files name it; None if they cannot."""
    named = (name for name in SERVO_MODELS if servo.identity.model.startswith(name))
    is_pin = servo.identity.family is Family.IO2 and "-D" not in servo.identity.model
    return None if is_pin else max(named, key=len, default=None)


def _comment(servo: ServoCondition) -> str:
    stands = "" if servo.position_deg is None else f", stood at {servo.position_deg:z.1f} deg"
    number = servo.identity.serial_number
    return f"    # {servo.identity.model}{f', serial number {number}' if number else ''}{stands}"


def _reason(servo: ServoCondition, main_bps: int) -> str:
    if servo.identity.is_shared:
        return "which several servos share"
    if servo.identity.is_doubtful:
        return "with unreadable replies"
    if servo.baud_bps != main_bps:
        return f"{servo.identity.model} at {servo.baud_bps} bps"
    return f"{servo.identity.model or 'no model known'}, which no joint of a robot file can be"
