"""The table of servo models and families, the drives that fit them, and the limits of a board.

`SERVO_MODELS` and `FAMILIES` are the facts. `board_problems` checks drives, lines and ranges of a
robot against them, and against the limits of an LSS-2IO for the bus that it is on.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import encode_move
from lss_motion.protocol.io2 import BAUD_MAX_BPS, SECTION_MAX_CHARS, rc_wire_per_deg, rc_zero_deg
from lss_motion.protocol.lss_pro import ACCEL_MAX_DEG_S2, UNITS, per_unit
from lss_motion.robot.model import ServoModel

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lss_motion.protocol.lss_pro import Units
    from lss_motion.robot.model import Bus, Drive, Joint


PRO_SPEED_MAX_ASSUMED_DEG_S: Final = 180.0
"""Assumption: no document gives the top speed of an LSS-PRO. Twice what real arms use (90 deg/s,
FACTS.md P9), so that no sensible setting is refused."""

RC_SPEED_MAX_ASSUMED_DEG_S: Final = 400.0
"""Assumption: an RC servo on a 2IO can be of any make; 0.15 s for 60 deg is common."""

IO2_WIRE_STEP: Final = 10
"""A 2IO receives tenths of a degree and rounds them to whole degrees (FACTS.md B6)."""


class FamilyFacts(Struct, frozen=True, kw_only=True):
    """Facts that hold for all models of a family.

    `drives` are the drives that it allows, the default first.
    `settings` are the session settings that a robot file may set, with their smallest and largest
    value. EM, FPC, AA, AD and SD are not among them: the player sets those as the plan needs them.
    """

    wire_per_deg: int
    drives: tuple[Drive, ...]
    settings: Mapping[str, tuple[int, int]]


RAMP_STEP_DEG_S2: Final = 10.0
"""The unit of AA and AD of an LSS (FACTS.md M20)."""
RAMP_MAX_DEG_S2: Final = 1000.0
"""The largest AA and AD of an LSS, and the default (FACTS.md M20)."""
_RAMPS: Final = {
    Family.LSS: (RAMP_STEP_DEG_S2, RAMP_MAX_DEG_S2),
    Family.LSS_PRO: (UNITS.accel_deg_s2, ACCEL_MAX_DEG_S2),
    Family.IO2: (0.0, math.inf),  # no ramps: it moves at full speed
}
"""The unit and the largest value of AA and AD, by family."""

_STIFFNESS: Final = (-10, 10)
"""AS and AH: -4..4 is sensible, -10..10 is accepted (FACTS.md M24, M25)."""

_LED: Final = (0, 7)
"""0 off to 7 white, all families (FACTS.md C8)."""

FAMILIES: Final[Mapping[Family, FamilyFacts]] = MappingProxyType(
    {
        Family.LSS: FamilyFacts(
            drives=("timed", "streamed"),
            wire_per_deg=10,  # 1/10 deg (FACTS.md C1)
            settings=MappingProxyType({"AS": _STIFFNESS, "AH": _STIFFNESS, "LED": _LED}),
        ),
        Family.LSS_PRO: FamilyFacts(
            drives=("timed",),  # EM and FPC are not in its tables: FACTS.md P10
            wire_per_deg=round(1 / UNITS.position_deg),  # 1/100 deg (FACTS.md P1)
            settings=MappingProxyType({"LED": _LED}),  # its tables have no AS and AH
        ),
        Family.IO2: FamilyFacts(
            drives=("stepped",),
            wire_per_deg=10,  # tenths (FACTS.md B6)
            settings=MappingProxyType({}),
        ),
    }
)


def _model(name: str, family: Family, speed_max_deg_s: float) -> ServoModel:
    accel_step_deg_s2, accel_max_deg_s2 = _RAMPS[family]
    return ServoModel(
        name=name,
        family=family,
        speed_max_deg_s=speed_max_deg_s,
        wire_per_deg=FAMILIES[family].wire_per_deg,
        wire_step=IO2_WIRE_STEP if family is Family.IO2 else 1,
        accel_step_deg_s2=accel_step_deg_s2,
        accel_max_deg_s2=accel_max_deg_s2,
    )


def with_units(model: ServoModel, units: Units) -> ServoModel:
    """Return the model with other units on the wire; one of another family as it is."""
    if model.family is Family.IO2:
        return replace(model, wire_per_deg=rc_wire_per_deg(units.rc_pulse_us), units=units)
    if model.family is not Family.LSS_PRO:
        return model
    return replace(
        model,
        wire_per_deg=round(per_unit(units.position_deg)),
        accel_step_deg_s2=units.accel_deg_s2,
        units=units,
    )


SERVO_MODELS: Final[Mapping[str, ServoModel]] = MappingProxyType(
    {
        model.name: model
        for model in (
            # No-load speeds of the LSS: FACTS.md E1.
            _model("LSS-ST1", Family.LSS, 360.0),
            _model("LSS-HS1", Family.LSS, 600.0),
            _model("LSS-HT1", Family.LSS, 360.0),
            _model("LSS-P-S1", Family.LSS_PRO, PRO_SPEED_MAX_ASSUMED_DEG_S),
            _model("LSS-P-M1", Family.LSS_PRO, PRO_SPEED_MAX_ASSUMED_DEG_S),
            _model("LSS-P-L1", Family.LSS_PRO, PRO_SPEED_MAX_ASSUMED_DEG_S),
            _model("LSS-2IO", Family.IO2, RC_SPEED_MAX_ASSUMED_DEG_S),
        )
    }
)

STATIC_TORQUE_N_M: Final[Mapping[str, float]] = MappingProxyType(
    {"LSS-HS1": 0.785, "LSS-ST1": 1.373, "LSS-HT1": 2.844}  # FACTS.md E2
)
"""The largest static torque of a model; none is known for the others."""
MASS_KG: Final[Mapping[str, float]] = MappingProxyType(
    {"LSS-HS1": 0.057, "LSS-ST1": 0.057, "LSS-HT1": 0.063}  # FACTS.md E3
)
"""The mass of a servo; none is known for the other models."""

BAUD_FIRMWARE_MIN: Final[Mapping[int, int]] = MappingProxyType(
    {
        # The rates of every firmware (FACTS.md W22).
        **dict.fromkeys([9600, 19200, 38400, 57600, 115200, 230400, 250000, 460800, 500000], 0),
        # Firmware 369 added these (FACTS.md W22).
        **dict.fromkeys([750000, 921600], 369),
    }
)
"""All baud rates of the servos, with the first firmware that has each."""

SERVO_ID_MAX: Final = 250
"""Ids 0 to 250 are usable (FACTS.md R1); this also bounds the joints of one bus to 251."""


def model_mismatch_text(joint: Joint, reported: str) -> str:
    """Return the text for a servo that reports another model than the robot file has."""
    known = next((name for name in SERVO_MODELS if reported.startswith(name)), None)
    remedy = "" if known is None else f"; if it is the right servo, write `model: {known}` there"
    return (
        f"servo {joint.servo_id} is an {reported}, the robot file says {joint.model.name}{remedy}. "
        f"Check whether the servo of this joint has another id, or is on another bus"
    )


def ramp_steps(model: ServoModel, accel_deg_s2: float, ramp_ratio: float) -> int:
    """Return the AA and AD whose ramps are nearest below `accel_deg_s2`.

    Real ramps are `ramp_ratio` times the setting. Rounded up, every ramp would break the limit. The
    result is not bounded to the range of AA and AD.
    """
    return math.floor(round(accel_deg_s2 / (_ramp_step(model) * ramp_ratio), 6))


def ramp_steps_max(model: ServoModel) -> int:
    """Return the largest AA and AD."""
    has_ramps = math.isfinite(model.accel_max_deg_s2)
    return round((model.accel_max_deg_s2 if has_ramps else RAMP_MAX_DEG_S2) / _ramp_step(model))


def ramp_of_steps(model: ServoModel, steps: int) -> float:
    """Return the acceleration, in deg/s², of an AA or AD."""
    return round(steps * _ramp_step(model), 6)


def _ramp_step(model: ServoModel) -> float:
    """Return the unit of AA and AD; for a servo without ramps, that of an LSS."""
    return model.accel_step_deg_s2 or RAMP_STEP_DEG_S2


FILTER_FIRMWARE_MIN: Final = 368
"""The first firmware with FPC (FACTS.md M5)."""
RC_RANGE_DEG: Final = 90.0
"""An LSS-2IO turns its RC servos by ±90 deg (FACTS.md B6)."""
DURATION_DIGITS_MS: Final = 9_999
"""The longest T of a move (`DURATION_MAX_MS` of `program`)."""

_WHY: Final = {
    (Family.LSS_PRO, "streamed"): "no document gives an LSS-PRO the filter (FPC) that it needs",
    (Family.IO2, "timed"): "an RC servo has no T and moves at full speed",
    (Family.IO2, "streamed"): "an RC servo has no filter and moves at full speed",
}
_STEPPED_WHY: Final = "whole degrees are for the RC servos of an LSS-2IO"


def drive_problem(model: ServoModel, drive: Drive) -> str:
    """Return why a servo of that model does not allow a drive; an empty text if it does."""
    allowed = FAMILIES[model.family].drives
    if drive in allowed:
        return ""
    why = _WHY.get((model.family, drive), _STEPPED_WHY)
    return f"an {model.name} cannot be {drive}: {why}; it can be {' or '.join(allowed)}"


def can_be_streamed(joint: Joint, bus: Bus) -> bool:
    """Return whether the servo has the filter of EM0, by its model and the firmware of the bus."""
    return "streamed" in FAMILIES[joint.model.family].drives and bus.firmware >= FILTER_FIRMWARE_MIN


def needs_filter(joint: Joint) -> bool:
    """Return whether only the filter of a servo can follow the acceleration of the joint."""
    can_stream = "streamed" in FAMILIES[joint.model.family].drives
    return can_stream and joint.accel_max_deg_s2 > joint.model.accel_max_deg_s2


def board_problems(
    buses: Mapping[str, Bus], joints: Mapping[str, Joint]
) -> Iterator[tuple[tuple[str, str, str], str]]:
    """Yield location and reason of every drive, line and range that model or bus do not allow."""
    has_board = {j.bus for j in joints.values() if j.model.family is Family.IO2}
    for name in sorted(has_board):
        if buses[name].baud_bps > BAUD_MAX_BPS:
            yield (
                ("buses", name, "baud_bps"),
                f"{buses[name].baud_bps} bps is too fast for the LSS-2IO on bus {name!r}; at most "
                f"{BAUD_MAX_BPS}",
            )
    for joint in joints.values():
        bus = buses[joint.bus]
        if joint.drive != "auto" and (reason := drive_problem(joint.model, joint.drive)):
            yield ("joints", joint.name, "drive"), f"joint {joint.name!r}: {reason}"
        if joint.drive == "streamed" and bus.firmware < FILTER_FIRMWARE_MIN:
            yield (
                ("joints", joint.name, "drive"),
                f"joint {joint.name!r} cannot be streamed: that needs firmware "
                f"{FILTER_FIRMWARE_MIN} or later, but bus {bus.name!r} has {bus.firmware}",
            )
        if joint.model.family is Family.IO2:
            yield from _rc_range_problems(joint)
        elif joint.bus in has_board and len(_longest(joint)) > SECTION_MAX_CHARS:
            yield (
                ("joints", joint.name, "id"),
                f"joint {joint.name!r}: {_longest(joint).decode()} has more than the "
                f"{SECTION_MAX_CHARS} characters that the LSS-2IO on bus {joint.bus!r} allows; "
                f"give it a shorter id or another bus",
            )


def _rc_range_problems(joint: Joint) -> Iterator[tuple[tuple[str, str, str], str]]:
    ends = joint.servo_range_deg
    pulse_us = joint.model.units.rc_pulse_us
    zero_deg, most_deg = rc_zero_deg(pulse_us), RC_RANGE_DEG * 10.0 / joint.model.wire_per_deg
    if max(map(abs, ends)) > most_deg:
        least, most = zero_deg - most_deg, zero_deg + most_deg
        reach = f"±{RC_RANGE_DEG:g}" if zero_deg == 0.0 else f"{least:.1f} to {most:.1f}"
        yield (
            ("joints", joint.name, "range_deg"),
            f"joint {joint.name!r}: its servo would go to {max(ends, key=abs) + zero_deg:g} deg; "
            f"an LSS-2IO turns its servos by {reach}",
        )


def _longest(joint: Joint) -> bytes:
    """Return the longest move of a timed or streamed joint, without its CR."""
    duration_ms = None if joint.drive == "streamed" else DURATION_DIGITS_MS
    wires = (round(end * joint.model.wire_per_deg) for end in joint.servo_range_deg)
    return max((encode_move(joint.servo_id, wire, duration_ms)[:-1] for wire in wires), key=len)
