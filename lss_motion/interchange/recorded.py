"""The recording of one joint, and the curve between keys that is compared with it.

The interpolation between keys (`interpolated`, `Spans`) is that of the planner,
`planning.trajectory.curves`, so the error is that of the motion that will be played. The planner is
in a layer above this package; a test compares the two.

A spline exactly through the samples oscillates where the acceleration jumps, so a motion at its
limits would be slowed down when it is planned again. Keys of a spline therefore follow the B-spline
that has the samples as control points (`bspline_values`): its speeds and accelerations are averages
of those of the recording.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.show.model import LINEAR_RAMP_RATIO, Interpolation
from lss_motion.show.splines import clamped_slopes, monotone_slopes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.interchange.reader import Channel

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]

BSPLINE_SHIFT_RATIO: Final = 0.5
"""Largest part of the tolerance for the distance of keys from their samples. Chosen."""


BROKEN_RATIO: Final = 1.5
"""Where a recording is beyond a limit, so may the spline be, by this ratio: the planner slows that
span down in any case. Measured on random motion of 8 joints at 50 Hz, 5 deg: 1,110 keys with ratio
1, 669 with 1.25, 659 with 1.5 and above."""

NOISE_RATIO: Final = 1.01
"""A recording this little beyond a limit is at its limit: rounding to 1 us and 1e-6 deg at 100 Hz
changes an acceleration of 600 deg/s² by 0.01 %."""


OUT_DEG: Final = 1e-7
"""Tolerance for rounding of a spline that rests at the end of a range."""

EXCESS_SLACK: Final = 5e-5
"""Half of the tolerance of the planner for rounding (`FEASIBLE_RATIO`)."""


class JointLimits(Struct, frozen=True, kw_only=True):
    """JointLimits of a joint: speed, acceleration and range."""

    speed_deg_s: float
    accel_deg_s2: float
    range_deg: tuple[float, float]


class Recorded(Struct, frozen=True, kw_only=True, eq=False):
    """The recording of one joint, the tolerance of its keys, and the limits of a spline.

    `wanted` are the angles that a curve should have at the samples, `key_values` those of the keys
    among them. `speed_max_deg_s`, `accel_max_deg_s2`:
    limits of a spline around each sample; infinite means no limit. A spline must stay within
    `range_deg`, which contains all keys.
    """

    times_s: FloatArray
    values: FloatArray
    wanted: FloatArray
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

    @property
    def is_limited(self) -> bool:
        """Whether a spline has limits or a range to keep."""
        has_range = self.range_deg != (-math.inf, math.inf)
        return has_range or math.isfinite(self.speed_max_deg_s[0])

    def with_values(self, key_values: FloatArray) -> Recorded:
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
        if self.ease is Interpolation.SPLINE and self.is_limited:
            self._raise_error_over_limits(keys, spans, error_deg)
        return error_deg

    @staticmethod
    def largest_per_span(per_sample: FloatArray, keys: IntArray) -> FloatArray:
        """Return the largest value of each span, with both of its keys."""
        inside = np.maximum.reduceat(per_sample, keys[:-1])
        return np.maximum(inside, per_sample[keys[1:]])

    def _raise_error_over_limits(self, keys: IntArray, spans: Spans, error_deg: FloatArray) -> None:
        """Raise `error_deg` above the tolerance in spans over a limit or out of range."""
        speed, accel = spans.peaks()
        excess = np.maximum(
            speed / self.largest_per_span(self.speed_max_deg_s, keys),
            accel / self.largest_per_span(self.accel_max_deg_s2, keys),
        )
        low_deg, high_deg = spans.extremes()
        is_out = (low_deg < self.range_deg[0] - OUT_DEG) | (high_deg > self.range_deg[1] + OUT_DEG)
        for span in np.flatnonzero(is_out | (excess > 1.0 + EXCESS_SLACK)).tolist():
            first, last = int(keys[span]), int(keys[span + 1])
            off = 2.0 * np.abs(np.arange(first, last) - 0.5 * (first + last)) / (last - first)
            raised_deg = self.tolerance_deg * (1.0 + float(excess[span]) * (1.5 - off))
            np.maximum(error_deg[first:last], raised_deg, out=error_deg[first:last])


def curve_of(
    channel: Channel, tolerance_deg: float, ease: Interpolation, limit: JointLimits | None
) -> Recorded:
    """Return the recording of one joint; a spline keeps the `limit` where the recording does."""
    times_s, values = channel.times_s, channel.values
    key_values = values
    most = (np.full(len(values), math.inf),) * 2
    range_deg = (-math.inf, math.inf)
    if limit is not None and ease is Interpolation.SPLINE:
        key_values = bspline_values(
            times_s, values, min(BSPLINE_SHIFT_MAX_DEG, BSPLINE_SHIFT_RATIO * tolerance_deg)
        )
        speed, accel = peaks_of_samples(times_s, values)
        most = _allowed(speed, limit.speed_deg_s), _allowed(accel, limit.accel_deg_s2)
    if limit is not None:
        low_deg, high_deg = limit.range_deg
        range_deg = (
            low_deg if key_values.min() >= low_deg else -math.inf,
            high_deg if key_values.max() <= high_deg else math.inf,
        )
    return Recorded(
        times_s=times_s,
        values=values,
        wanted=key_values,
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


class Spans(Struct, frozen=True):
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
            return np.repeat(self.start, counts) + np.repeat(self.moved, counts) * trapezoid_share(
                share
            )
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


def trapezoid_share(share: FloatArray) -> FloatArray:
    """Return the way covered of a move from rest to rest with even ramps."""
    ramp = LINEAR_RAMP_RATIO
    speed = 1.0 / (1.0 - ramp)
    rest = 1.0 - share
    up, down = 0.5 * speed * share**2 / ramp, 1.0 - 0.5 * speed * rest**2 / ramp
    cruise = speed * (share - 0.5 * ramp)
    return np.where(share < ramp, up, np.where(rest < ramp, down, cruise))


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
