"""Slopes of piecewise cubics, lines near a curve, runs of set flags. Numbers in, numbers out.

`lengths_s` are the lengths of the n pieces between n + 1 knots, `secants` the mean slope of each
piece: (n,), or (n, k) for k curves over the same knots.

scipy has the same slopes (`PchipInterpolator`, `CubicSpline`), but its numbers differ from these in
the last bits, and plans must stay the same to the bit. Its import also takes longer than a plan.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Number = TypeVar("Number", bound=np.number)

    FloatArray = NDArray[np.float64]


def distinct(values: NDArray[Number]) -> NDArray[Number]:
    """Return the different ones of `values`, which have any shape, in ascending order.

    `np.unique` without options imports `numpy.ma`, which takes a tenth of the start of a command.
    """
    ordered = np.sort(values, axis=None)
    return ordered[np.append(True, ordered[1:] != ordered[:-1])] if ordered.size else ordered


def monotone_slopes(lengths_s: FloatArray, secants: FloatArray) -> FloatArray:
    """Return the slopes at the n - 1 inner knots with which the curve never overshoots a knot.

    The slope is 0 where the secants differ in sign or one of them is 0. Weighted harmonic mean of
    Fritsch and Butland (SIAM J. Sci. Stat. Comput. 5, 1984).
    """
    lengths_s = _by_row(lengths_s, secants)
    before_s, after_s = lengths_s[:-1], lengths_s[1:]
    before, after = secants[:-1], secants[1:]
    is_monotone = before * after > 0.0
    before, after = np.where(is_monotone, before, 1.0), np.where(is_monotone, after, 1.0)
    weight, other = 2.0 * after_s + before_s, after_s + 2.0 * before_s
    mean = (weight + other) / (weight / before + other / after)
    return np.where(is_monotone, mean, 0.0)


def clamped_slopes(
    lengths_s: FloatArray,
    secants: FloatArray,
    *,
    start: float = 0.0,
    end: float = 0.0,
    with_scipy: bool = False,
) -> FloatArray:
    """Return the slopes at all n + 1 knots that make the second derivative continuous.

    `start` and `end` are the slopes at the first and the last knot. `with_scipy` solves the
    tridiagonal system with LAPACK: much faster for thousands of knots, but scipy has to be imported
    first. Both ways agree within rounding, not to the bit.
    """
    slopes = np.zeros((len(lengths_s) + 1, *secants.shape[1:]))
    slopes[0], slopes[-1] = start, end
    if len(lengths_s) < 2:
        return slopes
    inverse, pulls = 1.0 / lengths_s, 3.0 * secants / _by_row(lengths_s, secants)
    solve = _solved_by_scipy if with_scipy else _solved
    slopes[1:-1] = solve(inverse, pulls[:-1] + pulls[1:], start, end)
    return slopes


def _by_row(lengths_s: FloatArray, secants: FloatArray) -> FloatArray:
    """Return `lengths_s` in the shape that is broadcast over the columns of `secants`."""
    return lengths_s if secants.ndim == 1 else lengths_s[:, None]


def _solved(inverse: FloatArray, right: FloatArray, start: float, end: float) -> FloatArray:
    """Solve the system by Thomas elimination; it is diagonally dominant and needs no pivoting."""
    coefficients = inverse.tolist()
    # Python's numbers are faster than arrays of one element.
    rows = right.tolist() if right.ndim == 1 else list(right)
    factors, partial = [0.0], [start]
    for before, after, row in zip(coefficients, coefficients[1:], rows, strict=False):
        pivot = 2.0 * (before + after) - before * factors[-1]
        factors.append(after / pivot)
        partial.append((row - before * partial[-1]) / pivot)
    solved = [end]
    for value, factor in zip(partial[:0:-1], factors[:0:-1], strict=True):
        solved.append(value - factor * solved[-1])
    return np.array(solved[:0:-1])


def _solved_by_scipy(
    inverse: FloatArray, right: FloatArray, start: float, end: float
) -> FloatArray:
    from scipy.linalg import solve_banded

    right[0] -= inverse[0] * start
    right[-1] -= inverse[-1] * end
    bands = np.zeros((3, len(right)))
    bands[0, 1:] = inverse[1:-1]
    bands[1] = 2.0 * (inverse[:-1] + inverse[1:])
    bands[2, :-1] = inverse[1:-1]
    return np.asarray(solve_banded((1, 1), bands, right, check_finite=False))


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return (first, end) of every run of set flags; `end` is the first index after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True))


def near_runs(flags: NDArray[np.bool_], gap: int) -> list[tuple[int, int]]:
    """Return the runs of set flags; those less than `gap` apart are one."""
    found: list[tuple[int, int]] = []
    for first, end in runs(flags):
        if found and first - found[-1][1] < gap:
            found[-1] = (found[-1][0], end)
        else:
            found.append((first, end))
    return found


def polyline(times_s: FloatArray, values: FloatArray, tolerance: float) -> NDArray[np.intp]:
    """Return samples, first and last included, between which lines stay within the tolerance.

    The worst sample of each line that is too far off is added until there is none.
    """
    kept = np.array([0, len(times_s) - 1], dtype=np.intp)
    while True:
        off = np.abs(np.interp(times_s, times_s[kept], values[kept]) - values)
        worst = np.maximum.reduceat(off, kept[:-1])
        spans = np.repeat(np.arange(len(kept) - 1), np.diff(kept))
        is_worst = (off[: kept[-1]] == worst[spans]) & (worst > tolerance)[spans]
        found = np.flatnonzero(is_worst)
        if not len(found):
            return kept
        _, first = np.unique(spans[found], return_index=True)
        kept = np.union1d(kept, found[first])
