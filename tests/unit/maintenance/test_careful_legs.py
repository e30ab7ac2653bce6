"""The plan of a careful run, and what it makes of readings."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.maintenance.careful import (
    SPEED_RATIO,
    WAY_DEG,
    Course,
    judgement,
    make_legs,
    measured,
    way_of,
)
from lss_motion.robot.model import Robot
from tests.joints import joint

ROBOT = Robot(name="bench", path=None, buses={}, joints={})


@pytest.mark.parametrize(
    ("standing_deg", "way_deg"),
    [(0.0, WAY_DEG), (1.0, -WAY_DEG), (-89.0, WAY_DEG), (89.9, -WAY_DEG), (90.3, -WAY_DEG)],
)
def test_it_turns_towards_the_end_with_more_room(standing_deg, way_deg):
    assert way_of(joint(), ROBOT, standing_deg) == way_deg
    legs = make_legs(joint(), ROBOT, standing_deg, way_deg)
    targets = {leg.target_deg for leg in legs}
    assert targets == {standing_deg, standing_deg + way_deg}


def test_a_direction_turns_the_range_of_the_servo():
    tight = joint(direction=-1, position_min_deg=-3.0, position_max_deg=80.0, zero_deg=10.0)
    assert way_of(tight, ROBOT, 10.0) == -WAY_DEG
    small = joint(position_min_deg=-2.0, position_max_deg=1.0)
    assert way_of(small, ROBOT, 0.0) == -1.5
    none = joint(position_min_deg=-1.2, position_max_deg=1.2)
    assert way_of(none, ROBOT, 0.0) == 0.0


def test_a_joint_outside_of_its_range_is_refused():
    with pytest.raises(InputError, match="outside of its range of -90 to 90 deg"):
        way_of(joint(), ROBOT, 91.0)


@pytest.mark.parametrize("speed_deg_s", [3.0, 20.0, 100.0, 180.0])
@pytest.mark.parametrize("accel_deg_s2", [10.0, 100.0, 600.0])
def test_no_leg_exceeds_a_fifth_of_the_speed_whatever_one_unit_is(speed_deg_s, accel_deg_s2):
    one = joint(speed_max_deg_s=speed_deg_s, accel_max_deg_s2=accel_deg_s2)
    top = min(SPEED_RATIO * speed_deg_s, ROBOT.approach_speed_deg_s)
    for leg in make_legs(one, ROBOT, 0.0, way_of(one, ROBOT, 0.0)):
        bounds = {"SD": leg.settings["SD"], "T": 1000.0 * leg.course.way_deg / leg.duration_ms}
        assert max(bounds.values()) <= 1.001 * top
        assert max(leg.settings["AA"], leg.settings["AD"]) <= accel_deg_s2
        if leg.tests in bounds:
            assert bounds.pop(leg.tests) <= 0.3 * min(bounds.values())


@pytest.mark.parametrize("seed", range(20))
def test_a_course_is_its_own_inverse_and_keeps_its_limits(seed):
    way_deg, speed, accel, decel = np.random.default_rng(seed).uniform(
        [0.5, 0.5, 5.0, 5.0], [10.0, 60.0, 900.0, 900.0]
    )
    course = Course(way_deg, speed, accel, decel)
    assert course.at(course.duration_s)[0] == pytest.approx(way_deg)
    times_s = np.linspace(0.0, course.duration_s, 400)
    angles_deg = np.array([course.at(time_s)[0] for time_s in times_s])
    assert np.all(np.diff(angles_deg) >= -1e-9)
    assert np.diff(angles_deg).max() / np.diff(times_s).max() <= 1.0001 * speed
    for time_s, angle_deg in zip(times_s[1:-1], angles_deg[1:-1], strict=True):
        assert course.time_s(angle_deg) == pytest.approx(time_s, abs=1e-5)


@pytest.mark.parametrize(
    ("lag_s", "ratio", "lost_deg", "text"),
    [
        (0.02, 1.0, 0.0, ""),
        (0.06, 1.0, 1.0, ""),
        (0.02, 1.3, 0.0, ""),
        (0.15, 1.0, 0.0, "later than its profile"),
        (0.02, 3.0, 0.0, "times as fast"),
        (0.02, 0.4, 0.0, "later than its profile"),
        (0.02, 1.0, 3.0, "blocked"),
    ],
)
def test_the_readings_of_a_leg_are_judged(lag_s, ratio, lost_deg, text):
    one = joint()
    leg = make_legs(one, ROBOT, 0.0, WAY_DEG)[-2]
    times_s = np.arange(0.0, 3.0, 0.006)
    course_deg = np.array([leg.course.at(ratio * (time_s - lag_s))[0] for time_s in times_s])
    turned_deg = np.maximum(course_deg - lost_deg, 0.0)
    found = measured(leg, times_s.tolist(), turned_deg.tolist())
    said = judgement(one, leg, found, ROBOT.identify_command(one.name))
    assert text in said
    assert bool(text) is bool(said)
