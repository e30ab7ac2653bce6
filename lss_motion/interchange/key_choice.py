"""Which samples of a recorded curve are its keys: the fewest that can be found in reasonable time.

Keys grow from the ends and rests until the curve fits, then what is not needed goes, then the rest
is moved to where more of it can go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.interchange.interpolant import Spans
from lss_motion.sequence.model import Interpolation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.interchange.interpolant import FloatArray, IntArray

APART: Final = 4
"""Keys tried at once are so many apart: taking one out changes a smooth curve from two keys before
it to two after it, and a spline little beyond that."""

PULL: Final = 6
"""How many keys away a key still bends a spline: by 0.27 to the power of this, 0.04 %."""

OUT_DEG: Final = 1e-7
"""Rounding of a spline that rests at the end of a range."""

EXCESS_SLACK: Final = 5e-5
"""Half of what the planner takes for rounding (`trajectory.solve.FEASIBLE_RATIO`)."""

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One joint's recording, how far its keys may lead away from it, and how hard they may drive.

    `key_values` are the angles that samples have as keys. `speed_max_deg_s`, `accel_max_deg_s2`:
    what a spline may ask for around each sample; infinite where nobody minds. It may not leave
    `range_deg` either, unless a key does.
    """

    times_s: FloatArray
    values: FloatArray
    key_values: FloatArray
    speed_max_deg_s: FloatArray
    accel_max_deg_s2: FloatArray
    tolerance_deg: float
    ease: Interpolation
    range_deg: tuple[float, float] = (-np.inf, np.inf)
    step_s: float = 0.0
    """0, or only the samples next to its multiples may be keys."""

    @property
    def candidates(self) -> NDArray[np.bool_]:
        """Which samples may be keys."""
        if self.step_s == 0.0:
            return np.ones(len(self.times_s), dtype=np.bool_)
        return np.concatenate([[True], np.diff(np.round(self.times_s / self.step_s)) > 0.0])

    def fits(self, keys: IntArray) -> bool:
        return float(self.error_deg(keys).max()) <= self.tolerance_deg

    def error_deg(self, keys: IntArray) -> FloatArray:
        """Return how far the keys (the first and the last sample among them) lead away.

        A span that asks for more than it may counts as off by more than the tolerance, most so in
        its middle.
        """
        counts = np.diff(keys)
        counts[-1] += 1
        spans = Spans.between(self.ease, self.times_s[keys], self.key_values[keys])
        error_deg = spans.at(self.times_s, counts)
        error_deg -= self.values
        np.abs(error_deg, out=error_deg)
        if self.ease is Interpolation.SPLINE:
            self._blame(keys, spans, error_deg)
        return error_deg

    def _blame(self, keys: IntArray, spans: Spans, error_deg: FloatArray) -> None:
        speed, accel = spans.peaks()
        excess = np.maximum(
            speed / _most(self.speed_max_deg_s, keys), accel / _most(self.accel_max_deg_s2, keys)
        )
        low_deg, high_deg = spans.extremes()
        is_out = (low_deg < self.range_deg[0] - OUT_DEG) | (high_deg > self.range_deg[1] + OUT_DEG)
        for span in np.flatnonzero(is_out | (excess > 1.0 + EXCESS_SLACK)).tolist():
            first, last = int(keys[span]), int(keys[span + 1])
            off = 2.0 * np.abs(np.arange(first, last) - 0.5 * (first + last)) / (last - first)
            blame_deg = self.tolerance_deg * (1.0 + float(excess[span]) * (1.5 - off))
            np.maximum(error_deg[first:last], blame_deg, out=error_deg[first:last])


def _most(per_sample: FloatArray, keys: IntArray) -> FloatArray:
    """Return the largest value of each span, both of its keys included."""
    inside = np.maximum.reduceat(per_sample, keys[:-1])
    return np.maximum(inside, per_sample[keys[1:]])


def rough_keys(curve: Curve) -> IntArray:
    """Return samples that fit as keys, nearly the fewest."""
    if float(np.abs(curve.values - curve.key_values[0]).max()) <= curve.tolerance_deg:
        return np.zeros(1, dtype=np.intp)
    keys = _grown(curve)
    if not curve.fits(keys):
        return keys  # The candidates are too few: the caller will say so.
    return _pruned(curve, keys, APART)


def refined_keys(curve: Curve, keys: IntArray) -> IntArray:
    """Return fewer keys yet: moved to where more of them can go."""
    if len(keys) == 1 or not curve.fits(keys):
        return keys
    for _ in range(ROUNDS):
        shifted = _shifted(curve, keys)
        if not curve.fits(shifted):
            break  # Splines that were shifted side by side; rare.
        keys = _pruned(curve, shifted, APART)
    return _pruned(curve, keys, FAR_APART)


def _grown(curve: Curve) -> IntArray:
    """Return keys that fit: from all rests on, the worst sample of every bad span becomes a key."""
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
    """Return the spans near those that are bad with no sample left: their keys pull at these."""
    reach = np.ones(2 * PULL + 1)
    return np.asarray(np.convolve(is_full, reach)[PULL:-PULL] > 0.0)


def _rests(curve: Curve) -> IntArray:
    """Return both ends of every stretch in which a joint stays within half the tolerance."""
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


def _pruned(curve: Curve, keys: IntArray, apart: int) -> IntArray:
    """Return the keys without those that are not needed, tried `apart` keys from each other."""
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
    """Return the keys, each moved to a sample nearby where that brings the curve closer."""
    is_candidate = curve.candidates
    keys = keys.copy()
    for phase in range(APART):
        tried = np.arange(1 + phase, len(keys) - 1, APART)
        if not len(tried):
            continue
        # Each has the samples from two keys before it to two after it for itself.
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
    """Return which of the `tried` keys to blame for spans gone bad: the nearest of each."""
    bad = np.flatnonzero(bad_spans)
    is_blamed = np.zeros(len(tried), dtype=np.bool_)
    # Span n lies between keys n and n + 1.
    after = np.clip(np.searchsorted(tried, bad + 1), 0, len(tried) - 1)
    before = np.maximum(after - 1, 0)
    is_nearer = bad - tried[before] <= tried[after] - bad - 1
    is_blamed[np.where(is_nearer, before, after)] = True
    return is_blamed
