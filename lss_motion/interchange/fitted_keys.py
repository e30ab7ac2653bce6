"""Few keys with fitted angles at few instants, for joints that were sampled at the same times.

Keys whose angles are samples waste much of the tolerance: the curve between them swings to one
side. So angles are fitted: least squares, in which large errors get more weight until the largest
error is near its least (Lawson's algorithm). And keys of different joints are at the same instants:
a keyframe that holds many joints is easier to read and to edit than many keyframes that hold one.

`fitted_together` begins with keys of all joints at even instants, and puts one more into the middle
of every span in which a joint does not fit, until all do. Then each joint on its own loses the keys
that it does not need (`without_spare_keys`), and its other keys move to other instants where that
lets more of them be removed (`moved_keys`).

A spline that has limits to keep is pulled back where its acceleration exceeds them, in the same
equations: the acceleration at a key depends on three coefficients.

A curve depends on parameters: the coefficients of B-splines for `spline`, the angles of the keys
for `smooth` and `linear`. The value at a sample depends on four of them, those of the keys around
it, so a removed or moved key changes a few parameters, and the curve beyond `REACH` keys stays as
it is. Keys that are twice as far apart are tried together, and accepted or refused each on its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.interchange.recorded import Spans, trapezoid_share
from lss_motion.show.model import Interpolation
from lss_motion.show.splines import monotone_slopes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.interchange.recorded import Recorded

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]
    BoolArray = NDArray[np.bool_]

REACH: Final = 4
"""Distance, in keys, from which on the curve stays as it is when a key is removed or moved."""

STARTS_S: Final = (1.0, 1.4)
"""Distances of the first instants; the one that ends with fewer is taken. Measured: with four of
them 2 % fewer keys for 1.3 times the computing."""

REFINEMENTS_MAX: Final = 16
"""Rounds of more instants: from 1.4 s to 0.02 ms."""

GLOBAL_WEIGHTINGS: Final = 8
WEIGHTINGS: Final = 3
"""Solutions with other weights: of a whole joint, and when a key is tried."""

SWEEPS_MAX: Final = 2
"""Rounds of removing keys, before and after each round of moves. Measured: a third removes none."""

MOVES: Final = 2
"""Rounds of moving keys and removing those that are no longer needed. Measured: 8 % fewer keys
after one, 1 % after the second."""

STEPS: Final = (-1, 1)
SINGLE_STEPS: Final = (-4, -2, -1, 1, 2, 4)
"""Where a key is tried: at the next of the shared instants, or if no other joint shares them, so
many samples away."""

GAIN_RATIO: Final = 0.98
"""A key moves where the sum of the fourth powers of the errors around it falls below this ratio.
The power is between least squares and the largest error. Chosen."""

RIDGE: Final = 1e-9
"""Pull of a parameter to its old value, as a part of the largest sum of squares: it decides where
spans have fewer samples than parameters."""

PULL: Final = 1.0
PULL_GROWTH: Final = 4.0
"""Weight of an acceleration beyond its limit, as a move of its coefficient in units of the samples
around it, and its growth in each solution in which it still is. Measured: with a first weight of 1,
a spline at its limits has as many keys as one without limits."""

BEND_RATIO: Final = 0.995
"""A pulled acceleration aims at this share of its limit, which it meets after a few solutions."""

WEIGHT_LEAST: Final = 0.2
"""Least factor of a weight in one round, so that no sample is forgotten."""


def fitted_together(
    curves: Sequence[Recorded], instants_max: int, margin_deg: float
) -> tuple[list[Recorded], list[IntArray]] | None:
    """Return the curves with fitted angles, and the keys of each.

    The error at every sample stays within the tolerance less `margin_deg`, and a spline keeps its
    limits and its range. None if that takes more than `instants_max` instants at first.
    """
    best: tuple[list[Recorded], IntArray] | None = None
    for start_s in STARTS_S:
        most = instants_max if best is None else min(instants_max, len(best[1]) - 1)
        found = _refined(curves, start_s, most, margin_deg)
        best = best if found is None else found
    if best is None:
        return None
    made, shared = best
    keys_of = [shared for _ in made]
    for index, curve in enumerate(made):
        made[index], keys_of[index] = without_spare_keys(curve, shared, margin_deg)
    for _ in range(MOVES):
        instants = np.unique(np.concatenate(keys_of))
        for index, curve in enumerate(made):
            places = instants if len(made) > 1 else np.arange(len(curve.times_s))
            steps = STEPS if len(made) > 1 else SINGLE_STEPS
            moved, keys = moved_keys(curve, keys_of[index], places, steps, margin_deg)
            made[index], keys_of[index] = without_spare_keys(moved, keys, margin_deg)
    return made, keys_of


def _refined(
    curves: Sequence[Recorded], start_s: float, most: int, margin_deg: float
) -> tuple[list[Recorded], IntArray] | None:
    """Return curves that fit with keys at the same instants; None if `most` are not enough."""
    keys = _even(curves[0].times_s, start_s)
    for _ in range(REFINEMENTS_MAX):
        if len(keys) > most:
            return None
        pairs = [_fit_all(curve, keys) for curve in curves]
        is_bad = np.zeros(len(keys) - 1, dtype=np.bool_)
        for curve, (_, error_deg) in zip(curves, pairs, strict=True):
            is_bad |= _worst(error_deg, keys[:-1]) > curve.tolerance_deg - margin_deg
        if not is_bad.any():
            return [curve for curve, _ in pairs], keys
        is_open = np.diff(keys) > 1
        if not (is_bad & is_open).any():  # A limit is exceeded between samples beside it.
            is_bad = np.convolve(is_bad, np.ones(2 * REACH + 1))[REACH:-REACH] > 0.0
        spans = np.flatnonzero(is_bad & is_open)
        if not len(spans):
            return None
        keys = np.union1d(keys, (keys[spans] + keys[spans + 1]) // 2)
    return None


def _even(times_s: FloatArray, step_s: float) -> IntArray:
    """Return samples about `step_s` apart, with the first and the last."""
    count = max(1, round(float(times_s[-1] - times_s[0]) / step_s))
    even_s = np.linspace(times_s[0], times_s[-1], count + 1)
    return np.unique([*np.searchsorted(times_s, even_s[:-1]).tolist(), len(times_s) - 1])


def _fit_all(curve: Recorded, keys: IntArray) -> tuple[Recorded, FloatArray]:
    """Return the curve with the angles that fit best, and its errors."""
    parameters = _Parameters.of(curve, keys)
    spans = np.repeat(np.arange(len(keys) - 1), _counts(keys))
    weights = np.ones(len(curve.times_s))
    best: tuple[float, Recorded, FloatArray] | None = None
    values = parameters.begin()
    for _ in range(GLOBAL_WEIGHTINGS):
        values = values + parameters.step(values, weights, parameters.inner)
        made = parameters.curve(values)
        error_deg = made.error_deg(keys)
        worst_deg = _worst(error_deg, keys[:-1])
        bad = float(np.maximum(worst_deg - curve.tolerance_deg, 0.0).sum())
        if best is None or bad < best[0]:
            best = bad, made, error_deg
        if bad == 0.0:
            break
        rest = np.abs(parameters.at_samples(values) - curve.values)
        weights *= WEIGHT_LEAST + rest / np.maximum(_worst(rest, keys[:-1]), RIDGE)[spans]
    assert best is not None
    return best[1], best[2]


def without_spare_keys(
    curve: Recorded, keys: IntArray, margin_deg: float
) -> tuple[Recorded, IntArray]:
    """Return fewer of the `keys` and the curve with their fitted angles.

    The error at every sample stays within the tolerance less `margin_deg` wherever an angle
    changes. The first and the last key stay.
    """
    for _ in range(SWEEPS_MAX):
        made, fewer = curve, keys
        for phase in range(2 * REACH):
            tried = np.arange(1 + phase, len(fewer) - 1, 2 * REACH)
            if len(tried):
                trial = _KeyTrial(made, fewer, tried)
                is_fine, made = trial.removed(curve.tolerance_deg - margin_deg)
                fewer = np.delete(fewer, tried[is_fine])
        if len(fewer) == len(keys) or not made.fits(fewer):
            break
        curve, keys = made, fewer
    return curve, keys


def moved_keys(
    curve: Recorded, keys: IntArray, places: IntArray, steps: Sequence[int], margin_deg: float
) -> tuple[Recorded, IntArray]:
    """Return the keys, each moved by one of `steps` among `places` if that reduces the errors.

    The keys are among the `places`.
    """
    for phase in range(2 * REACH):
        tried = np.arange(1 + phase, len(keys) - 1, 2 * REACH)
        if not len(tried):
            continue
        at = np.searchsorted(places, keys[tried])
        windows, owner = _windows(keys, tried)
        best = GAIN_RATIO * np.add.reduceat(curve.error_deg(keys) ** 4, windows)
        chosen, values = keys[tried].copy(), curve.key_values.copy()
        old = _Parameters.of(curve, keys).present()
        for step in (0, *steps):
            aims = places[np.clip(at + step, 0, len(places) - 1)]
            is_free = (aims > keys[tried - 1]) & (aims < keys[tried + 1])
            aims = np.where(is_free, aims, keys[tried])
            trial = _KeyTrial(curve, keys, tried, aims, old)
            made, error_deg = trial.moved()
            total = np.add.reduceat(error_deg**4, windows)
            is_fine = _worst(error_deg, windows) <= curve.tolerance_deg - margin_deg
            is_better = is_free & is_fine & (total < best)
            best, chosen = np.where(is_better, total, best), np.where(is_better, aims, chosen)
            values = np.where(is_better[owner], made.key_values, values)
        moved, after = curve.with_values(values), keys.copy()
        after[tried] = chosen
        if moved.fits(after):
            curve, keys = moved, after
    return curve, keys


def _windows(keys: IntArray, tried: IntArray) -> tuple[IntArray, IntArray]:
    """Return the first sample of the part that each tried key changes, and the part of samples."""
    firsts = keys[np.maximum(tried - REACH, 0)]
    firsts[0] = 0
    owner = np.repeat(np.arange(len(tried)), np.diff(np.append(firsts, keys[-1] + 1)))
    return firsts, owner


class _KeyTrial:
    """Keys of a joint of which some, far apart, are removed or moved, with other angles around."""

    def __init__(
        self,
        curve: Recorded,
        keys: IntArray,
        tried: IntArray,
        aims: IntArray | None = None,
        old: FloatArray | None = None,
    ) -> None:
        """Take the keys to try, as indices of `keys`; `aims` are the samples to move them to.

        `old` are the parameters of the curve, if they are known.
        """
        self._curve = curve
        self._windows, self._owner = _windows(keys, tried)
        old = _Parameters.of(curve, keys).present() if old is None else old
        if aims is None:
            old, first, self._keys = (
                np.delete(old, tried + 1),
                tried - np.arange(len(tried)),
                (np.delete(keys, tried)),
            )
            places = (first - 1)[:, None] + np.arange(4)
        else:
            self._keys = keys.copy()
            self._keys[tried] = aims
            places = (tried - 1)[:, None] + np.arange(5)
        self._old, self._parameters = old, _Parameters.of(curve, self._keys)
        free = np.zeros(len(old), dtype=np.bool_)
        free[np.clip(places, 0, len(old) - 1)] = True
        self._free = free & self._parameters.inner

    def moved(self) -> tuple[Recorded, FloatArray]:
        """Return the curve with the angles of least squares, and its errors."""
        weights = np.ones(len(self._curve.times_s))
        values = self._old + self._parameters.step(self._old, weights, self._free)
        made = self._parameters.curve(values)
        return made, made.error_deg(self._keys)

    def removed(self, error_max_deg: float) -> tuple[BoolArray, Recorded]:
        """Return which keys can be removed, and the curve with the angles without those."""
        parameters = self._parameters
        weights = np.ones(len(self._curve.times_s))
        key_values = self._curve.key_values.copy()
        is_accepted = np.zeros(len(self._windows), dtype=np.bool_)
        values = self._old
        for _ in range(WEIGHTINGS):
            values = values + parameters.step(values, weights, self._free)
            made = parameters.curve(values)
            is_within = _worst(made.error_deg(self._keys), self._windows) <= error_max_deg
            is_new = is_within & ~is_accepted
            key_values = np.where(is_new[self._owner], made.key_values, key_values)
            is_accepted |= is_within
            if is_accepted.all():
                break
            rest = np.abs(parameters.at_samples(values) - self._curve.values)
            worst = np.maximum(_worst(rest, self._windows), RIDGE)
            weights *= WEIGHT_LEAST + rest / worst[self._owner]
        return is_accepted, self._curve.with_values(key_values)


def _worst(error_deg: FloatArray, firsts: IntArray) -> FloatArray:
    """Return the largest error from each of the samples `firsts` to the next."""
    return np.asarray(np.maximum.reduceat(error_deg, firsts))


def _counts(keys: IntArray) -> IntArray:
    """Return the number of samples of each span; the last sample belongs to the last one."""
    counts = np.diff(keys)
    counts[-1] += 1
    return counts


class _Parameters(ABC):
    """The parameters of the curve through some keys: two more than there are keys.

    The value at a sample of span n depends on the parameters n to n + 3.
    """

    def __init__(self, recording: Recorded, keys: IntArray) -> None:
        self.recording, self.keys = recording, keys

    @classmethod
    def of(cls, curve: Recorded, keys: IntArray) -> _Parameters:
        """Return them for keys of which the first and the last are at the ends."""
        return (_Splines if curve.ease is Interpolation.SPLINE else _Shapes)(curve, keys)

    @property
    def inner(self) -> BoolArray:
        """The parameters that may change: not the angles and slopes of the ends."""
        inner = np.ones(len(self.keys) + 2, dtype=np.bool_)
        inner[:2] = inner[-2:] = False
        return inner

    @abstractmethod
    def present(self) -> FloatArray:
        """Return the parameters of the curve as it is."""

    @abstractmethod
    def begin(self) -> FloatArray:
        """Return parameters to begin a fit with."""

    @abstractmethod
    def curve(self, values: FloatArray) -> Recorded:
        """Return the recording with the angles of the keys for these parameters."""

    @abstractmethod
    def at_samples(self, values: FloatArray) -> FloatArray:
        """Return the curve at all samples."""

    @abstractmethod
    def rows(self, values: FloatArray) -> FloatArray:
        """Return how samples change with their four parameters, (4, samples)."""

    @abstractmethod
    def restrain(self, values: FloatArray, band: FloatArray, right: FloatArray) -> None:
        """Add to the equations of `step` what leads the curve back within its limits."""

    def step(self, values: FloatArray, weights: FloatArray, free: BoolArray) -> FloatArray:
        """Return the change of the `free` parameters that makes the weighted errors least."""
        from scipy.linalg import solveh_banded

        rows, starts, count = self.rows(values), self.keys[:-1], len(self.keys) - 1
        weighted = weights * (self.recording.wanted - self.at_samples(values))
        band, right = np.zeros((4, len(free))), np.zeros(len(free))
        for one in range(4):
            right[one : one + count] += np.add.reduceat(weighted * rows[one], starts)
            scaled = weights * rows[one]
            for other in range(one, 4):
                sums = np.add.reduceat(scaled * rows[other], starts)
                band[other - one, one : one + count] += sums
        self.restrain(values, band, right)
        band[0] += RIDGE * band[0].max()
        right[~free] = 0.0
        for apart in range(1, 4):
            band[apart, :-apart] *= free[:-apart] & free[apart:]
        return np.asarray(solveh_banded(band, right, lower=True, check_finite=False))


class _Splines(_Parameters):
    """The coefficients of B-splines; a coefficient counts for four spans."""

    def __init__(self, recording: Recorded, keys: IntArray) -> None:
        super().__init__(recording, keys)
        knots_s = recording.times_s[keys]
        padded_s = np.concatenate([np.repeat(knots_s[:1], 3), knots_s, np.repeat(knots_s[-1:], 3)])
        self._counts = _counts(keys)
        self._firsts = np.repeat(np.arange(len(keys) - 1), self._counts)
        self._rows = _bsplines(recording.times_s, padded_s, self._counts)
        self._padded_s = padded_s
        self._pulls = np.zeros(len(keys))
        """Weights of the accelerations at the keys: 0 until one is beyond its limit."""

    @cached_property
    def _bends(self) -> tuple[FloatArray, FloatArray]:
        """How the acceleration at each key follows from three coefficients, and its limit."""
        padded_s, count = self._padded_s, len(self.keys)
        over_three_s = padded_s[4 : count + 5] - padded_s[1 : count + 2]
        over_two_s = padded_s[4 : count + 4] - padded_s[2 : count + 2]
        first, last = 6.0 / over_two_s / over_three_s[:-1], 6.0 / over_two_s / over_three_s[1:]
        most = self.recording.largest_per_span(self.recording.accel_max_deg_s2, self.keys)
        limit = BEND_RATIO * np.minimum(np.append(most, most[-1]), np.append(most[0], most))
        return np.stack([first, -first - last, last]), limit

    def restrain(self, values: FloatArray, band: FloatArray, right: FloatArray) -> None:
        if not self.recording.is_limited:
            return
        rows, limit = self._bends
        count = len(self.keys)
        bend = sum(rows[one] * values[one : one + count] for one in range(3))
        beyond = bend - np.clip(bend, -limit, limit)
        if not (beyond.any() or self._pulls.any()):
            return
        first = PULL * np.append(self._counts, self._counts[-1]) / rows[1] ** 2
        grown = np.maximum(first, PULL_GROWTH * self._pulls)
        self._pulls = np.where(beyond == 0.0, self._pulls, grown)
        for one in range(3):
            right[one : one + count] -= self._pulls * rows[one] * beyond
            for other in range(one, 3):
                band[other - one, one : one + count] += self._pulls * rows[one] * rows[other]

    def present(self) -> FloatArray:
        from scipy.interpolate import make_interp_spline

        times_s, angles = self.recording.times_s[self.keys], self.recording.key_values[self.keys]
        return np.asarray(make_interp_spline(times_s, angles, 3, bc_type="clamped").c)

    def begin(self) -> FloatArray:
        ends = self.recording.key_values[[0, -1]]
        return np.repeat(ends, [len(self.keys), 2])

    def curve(self, values: FloatArray) -> Recorded:
        angles = self.recording.key_values.copy()
        angles[self.keys] = self.at_samples(values)[self.keys]
        return self.recording.with_values(angles)

    def at_samples(self, values: FloatArray) -> FloatArray:
        found: FloatArray = self._rows[0] * values[self._firsts]
        for one in range(1, 4):
            found += self._rows[one] * values[self._firsts + one]
        return found

    def rows(self, values: FloatArray) -> FloatArray:  # noqa: ARG002
        return self._rows


class _Shapes(_Parameters):
    """The angles of the keys, with one more at each end that does not count."""

    def present(self) -> FloatArray:
        return np.pad(self.recording.key_values[self.keys], 1)

    def begin(self) -> FloatArray:
        return self.present()

    def curve(self, values: FloatArray) -> Recorded:
        angles = self.recording.key_values.copy()
        angles[self.keys] = np.clip(values[1:-1], *self.recording.range_deg)
        return self.recording.with_values(angles)

    def at_samples(self, values: FloatArray) -> FloatArray:
        times_s = self.recording.times_s
        spans = Spans.between(self.recording.ease, times_s[self.keys], values[1:-1])
        return spans.at(times_s, _counts(self.keys))

    def restrain(self, values: FloatArray, band: FloatArray, right: FloatArray) -> None:
        """Add nothing: only a spline keeps limits."""

    def rows(self, values: FloatArray) -> FloatArray:
        knots_s, counts = self.recording.times_s[self.keys], _counts(self.keys)
        lengths_s = np.diff(knots_s)
        share = (self.recording.times_s - np.repeat(knots_s[:-1], counts)) / np.repeat(
            lengths_s, counts
        )
        none = np.zeros_like(share)
        if self.recording.ease is Interpolation.LINEAR:
            way = trapezoid_share(share)
            return np.stack([none, 1.0 - way, way, none])
        way = share**2 * (3.0 - 2.0 * share)
        start, end = share * (share - 1.0) ** 2, share**2 * (share - 1.0)
        before, after = _slope_changes(lengths_s, np.diff(values[1:-1]) / lengths_s)
        # The slope at a key by the angles of the key before it, of itself and of the next one.
        by_key = np.pad(np.stack([-before, before - after, after]), ((0, 0), (1, 1)))
        first = [np.repeat(column[:-1] * lengths_s, counts) * start for column in by_key]
        second = [np.repeat(column[1:] * lengths_s, counts) * end for column in by_key]
        return np.stack(
            [first[0], 1.0 - way + first[1] + second[0], way + first[2] + second[1], second[2]]
        )


def _bsplines(times_s: FloatArray, padded_s: FloatArray, counts: IntArray) -> FloatArray:
    """Return the four cubic B-splines that are not 0 at each sample (Cox and de Boor).

    Each span between two knots, which are `padded_s` without three at each end, has the next of
    `counts` samples.
    """
    spans = len(counts)
    after = [np.repeat(padded_s[3 + n : 3 + n + spans], counts) - times_s for n in (1, 2, 3)]
    before = [times_s - np.repeat(padded_s[4 - n : 4 - n + spans], counts) for n in (1, 2, 3)]
    rows = [np.ones_like(times_s)]
    for degree in range(1, 4):
        left = np.zeros_like(times_s)
        risen = []
        for one in range(degree):
            part = rows[one] / (after[one] + before[degree - one - 1])
            risen.append(left + after[one] * part)
            left = before[degree - one - 1] * part
        rows = [*risen, left]
    return np.stack(rows)


def _slope_changes(lengths_s: FloatArray, secants: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how the slopes at inner keys change with the moves to them, and to the next keys."""
    means = monotone_slopes(lengths_s, secants)
    before_s, after_s = lengths_s[:-1], lengths_s[1:]
    total_s, is_moving = 3.0 * (before_s + after_s), means != 0.0
    before = means / np.where(is_moving, secants[:-1], 1.0)
    after = means / np.where(is_moving, secants[1:], 1.0)
    return (
        (2.0 * after_s + before_s) / total_s * before**2 / before_s,
        (after_s + 2.0 * before_s) / total_s * after**2 / after_s,
    )
