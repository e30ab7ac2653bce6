"""Jerk limits in shows that are too fast: rests at both ends, and keys at the end of a range."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lss_motion.planning.summaries import plan_lines
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.robot.model import Bus, Robot
from lss_motion.show.model import Keyframe, Sequence, Timing
from tests.joints import joint

LIMITED = {
    "j2": (-142.241, 73.613, 600.0, 700.0, math.inf),
    "j4": (-163.904, 39.774, 360.0, 1000.0, 8000.0),
    "j7": (-82.119, 62.649, 360.0, 1000.0, math.inf),
}


def arm(limits) -> Robot:
    joints = {
        name: joint(
            name,
            index,
            position_min_deg=low,
            position_max_deg=high,
            speed_max_deg_s=speed,
            accel_max_deg_s2=accel,
            jerk_max_deg_s3=jerk,
        )
        for index, (name, (low, high, speed, accel, jerk)) in enumerate(limits.items(), 1)
    }
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="arm", path=None, buses={"main": bus}, joints=joints)


def test_a_key_at_the_end_of_its_range_is_reached_beside_a_joint_with_a_jerk_limit() -> None:
    degs = [
        {"j2": -26.278, "j7": 59.334},
        {"j2": -50.669, "j7": 62.649},
        {"j4": -159.933},
        {"j4": -163.904},
        {"j7": -82.119},
    ]
    frames = tuple(Keyframe(at_s=None, deg=deg) for deg in degs)
    robot = arm(LIMITED)
    found = plan(Sequence(name="end", timing=Timing.FASTEST, keyframes=frames), robot)
    verify(found, robot)
    reached = found.sample(np.array([found.marks[1].planned_s]))[0]
    assert reached[found.joints.index("j7")] == pytest.approx(62.649, abs=0.005)


TIMED = (
    {
        "j1": (-144.703, 145.654, 360.0, 600.0, 8000.0),
        "j2": (-71.567, 42.963, 360.0, 1000.0, 4000.0),
        "j3": (-86.5, 95.176, 360.0, 1000.0, 4000.0),
    },
    (0.0, 0.84, 1.44, 1.83),
    [
        {"j1": 145.654, "j2": 42.963, "j3": -86.5},
        {"j1": 145.278, "j3": 37.514},
        {"j1": -36.634, "j2": -71.567},
        {"j1": 16.973, "j2": 42.963, "j3": 95.176},
    ],
)
UNTIMED = (
    {
        "j1": (-121.503, 132.766, 180.0, 700.0, 8000.0),
        "j2": (-160.23, 47.103, 360.0, 700.0, math.inf),
        "j3": (-121.325, 130.479, 180.0, 700.0, 8000.0),
    },
    (None, None, None),
    [
        {"j1": -121.503, "j2": -160.23, "j3": 113.797},
        {"j1": 132.766, "j3": 130.479},
        {"j2": 47.073, "j3": 130.479},
    ],
)


@pytest.mark.parametrize(("limits", "times", "degs"), [TIMED, UNTIMED])
def test_a_show_that_is_too_fast_rests_at_both_ends_for_smoothing(limits, times, degs) -> None:
    robot = arm(limits)
    frames = tuple(Keyframe(at_s=at_s, deg=deg) for at_s, deg in zip(times, degs, strict=True))
    timing = Timing.FASTEST if times[0] is None else Timing.AUTHORED
    found = plan(Sequence(name="fast", timing=timing, keyframes=frames), robot)
    verify(found, robot)
    assert np.abs(found.sample(np.array([0.0, found.duration_s]), 1)).max() < 1e-6


def test_a_key_that_is_not_reached_when_it_should_be_is_named() -> None:
    limits = {
        "j1": (-81.601, 110.617, 180.0, 600.0, math.inf),
        "j2": (-107.187, 78.879, 360.0, 700.0, 4000.0),
    }
    degs = [
        {"j1": 110.617, "j2": 78.658},
        {"j2": 38.549},
        {"j1": 110.617},
        {"j2": 78.879},
        {"j1": -81.601, "j2": 47.194},
        {"j1": 110.514},
    ]
    robot = arm(limits)
    frames = tuple(Keyframe(at_s=None, deg=deg) for deg in degs)
    found = plan(Sequence(name="off", timing=Timing.FASTEST, keyframes=frames), robot)
    off = {own.joint: own.key_error_deg for own in found.smoothing}
    for name in found.joints:
        column = found.joints.index(name)
        worst_deg = max(
            abs(float(found.sample(np.array([mark.planned_s]))[0, column]) - deg[name])
            for mark, deg in zip(found.marks, degs, strict=True)
            if name in deg
        )
        assert off[name] == pytest.approx(worst_deg, abs=1e-9)
    text = "\n".join(plan_lines(found, robot, is_whole=True))
    for name, error_deg in off.items():
        said = f"joint {name!r}, jerk at most 4000 deg/s³" if name == "j2" else f"joint {name!r}"
        assert (f"up to {error_deg:.2f} deg off a key" in text) == (error_deg > 0.005), said
