import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lss_motion.sim.profile import Ramps, plan_move, plan_stop, plan_wheel, travel_speed_deg_s

ramps = st.builds(Ramps, st.floats(1.0, 600.0), st.floats(10.0, 2000.0), st.floats(10.0, 2000.0))
positions = st.floats(-1000.0, 1000.0)
speeds = st.one_of(st.just(0.0), st.floats(-400.0, 400.0))


def assert_continuous(phases, position_deg, speed_deg_s):
    for phase in phases:
        assert phase.position_deg == pytest.approx(position_deg, abs=1e-6)
        assert phase.speed_deg_s == pytest.approx(speed_deg_s, abs=1e-5)
        if math.isfinite(phase.duration_s):
            position_deg, speed_deg_s = phase.end()


@given(positions, speeds, positions, ramps)
def test_a_move_ends_at_rest_on_its_target_without_a_jump(start_deg, speed_deg_s, end_deg, ramps):
    phases = plan_move(start_deg, speed_deg_s, end_deg, ramps)
    assert_continuous(phases, start_deg, speed_deg_s)
    assert phases[-1] == (math.inf, end_deg, 0.0, 0.0)


@given(positions, speeds, positions, ramps)
def test_a_move_keeps_to_its_ramps_and_to_its_travel_speed(start_deg, speed_deg_s, end_deg, ramps):
    limit_deg_s = max(abs(speed_deg_s), ramps.speed_deg_s) * (1 + 1e-9)
    for phase in plan_move(start_deg, speed_deg_s, end_deg, ramps)[:-1]:
        final_deg_s = phase.end()[1]
        assert max(abs(phase.speed_deg_s), abs(final_deg_s)) <= limit_deg_s + 1e-6
        is_faster = abs(phase.speed_deg_s) < abs(final_deg_s)
        rate_deg_s2 = ramps.accel_deg_s2 if is_faster else ramps.decel_deg_s2
        assert abs(phase.accel_deg_s2) in (0.0, rate_deg_s2)


@pytest.mark.parametrize(
    ("distance_deg", "travel_deg_s", "expected_s"),
    [
        (90.0, 100.0, 90 / 100 + 100 / 500 / 2 + 100 / 1000 / 2),  # d/v + v/2a + v/2d
        (-90.0, 100.0, 90 / 100 + 100 / 500 / 2 + 100 / 1000 / 2),
        (3.0, 100.0, math.sqrt(2 * 3.0 * (1 / 500 + 1 / 1000))),  # a triangle
    ],
)
def test_a_move_from_rest_takes_as_long_as_its_trapezoid(distance_deg, travel_deg_s, expected_s):
    phases = plan_move(10.0, 0.0, 10.0 + distance_deg, Ramps(travel_deg_s, 500.0, 1000.0))
    assert sum(phase.duration_s for phase in phases[:-1]) == pytest.approx(expected_s)


def test_one_that_is_too_fast_to_stop_runs_over_its_target_and_comes_back():
    phases = plan_move(0.0, 200.0, 10.0, Ramps(360.0, 1000.0, 1000.0))
    assert phases[0].end() == pytest.approx((20.0, 0.0))  # 200² / 2000
    assert phases[-1].position_deg == 10.0
    assert min(phase.speed_deg_s for phase in phases) < 0.0


def test_braking_starts_at_once_and_covers_the_square_of_the_speed():
    phases, stop_deg = plan_stop(5.0, -100.0, 500.0)
    assert stop_deg == pytest.approx(5.0 - 100**2 / 1000)
    assert phases[0].duration_s == pytest.approx(0.2)
    assert plan_stop(5.0, 0.0, 500.0) == ([], 5.0)


@given(positions, speeds, st.floats(-360.0, 360.0), ramps)
def test_a_wheel_reaches_its_speed_and_keeps_it(position_deg, speed_deg_s, wheel_deg_s, ramps):
    phases = plan_wheel(position_deg, speed_deg_s, wheel_deg_s, ramps)
    assert_continuous(phases, position_deg, speed_deg_s)
    assert (phases[-1].duration_s, phases[-1].speed_deg_s) == (math.inf, wheel_deg_s)


def test_the_cruise_law_divides_distance_by_time_and_stays_below_the_top_speed():
    limits = Ramps(360.0, 1000.0, 1000.0)
    assert travel_speed_deg_s(90.0, 0.5, 0.0, limits, "cruise") == pytest.approx(180.0)
    assert travel_speed_deg_s(900.0, 0.5, 0.0, limits, "cruise") == 360.0


@given(st.floats(5.0, 200.0), st.floats(0.0, 100.0), st.floats(1.2, 4.0), ramps)
def test_the_exact_law_makes_the_whole_move_last_its_time(
    distance_deg, speed_deg_s, stretch_ratio, ramps
):
    limits = ramps._replace(speed_deg_s=1e6)
    if speed_deg_s**2 > distance_deg * ramps.decel_deg_s2:
        speed_deg_s = 0.0
    quickest = plan_move(0.0, speed_deg_s, distance_deg, limits)
    asked_s = stretch_ratio * sum(phase.duration_s for phase in quickest[:-1])
    travel_deg_s = travel_speed_deg_s(distance_deg, asked_s, speed_deg_s, limits, "exact")
    phases = plan_move(0.0, speed_deg_s, distance_deg, limits._replace(speed_deg_s=travel_deg_s))
    assert sum(phase.duration_s for phase in phases[:-1]) == pytest.approx(asked_s, rel=1e-6)
