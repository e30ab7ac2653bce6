"""Fewer keys of a spline, because the values of the keys are fitted to the recording.

Keys whose values are samples of the recording waste much of the tolerance: the curve between them
swings to one side. `fitted_keys` removes keys that are needed as samples, but not if the keys
around them get other values. A spline is linear in the coefficients of its B-splines, so the values
with the least squared error are those of a banded linear system. Large errors get more weight until
the largest error is near its least (Lawson's algorithm).

A B-spline is 0 outside four spans. Without a key, only the coefficients whose B-splines reach that
key change. The curve beyond `REACH` keys stays as it is, so keys that are twice as far apart are
tried together and accepted or refused each on its own. Where no key can be removed, no value
changes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol, Self, TypeVar

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]

REACH: Final = 4
"""Distance, in keys, from which on the curve stays as it is when a key is removed. Measured: with
one or two more coefficients that may change on both sides, 1 % fewer keys for 1.5 to 2 times the
computing."""

WEIGHTINGS: Final = 3
"""Solutions with other weights. Measured: with 8 of them, 2 % fewer keys."""

SWEEPS_MAX: Final = 3
"""Rounds of removing keys."""

RIDGE: Final = 1e-9
"""Pull of a coefficient to its old value, as a part of the largest sum of squares: it decides where
spans have fewer samples than coefficients."""

WEIGHT_LEAST: Final = 0.2
"""Least factor of a weight in one round, so that no sample is forgotten."""


Joint = TypeVar("Joint", bound="Fittable")


class Fittable(Protocol):
    """The recording of one joint, the angles of its keys, and what the spline must keep."""

    @property
    def times_s(self) -> FloatArray:
        """Times of all samples."""

    @property
    def values(self) -> FloatArray:
        """Angles of all samples."""

    @property
    def key_values(self) -> FloatArray:
        """Angles of the samples that become keys."""

    @property
    def tolerance_deg(self) -> float:
        """Largest error at a sample."""

    def with_values(self, key_values: FloatArray) -> Self:
        """Return the same recording with other angles of keys."""

    def fits(self, keys: IntArray) -> bool:
        """Return whether the error of the keys is within the tolerance."""

    def error_deg(self, keys: IntArray) -> FloatArray:
        """Return the error at all samples, above the tolerance where a limit is exceeded."""


def fitted_keys(curve: Joint, keys: IntArray, margin_deg: float) -> tuple[Joint, IntArray]:
    """Return fewer of the `keys` and the curve with their fitted values, else both unchanged.

    The error at every sample stays within the tolerance less `margin_deg` wherever a value changes,
    and the spline keeps the limits and the range of the curve. The first and the last key stay.
    """
    if len(keys) < 3 or not curve.fits(keys):
        return curve, keys
    best_deg = curve.tolerance_deg - margin_deg
    found, kept = curve, keys
    for _ in range(SWEEPS_MAX):
        before = len(kept)
        for phase in range(2 * REACH):
            tried = np.arange(1 + phase, len(kept) - 1, 2 * REACH)
            if len(tried):
                found, kept = _without(found, kept, tried, best_deg)
        if len(kept) == before:
            break
    if len(kept) == len(keys) or not found.fits(kept):
        return curve, keys
    return found, kept


def _without(
    curve: Joint, keys: IntArray, tried: IntArray, error_max_deg: float
) -> tuple[Joint, IntArray]:
    """Return the keys without those of `tried` that can be removed, and the curve with new values.

    The keys of `tried` are `2 * REACH` keys apart.
    """
    basis = _Basis.of(curve.times_s, np.delete(keys, tried))
    old = np.delete(_coefficients(curve, keys), tried + 1)
    free = _free(tried, len(old))
    windows = keys[np.maximum(tried - REACH, 0)]
    windows[0] = 0
    owner = np.repeat(np.arange(len(tried)), np.diff(np.append(windows, len(curve.times_s))))
    key_values = curve.key_values.copy()
    is_accepted = np.zeros(len(tried), dtype=np.bool_)
    weights = np.ones(len(curve.times_s))
    off = curve.values - basis.at_samples(old)
    for _ in range(WEIGHTINGS):
        coefficients = old + basis.solved(weights, off, free)
        fitted = basis.at_samples(coefficients)
        values = curve.key_values.copy()
        values[basis.keys] = fitted[basis.keys]
        error_deg = curve.with_values(values).error_deg(basis.keys)
        is_within = np.maximum.reduceat(error_deg, windows) <= error_max_deg
        is_new = is_within & ~is_accepted
        key_values = np.where(is_new[owner], values, key_values)
        is_accepted |= is_within
        if is_accepted.all():
            break
        rest = np.abs(fitted - curve.values)
        worst = np.maximum(np.maximum.reduceat(rest, windows), RIDGE)
        weights *= WEIGHT_LEAST + rest / worst[owner]
    if not is_accepted.any():
        return curve, keys
    return curve.with_values(key_values), np.delete(keys, tried[is_accepted])


def _free(tried: IntArray, count: int) -> NDArray[np.bool_]:
    """Return which of the `count` coefficients without the keys of `tried` may change.

    The first two and the last two stay: they are the value and the slope at an end.
    """
    places = (tried - np.arange(len(tried)) - 1)[:, None] + np.arange(4)
    free = np.zeros(count, dtype=np.bool_)
    free[np.clip(places, 0, count - 1)] = True
    free[:2] = free[-2:] = False
    return free


def _coefficients(curve: Fittable, keys: IntArray) -> FloatArray:
    """Return the coefficients of the B-splines of the curve through the keys."""
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(curve.times_s[keys], curve.key_values[keys], 3, bc_type="clamped")
    return np.asarray(spline.c)


class _Basis:
    """The B-splines of some keys at all samples."""

    def __init__(self, keys: IntArray, rows: FloatArray, firsts: IntArray) -> None:
        self.keys = keys
        self._rows = rows
        """For each of the four B-splines that are not 0 at a sample."""
        self._firsts = firsts
        self._pairs = [
            (one, other, rows[one] * rows[other]) for one in range(4) for other in range(one, 4)
        ]

    @classmethod
    def of(cls, times_s: FloatArray, keys: IntArray) -> _Basis:
        """Return the B-splines of keys of which the first and the last are at the ends."""
        from scipy.interpolate import BSpline

        knots_s = times_s[keys]
        padded_s = np.concatenate([np.repeat(knots_s[:1], 3), knots_s, np.repeat(knots_s[-1:], 3)])
        rows = BSpline.design_matrix(times_s, padded_s, 3).data.reshape(-1, 4)
        counts = np.diff(keys)
        counts[-1] += 1
        return cls(keys, np.ascontiguousarray(rows.T), np.repeat(np.arange(len(counts)), counts))

    def at_samples(self, coefficients: FloatArray) -> FloatArray:
        """Return the spline at all samples."""
        values: FloatArray = self._rows[0] * coefficients[self._firsts]
        for one in range(1, 4):
            values += self._rows[one] * coefficients[self._firsts + one]
        return values

    def solved(
        self, weights: FloatArray, wanted: FloatArray, free: NDArray[np.bool_]
    ) -> FloatArray:
        """Return the coefficients of the least weighted squared error; 0 unless `free`."""
        from scipy.linalg import solveh_banded

        starts, count = self.keys[:-1], len(self.keys) - 1
        band, right = np.zeros((4, len(free))), np.zeros(len(free))
        weighted = weights * wanted
        for one in range(4):
            right[one : one + count] += np.add.reduceat(weighted * self._rows[one], starts)
        for one, other, product in self._pairs:
            sums = np.add.reduceat(weights * product, starts)
            band[other - one, one : one + count] += sums
        band[0] += RIDGE * band[0].max()
        right[~free] = 0.0
        for apart in range(1, 4):
            band[apart, :-apart] *= free[:-apart] & free[apart:]
        return np.asarray(solveh_banded(band, right, lower=True, check_finite=False))
