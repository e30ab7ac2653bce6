"""The rows of the LSS-PRO language, from its protocol page and the maker's driver.

About half of the page repeats the LSS page, so most rows are LSS rows with changes. The table
leaves out two misprints of the page: `QM` for `QSM`, and `#8SM2` for `#8CSM2` (FACTS.md C7).

The page gives several units for one value; `Units` holds the units in use. `pro_table` makes the
table for the units of one robot, whose file may set them (key `units`).
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.protocol.constants import Family
from lss_motion.protocol.io2 import OUTPUT_MAX_US, OUTPUT_MIN_US
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.table import TENTHS, Outside, ReplyShape, Row, Unit, make_table

if TYPE_CHECKING:
    from lss_motion.protocol.table import FamilyTable

PRO_FIRMWARE: Final = 780
"""FACTS.md P6."""

POSITION_DEG: Final = 0.01
"""FACTS.md P1. Some examples of the page still use tenths."""
OFFSET_DEG: Final = 0.1
"""Origin, angular range and first position (FACTS.md P3). One example uses hundredths."""
SPEED_DEG_S: Final = 0.01
"""The maker's running code (FACTS.md P2). The page gives tenths, and whole degrees per second for
the modifier."""
WHEEL_DEG_S: Final = 1.0
"""FACTS.md P4."""
ACCEL_DEG_S2: Final = 0.01
"""The maker's running code (FACTS.md P2). The page gives steps of 10 deg/s², and 1 deg/s² in its
example."""

ACCEL_MAX_DEG_S2: Final = 1000.0
"""The largest AA and AD, and their factory value: 100 steps of 10 deg/s² (PRO Angular Acceleration
(AA)), whatever the unit is. Assumed: the maker's code sets at most 100 deg/s² (FACTS.md P9)."""


class Units(Struct, frozen=True, kw_only=True):
    """What one unit on the wire is for an LSS-PRO, and the range of an RC servo on an LSS-2IO.

    A wrong unit makes a servo move at a multiple of its speed. The first slow move of a new robot
    shows it, and the robot file then states the right unit.
    """

    position_deg: float = POSITION_DEG
    offset_deg: float = OFFSET_DEG
    speed_deg_s: float = SPEED_DEG_S
    wheel_deg_s: float = WHEEL_DEG_S
    accel_deg_s2: float = ACCEL_DEG_S2
    rc_pulse_us: tuple[int, int] = (OUTPUT_MIN_US, OUTPUT_MAX_US)
    """Of an RC servo on an LSS-2IO: its pulses at -90 and +90 degrees."""


UNITS: Final = Units()
"""The units where a robot file states none."""


def per_unit(unit: float) -> Fraction:
    """Return the wire units in one physical unit: 100 for a wire unit of 0.01."""
    return 1 / Fraction(str(unit))


_LSS: Final = LSS_TABLE.row

SETUP: Final = (
    replace(_LSS("RESET"), source="PRO Reset", actions=("RESET",)),
    replace(_LSS("DEFAULT"), source="PRO Default & confirm"),
    replace(_LSS("UPDATE"), source="PRO Update & confirm"),
    replace(_LSS("CONFIRM"), source="PRO Confirm"),
    replace(
        _LSS("QID"),
        source="PRO ID Number",
        suffix_is_delay=False,
        note="The reply to a broadcast is *254QID5; the value is the id of the servo.",
    ),
    Row(
        name="ET",
        meaning="CAN terminal resistor on (1) or off (0)",
        source="PRO Enable CAN Terminal Resistor",
        queries=("QET",),
        configs=("CET",),
        choices={0: 0, 1: 0},
        default=0,
        note="The page prints the reply without its id. The default is assumed.",
    ),
    Row(
        name="UC",
        meaning="connected by USB (1) or not (0)",
        source="PRO USB Connection Status",
        queries=("QUC",),
    ),
    Row(
        name="FR",
        meaning="firmware release",
        source="PRO Firmware Release",
        queries=("QFR",),
        reply_shape=ReplyShape.VERSION,
        note="The page prints the reply without its id.",
    ),
)


def _motion(units: Units) -> tuple[Row, ...]:
    position, speed = per_unit(units.position_deg), per_unit(units.speed_deg_s)
    return (
        replace(
            _LSS("D"),
            source="PRO Position in Degrees",
            wire_per_unit=position,
            modifiers=("T", "SD"),
            note="The position is not bounded (virtual turns).",
        ),
        replace(
            _LSS("QDT"),
            source="PRO Position in Degrees",
            wire_per_unit=position,
            reply_shape=ReplyShape.INTEGER,
            note="Without a target the reply is the last target.",
        ),
        replace(
            _LSS("MD"),
            source="PRO (Relative) Move in Degrees",
            wire_per_unit=position,
            modifiers=("T", "SD"),
        ),
        replace(
            _LSS("WD"),
            source="PRO Wheel Mode in Degrees",
            queries=("QWD", "QVT"),
            wire_per_unit=per_unit(units.wheel_deg_s),
            modifiers=(),
            note="The page lists QVT beside QWD. Both are taken to be the same.",
        ),
        replace(_LSS("WR"), source="PRO Wheel Mode in RPM", modifiers=()),
        replace(
            _LSS("M"),
            source="PRO (Relative) Move in Degrees",
            firmware=0,
            note="The headline of the section names MD by mistake.",
        ),
        replace(
            _LSS("Q"),
            source="PRO Query Status, FACTS P5",
            note="The meaning of the numbers depends on the firmware (FACTS P5).",
        ),
        replace(_LSS("L"), source="PRO Limp"),
        replace(_LSS("H"), source="PRO Halt & Hold"),
        replace(_LSS("QS"), source="PRO Speed (SD) modifier"),
        Row(
            name="CS",
            meaning="present speed",
            source="FACTS P13",
            queries=("QCS",),
            unit=Unit.DEG_S,
            wire_per_unit=speed,
            note="The page does not list it; the maker's driver reads it. The unit is that of SD.",
        ),
    )


UNITLESS_SETTINGS: Final = (
    Row(
        name="SM",
        meaning="step mode: full, half or quarter steps",
        source="PRO Step Mode (SM)",
        actions=("SM",),
        queries=("QSM",),
        configs=("CSM",),
        suffixes=_LSS("G").suffixes,
        choices={1: 0, 2: 0, 4: 0},
        default=2,
        note="QM in the table is a misprint of QSM, and #8SM2 in the text one of #8CSM2.",
    ),
    replace(
        _LSS("EM"),
        source="PRO Motion Setup, FACTS P10",
        note="The page names EM1 but does not list EM; the maker's library sends EM.",
    ),
    replace(
        _LSS("QLB"),
        source="FACTS P13",
        note="The page does not list it; the maker's library sends QLB and CLB.",
    ),
    replace(
        _LSS("LED"),
        source="PRO RGB LED",
        default=0,
        note="The page gives no default; 0 is assumed.",
    ),
)


def _settings(units: Units) -> tuple[Row, ...]:
    offset, speed = per_unit(units.offset_deg), per_unit(units.speed_deg_s)
    accel = per_unit(units.accel_deg_s2)
    ramp_max = round(ACCEL_MAX_DEG_S2 * accel)
    return (
        replace(
            _LSS("O"),
            source="PRO Origin Offset (O)",
            wire_per_unit=offset,
            note="PRO Configurations gives -5.00 degrees for CO-500; by the table it is -50.0.",
        ),
        replace(
            _LSS("AR"),
            source="PRO Angular Range (AR)",
            wire_per_unit=offset,
            default=round(180 * offset),
            note="The reply is *5QAR1800; *5AR1800 in the page is a misprint.",
        ),
        *(
            replace(
                _LSS(name),
                source=f"PRO Angular {meaning} ({name}), FACTS P2",
                wire_per_unit=accel,
                maximum=ramp_max,
                default=ramp_max,
                note="The page gives 1 to 100 in steps of 10 deg/s2, and 30 deg/s2 for AA30 in its"
                " example. Largest and factory value are its 1000 deg/s2 (FACTS P2).",
            )
            for name, meaning in (("AA", "Acceleration"), ("AD", "Deceleration"))
        ),
        replace(_LSS("G"), source="PRO Gyre Direction (G)"),
        replace(
            _LSS("QFD"),
            source="PRO First Position",
            wire_per_unit=offset,
            minimum=-round(179 * offset),
            maximum=round(179 * offset),
            outside=Outside.CLAMPED,
            end_points=(-round(180 * offset), round(180 * offset)),
            note="Values beyond 1790 become 1800.",
        ),
        replace(_LSS("SD"), source="PRO Maximum Speed in Degrees (SD)", wire_per_unit=speed),
        replace(
            _LSS("SR"),
            source="PRO Maximum Speed in RPM (SR)",
            note="SR and SD overwrite each other.",
        ),
    )


def _modifiers(units: Units) -> tuple[Row, ...]:
    return (
        replace(
            LSS_TABLE.modifiers["SD"],
            source="PRO Speed (SD) modifier, FACTS P2",
            wire_per_unit=per_unit(units.speed_deg_s),
            note="The table gives whole degrees per second, the example tenths (SD180 is"
            " 18 deg/s). The unit of the command SD is taken.",
        ),
        replace(LSS_TABLE.modifiers["T"], source="PRO Timed move (T) modifier"),
    )


TELEMETRY: Final = (
    replace(
        _LSS("QT"),
        source="PRO Query PCB Temperature (QT)",
        meaning="temperature of the circuit board",
    ),
    replace(
        _LSS("QC"), source="PRO Query Current (QC)", meaning="RMS current of the stepper driver"
    ),
    replace(_LSS("QMS"), source="PRO Query Model String (QMS)"),
    replace(_LSS("QF"), source="PRO Query Firmware (QF)"),
    replace(_LSS("QN"), source="PRO Query Serial Number (QN)"),
    Row(
        name="TP",
        meaning="temperature of the probe on the motor",
        source="PRO Query Temperature Probe (QTP)",
        queries=("QTP",),
        unit=Unit.CELSIUS,
        wire_per_unit=TENTHS,
        note="Tenths are assumed, as for QT. The maker's library treats both as raw hundredths.",
    ),
    Row(
        name="TM",
        meaning="temperature of the processor",
        source="PRO Telemetry",
        queries=("QTM",),
        unit=Unit.CELSIUS,
        wire_per_unit=TENTHS,
        note="Tenths are assumed, as for QTP.",
    ),
    Row(
        name="TCW",
        meaning="motor controller is warm (1) or not (0)",
        source="PRO Query Temp of Controller (QTCW)",
        queries=("QTCW",),
        note="The page has no example; 0 and 1 are assumed.",
    ),
    Row(
        name="TCE",
        meaning="motor controller is too hot (1) or not (0)",
        source="PRO Query Temp of Controller (QTCW)",
        queries=("QTCE",),
        note="The page has no example; 0 and 1 are assumed.",
    ),
    *(
        Row(
            name=f"I{axis}",
            meaning=f"linear acceleration along {axis}",
            source="PRO Query IMU Linear",
            queries=(f"QI{axis}",),
            unit=Unit.MM_S2,
        )
        for axis in ("X", "Y", "Z")
    ),
    *(
        Row(
            name=queries[0].removeprefix("Q"),
            meaning=f"angular acceleration {angle}",
            source="PRO Query IMU Angular",
            queries=queries,
            unit=Unit.DEG_S2,
            wire_per_unit=TENTHS,
            note="The example gives tenths (FACTS P19).",
        )
        for queries, angle in (
            (("QIA",), "alpha"),
            (("QIB",), "beta"),
            (("QIC", "QIG"), "gamma"),
        )
    ),
)


@cache
def pro_table(units: Units) -> FamilyTable:
    """Return the table of an LSS-PRO with these units on the wire."""
    rows = (
        *SETUP,
        *_motion(units),
        *_settings(units),
        *UNITLESS_SETTINGS,
        *_modifiers(units),
        *TELEMETRY,
    )
    return make_table(Family.LSS_PRO, rows, firmware=PRO_FIRMWARE, answers_broadcast=True)


PRO_TABLE: Final = pro_table(UNITS)
