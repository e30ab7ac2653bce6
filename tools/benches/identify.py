"""Does `identify` find what a blind simulator hides? Servos drawn from seeds, judged by the truth.

Every seed draws lag, ramps, both laws, supply, load, play, noise and turnaround of the servo, and
the joint's limits. A number counts as found within 10 %, or 5 ms (times), or a wire unit (angles).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

import numpy as np

from benches.random_servo import random_servo
from benches.table import Row
from lss_motion.maintenance.identify.estimate import identify
from lss_motion.maintenance.identify.joint_run import Experiment
from lss_motion.maintenance.identify.trials import make_window
from lss_motion.playing.connection import Connection
from lss_motion.playing.player import checks, handshake
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.bus import SimBus, SimPort
from lss_motion.sim.physics import TICK_NS, Physics, ServoSpec
from lss_motion.system.clock import VirtualClock
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from lss_motion.maintenance.identify.estimate import Identified

SEEDS = 24
SEEDS_SHORT = 8
TIME_ALLOWED_S = 0.005
RATIO_ALLOWED = 0.1
ANGLE_ALLOWED_DEG = 0.1
MODEL = SERVO_MODELS["LSS-ST1"]


@dataclass(frozen=True)
class Blind:
    """One servo, what is true of it, what was found, and where its horn was meanwhile."""

    seed: int
    physics: Physics
    spec: ServoSpec
    joint: Joint
    span_deg: float
    found: Identified
    away_deg: float
    """How far the horn was from where it stood, at most."""
    last_lines: tuple[bytes, ...]


def blind(seed: int) -> Blind:
    """Identify the servo of `seed` in virtual time."""
    physics, spec = random_servo(seed, 3, MODEL)
    random = Random(f"{seed}/joint")  # noqa: S311
    joint = Joint(
        name="joint",
        servo_id=3,
        bus="main",
        model=MODEL,
        position_min_deg=-90.0,
        position_max_deg=90.0,
        speed_max_deg_s=random.choice((180.0, 300.0)),
        accel_max_deg_s2=random.choice((300.0, 600.0, 1000.0)),
        direction=random.choice((1, -1)),
    )
    span_deg = random.uniform(15.0, 45.0)
    robot = Robot(
        name="blind",
        path=None,
        buses={"main": Bus(name="main", port="sim://", baud_bps=115200, firmware=370)},
        joints={"joint": joint},
    )
    connection = Connection(robot.buses, VirtualClock())
    bus = SimBus([spec], baud_bps=115200, firmware=370, seed=seed, physics=physics)
    bus.record()
    connection.ports["main"] = SimPort(bus, connection.clock)
    answers = connection.ask(checks.queries([joint]))
    standing_deg = handshake.reported(joint, answers, "QD")
    assert standing_deg is not None
    window = make_window(joint, standing_deg, span_deg)
    experiment = Experiment(joint, robot, answers, window, standing_deg=standing_deg)
    connection.run(experiment)
    connection.close()
    if experiment.error is not None:
        raise experiment.error
    instants_ns = np.arange(0, connection.clock.now_ns(), TICK_NS)
    horn_deg = bus.horn_deg(instants_ns.tolist())[:, 0]
    assert bus.lines is not None
    return Blind(
        seed=seed,
        physics=physics,
        spec=spec,
        joint=joint,
        span_deg=span_deg,
        found=identify(joint, experiment.recording),
        away_deg=float(np.abs(horn_deg - spec.start_deg).max()),
        last_lines=tuple(line.rstrip(b"\r") for _, line in bus.lines[-5:]),
    )


def faults(one: Blind) -> dict[str, str]:
    """Return what was not found, or not kept: what → found and true."""
    found, physics = one.found, one.physics
    ramp_deg_s2 = physics.ramp_ratio * found.ramp_deg_s2
    turnaround = physics.turnaround
    assert turnaround is not None
    middle_ns = 0.5 * (turnaround.single_min_ns + turnaround.single_max_ns)
    loop_s = 0.0 if found.loop_s is None else found.loop_s.value
    told = {
        "lag": (found.lag_s.value, physics.lag_s, TIME_ALLOWED_S),
        "delay": (found.delay_s.value, physics.lag_s + s_from_ns(TICK_NS) / 2.0, TIME_ALLOWED_S),
        "loop": (loop_s, s_from_ns(TICK_NS), 0.0),
        "ramp up": (found.accel_deg_s2.value, ramp_deg_s2, 0.0),
        "ramp down": (found.decel_deg_s2.value, ramp_deg_s2, 0.0),
        "turnaround": (found.turnaround_s[1], middle_ns * 1e-9, 0.0),
        "droop": (found.droop_deg[1], _droop_deg(one), ANGLE_ALLOWED_DEG),
        "play": (found.play_deg.value, _play_deg(one), ANGLE_ALLOWED_DEG),
        "speed": (found.top_deg_s.value, _top_deg_s(one), 0.0),
    }
    wrong = {
        what: f"{value:.4g}, true {true:.4g}"
        for what, (value, true, allowed) in told.items()
        if abs(value - true) > max(allowed, RATIO_ALLOWED * abs(true))
    }
    for what, law in (("retarget", found.retarget), ("t_law", found.t_law)):
        if law.value != getattr(physics, what) or not law.is_sure:
            wrong[what] = f"{law}, true {getattr(physics, what)}"
    if one.away_deg > one.span_deg:
        wrong["span"] = f"{one.away_deg:.1f} deg away, allowed {one.span_deg:.1f}"
    if set(one.last_lines) != {b"#3EM1", b"#3AA100", b"#3AD100", b"#3SD3600", b"#3H"}:
        wrong["end"] = str(one.last_lines)
    return wrong


def _droop_deg(one: Blind) -> float:
    """Return how far the horn hangs in the middle of the window, in joint degrees."""
    spec = one.spec
    if not spec.droop_deg:
        return 0.0
    pull = math.cos(math.radians(spec.start_deg - spec.level_deg))
    side = math.copysign(spec.backlash_deg / 2.0, pull)
    return one.joint.direction * (spec.droop_deg * pull + side)


def _play_deg(one: Blind) -> float:
    """Return the play that shows: a load keeps the gears on its side, unless it changes sides."""
    spec = one.spec
    ends_deg = one.joint.servo_deg(one.found.low_deg), one.joint.servo_deg(one.found.high_deg)
    pulls = [math.cos(math.radians(end_deg - spec.level_deg)) for end_deg in ends_deg]
    is_one_sided = spec.droop_deg > 0.0 and min(pulls) * max(pulls) > 0.0
    return 0.0 if is_one_sided else spec.backlash_deg


def _top_deg_s(one: Blind) -> float:
    """Return the top speed, or, where it was not reached, what was found: then that is true."""
    top_deg_s = MODEL.speed_max_deg_s * one.physics.supply_v / one.physics.nominal_v
    found = one.found.top_deg_s.value
    return top_deg_s if one.found.is_top or found > top_deg_s else found


def measure() -> list[Row]:
    """Return one row a servo, and how many were found whole."""
    return _measured(SEEDS)


def measure_short() -> list[Row]:
    """Return the same of fewer servos."""
    return _measured(SEEDS_SHORT)


def _measured(seeds: int) -> list[Row]:
    rows, whole = [], 0
    for seed in range(seeds):
        one = blind(seed)
        wrong = faults(one)
        whole += not wrong
        found, physics = one.found, one.physics
        rows.append(
            Row(
                what=f"seed {seed}",
                ours=f"lag {1e3 * found.lag_s.value:.1f}/{1e3 * physics.lag_s:.1f} ms, ramps "
                f"{found.accel_deg_s2.value:.0f}, {found.decel_deg_s2.value:.0f}/"
                f"{physics.ramp_ratio * found.ramp_deg_s2:.0f}, droop {found.droop_deg[1]:.2f}/"
                f"{_droop_deg(one):.2f}, play {found.play_deg.value:.2f}/{_play_deg(one):.2f}, "
                f"speed {found.top_deg_s.value:.0f}{'' if found.is_top else '+'}",
                reference=f"{physics.retarget}, {physics.t_law}",
                target="; ".join(f"{what} {text}" for what, text in wrong.items()),
                is_met=not wrong,
            )
        )
    rows.append(
        Row(
            what="found whole",
            ours=f"{whole} of {seeds}",
            target=f"all, within {RATIO_ALLOWED:.0%} or {1e3 * TIME_ALLOWED_S:.0f} ms",
            is_met=whole == seeds,
        )
    )
    return rows
