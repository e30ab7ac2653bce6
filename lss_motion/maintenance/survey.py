"""Finds the servos of a bus over an open connection. Sends queries only; moves nothing.

`survey` tries baud rates and ids, for `scan`. `roll_call` finds all ids at the present rate, for
`monitor` and `configure`. `query_each` sends queries to single ids, one at a time, so that replies
of two servos with the same id are noticed.

`unreachable`, `warnings`, `differences` and `unnamed` are what a person should mend, `table` and
`starter` what there is. `ScanJob` does the same for a client of another process.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import LssMotionError
from lss_motion.files.texts import aligned
from lss_motion.playing import discovery
from lss_motion.playing.discovery import (
    HOT_C,
    RATES_BPS,
    SUPPLY_MAX_V,
    SUPPLY_MIN_V,
    BusListening,
    ServoIdentity,
    presence_steps,
)
from lss_motion.playing.live_end import live_state
from lss_motion.playing.player.echo import echo_text
from lss_motion.playing.player.unasked import unasked_text, unreadable_text
from lss_motion.playing.remote import schema as m
from lss_motion.protocol.constants import ID_MAX, Family, SafeModeCause, Status
from lss_motion.robot.servo_models import SERVO_MODELS, model_mismatch_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from lss_motion.playing.connection import Connection
    from lss_motion.playing.discovery import ServoCondition, Unasked
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.robot.model import Bus, Robot


def survey(
    connection: Connection,
    bus: Bus,
    baud_bps: int | None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[ServoCondition]:
    """Return the servos of a bus, at `baud_bps` or at every rate with a reply.

    `progress` is called with the text of each step. Leaves the port at the rate with the most
    replies.
    """
    rates_bps = list(dict.fromkeys((bus.baud_bps, *RATES_BPS))) if baud_bps is None else [baud_bps]
    used_bps = []
    for rate_bps in rates_bps:
        progress(f"{bus.port}: {rate_bps} bps")
        connection.set_baud(bus.name, rate_bps)
        presence = connection.run(BusListening(bus.name, presence_steps(rate_bps)))
        if presence.echo.count:
            connection.echoing.add(bus.name)
        if any(presence.received):
            used_bps.append(rate_bps)
    looks: list[ServoCondition] = []
    for rate_bps in (
        used_bps or rates_bps[:1]
    ):  # A lone 2IO with other ids replies to its own ids only.
        progress(f"{bus.port}: {rate_bps} bps, all ids")
        connection.set_baud(bus.name, rate_bps)
        looks += _look(connection, bus.name, rate_bps)
    counts = [look.baud_bps for look in looks]
    if counts:
        connection.set_baud(bus.name, max(counts, key=counts.count))
    progress("")
    return looks


def observed(connection: Connection, bus_name: str) -> Unasked:
    """Return what arrives on a bus at its present rate without a query of this program.

    The bus is observed in silence once for each rate.
    """
    baud_bps = connection.buses[bus_name].baud_bps
    unasked = connection.unasked.get((bus_name, baud_bps))
    if unasked is None:
        unasked = connection.unasked[bus_name, baud_bps] = discovery.Unasked()
        silence = discovery.BusListening(bus_name, discovery.silent_steps(baud_bps))
        unasked.observe(connection.run(silence).received)
    return unasked


def unreadable(connection: Connection, bus: Bus, *, is_silent: bool) -> list[str]:
    """Return notes about a port that echoes, and a bus on which a survey found unreadable bytes.

    `is_silent`: no servo has answered there.
    """
    is_echoing = bus.name in connection.echoing
    echo = [echo_text(bus.port, is_alone=is_silent)] if is_echoing else []
    seen = [one for (name, _), one in connection.unasked.items() if name == bus.name]
    is_unreadable = any(one.unreadable_bytes for one in seen)
    return echo + ([unreadable_text(bus.port)] if is_unreadable else [])


def roll_call(connection: Connection, bus_name: str) -> list[ServoIdentity]:
    """Return the servos that reply on a bus at its present rate."""
    baud_bps = connection.buses[bus_name].baud_bps
    unasked = observed(connection, bus_name)
    models: dict[int, str] = {}
    doubtful: set[int] = set()
    for _ in range(discovery.ROLL_CALLS):
        left = [servo_id for servo_id in range(ID_MAX + 1) if servo_id not in models]
        received = connection.run(
            BusListening(bus_name, discovery.roll_call_steps(baud_bps, left))
        ).received
        unasked.take(received, is_silent=False)
        answered, again = discovery.read_roll_call(baud_bps, left, received)
        models |= answered
        doubtful |= again
    found = {servo_id: models.get(servo_id, "") for servo_id in sorted(models.keys() | doubtful)}
    return query_each(connection, bus_name, found)


def query_each(
    connection: Connection, bus_name: str, models: Mapping[int, str]
) -> list[ServoIdentity]:
    """Return the servos that reply at these ids. `models` may be empty texts.

    While another host disturbs the bus, an id whose queries are regularly answered by unreadable
    bytes is returned as doubtful.
    """
    baud_bps = connection.buses[bus_name].baud_bps
    unasked = observed(connection, bus_name)
    replies: dict[int, list[bytes]] = {servo_id: [] for servo_id in models}

    def query(ids: Iterable[int], keyword: str, times: int) -> None:
        asked = [servo_id for servo_id in ids for _ in range(times)]
        steps = [discovery.question_alone(servo_id, keyword, baud_bps) for servo_id in asked]
        received = connection.run(BusListening(bus_name, steps)).received
        for servo_id, data in zip(asked, discovery.own_answers(asked, received), strict=True):
            replies[servo_id].append(data)

    def judge(servo_id: int) -> ServoIdentity | None:
        model, received = models[servo_id], replies[servo_id]
        return discovery.judge_answers(servo_id, model, received, is_disturbed=unasked.is_disturbed)

    query(models, "QMS", discovery.ASKED_ALONE)
    unreadable: list[int] = []
    if unasked.is_decidable:
        unreadable = list(models)
        for _ in range(discovery.UNREADABLE_MAX - discovery.ASKED_ALONE):
            unreadable = [n for n in unreadable if discovery.only_unreadable(n, replies[n])]
            query(unreadable, "QMS", 1)
        unreadable = [n for n in unreadable if discovery.only_unreadable(n, replies[n])]
    judged = {servo_id: judge(servo_id) for servo_id in models}
    numbered = [n for n, present in judged.items() if present and present.family is not Family.IO2]
    query(numbered, "QN", discovery.ASKED_ALONE)
    doubtful = [n for n in models if discovery.is_doubtful(n, replies[n])]
    query([n for n in doubtful if n in numbered], "QN", discovery.ASKED_AGAIN)
    if not unasked.is_decidable:
        query([n for n in doubtful if n not in numbered], "QMS", discovery.ASKED_AGAIN)
    for servo_id in models:
        judged[servo_id] = judge(servo_id)
    for servo_id in unreadable:
        judged[servo_id] = ServoIdentity(servo_id=servo_id, model="", is_doubtful=True)
    return [present for present in judged.values() if present is not None]


def _look(connection: Connection, bus_name: str, baud_bps: int) -> list[ServoCondition]:
    found = roll_call(connection, bus_name)
    unasked = observed(connection, bus_name)
    items = [item for p in found if p.is_single for item in discovery.questions(bus_name, p)]
    answers = connection.ask(items)
    looks = [discovery.read_condition(bus_name, baud_bps, present, answers) for present in found]
    looks = [replace(seen, unasked=unasked.replies[seen.servo_id]) for seen in looks]
    causes = connection.ask(discovery.cause_questions(looks))
    return [
        replace(seen, cause=discovery.read_cause(seen, causes))
        if (bus_name, seen.servo_id, "Q") in causes
        else seen
        for seen in looks
    ]


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
    others = unreadable(connection, bus, is_silent=not looks)
    if not looks:
        return servos, [*others, f"bus {bus_name}: {NO_ANSWER}"]
    problems = [
        *others,
        *unreachable(bus, looks),
        *differences(robot, bus, looks),
        *warnings(looks, f"--port {bus.port}"),
        *unnamed(robot, bus, looks),
    ]
    return servos, problems
