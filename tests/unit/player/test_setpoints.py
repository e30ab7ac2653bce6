"""What a streamed joint may be told next, and how it closes up on its plan."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import event, example, given
from hypothesis import strategies as st

from lss_motion.player.joint_state import CLOSING_RATIO, STEP_OFFSETS, Setpoints, closing_deg
from lss_motion.program.reference import servo_limits
from tests.filters import FILTER_S, felt, staircase
from tests.joints import joint

TOLERANCE_DEG, WEEK_S = 0.2, 7 * 86400.0
STEP_GAIN_DEG = 600.0 * FILTER_S**2
"""So much a step may differ from the last one within 600 deg/s²."""


@pytest.fixture
def limits(kit):
    return servo_limits(kit.joint(drive="streamed"), TOLERANCE_DEG)


def test_from_rest_the_first_step_keeps_the_acceleration_that_the_horn_feels(limits):
    low_deg, high_deg = Setpoints(10.0, count=3, limits=limits).allowed(0.5)
    assert high_deg - 10.0 == pytest.approx(10.0 - low_deg)
    felt = 1.0 - 2.718281828**-1.0
    assert high_deg - 10.0 == pytest.approx(3 * (STEP_GAIN_DEG + TOLERANCE_DEG) / felt)


def test_a_horn_without_lag_feels_all_of_a_step(limits):
    limits = replace(limits, response=replace(limits.response, lag_s=0.0))
    _, high_deg = Setpoints(10.0, count=3, limits=limits).allowed(0.5)
    assert high_deg - 10.0 == pytest.approx(3 * (STEP_GAIN_DEG + TOLERANCE_DEG))


@pytest.mark.parametrize("rest_s", [0.4, WEEK_S])
def test_a_filter_that_has_settled_is_at_rest_however_long(limits, rest_s):
    setpoints = Setpoints(0.0, count=3, limits=limits)
    setpoints.commanded(0.1, 10.0)
    at_rest = Setpoints(10.0, count=3, limits=limits).allowed(0.1)
    assert setpoints.allowed(0.1 + rest_s) == pytest.approx(at_rest, abs=1e-6)


def test_a_target_counts_from_when_it_is_heard(limits):
    setpoints = Setpoints(0.0, count=3, limits=limits)
    setpoints.commanded(0.1, 10.0)
    setpoints.commanded(1.1, 60.0)
    at_rest = Setpoints(10.0, count=3, limits=limits).allowed(1.1)
    assert setpoints.allowed(1.1) == pytest.approx(at_rest)


def test_where_the_possible_instants_disagree_a_target_is_half_way_between_them(limits):
    setpoints = Setpoints(0.0, count=3, limits=limits)
    setpoints.commanded(0.0199, 60.0)
    _, before_deg = setpoints.allowed(0.0199)
    low_deg, high_deg = setpoints.allowed(0.0301)
    after_deg, _ = setpoints.allowed(0.0399)
    assert before_deg < after_deg - 20.0
    assert low_deg == high_deg == pytest.approx(0.5 * (before_deg + after_deg))


def run_to_the_end(limits, count, sign):
    """Tell a servo to go as far as is allowed, step by step; return the targets and the filter."""
    setpoints = Setpoints(0.0, count=count, limits=limits)
    value, said, values = 0.0, [], [0.0]
    for step in range(1, 100):
        at_s = step * FILTER_S + 0.001
        span = setpoints.allowed(at_s)
        said.append(span[1] if sign > 0 else span[0])
        setpoints.commanded(at_s, said[-1])
        value += (said[-1] - value) / count
        values.append(value)
    return said, values


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("sign", [1, -1])
def test_it_brakes_before_the_end_of_the_range_and_no_sooner_than_it_must(limits, count, sign):
    limits = replace(limits, response=replace(limits.response, lag_s=0.0))
    said, values = run_to_the_end(limits, count, sign)
    assert max(sign * deg for deg in said) <= 90.0 + 1e-9
    assert sign * values[-1] > 89.8
    steps = [sign * (b - a) for a, b in pairwise(values)]
    gain_deg = STEP_GAIN_DEG + TOLERANCE_DEG
    assert max(steps) == pytest.approx(180.0 * FILTER_S)
    assert max(a - b for a, b in pairwise(steps)) <= gain_deg + 1e-9
    braked = zip(said[1:], pairwise(steps), strict=True)
    partly = [deg for deg, (a, b) in braked if 0.01 < a - b < gain_deg - 0.01]
    assert sum(abs(deg) < 89.99 for deg in partly) <= 1, "it brakes with all it may"


@pytest.mark.parametrize("sign", [1, -1])
def test_at_the_end_of_the_range_there_is_no_way_on(limits, sign):
    span = Setpoints(sign * 90.0, count=3, limits=limits).allowed(0.5)
    assert (span[1] if sign > 0 else span[0]) == pytest.approx(sign * 90.0)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("steps", [8, 20])
def test_what_closes_up_from_afar_brakes_evenly_until_it_is_there(limits, sign, steps):
    less_deg = CLOSING_RATIO * STEP_GAIN_DEG
    off_deg = sign * less_deg * sum(range(steps + 1))
    assert closing_deg(off_deg, limits) == pytest.approx(sign * steps * less_deg)


def test_what_is_near_closes_up_by_half_a_step_at_a_time(limits):
    assert closing_deg(0.0, limits) == 0.0
    assert closing_deg(-0.1, limits) == pytest.approx(-0.05)


@given(
    st.lists(
        st.tuples(st.integers(1_000, 20_000), st.floats(-90.0, 90.0)), min_size=1, max_size=60
    ),
    st.sampled_from([2, 3, 5]),
)
@example(asked=[(20_000, 90.0)] * 60, count=3)
def test_whatever_is_asked_and_however_unevenly_no_filter_leaves_its_limits(asked, count):
    limits = servo_limits(joint(drive="streamed"), TOLERANCE_DEG)
    setpoints = Setpoints(0.0, count=count, limits=limits)
    at_us, heard = 0.3, []
    for gap_us, wanted_deg in asked:
        at_us += gap_us
        low_deg, high_deg = setpoints.allowed(at_us / 1e6)
        if high_deg - low_deg < 1e-9:
            event("the instants disagree")
            break
        target_deg = min(max(wanted_deg, low_deg, -90.0), high_deg, 90.0)
        setpoints.commanded(at_us / 1e6, target_deg)
        heard.append((1e3 * at_us, target_deg))
    for phase in range(STEP_OFFSETS):
        values = staircase(heard, count, phase * FILTER_S / STEP_OFFSETS, at_us / 1e6 + FILTER_S)
        assert np.abs(np.diff(values)).max(initial=0.0) <= 180.0 * FILTER_S + 0.05
        most_deg_s2 = 600.0 + (TOLERANCE_DEG + 0.05) / FILTER_S**2
        assert np.abs(felt(values)).max(initial=0.0) <= most_deg_s2
