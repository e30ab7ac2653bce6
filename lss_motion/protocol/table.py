"""The types of a family's table: `Row` describes one command, `FamilyTable` all of a family.

The rows themselves are in `lss`, `lss_pro` and `io2`. `Row.source` has one of three forms: `LSS 8`
or `2IO 3` (document and command), `PRO Step Mode (SM)` (document and section), or `FACTS M5` (row
of FACTS.md). The documents are the LSS communication protocol 106.1 of 2019-02-22, the LSS-PRO
protocol of 2023-12-14, and the LSS-2IO protocol for the 2RC mode of 2020-02-07.
"""

from __future__ import annotations

from difflib import get_close_matches
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import force_setattr

from lss_motion.errors import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.protocol.constants import Family

WIRE_MIN: Final = -(2**31)
WIRE_MAX: Final = 2**31 - 1
"""Bounds for rows without a documented range. Assumed: 32-bit integers. They fit into a line."""

ONE: Final = Fraction(1)
TENTHS: Final = Fraction(10)
HUNDREDTHS: Final = Fraction(100)
THOUSANDTHS: Final = Fraction(1000)
STEPS_OF_TEN: Final = Fraction(1, 10)
"""Common values of `Row.wire_per_unit`."""


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
    """Effect of a value outside the range. `IGNORED` and `TAKEN` are assumptions."""

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
    CHANNELS = "integer or pulses with commas"
    TEXT = "text"


class Suffix(StrEnum):
    """Meaning of the number after a query. The reply does not repeat the number (FACTS.md C3)."""

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
    """The parts of a 2IO; each has an id of its own. A smart servo is not a `Device`."""

    MASTER = "master"
    SERVO = "servo"
    ANALOG = "analog"


SESSION_ONLY: Final = {0: Suffix.SESSION}
SESSION_OR_CONFIG: Final = {0: Suffix.SESSION, 1: Suffix.CONFIGURED}
"""`1` selects the EEPROM; `0` is the same as no suffix (FACTS.md C4)."""
SPEED: Final = {**SESSION_OR_CONFIG, 2: Suffix.INSTANTANEOUS, 3: Suffix.TARGET}
"""Suffixes of the speed queries (FACTS.md C4)."""


class Row(Struct, frozen=True, kw_only=True):
    """One value that can be commanded, queried or configured. Ranges and defaults are wire values.

    `actions`, `queries`, `configs`  keywords of the three forms; a row may have several of one form
    `wire_per_unit`    wire units per physical unit: with 10, 1443 on the wire is 144.3 `unit`
    `step`             the servo uses only multiples of it (2IO: whole degrees)
    `choices`          the only allowed values, each with the first firmware that accepts it
    `end_points`       results of clamping, if they differ from `minimum` and `maximum`
    `default`          factory value; None: there is none, or the model sets it (see the note)
    `sets_session`     a configuration changes the session value as well as the EEPROM
    `needs_reset`      a configuration acts only after RESET or power-up
    `mirrors`          name of the row with the same setting in another unit
    `suffix_is_delay`  the suffix of the query is a reply delay in us per id
    `firmware`         first firmware that has the row; 0: every firmware
    `devices`          parts of a 2IO that accept the row; empty: all parts
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
    _scale: tuple[int, int, float] = (1, 1, 1.0)
    """Numerator, denominator and value of `wire_per_unit`: a `Fraction` computes them slowly."""

    def __post_init__(self) -> None:
        numerator, denominator = self.wire_per_unit.as_integer_ratio()
        force_setattr(self, "_scale", (numerator, denominator, numerator / denominator))

    def physical(self, wire: int) -> float:
        """Return the value in `unit`, correctly rounded; values with scale 1 stay int (codes)."""
        numerator, denominator, ratio = self._scale
        return wire if ratio == 1.0 else wire * denominator / numerator

    def wire(self, physical: float, step: int = 1) -> int:
        """Return the nearest multiple of `step` wire units (ties to even). No range check."""
        return round(physical * self._scale[2] / step) * step

    def allows(self, wire: int) -> bool:
        """Return whether the row accepts the wire value."""
        if self.choices is not None:
            return wire in self.choices
        return self.minimum <= wire <= self.maximum

    def kept(self, wire: int) -> int | None:
        """Return the value that a servo uses after it received `wire`; None: it ignores `wire`."""
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
        """Return a text with the allowed values, in `unit`."""
        unit = f" {self.unit}" if self.unit else ""
        if self.choices is not None:
            return ", ".join(f"{self.physical(wire):.12g}" for wire in sorted(self.choices)) + unit
        return f"{self.physical(self.minimum):.12g} to {self.physical(self.maximum):.12g}{unit}"


class FamilyTable(Struct, frozen=True, kw_only=True):
    """Every row of a family, by keyword.

    `by_keyword` holds actions, queries and configurations. `modifiers` is a separate name space,
    because `SD` is both a command and a modifier. `firmware` is the newest version that the table
    covers. `answers_broadcast`: all servos reply at once to a query to id 254.
    """

    family: Family
    rows: tuple[Row, ...]
    firmware: int
    answers_broadcast: bool
    by_keyword: Mapping[str, tuple[Form, Row]]
    modifiers: Mapping[str, Row]

    def row(self, keyword: str) -> Row:
        """Return the row of `keyword`, or raise `ProtocolError`."""
        return self.find(keyword)[1]

    def find(self, keyword: str) -> tuple[Form, Row]:
        """Return form and row of `keyword`. The `ProtocolError` names the nearest keywords."""
        found = self.by_keyword.get(keyword)
        if found is None:
            raise ProtocolError(unknown_text(keyword, self.by_keyword, f"{self.family} keyword"))
        return found


def unknown_text(name: str, known: Mapping[str, object], kind: str) -> str:
    """Return the text that `name` is no such `kind`, with the nearest names of `known`."""
    near = get_close_matches(name, known, n=3, cutoff=0.5)
    hint = f"; did you mean {' or '.join(near)}?" if near else ""
    return f"{name!r} is no {kind}{hint}"


def make_table(
    family: Family, rows: Sequence[Row], *, firmware: int, answers_broadcast: bool
) -> FamilyTable:
    """Return the table of `rows`. A keyword in two rows is an error of the tables."""
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
