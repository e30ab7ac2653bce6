"""The shape of a motion between its keys, as `trajectory.curves` plans it.

Written here again because the planner stands above this package; a test holds the two together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.sequence.model import Interpolation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]

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
            find_slopes = _monotone_slopes if ease is Interpolation.SMOOTH else _spline_slopes
            slopes = find_slopes(lengths_s, moved / lengths_s)
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
        """Return those of the share, its square and its cube."""
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
