"""What `lss-motion check` says about a plan."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from lss_motion.cli.summaries import limit_uses, plan_lines
from lss_motion.robot.model import Bus, Robot
from lss_motion.sequence.model import Keyframe, Sequence, Timing
from lss_motion.trajectory.planner import plan
from tests.joints import joint


@pytest.fixture
def robot() -> Robot:
    joints = {
        name: joint(name, index, position_min_deg=-170.0, position_max_deg=170.0)
        for index, name in enumerate(("base", "elbow"))
    }
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="arm", path=None, buses={"main": bus}, joints=joints)


def show(*keys: tuple[float | None, float], **more) -> Sequence:
    frames = tuple(Keyframe(at_s=at_s, deg={"base": deg, "elbow": 0.0}) for at_s, deg in keys)
    return Sequence(name="show", keyframes=frames, **more)


def test_the_tightest_joint_and_its_margin_are_named(robot):
    # A Hermite cubic of 50 deg in 1 s: 75 deg/s in the middle, 300 deg/s² at its ends.
    lines = plan_lines(plan(show((0.0, 0.0), (1.0, 50.0)), robot), robot)
    assert (
        "tightest: joint 'base', acceleration 300 of 600 deg/s² at 0.000 s, 50% to spare" in lines
    )
    assert any("could run 1.41 times as fast, a pass in 0.709 s" in line for line in lines)


def test_what_is_said_about_speed_is_true(robot):
    sequence = show((0.0, 0.0), (1.0, 50.0), (2.5, -40.0))
    use = min(limit_uses(plan(sequence, robot), robot), key=lambda use: use.faster_ratio)
    ratio = math.floor(100.0 * use.faster_ratio) / 100.0
    assert not plan(replace(sequence, speed_ratio=ratio), robot).stretched
    assert plan(replace(sequence, speed_ratio=1.02 * ratio), robot).stretched


def test_a_show_at_its_limits_says_so(robot):
    lines = plan_lines(plan(show((None, 0.0), (None, 90.0), timing=Timing.FASTEST), robot), robot)
    assert lines[-1] == "the show runs as fast as it can; faster would slow more of it down"
    assert "0% to spare" in lines[-2]


def test_a_stretched_span_is_told_with_what_was_asked_and_allowed(robot):
    lines = plan_lines(plan(show((0.0, 0.0), (0.2, 100.0), (4.0, 0.0)), robot), robot)
    (slower,) = [line for line in lines if line.startswith("slower")]
    assert "joint 'base' would need acceleration 15" in slower
    assert slower.endswith("allowed 600 deg/s²")


def test_a_show_in_which_nothing_moves_says_so(robot):
    assert plan_lines(plan(show((0.0, 0.0), (1.0, 0.0)), robot), robot)[-1] == "nothing moves"


def test_the_pass_after_the_first_counts_too(robot):
    # The seam is passed at full speed, which only the second pass shows from its start.
    sequence = show((0.0, 0.0), (1.0, 40.0), (3.0, -40.0), (4.0, 0.0), loop=3)
    uses = {use.joint.name: use for use in limit_uses(plan(sequence, robot), robot)}
    assert uses["base"].accel_deg_s2 > 200.0
    assert uses["elbow"].speed_deg_s == 0.0
