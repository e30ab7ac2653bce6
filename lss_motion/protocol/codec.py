"""Physical values ⇄ commands and replies, by the table of the family. Wire units stay inside.

What we say is checked and refused with the allowed range (`ProtocolError`). What we hear is never
refused: what the table does not know or cannot read is None.

What a servo keeps without power: which rows those are, and their values on the wire.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, assert_never

from lss_motion.errors import ProtocolError
from lss_motion.protocol.constants import BROADCAST_ID, BUTTON_ID, GROUP_FIRMWARE, Family
from lss_motion.protocol.io2 import IO2_TABLE
from lss_motion.protocol.line import DISABLED, Command, Reply
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.lss_pro import PRO_TABLE
from lss_motion.protocol.table import Form, ReplyShape, Suffix, Unit, Value, unknown_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.protocol.table import FamilyTable, Row


FAMILY_TABLES: Final[Mapping[Family, FamilyTable]] = {
    Family.LSS: LSS_TABLE,
    Family.LSS_PRO: PRO_TABLE,
    Family.IO2: IO2_TABLE,
}

_SENSOR_SUFFIXES: Final = (Suffix.GP2Y0A41SK0F, Suffix.GP2Y0A21YK0F, Suffix.GP2Y0A02YK0F)


@dataclass(frozen=True, slots=True, kw_only=True)
class Decoded:
    """One command or reply in physical terms: what was said about which row.

    `value` is in `unit`; it is text for the replies that are text, and None where nothing was
    said or a first position is disabled. For a query it is the suffix, and `suffix` its meaning.
    `modifiers` are in the units of their rows.
    """

    servo_id: int | None
    keyword: str
    form: Form
    row: Row
    value: float | str | None = None
    unit: Unit = Unit.NONE
    suffix: Suffix | None = None
    modifiers: Mapping[str, float] = field(default_factory=dict)


def make_command(
    family: Family,
    servo_id: int,
    keyword: str,
    value: float | None = None,
    modifiers: Mapping[str, float] | None = None,
    *,
    firmware: int | None = None,
) -> Command:
    """Return the command that says `value`, in the row's unit, rounded to what the wire can say.

    A query takes its suffix as `value`. Codes must be whole numbers. Raises ProtocolError for
    what the family, or its `firmware` (newest if None), cannot say, with what is allowed.
    """
    table = FAMILY_TABLES[family]
    keyword = keyword.upper()
    form, row = table.find(keyword)
    known = table.firmware if firmware is None else firmware
    _check_firmware(keyword, row, known)
    if not (0 <= servo_id <= BUTTON_ID):
        raise ProtocolError(f"servo id {servo_id}: allowed are 0 to {BUTTON_ID}")
    say = _suffix if form is Form.QUERY else _wire
    said = _modifiers(table, row, keyword, modifiers or {}, known)
    return Command(servo_id, keyword, say(keyword, row, value, known), said)


def read_command(family: Family, command: Command) -> Decoded | None:
    """Return what a command says, or None if the family has no such command.

    The range is not judged: what a servo makes of a value outside it is `Row.kept`. A family
    without modifiers (2IO) hears past them (FACTS.md B5); another refuses those it does not know.
    """
    table = FAMILY_TABLES[family]
    found = table.by_keyword.get(command.keyword)
    modifiers = command.modifiers if table.modifiers else ()
    if found is None or any(name not in table.modifiers for name, _ in modifiers):
        return None
    form, row = found
    is_query = form is Form.QUERY
    suffixes = (row.suffixes or {}) if is_query else {}
    value = command.value
    return Decoded(
        servo_id=command.servo_id,
        keyword=command.keyword,
        form=form,
        row=row,
        value=value if is_query or not isinstance(value, int) else row.physical(value),
        unit=Unit.NONE if is_query else row.unit,
        suffix=suffixes.get(value) if isinstance(value, int) else None,
        modifiers={name: table.modifiers[name].physical(wire) for name, wire in modifiers},
    )


def make_reply(
    family: Family, servo_id: int | None, keyword: str, value: float | str | None = None
) -> Reply:
    """Return the reply that says `value`; None says nothing, or `DIS` for a first position.

    Raises ProtocolError where the shape of the row's reply cannot say it.
    """
    form, row = FAMILY_TABLES[family].find(keyword)
    if form is not Form.QUERY:
        raise ProtocolError(f"{keyword} is no query of {family}: nothing answers it")
    if value is None and row.reply_shape is ReplyShape.DISABLED:
        return Reply(servo_id, keyword, DISABLED)
    said = row.wire(value) if isinstance(value, int | float) else value
    if not _is_readable(row.reply_shape, said):
        raise ProtocolError(f"{keyword} answers {row.reply_shape}, not {value!r}")
    return Reply(servo_id, keyword, said)


def read_reply(family: Family, reply: Reply, *, suffix: int | None = None) -> Decoded | None:
    """Return what a reply says, or None if it is no reply of the family.

    `suffix` is what was asked with the query; the reply does not repeat it, but the unit can
    depend on it (`QA1` answers mm). The id in a reply to `QID` is the value, never the address.
    """
    found = FAMILY_TABLES[family].by_keyword.get(reply.keyword)
    if found is None or found[0] is not Form.QUERY:
        return None
    form, row = found
    if not _is_readable(row.reply_shape, reply.value):
        return None
    value = (
        None if row.reply_shape is ReplyShape.DISABLED and reply.value == DISABLED else reply.value
    )
    meaning = (row.suffixes or {}).get(0 if suffix is None else suffix)
    return Decoded(
        servo_id=value if row.name == "ID" and isinstance(value, int) else reply.servo_id,
        keyword=reply.keyword,
        form=form,
        row=row,
        value=row.physical(value) if isinstance(value, int) else value,
        unit=Unit.MM if meaning in _SENSOR_SUFFIXES else row.unit,
        suffix=meaning,
    )


def identify_reply(family: Family, servo_id: int, asked_id: int, *, firmware: int) -> Reply:
    """Return what servo `servo_id` answers to `#<asked_id>QID` (three shapes: FACTS.md C5)."""
    if asked_id != BROADCAST_ID:
        return Reply(servo_id, "QID", servo_id)
    match family:
        case Family.LSS:
            return Reply(servo_id if firmware >= GROUP_FIRMWARE else None, "QID", servo_id)
        case Family.LSS_PRO:
            return Reply(BROADCAST_ID, "QID", servo_id)
        case Family.IO2:
            raise ProtocolError("a 2IO does not answer QID")
        case _:
            assert_never(family)


def _check_firmware(keyword: str, row: Row, firmware: int) -> None:
    if firmware < row.firmware:
        raise ProtocolError(f"{keyword} needs firmware {row.firmware} or newer, not {firmware}")


def _suffix(keyword: str, row: Row, value: float | None, firmware: int) -> int | None:
    """Return the number after a query, checked against the row."""
    if value is None:
        return None
    if row.suffix_is_delay and float(value).is_integer() and value >= 0:
        if firmware < GROUP_FIRMWARE:
            raise ProtocolError(f"{keyword}{value:g} needs firmware {GROUP_FIRMWARE} or newer")
        return int(value)
    suffixes = row.suffixes or {}
    if value not in suffixes:
        allowed = ", ".join(f"{number} ({name})" for number, name in suffixes.items()) or "none"
        raise ProtocolError(f"{keyword} with suffix {value:g}: allowed are {allowed}")
    return int(value)


def _wire(keyword: str, row: Row, value: float | None, firmware: int) -> int | None:
    """Return the value on the wire, checked against the row."""
    if value is None:
        if row.value is Value.REQUIRED:
            raise ProtocolError(f"{keyword} needs a value: {row.allowed()}")
        return None
    if row.value is Value.NONE:
        raise ProtocolError(f"{keyword} takes no value, not {value:g}")
    is_sayable = math.isfinite(value) and (row.unit is not Unit.NONE or value == int(value))
    wire = row.wire(value, row.step) if is_sayable else None
    if wire is None or not row.allows(wire):
        raise ProtocolError(f"{keyword} {value:g}: allowed are {row.allowed()}")
    since = 0 if row.choices is None else row.choices[wire]
    if firmware < since:
        raise ProtocolError(f"{keyword} {value:g} needs firmware {since} or newer, not {firmware}")
    return wire


def _modifiers(
    table: FamilyTable, row: Row, keyword: str, modifiers: Mapping[str, float], firmware: int
) -> tuple[tuple[str, int], ...]:
    if modifiers and keyword not in row.actions:
        raise ProtocolError(f"{keyword} takes no modifier")
    said: list[tuple[str, int]] = []
    for name in row.modifiers:
        if name in modifiers:
            modifier = table.modifiers[name]
            _check_firmware(name, modifier, firmware)
            wire = _wire(name, modifier, modifiers[name], firmware)
            assert wire is not None
            said.append((name, wire))
    for name in modifiers:
        if name not in row.modifiers:
            allowed = ", ".join(row.modifiers) or "none"
            raise ProtocolError(f"{keyword} with {name}: allowed modifiers are {allowed}")
    return tuple(said)


def _is_readable(answer: ReplyShape, value: int | str | None) -> bool:
    match answer:
        case ReplyShape.INTEGER:
            return isinstance(value, int)
        case ReplyShape.DISABLED:
            return value == DISABLED or isinstance(value, int)
        case ReplyShape.OPTIONAL:
            return value is None or isinstance(value, int)
        case ReplyShape.VERSION:
            is_dotted = isinstance(value, str) and value.replace(".", "").isdecimal()
            return is_dotted or isinstance(value, int)
        case ReplyShape.TEXT:
            return isinstance(value, str)
        case _:
            assert_never(answer)


_FIRST: Final = ("G", "AR")
"""Written before the others: G before O (FACTS.md R10), and AR before what is a pulse within it."""


@cache
def storable(family: Family) -> Mapping[str, Row]:
    """Return the rows that can be configured, by name, in the order in which to write them.

    Without the id, which names the servo, and without rows that say the same in another unit.
    """
    rows = [
        row
        for row in FAMILY_TABLES[family].rows
        if row.configs and row.mirrors is None and row.name != "ID"
    ]
    rows.sort(key=lambda row: row.name not in _FIRST)
    return MappingProxyType({row.name: row for row in rows})


def stored_wire(family: Family, name: str, value: float | None) -> int | None:
    """Return a stored value as it is on the wire; None, for a first position only: there is none.

    Raises ProtocolError for what the family does not store, or not with this value, with what is
    allowed.
    """
    rows = storable(family)
    if name not in rows:
        raise ProtocolError(unknown_text(name, rows, f"setting that {family} stores"))
    row = rows[name]
    if value is None:
        if row.reply_shape is not ReplyShape.DISABLED:
            raise ProtocolError(f"{name} has no DIS: {row.allowed()}")
        return None
    wire = make_command(family, 0, row.configs[0], value).value
    assert isinstance(wire, int)
    return wire
