from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.show.gait.curves import spline
from lss_motion.show.gait.kinematics import forward
from lss_motion.show.gait.model import PATTERNS, BodyMove, BodyPose, Wave
from lss_motion.show.gait.pacing import ACCEL_SHARE, FOOT_ERROR_MM, joints_of, paced

ALL = [*PATTERNS[6], *PATTERNS[4]]
STATIC = [name for known in PATTERNS.values() for name, own in known.items() if own.is_static]


def limits(gait, robot):
    joints = [robot.joints[name] for name in joints_of(gait)]
    return np.array([(joint.speed_max_deg_s, joint.accel_max_deg_s2) for joint in joints]).T


@pytest.mark.parametrize("pattern", ALL)
def test_every_pattern_keeps_feet_on_their_paths_within_all_limits(kit, pattern):
    gait = kit.gait(pattern, kit.walk(40.0, turn_deg_s=8.0, cycles=2), cycle_s=1.0)
    robot = kit.robot(gait)
    (part,) = paced(gait, robot)
    at_s = np.linspace(0.0, part.times_s[-1], 2 * len(part.times_s) - 1)
    curve = spline(float(part.times_s[1]), part.angles_deg)
    angles = np.empty((len(at_s), part.angles_deg.shape[1]))
    angles[0::2], angles[1::2] = part.angles_deg, curve.middles()
    feet = part.passage.at(at_s).feet_in_body()
    for index, leg in enumerate(gait.legs):
        own = forward(leg, angles[:, 3 * index : 3 * index + 3])
        assert np.linalg.norm(own - feet[:, index], axis=1).max() <= FOOT_ERROR_MM + 1e-9
    speed, accel = curve.peaks()
    speed_max, accel_max = limits(gait, robot)
    assert (speed / part.pace_ratio <= speed_max * 1.000001).all()
    assert (accel / part.pace_ratio**2 <= ACCEL_SHARE * accel_max * 1.000001).all()
    assert part.angles_deg[0].tolist() == part.angles_deg[-1].tolist()


@pytest.mark.parametrize("pattern", ALL)
def test_every_leg_steps_and_as_many_feet_stand_as_the_pattern_requires(kit, pattern):
    gait = kit.gait(pattern, kit.walk(40.0, cycles=3))
    (part,) = paced(gait, kit.robot(gait))
    at_s = np.linspace(0.0, part.times_s[-1], 4001)
    stance = part.passage.at(at_s)
    assert (~stance.is_down).any(axis=0).all()
    np.testing.assert_allclose(stance.feet_mm[..., 2].max(axis=0), gait.step_height_mm, atol=0.1)
    least = stance.is_down.sum(axis=1).min()
    assert least == {"tripod": 3, "ripple": 4, "amble": 4, "wave": 5, "crawl": 3, "walk": 3}.get(
        pattern, 2
    )


@pytest.mark.parametrize("pattern", STATIC)
def test_static_patterns_keep_the_body_inside_of_their_feet_at_every_instant(kit, pattern):
    gait = kit.gait(pattern, kit.walk(20.0, 10.0), kit.walk(turn_deg_s=8.0))
    (part,) = paced(gait, kit.robot(gait))
    margin = part.passage.at(np.linspace(0.0, part.times_s[-1], 5001)).margin_mm()
    assert margin.min() >= part.margin_min_mm - 1e-6
    assert part.margin_min_mm > 5.0


def test_a_crawl_without_sway_is_refused_with_its_line(kit):
    gait = kit.gait("crawl", kit.walk(20.0, line=12), sway_mm=0.0)
    with pytest.raises(PlanningError, match=r"quadruped_trot.yaml:12: .*crawl.* would fall") as no:
        paced(gait, kit.robot(gait))
    assert "sway_mm" in str(no.value)


def test_a_dynamic_pattern_can_have_a_negative_margin(kit):
    gait = kit.gait("trot", kit.walk(20.0))
    (part,) = paced(gait, kit.robot(gait))
    assert -20.0 < part.margin_min_mm < 0.0


def test_a_pose_that_would_fall_is_refused(kit):
    tumble = BodyMove(pose=BodyPose(shift_mm=(0.0, 65.0, 0.0)), in_s=2.0, line=3)
    narrow = tuple(replace(leg, stance_mm=20.0) for leg in kit.gait("trot").legs)
    gait = kit.gait("trot", tumble, legs=narrow, height_mm=120.0)
    with pytest.raises(
        PlanningError, match=r":3: this pose would fall: 2\.00 s .* 7\.5 mm outside"
    ):
        paced(gait, kit.robot(gait))


def test_a_fast_passage_is_slowed_as_a_whole_and_feet_keep_their_paths(kit):
    slow = kit.gait("tripod", kit.walk(40.0, cycles=2), cycle_s=3.0)
    quick = replace(slow, actions=(kit.walk(240.0, cycles=2),), cycle_s=0.5)
    robot = kit.robot(slow)
    (calm,), (hasty,) = paced(slow, robot), paced(quick, robot)
    assert calm.pace_ratio == 1.0
    assert hasty.pace_ratio > 2.0
    assert hasty.limit == "acceleration"
    np.testing.assert_allclose(hasty.angles_deg, calm.angles_deg, atol=2e-5)
    assert hasty.duration_s == pytest.approx(hasty.times_s[-1] * hasty.pace_ratio)
    _, accel = spline(hasty.times_s[1] * hasty.pace_ratio, hasty.angles_deg).peaks()
    column = joints_of(quick).index(hasty.joint)
    assert accel[column] == pytest.approx(ACCEL_SHARE * limits(quick, robot)[1][column])


def test_the_slowest_servo_limits_the_pace(kit):
    gait = kit.gait("tripod", kit.walk(40.0))
    robot = kit.robot(gait)
    tired = replace(robot.joints["right_rear_tibia"], speed_max_deg_s=3.0)
    robot = replace(robot, joints={**robot.joints, "right_rear_tibia": tired})
    (part,) = paced(gait, robot)
    assert (part.joint, part.limit) == ("right_rear_tibia", "speed")


def test_legs_out_of_reach_and_joints_out_of_range_name_the_line(kit):
    stretched = kit.gait("tripod", kit.walk(20.0, line=7), kit.walk(400.0, line=8))
    with pytest.raises(InputError, match=r"leg '.*' cannot reach .* too far out") as caught:
        paced(stretched, kit.robot(stretched))
    assert caught.value.line == 8
    low = kit.gait("tripod", BodyMove(pose=BodyPose(shift_mm=(0, 0, 92)), in_s=1.0, line=9))
    with pytest.raises(InputError, match="outside its range") as caught:
        paced(low, kit.robot(low))
    assert (caught.value.line, caught.value.path) == (9, low.path)


def test_passages_are_split_where_the_robot_rests(kit):
    nod = BodyMove(pose=BodyPose(tilt_deg=(0, 5, 0)), in_s=0.5)
    held = replace(nod, hold_s=0.4)
    walk = kit.walk(20.0, cycles=1)
    gait = kit.gait("tripod", nod, held, nod, walk, walk, held)
    parts = paced(gait, kit.robot(gait))
    assert [len(part.actions) for part in parts] == [2, 1, 2, 1]
    assert [part.hold_s for part in parts] == [0.4, 0.0, 0.0, 0.4]
    for before, after in pairwise(parts):
        np.testing.assert_allclose(before.angles_deg[-1], after.angles_deg[0], atol=1e-9)


def test_the_pose_is_kept_while_walking(kit):
    lower = BodyMove(pose=BodyPose(shift_mm=(10.0, 0.0, -15.0), tilt_deg=(0, 3, 0)), in_s=1.0)
    gait = kit.gait("tripod", lower, kit.walk(30.0))
    stance = paced(gait, kit.robot(gait))[1].passage.at(np.array([0.0, 2.0, 4.0]))
    assert stance.shift_mm.tolist() == [[10.0, 0.0, gait.height_mm - 15.0]] * 3
    assert stance.tilt_deg.tolist() == [[0.0, 3.0, 0.0]] * 3


def test_swings_move_the_body_over_standing_feet_and_fade_at_rests(kit):
    side = Wave(pose=BodyPose(shift_mm=(0, 12, 0), tilt_deg=(-4, 0, 0)), every_s=1.5)
    beat = Wave(pose=BodyPose(shift_mm=(0, 3, -5)), every_s=0.75, start_ratio=0.25)
    rest = BodyMove(pose=BodyPose(), in_s=4.0)
    gait = kit.gait("tripod", rest, kit.walk(20.0, cycles=2), waves=(side, beat))
    plain = replace(gait, waves=())
    robot = kit.robot(gait)
    for part, bare in zip(paced(gait, robot), paced(plain, robot), strict=True):
        at_s = np.linspace(0.0, part.passage.duration_s, 400)
        stance, still = part.passage.at(at_s), bare.passage.at(at_s)
        np.testing.assert_array_equal(stance.feet_mm, still.feet_mm)
        off_mm, off_deg = stance.shift_mm - still.shift_mm, stance.tilt_deg - still.tilt_deg
        inside = (at_s > 1.0) & (at_s < part.passage.duration_s - 1.0)
        turn = 2.0 * np.pi * at_s[inside] / 1.5
        wanted = 12.0 * np.sin(turn) + 3.0 * np.cos(2.0 * turn)
        np.testing.assert_allclose(off_mm[inside, 1], wanted, atol=1e-9)
        np.testing.assert_allclose(off_deg[inside, 0], -4.0 * np.sin(turn), atol=1e-9)
        np.testing.assert_allclose(off_mm[[0, -1]], 0.0, atol=1e-9)
        ends = part.angles_deg[[0, -1]]
        np.testing.assert_allclose(ends, bare.angles_deg[[0, -1]], atol=1e-4)
