"""Judged against the textbook's parabolas, written out here."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.robot.model import Response
from lss_motion.robot.profile import Piece, Profile, trapezoid

REST = Piece(0.0, 0.0, 0.0, 0.0)
RAMP_DEG_S2 = 500.0


def textbook_deg(time_s, distance_deg, travel_deg_s, ramp_deg_s2):
    """Position of a move from rest to rest."""
    top = min(travel_deg_s, math.sqrt(distance_deg * ramp_deg_s2))
    ramp_s = top / ramp_deg_s2
    end_s = distance_deg / top + ramp_s
    if time_s <= ramp_s:
        return 0.5 * ramp_deg_s2 * time_s**2
    if time_s <= end_s - ramp_s:
        return top * (time_s - 0.5 * ramp_s)
    return distance_deg - 0.5 * ramp_deg_s2 * max(end_s - time_s, 0.0) ** 2


def profile(response=None, *, ramp_deg_s2=RAMP_DEG_S2, speed_max_deg_s=360.0):
    return Profile(
        0.0,
        ramp_deg_s2=ramp_deg_s2,
        speed_max_deg_s=speed_max_deg_s,
        response=response or Response(),
    )


@pytest.mark.parametrize(
    ("target_deg", "travel_deg_s"), [(90.0, 100.0), (-90.0, 100.0), (10.0, 300.0), (0.1, 1.0)]
)
def test_a_move_from_rest_to_rest_is_the_textbooks_trapezoid(target_deg, travel_deg_s):
    pieces = trapezoid(REST, target_deg, travel_deg_s, RAMP_DEG_S2)
    times_s = np.linspace(0.0, 1.1 * pieces[-1].start_s, 500)
    expected = [textbook_deg(t, abs(target_deg), travel_deg_s, RAMP_DEG_S2) for t in times_s]
    found = PiecewiseProfile(pieces).sample(times_s)
    assert found == pytest.approx(math.copysign(1.0, target_deg) * np.array(expected), abs=1e-9)


def test_a_new_move_on_the_way_takes_over_position_and_speed():
    start = Piece(2.0, 10.0, 50.0, 0.0)
    pieces = trapezoid(start, 110.0, 50.0, RAMP_DEG_S2)
    assert pieces[0].at(2.0) == (10.0, 50.0)
    braking_deg = 50.0**2 / (2.0 * RAMP_DEG_S2)
    arrival_s = 2.0 + (100.0 - braking_deg) / 50.0 + 50.0 / RAMP_DEG_S2
    assert pieces[-1].start_s == pytest.approx(arrival_s)


def test_too_fast_to_stop_it_overshoots_and_comes_back():
    pieces = trapezoid(Piece(0.0, 0.0, 100.0, 0.0), 1.0, 360.0, RAMP_DEG_S2)
    times_s = np.linspace(0.0, pieces[-1].start_s, 2001)
    found = PiecewiseProfile(pieces).sample(times_s)
    assert found.max() == pytest.approx(100.0**2 / (2.0 * RAMP_DEG_S2), abs=1e-4)
    back_s = 2.0 * math.sqrt(9.0 / RAMP_DEG_S2)
    assert pieces[-1].start_s == pytest.approx(100.0 / RAMP_DEG_S2 + back_s)
    assert pieces[-1].position_deg == 1.0


def test_moving_away_it_turns_round():
    pieces = trapezoid(Piece(0.0, 0.0, -100.0, 0.0), 50.0, 360.0, RAMP_DEG_S2)
    found = PiecewiseProfile(pieces).sample(np.linspace(0.0, pieces[-1].start_s, 2001))
    assert found.min() == pytest.approx(-10.0, abs=1e-4)
    assert found[-1] == pytest.approx(50.0)


def test_too_fast_at_the_start_it_slows_down_to_the_travel_speed():
    pieces = trapezoid(Piece(0.0, 0.0, 200.0, 0.0), 150.0, 100.0, RAMP_DEG_S2)
    slowed_s = 100.0 / RAMP_DEG_S2
    assert PiecewiseProfile(pieces).at(slowed_s) == pytest.approx((30.0, 100.0))
    assert PiecewiseProfile(pieces).at(slowed_s + 0.5) == pytest.approx((80.0, 100.0))
    assert pieces[-1].start_s == pytest.approx(slowed_s + (120.0 - 10.0) / 100.0 + slowed_s)


def test_cruise_law_travels_at_distance_over_duration_and_is_late_by_a_ramp():
    servo = profile()
    servo.retarget(1.0, 90.0, 0.9)
    assert servo.at(1.5) == pytest.approx((100.0 * (0.5 - 0.1), 100.0))
    assert servo.at(1.9 + 100.0 / RAMP_DEG_S2) == (90.0, 0.0)
    assert servo.at(1.9 + 100.0 / RAMP_DEG_S2 - 0.01)[0] < 90.0


def test_exact_law_arrives_after_exactly_its_duration():
    servo = profile(Response(t_law="exact"))
    servo.retarget(1.0, 45.0, 0.9)
    assert servo.at(1.9) == pytest.approx((45.0, 0.0), abs=1e-6)
    assert servo.at(1.89)[0] < 45.0 - 0.02


def test_no_law_makes_it_faster_than_its_speed_limit():
    for law in ("cruise", "exact"):
        servo = profile(Response(t_law=law), speed_max_deg_s=60.0)
        servo.retarget(0.0, 60.0, 0.1)
        assert servo.at(0.5)[1] == 60.0


def test_from_rest_forgets_the_speed_and_keep_speed_does_not():
    keeping, resting = profile(), profile(Response(retarget="from_rest"))
    for servo in (keeping, resting):
        servo.retarget(0.0, 90.0, 0.9)
        servo.retarget(0.5, 90.0, 0.9)
    assert keeping.at(0.5)[1] == pytest.approx(100.0)
    assert resting.at(0.5)[1] == 0.0
    assert keeping.at(0.5)[0] == resting.at(0.5)[0] == pytest.approx(40.0)


def test_a_target_that_is_being_passed_is_reached_by_coming_back():
    servo = profile()
    servo.retarget(0.0, 90.0, 0.9)
    here_deg, _ = servo.at(0.5)
    servo.retarget(0.5, here_deg, 0.1)
    times_s = 0.5 + 0.001 * np.arange(1000)
    path_deg = np.array([servo.at(time_s)[0] for time_s in times_s])
    assert np.abs(np.diff(path_deg)).max() < 0.001 * 100.0 + 1e-9
    assert path_deg.max() == pytest.approx(here_deg + 10.0, abs=1e-3)
    assert path_deg[-1] == here_deg


def test_a_new_command_drops_what_was_planned_after_it():
    servo = profile()
    servo.retarget(0.0, 90.0, 0.9)
    servo.retarget(0.5, 50.0, 0.1)
    servo.retarget(0.5, 60.0, 0.5)
    assert servo.at(10.0) == (60.0, 0.0)
    starts_s = [piece.start_s for piece in servo.pieces()]
    assert starts_s == sorted(starts_s)


def test_dropping_history_does_not_change_the_present():
    servo = profile()
    for step in range(200):
        servo.retarget(0.1 * step, 90.0 if step % 2 else -90.0, 0.9)
    before = [servo.at(time_s) for time_s in np.arange(18.0, 25.0, 0.01)]
    servo.forget_before(18.0)
    assert [servo.at(time_s) for time_s in np.arange(18.0, 25.0, 0.01)] == before
    assert len(list(servo.pieces())) < 60


def test_before_its_history_a_profile_stands_at_its_first_position():
    servo = profile()
    servo.retarget(3.0, 90.0, 0.9)
    assert servo.at(-1e9) == servo.at(2.9) == (0.0, 0.0)


def test_a_piecewise_profile_equals_its_profile():
    servo = profile()
    servo.retarget(0.0, 90.0, 0.9)
    servo.retarget(0.4, -30.0, 0.5)
    curve = PiecewiseProfile(servo.pieces())
    times_s = np.linspace(-1.0, 3.0, 400)
    expected = [servo.at(time_s) for time_s in times_s]
    assert curve.sample(times_s) == pytest.approx([deg for deg, _ in expected])
    for time_s, one in zip(times_s, expected, strict=True):
        assert curve.at(float(time_s)) == pytest.approx(one)


@pytest.mark.parametrize(
    ("start_s", "step_s"), [(-1.0, 0.005), (0.213, 0.01), (0.9, 0.4), (9.0, 1.0)]
)
@pytest.mark.parametrize("begin_s", [-math.inf, 0.0])
def test_samples_on_a_grid_equal_single_samples(start_s, step_s, begin_s):
    moves = trapezoid(Piece(0.0, 5.0, 60.0, 0.0), 90.0, 200.0, RAMP_DEG_S2)
    first = [Piece(begin_s, 5.0, 0.0, 0.0)] if math.isinf(begin_s) else []
    for curve in (
        PiecewiseProfile([*first, *moves]),
        PiecewiseProfile([Piece(begin_s, 7.0, 0.0, 0.0)]),
    ):
        times_s = start_s + step_s * np.arange(400)
        found = curve.on_grid(start_s, step_s, 400)
        assert found == pytest.approx(curve.sample(times_s), abs=1e-9)


def test_exact_law_slows_down_below_the_mean_where_the_start_is_fast():
    servo = profile(Response(t_law="exact"))
    servo.retarget(0.0, 300.0, 3.5)
    servo.retarget(1.0, servo.at(1.0)[0] + 20.0, 1.0)
    target_deg = servo.at(9.0)[0]
    assert servo.at(1.99)[0] < target_deg - 0.01
    assert servo.at(2.0) == pytest.approx((target_deg, 0.0), abs=1e-6)
    assert servo.at(1.6)[1] < 20.0
