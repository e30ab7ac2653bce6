"""What the samples of a recording ask of a servo, and the spline through them that asks no more.

A spline through samples exactly swings about where the acceleration jumps, so a motion that sits
at its limits would be slowed there when it is planned again. The spline whose control points are
the samples does not: its speeds and accelerations are averages of the recording's own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from lss_motion.interchange.interpolant import FloatArray

EVENING_MAX_DEG: Final = 0.02
"""How far a key may be from its sample: 1000 deg/s² (all that the ramps of a servo can express)
at 100 Hz come to 0.017 deg. Where it would be more, the sample itself is the key."""

EVEN_RATIO: Final = 0.01
"""Steps of time that differ by less are even. Chosen: microseconds at 1 kHz are 0.1 %."""

REPEAT_DEG: Final = 1e-9
"""Samples this near are at rest and stay what they are."""


def evened(times_s: FloatArray, values: FloatArray, most_deg: float) -> FloatArray:
    """Return the values at the samples of the uniform cubic B-spline that they control.

    From rest to rest, as keys are. No value is moved by more than `most_deg`: then it stays.
    """
    if len(values) < 3:
        return values
    steps_s = np.diff(times_s)
    steps_s = np.concatenate([steps_s[:1], steps_s, steps_s[-1:]])
    is_even = np.abs(np.diff(steps_s)) <= EVEN_RATIO * steps_s[1:]
    around = np.concatenate([values[1:2], values, values[-2:-1]])
    by = (around[:-2] - 2.0 * values + around[2:]) / 6.0
    is_moved = is_even & (np.abs(by) <= most_deg) & (np.abs(by) > REPEAT_DEG)
    return np.where(is_moved, values + by, values)


def drive(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return speed and acceleration of the recording around each sample, without signs."""
    if len(values) < 3:
        return np.full(len(values), np.inf), np.full(len(values), np.inf)
    steps_s = np.diff(times_s)
    speeds = np.diff(values) / steps_s
    accels = np.abs(2.0 * np.diff(speeds) / (steps_s[1:] + steps_s[:-1]))
    speeds = np.abs(speeds)
    return (
        np.maximum(np.append(speeds, 0.0), np.append(0.0, speeds)),
        np.concatenate([accels[:1], accels, accels[-1:]]),
    )
