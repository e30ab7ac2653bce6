"""Robots that are steered while they walk, in virtual time, judged by what their horns did."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from local_planner import LocalPlanner
from msgspec.structs import replace

from lss_motion.planning import shows
from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import Observer, perform
from lss_motion.playing.walking.pilot import Pilot
from lss_motion.playing.walking.planner import WalkPlanner
from lss_motion.show.gait.kinematics import forward
from lss_motion.show.gait.model import BodyPose
from lss_motion.show.gait.steering import slowed_to_limits
from lss_motion.show.gait.stepping import STILL, Twist
from lss_motion.sim import bus as sim_bus

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
TOLERANCE_DEG = 0.2
STAND_DEG = 0.6
TOP = {
    "hexapod_walk": Twist(forward_mm_s=45.0, left_mm_s=35.0, turn_deg_s=12.0),
    "quadruped_trot": Twist(forward_mm_s=25.0, left_mm_s=12.0, turn_deg_s=8.0),
}


class WalkedRobot:
    """One steered run. `script` is `(show time, what to do with (walk, player, now_ns))` in turn.

    After the script it is let go, and ends when it stands.
    """

    def __init__(self, monkeypatch, name, script, *, takes_s=lambda: 0.2, has_feedback=False):
        gait, self.robot = shows.load_gait(EXAMPLES / f"{name}.yaml", None)
        self.gait, self.top = slowed_to_limits(
            replace(gait, start=BodyPose()), self.robot, TOP[name]
        )
        self.planner = WalkPlanner(self.gait, self.robot, TOLERANCE_DEG)
        link = LocalPlanner(self.planner, takes_s)
        self.pilot = Pilot(link, phase_s=self.planner.phase_s, splice_s=self.planner.splice_s)
        self.script, self.acted_ns = list(script), []
        buses, make = {}, sim_bus.bus_from_robot

        def made(robot, bus, **rest):
            buses[bus] = make(robot, bus, **rest)
            return buses[bus]

        with monkeypatch.context() as patch:
            patch.setattr(sim_bus, "bus_from_robot", made)
            self.result = perform(
                self.planner.program,
                self.robot,
                is_virtual=True,
                has_feedback=has_feedback,
                observer=Observer(controls=self),
                is_open=True,
            )
        self.bus = buses["main"]
        self.report, self.truth = self.result.report, self.result.truth

    def filenos(self):
        return []

    def act(self, player, now_ns):
        if player.phase is Phase.SHOW and player.show is not None:
            show_s = player.show.show_s(now_ns)
            while self.script and show_s >= self.script[0][0]:
                self.acted_ns.append(now_ns)
                self.script.pop(0)[1](self, player, now_ns)
            if not self.script and player.show.is_open:
                self.pilot.commanded = STILL
                if self.pilot.is_standing(show_s - 0.5):
                    player.close()
        self.pilot.act(player, now_ns)

    @property
    def stand_deg(self):
        return np.array([self.planner.program.start_deg[name] for name in self.truth.joints])

    def feet_mm(self):
        """Return where the feet were in the body, (n, legs, 3)."""
        columns = [[self.truth.joints.index(name) for name in leg.joints] for leg in self.gait.legs]
        return np.stack(
            [
                forward(leg, self.truth.horn_deg[:, own])
                for leg, own in zip(self.gait.legs, columns, strict=True)
            ],
            axis=1,
        )

    def assert_within_limits(self):
        horn_deg = self.truth.horn_deg
        speed = np.abs(np.diff(horn_deg, axis=0)).max(axis=0) / 0.01
        accel = np.abs(np.diff(horn_deg[::2], 2, axis=0)).max(axis=0) / 0.02**2
        for column, name in enumerate(self.truth.joints):
            joint = self.robot.joints[name]
            assert horn_deg[:, column].min() > joint.position_min_deg - 0.5
            assert horn_deg[:, column].max() < joint.position_max_deg + 0.5
            assert speed[column] < 1.05 * joint.speed_max_deg_s
            assert accel[column] < 1.3 * joint.accel_max_deg_s2

    def assert_stands(self):
        assert np.abs(self.truth.horn_deg[-1] - self.stand_deg).max() < STAND_DEG


def wish(twist):
    def do(walk, player, now_ns):
        walk.pilot.commanded = twist

    return do


def stop(walk, player, now_ns):
    player.stop(now_ns)


def at_random(top, count, *, seed):
    random, at_s, script = np.random.default_rng(seed), 1.0, []
    for _ in range(count):
        ahead, left, turn = random.uniform(-1.0, 1.0, 3).tolist()
        script.append(
            (
                at_s,
                wish(
                    Twist(
                        forward_mm_s=ahead * top.forward_mm_s,
                        left_mm_s=left * top.left_mm_s,
                        turn_deg_s=turn * top.turn_deg_s,
                    )
                ),
            )
        )
        at_s += random.uniform(0.3, 1.2)
    return [*script, (at_s, wish(STILL))]


@pytest.mark.parametrize("name", TOP)
def test_whatever_is_steered_breaks_no_limit_and_ends_in_the_stand(monkeypatch, name):
    takes = np.random.default_rng(9)
    script = at_random(TOP[name], 6, seed=4)
    walk = WalkedRobot(
        monkeypatch,
        name,
        script,
        takes_s=lambda: float(takes.uniform(0.05, 0.4)),
        has_feedback=name == "hexapod_walk",
    )
    assert walk.report.outcome == "finished"
    assert walk.report.timing.missed == 0
    assert walk.pilot.taken >= 4
    assert walk.pilot.late == 0
    walk.assert_within_limits()
    walk.assert_stands()
    moved = np.ptp(walk.feet_mm(), axis=0)
    assert moved[:, :2].max(axis=1).min() > 10.0, "every foot steps"
    assert moved[:, 2].min() > 0.8 * walk.gait.step_height_mm


def test_a_plan_that_comes_too_late_lets_the_robot_stand_by_itself_and_walk_again(monkeypatch):
    taken = []

    def takes_s():
        taken.append(None)
        return 6.0 if len(taken) == 3 else 0.2

    ahead = wish(Twist(forward_mm_s=30.0))
    script = [(1.0, ahead), (15.0, wish(STILL))]
    walk = WalkedRobot(monkeypatch, "quadruped_trot", script, takes_s=takes_s)
    assert walk.report.outcome == "finished"
    assert walk.pilot.late == 1
    assert walk.pilot.taken > 3, "it has walked again"
    walk.assert_within_limits()
    walk.assert_stands()
    # While the late plan was made it reached its stand, and stood: never in the middle of a step.
    off_deg = np.abs(walk.truth.horn_deg - walk.stand_deg).max(axis=1)
    walks = np.flatnonzero(off_deg > STAND_DEG)
    assert walks[0] < 500, "it began to walk within five seconds"
    assert np.diff(walks).max() > 100, "it stood for at least a second"


def test_one_interruption_walks_to_the_stand_and_holds(monkeypatch):
    ahead = wish(Twist(forward_mm_s=25.0))
    walk = WalkedRobot(monkeypatch, "quadruped_trot", [(1.0, ahead), (4.0, stop)])
    assert walk.report.outcome == "stopped"
    assert walk.report.played_s > 5.0
    walk.assert_within_limits()
    walk.assert_stands()
    assert walk.bus.lines[-1][1] == b"#254H\r"


def test_a_second_interruption_holds_at_once(monkeypatch):
    ahead = wish(Twist(forward_mm_s=25.0))
    walk = WalkedRobot(monkeypatch, "quadruped_trot", [(1.0, ahead), (4.0, stop), (4.3, stop)])
    assert walk.report.outcome == "stopped"
    assert walk.bus.lines[-1][1] == b"#254H\r"
    assert walk.bus.lines[-1][0] - walk.acted_ns[-1] < 20_000_000
    assert np.abs(walk.truth.horn_deg[-1] - walk.stand_deg).max() > 1.0, "in the middle of a step"


def test_it_sits_down_from_its_stand_and_does_not_walk_while_it_sits(monkeypatch):
    def sit(walk, player, now_ns):
        walk.pilot.commanded, walk.pilot.commanded_pose = STILL, walk.gait.sit

    walk = WalkedRobot(
        monkeypatch,
        "hexapod_walk",
        [(1.0, wish(Twist(forward_mm_s=25.0))), (2.5, sit), (9.0, wish(STILL))],
    )
    assert walk.gait.sit is not None
    walk.assert_within_limits()
    low_mm = -walk.gait.height_mm - walk.gait.sit.shift_mm[2]
    np.testing.assert_allclose(walk.feet_mm()[-1, :, 2], low_mm, atol=1.0)
