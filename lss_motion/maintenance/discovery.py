"""Finds the servos of a bus and reads what they are.

Who is on a bus: which rates are in use, which ids answer, and which ids several servos share.

Every question here is one that moves nothing and changes nothing. `QMS` is asked because all
three families answer it; a broadcast only says that somebody is there, since all answer at once,
and a 2IO does not answer it at all (FACTS.md B13).

Saying lines and keeping every byte that comes back: for buses of which nothing is known yet.

One look at a servo that answers: what it is, and how it does.

Letting time pass on open ports: what the servos say meanwhile is dropped.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.player.query_tracker import REPLY_MAX_BYTES, REPLY_TIMEOUT_NS
from lss_motion.player.transactions import Item
from lss_motion.protocol.codec import FAMILY_TABLES, read_reply
from lss_motion.protocol.constants import (
    BAUD_RATES_BPS,
    BROADCAST_ID,
    Family,
    SafeModeCause,
    Status,
    status_from,
)
from lss_motion.protocol.io2 import PIN_IDS
from lss_motion.protocol.line import Command, Reply, ReplyParser, encode
from lss_motion.units import NS_PER_MS, line_time_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.player.events import Event

    Answers = Mapping[tuple[str, int, str], int | str | None]


@dataclass(frozen=True, slots=True)
class Step:
    """Bytes to send, and how long to listen from then on."""

    data: bytes
    listen_ns: int


class Listening:
    """Works through `steps` on one bus, for the runner.

    `heard` has what came while each step was the last one sent; what an adapter holds back may
    stand with a later step.
    """

    def __init__(self, bus: str, steps: Sequence[Step]) -> None:
        self.received = [b"" for _ in steps]
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
        return {self._bus: step.data} if step.data else {}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        if self._next:
            self.received[self._next - 1] += data

    def next_wakeup_ns(self) -> int | None:
        return self._until_ns

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}


RATES_BPS: Final = (
    115200,
    *(rate for rate in sorted(BAUD_RATES_BPS, reverse=True) if rate != 115200),
)
"""The factory's rate first (FACTS.md W23), then from the fastest: those take the least time."""
TURNAROUND_NS: Final = 2 * NS_PER_MS
"""From a question to its answer, at most, while ids are called one after the other: 1.8 ms of
older firmware (FACTS.md W13). What comes later may meet another answer; those ids are asked
again alone."""
HELD_BACK_NS: Final = 20 * NS_PER_MS
"""How long an adapter may hold an answer back: 16 ms (FACTS.md H1) and a little more."""
CALLS: Final = 2
"""How often everybody is called: an answer can be lost, or look like another's."""
ASKED_ALONE: Final = 2
ASKED_AGAIN: Final = 4
"""How often an id is asked alone; again when one answer was damaged. Firmware up to 368 damages
some answers by itself (FACTS.md W21), so one bad answer proves nothing."""

_CLEAN: Final = re.compile(rb"\*([0-9]+)(QMS|QN)([!-)+-~]+)\r")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoIdentity:
    """What answers to one id. `is_shared`: several devices do, at once.

    `model` is what `QMS` says, empty where every answer was damaged.
    """

    servo_id: int
    model: str
    serial_number: str = ""
    is_shared: bool = False

    @property
    def family(self) -> Family:
        return family_of(self.model)


def family_of(model: str) -> Family:
    """Return the family that a model string names (FACTS.md P18; LSS where it says neither)."""
    if model.startswith("LSS-2IO"):
        return Family.IO2
    return Family.LSS_PRO if model.startswith("LSS-P-") else Family.LSS


def presence_steps(baud_bps: int) -> list[Step]:
    """Return what makes anybody at this rate say something, twice: an answer may be damaged."""
    listen_ns = REPLY_TIMEOUT_NS + HELD_BACK_NS + line_time_ns(2 * REPLY_MAX_BYTES, baud_bps)
    lines = [Command(BROADCAST_ID, "QID"), Command(PIN_IDS["MASTER"], "QMS")]
    return [
        Step(b"\r", 0),  # Ends whatever noise stands in the servos' buffers.
        *(Step(encode(line), listen_ns) for _ in range(2) for line in lines),
    ]


def roll_call_steps(baud_bps: int, ids: Iterable[int]) -> list[Step]:
    """Return the roll call: one question to each id, and a wait for what is held back."""
    gap_ns = TURNAROUND_NS + line_time_ns(REPLY_MAX_BYTES, baud_bps)
    steps = [_question(servo_id, "QMS", gap_ns, baud_bps) for servo_id in ids]
    return [*steps, Step(b"", REPLY_TIMEOUT_NS + HELD_BACK_NS)]


def read_roll_call(
    baud_bps: int, ids: Sequence[int], heard: Sequence[bytes]
) -> tuple[dict[int, str], set[int]]:
    """Return the models by id that answered a roll call of `ids`, and who is to be asked again.

    An id is asked again if damaged bytes came in the time in which its answer could have come.
    """
    models = {
        item.servo_id: str(item.value)
        for item in ReplyParser(grouped=False).feed(b"".join(heard))
        if isinstance(item, Reply) and item.servo_id is not None and item.keyword == "QMS"
    }
    gap_ns = TURNAROUND_NS + line_time_ns(REPLY_MAX_BYTES, baud_bps)
    behind = 1 + HELD_BACK_NS // gap_ns
    doubtful: set[int] = set()
    for index, data in enumerate(heard):
        if _CLEAN.sub(b"", data):
            doubtful.update(ids[max(index - behind, 0) : index + 1])
    return models, doubtful


def question_alone(servo_id: int, keyword: str, baud_bps: int) -> Step:
    """Return a question with all the time that its answer may take."""
    listen_ns = REPLY_TIMEOUT_NS + line_time_ns(REPLY_MAX_BYTES, baud_bps)
    return _question(servo_id, keyword, listen_ns, baud_bps)


def is_damaged(servo_id: int, data: bytes) -> bool:
    """Return whether what came after one question is anything but one clean answer or silence."""
    return bool(data) and (len(_values(servo_id, data)) != 1 or _CLEAN.sub(b"", data) != b"")


def judge_answers(servo_id: int, model: str, heard: Sequence[bytes]) -> ServoIdentity | None:
    """Return what answered to an id that was asked alone; None: nobody.

    Several devices share it when three quarters of what came was damaged or two answers, or when
    two serial numbers came more than once each.
    """
    answers = [data for data in heard if data]
    if not answers:
        return None
    clean = [data for data in answers if not is_damaged(servo_id, data)]
    counts = _numbers(servo_id, heard).most_common(2)
    models = [text for data in answers for key, text in _values(servo_id, data) if key == "QMS"]
    is_shared = 4 * len(clean) <= len(answers) or (len(counts) > 1 and counts[1][1] > 1)
    return ServoIdentity(
        servo_id=servo_id,
        model=model or (models[0] if models else ""),
        serial_number="" if is_shared or not counts else counts[0][0],
        is_shared=is_shared,
    )


def is_doubtful(servo_id: int, heard: Sequence[bytes]) -> bool:
    """Return whether an id must be asked again: damage, or two serial numbers."""
    is_any_damaged = any(is_damaged(servo_id, data) for data in heard)
    return is_any_damaged or len(_numbers(servo_id, heard)) > 1


def _numbers(servo_id: int, heard: Sequence[bytes]) -> Counter[str]:
    """Return how often each serial number came, in answers that look undamaged."""
    return Counter(
        text
        for data in heard
        if not is_damaged(servo_id, data)
        for keyword, text in _values(servo_id, data)
        if keyword == "QN"
    )


def _question(servo_id: int, keyword: str, listen_ns: int, baud_bps: int) -> Step:
    data = encode(Command(servo_id, keyword))
    return Step(data, listen_ns + line_time_ns(len(data), baud_bps))


def _values(servo_id: int, data: bytes) -> list[tuple[str, str]]:
    """Return keyword and text of every clean answer of one id in `data`."""
    return [
        (match[2].decode(), match[3].decode())
        for match in _CLEAN.finditer(data)
        if int(match[1]) == servo_id
    ]


HOT_C: Final = 65.0
"""Warn from here on; at 85 °C a servo lets go (FACTS.md S7). Chosen: time to do something."""
SUPPLY_MIN_V: Final = 6.0
SUPPLY_MAX_V: Final = 12.6
"""The range of the datasheets (FACTS.md E4)."""
CURRENT_MAX_A: Final = 1.5
"""What users plan for in the long run (FACTS.md E5)."""
BAD_STATUS: Final = (Status.STUCK, Status.BLOCKED, Status.SAFE_MODE, Status.ERROR)

_QUESTIONS: Final = ("QF", "QN", "QD", "QV", "QT", "Q")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoCondition:
    """What one servo said; None where it said nothing. Angles are the servo's own."""

    bus: str
    baud_bps: int
    identity: ServoIdentity
    firmware: int | None = None
    position_deg: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    status: Status | None = None
    cause: SafeModeCause | None = None

    @property
    def servo_id(self) -> int:
        return self.identity.servo_id


def questions(bus: str, present: ServoIdentity) -> list[Item]:
    """Return what to ask of one servo, those questions only that its family answers."""
    table = FAMILY_TABLES[present.family]
    return [
        Item(bus=bus, command=Command(present.servo_id, keyword), is_query=True)
        for keyword in _QUESTIONS
        if keyword in table.by_keyword and _is_answered_by(present, keyword)
    ]


def cause_questions(looks: Sequence[ServoCondition]) -> list[Item]:
    """Return the questions for the cause of safe mode, of the servos that are in it."""
    return [
        Item(bus=look.bus, command=Command(look.servo_id, "Q", 1), is_query=True)
        for look in looks
        if look.status is Status.SAFE_MODE
    ]


def read_condition(
    bus: str, baud_bps: int, present: ServoIdentity, answers: Answers
) -> ServoCondition:
    """Return what the answers to `questions` say."""
    firmware = answers.get((bus, present.servo_id, "QF"))
    version = firmware if isinstance(firmware, int) else None
    status = answers.get((bus, present.servo_id, "Q"))

    def number(keyword: str) -> float | None:
        value = answers.get((bus, present.servo_id, keyword))
        if value is None:
            return None
        said = read_reply(present.family, Reply(present.servo_id, keyword, value))
        is_number = said is not None and isinstance(said.value, int | float)
        return float(said.value) if said is not None and is_number else None  # type: ignore[arg-type]

    return ServoCondition(
        bus=bus,
        baud_bps=baud_bps,
        identity=present,
        firmware=version,
        position_deg=number("QD"),
        voltage_v=number("QV"),
        temperature_c=number("QT"),
        status=status_from(status, present.family, version or 0)
        if isinstance(status, int)
        else None,
    )


def read_cause(look_: ServoCondition, answers: Answers) -> SafeModeCause | None:
    """Return what the answer to `cause_questions` says."""
    value = answers.get((look_.bus, look_.servo_id, "Q"))
    known = {int(cause) for cause in SafeModeCause}
    return SafeModeCause(value) if isinstance(value, int) and value in known else None


def _is_answered_by(present: ServoIdentity, keyword: str) -> bool:
    """Ask a 2IO for positions only at its digital pins, where RC servos are (FACTS.md B2)."""
    return keyword != "QD" or "LSS-2IO-" not in present.model or "-D" in present.model


class Pause:
    """Drives nothing until `until_ns`, for the runner."""

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
