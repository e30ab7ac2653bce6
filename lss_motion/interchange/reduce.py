"""Reduces a dense recording to few keys whose interpolation stays within a tolerance.

`reduced` is the entry. The interpolation between keys (`interpolated`, `Spans`) is that of the
planner, `trajectory.curves`, so the reported error is the error of the motion that will be played.
The planner is in a layer above this package; a test compares the two.

The keys of a joint (`rough_keys`, `refined_keys`) start with the ends and the rests. Keys are added
until the curve fits, then keys that are not needed are removed, then the others are moved so that
more of them can be removed. Then the joints share times (`shared_keys`): a keyframe that holds many
joints is easier to read and to edit than many keyframes that hold one. At last, keys of a spline
are removed where fitted angles of the keys around them replace them (`fitted_keys`).

A spline exactly through the samples oscillates where the acceleration jumps, so a motion at its
limits would be slowed down when it is planned again. Keys of a spline are therefore the values of
the B-spline that has the samples as control points (`bspline_values`): its speeds and accelerations
are averages of those of the recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.interchange.fitted_keys import fitted_keys
from lss_motion.interchange.reader import DIGITS, Unit
from lss_motion.sequence.model import KEYFRAMES_MAX, LINEAR_RAMP_RATIO, Interpolation
from lss_motion.splines import clamped_slopes, monotone_slopes

if TYPE_CHECKING:
    from collections.abc import Mapping
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from lss_motion.interchange.reader import Channel, ForeignMotion

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]


TOLERANCE_DEG: Final = 1.0
"""Default of `--tolerance-deg`: the largest error of the keys. Less than an eye sees on a figure,
more than the backlash of a servo."""

ANGLE_DECIMALS: Final = 4
"""Decimals of most keys: easy to read, and finer than a servo resolves."""

CLOSE_S: Final = 0.1
"""Keys closer than this have `DIGITS` decimals, because rounding to 4 would change the acceleration
(by 6 deg/s² for keys 10 ms apart, by 0.06 deg/s² for 100 ms)."""

EDGE_DEG: Final = 0.01
"""A joint this close to the end of its range has keys with `DIGITS` decimals, so that rounding does
not move the spline out of the range."""

ROUNDING_DEG: Final = 0.5 * 10.0**-ANGLE_DECIMALS

BSPLINE_SHIFT_RATIO: Final = 0.5
"""Largest part of the tolerance for the distance of keys from their samples. Chosen."""


BROKEN_RATIO: Final = 1.5
"""Where a recording is beyond a limit, so may the spline be, by this ratio: the planner slows that
span down in any case. Measured on random motion of 8 joints at 50 Hz, 5 deg: 1,110 keys with ratio
1, 669 with 1.25, 659 with 1.5 and above."""

NOISE_RATIO: Final = 1.01
"""A recording this little beyond a limit is at its limit: rounding to 1 us and 1e-6 deg at 100 Hz
changes an acceleration of 600 deg/s² by 0.01 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of a joint: speed, acceleration and range."""

    speed_deg_s: float
    accel_deg_s2: float
    range_deg: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFit:
    """Result of a reduction; the errors are measured at every sample of the recording."""

    samples_count: int
    keys_count: int
    keyframes_count: int
    error_max_deg: float
    error_rms_deg: float
    joint: str
    """The joint of the largest error, at `at_s`."""
    at_s: float


def reduced(
    motion: ForeignMotion,
    tolerance_deg: float,
    ease: Interpolation,
    limits: Mapping[str, Limits] | None = None,
) -> tuple[ForeignMotion, KeyFit]:
    """Return a recording in degrees reduced to few keys, at times of samples, and its `KeyFit`.

    Keys of different joints are at the same times where the tolerance allows. Where the recording
    keeps the `limits` of its joint, a spline through the keys keeps them too.
    Raises `InputError` if even as many keyframes as a sequence may have exceed the tolerance.
    """
    assert all(channel.unit is Unit.DEG for channel in motion.channels), "map it first"
    curves = [
        _curve(channel, tolerance_deg, ease, (limits or {}).get(channel.name))
        for channel in motion.channels
    ]
    rough = [rough_keys(curve) for curve in curves]
    start_s, end_s, count = _span(motion, rough)
    if count > KEYFRAMES_MAX:
        # Too many different times: the joints share a grid of as many times as a sequence may have.
        step_s = (end_s - start_s) / (KEYFRAMES_MAX - 2)
        curves = [replace(curve, step_s=step_s) for curve in curves]
        rough = [rough_keys(curve) for curve in curves]
    channels: list[Channel] = []
    refined = [refined_keys(curve, found) for curve, found in zip(curves, rough, strict=True)]
    shared = shared_keys(curves, refined)
    if ease is Interpolation.SPLINE:
        pairs = [_fitted(curve, keys) for curve, keys in zip(curves, shared, strict=True)]
        curves, shared = [curve for curve, _ in pairs], [keys for _, keys in pairs]
    for channel, curve, keys in zip(motion.channels, curves, shared, strict=True):
        own_lines = None if channel.lines is None else channel.lines[keys]
        values = _rounded(curve, keys)
        channels.append(
            replace(channel, times_s=curve.times_s[keys], values=values, lines=own_lines)
        )
    times_s = np.unique(np.concatenate([channel.times_s for channel in channels]))
    fit = _fit(motion, channels, ease, len(times_s))
    if len(times_s) > KEYFRAMES_MAX or fit.error_max_deg > tolerance_deg + ROUNDING_DEG:
        raise InputError(
            f"needs more than {KEYFRAMES_MAX:,} keyframes: joint {fit.joint!r} would be "
            f"{fit.error_max_deg:.2f} deg off at {fit.at_s:.3f} s, {tolerance_deg:g} deg are "
            "allowed; give a larger --tolerance-deg, or cut the recording into parts",
            path=motion.path,
        )
    notes = {at_s: note for at_s, note in motion.notes.items() if at_s in set(times_s.tolist())}
    lost = sum(bool(note.label) for note in motion.notes.values()) - sum(
        bool(note.label) for note in notes.values()
    )
    comments = (*motion.comments, *([f"Not carried over: {lost} names of poses"] if lost else []))
    return (
        replace(
            motion,
            channels=tuple(channels),
            notes=notes,
            ease=ease,
            comments=comments,
            is_recording=False,
        ),
        fit,
    )


def every_sample(motion: ForeignMotion, ease: Interpolation) -> ForeignMotion:
    """Return a recording in degrees with all its samples as keys."""
    return replace(
        motion,
        channels=tuple(
            replace(c, values=bspline_values(c.times_s, c.values, BSPLINE_SHIFT_MAX_DEG))
            if ease is Interpolation.SPLINE
            else c
            for c in motion.channels
        ),
        ease=ease,
    )


def _curve(
    channel: Channel, tolerance_deg: float, ease: Interpolation, limit: Limits | None
) -> Curve:
    times_s, values = channel.times_s, channel.values
    key_values = values
    most = (np.full(len(values), math.inf),) * 2
    range_deg = (-math.inf, math.inf)
    if ease is Interpolation.SPLINE and limit is not None:
        key_values = bspline_values(
            times_s, values, min(BSPLINE_SHIFT_MAX_DEG, BSPLINE_SHIFT_RATIO * tolerance_deg)
        )
        speed, accel = peaks_of_samples(times_s, values)
        most = _allowed(speed, limit.speed_deg_s), _allowed(accel, limit.accel_deg_s2)
        low_deg, high_deg = limit.range_deg
        range_deg = (
            low_deg if key_values.min() >= low_deg else -math.inf,
            high_deg if key_values.max() <= high_deg else math.inf,
        )
    return Curve(
        times_s=times_s,
        values=values,
        key_values=key_values,
        speed_max_deg_s=most[0],
        accel_max_deg_s2=most[1],
        tolerance_deg=tolerance_deg,
        ease=ease,
        range_deg=range_deg,
    )


def _allowed(peaks: FloatArray, limit: float) -> FloatArray:
    """Return the limit of a spline around each sample, from the peaks of the recording there."""
    return np.where(peaks > NOISE_RATIO * limit, BROKEN_RATIO * peaks, np.maximum(peaks, limit))


def _rounded(curve: Curve, keys: IntArray) -> FloatArray:
    """Return the angles of the keys, rounded to the decimals that they need."""
    times_s, values = curve.times_s[keys], curve.key_values[keys]
    low_deg, high_deg = curve.range_deg
    if values.min() < low_deg + EDGE_DEG or values.max() > high_deg - EDGE_DEG:
        return np.round(values, DIGITS)
    is_close = np.diff(times_s) < CLOSE_S
    is_close = np.append(is_close, False) | np.append(False, is_close)
    return np.where(is_close, np.round(values, DIGITS), np.round(values, ANGLE_DECIMALS))


def _span(motion: ForeignMotion, kept: list[IntArray]) -> tuple[float, float, int]:
    """Return the first and the last time of all keys, and the number of different times."""
    times_s = np.unique(
        np.concatenate([c.times_s[keys] for c, keys in zip(motion.channels, kept, strict=True)])
    )
    return float(times_s[0]), float(times_s[-1]), len(times_s)


def _fit(
    motion: ForeignMotion, channels: list[Channel], ease: Interpolation, keyframes_count: int
) -> KeyFit:
    worst = (-1.0, "", 0.0)
    squares = 0.0
    samples_count = 0
    for whole, keys in zip(motion.channels, channels, strict=True):
        error_deg = np.abs(
            interpolated(ease, keys.times_s, keys.values, whole.times_s) - whole.values
        )
        at = int(np.argmax(error_deg))
        if error_deg[at] > worst[0]:
            worst = (float(error_deg[at]), whole.name, float(whole.times_s[at]))
        squares += float(error_deg @ error_deg)
        samples_count += len(error_deg)
    return KeyFit(
        samples_count=samples_count,
        keys_count=sum(len(channel.times_s) for channel in channels),
        keyframes_count=keyframes_count,
        error_max_deg=worst[0],
        error_rms_deg=math.sqrt(squares / samples_count),
        joint=worst[1],
        at_s=worst[2],
    )


def interpolated(
    ease: Interpolation, key_times_s: FloatArray, key_values: FloatArray, times_s: FloatArray
) -> FloatArray:
    """Return the curve through keys at the increasing `times_s`: rest at both ends and outside.

    `ease` is `spline`, `smooth` or `linear`.
    """
    if len(key_times_s) == 1:
        return np.full(len(times_s), key_values[0])
    # Number of samples in each span; samples after the last key belong to the last span.
    bounds = np.searchsorted(times_s, key_times_s[1:-1], side="left")
    counts = np.diff(np.concatenate([[0], bounds, [len(times_s)]]))
    return Spans.between(ease, key_times_s, key_values).at(times_s, counts)


@dataclass(frozen=True, slots=True)
class Spans:
    """What lies between keys: cubics of the share of each span, or moves with even ramps."""

    starts_s: FloatArray
    lengths_s: FloatArray
    start: FloatArray
    moved: FloatArray
    slopes: FloatArray | None
    """At all keys; None for `linear`."""

    @classmethod
    def between(cls, ease: Interpolation, times_s: FloatArray, values: FloatArray) -> Spans:
        """Return the spans between two keys or more."""
        lengths_s, moved = np.diff(times_s), np.diff(values)
        slopes = None
        if ease is not Interpolation.LINEAR:
            assert ease in {Interpolation.SMOOTH, Interpolation.SPLINE}, ease
            secants = moved / lengths_s
            if ease is Interpolation.SPLINE:
                slopes = clamped_slopes(lengths_s, secants, with_scipy=True)
            else:
                slopes = np.zeros(len(times_s))
                slopes[1:-1] = monotone_slopes(lengths_s, secants)
        return cls(times_s[:-1], lengths_s, values[:-1], moved, slopes)

    def at(self, times_s: FloatArray, counts: IntArray) -> FloatArray:
        """Return the values at `times_s`, of which each span has the next of `counts`."""
        scale = 1.0 / self.lengths_s
        share = times_s * np.repeat(scale, counts)
        share -= np.repeat(self.starts_s * scale, counts)
        np.clip(share, 0.0, 1.0, out=share)
        if self.slopes is None:
            return np.repeat(self.start, counts) + np.repeat(self.moved, counts) * _trapezoid(share)
        linear, square, cube = self._coefficients(self.slopes)
        values = share * np.repeat(cube, counts)
        values += np.repeat(square, counts)
        values *= share
        values += np.repeat(linear, counts)
        values *= share
        values += np.repeat(self.start, counts)
        return values

    def peaks(self) -> tuple[FloatArray, FloatArray]:
        """Return the largest speed and acceleration within each span; not for `linear`."""
        assert self.slopes is not None
        linear, square, cube = self._coefficients(self.slopes)
        accel = 2.0 * np.maximum(np.abs(square), np.abs(square + 3.0 * cube)) / self.lengths_s**2
        turn = np.divide(-square, 3.0 * cube, out=np.zeros_like(cube), where=cube != 0.0)
        turn = np.clip(turn, 0.0, 1.0)
        speed = np.abs(linear + turn * (2.0 * square + turn * 3.0 * cube)) / self.lengths_s
        at_keys = np.abs(self.slopes)
        return np.maximum(speed, np.maximum(at_keys[:-1], at_keys[1:])), accel

    def extremes(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest value of each span; not for `linear`."""
        assert self.slopes is not None
        linear, square, cube = self._coefficients(self.slopes)
        ends = np.stack([np.zeros_like(linear), self.moved])
        # Where 3 cube s² + 2 square s + linear is 0, in the form that also holds for cube = 0.
        root = np.sqrt(np.maximum(square**2 - 3.0 * cube * linear, 0.0))
        near = -(square + np.copysign(root, square))
        turns = [
            np.divide(linear, near, out=np.zeros_like(near), where=near != 0.0),
            np.divide(near, 3.0 * cube, out=np.zeros_like(near), where=cube != 0.0),
        ]
        inside = [np.clip(turn, 0.0, 1.0) for turn in turns]
        values = np.stack([*ends, *(s * (linear + s * (square + s * cube)) for s in inside)])
        return self.start + values.min(axis=0), self.start + values.max(axis=0)

    def _coefficients(self, slopes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the coefficients of the share, its square and its cube."""
        before, after = slopes[:-1] * self.lengths_s, slopes[1:] * self.lengths_s
        square = 3.0 * self.moved - 2.0 * before - after
        return before, square, before + after - 2.0 * self.moved


def _trapezoid(share: FloatArray) -> FloatArray:
    """Return the way covered of a move from rest to rest with even ramps."""
    ramp = LINEAR_RAMP_RATIO
    speed = 1.0 / (1.0 - ramp)
    rest = 1.0 - share
    up, down = 0.5 * speed * share**2 / ramp, 1.0 - 0.5 * speed * rest**2 / ramp
    cruise = speed * (share - 0.5 * ramp)
    return np.where(share < ramp, up, np.where(rest < ramp, down, cruise))


APART: Final = 4
"""Distance, in keys, of keys that are tried at the same time. Removing a key changes a smooth curve
from two keys before it to two keys after it, and a spline only little beyond that."""

PULL: Final = 6
"""Distance, in keys, at which a key still changes a spline: by 0.27 to the power of 6, 0.04 %."""

OUT_DEG: Final = 1e-7
"""Tolerance for rounding of a spline that rests at the end of a range."""

EXCESS_SLACK: Final = 5e-5
"""Half of the tolerance of the planner for rounding (`FEASIBLE_RATIO`)."""

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """The recording of one joint, the tolerance of its keys, and the limits of a spline.

    `key_values` are the angles of samples that become keys. `speed_max_deg_s`, `accel_max_deg_s2`:
    limits of a spline around each sample; infinite means no limit. A spline must stay within
    `range_deg`, which contains all keys.
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
    """If not 0, only the samples next to multiples of this time may be keys."""

    @property
    def candidates(self) -> NDArray[np.bool_]:
        """Mask of the samples that may be keys."""
        if self.step_s == 0.0:
            return np.ones(len(self.times_s), dtype=np.bool_)
        return np.concatenate([[True], np.diff(np.round(self.times_s / self.step_s)) > 0.0])

    def with_values(self, key_values: FloatArray) -> Curve:
        """Return the same recording with other angles of keys."""
        return replace(self, key_values=key_values)

    def fits(self, keys: IntArray) -> bool:
        """Return whether the error of the keys is within the tolerance."""
        return float(self.error_deg(keys).max()) <= self.tolerance_deg

    def error_deg(self, keys: IntArray) -> FloatArray:
        """Return the error of the curve through the keys at the samples from first to last key.

        A span over a limit gets an error above the tolerance, the largest in its middle.
        """
        counts = np.diff(keys)
        counts[-1] += 1
        spans = Spans.between(self.ease, self.times_s[keys], self.key_values[keys])
        error_deg = spans.at(self.times_s, counts)
        error_deg -= self.values
        np.abs(error_deg, out=error_deg)
        if self.ease is Interpolation.SPLINE:
            self._raise_error_over_limits(keys, spans, error_deg)
        return error_deg

    def _raise_error_over_limits(self, keys: IntArray, spans: Spans, error_deg: FloatArray) -> None:
        """Raise `error_deg` above the tolerance in spans over a limit or out of range."""
        speed, accel = spans.peaks()
        excess = np.maximum(
            speed / _largest_per_span(self.speed_max_deg_s, keys),
            accel / _largest_per_span(self.accel_max_deg_s2, keys),
        )
        low_deg, high_deg = spans.extremes()
        is_out = (low_deg < self.range_deg[0] - OUT_DEG) | (high_deg > self.range_deg[1] + OUT_DEG)
        for span in np.flatnonzero(is_out | (excess > 1.0 + EXCESS_SLACK)).tolist():
            first, last = int(keys[span]), int(keys[span + 1])
            off = 2.0 * np.abs(np.arange(first, last) - 0.5 * (first + last)) / (last - first)
            raised_deg = self.tolerance_deg * (1.0 + float(excess[span]) * (1.5 - off))
            np.maximum(error_deg[first:last], raised_deg, out=error_deg[first:last])


def _largest_per_span(per_sample: FloatArray, keys: IntArray) -> FloatArray:
    """Return the largest value of each span, with both of its keys."""
    inside = np.maximum.reduceat(per_sample, keys[:-1])
    return np.maximum(inside, per_sample[keys[1:]])


def rough_keys(curve: Curve) -> IntArray:
    """Return samples that fit as keys, close to the smallest number."""
    if float(np.abs(curve.values - curve.key_values[0]).max()) <= curve.tolerance_deg:
        return np.zeros(1, dtype=np.intp)
    keys = _grown(curve)
    if not curve.fits(keys):
        return keys  # There are too few candidates; the caller reports that.
    return _pruned(curve, keys, APART)


def refined_keys(curve: Curve, keys: IntArray) -> IntArray:
    """Return fewer keys: keys are moved so that more of them can be removed."""
    if len(keys) == 1 or not curve.fits(keys):
        return keys
    for _ in range(ROUNDS):
        shifted = _shifted(curve, keys)
        if not curve.fits(shifted):
            break  # Rare: shifts of adjacent splines add up.
        keys = _pruned(curve, shifted, APART)
    return _pruned(curve, keys, FAR_APART)


def shared_keys(curves: SequenceOf[Curve], keys: SequenceOf[IntArray]) -> list[IntArray]:
    """Return keys at fewer different times: joints use the times of joints with more keys."""
    result = list(keys)
    taken_s = np.empty(0)
    for index in sorted(range(len(keys)), key=lambda index: -len(keys[index])):
        curve, own = curves[index], keys[index]
        there = np.flatnonzero(np.isin(curve.times_s, taken_s) & curve.candidates)
        if len(own) > 2 and len(there) and curve.fits(own):
            own = _pruned(curve, _moved_to(curve, own, there), APART)
        result[index] = own
        taken_s = np.union1d(taken_s, curve.times_s[own])
    return result


def _fitted(curve: Curve, keys: IntArray) -> tuple[Curve, IntArray]:
    """Return the curve with fitted values and fewer keys, else both unchanged."""
    margin_deg = min(ROUNDING_DEG, 0.01 * curve.tolerance_deg)
    found, kept = fitted_keys(curve, keys, margin_deg)
    return found, (keys if found is curve else _pruned(found, kept, FAR_APART))


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


def _pruned(curve: Curve, keys: IntArray, apart: int) -> IntArray:
    """Return the keys without unneeded ones; keys at a distance of `apart` are tried together."""
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


BSPLINE_SHIFT_MAX_DEG: Final = 0.02
"""Largest distance of a key from its sample: 1000 deg/s², the limit of the ramps of a servo, at
100 Hz gives 0.017 deg. If the distance would be larger, the sample itself is the key."""

EVEN_RATIO: Final = 0.01
"""Time steps that differ by less are even. Chosen: rounding to 1 us at 1 kHz is 0.1 %."""

REST_DEG: Final = 1e-9
"""Samples that would be moved by less are at rest and stay unchanged."""


def bspline_values(times_s: FloatArray, values: FloatArray, shift_max_deg: float) -> FloatArray:
    """Return the uniform cubic B-spline with control points `values`, at the samples.

    The ends are at rest, as those of keys. A value that would move by more than `shift_max_deg`
    stays unchanged.
    """
    if len(values) < 3:
        return values
    steps_s = np.diff(times_s)
    steps_s = np.concatenate([steps_s[:1], steps_s, steps_s[-1:]])
    is_even = np.abs(np.diff(steps_s)) <= EVEN_RATIO * steps_s[1:]
    around = np.concatenate([values[1:2], values, values[-2:-1]])
    by = (around[:-2] - 2.0 * values + around[2:]) / 6.0
    is_moved = is_even & (np.abs(by) <= shift_max_deg) & (np.abs(by) > REST_DEG)
    return np.where(is_moved, values + by, values)


def peaks_of_samples(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the absolute speed and acceleration of the recording around each sample.

    A spline is at rest at both ends. The even acceleration from there to the first sample, and from
    the last but one to rest, counts as well: it is large if a recording begins or ends in motion.
    """
    if len(values) < 3:
        return np.full(len(values), np.inf), np.full(len(values), np.inf)
    steps_s = np.diff(times_s)
    speeds = np.diff(values) / steps_s
    accels = np.abs(2.0 * np.diff(speeds) / (steps_s[1:] + steps_s[:-1]))
    speeds = np.abs(speeds)
    starts, ends = 2.0 * speeds[:1] / steps_s[:1], 2.0 * speeds[-1:] / steps_s[-1:]
    return (
        np.maximum(np.append(speeds, 0.0), np.append(0.0, speeds)),
        np.concatenate([np.maximum(accels[:1], starts), accels, np.maximum(accels[-1:], ends)]),
    )
