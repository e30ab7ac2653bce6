"""Loops whose seams are passed in motion: the motion runs ahead up to them, and is never early."""

from __future__ import annotations

import numpy as np
import pytest
from campaign.anchors import any_show, robot_of, scaled
from msgspec.structs import replace

from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Interpolation, Keyframe, Sequence

EARLY_S = 1e-6


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


def any_loop(seed: int) -> tuple:
    """Return a loop without anchors, often too fast for its robot, and the robot."""
    show, robot = any_show(seed)
    random = np.random.default_rng([seed, 3])
    start = {name: round(float(random.uniform(-40.0, 40.0)), 1) for name in robot.joints}
    frames = [replace(frame, is_anchor=False) for frame in show.keyframes]
    frames[0] = replace(frames[0], deg=start)
    ends_s = frames[-1].at_s + frames[-1].hold_s + float(random.uniform(0.3, 1.0))
    frames.append(Keyframe(at_s=ends_s, deg=start, ease=Interpolation.SMOOTH))
    frames = [
        frame if frame.ease is not Interpolation.SPLINE else replace(frame, ease="smooth")
        for frame in frames
    ]
    loop = int(random.integers(2, 5)) if random.random() < 0.7 else None
    show = replace(show, keyframes=tuple(frames), loop=loop)
    return scaled(show, float(random.choice([0.7, 0.85, 1.0]))), robot


@pytest.mark.parametrize("seed", range(24))
def test_no_key_of_a_loop_is_early_and_holds_keep_their_length(seed: int) -> None:
    show, robot = any_loop(seed)
    trajectory = plan(show, robot)
    verify(trajectory, robot)
    period_s = show.keyframes[-1].at_s
    for motion in (trajectory.first, trajectory.middle, trajectory.last):
        assert motion.duration_s >= period_s - EARLY_S
    for mark, frame in zip(trajectory.marks, show.keyframes, strict=True):
        assert mark.planned_s >= frame.at_s - EARLY_S
        assert mark.held_s >= frame.hold_s - EARLY_S


def test_a_key_between_two_slow_spans_is_not_early() -> None:
    robot = robot_of(np.random.default_rng(496), ("base",))
    robot = replace(
        robot,
        joints={
            "base": replace(robot.joints["base"], speed_max_deg_s=240.0, accel_max_deg_s2=400.0)
        },
    )
    times = (0.0, 0.284, 0.645, 0.95, 1.475, 2.514, 3.046)
    angles = (-35.0, 14.2, 10.7, 38.5, 40.2, 11.5, -35.0)
    for ease in (Interpolation.SPLINE, Interpolation.SMOOTH):
        frames = tuple(
            Keyframe(at_s=at_s, deg={"base": deg}, ease=ease)
            for at_s, deg in zip(times, angles, strict=True)
        )
        trajectory = plan(Sequence(name="two", keyframes=frames), robot)
        late_s = [mark.planned_s - mark.authored_s for mark in trajectory.marks]
        assert max(late_s) > 0.1
        assert min(late_s) >= -EARLY_S


LIMITS = {
    "base": (131.0, 840.0),
    "shoulder": (235.0, 280.0),
    "elbow": (190.0, 580.0),
    "wrist": (108.0, 790.0),
}
FAST = (
    (0.0, {"base": -3.2, "shoulder": -26.6, "elbow": -27.8, "wrist": -11.2}),
    (0.567565218, {"elbow": 23.5, "wrist": -24.9}),
    (1.623679466, {"base": -56.4, "elbow": 24.8, "wrist": -15.1}),
    (2.437920712, {"base": 26.7, "shoulder": -33.8, "elbow": 39.6}),
    (3.234048289, {"base": -3.2, "shoulder": -26.6, "elbow": -27.8, "wrist": -11.2}),
)


@pytest.mark.parametrize("loop", [3, None])
def test_a_loop_that_is_too_fast_at_its_seam_ends_its_passes_on_time(loop) -> None:
    robot = robot_of(np.random.default_rng(0), tuple(LIMITS))
    joints = {
        name: replace(robot.joints[name], speed_max_deg_s=speed, accel_max_deg_s2=accel)
        for name, (speed, accel) in LIMITS.items()
    }
    frames = tuple(Keyframe(at_s=at_s, deg=deg) for at_s, deg in FAST)
    show = Sequence(name="fast", keyframes=frames, loop=loop)
    robot = replace(robot, joints=joints)
    trajectory = plan(show, robot)
    assert trajectory.is_periodic
    verify(trajectory, robot)
    for motion in (trajectory.first, trajectory.middle, trajectory.last):
        assert motion.duration_s == pytest.approx(FAST[-1][0], abs=1e-3)
