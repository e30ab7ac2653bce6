"""Pauses, other speeds and starts in the middle break no limit in any example, at the horn."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from lss_motion.planning import shows
from lss_motion.playing import api
from lss_motion.playing.run import Observer, perform
from lss_motion.sim.bus import servos_of

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
NAMES = ("wave", "show", "tracks", "fastest", "playlist", "hexapod_walk", "quadruped_trot")
STEP_NS = 5_000_000
WINDOW = 4
"""Speeds are differences over 20 ms: a servo's own loop is 5 ms."""
SPEED_EXCESS, ACCEL_EXCESS, RANGE_EXCESS_DEG = 1.05, 1.1, 0.3
"""As in the fault campaign: what the simulator's loop of 5 ms and its noise add."""
ALL_S = 4.0
"""Show time that is played of each, from anywhere."""


class Meddler:
    """Controls of somebody who pauses, goes on, changes the speed and stops."""

    def __init__(self, random, start_s):
        at_s = start_s
        self._wishes = []
        for rate in (0.0, random.uniform(0.3, 1.0), random.uniform(0.1, 0.9), 1.0, 0.0, 1.0):
            at_s += random.uniform(0.1, 0.5)
            self._wishes.append((at_s, rate))
        self._stop_s = start_s + ALL_S
        self.done = []

    def filenos(self):
        return []

    def act(self, player, now_ns):
        if player.phase != "playing":
            return
        stands = player.show.is_standing(now_ns)
        show_s = player.show.show_s(now_ns)
        if self._wishes and (stands or show_s >= self._wishes[0][0]):
            _, rate = self._wishes.pop(0)
            player.set_rate(rate, now_ns)
            self.done.append(rate)
        elif not self._wishes and (stands or show_s >= self._stop_s):
            player.stop(now_ns)


@pytest.fixture(scope="module")
def example():
    """Return what plans and compiles an example, once."""
    made = {}

    def compiled(name):
        if name not in made:
            sequence, robot = shows.load(EXAMPLES / f"{name}.yaml", None)
            made[name] = robot, api.compile(shows.planned(sequence, robot), robot)
        return made[name]

    return compiled


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("wave", 0), *((name, 1) for name in NAMES)])
def test_whatever_somebody_does_no_horn_breaks_a_limit(example, name, seed):
    robot, program = example(name)
    random = Random(f"{name}/{seed}")
    end_s = min(program.duration_s, 60.0)
    # Seed 0 begins where the show begins; all others somewhere, as after a seek.
    start_s = random.uniform(0.0, max(0.0, end_s - ALL_S - 0.5)) if seed else None
    meddler = Meddler(random, start_s or 0.0)
    observer = Observer(controls=meddler)
    result = perform(program, robot, is_virtual=True, seed=seed, start_s=start_s, observer=observer)
    assert result.report.outcome in ("stopped", "finished")
    assert len(meddler.done) >= 3
    assert not result.report.faults
    for bus_name, bus in result.simulated.items():
        end_ns = bus.lines[-1][0]
        horns = bus.horn_deg(np.arange(0, end_ns, STEP_NS))
        for column, joint_name in enumerate(servos_of(robot, bus_name)):
            joint = robot.joints[joint_name]
            angles = joint.direction * (horns[:, column] - joint.zero_deg)
            assert angles.min() > joint.position_min_deg - RANGE_EXCESS_DEG, joint_name
            assert angles.max() < joint.position_max_deg + RANGE_EXCESS_DEG, joint_name
            speed = (angles[WINDOW:] - angles[:-WINDOW]) / (WINDOW * STEP_NS / 1e9)
            accel = (speed[WINDOW:] - speed[:-WINDOW]) / (WINDOW * STEP_NS / 1e9)
            assert np.abs(speed).max() < SPEED_EXCESS * joint.speed_max_deg_s, joint_name
            assert np.abs(accel).max() < ACCEL_EXCESS * joint.accel_max_deg_s2, joint_name
