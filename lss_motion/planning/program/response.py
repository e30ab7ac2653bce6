"""The response model of servos in EM1: how they move on `D…T…`, in arrays.

The servo computes a *profile*: from its present position and speed it ramps to a travel speed,
cruises, and brakes to a stop on the target. Angles are servo angles in degrees, instants are
seconds on one clock. The horn follows the profile `Response.lag_s` later. `robot.model.Response`
names the source of each of these assumptions.

`robot.profile.Profile` is the model of one servo, command by command. The functions on `States`
compute the same for many servos at once: they take and return arrays, an
element a servo, or rows of such, a row a candidate. A property test holds both to the same numbers.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from lss_motion.robot.profile import Piece

    FloatArray = NDArray[np.float64]
    SingleArray = NDArray[np.float32]
    IntArray = NDArray[np.intp]
    BoolArray = NDArray[np.bool_]
    Index = IntArray | BoolArray | slice

SPEED_TINY_DEG_S = 1e-12
"""Keeps divisions finite; no servo moves this slowly."""


class PiecewiseProfile:
    """The profile of one servo over all of a show: its pieces as arrays, for many samples."""

    _near: tuple[float, float, float, float, float] = (math.inf, -math.inf, 0.0, 0.0, 0.0)
    """The last piece that `at` has used: its begin and end, position, speed, acceleration."""

    def __init__(self, pieces: Iterable[Piece]) -> None:
        rows = [(p.start_s, p.position_deg, p.speed_deg_s, p.accel_deg_s2) for p in pieces]
        table = np.array(rows, dtype=np.float64)
        self._start_s, self._position, self._speed, self._accel = (
            np.ascontiguousarray(column) for column in table.T
        )

    @classmethod
    def of(cls, table: tuple[NDArray[np.float64], ...]) -> PiecewiseProfile:
        """Return the profile with this `table`, without a copy."""
        made = cls.__new__(cls)
        made._start_s, made._position, made._speed, made._accel = table  # noqa: SLF001  (its own)
        return made

    @property
    def table(self) -> tuple[NDArray[np.float64], ...]:
        """The pieces: when each starts, and position, speed and acceleration there."""
        return self._start_s, self._position, self._speed, self._accel

    def followed_by(self, later: PiecewiseProfile, since_s: float) -> PiecewiseProfile:
        """Return this profile until `later` begins, and then `later`.

        Pieces that ended before `since_s` are dropped.
        """
        end = int(np.searchsorted(self._start_s, later.table[0][0], side="left"))
        first = max(int(np.searchsorted(self._start_s, since_s, side="right")) - 1, 0)
        parts = zip(self.table, later.table, strict=True)
        return PiecewiseProfile.of(
            tuple(np.concatenate([own[first:end], new]) for own, new in parts)
        )

    @property
    def end_s(self) -> float:
        """When the last piece, which is at rest, begins; -inf if it is the only one."""
        return float(self._start_s[-1])

    def sample(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions in degrees at `times_s`. Before the first piece the profile rests."""
        index = np.maximum(np.searchsorted(self._start_s, times_s, side="right") - 1, 0)
        return _along(times_s, *(column[index] for column in self.table))

    def on_grid(self, start_s: float, step_s: float, count: int) -> NDArray[np.float64]:
        """Return `sample` at `count` instants every `step_s`, faster for many instants."""
        first = np.ceil((self._start_s - start_s) / step_s)
        first = np.minimum(np.maximum(first, 0.0), count).astype(np.intp)
        counts = np.diff(first, append=count)
        counts[0] += first[0]
        first_s = start_s + step_s * first
        dt = first_s - self._start_s
        dt[~np.isfinite(dt)] = 0.0
        steps = np.arange(count, dtype=np.float64)
        steps -= np.repeat(first, counts)
        found: NDArray[np.float64] = np.repeat(0.5 * step_s * step_s * self._accel, counts)
        found *= steps
        found += np.repeat(step_s * (self._speed + self._accel * dt), counts)
        found *= steps
        found += np.repeat(_along(first_s, *self.table), counts)
        found[: first[0]] = self._position[0]
        return found

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at one instant."""
        start_s, end_s, position_deg, speed_deg_s, accel_deg_s2 = self._near
        if not start_s <= time_s < end_s:
            self._near = self._piece(time_s)
            start_s, end_s, position_deg, speed_deg_s, accel_deg_s2 = self._near
        dt = time_s - start_s
        if not 0.0 <= dt < math.inf:
            return position_deg, 0.0
        return (
            position_deg + dt * (speed_deg_s + 0.5 * accel_deg_s2 * dt),
            speed_deg_s + accel_deg_s2 * dt,
        )

    def _piece(self, time_s: float) -> tuple[float, float, float, float, float]:
        """Return the piece at one instant as `_near`; before the first piece that one."""
        index = max(bisect_right(self._start_s.data, time_s) - 1, 0)
        is_last = index + 1 == len(self._start_s)
        return (
            self._start_s.item(index),
            math.inf if is_last else self._start_s.item(index + 1),
            self._position.item(index),
            self._speed.item(index),
            self._accel.item(index),
        )


def _along(
    times_s: NDArray[np.float64],
    start_s: NDArray[np.float64],
    position_deg: NDArray[np.float64],
    speed_deg_s: NDArray[np.float64],
    accel_deg_s2: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return positions, one piece and instant an element; before a piece, its first position."""
    dt = np.maximum(times_s - start_s, 0.0)
    dt[~np.isfinite(dt)] = 0.0
    found: NDArray[np.float64] = position_deg + dt * (speed_deg_s + 0.5 * accel_deg_s2 * dt)
    return found


class States(Struct, frozen=True):
    """Positions and speeds of profiles, each at an instant of its own."""

    time_s: FloatArray
    position_deg: FloatArray
    speed_deg_s: FloatArray

    def take(self, chosen: Index) -> States:
        return States(self.time_s[chosen], self.position_deg[chosen], self.speed_deg_s[chosen])


def concatenated_states(one: States, other: States) -> States:
    """Return the states of `one`, followed by those of `other`."""
    return States(
        np.concatenate((one.time_s, other.time_s)),
        np.concatenate((one.position_deg, other.position_deg)),
        np.concatenate((one.speed_deg_s, other.speed_deg_s)),
    )


class Trapezoids(Struct, frozen=True):
    """Moves to rest: a ramp to the peak speed, a cruise, a ramp down, as `trapezoid` for one servo.

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
        """Return how long profiles have ramped up and down, and their positions."""
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
    """Return the travel speeds of servos for `D target T duration`, before their limits."""
    cruising: FloatArray = np.abs(target_deg - start.position_deg) / duration_s
    if not is_exact.any():
        return cruising
    return np.where(is_exact, exact_speeds(start, target_deg, duration_s, ramp_deg_s2), cruising)


def exact_speeds(
    start: States, target_deg: FloatArray, duration_s: FloatArray, ramp_deg_s2: FloatArray
) -> FloatArray:
    """Return the travel speeds with which moves last `duration_s`; infinite if none does.

    A move at the travel speed `c` spends (c - v)/a and c/a in its ramps, and the rest of the
    distance at `c`. This gives a quadratic equation for c > v and a linear one below.
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
    is_reached = (root >= 0.0) & (linear > 0.0)  # Else: no time to turn round.
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
    """Return the T with which servos travel at `travel_deg_s`: the inverse of `speeds_for`."""
    cruising: FloatArray = np.abs(target_deg - start.position_deg) / travel_deg_s
    if not is_exact.any():
        return cruising
    exact_s = trapezoids(start, target_deg, travel_deg_s, ramp_deg_s2).end_s - start.time_s
    return np.where(is_exact, exact_s, cruising)


FADED: Final = 1e-6
"""What is left of a distance has no influence."""


def lagged_deg(position_deg: FloatArray, step_s: float, lag_s: float) -> FloatArray:
    """Return the angles of a horn that follows positions on a grid with a first-order lag.

    It rests before them. Between the points of the grid the positions are taken as straight.
    """
    keep_ratio = math.exp(-step_s / lag_s) if lag_s > 0.0 else 0.0
    away_deg = position_deg - position_deg[0]
    found = np.append(away_deg[:1], 0.5 * (away_deg[1:] + away_deg[:-1]))
    found *= 1.0 - keep_ratio
    shift, kept_ratio = 1, keep_ratio
    while kept_ratio > FADED and shift < len(found):  # The sum over so many steps, then twice.
        found[shift:] += kept_ratio * found[:-shift]
        shift, kept_ratio = 2 * shift, kept_ratio * kept_ratio
    found += position_deg[0]
    return found
