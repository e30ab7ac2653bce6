"""Laws of the show clock and of the estimate of one joint."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lss_motion.playing.player.estimators import OFFSET_MAX_DEG, DisturbanceEstimator, HornEstimator
from lss_motion.playing.player.show_clock import ShowClock

MS = 1_000_000

ramps = st.lists(
    st.tuples(st.integers(1, 2000), st.just(0.0) | st.floats(0.01, 1.0), st.floats(0.05, 2.0)),
    max_size=6,
)
"""Milliseconds to wait, the rate to go to, and over how long; also in mid-ramp."""


def clock_of(changes, start_s=-0.25, rate=1.0):
    clock, now_ns = ShowClock(5 * MS, start_s, rate), 5 * MS
    for wait_ms, to_rate, over_s in changes:
        now_ns += wait_ms * MS
        clock.ramp_to(to_rate, now_ns, over_s)
    return clock, now_ns + 3000 * MS


@given(ramps)
def test_show_time_never_goes_back_never_jumps_and_is_never_too_fast(changes):
    clock, end_ns = clock_of(changes)
    instants_ns = np.arange(5 * MS, end_ns, 7 * MS)
    shown_s = np.array([clock.show_s(int(instant)) for instant in instants_ns])
    assert shown_s[0] == -0.25
    steps_s = np.diff(shown_s)
    assert steps_s.min() >= -1e-12
    assert steps_s.max() <= 0.007 + 1e-12


@given(ramps)
def test_show_time_is_the_sum_of_the_rate(changes):
    clock, now_ns = ShowClock(5 * MS, 0.0, 1.0), 5 * MS
    total_s = 0.0
    for wait_ms, to_rate, over_s in changes:
        for _ in range(wait_ms):
            before, now_ns = clock.rate(now_ns), now_ns + MS
            total_s += 0.5e-3 * (before + clock.rate(now_ns))
        assert clock.show_s(now_ns) == pytest.approx(total_s, abs=2e-3)
        clock.ramp_to(to_rate, now_ns, over_s)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.05, 2.0), st.floats(0.0, 1.0))
def test_the_rate_ramps_evenly(from_rate, to_rate, over_s, share):
    clock = ShowClock(0, 0.0, from_rate)
    clock.ramp_to(to_rate, 1000 * MS, over_s)
    at_ns = 1000 * MS + round(share * over_s * 1e9)
    assert clock.rate(at_ns) == pytest.approx(from_rate + share * (to_rate - from_rate), abs=1e-6)
    assert clock.is_ramping(clock.ramp_end_ns - 1)
    assert not clock.is_ramping(clock.ramp_end_ns)
    assert clock.rate(clock.ramp_end_ns + 5) == to_rate == clock.target_rate


@given(ramps)
def test_between_knots_show_time_may_be_interpolated(changes):
    clock, end_ns = clock_of(changes)
    knots = list(clock.knots(5 * MS, end_ns, 10 * MS))
    assert [instant for instant, _ in knots] == sorted(instant for instant, _ in knots)
    assert knots[0][0] == 5 * MS
    assert knots[-1][0] == end_ns
    instants_ns = np.arange(5 * MS, end_ns, 3 * MS)
    exact_s = np.array([clock.show_s(int(instant)) for instant in instants_ns])
    found_s = np.interp(instants_ns, [i for i, _ in knots], [s for _, s in knots])
    assert np.abs(found_s - exact_s).max() < 0.00026  # half a step's sagitta at the steepest ramp


@given(ramps, st.floats(0.0, 100.0))
def test_an_instant_is_where_show_time_is_reached(changes, ahead_s):
    clock, _ = clock_of(changes)
    begin_s = clock.show_s(clock.ramp_end_ns)
    instant_ns = clock.instant_ns(begin_s + ahead_s)
    if clock.target_rate == 0.0:
        assert instant_ns is None
    else:
        assert clock.show_s(instant_ns) == pytest.approx(begin_s + ahead_s, abs=1e-8)


readings = st.lists(
    st.tuples(st.integers(1, 200), st.floats(-180.0, 180.0), st.floats(-1.0, 1.0)), max_size=60
)


@given(readings)
def test_whatever_is_read_a_correction_is_bounded_and_nothing_else_believed(read):
    following, now_s = DisturbanceEstimator(speed_max_deg_s=180.0), 0.0
    for wait_ms, wild_deg, near_deg in read:
        for measured_deg in (near_deg, wild_deg):
            now_s += wait_ms / 1e3
            elapsed_s = following.take(measured_deg, now_s, expected_deg=0.0, planned_deg=0.0)
            if elapsed_s is not None:
                following.horn.take(measured_deg, (0.0, 0.0, 0.0, 0.0), 0.0, elapsed_s)
            before_deg = following.offset_deg
            following.aim(0.0, 0.0, 0.01)
            assert abs(following.offset_deg - before_deg) <= 0.01 + 1e-9
            assert abs(following.offset_deg) <= OFFSET_MAX_DEG
            assert math.isfinite(following.horn.early_s)
    assert following.readings + following.rejected == 2 * len(read)


@given(st.floats(-6.0, 6.0), st.integers(5, 200))
def test_a_constant_load_is_found_whatever_the_rate_of_readings(droop_deg, period_ms):
    horn, found = HornEstimator(), []
    for _ in range(3000 // period_ms):
        horn.take(-droop_deg, (0.0, 0.0, 0.0, 0.0), 0.0, period_ms / 1e3)
        found.append(horn.load_deg(0.0, 0.0))
    assert found[-1] == pytest.approx(droop_deg, abs=0.05)
    growth = [abs(b) - abs(a) for a, b in pairwise(found)]
    assert min(growth) >= -1e-9, "it does not ring"
