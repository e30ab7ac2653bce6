from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.show.gait.kinematics import forward, neutral_mm
from lss_motion.show.gait.model import PATTERNS, BodyPose
from lss_motion.show.gait.steering import SteeredGait, slowed_to_limits
from lss_motion.show.gait.stepping import STILL, Twist

ALL = [*PATTERNS[6], *PATTERNS[4]]
STATIC = [name for known in PATTERNS.values() for name, own in known.items() if own.is_static]
TOP = {
    6: Twist(forward_mm_s=40.0, left_mm_s=30.0, turn_deg_s=12.0),
    4: Twist(forward_mm_s=25.0, left_mm_s=12.0, turn_deg_s=8.0),
}


def steering(kit, pattern="tripod", **fields):
    gait = kit.gait(pattern, **fields)
    robot = kit.robot(gait)
    gait, top = slowed_to_limits(gait, robot, TOP[len(gait.legs)])
    return SteeredGait(gait, robot, BodyPose()), top


def anyhow(random, top):
    ahead, left, turn = random.uniform(-1.0, 1.0, 3).tolist()
    return Twist(
        forward_mm_s=ahead * top.forward_mm_s,
        left_mm_s=left * top.left_mm_s,
        turn_deg_s=turn * top.turn_deg_s,
    )


def feet_of(steered, angles_deg):
    parts = np.split(angles_deg, len(steered.gait.legs), axis=1)
    return np.stack(
        [forward(leg, own) for leg, own in zip(steered.gait.legs, parts, strict=True)], axis=1
    )


@pytest.mark.parametrize("pattern", ALL)
def test_every_plan_continues_the_last_one_and_ends_in_a_stand(kit, pattern):
    random = np.random.default_rng(3)
    own, top = steering(kit, pattern)
    walker, before = own.standing(), None
    neutral = [[*neutral_mm(leg), -own.gait.height_mm] for leg in own.gait.legs]
    moved = 0
    for _ in range(8):
        plan = own.plan_towards(walker, anyhow(random, top))
        if before is not None:
            at = np.flatnonzero(np.abs(before.times_s - plan.from_s) < 1e-9)[0]
            now = np.flatnonzero(np.abs(plan.times_s - plan.from_s) < 1e-9)[0]
            assert plan.from_s == pytest.approx(before.next_s)
            for rows in ("angles_deg", "slopes_deg_s"):
                old, new = getattr(before, rows), getattr(plan, rows)
                np.testing.assert_array_equal(old[at], new[now])
        np.testing.assert_allclose(feet_of(own, plan.angles_deg[-1:])[0], neutral, atol=1e-4)
        assert not plan.slopes_deg_s[-1].any()
        if own.gait.pattern.is_static:
            assert plan.margin_min_mm >= 0.0
        moved += plan.twist != STILL
        walker, before = plan.following, plan
    assert moved >= 6
    for _ in range(3 * own.stepper.phases):
        walker = own.plan_towards(walker, STILL).following
    assert own.is_standing(walker)


@pytest.mark.parametrize("pattern", ["tripod", "wave", "trot", "crawl"])
def test_steered_joints_keep_their_limits_across_plans(kit, pattern):
    """Judged by differences of the path that is walked: each plan up to its next boundary."""
    random = np.random.default_rng(5)
    own, top = steering(kit, pattern)
    walker, walked = own.standing(), []
    for _ in range(12):
        plan = own.plan_towards(walker, anyhow(random, top))
        kept = (plan.times_s >= plan.from_s - 1e-9) & (plan.times_s < plan.next_s - 1e-9)
        walked.append(plan.angles_deg[kept])
        step_s = float(plan.times_s[-1] - plan.times_s[-2])
        walker = plan.following
    angles = np.concatenate(walked)
    joints = [own.robot.joints[name] for leg in own.gait.legs for name in leg.joints]
    speed = np.abs(np.diff(angles, axis=0)).max(axis=0) / step_s
    accel = np.abs(np.diff(angles, 2, axis=0)).max(axis=0) / step_s**2
    assert (speed <= [joint.speed_max_deg_s for joint in joints]).all()
    assert (accel <= [joint.accel_max_deg_s2 for joint in joints]).all()
    assert accel.max() > 50.0, "nothing moved"


def test_standing_feet_do_not_slip_when_the_velocity_changes(kit):
    """The body moves rigidly over feet that stand: distances between them do not change."""
    random = np.random.default_rng(1)
    own, top = steering(kit, "tripod")
    walker = own.standing()
    for _ in range(6):
        plan = own.plan_towards(walker, anyhow(random, top))
        inside = (plan.times_s > plan.from_s) & (plan.times_s < plan.next_s)
        feet = feet_of(own, plan.angles_deg[inside])
        down = np.flatnonzero(feet[:, :, 2].max(axis=0) < -own.gait.height_mm + 0.01)
        assert len(down) == 3
        apart = np.linalg.norm(feet[:, down] - feet[:, np.roll(down, 1)], axis=2)
        assert np.ptp(apart, axis=0).max() < 0.1
        walker = plan.following


def test_a_velocity_that_is_held_is_reached_exactly(kit):
    own, top = steering(kit, "tripod")
    ahead = Twist(forward_mm_s=0.5 * top.forward_mm_s)
    walker = own.standing()
    for _ in range(4):
        walker = own.plan_towards(walker, ahead).following
    begun = walker.place
    for _ in range(4):
        walker = own.plan_towards(walker, ahead).following
    gone = walker.place - begun
    assert gone[0] == pytest.approx(ahead.forward_mm_s * 4 * own.stepper.phase_s, abs=1e-3)
    np.testing.assert_allclose(gone[1:], 0.0, atol=1e-9)


def test_a_change_beyond_the_limits_is_made_in_part(kit):
    own, top = steering(kit, "tripod")
    wild = Twist(forward_mm_s=40.0 * top.forward_mm_s)
    with pytest.raises((InputError, PlanningError)):
        own.plan(own.standing(), wild)
    plan = own.plan_towards(own.standing(), wild)
    assert STILL.forward_mm_s <= plan.twist.forward_mm_s < wild.forward_mm_s


def test_a_boundary_can_be_skipped_for_more_planning_time(kit):
    own, _ = steering(kit, "tripod")
    ahead = Twist(forward_mm_s=20.0)
    once, twice = (own.plan_towards(own.standing(), ahead, hold) for hold in (1, 2))
    assert once.next_s == pytest.approx(own.stepper.phase_s)
    assert twice.next_s == pytest.approx(2.0 * own.stepper.phase_s)
    shared = (once.times_s <= once.next_s + 1e-9).sum()
    np.testing.assert_allclose(once.angles_deg[:shared], twice.angles_deg[:shared], atol=1e-6)


def test_a_gait_that_is_too_fast_is_slowed_as_a_whole(kit):
    gait = kit.gait("tripod", cycle_s=0.5)
    quick = Twist(forward_mm_s=150.0)
    slower, top = slowed_to_limits(gait, kit.robot(gait), quick)
    assert slower.cycle_s > 1.2 * gait.cycle_s
    assert top.forward_mm_s * slower.cycle_s == pytest.approx(quick.forward_mm_s * gait.cycle_s)


def test_a_joint_with_little_range_limits_the_velocity(kit):
    own, _ = steering(kit, "tripod")
    name = own.gait.legs[0].joints[0]
    joint = own.robot.joints[name]
    stiff = replace(joint, position_min_deg=-0.5, position_max_deg=0.5)
    robot = replace(own.robot, joints={**own.robot.joints, name: stiff})
    bound = SteeredGait(own.gait, robot, BodyPose())
    assert bound.plan_towards(bound.standing(), Twist(forward_mm_s=40.0)).twist.forward_mm_s < 10.0


def test_a_plan_that_is_too_fast_for_a_servo_is_refused_with_its_joint(kit):
    gait = kit.gait("tripod", cycle_s=0.5)
    hasty = SteeredGait(gait, kit.robot(gait), BodyPose())
    with pytest.raises(PlanningError, match=r"joint '.*' would need .* deg/s², allowed 900") as no:
        hasty.plan(hasty.standing(), Twist(forward_mm_s=60.0))
    assert no.value.joint in hasty.joints
