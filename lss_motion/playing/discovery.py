"""Which servos are on a bus, their condition, and the limits that a robot file leaves to them.

The roll call finds the baud rates in use, the ids that answer, and the ids that several servos
share. No query here moves or changes anything. The roll call sends `QMS`, which all three families
answer. A broadcast only shows that there are servos, because all answer at once; the only one that
a 2IO answers is QMS (FACTS.md B13).

`BusListening` and `SilentPause` are for the run loop: the one sends bytes and keeps every byte that
comes back, for a bus of which nothing is known yet; the other lets time pass.

A joint limit may be left to its servo: `speed_max_deg_s: servo` is the setting SD,
`accel_max_deg_s2: servo` the smaller of AA and AD. `limit_questions` asks for them.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import BusError, InputError
from lss_motion.playing.player.echo import EchoFilter
from lss_motion.playing.player.handshake import Item
from lss_motion.playing.player.query_tracker import REPLY_MAX_BYTES, REPLY_TIMEOUT_NS
from lss_motion.protocol.codec import FAMILY_TABLES, read_reply, storable
from lss_motion.protocol.constants import (
    BAUD_RATES_BPS,
    BROADCAST_ID,
    Family,
    SafeModeCause,
    Status,
    status_from,
)
from lss_motion.protocol.framing import Command, Reply, ReplyParser, encode
from lss_motion.units import NS_PER_MS, line_time_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.model import Joint, Robot

RATES_BPS: Final = (
    115200,
    *(rate for rate in sorted(BAUD_RATES_BPS, reverse=True) if rate != 115200),
)
"""The factory rate first (FACTS.md W23), then from the fastest, which takes the least time."""
TURNAROUND_NS: Final = 2 * NS_PER_MS
"""The longest time from a query to its answer during the roll call: 1.8 ms with older firmware
(FACTS.md W13). A later answer may collide with the next; those ids are queried alone."""
HELD_BACK_NS: Final = 20 * NS_PER_MS
"""How long an adapter may hold an answer back: 16 ms (FACTS.md H1) and a margin."""
ROLL_CALLS: Final = 2
"""How often the roll is called: an answer can be lost, or look like that of another id."""
ASKED_ALONE: Final = 2
ASKED_AGAIN: Final = 4
"""How often an id is queried alone, and how often when an answer was damaged. Firmware up to 368
damages some answers by itself (FACTS.md W21), so one bad answer proves nothing."""

UNASKED_NS: Final = 400 * NS_PER_MS
"""How long the bus is observed without a query: another program polls several times a second."""
UNREADABLE_MAX: Final = 20
"""How often an id is queried on a disturbed bus, while only unreadable bytes come. Chosen: where
half of the waits are disturbed, one of 5,000 ids without a servo has at most two silent waits."""
SILENT_ENOUGH: Final = 3
"""Several servos answer every query, so an id that was silent so often has none. Chosen: one of
the queries may be lost, and one reply be late."""
DECIDABLE_RATIO: Final = 0.5
"""Where more of the waits without a query are disturbed, unreadable bytes tell nothing of an id."""

_CLEAN: Final = re.compile(rb"\*([0-9]+)(QMS|QN|Q[A-Z]*)([!-)+-~]*)\r")
_ASKED_HERE: Final = ("QMS", "QN")
_CUT_OFF: Final = re.compile(rb"\A[0-9A-Z-]*\r|\*[0-9]*[!-)+-~]*\Z")
"""A reply that began before the bus was observed, or ends after it."""

HOT_C: Final = 65.0
"""A warning is due from here on; at 85 °C a servo goes limp (FACTS.md S7). Chosen: time to act."""
SUPPLY_MIN_V: Final = 6.0
SUPPLY_MAX_V: Final = 12.6
"""The range of the datasheets (FACTS.md E4)."""
CURRENT_MAX_A: Final = 1.5
"""The continuous current that users plan for (FACTS.md E5)."""
BAD_STATUS: Final = (Status.STUCK, Status.BLOCKED, Status.SAFE_MODE, Status.ERROR)

_QUESTIONS: Final = ("QF", "QN", "QD", "QV", "QT", "Q")


class ServoIdentity(Struct, frozen=True, kw_only=True):
    """The device that answers to an id; with `is_shared`, several devices.

    `model` is the answer to `QMS`, empty if every answer was damaged. With `is_doubtful` there was
    no readable answer on a bus that another host disturbs: there may be several devices.
    """

    servo_id: int
    model: str
    serial_number: str = ""
    is_shared: bool = False
    is_doubtful: bool = False

    @property
    def is_single(self) -> bool:
        """Whether one device answers to this id, beyond doubt."""
        return not (self.is_shared or self.is_doubtful)

    @property
    def family(self) -> Family:
        return family_of(self.model)


def family_of(model: str) -> Family:
    """Return the family of a model name (FACTS.md P18; LSS if the name shows neither other one)."""
    if model.startswith("LSS-2IO"):
        return Family.IO2
    return Family.LSS_PRO if model.startswith("LSS-P-") else Family.LSS


def presence_steps(baud_bps: int) -> list[DiscoveryStep]:
    """Return queries that every servo at this rate answers, each twice for damaged answers."""
    listen_ns = REPLY_TIMEOUT_NS + HELD_BACK_NS + line_time_ns(2 * REPLY_MAX_BYTES, baud_bps)
    lines = [Command(BROADCAST_ID, "QID"), Command(BROADCAST_ID, "QMS")]
    return [
        DiscoveryStep(b"\r", 0),  # Ends any noise in the servos' buffers.
        *(DiscoveryStep(encode(line), listen_ns) for _ in range(2) for line in lines),
    ]


def roll_call_steps(baud_bps: int, ids: Iterable[int]) -> list[DiscoveryStep]:
    """Return the roll call: a query to each id, then a wait for delayed answers."""
    gap_ns = TURNAROUND_NS + line_time_ns(REPLY_MAX_BYTES, baud_bps)
    steps = [_question(servo_id, "QMS", gap_ns, baud_bps) for servo_id in ids]
    return [*steps, DiscoveryStep(b"", REPLY_TIMEOUT_NS + HELD_BACK_NS)]


def read_roll_call(
    baud_bps: int, ids: Sequence[int], received: Sequence[bytes]
) -> tuple[dict[int, str], set[int]]:
    """Return the models by id that answered a roll call of `ids`, and the ids to query again.

    An id is queried again if damaged bytes came while its answer could have come.
    """
    models = {
        item.servo_id: str(item.value)
        for item in ReplyParser(grouped=False).feed(b"".join(received))
        if isinstance(item, Reply) and item.servo_id is not None and item.keyword == "QMS"
    }
    gap_ns = TURNAROUND_NS + line_time_ns(REPLY_MAX_BYTES, baud_bps)
    behind = 1 + HELD_BACK_NS // gap_ns
    doubtful: set[int] = set()
    for index, data in enumerate(received):
        if _CLEAN.sub(b"", data):
            doubtful.update(ids[max(index - behind, 0) : index + 1])
    return models, doubtful


def question_alone(servo_id: int, keyword: str, baud_bps: int) -> DiscoveryStep:
    """Return a query with the longest time that its answer may take."""
    listen_ns = REPLY_TIMEOUT_NS + line_time_ns(REPLY_MAX_BYTES, baud_bps)
    return _question(servo_id, keyword, listen_ns, baud_bps)


def own_answers(asked: Sequence[int | None], received: Sequence[bytes]) -> list[bytes]:
    """Return the data after the query to each id of `asked`, without whole answers of other ids.

    Another host causes those. They may begin after one query and end after the next. None in
    `asked` is a wait without a query.
    """
    whole = b"".join(received)
    places = [index for index, data in enumerate(received) for _ in data]
    foreign: set[int] = set()
    for match in _CLEAN.finditer(whole):
        first, last = places[match.start()], places[match.end() - 1]
        if int(match[1]) not in (asked[first], asked[last]):
            foreign.update(range(*match.span()))
    left = [bytearray() for _ in received]
    for offset, (place, byte) in enumerate(zip(places, whole, strict=True)):
        if offset not in foreign:
            left[place].append(byte)
    return [bytes(data) for data in left]


def is_damaged(servo_id: int, data: bytes) -> bool:
    """Return whether the data after one query is more than one clean answer or silence."""
    return bool(data) and (len(_values(servo_id, data)) != 1 or _CLEAN.sub(b"", data) != b"")


def judge_answers(
    servo_id: int, model: str, received: Sequence[bytes], *, is_disturbed: bool = False
) -> ServoIdentity | None:
    """Return the device that answered to an id that was queried alone; None without an answer.

    The id is shared by several devices if three quarters of the answers were damaged or doubled,
    or if two serial numbers came more than once each. Devices answer every time: damaged bytes
    after half of the queries or fewer belong to what another host asked. With `is_disturbed`
    bytes also come without a query (`Unasked`): then only what is readable counts.
    """
    if is_disturbed:
        received = [
            b"".join(match[0] for match in _CLEAN.finditer(data) if int(match[1]) == servo_id)
            for data in received
        ]
    answers = [data for data in received if data]
    clean = [data for data in answers if not is_damaged(servo_id, data)]
    if not clean and 2 * len(answers) <= len(received):
        return None
    counts = _numbers(servo_id, received).most_common(2)
    models = [text for data in answers for key, text in _values(servo_id, data) if key == "QMS"]
    is_shared = 4 * len(clean) <= len(answers) or (len(counts) > 1 and counts[1][1] > 1)
    return ServoIdentity(
        servo_id=servo_id,
        model=model or (models[0] if models else ""),
        serial_number="" if is_shared or not counts else counts[0][0],
        is_shared=is_shared,
    )


def is_doubtful(servo_id: int, received: Sequence[bytes]) -> bool:
    """Return whether an id must be queried again: damaged data, or two serial numbers."""
    is_any_damaged = any(is_damaged(servo_id, data) for data in received)
    return is_any_damaged or len(_numbers(servo_id, received)) > 1


def _numbers(servo_id: int, received: Sequence[bytes]) -> Counter[str]:
    """Return how often each serial number came, in answers that look undamaged."""
    return Counter(
        text
        for data in received
        if not is_damaged(servo_id, data)
        for keyword, text in _values(servo_id, data)
        if keyword == "QN"
    )


def _question(servo_id: int, keyword: str, listen_ns: int, baud_bps: int) -> DiscoveryStep:
    data = encode(Command(servo_id, keyword))
    return DiscoveryStep(data, listen_ns + line_time_ns(len(data), baud_bps))


def _values(servo_id: int, data: bytes) -> list[tuple[str, str]]:
    """Return keyword and text of every clean answer of one id in `data` to a query sent here."""
    return [
        (match[2].decode(), match[3].decode())
        for match in _CLEAN.finditer(data)
        if int(match[1]) == servo_id and match[2].decode() in _ASKED_HERE and match[3]
    ]


def only_unreadable(servo_id: int, received: Sequence[bytes]) -> bool:
    """Return whether nothing readable came from an id, and bytes after almost all its queries.

    That is how several servos answer while another host disturbs the bus.
    """
    is_readable = any(_values(servo_id, data) for data in received)
    return not is_readable and sum(not data for data in received) < SILENT_ENOUGH


def silent_steps(baud_bps: int) -> list[DiscoveryStep]:
    """Return waits in which nothing is asked, each as long as that for one answer."""
    wait_ns = question_alone(0, "QMS", baud_bps).listen_ns
    return [DiscoveryStep(b"", wait_ns)] * -(-UNASKED_NS // wait_ns)


@dataclass(slots=True)
class Unasked:
    """What arrived on a bus and no query of this program can have caused."""

    replies: Counter[int] = field(default_factory=Counter)
    """Whole replies by id."""
    unreadable_bytes: int = 0
    """Bytes of no readable reply that came while nothing was asked: replies of several servos to
    one query of another host damage each other."""
    is_disturbed: bool = False
    """Whether anything came while nothing was asked."""
    disturbed_ratio: float = 0.0
    """The share of the waits without a query in which unreadable bytes came."""

    @property
    def is_decidable(self) -> bool:
        """Whether an id with several servos can be told from one without, on a disturbed bus."""
        return self.is_disturbed and self.disturbed_ratio <= DECIDABLE_RATIO

    def observe(self, received: Sequence[bytes]) -> None:
        """Use what came during `silent_steps`."""
        self.take(received, is_silent=True)
        self.is_disturbed |= any(received)
        unreadable = own_answers([None] * len(received), received)
        self.disturbed_ratio = sum(map(bool, unreadable)) / len(received)

    def take(self, received: Iterable[bytes], *, is_silent: bool) -> None:
        """Use what came during a roll call, or with `is_silent` while nothing was asked.

        The commands of another computer cannot be seen: only the servos receive them.
        """
        data = b"".join(received)
        self.replies += Counter(
            int(match[1])
            for match in _CLEAN.finditer(data)
            if is_silent or match[2].decode() not in (*_ASKED_HERE, "QID")
        )
        if is_silent:
            self.unreadable_bytes += len(_CLEAN.sub(b"", _CUT_OFF.sub(b"", data)))


class ServoCondition(Struct, frozen=True, kw_only=True):
    """The answers of one servo; None where it did not answer. Angles are servo degrees."""

    bus: str
    baud_bps: int
    identity: ServoIdentity
    firmware: int | None = None
    position_deg: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    status: Status | None = None
    cause: SafeModeCause | None = None
    unasked: int = 0
    """How many of its replies no query of this program can have caused."""

    @property
    def servo_id(self) -> int:
        return self.identity.servo_id


def questions(bus: str, identity: ServoIdentity) -> list[Item]:
    """Return the queries for one servo, as far as its family answers them."""
    table = FAMILY_TABLES[identity.family]
    return [
        Item(bus=bus, command=Command(identity.servo_id, keyword))
        for keyword in _QUESTIONS
        if keyword in table.by_keyword and _is_answered_by(identity, keyword)
    ]


def cause_questions(conditions: Sequence[ServoCondition]) -> list[Item]:
    """Return the queries for the cause of safe mode, to the servos that are in it."""
    return [
        Item(bus=condition.bus, command=Command(condition.servo_id, "Q", 1))
        for condition in conditions
        if condition.status is Status.SAFE_MODE
    ]


def read_condition(
    bus: str, baud_bps: int, identity: ServoIdentity, answers: Answers
) -> ServoCondition:
    """Return the condition that the answers to `questions` give."""
    firmware = answers.get((bus, identity.servo_id, "QF"))
    version = firmware if isinstance(firmware, int) else None
    status = answers.get((bus, identity.servo_id, "Q"))

    def number(keyword: str) -> float | None:
        value = answers.get((bus, identity.servo_id, keyword))
        if value is None:
            return None
        statement = read_reply(identity.family, Reply(identity.servo_id, keyword, value))
        if statement is None or not isinstance(statement.value, int | float):
            return None
        return float(statement.value)

    return ServoCondition(
        bus=bus,
        baud_bps=baud_bps,
        identity=identity,
        firmware=version,
        position_deg=number("QD"),
        voltage_v=number("QV"),
        temperature_c=number("QT"),
        status=status_from(status, identity.family, version) if isinstance(status, int) else None,
    )


def read_cause(condition: ServoCondition, answers: Answers) -> SafeModeCause | None:
    """Return the cause that the answer to `cause_questions` gives."""
    value = answers.get((condition.bus, condition.servo_id, "Q"))
    known = {int(cause) for cause in SafeModeCause}
    return SafeModeCause(value) if isinstance(value, int) and value in known else None


def _is_answered_by(identity: ServoIdentity, keyword: str) -> bool:
    """Query a 2IO for positions only at its digital pins, which drive RC servos (FACTS.md B2)."""
    return keyword != "QD" or "LSS-2IO-" not in identity.model or "-D" in identity.model


class DiscoveryStep(Struct, frozen=True):
    """Bytes to send, and how long to listen afterwards."""

    data: bytes
    listen_ns: int


class BusListening:
    """Works through `steps` on one bus, for the run loop.

    `received` holds the data that came after each step and before the next; data that an adapter
    held back may stand with a later step.
    """

    def __init__(self, bus: str, steps: Sequence[DiscoveryStep]) -> None:
        self.received = [b"" for _ in steps]
        self.echo = EchoFilter()
        self._bus = bus
        self._steps = steps
        self._next = 0
        self._until_ns: int | None = None

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        if self._until_ns is not None and leaves_ns < self._until_ns:
            return {}
        if self._next == len(self._steps):
            self._until_ns = None
            return {}
        step = self._steps[self._next]
        self._next += 1
        self._until_ns = leaves_ns + step.listen_ns
        if step.data:
            self.echo.note_sent(step.data)
        return {self._bus: step.data} if step.data else {}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        if self._next:
            self.received[self._next - 1] += self.echo.without_echo(data)

    def next_wakeup_ns(self) -> int | None:
        return self._until_ns

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}


class SilentPause:
    """Sends nothing until `until_ns`, for the run loop."""

    def __init__(self, until_ns: int) -> None:
        self._until_ns = until_ns
        self._is_over = False

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        self._is_over = leaves_ns >= self._until_ns
        return {}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        pass

    def next_wakeup_ns(self) -> int | None:
        return None if self._is_over else self._until_ns

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}


SETTINGS: Final = {"speed_max_deg_s": ("SD",), "accel_max_deg_s2": ("AA", "AD")}
"""The settings behind a limit; the smallest of them is the limit."""


def limit_questions(robot: Robot) -> list[Item]:
    """Return the queries for the open limits, as they are in this session."""
    return [
        Item.to(joint, f"Q{name}")
        for joint in robot.unread
        for limit in sorted(joint.unread)
        for name in SETTINGS[limit]
    ]


def robot_from_answers(robot: Robot, answers: Answers) -> Robot:
    """Return the robot with the limits that its servos answered.

    Raises `BusError` naming the servos without an answer, `InputError` for a limit of 0.
    """

    def wire(joint: Joint, name: str) -> int | None:
        value = answers.get((joint.bus, joint.servo_id, f"Q{name}"))
        return value if isinstance(value, int) else None

    known = with_limits(robot, physical_limits(robot, wire))
    if known.unread:
        named = ", ".join(
            f"{joint.name} (id {joint.servo_id} on bus {joint.bus!r})" for joint in known.unread
        )
        raise BusError(
            f"the robot file leaves limits to servos that do not answer: {named}. Check power "
            f"and wiring, or give numbers",
            url=robot.buses[known.unread[0].bus].port,
        )
    return known


def with_limits(robot: Robot, limits: Mapping[str, Mapping[str, float]]) -> Robot:
    """Return the robot with `limits`, by joint and name, where its file leaves them open.

    No limit exceeds that of the servo model.
    """
    joints, servos = dict(robot.joints), dict(robot.servos)
    for joint in robot.unread:
        read = {
            key: min(value, getattr(joint, key))
            for key, value in limits.get(joint.name, {}).items()
            if key in joint.unread
        }
        for key, value in read.items():
            if value <= 0.0:
                raise InputError(
                    f"joint {joint.name!r}: {key} is left to servo {joint.servo_id}, and its "
                    f"{' or '.join(SETTINGS[key])} is 0; configure it, or give a number",
                    path=robot.path,
                )
        joints[joint.name] = replace(joint, unread=joint.unread - read.keys(), **read)
        if joint.name in servos:
            servos[joint.name] = joints[joint.name]
    asked = {**robot.read_limits, **{name: dict(values) for name, values in limits.items()}}
    return replace(robot, joints=joints, servos=servos, read_limits=asked)


def physical_limits(
    robot: Robot, wire_of: Callable[[Joint, str], int | None]
) -> dict[str, dict[str, float]]:
    """Return the known limits by joint and name, in horn degrees."""
    limits: dict[str, dict[str, float]] = {}
    for joint in robot.unread:
        rows = storable(joint.model.language)
        for key in joint.unread:
            wires = [wire_of(joint, name) for name in SETTINGS[key]]
            values = [
                rows[name].physical(wire)
                for name, wire in zip(SETTINGS[key], wires, strict=True)
                if wire is not None
            ]
            if len(values) < len(wires):
                continue
            # The ramps are `ramp_ratio` times the values of AA and AD.
            ratio = 1.0 if key == "speed_max_deg_s" else joint.ramp_ratio
            limits.setdefault(joint.name, {})[key] = ratio * min(values)
    return limits
