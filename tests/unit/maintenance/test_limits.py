"""Limits that a robot file leaves to its servos: queried, from a backup, refused when unknown."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import BusError, InputError
from lss_motion.maintenance.settings import ServoBackup, robot_from_backup
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.connection import ask_limits, connect
from lss_motion.playing.discovery import limit_questions, robot_from_answers
from lss_motion.playing.player.handshake import Item
from lss_motion.protocol.framing import Command
from lss_motion.robot.load import load_robot
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.system.clock import VirtualClock

ROBOT = """
robot: two
defaults: {range_deg: [-90, 90], speed_max_deg_s: servo, accel_max_deg_s2: servo}
joints:
  arm:  {id: 5, model: LSS-ST1, response: {ramp_ratio: 0.5}}
  hand: {id: 6, model: LSS-P-S1, accel_max_deg_s2: 200}
  eye:  {id: 7, model: LSS-ST1, speed_max_deg_s: 60, accel_max_deg_s2: 300}
"""
SHOW = Sequence(
    name="there",
    keyframes=(
        Keyframe(deg={"arm": 0.0, "hand": 0.0, "eye": 0.0}, at_s=0.0),
        Keyframe(deg={"arm": 60.0, "hand": 60.0, "eye": 60.0}, at_s=0.1),
    ),
)


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return load_robot(path)


@pytest.fixture
def asked(robot):
    """Return a function that sets simulated servos, then queries their limits."""

    def ask(*settings):
        with connect(robot.buses, robot=robot, clock=VirtualClock()) as connection:
            connection.ask(Item(bus="main", command=Command(*setting)) for setting in settings)
            connection.wait(0.02)
            return robot_from_answers(robot, connection.ask(limit_questions(robot)))

    return ask


def limits(robot):
    return {
        joint.name: (joint.speed_max_deg_s, joint.accel_max_deg_s2)
        for joint in robot.joints.values()
    }


def test_limits_are_the_servo_settings_and_the_smaller_ramp(asked):
    known = asked((5, "SD", 1200), (5, "AA", 40), (5, "AD", 30), (6, "SD", 4500), (7, "SD", 10))
    assert limits(known) == {"arm": (120.0, 150.0), "hand": (45.0, 200.0), "eye": (60.0, 300.0)}
    assert not known.unread
    assert known.read_limits == {
        "arm": {"speed_max_deg_s": 120.0, "accel_max_deg_s2": 150.0},
        "hand": {"speed_max_deg_s": 45.0},
    }


def test_the_plan_stays_within_the_limits(asked):
    known = asked((5, "SD", 300), (5, "AA", 20), (5, "AD", 100))
    trajectory = plan(SHOW, known)
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    arm = trajectory.joints.index("arm")
    assert np.abs(trajectory.sample(times_s, 1)[:, arm]).max() == pytest.approx(30.0, rel=0.01)
    assert np.abs(trajectory.sample(times_s, 2)[:, arm]).max() <= 100.1


def test_no_limit_exceeds_that_of_the_servo_model(asked):
    assert limits(asked((5, "SD", 9000)))["arm"][0] == 360.0


def test_a_plan_without_limits_is_refused_with_a_remedy(robot):
    with pytest.raises(InputError, match=r"'arm'.*accel_max_deg_s2 and speed_max.*--robot-cache"):
        plan(SHOW, robot)


def test_a_simulated_robot_is_queried_as_a_real_one(robot):
    assert not ask_limits(robot).unread


def test_a_servo_that_does_not_answer_is_named(robot):
    said = {("main", 5, "QSD"): 1200, ("main", 5, "QAA"): 40, ("main", 5, "QAD"): 40}
    with pytest.raises(BusError, match=r"hand \(id 6 on bus 'main'\)") as caught:
        robot_from_answers(robot, said)
    assert "arm" not in str(caught.value)
    half = {**said, ("main", 6, "QSD"): 450}
    del half["main", 5, "QAD"]
    with pytest.raises(BusError, match=r"arm \(id 5"):
        robot_from_answers(robot, half)


def test_a_limit_of_0_is_refused(robot):
    said = {("main", 5, "QSD"): 0, ("main", 5, "QAA"): 40, ("main", 5, "QAD"): 40}
    with pytest.raises(InputError, match="SD is 0; configure it, or give a number"):
        robot_from_answers(robot, said)


def test_a_backup_serves_in_place_of_the_servos(robot, tmp_path):
    path = tmp_path / "backup.yaml"
    arm = ServoBackup(
        bus="main", servo_id=5, model="LSS-ST1", settings={"SD": 900, "AA": 50, "AD": 60}
    )
    hand = ServoBackup(bus="main", servo_id=6, model="LSS-P-S1", settings={"SD": 3000})
    known = robot_from_backup(robot, [arm, hand], path)
    assert limits(known) == {"arm": (90.0, 250.0), "hand": (30.0, 200.0), "eye": (60.0, 300.0)}
    with pytest.raises(InputError, match=r"holds no SD of servo 6.*'hand'.*make a new backup"):
        robot_from_backup(robot, [arm], path)
