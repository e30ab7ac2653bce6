"""Which samples of a recorded curve are its keys: the fewest that can be found in reasonable time.

Keys grow from the ends and rests until the curve fits, then what is not needed goes, then the rest
is moved to where more of it can go.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.interchange.interpolant import interpolated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.interchange.reader import Channel, FloatArray
    from lss_motion.sequence.model import Interpolation

    IntArray = NDArray[np.intp]

APART: Final = 4
"""Keys tried at once are so many apart: taking one out changes a smooth curve from two keys before
it to two after it, and a spline little beyond that."""

REST_MIN_S: Final = 0.25
"""A joint that stays for so long was put there; its corners are the first keys to try."""

FAR_APART: Final = 12
"""For the last keys: so far apart not even splines touch each other (each key on the way leaves a
quarter of a change, so 0.02 % here)."""

SHIFTS: Final = (-16, -8, -4, -2, -1, 1, 2, 4, 8, 16)
"""How many samples a key is moved at a time to bring the curve closer."""

ROUNDS: Final = 2
"""Rounds of moving keys and taking out what that frees."""

SWEEPS_MAX: Final = 12
"""Rounds of taking out keys. Measured: the last rounds of recordings take out less than 0.1 %."""


def rough_keys(
    channel: Channel, tolerance_deg: float, ease: Interpolation, step_s: float
) -> IntArray:
    """Return samples that fit as keys, nearly the fewest; candidates are those of `_candidates`."""
    times_s, values = channel.times_s, channel.values
    if float(np.abs(values - values[0]).max()) <= tolerance_deg:
        return np.zeros(1, dtype=np.intp)
    is_candidate = _candidates(times_s, step_s)
    keys = _grown(times_s, values, tolerance_deg, ease, is_candidate)
    if float(_error_deg(times_s, values, keys, ease).max()) > tolerance_deg:
        return keys  # The candidates are too few: the caller will say so.
    return _pruned(times_s, values, tolerance_deg, ease, keys, APART)


def refined_keys(
    channel: Channel, tolerance_deg: float, ease: Interpolation, step_s: float, keys: IntArray
) -> IntArray:
    """Return fewer keys yet: moved to where more of them can go."""
    times_s, values = channel.times_s, channel.values
    if float(_error_deg(times_s, values, keys, ease).max()) > tolerance_deg:
        return keys
    for _ in range(ROUNDS):
        shifted = _shifted(times_s, values, tolerance_deg, ease, keys, _candidates(times_s, step_s))
        if float(_error_deg(times_s, values, shifted, ease).max()) > tolerance_deg:
            break  # Splines that were shifted side by side; rare.
        keys = _pruned(times_s, values, tolerance_deg, ease, shifted, APART)
    return _pruned(times_s, values, tolerance_deg, ease, keys, FAR_APART)


def _candidates(times_s: FloatArray, step_s: float) -> NDArray[np.bool_]:
    """Return which samples may be keys: all, or with `step_s` those next to its multiples."""
    if step_s == 0.0:
        return np.ones(len(times_s), dtype=np.bool_)
    return np.concatenate([[True], np.diff(np.round(times_s / step_s)) > 0.0])


def _error_deg(
    times_s: FloatArray, values: FloatArray, keys: IntArray, ease: Interpolation
) -> FloatArray:
    return np.abs(interpolated(ease, times_s[keys], values[keys], times_s) - values)


def _grown(
    times_s: FloatArray,
    values: FloatArray,
    tolerance_deg: float,
    ease: Interpolation,
    is_candidate: NDArray[np.bool_],
) -> IntArray:
    """Return keys that fit: from all rests on, the worst sample of every bad span becomes a key."""
    rests = _rests(times_s, values, tolerance_deg)
    keys = np.union1d([0, len(times_s) - 1], rests[is_candidate[rests]])
    while True:
        error_deg = _error_deg(times_s, values, keys, ease)
        bad = np.maximum.reduceat(error_deg, keys[:-1]) > tolerance_deg
        is_open = is_candidate.copy()
        is_open[keys] = False
        error_deg[~is_open] = -1.0
        worst_deg = np.maximum.reduceat(error_deg, keys[:-1])
        spans = np.repeat(np.arange(len(keys) - 1), np.diff(keys))
        is_worst = (error_deg[: keys[-1]] == worst_deg[spans]) & (bad & (worst_deg >= 0.0))[spans]
        found = np.flatnonzero(is_worst)
        if not len(found):
            return keys
        _, first_of_span = np.unique(spans[found], return_index=True)
        keys = np.union1d(keys, found[first_of_span])


def _rests(times_s: FloatArray, values: FloatArray, tolerance_deg: float) -> IntArray:
    """Return both ends of every stretch in which a joint stays within half the tolerance."""
    ends: list[int] = []
    first = 0
    low = high = float(values[0])
    for index, value in enumerate(values.tolist()):
        low, high = min(low, value), max(high, value)
        if high - low > 0.5 * tolerance_deg:
            if times_s[index - 1] - times_s[first] >= REST_MIN_S:
                ends += [first, index - 1]
            first, low, high = index, value, value
    if times_s[-1] - times_s[first] >= REST_MIN_S:
        ends += [first, len(times_s) - 1]
    return np.array(ends, dtype=np.intp)


def _pruned(
    times_s: FloatArray,
    values: FloatArray,
    tolerance_deg: float,
    ease: Interpolation,
    keys: IntArray,
    apart: int,
) -> IntArray:
    """Return the keys without those that are not needed, tried `apart` keys from each other."""
    for _ in range(SWEEPS_MAX):
        before = len(keys)
        for phase in range(apart):
            tried = np.arange(1 + phase, len(keys) - 1, apart)
            while len(tried):
                error_deg = _error_deg(times_s, values, np.delete(keys, tried), ease)
                worst_deg = np.maximum.reduceat(error_deg, keys)
                is_bad = _is_near_bad(worst_deg > tolerance_deg, tried)
                if not is_bad.any():
                    keys = np.delete(keys, tried)
                    break
                tried = tried[~is_bad]
        if len(keys) == before:
            break
    return keys


def _shifted(
    times_s: FloatArray,
    values: FloatArray,
    tolerance_deg: float,
    ease: Interpolation,
    keys: IntArray,
    is_candidate: NDArray[np.bool_],
) -> IntArray:
    """Return the keys, each moved to a sample nearby where that brings the curve closer."""
    keys = keys.copy()
    for phase in range(APART):
        tried = np.arange(1 + phase, len(keys) - 1, APART)
        if not len(tried):
            continue
        # Each has the samples from two keys before it to two after it for itself.
        starts = keys[np.maximum(tried - APART // 2, 0)]
        starts[0] = 0
        best = np.add.reduceat(_error_deg(times_s, values, keys, ease) ** 2, starts)
        for step in SHIFTS:
            moved = keys.copy()
            moved[tried] += step
            fits = (moved[tried] > keys[tried - 1]) & (moved[tried] < keys[tried + 1])
            fits &= is_candidate[np.clip(moved[tried], 0, len(times_s) - 1)]
            moved[tried[~fits]] = keys[tried[~fits]]
            error_deg = _error_deg(times_s, values, moved, ease)
            total = np.add.reduceat(error_deg**2, starts)
            is_within = np.maximum.reduceat(error_deg, starts) <= tolerance_deg
            is_better = fits & is_within & (total < best)
            keys[tried[is_better]] = moved[tried[is_better]]
            best[is_better] = total[is_better]
    return keys


def _is_near_bad(bad_spans: NDArray[np.bool_], tried: IntArray) -> NDArray[np.bool_]:
    """Return which of the `tried` keys to blame for spans gone bad: the nearest of each."""
    bad = np.flatnonzero(bad_spans)
    is_blamed = np.zeros(len(tried), dtype=np.bool_)
    # Span n lies between keys n and n + 1.
    after = np.clip(np.searchsorted(tried, bad + 1), 0, len(tried) - 1)
    before = np.maximum(after - 1, 0)
    is_nearer = bad - tried[before] <= tried[after] - bad - 1
    is_blamed[np.where(is_nearer, before, after)] = True
    return is_blamed
