"""The joint that most tests play with."""

from __future__ import annotations

from msgspec.structs import replace

from lss_motion.robot.model import Joint
from lss_motion.robot.servo_models import SERVO_MODELS


def joint(name="j0", servo_id=1, **fields) -> Joint:
    base = Joint(
        name=name,
        servo_id=servo_id,
        bus="main",
        model=SERVO_MODELS["LSS-ST1"],
        position_min_deg=-90.0,
        position_max_deg=90.0,
        speed_max_deg_s=180.0,
        accel_max_deg_s2=600.0,
    )
    return replace(base, **fields)
