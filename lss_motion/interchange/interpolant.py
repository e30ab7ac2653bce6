"""The shape of a motion between its keys, as `trajectory.curves` plans it.

Written here again because the planner stands above this package; a test holds the two together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.sequence.model import Interpolation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

LINEAR_RAMP_RATIO: Final = 0.25
"""Each ramp of a `linear` move takes this share of it, as in `trajectory.curves`."""


def interpolated(
    ease: Interpolation, key_times_s: FloatArray, key_values: FloatArray, times_s: FloatArray
) -> FloatArray:
    """Return what keys lead to at the increasing `times_s`: from rest to rest, still outside.

    `ease` is `spline`, `smooth` or `linear`.
    """
    if len(key_times_s) == 1:
        return np.full(len(times_s), key_values[0])
    # How many of the samples each span has; the last one has those after it as well.
    bounds = np.searchsorted(times_s, key_times_s[1:-1], side="left")
    counts = np.diff(np.concatenate([[0], bounds, [len(times_s)]]))
    lengths_s, moved = np.diff(key_times_s), np.diff(key_values)
    share = np.clip(
        (times_s - np.repeat(key_times_s[:-1], counts)) / np.repeat(lengths_s, counts), 0.0, 1.0
    )
    start = np.repeat(key_values[:-1], counts)
    if ease is Interpolation.LINEAR:
        return start + np.repeat(moved, counts) * _trapezoid(share)
    assert ease in {Interpolation.SMOOTH, Interpolation.SPLINE}, ease
    find_slopes = _monotone_slopes if ease is Interpolation.SMOOTH else _spline_slopes
    slopes = find_slopes(lengths_s, moved / lengths_s)
    before, after = slopes[:-1] * lengths_s, slopes[1:] * lengths_s
    cube = np.repeat(before + after - 2.0 * moved, counts)
    square = np.repeat(3.0 * moved - 2.0 * before - after, counts)
    return start + share * (np.repeat(before, counts) + share * (square + share * cube))


def _trapezoid(share: FloatArray) -> FloatArray:
    """Return the way covered of a move from rest to rest with even ramps."""
    ramp = LINEAR_RAMP_RATIO
    speed = 1.0 / (1.0 - ramp)
    rest = 1.0 - share
    up, down = 0.5 * speed * share**2 / ramp, 1.0 - 0.5 * speed * rest**2 / ramp
    cruise = speed * (share - 0.5 * ramp)
    return np.where(share < ramp, up, np.where(rest < ramp, down, cruise))


def _monotone_slopes(lengths_s: FloatArray, secants: FloatArray) -> FloatArray:
    """Return slopes at all keys, 0 at both ends and where the direction turns.

    Fritsch and Butland's weighted harmonic mean (SIAM J. Sci. Stat. Comput. 5, 1984).
    """
    before_s, after_s = lengths_s[:-1], lengths_s[1:]
    is_monotone = secants[:-1] * secants[1:] > 0.0
    before = np.where(is_monotone, secants[:-1], 1.0)
    after = np.where(is_monotone, secants[1:], 1.0)
    weight, other = 2.0 * after_s + before_s, after_s + 2.0 * before_s
    mean = (weight + other) / (weight / before + other / after)
    slopes = np.zeros(len(lengths_s) + 1)
    slopes[1:-1] = np.where(is_monotone, mean, 0.0)
    return slopes


def _spline_slopes(lengths_s: FloatArray, secants: FloatArray) -> FloatArray:
    """Return slopes that make the second derivative continuous, 0 at both ends."""
    from scipy.linalg import solve_banded

    slopes = np.zeros(len(lengths_s) + 1)
    if len(lengths_s) < 2:
        return slopes
    inverse, pulls = 1.0 / lengths_s, 3.0 * secants / lengths_s
    bands = np.zeros((3, len(slopes) - 2))
    bands[0, 1:] = inverse[1:-1]
    bands[1] = 2.0 * (inverse[:-1] + inverse[1:])
    bands[2, :-1] = inverse[1:-1]
    slopes[1:-1] = solve_banded((1, 1), bands, pulls[:-1] + pulls[1:], check_finite=False)
    return slopes
