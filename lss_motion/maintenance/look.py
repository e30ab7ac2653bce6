"""One look at a servo that answers: what it is, and how it does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.player.dialogue import Item
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import SafeModeCause, Status, status_from
from lss_motion.protocol.families import FAMILY_TABLES
from lss_motion.protocol.line import Command, Reply

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.maintenance.roll_call import Present

    Answers = Mapping[tuple[str, int, str], int | str | None]

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
class Look:
    """What one servo said; None where it said nothing. Angles are the servo's own."""

    bus: str
    baud_bps: int
    present: Present
    firmware: int | None = None
    position_deg: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    status: Status | None = None
    cause: SafeModeCause | None = None

    @property
    def servo_id(self) -> int:
        return self.present.servo_id


def questions(bus: str, present: Present) -> list[Item]:
    """Return what to ask of one servo, those questions only that its family answers."""
    table = FAMILY_TABLES[present.family]
    return [
        Item(bus=bus, command=Command(present.servo_id, keyword), is_question=True)
        for keyword in _QUESTIONS
        if keyword in table.by_keyword and _is_answered_by(present, keyword)
    ]


def cause_questions(looks: Sequence[Look]) -> list[Item]:
    """Return the questions for the cause of safe mode, of the servos that are in it."""
    return [
        Item(bus=look.bus, command=Command(look.servo_id, "Q", 1), is_question=True)
        for look in looks
        if look.status is Status.SAFE_MODE
    ]


def look(bus: str, baud_bps: int, present: Present, answers: Answers) -> Look:
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

    return Look(
        bus=bus,
        baud_bps=baud_bps,
        present=present,
        firmware=version,
        position_deg=number("QD"),
        voltage_v=number("QV"),
        temperature_c=number("QT"),
        status=status_from(status, present.family, version or 0)
        if isinstance(status, int)
        else None,
    )


def cause_of(look_: Look, answers: Answers) -> SafeModeCause | None:
    """Return what the answer to `cause_questions` says."""
    value = answers.get((look_.bus, look_.servo_id, "Q"))
    known = {int(cause) for cause in SafeModeCause}
    return SafeModeCause(value) if isinstance(value, int) and value in known else None


def _is_answered_by(present: Present, keyword: str) -> bool:
    """Ask a 2IO for positions only at its digital pins, where RC servos are (FACTS.md B2)."""
    return keyword != "QD" or "LSS-2IO-" not in present.model or "-D" in present.model
