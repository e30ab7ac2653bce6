"""How far along its path a motion is at every instant: piecewise parabolas over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """Path position over time. Piece i starts at `times_s[i]` and `path_s[i]`.

    `rates[i]` is how fast the path is followed there (1: one path second a second) and
    `rate_slopes[i]` its growth per second. `times_s` and `path_s` have one entry more: the end.
    Rates may jump where every joint rests.
    """

    times_s: FloatArray
    path_s: FloatArray
    rates: FloatArray
    rate_slopes: FloatArray

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    def positions(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return path position, rate and slope of the rate at times within the duration."""
        pieces = np.searchsorted(self.times_s, times_s, side="right") - 1
        pieces = np.clip(pieces, 0, len(self.rates) - 1)
        local_s = times_s - self.times_s[pieces]
        rates, slopes = self.rates[pieces], self.rate_slopes[pieces]
        path_s = self.path_s[pieces] + local_s * (rates + 0.5 * slopes * local_s)
        # Rounding must not carry a position into the next cubic, whose curve is another one.
        path_s = np.minimum(path_s, self.path_s[pieces + 1])
        return path_s, rates + slopes * local_s, slopes

    def times_of(self, path_s: FloatArray) -> FloatArray:
        """Return when each path position is first reached."""
        pieces = np.searchsorted(self.path_s[1:], path_s, side="left")
        pieces = np.clip(pieces, 0, len(self.rates) - 1)
        distance_s = path_s - self.path_s[pieces]
        rates = self.rates[pieces]
        end_rates = np.sqrt(np.maximum(rates**2 + 2.0 * self.rate_slopes[pieces] * distance_s, 0.0))
        mean_rates = 0.5 * (rates + end_rates)
        is_moving = (mean_rates > 0.0) & (distance_s > 0.0)
        spent_s = np.where(is_moving, distance_s / np.where(is_moving, mean_rates, 1.0), 0.0)
        return np.minimum(self.times_s[pieces] + spent_s, self.times_s[pieces + 1])

    def cut(self, from_s: float, to_s: float) -> Clock:
        """Return the part between two path positions that are boundaries, starting at 0 and 0."""
        first = int(np.argmin(np.abs(self.path_s[:-1] - from_s)))
        last = len(self.path_s) - 1 - int(np.argmin(np.abs(self.path_s[:0:-1] - to_s)))
        return Clock(
            times_s=self.times_s[first : last + 1] - self.times_s[first],
            path_s=self.path_s[first : last + 1] - self.path_s[first],
            rates=self.rates[first:last],
            rate_slopes=self.rate_slopes[first:last],
        )


def steady(length_s: float) -> Clock:
    """Return the clock that follows a path of that length at rate 1."""
    return Clock(
        times_s=np.array([0.0, length_s]),
        path_s=np.array([0.0, length_s]),
        rates=np.ones(1),
        rate_slopes=np.zeros(1),
    )
