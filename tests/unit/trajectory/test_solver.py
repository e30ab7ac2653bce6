"""The rates along a path: limits hold everywhere. Issue numbers are those of toppra."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Sequence, Timing
from tests.unit.trajectory.shows import show, trapezoid_s


def test_many_turns_and_limits_a_hundredfold_apart_are_planned(make_robot, frame):
    robot = make_robot(reach=3600.0, elbow=(1.8, 6.0))
    frames = [frame(0.0, base=-3600.0, elbow=0.0), frame(9.0, base=3600.0, elbow=5.0)]
    trajectory = plan(show(*frames), robot)
    assert trajectory.duration_s == pytest.approx(trapezoid_s(7200.0), rel=0.005)
    assert trajectory.sample(np.array([trajectory.duration_s]))[0] == pytest.approx([3600.0, 5.0])


def test_a_hump_inside_of_one_cell_is_repaired(make_robot, frame):
    """Found by the property tests: a joint accelerates within a fraction of a grid cell."""
    robot = make_robot(4, speed=4.0, accel=20.0, reach=3600.0, j3=(14.0, 1166.0))
    frames = [
        frame(0.0, base=0.0, elbow=0.0, j2=5.0, j3=116.875),
        frame(0.0, base=0.01),
        frame(0.0, base=0.0, elbow=0.0, j2=0.0, j3=116.875),
        frame(0.0, base=0.0, elbow=0.0, j2=0.0, j3=7.5),
    ]
    assert verify(plan(show(*frames), robot), robot).speed_ratio <= 1.001


def test_ten_thousand_keyframes_are_planned(make_robot, frame):
    rng = np.random.default_rng(3)
    frames = [
        frame(0.25 * index, base=40.0 if index % 250 == 249 else float(deg), elbow=float(-deg))
        for index, deg in enumerate(rng.uniform(-3.0, 3.0, 10_000))
    ]
    trajectory = plan(show(*frames), make_robot())
    assert trajectory.duration_s >= 0.25 * 9_999
    assert len(trajectory.marks) == 10_000
    assert len(trajectory.stretched) >= 40


def fastest(frames):
    return Sequence(name="trap", keyframes=tuple(frames), timing=Timing.FASTEST)


def lively(frame, seed, count, joints):
    random = np.random.default_rng(seed)
    return [
        frame(**{name: float(deg) for name, deg in zip(joints, row, strict=True)})
        for row in random.uniform(-90.0, 90.0, (count, len(joints)))
    ]


def test_issue_150_acceleration_is_not_exceeded_between_grid_points(make_robot, frame):
    robot = make_robot()
    trajectory = plan(fastest(lively(frame, 1, 30, ("base", "elbow"))), robot)
    times_s = np.linspace(0.0, trajectory.duration_s, 200_000)
    accel = np.abs(trajectory.sample(times_s, 2)).max()
    assert 0.99 * 600.0 < accel <= 1.001 * 600.0


def test_issue_22_speed_is_not_exceeded_at_keyframes(make_robot, frame):
    frames = [frame(base=float(deg)) for deg in range(-160, 161, 20)]
    robot = make_robot()
    trajectory = plan(fastest(frames), robot)
    passed_s = np.array([mark.planned_s for mark in trajectory.marks])
    around_s = np.concatenate([passed_s + shift for shift in (-1e-6, 0.0, 1e-6)])
    speed = np.abs(trajectory.sample(around_s, 1)).max()
    assert 0.99 * 180.0 < speed <= 1.001 * 180.0


@pytest.mark.parametrize("seed", range(3))
def test_issue_56_limits_hold_for_seven_joints_of_different_strength(make_robot, frame, seed):
    names = ("base", "elbow", *(f"j{n}" for n in range(2, 7)))
    strength = {name: (20.0 * (n + 1), 900.0 / (n + 1)) for n, name in enumerate(names)}
    robot = make_robot(7, **strength)
    found = verify(plan(fastest(lively(frame, seed, 25, names)), robot), robot)
    assert 0.99 < max(found.speed_ratio, found.accel_ratio) <= 1.001


def test_issue_17_keyframes_that_are_almost_the_same_give_no_nan(make_robot, frame):
    frames = [frame(base=deg) for deg in (0.0, 1e-12, 40.0, 40.0 + 1e-10, 40.0 - 1e-10, 0.0)]
    robot = make_robot()
    trajectory = plan(fastest(frames), robot)
    assert np.isfinite(trajectory.sample(np.linspace(0.0, trajectory.duration_s, 999))).all()
    assert 1.0 < trajectory.duration_s < 1.1


def test_issue_16_times_that_are_almost_the_same_do_not_crash(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, elbow=0.0),
        frame(1.0, base=30.0),
        frame(1.0 + 1e-10, elbow=30.0),
        frame(1.0 + 2e-7, base=30.0),
        frame(2.0, base=0.0, elbow=0.0),
    ]
    trajectory = plan(Sequence(name="trap", keyframes=tuple(frames)), make_robot())
    assert trajectory.duration_s == pytest.approx(2.0, abs=1e-6)


def test_issue_44_a_turning_point_is_passed_without_waiting(make_robot, frame):
    frames = [frame(base=0.0), frame(base=50.0), frame(base=0.0)]
    trajectory = plan(fastest(frames), make_robot())
    # At the turn it may brake and start again with full acceleration: no time is lost.
    assert trajectory.duration_s == pytest.approx(2.0 * 2.0 * (50.0 / 600.0) ** 0.5, rel=0.006)


def test_issue_25_a_duration_longer_than_needed_is_met(make_robot, frame):
    frames = (frame(base=0.0), frame(base=50.0), frame(base=20.0))
    longer = Sequence(name="trap", keyframes=frames, timing=Timing.FIT, fit_duration_s=7.0)
    assert plan(longer, make_robot()).duration_s == pytest.approx(7.0, abs=1e-6)
