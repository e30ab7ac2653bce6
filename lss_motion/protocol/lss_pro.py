"""The rows of the LSS-PRO language: document 001, half of it a copy of the LSS one.

Left out as misprints: `QM` for `QSM` (001:155), `#8SM2` for `#8CSM2` (001:594).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from lss_motion.protocol.family import Family
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.table import (
    HUNDREDTHS,
    ONE,
    TENTHS,
    Answer,
    Outside,
    Row,
    Unit,
    make_table,
)

PRO_FIRMWARE: Final = 780
"""001:122."""

POSITION_SCALE: Final = HUNDREDTHS
"""001:137-138; the examples 001:304, 312, 318, 329 still think in tenths (design decision)."""

OFFSET_SCALE: Final = TENTHS
"""Origin, angular range and first position: 001:147-148, 152, 453. 001:85 says hundredths."""

SPEED_SCALE: Final = TENTHS
"""001:153, 558, 606. 001:159 says whole degrees a second for the modifier; the maker's code
treats speed as hundredths (facts 3). With the hardware at hand, this is the line to correct."""

WHEEL_SCALE: Final = ONE
"""001:139, 341, 348."""

_LSS: Final = LSS_TABLE.row

SETUP: Final = (
    replace(_LSS("RESET"), source="001:126, 192-198", actions=("RESET",)),
    replace(_LSS("DEFAULT"), source="001:127, 201-213"),
    replace(_LSS("UPDATE"), source="001:128, 216-228"),
    replace(_LSS("CONFIRM"), source="001:129, 231-238"),
    replace(
        _LSS("QID"),
        source="001:130, 241-257",
        suffix_is_delay=False,
        note="A broadcast is answered *254QID5: the id is the value.",
    ),
    Row(
        name="ET",
        meaning="CAN terminal resistor on (1) or off (0)",
        source="001:131, 260-274",
        queries=("QET",),
        configs=("CET",),
        choices={0: 0, 1: 0},
        default=0,
        note="001:265 prints the reply without its id. The default is assumed.",
    ),
    Row(
        name="UC",
        meaning="connected by USB (1) or not (0)",
        source="001:132, 277-283",
        queries=("QUC",),
    ),
    Row(
        name="FR",
        meaning="firmware release",
        source="001:133, 286-293",
        queries=("QFR",),
        answer=Answer.VERSION,
        note="001:291 prints the reply without its id.",
    ),
)

MOTION: Final = (
    replace(
        _LSS("D"),
        source="001:137, 25-46, 304-314",
        wire_per_unit=POSITION_SCALE,
        modifiers=("T", "SD"),
        note="Unbounded: virtual turns.",
    ),
    replace(
        _LSS("QDT"),
        source="001:137, 316-320",
        wire_per_unit=POSITION_SCALE,
        answer=Answer.INTEGER,
        note="Without a target: the last one.",
    ),
    replace(
        _LSS("MD"),
        source="001:138, 324-331",
        wire_per_unit=POSITION_SCALE,
        modifiers=("T", "SD"),
    ),
    replace(
        _LSS("WD"),
        source="001:139, 335-348",
        queries=("QWD", "QVT"),
        wire_per_unit=WHEEL_SCALE,
        modifiers=(),
        note="QVT is listed beside QWD; taken as the same.",
    ),
    replace(_LSS("WR"), source="001:140, 352-365", modifiers=()),
    replace(_LSS("M"), source="001:369-379", firmware=0, note="Its headline says MD by mistake."),
    replace(_LSS("Q"), source="001:141, 383-416, facts 3", note="Numbers: see status_codes."),
    replace(_LSS("L"), source="001:142, 419-426"),
    replace(_LSS("H"), source="001:143, 429-437"),
    replace(_LSS("QS"), source="001:609-615"),
)

SETTINGS: Final = (
    replace(
        _LSS("O"),
        source="001:147, 442-464",
        wire_per_unit=OFFSET_SCALE,
        note="001:83 calls CO-500 -5.00 degrees; by the table it is -50.0.",
    ),
    replace(
        _LSS("AR"),
        source="001:148, 466-490",
        wire_per_unit=OFFSET_SCALE,
        note="The reply is *5QAR1800; *5AR1800 in 001:486 is a misprint.",
    ),
    replace(
        _LSS("AA"),
        source="001:149, 492-510",
        note="Steps of 10 deg/s2 as in 001:494; 001:498 calls AA30 30 deg/s2 (design decision).",
    ),
    replace(_LSS("AD"), source="001:150, 512-528", note="As AA."),
    replace(_LSS("G"), source="001:151, 532-550"),
    replace(
        _LSS("QFD"),
        source="001:152, 552-554",
        wire_per_unit=OFFSET_SCALE,
        minimum=-1790,
        maximum=1790,
        outside=Outside.CLAMPED,
        end_points=(-1800, 1800),
        note="Values beyond 1790 become 1800.",
    ),
    replace(_LSS("SD"), source="001:153, 556-566", wire_per_unit=SPEED_SCALE),
    replace(_LSS("SR"), source="001:154, 568-578", note="Overwrites SD and the other way round."),
    Row(
        name="SM",
        meaning="step mode: full, half or quarter steps",
        source="001:155, 580-596",
        actions=("SM",),
        queries=("QSM",),
        configs=("CSM",),
        suffixes=_LSS("G").suffixes,
        choices={1: 0, 2: 0, 4: 0},
        default=2,
        note="QM in the table is a misprint of QSM, #8SM2 in 001:594 one of #8CSM2.",
    ),
    replace(
        _LSS("EM"),
        source="001:149, facts 8",
        note="001 names EM1 but lists no EM; the maker's library sends it.",
    ),
    replace(_LSS("LED"), source="001:185", default=0, note="001 gives no default; 0 is assumed."),
)

MODIFIERS: Final = (
    replace(
        LSS_TABLE.modifiers["SD"],
        source="001:159, 600-606",
        wire_per_unit=SPEED_SCALE,
        note="The table says whole degrees a second, the example tenths (SD180 is 18 deg/s).",
    ),
    replace(LSS_TABLE.modifiers["T"], source="001:160, 617-623"),
)

TELEMETRY: Final = (
    replace(_LSS("QT"), source="001:164, 629-633", meaning="temperature of the circuit board"),
    replace(_LSS("QC"), source="001:165, 645-649", meaning="RMS current of the stepper driver"),
    replace(_LSS("QMS"), source="001:166, 651-655"),
    replace(_LSS("QF"), source="001:167, 657-661"),
    replace(_LSS("QN"), source="001:168, 663-667"),
    Row(
        name="TP",
        meaning="temperature of the probe on the motor",
        source="001:169, 635-637",
        queries=("QTP",),
        unit=Unit.CELSIUS,
        wire_per_unit=TENTHS,
        note="Tenths are assumed, as of QT; the maker's library calls all of them raw hundredths.",
    ),
    Row(
        name="TM",
        meaning="temperature of the processor",
        source="001:170",
        queries=("QTM",),
        unit=Unit.CELSIUS,
        wire_per_unit=TENTHS,
        note="Tenths are assumed, as of QTP.",
    ),
    Row(
        name="TCW",
        meaning="motor controller is warm (1) or not (0)",
        source="001:171-172, 639-643",
        queries=("QTCW",),
        note="No example; 0 and 1 are assumed.",
    ),
    Row(
        name="TCE",
        meaning="motor controller is too hot (1) or not (0)",
        source="001:171-174, 639-643",
        queries=("QTCE",),
        note="No example; 0 and 1 are assumed.",
    ),
    *(
        Row(
            name=f"I{axis}",
            meaning=f"linear acceleration along {axis}",
            source=f"001:{line}, 669-673",
            queries=(f"QI{axis}",),
            unit=Unit.MM_S2,
        )
        for axis, line in (("X", 176), ("Y", 177), ("Z", 178))
    ),
    *(
        Row(
            name=queries[0].removeprefix("Q"),
            meaning=f"angular acceleration {angle}",
            source=f"001:{line}, 675-679",
            queries=queries,
            unit=Unit.DEG_S2,
            wire_per_unit=TENTHS,
            note="Tenths by the example 001:677-679.",
        )
        for queries, angle, line in (
            (("QIA",), "alpha", 179),
            (("QIB",), "beta", 180),
            (("QIC", "QIG"), "gamma", 181),
        )
    ),
)

PRO_TABLE: Final = make_table(
    Family.LSS_PRO,
    (*SETUP, *MOTION, *SETTINGS, *MODIFIERS, *TELEMETRY),
    firmware=PRO_FIRMWARE,
    answers_broadcast=True,
)
