"""From the raw readings of a servo to a smooth recording at even times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

STEP_S: Final = 0.01
"""Recordings are kept at 100 Hz, finer than any hand moves; joints then share their times."""

WINDOW_S: Final = 0.1
"""A parabola through the readings of so long is what a hand did in its middle. Chosen: a hand's
motion ends at 10 Hz, and at 50 readings a second it averages five of them."""

OUTLIER_DEG: Final = 0.7
"""A reading this far from the line between its neighbours, and further than a hand could bend it
(`HAND_DEG_S2`), was damaged on the line: replies carry no checksum. Chosen: above the noise."""

HAND_DEG_S2: Final = 4000.0
"""The hardest that a hand accelerates a joint. Assumed: a shake of 20 deg at 3 Hz."""

AVERAGED_S: Final = 0.02
"""Readings within so long are one. Chosen: a hand moves a joint evenly for longer."""

OUTLIER_ROUNDS: Final = 10
"""Damaged readings side by side are taken out one a round."""


SOFT_DEG: Final = 2.0
"""How gently a motion beyond a range is bent back: at 90 deg/s this asks for 1000 deg/s²."""

TRIFLE_DEG: Final = 0.5
"""So little beyond a range is noise and is cut off plainly."""

STANDING_DEG_S: Final = 5.0
"""Slower than this a joint stands: noise of the readings is 2 deg/s over `WINDOW_S`."""


@dataclass(frozen=True, slots=True)
class Clean:
    """Angles at even times from the first reading on; `noise_deg` is what was taken out, RMS."""

    times_s: FloatArray
    angles_deg: FloatArray
    noise_deg: float


def cleaned(times_s: FloatArray, angles_deg: FloatArray) -> Clean:
    """Return a recording without damaged readings and noise. Times increase, one or more."""
    for _ in range(OUTLIER_ROUNDS):
        is_outlier = _outliers(times_s, angles_deg)
        if not is_outlier.any():
            break
        times_s, angles_deg = times_s[~is_outlier], angles_deg[~is_outlier]
    first, last = int(np.floor(times_s[0] / STEP_S)), int(np.ceil(times_s[-1] / STEP_S))
    even_s = np.round(STEP_S * np.arange(first, last + 1), 6)
    even_deg = _between(*_averaged(times_s, angles_deg), even_s)
    rate_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else STEP_S
    width = int(max(WINDOW_S, 5.0 * rate_s) / STEP_S) | 1
    if len(even_s) > width:
        from scipy.signal import savgol_filter

        even_deg = savgol_filter(even_deg, width, polyorder=2, mode="interp")
    noise_deg = float(np.sqrt(np.mean((np.interp(times_s, even_s, even_deg) - angles_deg) ** 2)))
    return Clean(even_s, even_deg, noise_deg)


def _averaged(times_s: FloatArray, angles_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return one reading for each `AVERAGED_S` that has any: so close, two show only noise."""
    bins = np.floor(times_s / AVERAGED_S).astype(np.intp)
    _, places, counts = np.unique(bins, return_inverse=True, return_counts=True)
    return np.bincount(places, times_s) / counts, np.bincount(places, angles_deg) / counts


def _between(times_s: FloatArray, angles_deg: FloatArray, at_s: FloatArray) -> FloatArray:
    """Return angles at any times: a curve that never swings beyond the readings around a gap."""
    if len(times_s) < 3:
        return np.interp(at_s, times_s, angles_deg)
    from scipy.interpolate import PchipInterpolator

    inside_s = np.clip(at_s, times_s[0], times_s[-1])
    return np.asarray(PchipInterpolator(times_s, angles_deg)(inside_s), dtype=np.float64)


def _outliers(times_s: FloatArray, angles_deg: FloatArray) -> NDArray[np.bool_]:
    """Return the readings that no hand could have made; of neighbours, only the worst."""
    found = np.zeros(len(times_s), dtype=np.bool_)
    if len(times_s) < 4:
        return found
    off_deg = np.zeros(len(times_s))
    before_s, after_s = np.diff(times_s)[:-1], np.diff(times_s)[1:]
    share = before_s / (before_s + after_s)
    expected = angles_deg[:-2] + share * (angles_deg[2:] - angles_deg[:-2])
    bend_deg = OUTLIER_DEG + 0.5 * HAND_DEG_S2 * before_s * after_s
    off_deg[1:-1] = np.abs(angles_deg[1:-1] - expected) / bend_deg
    # The ends, from the line through the two readings next to them.
    for end, near, far in ((0, 1, 2), (-1, -2, -3)):
        near_s, far_s = abs(times_s[end] - times_s[near]), abs(times_s[end] - times_s[far])
        slope = (angles_deg[near] - angles_deg[far]) / (far_s - near_s)
        bend_deg_end = OUTLIER_DEG + 0.5 * HAND_DEG_S2 * near_s * far_s
        off_deg[end] = abs(angles_deg[end] - angles_deg[near] - slope * near_s) / bend_deg_end
    worst = np.maximum(off_deg[:-2], off_deg[2:])
    found[1:-1] = (off_deg[1:-1] > 1.0) & (off_deg[1:-1] >= worst)
    found[0] = off_deg[0] > 1.0 and off_deg[0] > off_deg[1]
    found[-1] = off_deg[-1] > 1.0 and off_deg[-1] > off_deg[-2]
    return found


def at_rest(
    times_s: FloatArray, angles_deg: FloatArray, braking_deg_s2: float
) -> tuple[FloatArray, FloatArray]:
    """Return even samples with more of them where a joint moves at the start or at the end.

    It is braked there after the end, and got going before the start, at times below the first.
    """
    if len(times_s) < 3:
        return times_s, angles_deg
    after_s, after_deg = _braked(float(angles_deg[-1]), float(angles_deg[-3]), braking_deg_s2)
    before_s, before_deg = _braked(float(angles_deg[0]), float(angles_deg[2]), braking_deg_s2)
    return (
        np.round(np.concatenate([times_s[0] - before_s[::-1], times_s, times_s[-1] + after_s]), 6),
        np.concatenate([before_deg[::-1], angles_deg, after_deg]),
    )


def _braked(
    end_deg: float, before_deg: float, braking_deg_s2: float
) -> tuple[FloatArray, FloatArray]:
    """Return how long after an end, and where, a joint is on its way to rest."""
    speed_deg_s = (end_deg - before_deg) / (2.0 * STEP_S)
    if abs(speed_deg_s) < STANDING_DEG_S:
        return np.empty(0), np.empty(0)
    braking_s = abs(speed_deg_s) / braking_deg_s2
    after_s = STEP_S * np.arange(1.0, np.ceil(braking_s / STEP_S) + 1.0)
    until_s = np.minimum(after_s, braking_s)
    return after_s, end_deg + speed_deg_s * until_s * (1.0 - 0.5 * until_s / braking_s)


def within(angles_deg: FloatArray, low_deg: float, high_deg: float) -> FloatArray:
    """Return angles in a range; what goes far beyond it is bent back without a corner."""
    soft_deg = min(SOFT_DEG, 0.1 * (high_deg - low_deg))
    if angles_deg.max() > high_deg + TRIFLE_DEG:
        angles_deg = high_deg - soft_deg * np.logaddexp(0.0, (high_deg - angles_deg) / soft_deg)
    if angles_deg.min() < low_deg - TRIFLE_DEG:
        angles_deg = low_deg + soft_deg * np.logaddexp(0.0, (angles_deg - low_deg) / soft_deg)
    return np.clip(angles_deg, low_deg, high_deg)
