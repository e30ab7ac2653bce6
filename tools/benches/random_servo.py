"""A simulated servo with random physics, the same for the same seed."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from lss_motion.sim.physics import Physics, ServoSpec, Turnaround

if TYPE_CHECKING:
    from lss_motion.robot.model import ServoModel

LAG_S = (0.008, 0.08)
RAMP_RATIO = (0.75, 1.3)
NOISE_DEG = (0.03, 0.15)
SUPPLY_V = (6.8, 12.4)
NOMINAL_V = (12.0, 24.0)
DROOP_DEG = (0.5, 3.0)
PLAY_DEG = (0.3, 1.2)
TURNAROUND_MIN_NS = (100_000, 1_000_000)
TURNAROUND_MORE_NS = (100_000, 2_000_000)
"""Ranges of the random values. Chosen: around the defaults, several times to either side."""


def random_servo(seed: int, servo_id: int, model: ServoModel) -> tuple[Physics, ServoSpec]:
    """Return the physics of a bus and the one servo on it, the same for the same arguments.

    Half of all servos carry a load; half of all have play.
    """
    random = Random(f"{seed}/servo")  # noqa: S311
    least_ns = random.randint(*TURNAROUND_MIN_NS)
    physics = Physics(
        lag_s=random.uniform(*LAG_S),
        ramp_ratio=random.uniform(*RAMP_RATIO),
        retarget=random.choice(("keep_speed", "from_rest")),
        t_law=random.choice(("cruise", "exact")),
        noise_deg=random.uniform(*NOISE_DEG),
        supply_v=random.uniform(*SUPPLY_V),
        nominal_v=random.uniform(*NOMINAL_V),
        turnaround=Turnaround(
            single_min_ns=least_ns, single_max_ns=least_ns + random.randint(*TURNAROUND_MORE_NS)
        ),
    )
    spec = ServoSpec(
        servo_id=servo_id,
        model=model,
        start_deg=random.uniform(-45.0, 45.0),
        droop_deg=random.choice((0.0, random.uniform(*DROOP_DEG))),
        level_deg=random.uniform(-60.0, 60.0),
        backlash_deg=random.choice((0.0, random.uniform(*PLAY_DEG))),
    )
    return physics, spec
