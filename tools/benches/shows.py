"""Shows and robots made from a seed, for measuring."""

from __future__ import annotations

import numpy as np

from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence

SPEED_MAX_DEG_S = 200.0
ACCEL_MAX_DEG_S2 = 800.0
RANGE_DEG = 90.0
SWING_DEG = 25.0


def robot_of(joints: int, *, baud_bps: int = 115_200) -> Robot:
    """Return a robot of so many ST1 servos on one simulated bus."""
    return Robot(
        name=f"bench{joints}",
        path=None,
        buses={"main": Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370)},
        joints={
            f"j{index:02d}": Joint(
                name=f"j{index:02d}",
                servo_id=index + 1,
                bus="main",
                model=SERVO_MODELS["LSS-ST1"],
                position_min_deg=-RANGE_DEG,
                position_max_deg=RANGE_DEG,
                speed_max_deg_s=SPEED_MAX_DEG_S,
                accel_max_deg_s2=ACCEL_MAX_DEG_S2,
            )
            for index in range(joints)
        },
    )


def lively_show(
    robot: Robot, duration_s: float, *, seed: int, infeasible_ratio: float = 0.0
) -> Sequence:
    """Return a show in which most joints are keyed every half second or so.

    A key is no further from the last one than the joint can go in the time between, with room to
    spare, except for `infeasible_ratio` of the keyframes.
    """
    random = np.random.default_rng(seed)
    names = list(robot.joints)
    now_s, last_s = 0.0, dict.fromkeys(names, 0.0)
    at_deg = dict.fromkeys(names, 0.0)
    frames = [Keyframe(at_s=0.0, deg=dict(at_deg))]
    while now_s < duration_s - min(1.5, duration_s / 2.0):
        now_s = round(now_s + random.uniform(0.35, 0.65), 3)
        is_rough = random.random() < infeasible_ratio
        keyed = {}
        for name in names:
            if random.random() < 0.3:
                continue
            free_s = now_s - last_s[name]
            most_deg = min(SWING_DEG * 2, ACCEL_MAX_DEG_S2 * free_s * free_s / 9.0)
            wanted = float(np.clip(random.normal(0.0, SWING_DEG), -80.0, 80.0))
            if not is_rough:
                wanted = float(np.clip(wanted, at_deg[name] - most_deg, at_deg[name] + most_deg))
            keyed[name] = round(wanted, 1)
            at_deg[name], last_s[name] = keyed[name], now_s
        if keyed:
            frames.append(Keyframe(at_s=now_s, deg=keyed))
    frames.append(Keyframe(at_s=duration_s, deg=dict.fromkeys(names, 0.0)))
    return Sequence(name=f"lively{seed}", keyframes=tuple(frames))
