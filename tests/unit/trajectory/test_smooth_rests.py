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


LATE_TURN = (  # The others are so slow that the first joint is where it turns long before its mark.
    {
        "j0": (-149.74, 71.329, 600.0, 600.0, 2000.0),
        "j1": (-122.876, 47.549, 180.0, 1000.0, 4000.0),
        "j2": (-97.989, 84.841, 600.0, 600.0, 20000.0),
        "j3": (-145.961, 131.255, 600.0, 600.0, 20000.0),
    },
    (0.0, 0.79, 1.36, 1.59),
    [
        {"j1": 10.627, "j3": 131.255},
        {"j0": -149.74, "j2": -97.989},
        {"j0": 71.329, "j1": 47.549, "j2": -81.74, "j3": -49.286},
        {"j1": -26.417},
    ],
)
TWICE_AT_THE_END = (
    {
        "j0": (-125.796, 125.876, 600.0, 1000.0, 4000.0),
        "j1": (-77.563, 61.162, 360.0, 1000.0, 8000.0),
    },
    (None, None, None, None),
    [
        {"j0": -125.796, "j1": 61.162},
        {"j0": 125.876, "j1": -35.783},
        {"j0": 125.876},
        {"j0": 55.03, "j1": 61.162},
    ],
)
NEAR_THE_END = (
    {"j0": (-146.033, 105.963, 600.0, 1000.0, 4000.0)},
    (0.0, 0.78, 0.98, 2.1, 2.4, 3.02),
    [{"j0": deg} for deg in (105.963, -146.033, 105.419, 105.963, 105.963, -140.371)],
)
CLOSE_AT_THE_END = (
    {
        "j0": (-64.815, 32.404, 360.0, 600.0, 2000.0),
        "j1": (-124.586, 56.965, 600.0, 1000.0, 4000.0),
    },
    (0.0, 1.2, 2.77, 3.05, 4.09, 4.31),
    [
        {"j0": -17.616, "j1": -124.02},
        {"j0": -64.815, "j1": 56.965},
        {"j0": -64.815, "j1": -109.541},
        {"j0": -64.815, "j1": -124.586},
        {"j0": 18.981, "j1": 56.965},
        {"j0": 15.661},
    ],
)


def any_show(seed: int) -> tuple[dict, tuple, list]:
    """Return limits, times and angles, many of them at or near the ends of ranges."""
    random = np.random.default_rng(seed)
    names = [f"j{index}" for index in range(int(random.integers(1, 4)))]
    limits = {
        name: (
            -round(float(random.uniform(60.0, 170.0)), 3),
            round(float(random.uniform(30.0, 150.0)), 3),
            float(random.choice([180.0, 360.0, 600.0])),
            float(random.choice([600.0, 700.0, 1000.0])),
            float(random.choice([2000.0, 4000.0, 8000.0, 20000.0, math.inf])),
        )
        for name in names
    }
    is_timed, at_s = random.random() < 0.5, 0.0
    times, degs = [], []
    for _ in range(int(random.integers(3, 8))):
        chosen = [name for name in names if random.random() < 0.6] or names[:1]
        times.append(round(at_s, 2) if is_timed else None)
        at_s += float(random.uniform(0.2, 1.2))
        deg = {}
        for name in chosen:
            low, high = limits[name][:2]
            near = float(random.choice([0.0, 0.0, round(float(random.uniform(0.15, 0.6)), 3)]))
            other = round(float(random.uniform(low, high)), 3)
            deg[name] = float(random.choice([low + near, high - near, other]))
        degs.append(deg)
    return limits, tuple(times), degs


KINDS = (LATE_TURN, TWICE_AT_THE_END, NEAR_THE_END, CLOSE_AT_THE_END)


@pytest.mark.parametrize("show", [*KINDS, *map(any_show, range(24))])
def test_with_a_jerk_limit_every_key_is_reached_at_its_mark(show) -> None:
    limits, times, degs = show
    robot = arm(limits)
    frames = tuple(Keyframe(at_s=at_s, deg=deg) for at_s, deg in zip(times, degs, strict=True))
    timing = Timing.FASTEST if times[0] is None else Timing.AUTHORED
    found = plan(Sequence(name="keys", timing=timing, keyframes=frames), robot)
    verify(found, robot)
    for mark, deg in zip(found.marks, degs, strict=True):
        reached = dict(zip(found.joints, found.sample(np.array([mark.planned_s]))[0], strict=True))
        assert {name: reached[name] for name in deg} == pytest.approx(deg, abs=0.004), mark


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
