"""The rows of the LSS-PRO language, from its protocol page.

About half of the page repeats the LSS page, so most rows are LSS rows with changes. The table
leaves out two misprints of the page: `QM` for `QSM`, and `#8SM2` for `#8CSM2` (FACTS.md C7).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from lss_motion.protocol.constants import Family
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.table import (
    HUNDREDTHS,
    ONE,
    TENTHS,
    Outside,
    ReplyShape,
    Row,
    Unit,
    make_table,
)

PRO_FIRMWARE: Final = 780
"""FACTS.md P6."""

POSITION_SCALE: Final = HUNDREDTHS
"""FACTS.md P1. Some examples of the page still use tenths."""

OFFSET_SCALE: Final = TENTHS
"""Scale of origin, angular range and first position (FACTS.md P3). One example uses hundredths."""

SPEED_SCALE: Final = TENTHS
"""The page gives tenths, and whole degrees per second for the modifier. The maker's code treats
speeds as hundredths (FACTS.md P2). Correct this line if a real servo shows another scale."""

WHEEL_SCALE: Final = ONE
"""FACTS.md P4."""

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

MOTION: Final = (
    replace(
        _LSS("D"),
        source="PRO Position in Degrees",
        wire_per_unit=POSITION_SCALE,
        modifiers=("T", "SD"),
        note="The position is not bounded (virtual turns).",
    ),
    replace(
        _LSS("QDT"),
        source="PRO Position in Degrees",
        wire_per_unit=POSITION_SCALE,
        reply_shape=ReplyShape.INTEGER,
        note="Without a target the reply is the last target.",
    ),
    replace(
        _LSS("MD"),
        source="PRO (Relative) Move in Degrees",
        wire_per_unit=POSITION_SCALE,
        modifiers=("T", "SD"),
    ),
    replace(
        _LSS("WD"),
        source="PRO Wheel Mode in Degrees",
        queries=("QWD", "QVT"),
        wire_per_unit=WHEEL_SCALE,
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
)

SETTINGS: Final = (
    replace(
        _LSS("O"),
        source="PRO Origin Offset (O)",
        wire_per_unit=OFFSET_SCALE,
        note="PRO Configurations gives -5.00 degrees for CO-500; by the table it is -50.0.",
    ),
    replace(
        _LSS("AR"),
        source="PRO Angular Range (AR)",
        wire_per_unit=OFFSET_SCALE,
        note="The reply is *5QAR1800; *5AR1800 in the page is a misprint.",
    ),
    replace(
        _LSS("AA"),
        source="PRO Angular Acceleration (AA)",
        note="The page gives steps of 10 deg/s2; its example gives 30 deg/s2 for AA30 (FACTS P2).",
    ),
    replace(_LSS("AD"), source="PRO Angular Deceleration (AD)", note="The note on AA applies."),
    replace(_LSS("G"), source="PRO Gyre Direction (G)"),
    replace(
        _LSS("QFD"),
        source="PRO First Position",
        wire_per_unit=OFFSET_SCALE,
        minimum=-1790,
        maximum=1790,
        outside=Outside.CLAMPED,
        end_points=(-1800, 1800),
        note="Values beyond 1790 become 1800.",
    ),
    replace(_LSS("SD"), source="PRO Maximum Speed in Degrees (SD)", wire_per_unit=SPEED_SCALE),
    replace(
        _LSS("SR"),
        source="PRO Maximum Speed in RPM (SR)",
        note="SR and SD overwrite each other.",
    ),
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
        _LSS("LED"),
        source="PRO RGB LED",
        default=0,
        note="The page gives no default; 0 is assumed.",
    ),
)

MODIFIERS: Final = (
    replace(
        LSS_TABLE.modifiers["SD"],
        source="PRO Speed (SD) modifier",
        wire_per_unit=SPEED_SCALE,
        note="The table gives whole degrees per second, the example tenths (SD180 is 18 deg/s).",
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

PRO_TABLE: Final = make_table(
    Family.LSS_PRO,
    (*SETUP, *MOTION, *SETTINGS, *MODIFIERS, *TELEMETRY),
    firmware=PRO_FIRMWARE,
    answers_broadcast=True,
)
