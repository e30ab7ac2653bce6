"""What one row of a family's table says: the type of the rows, and no row.

Sources are written `LSS 8` or `2IO 3` (document and command), `PRO Step Mode (SM)` (document and
section), or `FACTS M5` (row of FACTS.md, which names the documents: the LSS communication protocol
106.1 of 2019-02-22, the LSS-PRO one of 2023-12-14, the 2IO one for the 2RC mode of 2020-02-07).
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from lss_motion.errors import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.protocol.constants import Family

WIRE_MIN: Final = -(2**31)
WIRE_MAX: Final = 2**31 - 1
"""Bounds where no document gives one. Assumed (32-bit integers); every line stays readable."""

ONE: Final = Fraction(1)
TENTHS: Final = Fraction(10)
HUNDREDTHS: Final = Fraction(100)
THOUSANDTHS: Final = Fraction(1000)
STEPS_OF_TEN: Final = Fraction(1, 10)
"""The usual numbers of wire units per physical unit."""


class Form(StrEnum):
    """What a keyword does with its row."""

    ACTION = "action"
    QUERY = "query"
    CONFIG = "config"
    MODIFIER = "modifier"


class Unit(StrEnum):
    """The physical unit of a value, as `codec` gives and takes it."""

    NONE = ""
    DEG = "deg"
    DEG_S = "deg/s"
    DEG_S2 = "deg/s²"
    RPM = "rpm"
    MS = "ms"
    US = "us"
    US_S = "us/s"
    VOLT = "V"
    AMPERE = "A"
    CELSIUS = "°C"
    BPS = "bps"
    MM = "mm"
    MM_S2 = "mm/s²"


class Value(StrEnum):
    """Whether an action, configuration or modifier carries a value."""

    NONE = "none"
    REQUIRED = "required"
    OPTIONAL = "optional"


class Outside(StrEnum):
    """What a servo does with a value outside the range. `IGNORED` and `TAKEN` are assumptions."""

    IGNORED = "ignored"
    TAKEN = "taken"
    CLAMPED = "clamped"
    ZEROED = "zeroed"


class ReplyShape(StrEnum):
    """The shape of the value in a reply."""

    INTEGER = "integer"
    OPTIONAL = "integer or nothing"
    DISABLED = "integer or DIS"
    VERSION = "integer or dotted numbers"
    TEXT = "text"


class Suffix(StrEnum):
    """What the number after a query asks for. It is not echoed in the reply (FACTS.md C3)."""

    SESSION = "session value"
    CONFIGURED = "configured value"
    INSTANTANEOUS = "instantaneous value"
    TARGET = "target value"
    CAUSE = "cause of safe mode"
    FULL_VERSION = "dotted version"
    GP2Y0A41SK0F = "mm of a Sharp GP2Y0A41SK0F"
    GP2Y0A21YK0F = "mm of a Sharp GP2Y0A21YK0F"
    GP2Y0A02YK0F = "mm of a Sharp GP2Y0A02YK0F"


class Device(StrEnum):
    """The parts of a 2IO, each with an id of its own. A smart servo is none of them."""

    MASTER = "master"
    SERVO = "servo"
    ANALOG = "analog"


SESSION_ONLY: Final = {0: Suffix.SESSION}
SESSION_OR_CONFIG: Final = {0: Suffix.SESSION, 1: Suffix.CONFIGURED}
"""FACTS.md C4: `1` asks for the EEPROM; `0` is the same as no suffix."""
SPEED: Final = {**SESSION_OR_CONFIG, 2: Suffix.INSTANTANEOUS, 3: Suffix.TARGET}
"""FACTS.md C4."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One thing that can be commanded, asked or configured. Ranges and defaults are wire values.

    `wire_per_unit`    1443 tenths on the wire are 144.3 `unit`
    `step`             a servo heeds only multiples of it (2IO: whole degrees)
    `choices`          the only values, each with the first firmware that takes it
    `end_points`       where a clamped value lands, if not on `minimum` and `maximum`
    `default`          factory value; None: none, or given by the model (the note says which)
    `sets_session`     a configuration changes the session as well as the EEPROM
    `needs_reset`      a configuration acts after RESET or power-up only
    `mirrors`          the row whose setting this one reads and overwrites in another unit
    `suffix_is_delay`  the query's suffix is a reply delay in us per id
    `firmware`         the first that knows the row; 0: all
    `devices`          the parts of a 2IO that obey; empty: all
    """

    name: str
    meaning: str
    source: str
    actions: tuple[str, ...] = ()
    queries: tuple[str, ...] = ()
    configs: tuple[str, ...] = ()
    is_modifier: bool = False
    value: Value = Value.REQUIRED
    unit: Unit = Unit.NONE
    wire_per_unit: Fraction = ONE
    step: int = 1
    minimum: int = WIRE_MIN
    maximum: int = WIRE_MAX
    choices: Mapping[int, int] | None = None
    outside: Outside = Outside.IGNORED
    end_points: tuple[int, int] | None = None
    default: int | None = None
    sets_session: bool = True
    needs_reset: bool = False
    mirrors: str | None = None
    modifiers: tuple[str, ...] = ()
    suffixes: Mapping[int, Suffix] | None = None
    suffix_is_delay: bool = False
    reply_shape: ReplyShape = ReplyShape.INTEGER
    firmware: int = 0
    devices: tuple[Device, ...] = ()
    note: str = ""

    def physical(self, wire: int) -> float:
        """Return the value in `unit`, correctly rounded; codes and other bare numbers stay int."""
        if self.wire_per_unit == 1:
            return wire
        return wire * self.wire_per_unit.denominator / self.wire_per_unit.numerator

    def wire(self, physical: float, step: int = 1) -> int:
        """Return the nearest multiple of `step` wire units (ties to even), in range or not."""
        return round(physical * float(self.wire_per_unit) / step) * step

    def allows(self, wire: int) -> bool:
        if self.choices is not None:
            return wire in self.choices
        return self.minimum <= wire <= self.maximum

    def kept(self, wire: int) -> int | None:
        """Return what a servo that hears `wire` goes on with; None: it takes no notice."""
        if self.allows(wire):
            return wire
        match self.outside:
            case Outside.IGNORED:
                return None
            case Outside.TAKEN:
                return wire
            case Outside.CLAMPED:
                low, high = self.end_points or (self.minimum, self.maximum)
                return low if wire < self.minimum else high
            case Outside.ZEROED:
                return 0

    def allowed(self) -> str:
        """Say the allowed values, in `unit`."""
        unit = f" {self.unit}" if self.unit else ""
        if self.choices is not None:
            return ", ".join(f"{self.physical(wire):.12g}" for wire in sorted(self.choices)) + unit
        return f"{self.physical(self.minimum):.12g} to {self.physical(self.maximum):.12g}{unit}"


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyTable:
    """Every row of a family, found by keyword.

    `by_keyword` holds actions, queries and configurations; `modifiers` is a name space of its own
    (`SD` is both a command and a modifier).
    `firmware` is the newest version that the table knows.
    `answers_broadcast`: a query to id 254 is answered by everybody at once.
    """

    family: Family
    rows: tuple[Row, ...]
    firmware: int
    answers_broadcast: bool
    by_keyword: Mapping[str, tuple[Form, Row]]
    modifiers: Mapping[str, Row]

    def row(self, keyword: str) -> Row:
        return self.find(keyword)[1]

    def find(self, keyword: str) -> tuple[Form, Row]:
        """Return what `keyword` does and with which row; ProtocolError names the nearest."""
        found = self.by_keyword.get(keyword)
        if found is None:
            raise ProtocolError(unknown_text(keyword, self.by_keyword, f"{self.family} keyword"))
        return found


def unknown_text(name: str, known: Mapping[str, object], kind: str) -> str:
    near = get_close_matches(name, known, n=3, cutoff=0.5)
    hint = f"; did you mean {' or '.join(near)}?" if near else ""
    return f"{name!r} is no {kind}{hint}"


def make_table(
    family: Family, rows: Sequence[Row], *, firmware: int, answers_broadcast: bool
) -> FamilyTable:
    """Return the table; every keyword belongs to one row."""
    by_keyword: dict[str, tuple[Form, Row]] = {}
    for row in rows:
        for form, keywords in (
            (Form.ACTION, row.actions),
            (Form.QUERY, row.queries),
            (Form.CONFIG, row.configs),
        ):
            for keyword in keywords:
                assert keyword not in by_keyword, f"{keyword} is in two rows"
                by_keyword[keyword] = (form, row)
    return FamilyTable(
        family=family,
        rows=tuple(rows),
        firmware=firmware,
        answers_broadcast=answers_broadcast,
        by_keyword=by_keyword,
        modifiers={row.name: row for row in rows if row.is_modifier},
    )
