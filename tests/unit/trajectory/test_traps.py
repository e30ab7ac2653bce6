"""The traps that others met in toppra, by their issue there, and that each is closed here."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.sequence.model import Sequence, Timing
from lss_motion.trajectory.planner import plan
from lss_motion.trajectory.verify import verify


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


def test_a_noisy_recording_does_not_swing_beyond_its_keys(make_robot, frame):
    random = np.random.default_rng(4)
    noisy = np.round(20.0 * np.sin(np.arange(300) / 20.0) + random.normal(0.0, 0.03, 300), 2)
    frames = [frame(0.05 * index, base=float(deg)) for index, deg in enumerate(noisy)]
    trajectory = plan(Sequence(name="trap", keyframes=tuple(frames)), make_robot())
    deg = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 20_000))[:, 0]
    assert noisy.min() - 1e-9 <= deg.min()
    assert deg.max() <= noisy.max() + 1e-9
    assert trajectory.duration_s == pytest.approx(0.05 * 299, abs=0.05)
