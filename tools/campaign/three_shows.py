"""Three small robots with a short show each: what a seed plays takes a fraction of a second."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.playing import api
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.profile import ramp_setting_deg_s2
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence

if TYPE_CHECKING:
    from lss_motion.planning.program.model import Program

RESUME_S: Final = 2.0
"""A servo is back 1.25 s after its RESET: some faults are waited for, others given up."""
SLOW_BPS: Final = 9_600
"""Of the slowest line. What a run costs is its questions, and they fill the line; a slow one also
has less room."""
NAMES: Final = ("arm", "owl", "pair")


@dataclass(frozen=True)
class Show:
    """A robot, and the program that it plays."""

    robot: Robot
    program: Program


@cache
def show(name: str, slow_bps: int = SLOW_BPS) -> Show:
    """Return one of the shows `NAMES`; its slowest line has `slow_bps`."""
    make, keys = {"arm": (_arm, ARM_KEYS), "owl": (_owl, OWL_KEYS), "pair": (_pair, PAIR_KEYS)}[
        name
    ]
    robot = make(slow_bps)
    frames = tuple(
        Keyframe(deg=dict(zip(robot.joints, angles, strict=True)), at_s=at_s)
        for at_s, angles in keys
    )
    sequence = Sequence(name=name, keyframes=frames)
    return Show(robot, api.compile(api.plan(sequence, robot), robot))


def with_stored_limits(robot: Robot) -> Robot:
    """Return a robot whose servos store the limits of its joints, as `configure` recommends."""
    joints = {}
    for name, joint in robot.joints.items():
        ramp = float(ramp_setting_deg_s2(joint))
        limits = {"SD": math.floor(10.0 * joint.speed_max_deg_s) / 10.0, "AA": ramp, "AD": ramp}
        own = {} if joint.drive == "stepped" else limits
        joints[name] = replace(joint, stored={**joint.stored, **own})
    return replace(robot, joints=joints)


ARM_KEYS: Final = (
    (0.0, (0.0, 20.0, -30.0)),
    (0.7, (45.0, -10.0, 20.0)),
    (1.5, (-30.0, 35.0, 10.0)),
    (2.2, (0.0, 20.0, -30.0)),
)
OWL_KEYS: Final = (
    (0.0, (0.0, 5.0, 5.0, 0.0)),
    (0.6, (40.0, 50.0, 30.0, 25.0)),
    (1.1, (20.0, 10.0, 60.0, 5.0)),
    (2.0, (-20.0, 5.0, 5.0, 0.0)),
)
PAIR_KEYS: Final = (
    (0.0, (0.0, 0.0, 0.0, 0.0)),
    (0.8, (25.0, -40.0, 30.0, 15.0)),
    (1.4, (-25.0, 10.0, -30.0, 40.0)),
    (2.1, (10.0, 0.0, 0.0, 20.0)),
)


def _joint(name: str, servo_id: int, bus: str = "main", **fields: Any) -> Joint:  # noqa: ANN401
    base = Joint(
        name=name,
        servo_id=servo_id,
        bus=bus,
        model=SERVO_MODELS["LSS-ST1"],
        position_min_deg=-60.0,
        position_max_deg=70.0,
        speed_max_deg_s=180.0,
        accel_max_deg_s2=600.0,
    )
    return replace(base, **fields)


def _robot(name: str, joints: list[Joint], **baud_bps: int) -> Robot:
    buses = {
        bus: Bus(name=bus, port="sim://", baud_bps=rate, firmware=370)
        for bus, rate in baud_bps.items()
    }
    named = {joint.name: joint for joint in joints}
    return Robot(name=name, path=None, buses=buses, joints=named, resume_s=RESUME_S)


def _arm(slow_bps: int) -> Robot:
    """Return three timed joints, the middle one turned round and with a zero of its own."""
    joints = [
        _joint("base", 1),
        _joint("shoulder", 2, direction=-1, zero_deg=15.0),
        _joint("elbow", 3),
    ]
    return _robot("arm", joints, main=slow_bps)


def _owl(slow_bps: int) -> Robot:
    """Return a robot with every drive on one bus: a timed, two streamed and a stepped joint."""
    wing = {"drive": "streamed", "speed_max_deg_s": 240.0, "accel_max_deg_s2": 1500.0}
    lid = {
        "model": SERVO_MODELS["LSS-2IO"],
        "drive": "stepped",
        "speed_max_deg_s": 350.0,
        "accel_max_deg_s2": 3000.0,
    }
    joints = [
        _joint("head", 1),
        _joint("left_wing", 3, **wing),
        _joint("right_wing", 4, direction=-1, **wing),
        _joint("lid", 209, **lid),
    ]
    return _robot("owl", joints, main=2 * slow_bps)


def _pair(slow_bps: int) -> Robot:
    """Return two buses with two joints each, one of them slow and one of LSS-PRO."""
    pro = SERVO_MODELS["LSS-P-S1"]
    joints = [
        _joint("left_pan", 1, "left"),
        _joint("left_tilt", 2, "left"),
        _joint("right_pan", 1, "right", model=pro),
        _joint("right_tilt", 5, "right", model=pro),
    ]
    return _robot("pair", joints, left=slow_bps, right=2 * slow_bps)
