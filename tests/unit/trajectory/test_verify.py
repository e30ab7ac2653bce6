from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lss_motion.errors import PlanningError
from lss_motion.sequence.model import Sequence, Timing
from lss_motion.trajectory.clock import Clock
from lss_motion.trajectory.model import Motion, Trajectory
from lss_motion.trajectory.path import Path
from lss_motion.trajectory.planner import plan
from lss_motion.trajectory.verify import verify


def trajectory_of(knots_s, cubics, *, joint="base", **more):
    """One joint along a path that is followed at rate 1; `cubics` in rising powers."""
    path = Path(knots_s=np.array(knots_s), coefficients=np.array(cubics, dtype=float)[:, :, None])
    clock = Clock(
        times_s=np.array([0.0, knots_s[-1]]),
        path_s=np.array([0.0, knots_s[-1]]),
        rates=np.ones(1),
        rate_slopes=np.zeros(1),
    )
    motion = Motion(path=path, clock=clock)
    return Trajectory(
        name="made", joints=(joint,), first=motion, middle=motion, last=motion, **more
    )


def bump(deg, seconds):
    """Out and back: two smooth moves of `deg`, each in `seconds`."""
    there = [0.0, 0.0, 3.0 * deg / seconds**2, -2.0 * deg / seconds**3]
    back = [deg, 0.0, -3.0 * deg / seconds**2, 2.0 * deg / seconds**3]
    return [0.0, seconds, 2.0 * seconds], [there, back]


def test_the_shares_of_the_limits_are_those_of_the_curve(make_robot):
    found = verify(trajectory_of(*bump(60.0, 1.0)), make_robot())
    assert found.speed_ratio == pytest.approx(1.5 * 60.0 / 180.0, rel=1e-3)
    assert found.accel_ratio == pytest.approx(6.0 * 60.0 / 600.0, rel=2e-3)
    assert found.speed_joint == found.accel_joint == "base"
    assert found.samples >= 2000


def test_too_much_speed_is_refused_with_joint_time_and_limit(make_robot):
    with pytest.raises(
        PlanningError, match=r"'base' would reach speed .* allowed 180 deg/s"
    ) as caught:
        verify(trajectory_of(*bump(140.0, 1.1)), make_robot(accel=5000.0))
    assert caught.value.joint == "base"
    assert caught.value.time_s % 1.1 == pytest.approx(0.55, abs=0.01)


@pytest.mark.parametrize(("excess", "is_refused"), [(1.0005, False), (1.003, True)])
def test_a_thousandth_of_a_limit_is_the_most_that_passes(make_robot, excess, is_refused):
    trajectory = trajectory_of(*bump(60.0, 1.0))
    robot = make_robot(accel=360.0 / excess)
    if is_refused:
        with pytest.raises(PlanningError, match="acceleration"):
            verify(trajectory, robot)
    else:
        verify(trajectory, robot)


def test_a_step_of_speed_is_refused(make_robot):
    with pytest.raises(PlanningError, match="acceleration"):
        verify(trajectory_of([0.0, 1.0, 2.0], [[0, 0, 0, 0], [0, 5.0, -2.5, 0]]), make_robot())


def test_a_start_in_motion_is_refused(make_robot):
    with pytest.raises(PlanningError, match="acceleration"):
        verify(trajectory_of([0.0, 2.0], [[0.0, 10.0, -2.5, 0.0]]), make_robot())


def test_a_jump_of_angle_is_refused(make_robot):
    with pytest.raises(PlanningError):
        verify(trajectory_of([0.0, 1.0, 2.0], [[0, 0, 0, 0], [1.0, 0, 0, 0]]), make_robot())


def test_a_jump_between_passes_is_refused(make_robot):
    knots_s, cubics = bump(30.0, 1.0)
    with pytest.raises(PlanningError):
        verify(trajectory_of(knots_s[:2], cubics[:1], loop=2), make_robot())


def test_an_acceleration_shorter_than_a_sample_is_found_at_its_knot(make_robot):
    # 2000 deg/s² for 0.2 ms, then a legal way back to rest: too short for steps of 1 ms to see.
    up = 2000.0 * 0.0002
    cubics = [[0, 0, 1000.0, 0], [1000.0 * 0.0002**2, up, -up, 0]]
    with pytest.raises(PlanningError, match="acceleration"):
        verify(trajectory_of([0.0, 0.0002, 0.5002], cubics), make_robot())


def test_leaving_the_range_between_keys_is_refused(make_robot):
    with pytest.raises(PlanningError, match=r"'base' would be at .* allowed -170 to 170 deg"):
        verify(trajectory_of(*bump(170.1, 4.0)), make_robot())


def test_an_angle_that_is_no_number_is_refused(make_robot):
    with pytest.raises(PlanningError, match="nan"):
        verify(trajectory_of([0.0, 1.0], [[0.0, 0.0, float("nan"), 0.0]]), make_robot())


def test_a_plan_for_a_stronger_robot_is_refused_for_a_weaker_one(make_robot, frame):
    frames = (frame(base=0.0, elbow=0.0), frame(base=90.0, elbow=40.0))
    planned = plan(Sequence(name="s", keyframes=frames, timing=Timing.FASTEST), make_robot())
    with pytest.raises(PlanningError):
        verify(planned, make_robot(speed=178.0))
    with pytest.raises(PlanningError):
        verify(planned, make_robot(accel=595.0))


def test_a_plan_whose_clock_is_hurried_is_refused(make_robot, frame):
    frames = (frame(base=0.0), frame(base=90.0))
    planned = plan(Sequence(name="s", keyframes=frames, timing=Timing.FASTEST), make_robot())
    clock = planned.first.clock
    hurried = replace(
        planned.first,
        clock=replace(
            clock,
            times_s=clock.times_s / 1.01,
            rates=clock.rates * 1.01,
            rate_slopes=clock.rate_slopes * 1.01**2,
        ),
    )
    with pytest.raises(PlanningError):
        verify(replace(planned, first=hurried, middle=hurried, last=hurried), make_robot())
