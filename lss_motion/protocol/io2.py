"""The rows of the LSS-2IO language: the board in its 2RC mode (FACTS.md B), and its limits."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.protocol.constants import BAUD_RATES_BPS, Family
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.table import (
    Device,
    Outside,
    ReplyShape,
    Row,
    Suffix,
    make_table,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.protocol.table import FamilyTable

SECTION_MAX_CHARS: Final = 15
"""Longest `#…` without its CR that may be sent, to any id, on a bus with a 2IO. Every byte on the
bus enters the 16-byte line buffer of the board, which has no overflow check (FACTS.md B4)."""

BAUD_MAX_BPS: Final = 500000
"""FACTS.md B3: a 2IO cannot join a faster bus."""

PIN_IDS: Final[Mapping[str, int]] = {
    "D9": 209,
    "D10": 210,
    "D11": 211,
    "A3": 203,
    "A4": 204,
    "A5": 205,
    "MASTER": 207,
}
"""FACTS.md B1, in the order in which the board looks for an id (B22). The master replies
`LSS-2IO-LED` to `QMS`, the other pins `LSS-2IO-<pin>` (B2)."""

OUTPUT_MIN_US: Final = 544
OUTPUT_MAX_US: Final = 2400
"""Pulses of the outputs for D-900 and D900, and the ends of P (FACTS.md B7)."""

PPM_MODE: Final = 4
"""The mode of an analog pin with a receiver of remote control (FACTS.md B18)."""


def rc_wire_per_deg(rc_pulse_us: tuple[int, int]) -> float:
    """Return the wire units of D in one degree of an RC servo: 10 if it has the outputs' range."""
    low_us, high_us = rc_pulse_us
    return 10.0 * (high_us - low_us) / (OUTPUT_MAX_US - OUTPUT_MIN_US)


def rc_zero_deg(rc_pulse_us: tuple[int, int]) -> float:
    """Return where D0 is in degrees of an RC servo: its 0 is the middle of its own pulses."""
    low_us, high_us = rc_pulse_us
    middle_us = (OUTPUT_MIN_US + OUTPUT_MAX_US) / 2.0
    return (middle_us - (low_us + high_us) / 2.0) * 180.0 / (high_us - low_us)


_LSS: Final = LSS_TABLE.row

ROWS: Final = (
    replace(
        _LSS("L"),
        meaning="stop the pulses; the servo goes limp",
        source="2IO 1",
        devices=(Device.SERVO,),
    ),
    replace(
        _LSS("P"),
        meaning="pulse width",
        source="2IO 2",
        modifiers=(),
        devices=(Device.SERVO,),
        note="QP returns the last commanded value. The outputs end at 544 and 2400 us (FACTS B7).",
    ),
    replace(
        _LSS("D"),
        source="2IO 3, FACTS B6",
        step=10,
        minimum=-900,
        maximum=900,
        outside=Outside.CLAMPED,
        modifiers=(),
        devices=(Device.SERVO,),
        note="The wire has tenths, the board whole degrees. Values outside are clamped:"
        " #209D1456 ends at 90. The servo moves at once, because the board ignores T. QD returns"
        " the last commanded value.",
    ),
    replace(
        _LSS("LED"),
        source="2IO 4, FACTS B11",
        suffixes=None,
        outside=Outside.ZEROED,
        default=0,
        devices=(Device.MASTER,),
        note="2IO 4 allows a broadcast QLED; the sketch never answers a broadcast.",
    ),
    replace(
        _LSS("G"),
        source="2IO 5, FACTS B9",
        suffixes=None,
        note="With G = -1 D is mirrored, P is not, and an analog pin returns 1024 minus its value.",
    ),
    replace(
        _LSS("QID"),
        source="2IO 6, FACTS B13",
        default=None,
        needs_reset=False,
        sets_session=True,
        suffix_is_delay=False,
        outside=Outside.TAKEN,
        note="The defaults are 207 (master), 203 to 205 (A3 to A5) and 209 to 211 (D9 to D11). A"
        " new id acts at once; this is assumed, because no RESET is required. The board takes ids"
        " beyond 250, too (FACTS B1).",
    ),
    replace(
        _LSS("QB"),
        source="2IO 7",
        choices={rate: since for rate, since in BAUD_RATES_BPS.items() if rate <= BAUD_MAX_BPS},
        sets_session=True,
        needs_reset=False,
        devices=(Device.MASTER,),
        note="A new rate acts at once.",
    ),
    replace(
        _LSS("QMS"),
        source="2IO 8, FACTS B13",
        note="The only query to a broadcast that the board answers, once for each device.",
    ),
    replace(_LSS("RESET"), source="2IO 9", actions=("RESET",), devices=(Device.MASTER,)),
    replace(
        _LSS("DEFAULT"),
        meaning="restore the factory values at once",
        source="2IO 10",
        devices=(Device.MASTER,),
        note="The board has no CONFIRM.",
    ),
    Row(
        name="A",
        meaning="value of an analog pin, raw or as the distance of a sensor",
        source="2IO 11, FACTS B15",
        actions=("A",),
        queries=("QA",),
        minimum=0,
        maximum=255,
        suffixes={
            1: Suffix.GP2Y0A41SK0F,
            2: Suffix.GP2Y0A21YK0F,
            3: Suffix.GP2Y0A02YK0F,
        },
        reply_shape=ReplyShape.CHANNELS,
        devices=(Device.ANALOG,),
        note="A sets the level of the pin (FACTS B18). The reply does not repeat the suffix:"
        " *203QA50 is 50 mm of sensor 1. The board clamps the distance to 30 to 310, 90 to 810 and"
        " 190 to 1510 mm (sensors 1 to 3, FACTS B15).",
    ),
    Row(
        name="AM",
        meaning="mode of an analog pin: 4 for the receiver of a remote control (PPM)",
        source="FACTS B18",
        configs=("CA",),
        minimum=0,
        maximum=PPM_MODE,
        default=0,
        devices=(Device.ANALOG,),
        note="In PPM mode QA returns the pulses of the receiver, *203QA,1500,1500.",
    ),
)

IO2_TABLE: Final = make_table(Family.IO2, ROWS, firmware=0, answers_broadcast=False)


@cache
def rc_table(rc_pulse_us: tuple[int, int]) -> FamilyTable:
    """Return the table with D in degrees of an RC servo that has this range of pulses."""
    scale = Fraction(rc_wire_per_deg(rc_pulse_us))
    rows = [replace(row, wire_per_unit=scale) if row.name == "D" else row for row in ROWS]
    return make_table(Family.IO2, rows, firmware=0, answers_broadcast=False)
