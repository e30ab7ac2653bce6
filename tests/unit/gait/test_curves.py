from __future__ import annotations

import numpy as np
import pytest

from lss_motion.show.gait.curves import blend, hermite, lift, spline, through

RATIOS = np.linspace(0.0, 1.0, 2001)


def derivatives(values):
    step = RATIOS[1]
    return np.gradient(values, step), np.gradient(np.gradient(values, step), step)


@pytest.mark.parametrize(("curve", "ends"), [(blend, (0.0, 1.0)), (lift, (0.0, 0.0))])
def test_steps_leave_and_meet_the_ground_without_speed_or_acceleration(curve, ends):
    values = curve(RATIOS)
    assert (values[0], values[-1]) == ends
    assert values.max() == pytest.approx(1.0)
    assert values.min() == 0.0
    for derivative in derivatives(values):
        assert np.abs(derivative[[0, -1]]).max() < 0.2
    assert curve(np.array([-1.0, 2.0])).tolist() == list(ends)


def test_the_lift_has_the_least_acceleration_of_its_family():
    def peak(c):
        w = 4.0 * RATIOS * (1.0 - RATIOS)
        return np.abs(derivatives(w**3 * (1.0 + c * (1.0 - w)))[1]).max()

    own = np.abs(derivatives(lift(RATIOS))[1]).max()
    assert own == pytest.approx(peak(0.4), rel=1e-6)
    assert all(own < peak(c) for c in (0.0, 0.2, 0.6))


def test_a_curve_through_poses_meets_them_and_never_goes_beyond():
    times = np.array([0.0, 0.5, 1.5, 2.0])
    values = np.array([[0.0, 0.0], [10.0, 5.0], [-10.0, 6.0], [-10.0, 10.0]])
    at = np.linspace(0.0, 2.0, 401)
    curve = through(times, values, at)
    np.testing.assert_allclose(through(times, values, times), values, atol=1e-12)
    assert np.abs(curve).max() <= 10.0 + 1e-12
    assert (np.diff(curve[:, 1]) >= 0.0).all()
    speed = np.gradient(curve, at, axis=0)
    ends = through(times, values, np.array([0.0, 1e-6, 2.0 - 1e-6, 2.0]))
    assert np.abs(np.diff(ends, axis=0)[[0, 2]]).max() < 1e-9, "at rest at both ends"
    assert speed[at == 0.5][0, 1] > 1.0, "what goes on does not stop"
    assert np.abs(np.diff(speed, axis=0)).max() < 1.5, "no jump of speed"


def test_hermite_has_its_values_and_slopes():
    at = np.array([[0.0], [1e-6], [2.0 - 1e-6], [2.0]])
    ones = np.ones((4, 1))
    value = hermite(2.0, (3.0 * ones, 5.0 * ones), (1.0 * ones, -2.0 * ones), at)[:, 0]
    assert value[[0, 3]].tolist() == [3.0, 5.0]
    assert (value[1] - value[0]) / 1e-6 == pytest.approx(1.0, abs=1e-4)
    assert (value[3] - value[2]) / 1e-6 == pytest.approx(-2.0, abs=1e-4)


@pytest.mark.parametrize("count", [2, 3, 4, 40])
def test_a_spline_is_that_of_scipy_and_knows_its_peaks(count):
    from scipy.interpolate import CubicSpline

    values = np.random.default_rng(count).normal(0.0, 10.0, (count, 3))
    own = spline(0.1, values)
    peer = CubicSpline(0.1 * np.arange(count), values, bc_type="clamped")
    np.testing.assert_allclose(own.slopes, peer(0.1 * np.arange(count), 1), atol=1e-8)
    middles = peer(0.1 * (np.arange(count - 1) + 0.5))
    np.testing.assert_allclose(own.middles(), middles, atol=1e-9)
    at = np.linspace(0.0, 0.1 * (count - 1), 20_000)
    speed, accel = own.peaks()
    np.testing.assert_allclose(speed, np.abs(peer(at, 1)).max(axis=0), rtol=1e-4)
    np.testing.assert_allclose(accel, np.abs(peer(at, 2)).max(axis=0), rtol=1e-2)
    assert (speed >= np.abs(peer(at, 1)).max(axis=0) - 1e-9).all()
