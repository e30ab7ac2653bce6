"""Angles over time as few cubics: what a browser needs to draw ten minutes of 18 joints.

A curve is given by its knots: time, angle and speed. Between two knots it is the cubic that has
these angles and speeds at both (Hermite), so that a page can compute angle, speed and acceleration
at any instant, at every zoom. Between two keys a plan is such a cubic; where it is slowed, and for
predicted horns, knots are added until the curve is within `Tolerance`.
"""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

POSITION_DEG: Final = 0.03
"""Chosen: a third of the finest step of a servo, far below a pixel."""

SPEED_RATIO: Final = 0.01
ACCEL_RATIO: Final = 0.03
"""Of the limit of the joint. Chosen: about a pixel of a lane that is 60 pixels high."""

SWING_RATIO: Final = 4.0 / 27.0
"""A cubic with equal angles at both ends and a speed at one of them swings out by this share of
speed times length."""

ROUNDS_MAX: Final = 40
"""Each round halves what is outside of the tolerance; far fewer are needed."""


class Tolerance(Struct, frozen=True, kw_only=True):
    """How far a curve may be from the motion; infinite: it does not matter."""

    deg: float = POSITION_DEG
    deg_s: float = np.inf
    deg_s2: float = np.inf


class Curve(Struct, frozen=True):
    """Knots of a piecewise cubic, in order of time. Two knots at one instant are a jump."""

    times_s: FloatArray
    deg: FloatArray
    deg_s: FloatArray

    def at(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        """Return deg, deg/s or deg/s² for order 0, 1, 2; outside of its knots it rests."""
        index = np.searchsorted(self.times_s, times_s, side="right") - 1
        index = np.clip(index, 0, len(self.times_s) - 2)
        ends = _Ends.of(self.times_s, self.deg, self.deg_s, index, index + 1)
        inside_s = np.clip(times_s, self.times_s[0], self.times_s[-1])
        return ends.at(inside_s)[order]

    def as_json(self) -> dict[str, Any]:
        """Return the curve as the pages read it: little-endian, base64; times are f64."""
        return {
            "times_s": packed(self.times_s, "<f8"),
            "deg": packed(self.deg, "<f4"),
            "deg_s": packed(self.deg_s, "<f4"),
        }


def packed(values: NDArray[Any], kind: str) -> str:
    """Return numbers as base64 of their bytes in `kind`, a type of numpy."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode()


class Samples(Struct, frozen=True):
    """A motion at instants: what a curve is fitted to. `deg_s2` is NaN where it may jump."""

    times_s: FloatArray
    deg: FloatArray
    deg_s: FloatArray
    deg_s2: FloatArray


def fitted(samples: Samples, keys_s: FloatArray, tolerance: Tolerance) -> Curve:
    """Return the curve through few of the samples, with knots at `keys_s`, within `tolerance`.

    Where all samples are knots already, the curve is as good as the samples are dense.
    """
    times_s = samples.times_s
    last = len(times_s) - 1
    keys = np.clip(np.searchsorted(times_s, keys_s - 1e-9), 0, last)
    knots = np.unique(np.concatenate([[0, last], keys]))
    everywhere = np.arange(last + 1)
    for _ in range(ROUNDS_MAX):
        piece = np.clip(np.searchsorted(knots, everywhere, side="right") - 1, 0, len(knots) - 2)
        first, end = knots[piece], knots[piece + 1]
        found = _Ends.of(times_s, samples.deg, samples.deg_s, first, end).at(times_s)
        is_off = np.abs(found[0] - samples.deg) > tolerance.deg
        off_deg_s = np.abs(found[1] - samples.deg_s)
        is_off |= off_deg_s > tolerance.deg_s
        # A cubic whose speed is wrong at an instant swings out between the samples beside it.
        is_off |= SWING_RATIO * off_deg_s * (times_s[end] - times_s[first]) > tolerance.deg
        is_off |= np.abs(found[2] - samples.deg_s2) > tolerance.deg_s2
        halved = np.unique(piece[is_off & (end - first > 1)])
        if not len(halved):
            break
        knots = np.union1d(knots, (knots[halved] + knots[halved + 1]) // 2)
    return Curve(times_s[knots], samples.deg[knots], samples.deg_s[knots])


def between(knots_s: FloatArray, count: int) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the knots and `count` instants between each two, and which of them are knots."""
    steps_s = np.diff(knots_s)
    shares = np.arange(count + 1) / (count + 1)
    times_s = (knots_s[:-1, None] + steps_s[:, None] * shares).ravel()
    is_knot = np.zeros((len(steps_s), count + 1), dtype=np.bool_)
    is_knot[:, 0] = True
    return np.append(times_s, knots_s[-1]), np.append(is_knot.ravel(), True)


class _Ends(Struct, frozen=True):
    """Both ends of the cubic in which each instant lies."""

    start_s: FloatArray
    length_s: FloatArray
    deg: tuple[FloatArray, FloatArray]
    deg_s: tuple[FloatArray, FloatArray]

    @staticmethod
    def of(
        times_s: FloatArray,
        deg: FloatArray,
        deg_s: FloatArray,
        first: NDArray[np.intp],
        end: NDArray[np.intp],
    ) -> _Ends:
        length_s = np.maximum(times_s[end] - times_s[first], 1e-12)
        return _Ends(times_s[first], length_s, (deg[first], deg[end]), (deg_s[first], deg_s[end]))

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angle, speed and acceleration."""
        share = (times_s - self.start_s) / self.length_s
        rise = (self.deg[1] - self.deg[0]) / self.length_s
        bend = (3.0 * rise - 2.0 * self.deg_s[0] - self.deg_s[1]) / self.length_s
        twist = (self.deg_s[0] + self.deg_s[1] - 2.0 * rise) / self.length_s**2
        after_s = share * self.length_s
        return (
            self.deg[0] + after_s * (self.deg_s[0] + after_s * (bend + after_s * twist)),
            self.deg_s[0] + after_s * (2.0 * bend + 3.0 * after_s * twist),
            2.0 * bend + 6.0 * after_s * twist,
        )
