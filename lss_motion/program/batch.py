"""The timed response model for many servos at once: `response` in arrays.

Every function takes and returns arrays, an element a servo, or rows of such: a row for each trial.
What it says is what `response.Profile` says of each alone, which a test holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]
    SingleArray = NDArray[np.float32]
    IntArray = NDArray[np.intp]
    BoolArray = NDArray[np.bool_]
    Index = IntArray | BoolArray | slice

SPEED_TINY_DEG_S = 1e-12
"""Keeps divisions finite; no servo moves this slowly."""


@dataclass(frozen=True, slots=True)
class States:
    """Where profiles are and how fast, at instants of their own."""

    time_s: FloatArray
    position_deg: FloatArray
    speed_deg_s: FloatArray

    def take(self, chosen: Index) -> States:
        return States(self.time_s[chosen], self.position_deg[chosen], self.speed_deg_s[chosen])


def both(one: States, other: States) -> States:
    """Return the states of both, one after the other."""
    return States(
        np.concatenate((one.time_s, other.time_s)),
        np.concatenate((one.position_deg, other.position_deg)),
        np.concatenate((one.speed_deg_s, other.speed_deg_s)),
    )


@dataclass(frozen=True, slots=True)
class Trapezoids:
    """Moves to rest: a ramp to the peak speed, a cruise, a ramp down (`response.trapezoid`).

    Speeds and accelerations count in the direction of the move, `sign`.
    """

    start: States
    sign: FloatArray
    ramp_deg_s2: FloatArray
    first_deg_s: FloatArray
    peak_deg_s: FloatArray
    first_s: FloatArray
    cruise_s: FloatArray

    def take(self, chosen: IntArray) -> Trapezoids:
        """Return the moves of the `chosen` servos, in all rows."""
        moves = (self.sign, self.ramp_deg_s2, self.first_deg_s, self.peak_deg_s, self.first_s)
        own = (column.take(chosen, axis=-1) for column in (*moves, self.cruise_s))
        return Trapezoids(self.start.take(chosen), *own)

    @property
    def end_s(self) -> FloatArray:
        """When the profiles come to rest."""
        last_s = self.peak_deg_s / self.ramp_deg_s2
        end_s: FloatArray = self.start.time_s + self.first_s + self.cruise_s + last_s
        return end_s

    def at(self, times_s: FloatArray) -> States:
        """Return the states at `times_s`, which must not be before the start."""
        tau_s = times_s - self.start.time_s
        first_s, last_s, position_deg = self._after(tau_s)
        gained = np.copysign(self.ramp_deg_s2, self.peak_deg_s - self.first_deg_s) * first_s
        speed = np.where(
            tau_s < self.first_s,
            self.first_deg_s + gained,
            self.peak_deg_s - self.ramp_deg_s2 * last_s,
        )
        return States(times_s, position_deg, self.sign * speed)

    def positions_deg(self, times_s: FloatArray) -> FloatArray:
        """Return the positions at `times_s`, which must not be before the start."""
        return self._after(times_s - self.start.time_s)[2]

    def _after(self, tau_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return for how long profiles have ramped to their peaks and down, and where they are."""
        first_s = np.minimum(tau_s, self.first_s)
        left_s = tau_s - self.first_s
        cruise_s = np.maximum(left_s, 0.0)
        np.minimum(cruise_s, self.cruise_s, out=cruise_s)
        left_s -= self.cruise_s
        np.maximum(left_s, 0.0, out=left_s)
        last_s = np.minimum(left_s, self.peak_deg_s / self.ramp_deg_s2, out=left_s)
        change = np.copysign(0.5 * self.ramp_deg_s2, self.peak_deg_s - self.first_deg_s)
        way = (self.first_deg_s + change * first_s) * first_s
        cruise_s *= self.peak_deg_s
        way += cruise_s
        way += (self.peak_deg_s - 0.5 * self.ramp_deg_s2 * last_s) * last_s
        way *= self.sign
        way += self.start.position_deg
        return first_s, last_s, way


def trapezoids(
    start: States, target_deg: FloatArray, travel_deg_s: FloatArray, ramp_deg_s2: FloatArray
) -> Trapezoids:
    """Return the moves that begin at `start` and end at rest on `target_deg`."""
    speed = start.speed_deg_s
    away = target_deg - start.position_deg
    sign = np.where(away >= speed * np.abs(speed) / (2.0 * ramp_deg_s2), 1.0, -1.0)
    distance, first = sign * away, sign * speed
    reachable = np.sqrt(np.maximum(ramp_deg_s2 * distance + 0.5 * first * first, 0.0))
    peak = np.minimum(travel_deg_s, reachable)
    first_s = np.abs(peak - first) / ramp_deg_s2
    covered = 0.5 * ((first + peak) * first_s + peak * peak / ramp_deg_s2)
    cruise_s = np.maximum(distance - covered, 0.0) / np.maximum(peak, SPEED_TINY_DEG_S)
    return Trapezoids(start, sign, ramp_deg_s2, first, peak, first_s, cruise_s)


def speeds_for(
    start: States,
    target_deg: FloatArray,
    duration_s: FloatArray,
    ramp_deg_s2: FloatArray,
    is_exact: BoolArray,
) -> FloatArray:
    """Return the travel speeds that servos take for `D target T duration`, before any cap."""
    asked: FloatArray = np.abs(target_deg - start.position_deg) / duration_s
    if not is_exact.any():
        return asked
    return np.where(is_exact, exact_speeds(start, target_deg, duration_s, ramp_deg_s2), asked)


def exact_speeds(
    start: States, target_deg: FloatArray, duration_s: FloatArray, ramp_deg_s2: FloatArray
) -> FloatArray:
    """Return the travel speeds with which moves last `duration_s`; infinite where none is so fast.

    Of the time that a move at `c` takes, its ramps take (c - v)/a and c/a; what they leave of the
    distance is travelled at `c`. That is a square in `c` for c > v and a line below.
    """
    speed, ramp = start.speed_deg_s, ramp_deg_s2
    away = target_deg - start.position_deg
    sign = np.where(away >= speed * np.abs(speed) / (2.0 * ramp), 1.0, -1.0)
    distance, first = sign * away, sign * speed
    braked = 0.5 * first * first / ramp
    with np.errstate(divide="ignore", invalid="ignore"):
        slower = (distance - braked) / (duration_s - first / ramp)
    linear = ramp * duration_s + first
    root = linear * linear - 4.0 * ramp * (distance + braked)
    is_reached = (root >= 0.0) & (linear > 0.0)  # Below, there is not even the time to turn round.
    faster = np.where(is_reached, 0.5 * (linear - np.sqrt(np.maximum(root, 0.0))), np.inf)
    is_slower = (duration_s * ramp > first) & (slower <= first)
    found: FloatArray = np.where(is_slower, np.maximum(slower, 0.0), faster)
    return found


def durations_for(
    start: States,
    target_deg: FloatArray,
    travel_deg_s: FloatArray,
    ramp_deg_s2: FloatArray,
    is_exact: BoolArray,
) -> FloatArray:
    """Return the T that make servos travel at `travel_deg_s`: the inverse of `speeds_for`."""
    asked: FloatArray = np.abs(target_deg - start.position_deg) / travel_deg_s
    if not is_exact.any():
        return asked
    exact_s = trapezoids(start, target_deg, travel_deg_s, ramp_deg_s2).end_s - start.time_s
    return np.where(is_exact, exact_s, asked)
