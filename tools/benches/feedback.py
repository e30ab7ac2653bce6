"""What the closed loop is worth: horns against the plan, with and without it, disturbed.

Six joints, three lively shows, virtual time; the same bytes of the same program both times.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final
from unittest.mock import patch

import numpy as np
from msgspec.structs import replace

from benches.shows import lively_show, robot_of
from benches.table import Row
from lss_motion.playing import api
from lss_motion.playing.run import perform
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim import bus
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.robot.model import Robot

JOINTS: Final = 6
SHOW_S: Final = 20.0
SEEDS: Final = (5, 6, 7)
"""Which commands are lost decides much: one show says little."""
DROOP_DEG: Final = 2.5
"""What hangs on every joint pulls it so far down when its arm is level."""
LAG_WRONG_S: Final = 0.03
SLOW_RATIO: Final = 0.8
"""Servo 1 reaches so much of the speed that its robot file says."""
SLOW_DEG_S: Final = 40.0
"""That speed: its shows go at it for a twentieth to a fifth of their time, and it falls behind."""
LOST_RATIO: Final = 0.02
TARGET_RATIO: Final = 3.0

SLOW: Final = Fault(
    kind=FaultKind.WEAK,
    servo_id=1,
    speed_ratio=SLOW_RATIO * SLOW_DEG_S / SERVO_MODELS["LSS-ST1"].speed_max_deg_s,
)
LOST: Final = Fault(kind=FaultKind.LOST_COMMAND, ratio=LOST_RATIO)


def measure() -> list[Row]:
    """Return RMS with feedback next to that without, for each disturbance and for all of them."""
    robot = _robot()
    droop_deg = dict.fromkeys(robot.joints, DROOP_DEG)
    lag = Physics(lag_s=Physics().lag_s + LAG_WRONG_S)
    cases: dict[str, dict[str, Any]] = {
        "none": {},
        f"{DROOP_DEG:g} deg of gravity droop": {"droop_deg": droop_deg},
        f"a lag wrong by {1e3 * LAG_WRONG_S:.0f} ms": {"physics": lag},
        f"a servo {1.0 - SLOW_RATIO:.0%} slow": {"faults": [SLOW]},
        f"{LOST_RATIO:.0%} of the commands lost": {"faults": [LOST]},
        "all of them": {"droop_deg": droop_deg, "physics": lag, "faults": [SLOW, LOST]},
    }
    rows = []
    for what, disturbance in cases.items():
        with_deg, without_deg = (
            _rms([_rms_deg(robot, disturbance, seed, has_feedback=has_feedback) for seed in SEEDS])
            for has_feedback in (True, False)
        )
        ratio = without_deg / with_deg
        is_judged = what == "all of them"
        rows.append(
            Row(
                what=f"RMS of all horns, disturbed by: {what}",
                ours=f"{with_deg:.3f} deg",
                reference=f"{without_deg:.3f} deg with --no-feedback",
                ratio=ratio,
                target=f">= {TARGET_RATIO:g} x smaller" if is_judged else "",
                is_met=ratio >= TARGET_RATIO if is_judged else None,
            )
        )
    return rows


def _robot() -> Robot:
    robot = robot_of(JOINTS)
    first = next(iter(robot.joints.values()))
    slow = replace(first, speed_max_deg_s=SLOW_DEG_S)
    return replace(robot, joints={**robot.joints, first.name: slow})


def _rms_deg(
    robot: Robot, disturbance: Mapping[str, Any], seed: int, *, has_feedback: bool
) -> float:
    trajectory = api.plan(lively_show(robot, SHOW_S, seed=seed), robot)
    program = api.compile(trajectory, robot)
    faults: Sequence[Fault] = disturbance.get("faults", ())
    made = partial(
        bus.bus_from_robot,
        droop_deg=disturbance.get("droop_deg"),
        physics=disturbance.get("physics"),
    )
    with patch.object(bus, "bus_from_robot", made):
        result = perform(
            program,
            robot,
            is_virtual=True,
            seed=seed,
            trajectory=trajectory,
            has_feedback=has_feedback,
            faults=faults,
        )
    joints = result.report.joints.values()
    return _rms([joint.horn_error_rms_deg for joint in joints])


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
