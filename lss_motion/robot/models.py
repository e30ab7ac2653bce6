"""The table of servo models, and what each family can do that playing needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.protocol.family import Family
from lss_motion.robot.model import ServoModel

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Drive, Joint

PRO_SPEED_MAX_ASSUMED_DEG_S: Final = 180.0
"""Assumption: no document gives the top speed of an LSS-PRO. Twice what real arms use (90 deg/s,
FACTS.md P9), so that a sober setting is never refused."""

RC_SPEED_MAX_ASSUMED_DEG_S: Final = 400.0
"""Assumption: an RC servo on a 2IO can be of any make; 0.15 s for 60 deg is a common one."""

IO2_WIRE_STEP: Final = 10
"""A 2IO takes tenths of a degree and makes whole degrees of them (FACTS.md B6)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyFacts:
    """What all models of a family have in common.

    `drives` are those that it can be commanded with, its usual one first.
    `accel_max_deg_s2` is what the ramps AA and AD can express; a timed joint cannot follow more.
    `settings` are the session settings that a robot file may set, with their least and largest
    value. EM, FPC, AA, AD and SD are not among them: the player sets those to what the plan needs.
    """

    wire_per_deg: int
    drives: tuple[Drive, ...]
    accel_step_deg_s2: float
    accel_max_deg_s2: float
    settings: Mapping[str, tuple[int, int]]


RAMP_STEP_DEG_S2: Final = 10
"""AA and AD count in tens of deg/s² (FACTS.md M20)."""
RAMP_STEPS_MAX: Final = 100
"""The largest AA and AD, and the default (FACTS.md M20)."""

_STIFFNESS: Final = (-10, 10)
"""AS and AH: -4..4 is sensible, -10..10 is accepted (FACTS.md M24, M25)."""

_LED: Final = (0, 7)
"""0 off to 7 white, all families (FACTS.md C8)."""

FAMILIES: Final[Mapping[Family, FamilyFacts]] = MappingProxyType(
    {
        Family.LSS: FamilyFacts(
            drives=("timed", "streamed"),
            wire_per_deg=10,  # 1/10 deg (FACTS.md C1)
            accel_step_deg_s2=RAMP_STEP_DEG_S2,
            accel_max_deg_s2=RAMP_STEPS_MAX * RAMP_STEP_DEG_S2,
            settings=MappingProxyType({"AS": _STIFFNESS, "AH": _STIFFNESS, "LED": _LED}),
        ),
        Family.LSS_PRO: FamilyFacts(
            drives=("timed",),  # EM and FPC are not in its tables: FACTS.md P10
            wire_per_deg=100,  # 1/100 deg (FACTS.md P1)
            accel_step_deg_s2=RAMP_STEP_DEG_S2,
            accel_max_deg_s2=RAMP_STEPS_MAX * RAMP_STEP_DEG_S2,
            settings=MappingProxyType({"LED": _LED}),  # its tables have no AS and AH
        ),
        Family.IO2: FamilyFacts(
            drives=("stepped",),
            wire_per_deg=10,  # tenths (FACTS.md B6)
            accel_step_deg_s2=0.0,  # no ramps: it jumps
            accel_max_deg_s2=math.inf,
            settings=MappingProxyType({}),
        ),
    }
)


def _model(name: str, family: Family, speed_max_deg_s: float) -> ServoModel:
    return ServoModel(
        name=name,
        family=family,
        speed_max_deg_s=speed_max_deg_s,
        wire_per_deg=FAMILIES[family].wire_per_deg,
        wire_step=IO2_WIRE_STEP if family is Family.IO2 else 1,
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

BAUD_FIRMWARE_MIN: Final[Mapping[int, int]] = MappingProxyType(
    {
        # The rates of every firmware (FACTS.md W22).
        **dict.fromkeys([9600, 19200, 38400, 57600, 115200, 230400, 250000, 460800, 500000], 0),
        # Firmware 369 added these (FACTS.md W22).
        **dict.fromkeys([750000, 921600], 369),
    }
)
"""The baud rates that a servo recognises, and from which firmware; no others exist."""

SERVO_ID_MAX: Final = 250
"""Ids 0 to 250 are usable (FACTS.md R1); this also bounds the joints of one bus to 251."""


def other_model(joint: Joint, said: str) -> str:
    """Return what to say of a servo that says that it is another model than the robot file does."""
    known = next((name for name in SERVO_MODELS if said.startswith(name)), None)
    remedy = "" if known is None else f"; if it is the right servo, write `model: {known}` there"
    return (
        f"servo {joint.servo_id} is an {said}, the robot file says {joint.model.name}{remedy}. "
        f"Look whether the servo of this joint has another id, or hangs on another bus"
    )


def ramp_steps(accel_deg_s2: float, ramp_ratio: float) -> int:
    """Return the AA and AD whose ramps, `ramp_ratio` of what they say, are nearest below.

    Rounded up, the servo would break the limit with every ramp. Not bounded to what exists.
    """
    return math.floor(round(accel_deg_s2 / (RAMP_STEP_DEG_S2 * ramp_ratio), 6))
