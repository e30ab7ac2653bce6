"""Slopes of piecewise cubics, compared with those of scipy, and runs of flags."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator

from lss_motion.show.splines import clamped_slopes, monotone_slopes, runs


def knots(count: int, columns: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Return increasing times and values, (count, columns); every fourth value repeats."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(-90.0, 90.0, (count, columns))
    values[3::4] = values[2::4][: len(values[3::4])]
    return np.cumsum(rng.uniform(0.01, 1.0, count)), values


@pytest.mark.parametrize("count", [3, 4, 40])
def test_monotone_slopes_are_those_of_pchip_at_inner_knots(count):
    times_s, values = knots(count, 3)
    lengths_s = np.diff(times_s)
    secants = np.diff(values, axis=0) / lengths_s[:, None]
    expected = PchipInterpolator(times_s, values).derivative()(times_s)[1:-1]
    np.testing.assert_allclose(monotone_slopes(lengths_s, secants), expected, atol=1e-9)
    np.testing.assert_array_equal(
        monotone_slopes(lengths_s, secants[:, 1]), monotone_slopes(lengths_s, secants)[:, 1]
    )


@pytest.mark.parametrize("with_scipy", [False, True])
@pytest.mark.parametrize("count", [2, 3, 4, 40])
@pytest.mark.parametrize("ends", [(0.0, 0.0), (12.0, -7.5)])
def test_clamped_slopes_are_those_of_a_clamped_cubic_spline(count, ends, with_scipy):
    times_s, values = knots(count, 3)
    lengths_s = np.diff(times_s)
    secants = np.diff(values, axis=0) / lengths_s[:, None]
    start, end = (np.full(3, slope) for slope in ends)
    spline = CubicSpline(times_s, values, bc_type=((1, start), (1, end)))
    found = clamped_slopes(lengths_s, secants, start=ends[0], end=ends[1], with_scipy=with_scipy)
    np.testing.assert_allclose(found, spline(times_s, 1), atol=1e-7)
    single = clamped_slopes(
        lengths_s, secants[:, 2], start=ends[0], end=ends[1], with_scipy=with_scipy
    )
    np.testing.assert_allclose(single, found[:, 2], atol=1e-9)


def test_no_inner_knot_has_no_monotone_slope():
    assert monotone_slopes(np.ones(1), np.ones(1)).shape == (0,)


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ("", []),
        ("....", []),
        ("####", [(0, 4)]),
        ("#..##.#", [(0, 1), (3, 5), (6, 7)]),
        (".##.", [(1, 3)]),
    ],
)
def test_runs_of_set_flags(flags, expected):
    assert runs(np.array([flag == "#" for flag in flags], dtype=bool)) == expected
