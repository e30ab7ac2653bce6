"""Smooth courses of single quantities: blends, lifts, curves through poses, clamped splines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from lss_motion.show.splines import clamped_slopes, monotone_slopes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]


def blend(ratio: FloatArray) -> FloatArray:
    """Return 0 to 1 over 0 to 1, at rest and without acceleration at both ends."""
    u = np.clip(ratio, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u * u))


def lift(ratio: FloatArray) -> FloatArray:
    """Return 0 to 1 and back over 0 to 1, at rest and without acceleration at both ends.

    Of the curves w³ (1 + c (1 - w)), w = 4 u (1 - u), c = 0.4 has the least peak of acceleration.
    """
    u = np.clip(ratio, 0.0, 1.0)
    w = 4.0 * u * (1.0 - u)
    return np.asarray(w**3 * (1.4 - 0.4 * w))


def through(times_s: FloatArray, values: FloatArray, at_s: FloatArray) -> FloatArray:
    """Return the curve through `values`, (n, k), at rest at both ends and where they turn.

    It never leaves the range of the values around it (`show.splines.monotone_slopes`).
    """
    length_s = np.diff(times_s)
    slope = np.zeros_like(values)
    slope[1:-1] = monotone_slopes(length_s, np.diff(values, axis=0) / length_s[:, None])
    piece = np.clip(np.searchsorted(times_s, at_s, side="right") - 1, 0, len(times_s) - 2)
    return hermite(
        length_s[piece, None],
        (values[piece], values[piece + 1]),
        (slope[piece], slope[piece + 1]),
        (at_s - times_s[piece])[:, None],
    )


def hermite(
    length_s: FloatArray | float,
    ends: tuple[FloatArray, FloatArray],
    slopes: tuple[FloatArray, FloatArray],
    local_s: FloatArray,
) -> FloatArray:
    """Return cubics with those values and slopes at both ends, `local_s` after the first."""
    u = local_s / length_s
    rest = ends[0] * (1.0 - u) ** 2 * (1.0 + 2.0 * u) + ends[1] * u**2 * (3.0 - 2.0 * u)
    turn = slopes[0] * u * (1.0 - u) ** 2 - slopes[1] * u**2 * (1.0 - u)
    return np.asarray(rest + turn * length_s)


class Spline(Struct, frozen=True):
    """The C2 cubic through equidistant keys, at rest at both ends: what `ease: spline` is."""

    step_s: float
    values: FloatArray
    slopes: FloatArray

    def middles(self) -> FloatArray:
        """Return the values halfway between keys, one row fewer than there are keys."""
        mean = 0.5 * (self.values[:-1] + self.values[1:])
        return np.asarray(mean + 0.125 * self.step_s * (self.slopes[:-1] - self.slopes[1:]))

    def peaks(self) -> tuple[FloatArray, FloatArray]:
        """Return the largest speed and acceleration of each column, exactly."""
        step_s, left, right = self.step_s, self.slopes[:-1], self.slopes[1:]
        secant = np.diff(self.values, axis=0) / step_s
        accel = (6.0 * secant - 4.0 * left - 2.0 * right) / step_s
        end_accel = (-6.0 * secant + 2.0 * left + 4.0 * right) / step_s
        change = end_accel - accel
        is_turning = accel * end_accel < 0.0
        # Speed is a parabola between keys: its extremum lies where the acceleration is zero.
        share = np.divide(-accel, change, out=np.zeros_like(accel), where=is_turning)
        inside = left + step_s * share * (accel + 0.5 * change * share)
        speed = np.maximum(np.abs(self.slopes).max(axis=0), np.abs(inside).max(axis=0))
        return speed, np.maximum(np.abs(accel), np.abs(end_accel)).max(axis=0)


def spline(step_s: float, values: FloatArray) -> Spline:
    """Return the clamped spline through `values`, (n, k), n at least 2."""
    lengths_s = np.full(len(values) - 1, step_s)
    return Spline(step_s, values, clamped_slopes(lengths_s, np.diff(values, axis=0) / step_s))
