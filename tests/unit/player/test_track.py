"""Joints without a T: what the speed limit takes off a target is said again until it is reached."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from lss_motion.player.track import make_tracks
from lss_motion.program.model import Driving, Program
from lss_motion.robot.models import SERVO_MODELS

STEP_NS, PULSE_NS = 20_000_000, 20_000_000


def track_of(kit, joint):
    robot = kit.robot(joint)
    count = joint.filter_count if joint.drive == "streamed" else 0
    program = Program(
        name="still",
        robot=robot.name,
        moves=(),
        duration_s=1.0,
        start_deg={joint.name: 0.0},
        tolerance_deg=0.2,
        drives={joint.name: Driving(joint.drive, count)},
    )
    return make_tracks(program, robot, {joint.name: 0.0}, 0.0, has_feedback=True)[joint.name]


def told(track, target_deg):
    """Say a target, and whatever is owed after that; return `(heard_ns, degrees)` of each."""
    now_ns, said = STEP_NS, []
    while True:
        wire = track.wire_for(target_deg, now_ns)
        track.moved(now_ns, wire, None)
        said.append((now_ns, wire / 10))
        if track.owed is None:
            return said
        now_ns, target_deg = track.owed
        assert len(said) < 200, "it arrives some time"


@pytest.mark.parametrize("target_deg", [80.0, -80.0])
def test_a_streamed_joint_speeds_up_within_its_limits_and_arrives(kit, target_deg):
    joint = kit.joint("j0", 2, drive="streamed", speed_max_deg_s=180.0, accel_max_deg_s2=600.0)
    track = track_of(kit, joint)
    said = told(track, target_deg)
    assert said[-1][1] == target_deg
    assert len(said) > 20
    speeds = [track.profile.at(0.001 * ms)[1] for ms in range(20, 1500, 20)]
    assert max(map(abs, speeds)) == pytest.approx(180.0, abs=1.0)
    gained = [abs(b) - abs(a) for a, b in pairwise(speeds)]
    assert max(gained) <= 600.0 * 0.02 + 2 * 0.2 / 0.02 + 1.0
    assert track.profile.at(3.0) == (target_deg, 0.0)


def test_a_target_that_the_plan_would_ask_for_is_said_as_it_is(kit):
    track = track_of(kit, kit.joint("j0", 2, drive="streamed"))
    assert told(track, 2.0) == [(STEP_NS, 2.0)]


def test_a_stepped_joint_jumps_no_further_than_its_speed_allows(kit):
    joint = kit.joint("j0", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    track = track_of(kit, replace(joint, speed_max_deg_s=100.0))
    said = told(track, 37.0)
    assert said[-1][1] == 37.0
    values = [0.0, *(deg for _, deg in said)]
    jumps = [b - a for a, b in pairwise(values)]
    assert max(jumps) <= 1.0 + 100.0 * 0.02
    assert said[-1][0] - said[0][0] >= 0.8 * 37.0 / 150.0 * 1e9


def test_correction_and_range_hold_for_bare_targets_too(kit):
    joint = kit.joint("j0", 2, drive="streamed", position_max_deg=20.0)
    track = track_of(kit, joint)
    track.following.offset_deg = 1.5
    assert told(track, 10.0)[-1][1] == 11.5
    assert told(track, 20.0)[-1][1] == 20.0


def test_an_aim_is_reached_in_the_time_that_it_has(kit):
    track = track_of(kit, kit.joint("j0", 2, drive="streamed"))
    target_deg = track.chased(1.0, STEP_NS, 0.04)
    track.moved(STEP_NS, round(10 * target_deg), None)
    step = track.profile.acts_on(STEP_NS / 1e9)
    assert track.profile.value(step + 1) == pytest.approx(1.0, abs=0.05)
