from __future__ import annotations

import numpy as np
import pytest

from lss_motion.maintenance.take import HAND_DEG_S2, STEP_S, at_rest, cleaned, within


def read(seed: int, rate_hz: float = 40.0):
    """A hand's motion as a servo tells it: uneven times, tenths of a degree, one tenth of noise."""
    rng = np.random.default_rng(seed)
    times_s = np.cumsum(rng.uniform(0.7, 1.3, int(4 * rate_hz))) / rate_hz
    true_deg = true_at(times_s)
    return times_s, np.round(true_deg + rng.uniform(-0.1, 0.1, len(times_s)), 1)


def true_at(times_s):
    return 40.0 * np.sin(2.0 * np.pi * 0.4 * times_s) + 5.0 * np.sin(2.0 * np.pi * times_s)


@pytest.mark.parametrize("seed", range(5))
def test_a_clean_recording_is_even_and_nearer_to_the_truth_than_the_readings(seed) -> None:
    times_s, readings_deg = read(seed)
    clean = cleaned(times_s, readings_deg)
    assert np.allclose(np.diff(clean.times_s), STEP_S)
    inside = (clean.times_s > 0.2) & (clean.times_s < times_s[-1] - 0.2)
    off_deg = clean.angles_deg[inside] - true_at(clean.times_s[inside])
    assert np.abs(off_deg).max() < 0.25
    assert 0.02 < clean.noise_deg < 0.15


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("damage_deg", [3.0, -9.0, 80.0, -900.0])
def test_damaged_readings_leave_no_trace(seed, damage_deg) -> None:
    times_s, readings_deg = read(seed)
    damaged = readings_deg.copy()
    hit = np.random.default_rng(seed + 100).choice(len(damaged), 8, replace=False)
    damaged[hit] += damage_deg
    clean = cleaned(times_s, damaged)
    inside = (clean.times_s > 0.2) & (clean.times_s < times_s[-1] - 0.2)
    off_deg = clean.angles_deg[inside] - true_at(clean.times_s[inside])
    assert np.abs(off_deg).max() < 1.5
    assert np.sqrt(np.mean(off_deg**2)) < 0.4


def test_as_hard_as_a_hand_can_move_is_no_damage() -> None:
    times_s = np.arange(200) / 50.0
    shake_deg = 10.0 * np.cos(2.0 * np.pi * 2.5 * times_s)
    assert (2.0 * np.pi * 2.5) ** 2 * 10.0 < HAND_DEG_S2
    clean = cleaned(times_s, shake_deg)
    assert np.ptp(clean.angles_deg[20:-20]) > 18.0


def test_what_is_cut_off_in_motion_gets_a_way_from_rest_and_to_rest() -> None:
    times_s = np.round(np.arange(100) * STEP_S, 6)
    longer_s, angles_deg = at_rest(times_s, 90.0 * times_s, 300.0)
    assert longer_s[0] == pytest.approx(-0.3)
    assert longer_s[-1] == pytest.approx(0.99 + 0.3)
    speeds = np.diff(angles_deg) / STEP_S
    assert abs(speeds[0]) < 5.0
    assert abs(speeds[-1]) < 5.0
    assert np.abs(np.diff(speeds)).max() / STEP_S < 310.0
    assert speeds.max() == pytest.approx(90.0, abs=0.01)
    still_s, still_deg = at_rest(times_s, np.full(100, 7.0), 300.0)
    assert (still_s.tolist(), still_deg.tolist()) == (times_s.tolist(), [7.0] * 100)


def test_a_motion_beyond_the_range_is_bent_back_without_a_corner() -> None:
    times_s = np.arange(400) * STEP_S
    angles_deg = 60.0 * np.sin(times_s)
    kept = within(angles_deg, -90.0, 50.0)
    assert 49.0 < kept.max() <= 50.0
    assert np.abs(np.diff(kept, 2)).max() / STEP_S**2 < 700.0
    far = angles_deg < 35.0
    assert np.abs(kept - angles_deg)[far].max() < 0.01
    np.testing.assert_array_equal(within(angles_deg, -90.0, 59.8), np.minimum(angles_deg, 59.8))
