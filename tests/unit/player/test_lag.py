"""The lag of a horn from its readings: found, not mistaken for a load, and bounded."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from lss_motion.player.estimators import DEAD_S, LAG_MAX_S, MEMORY_S, LagEstimator


def swung(lag_s, *, load_deg=0.0, noise_deg=0.1, seconds=6.0, hz=40.0, swing_deg=30.0):
    """Return the estimate after readings of a joint that swings once a second and a half."""
    random, lag = Random(1), LagEstimator()
    times_s = np.arange(0.0, seconds, 1.0 / hz)
    rate = 2.0 * np.pi / 1.5
    for time_s in times_s.tolist():
        now_deg, speed = swing_deg * np.sin(rate * time_s), swing_deg * rate * np.cos(rate * time_s)
        then_deg = swing_deg * np.sin(rate * (time_s - lag_s))
        load = load_deg * np.cos(np.radians(now_deg))
        measured_deg = then_deg - load + random.uniform(-noise_deg, noise_deg)
        lag.take(now_deg - measured_deg, float(speed), 1.0 / hz)
    return lag


@pytest.mark.parametrize("lag_s", [-0.015, 0.0, 0.01, 0.03, 0.05])
@pytest.mark.parametrize("load_deg", [0.0, 3.0])
def test_a_lag_is_found_whatever_the_load(lag_s, load_deg):
    assert swung(lag_s, load_deg=load_deg).estimate_s == pytest.approx(lag_s, abs=0.003)


def test_a_lag_as_assumed_moves_nothing():
    assert swung(0.0).extra_s == 0.0
    assert swung(0.03).extra_s == swung(0.03).estimate_s == pytest.approx(0.03, abs=0.003)
    assert 0.0 < swung(1.5 * DEAD_S).extra_s < 1.5 * DEAD_S


def test_no_estimate_goes_beyond_what_a_lag_can_be():
    assert swung(0.2).estimate_s == LAG_MAX_S
    assert swung(-0.2).estimate_s == -LAG_MAX_S


def test_at_rest_nothing_is_learnt_and_nothing_forgotten():
    lag = swung(0.03)
    known_s = lag.estimate_s
    for _ in range(4000):
        lag.take(2.0, 0.0, 0.02)
    assert lag.estimate_s == known_s


def test_one_reading_says_nothing():
    lag = LagEstimator()
    assert lag.estimate_s == 0.0
    lag.take(5.0, 100.0, 0.02)
    assert abs(lag.estimate_s) < 0.002


def driven(lag, lag_s, *speeds_deg_s, seconds, load_deg=0.0):
    """Read a horn that lags by `lag_s` at each of the speeds in turn, for so long in all."""
    for step in range(round(100 * seconds)):
        speed = speeds_deg_s[step % len(speeds_deg_s)]
        lag.take(load_deg + lag_s * speed, speed, 0.01)
    return lag.estimate_s


def test_half_a_second_to_and_fro_tells_the_lag():
    assert driven(LagEstimator(), 0.03, -100.0, 100.0, seconds=0.5) == pytest.approx(0.03, rel=0.05)


def test_a_slow_move_is_hardly_believed():
    assert 0.01 < driven(LagEstimator(), 0.03, -10.0, 10.0, seconds=2.0) < 0.02


def test_one_way_at_two_speeds_tells_a_lag_from_a_load():
    found_s = driven(LagEstimator(), 0.03, 40.0, 120.0, seconds=4.0, load_deg=3.0)
    assert found_s == pytest.approx(0.03, rel=0.05)


def test_what_was_found_counts_a_third_after_so_much_motion():
    lag = LagEstimator()
    driven(lag, 0.04, -100.0, 100.0, seconds=20.0)
    assert driven(lag, 0.0, -100.0, 100.0, seconds=MEMORY_S) == pytest.approx(0.04 / 2.72, rel=0.05)


def test_creeping_for_a_minute_forgets_little():
    lag = swung(0.03)
    assert driven(lag, 0.03, -2.0, 2.0, seconds=60.0) == pytest.approx(0.03, rel=0.1)
