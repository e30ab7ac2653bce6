"""Physical values ⇄ commands and replies, by the table of the family.

Callers use physical units; wire units stay inside. A command that the family cannot express raises
`ProtocolError` with the allowed range. A command or reply that was received never raises: the
result is None if the table has no such keyword, or if the value cannot be read.

The module also lists the settings that a servo keeps without power (`storable`).
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple, assert_never

from lss_motion.errors import ProtocolError
from lss_motion.protocol.constants import BROADCAST_ID, BUTTON_ID, GROUP_FIRMWARE, Family
from lss_motion.protocol.framing import DISABLED, Command, Reply
from lss_motion.protocol.io2 import IO2_TABLE, rc_table
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.lss_pro import PRO_TABLE, UNITS, Units, pro_table
from lss_motion.protocol.table import Form, ReplyShape, Suffix, Unit, Value, unknown_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.protocol.table import FamilyTable, Row


FAMILY_TABLES: Final[Mapping[Family, FamilyTable]] = {
    Family.LSS: LSS_TABLE,
    Family.LSS_PRO: PRO_TABLE,
    Family.IO2: IO2_TABLE,
}
"""The table of each family, an LSS-PRO with the units that a robot file need not state."""


class Language(NamedTuple):
    """The language of one servo: its family, and for an LSS-PRO the units on its wire.

    The functions here take a `Family` as well: it stands for the usual units.
    """

    family: Family
    units: Units = UNITS


def language_table(language: Family | Language) -> FamilyTable:
    """Return the table of a language."""
    if not isinstance(language, Language):
        return FAMILY_TABLES[language]
    match language.family:
        case Family.LSS_PRO:
            return pro_table(language.units)
        case Family.IO2:
            return rc_table(language.units.rc_pulse_us)
        case _:
            return FAMILY_TABLES[language.family]


_SENSOR_SUFFIXES: Final = (Suffix.GP2Y0A41SK0F, Suffix.GP2Y0A21YK0F, Suffix.GP2Y0A02YK0F)


class Decoded(NamedTuple):
    """One command or reply in physical units.

    `value` is in `unit`. It is text for a reply with text, and None if there is no value or if a
    first position is disabled. For a query, `value` is the suffix and `suffix` is its meaning.
    `modifiers` are in the units of their rows.
    """

    servo_id: int | None
    keyword: str
    form: Form
    row: Row
    value: float | str | None = None
    unit: Unit = Unit.NONE
    suffix: Suffix | None = None
    modifiers: Mapping[str, float] = MappingProxyType({})


def make_command(
    language: Family | Language,
    servo_id: int,
    keyword: str,
    value: float | None = None,
    modifiers: Mapping[str, float] | None = None,
    *,
    firmware: int | None = None,
) -> Command:
    """Return the command with `value`, in the unit of the row, rounded to the wire unit.

    For a query, `value` is the suffix. Codes must be whole numbers. Raises `ProtocolError`, with
    the allowed values, if the family or its `firmware` (newest if None) has no such command.
    """
    table = language_table(language)
    keyword = keyword.upper()
    form, row = table.find(keyword)
    known = table.firmware if firmware is None else firmware
    _check_firmware(keyword, row, known)
    if not (0 <= servo_id <= BUTTON_ID):
        raise ProtocolError(f"servo id {servo_id}: allowed are 0 to {BUTTON_ID}")
    wire_modifiers = _modifiers(table, row, keyword, modifiers or {}, known)
    checked = _suffix if form is Form.QUERY else _wire
    return Command(servo_id, keyword, checked(keyword, row, value, known), wire_modifiers)


def read_command(language: Family | Language, command: Command) -> Decoded | None:
    """Return the command in physical units, or None if the family has no such command.

    The range is not checked: `Row.kept` returns the effect of a value outside it. A family without
    modifiers (2IO) ignores them (FACTS.md B5); for the others an unknown modifier gives None.
    """
    table = language_table(language)
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
    language: Family | Language,
    servo_id: int | None,
    keyword: str,
    value: float | str | None = None,
) -> Reply:
    """Return the reply with `value`; None gives no value, or `DIS` for a first position.

    Raises `ProtocolError` if the value does not match the shape of the row's reply.
    """
    table = language_table(language)
    form, row = table.find(keyword)
    if form is not Form.QUERY:
        raise ProtocolError(f"{keyword} is no query of {table.family}, so it has no reply")
    if value is None and row.reply_shape is ReplyShape.DISABLED:
        return Reply(servo_id, keyword, DISABLED)
    wire = row.wire(value) if isinstance(value, int | float) else value
    if not _is_readable(row.reply_shape, wire):
        raise ProtocolError(f"{keyword} answers {row.reply_shape}, not {value!r}")
    return Reply(servo_id, keyword, wire)


def read_reply(
    language: Family | Language, reply: Reply, *, suffix: int | None = None
) -> Decoded | None:
    """Return the reply in physical units, or None if it is no reply of the family.

    `suffix` is the suffix of the query. The reply does not repeat it, but the unit can depend on it
    (the reply to `QA1` is in mm). In a reply to `QID` the servo id is the value, not the address.
    """
    found = language_table(language).by_keyword.get(reply.keyword)
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


def reply_number(language: Family | Language, reply: Reply) -> float | None:
    """Return the number in a reply as `read_reply` does, faster; None: `read_reply` has none."""
    row = _number_row(language, reply.keyword)
    if row is None or not isinstance(reply.value, int):
        return None
    return row.physical(reply.value)


@lru_cache(maxsize=256)
def _number_row(language: Family | Language, keyword: str) -> Row | None:
    """Return the row of a query that is answered with a number."""
    form, row = language_table(language).by_keyword.get(keyword, (None, None))
    if form is not Form.QUERY or row is None or not _is_readable(row.reply_shape, 0):
        return None
    return row


def identify_reply(family: Family, servo_id: int, queried_id: int, *, firmware: int) -> Reply:
    """Return the reply of servo `servo_id` to `#<queried_id>QID` (three shapes: FACTS.md C5)."""
    if queried_id != BROADCAST_ID:
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
    is_exact = math.isfinite(value) and (row.unit is not Unit.NONE or value == int(value))
    wire = row.wire(value, row.step) if is_exact else None
    if wire is None or not row.allows(wire):
        raise ProtocolError(f"{keyword} {value:g}: allowed are {row.allowed()}")
    first = 0 if row.choices is None else row.choices[wire]
    if firmware < first:
        raise ProtocolError(f"{keyword} {value:g} needs firmware {first} or newer, not {firmware}")
    return wire


def _modifiers(
    table: FamilyTable, row: Row, keyword: str, modifiers: Mapping[str, float], firmware: int
) -> tuple[tuple[str, int], ...]:
    if modifiers and keyword not in row.actions:
        raise ProtocolError(f"{keyword} takes no modifier")
    wires: list[tuple[str, int]] = []
    for name in row.modifiers:
        if name in modifiers:
            modifier = table.modifiers[name]
            _check_firmware(name, modifier, firmware)
            wire = _wire(name, modifier, modifiers[name], firmware)
            assert wire is not None
            wires.append((name, wire))
    for name in modifiers:
        if name not in row.modifiers:
            allowed = ", ".join(row.modifiers) or "none"
            raise ProtocolError(f"{keyword} with {name}: allowed modifiers are {allowed}")
    return tuple(wires)


def _is_readable(answer: ReplyShape, value: int | str | None) -> bool:
    match answer:
        case ReplyShape.INTEGER:
            return isinstance(value, int)
        case ReplyShape.CHANNELS:
            return isinstance(value, int) or (isinstance(value, str) and value.startswith(","))
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
"""Rows to write first: G before O (FACTS.md R10), and AR before the pulse widths in its range."""


@cache
def storable(language: Family | Language) -> Mapping[str, Row]:
    """Return the rows that can be configured, by name, in the order in which to write them.

    The id is left out because it addresses the servo. A row that mirrors another one in a second
    unit is left out as well.
    """
    rows = [
        row
        for row in language_table(language).rows
        if row.configs and row.mirrors is None and row.name != "ID"
    ]
    rows.sort(key=lambda row: row.name not in _FIRST)
    return MappingProxyType({row.name: row for row in rows})


def stored_wire(language: Family | Language, name: str, value: float | None) -> int | None:
    """Return the wire value of a stored setting; None, only for a first position: disabled.

    Raises `ProtocolError`, with the allowed values, if the family does not store this setting or
    does not allow this value.
    """
    rows = storable(language)
    if name not in rows:
        kind = f"setting that {language_table(language).family} stores"
        raise ProtocolError(unknown_text(name, rows, kind))
    row = rows[name]
    if value is None:
        if row.reply_shape is not ReplyShape.DISABLED:
            raise ProtocolError(f"{name} has no DIS: {row.allowed()}")
        return None
    wire = make_command(language, 0, row.configs[0], value).value
    assert isinstance(wire, int)
    return wire
