"""The settings of servos: queries, differences from the wanted values, commands to write.

Values are wire values by the name of their row; None is a first position that is switched off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.playing.player.transactions import Item
from lss_motion.protocol.codec import Language, storable
from lss_motion.protocol.constants import Family, Led
from lss_motion.protocol.framing import DISABLED, Command
from lss_motion.protocol.lss_pro import UNITS, Units
from lss_motion.protocol.table import Device, ReplyShape, Suffix

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.playing.player.handshake import Answers
    from lss_motion.protocol.table import Row


Values = dict[str, int | None]

RC_MODE: Final = "CRC"
BAUD: Final = "B"
LEAVING: Final = (RC_MODE, BAUD)
"""A servo with one of these changed no longer answers on its line after a RESET."""
FRAME: Final = ("G", "O")
"""Direction and origin, which define what an angle means."""
FIRST: Final = ("FP", "FD")
"""The two first positions; writing one erases the other (FACTS.md C16)."""


class Target(Struct, frozen=True, kw_only=True):
    """A servo whose settings are read or written. `model` is the answer to `QMS`."""

    name: str
    bus: str
    servo_id: int
    model: str
    family: Family
    firmware: int | None
    """What it answers to QF; None: it did not answer."""
    units: Units = UNITS

    @property
    def language(self) -> Language:
        """What the tables of `protocol.codec` are found with."""
        return Language(self.family, self.units)

    @property
    def device(self) -> Device | None:
        """Return which part of a 2IO it is (FACTS.md B2); None: a smart servo."""
        if self.family is not Family.IO2:
            return None
        if self.model.endswith("-LED"):
            return Device.MASTER
        return Device.ANALOG if "-A" in self.model else Device.SERVO

    def rows(self, *, is_session: bool) -> Mapping[str, Row]:
        """Return the settings that can be read and written: stored, or those of the session."""
        return {
            name: row
            for name, row in storable(self.language).items()
            if row.queries
            and row.firmware <= (self.firmware or 0)
            and (not row.devices or self.device in row.devices)
            and (not is_session or row.actions)
        }


class Change(Struct, frozen=True, kw_only=True):
    """A setting that differs from the wanted value."""

    target: Target
    row: Row
    had: int | None
    wanted: int | None

    def __str__(self) -> str:
        had, wanted = value_text(self.row, self.had), value_text(self.row, self.wanted)
        return f"{self.target.name}: {self.row.meaning} ({self.row.name}) {had} → {wanted}"


def questions(target: Target, rows: Mapping[str, Row], *, is_session: bool) -> list[Item]:
    """Return the queries for the stored values, or for those of the session."""
    items = []
    for row in rows.values():
        is_stored_asked = Suffix.CONFIGURED in (row.suffixes or {}).values() and not is_session
        command = Command(target.servo_id, row.queries[0], 1 if is_stored_asked else None)
        items.append(Item(bus=target.bus, command=command, is_query=True))
    return items


def values(target: Target, rows: Mapping[str, Row], answers: Answers) -> Values:
    """Return the values that answer `questions`; without an answer a setting is absent."""
    found: Values = {}
    for name, row in rows.items():
        address = (target.bus, target.servo_id, row.queries[0])
        value = answers.get(address)
        if isinstance(value, int):
            found[name] = value
        elif value == DISABLED and row.reply_shape is ReplyShape.DISABLED:
            found[name] = None
    return found


def changes(target: Target, had: Values, wanted: Mapping[str, int | None]) -> list[Change]:
    """Return what must be written, in the order of writing.

    A setting that cannot be read back, such as RC mode, is always written. Of the two first
    positions, which overwrite each other, the wanted one is written last.
    """
    rows = storable(target.language)
    needed = [
        Change(target=target, row=rows[name], had=had.get(name), wanted=wanted[name])
        for name in rows
        if name in wanted and (name not in had or had[name] != wanted[name])
    ]
    return sorted(needed, key=lambda change: change.wanted is not None and change.row.name in FIRST)


def orders(needed: Iterable[Change], *, is_session: bool) -> list[Item]:
    """Return the commands that write changes."""
    items = []
    for change in needed:
        keyword = (change.row.actions if is_session else change.row.configs)[0]
        command = Command(change.target.servo_id, keyword, change.wanted)
        items.append(Item(bus=change.target.bus, command=command, is_query=False))
    return items


def goes_limp(change: Change, *, is_session: bool) -> bool:
    """Return whether a servo goes limp while a change is written: for a RESET, or for safety."""
    return change.row.name in FRAME or (change.row.needs_reset and not is_session)


def limp_orders(needed: Iterable[Change]) -> list[Item]:
    """Return the commands that release the servos whose angles change their meaning.

    A servo that holds a position might turn to that position in the new frame (FACTS.md R11).
    """
    return [
        Item(bus=target.bus, command=Command(target.servo_id, "L"), is_query=False)
        for target in {change.target for change in needed if change.row.name in FRAME}
    ]


def dangers(needed: Sequence[Change], baud_bps: int) -> list[str]:
    """Return the reasons why changes would make a servo unreachable at `baud_bps`."""
    found = []
    for change in needed:
        servo = f"{change.target.name} (id {change.target.servo_id})"
        if change.row.name == RC_MODE and change.wanted:
            found.append(
                f"{servo}: in RC mode it receives nothing from the bus; only its button ends that"
            )
        if change.row.name == BAUD and change.wanted != baud_bps:
            found.append(
                f"{servo}: at {change.wanted} bps it would not receive this line, which runs at "
                f"{baud_bps}; --new-baud changes all servos of a line together"
            )
    return found


def value_text(row: Row, wire: int | None) -> str:
    """Return a value as text: with its unit, and with the name of a colour."""
    if wire is None:
        return "off"
    unit = f" {row.unit}" if row.unit else ""
    text = f"{row.physical(wire):.12g}{unit}"
    is_colour = row.name == "LED" and wire in {int(led) for led in Led}
    return f"{text} ({Led(wire).name.lower()})" if is_colour else text
