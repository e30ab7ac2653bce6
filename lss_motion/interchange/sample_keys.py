"""Keys of a recording whose angles are samples, at the times of samples.

The keys of a joint (`rough_keys`, `refined_keys`) start with the ends and the rests. Keys are added
until the curve fits, then keys that are not needed are removed, then the others are moved so that
more of them can be removed. Then the joints share times (`shared_keys`). A spline keeps its limits
with samples where it would not with fitted angles, so `reduce` takes these keys where
`fitted_keys` finds no fewer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from lss_motion.interchange.recorded import Curve

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]

APART: Final = 4
"""Distance, in keys, of keys that are tried at the same time. Removing a key changes a smooth curve
from two keys before it to two keys after it, and a spline only little beyond that."""

PULL: Final = 6
"""Distance, in keys, at which a key still changes a spline: by 0.27 to the power of 6, 0.04 %."""

REST_MIN_S: Final = 0.25
"""A joint at rest for this long was put there; both ends of the rest are the first keys."""

FAR_APART: Final = 12
"""As `APART`, for the last pass: splines do not influence each other over this distance, because
each key leaves a quarter of a change, so 0.02 % here."""

SHIFTS: Final = (-16, -8, -4, -2, -1, 1, 2, 4, 8, 16)
"""Shifts of a key, in samples, that are tried to reduce the error."""

ROUNDS: Final = 2
"""Rounds of moving keys and removing the keys that are no longer needed."""

SWEEPS_MAX: Final = 12
"""Rounds of removing keys. Measured: the last rounds remove less than 0.1 % of the keys."""


def rough_keys(curve: Curve) -> IntArray:
    """Return samples that fit as keys, close to the smallest number."""
    if float(np.abs(curve.values - curve.key_values[0]).max()) <= curve.tolerance_deg:
        return np.zeros(1, dtype=np.intp)
    keys = _grown(curve)
    if not curve.fits(keys):
        return keys  # There are too few candidates; the caller reports that.
    return without_plain_keys(curve, keys, APART)


def refined_keys(curve: Curve, keys: IntArray) -> IntArray:
    """Return fewer keys: keys are moved so that more of them can be removed."""
    if len(keys) == 1 or not curve.fits(keys):
        return keys
    for _ in range(ROUNDS):
        shifted = _shifted(curve, keys)
        if not curve.fits(shifted):
            break  # Rare: shifts of adjacent splines add up.
        keys = without_plain_keys(curve, shifted, APART)
    return without_plain_keys(curve, keys, FAR_APART)


def shared_keys(curves: SequenceOf[Curve], keys: SequenceOf[IntArray]) -> list[IntArray]:
    """Return keys at fewer different times: joints use the times of joints with more keys."""
    result = list(keys)
    taken_s = np.empty(0)
    for index in sorted(range(len(keys)), key=lambda index: -len(keys[index])):
        curve, own = curves[index], keys[index]
        there = np.flatnonzero(np.isin(curve.times_s, taken_s) & curve.candidates)
        if len(own) > 2 and len(there) and curve.fits(own):
            own = without_plain_keys(curve, _moved_to(curve, own, there), APART)
        result[index] = own
        taken_s = np.union1d(taken_s, curve.times_s[own])
    return result


def _moved_to(curve: Curve, keys: IntArray, there: IntArray) -> IntArray:
    """Return the keys with as many of them as fit at the samples `there`.

    A key moves to the nearest of these samples, else to the next on its other side, else it gives
    way to both.
    """
    for way in (_nearer, _farther, _both):
        for phase in range(APART):
            inner = np.flatnonzero(~np.isin(keys, there))
            tried = inner[(inner > 0) & (inner < len(keys) - 1) & (inner % APART == phase)]
            while len(tried):
                at = np.searchsorted(there, keys[tried])
                before = there[np.maximum(at - 1, 0)]
                after = there[np.minimum(at, len(there) - 1)]
                places = way(keys[tried], before, after)
                moved = np.union1d(np.delete(keys, tried), places)
                moved = moved[(moved >= keys[0]) & (moved <= keys[-1])]
                worst_deg = np.maximum.reduceat(curve.error_deg(moved), keys)
                is_bad = _is_near_bad(worst_deg > curve.tolerance_deg, tried)
                if not is_bad.any():
                    keys = moved
                    break
                tried = tried[~is_bad]
    return keys


def _nearer(keys: IntArray, before: IntArray, after: IntArray) -> IntArray:
    return np.where(np.abs(keys - before) <= np.abs(after - keys), before, after)


def _farther(keys: IntArray, before: IntArray, after: IntArray) -> IntArray:
    return np.where(np.abs(keys - before) <= np.abs(after - keys), after, before)


def _both(_keys: IntArray, before: IntArray, after: IntArray) -> IntArray:
    return np.concatenate([before, after])


def _grown(curve: Curve) -> IntArray:
    """Return keys that fit: first the rests, then the worst sample of every bad span."""
    is_candidate = curve.candidates
    rests = _rests(curve)
    keys = np.union1d([0, len(curve.times_s) - 1], rests[is_candidate[rests]])
    while True:
        error_deg = curve.error_deg(keys)
        bad = np.maximum.reduceat(error_deg, keys[:-1]) > curve.tolerance_deg
        is_open = is_candidate.copy()
        is_open[keys] = False
        error_deg[~is_open] = -1.0
        worst_deg = np.maximum.reduceat(error_deg, keys[:-1])
        bad |= _around(bad & (worst_deg < 0.0))
        spans = np.repeat(np.arange(len(keys) - 1), np.diff(keys))
        is_worst = (error_deg[: keys[-1]] == worst_deg[spans]) & (bad & (worst_deg >= 0.0))[spans]
        found = np.flatnonzero(is_worst)
        if not len(found):
            return keys
        _, first_of_span = np.unique(spans[found], return_index=True)
        keys = np.union1d(keys, found[first_of_span])


def _around(is_full: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the spans near full bad spans; a new key in one of them changes the bad one too."""
    reach = np.ones(2 * PULL + 1)
    return np.asarray(np.convolve(is_full, reach)[PULL:-PULL] > 0.0)


def _rests(curve: Curve) -> IntArray:
    """Return both ends of every rest: the joint stays within half the tolerance."""
    times_s = curve.times_s
    ends: list[int] = []
    first = 0
    low = high = float(curve.values[0])
    for index, value in enumerate(curve.values.tolist()):
        low, high = min(low, value), max(high, value)
        if high - low > 0.5 * curve.tolerance_deg:
            if times_s[index - 1] - times_s[first] >= REST_MIN_S:
                ends += [first, index - 1]
            first, low, high = index, value, value
    if times_s[-1] - times_s[first] >= REST_MIN_S:
        ends += [first, len(times_s) - 1]
    return np.array(ends, dtype=np.intp)


def without_plain_keys(curve: Curve, keys: IntArray, apart: int = FAR_APART) -> IntArray:
    """Return the keys that are needed while all others stay; those `apart` are tried together."""
    for _ in range(SWEEPS_MAX):
        before = len(keys)
        for phase in range(apart):
            tried = np.arange(1 + phase, len(keys) - 1, apart)
            while len(tried):
                error_deg = curve.error_deg(np.delete(keys, tried))
                worst_deg = np.maximum.reduceat(error_deg, keys)
                is_bad = _is_near_bad(worst_deg > curve.tolerance_deg, tried)
                if not is_bad.any():
                    keys = np.delete(keys, tried)
                    break
                tried = tried[~is_bad]
        if len(keys) == before:
            break
    return keys


def _shifted(curve: Curve, keys: IntArray) -> IntArray:
    """Return the keys, each moved to a sample nearby if that reduces the error."""
    is_candidate = curve.candidates
    keys = keys.copy()
    for phase in range(APART):
        tried = np.arange(1 + phase, len(keys) - 1, APART)
        if not len(tried):
            continue
        # Each key is judged by the samples from two keys before it to two keys after it.
        starts = keys[np.maximum(tried - APART // 2, 0)]
        starts[0] = 0
        best = np.add.reduceat(curve.error_deg(keys) ** 2, starts)
        for step in SHIFTS:
            moved = keys.copy()
            moved[tried] += step
            fits = (moved[tried] > keys[tried - 1]) & (moved[tried] < keys[tried + 1])
            fits &= is_candidate[np.clip(moved[tried], 0, len(curve.times_s) - 1)]
            moved[tried[~fits]] = keys[tried[~fits]]
            error_deg = curve.error_deg(moved)
            total = np.add.reduceat(error_deg**2, starts)
            is_within = np.maximum.reduceat(error_deg, starts) <= curve.tolerance_deg
            is_better = fits & is_within & (total < best)
            keys[tried[is_better]] = moved[tried[is_better]]
            best[is_better] = total[is_better]
    return keys


def _is_near_bad(bad_spans: NDArray[np.bool_], tried: IntArray) -> NDArray[np.bool_]:
    """Return which of the `tried` keys are the nearest to a bad span, and so its cause."""
    bad = np.flatnonzero(bad_spans)
    is_blamed = np.zeros(len(tried), dtype=np.bool_)
    # Span n lies between keys n and n + 1.
    after = np.clip(np.searchsorted(tried, bad + 1), 0, len(tried) - 1)
    before = np.maximum(after - 1, 0)
    is_nearer = bad - tried[before] <= tried[after] - bad - 1
    is_blamed[np.where(is_nearer, before, after)] = True
    return is_blamed
