"""Motion whose acceleration does not jump, judged by differences of the plan's angles at 1 kHz."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.summaries import plan_lines
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Layer, PlaylistStep, Sequence, Timing
from tests.unit.trajectory.shows import at, show

STEP_S = 0.001
JERK = 6000.0


def jerk_of(trajectory, until_s=None):
    """Return the largest jerk of each joint, from the angles alone, with rest before and after."""
    end_s = trajectory.duration_s if until_s is None else until_s
    times_s = STEP_S * np.arange(-10, math.ceil(end_s / STEP_S) + (10 if until_s is None else 0))
    return np.abs(np.diff(trajectory.sample(times_s), n=3, axis=0)).max(axis=0) / STEP_S**3


def with_jerk(robot, **limits):
    joints = {
        name: replace(joint, jerk_max_deg_s3=limits.get(name, math.inf))
        for name, joint in robot.joints.items()
    }
    return replace(robot, joints=joints)


@pytest.fixture
def nod(frame):
    """A show within the limits, with holds, a key that is passed and one where the joint turns."""
    return show(
        frame(0.0, base=0.0, elbow=0.0),
        frame(1.0, base=40.0, hold_s=0.5),
        frame(1.4, elbow=15.0),
        frame(2.5, base=-20.0, elbow=40.0),
        frame(4.0, base=10.0, elbow=5.0, hold_s=0.3),
        frame(5.5, base=0.0, elbow=0.0),
    )


def test_off_by_default_the_acceleration_jumps(nod, make_robot):
    trajectory = plan(nod, make_robot())
    assert trajectory.smoothing == ()
    assert jerk_of(trajectory).max() > 100_000.0


@pytest.mark.parametrize("smooth_s", [0.05, 0.1, 0.3])
def test_smooth_s_spreads_every_change_of_the_acceleration(nod, make_robot, smooth_s):
    robot = make_robot()
    trajectory = plan(replace(nod, smooth_s=smooth_s), robot)
    assert jerk_of(trajectory).max() <= 1.001 * 2.0 * 600.0 / smooth_s
    assert verify(trajectory, robot).jerk_ratio <= 1.001
    assert trajectory.duration_s == pytest.approx(5.5)


def test_keys_times_and_holds_stay_the_authors(nod, make_robot):
    trajectory = plan(replace(nod, smooth_s=0.1), make_robot())
    for frame in nod.keyframes:
        held_s = np.linspace(frame.at_s, frame.at_s + frame.hold_s, 20)
        for name, deg in frame.deg.items():
            assert at(trajectory, name, *held_s) == pytest.approx(deg, abs=0.002)
    assert max(abs(m.planned_s - m.authored_s) for m in trajectory.marks) < 1e-3
    assert trajectory.sample(np.linspace(0.0, 5.5, 5501)).max() <= 40.0 + 0.05


def test_a_joint_with_a_jerk_limit_keeps_it_and_the_others_are_hardly_changed(nod, make_robot):
    robot = with_jerk(make_robot(), base=JERK)
    trajectory = plan(nod, robot)
    base, elbow = jerk_of(trajectory)
    assert base <= 1.001 * JERK < elbow
    assert [own.jerk_max_deg_s3 for own in trajectory.smoothing] == [JERK, 0.0]
    plain = plan(nod, make_robot())
    times_s = np.linspace(0.0, 5.5, 551)
    assert np.abs(at(trajectory, "elbow", *times_s) - at(plain, "elbow", *times_s)).max() < 2.0


def test_a_motion_that_is_too_fast_is_slowed_and_still_has_no_jump(frame, make_robot):
    robot = make_robot()
    hasty = show(
        frame(0.0, base=0.0, elbow=10.0),
        frame(0.3, base=60.0, elbow=-30.0),
        frame(0.5, base=20.0),
        frame(0.8, base=-50.0, elbow=10.0),
        smooth_s=0.1,
    )
    trajectory = plan(hasty, robot)
    assert jerk_of(trajectory).max() <= 1.001 * 12_000.0
    found = verify(trajectory, robot)
    assert max(found.speed_ratio, found.accel_ratio) <= 1.001
    for mark, keyframe in zip(trajectory.marks, hasty.keyframes, strict=True):
        for name, deg in keyframe.deg.items():
            assert at(trajectory, name, mark.planned_s)[0] == pytest.approx(deg, abs=0.002)
    assert trajectory.duration_s > plan(replace(hasty, smooth_s=0.0), robot).duration_s


@pytest.mark.parametrize("deg", [2.0, 20.0, 85.0])
@pytest.mark.parametrize("timing", [Timing.FASTEST, Timing.AUTHORED])
def test_a_single_move_is_near_the_least_duration_of_ruckig(frame, make_robot, deg, timing):
    ruckig = pytest.importorskip("ruckig")
    times_s = (None, None) if timing is Timing.FASTEST else (0.0, 0.05)
    hasty = show(frame(times_s[0], base=0.0), frame(times_s[1], base=deg), timing=timing)
    trajectory = plan(hasty, with_jerk(make_robot(), base=JERK))
    wanted = ruckig.InputParameter(1)
    wanted.current_position, wanted.target_position = [0.0], [deg]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [180.0], [600.0], [JERK]
    least = ruckig.Trajectory(1)
    assert ruckig.Ruckig(1).calculate(wanted, least) == ruckig.Result.Working
    assert least.duration <= trajectory.duration_s <= 1.45 * least.duration


@pytest.mark.parametrize("loop", [2, 5, None])
def test_a_loop_in_motion_has_no_jump_at_its_seams(frame, make_robot, loop):
    orbit = show(
        frame(0.0, base=0.0, elbow=20.0),
        frame(0.7, base=20.0, elbow=0.0),
        frame(1.4, base=0.0, elbow=-20.0),
        frame(2.1, base=-20.0, elbow=0.0),
        frame(2.8, base=0.0, elbow=20.0),
        loop=loop,
        smooth_s=0.1,
    )
    trajectory = plan(orbit, make_robot())
    assert trajectory.is_periodic
    assert jerk_of(trajectory, None if loop else 11.2).max() <= 1.001 * 12_000.0
    seam_s = trajectory.first.duration_s
    assert abs(at(trajectory, "base", seam_s, order=1)[0]) > 5.0


def test_a_straight_line_stays_straight(frame, make_robot):
    robot = with_jerk(make_robot(), base=JERK)
    line = show(
        frame(0.0, base=0.0, elbow=0.0),
        frame(1.0, base=30.0, elbow=12.0, ease="linear"),
        frame(2.0, base=50.0, elbow=60.0, ease="linear"),
    )
    trajectory = plan(line, robot)
    base, elbow = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 999)).T
    first = elbow <= 12.0
    assert elbow[first] == pytest.approx(0.4 * base[first], abs=0.002)
    assert elbow[~first] == pytest.approx(12.0 + 2.4 * (base[~first] - 30.0), abs=0.005)


def test_a_range_holds_where_the_joint_turns(frame, make_robot):
    lid = show(frame(0.0, base=60.0), frame(0.4, base=0.0), frame(1.4, base=60.0), smooth_s=0.1)
    robot = make_robot()
    joint = replace(robot.joints["base"], position_min_deg=0.0)
    trajectory = plan(lid, replace(robot, joints={**robot.joints, "base": joint}))
    assert at(trajectory, "base", *np.linspace(0.0, 1.4, 1401)).min() >= -1e-6


def test_fit_takes_its_duration_or_is_refused(nod, make_robot):
    fitted = replace(nod, timing=Timing.FIT, fit_duration_s=4.0, smooth_s=0.1)
    assert plan(fitted, make_robot()).duration_s == pytest.approx(4.0, abs=1e-3)
    short = replace(fitted, fit_duration_s=2.6, smooth_s=0.3)
    plan(replace(short, smooth_s=0.0), make_robot())
    with pytest.raises(PlanningError, match="acceleration that does not jump"):
        plan(short, make_robot())


def test_an_anchor_that_only_smoothing_misses_names_it(frame, make_robot):
    tight = show(frame(0.0, base=0.0), frame(0.8, base=60.0, anchor=True))
    plan(tight, make_robot())
    with pytest.raises(PlanningError, match=r"because of smooth_s or jerk_max_deg_s3"):
        plan(replace(tight, smooth_s=0.3), make_robot())


def test_layers_are_summed_without_a_jump(nod, frame, make_robot):
    robot = make_robot()
    bob = show(frame(0.0, elbow=0.0), frame(0.6, elbow=6.0), frame(1.2, elbow=0.0), name="bob")
    layer = Layer(sequence=bob, joints=("elbow",), mode="add", from_s=1.0, fade_s=0.4, line=None)
    trajectory = plan(replace(nod, layers=(layer,), smooth_s=0.1), robot)
    assert jerk_of(trajectory).max() <= 1.001 * 12_000.0
    with_limit = plan(replace(nod, layers=(layer,)), with_jerk(robot, elbow=JERK))
    assert jerk_of(with_limit)[1] <= 1.001 * JERK


def test_the_moves_of_a_play_list_have_no_jump(nod, frame, make_robot):
    bow = show(frame(0.0, base=20.0, elbow=0.0), frame(1.0, base=30.0), name="bow", smooth_s=0.1)
    steps = (PlaylistStep(sequence=replace(nod, smooth_s=0.1)), PlaylistStep(sequence=bow))
    trajectory = plan(Sequence(name="list", play=steps), make_robot())
    assert jerk_of(trajectory).max() <= 1.001 * 12_000.0


def test_a_plan_from_the_cache_is_the_same_and_is_checked(nod, make_robot):
    robot = make_robot()
    first, again = (plan(replace(nod, smooth_s=0.1), robot) for _ in range(2))
    times_s = np.linspace(0.0, 5.5, 100)
    assert np.array_equal(first.sample(times_s), again.sample(times_s))
    assert first.smoothing == again.smoothing != ()


def test_the_verifier_refuses_a_jump(nod, make_robot):
    robot = make_robot()
    limits = plan(replace(nod, smooth_s=0.1), robot).smoothing
    rough = replace(plan(nod, robot), smoothing=limits)
    with pytest.raises(PlanningError, match=r"would reach jerk \d+"):
        verify(rough, robot)


def test_check_tells_what_it_costs(nod, make_robot):
    robot = make_robot()
    text = "\n".join(plan_lines(plan(replace(nod, smooth_s=0.1), robot), robot))
    assert "no jump of acceleration: 2 joints, no longer than without" in text
    assert "joint 'base', jerk at most 12000 deg/s³, averaged over 0.100 s" in text
    late = replace(nod, timing=Timing.FASTEST, smooth_s=0.1)
    assert "s longer than without" in "\n".join(plan_lines(plan(late, robot), robot))
