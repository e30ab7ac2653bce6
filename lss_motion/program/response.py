"""How a servo in EM1 is assumed to move on a `D…T…` command: the timed response model.

The servo keeps a *profile*, its own idea of where the horn should be: from the profile's present
position and speed it ramps to a travel speed, cruises, and brakes to a stop on the target. All
angles are servo angles in degrees, all instants seconds on one clock. The horn follows the profile
`Response.lag_s` later. Which of these assumptions come from where: `robot.model.Response`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from lss_motion.robot.model import Response

EXACT_LAW_STEPS = 40
"""Halvings in search of the travel speed of `t_law: exact`: 2⁻⁴⁰ of the top speed is far below
what a wire unit can express."""


@dataclass(frozen=True, slots=True)
class Piece:
    """The profile from `start_s` on, until the next piece: a parabola."""

    start_s: float
    position_deg: float
    speed_deg_s: float
    accel_deg_s2: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at `time_s`."""
        dt = time_s - self.start_s
        return (
            self.position_deg + dt * (self.speed_deg_s + 0.5 * self.accel_deg_s2 * dt),
            self.speed_deg_s + self.accel_deg_s2 * dt,
        )


def trapezoid(
    start: Piece, target_deg: float, travel_deg_s: float, ramp_deg_s2: float
) -> list[Piece]:
    """Return the pieces of a move that begins at `start` and ends at rest on `target_deg`.

    Faster than `travel_deg_s` at the start means braking down to it first; too fast to stop on the
    target means stopping beyond it and coming back, as a profile with bounded ramps must.
    """
    position, speed = start.position_deg, start.speed_deg_s
    stop_deg = position + speed * abs(speed) / (2.0 * ramp_deg_s2)
    sign = 1.0 if target_deg >= stop_deg else -1.0
    distance, v0 = sign * (target_deg - position), sign * speed
    peak = min(travel_deg_s, (max(0.0, ramp_deg_s2 * distance + 0.5 * v0 * v0)) ** 0.5)
    ramp_in_s = abs(peak - v0) / ramp_deg_s2
    ramp_out_s = peak / ramp_deg_s2
    covered = 0.5 * (v0 + peak) * ramp_in_s + 0.5 * peak * ramp_out_s
    cruise_s = max(0.0, distance - covered) / peak if peak > 0.0 else 0.0

    pieces: list[Piece] = []
    now = start.start_s
    accel_in = sign * ramp_deg_s2 * (1.0 if peak >= v0 else -1.0)
    for duration_s, accel in ((ramp_in_s, accel_in), (cruise_s, 0.0)):
        if duration_s > 0.0:
            pieces.append(Piece(now, position, speed, accel))
            position, speed = pieces[-1].at(now + duration_s)
            now += duration_s
            speed = sign * peak
    if ramp_out_s > 0.0:
        pieces.append(Piece(now, position, speed, -sign * ramp_deg_s2))
        now += ramp_out_s
    pieces.append(Piece(now, target_deg, 0.0, 0.0))
    return pieces


def travel_speed(
    start: Piece, target_deg: float, duration_s: float, ramp_deg_s2: float, response: Response
) -> float:
    """Return the travel speed that the servo takes for `D target T duration`, before any cap."""
    if response.t_law == "cruise":
        return abs(target_deg - start.position_deg) / duration_s
    slow, fast = 0.0, 1e4
    for _ in range(EXACT_LAW_STEPS):
        middle = 0.5 * (slow + fast)
        end_s = trapezoid(start, target_deg, middle, ramp_deg_s2)[-1].start_s
        slow, fast = (middle, fast) if end_s - start.start_s > duration_s else (slow, middle)
    return fast


class Profile:
    """The profile of one servo, command by command. Instants passed in must not go back."""

    def __init__(
        self,
        position_deg: float,
        *,
        ramp_deg_s2: float,
        speed_max_deg_s: float,
        response: Response,
        start_s: float = float("-inf"),
    ) -> None:
        self.ramp_deg_s2 = ramp_deg_s2
        self._speed_max_deg_s = speed_max_deg_s
        self._response = response
        self._pieces: list[Piece] = [Piece(start_s, position_deg, 0.0, 0.0)]

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at `time_s`; before the known history, its first position."""
        for piece in reversed(self._pieces):
            if piece.start_s <= time_s:
                return (
                    piece.at(time_s)
                    if piece.speed_deg_s or piece.accel_deg_s2
                    else (
                        piece.position_deg,
                        0.0,
                    )
                )
        return self._pieces[0].position_deg, 0.0

    @property
    def target_deg(self) -> float:
        """Where it comes to rest, if it is told nothing more."""
        return self._pieces[-1].position_deg

    def state(self, time_s: float) -> Piece:
        """Return what a command heard at `time_s` starts from."""
        position_deg, speed_deg_s = self.at(time_s)
        if self._response.retarget == "from_rest":
            speed_deg_s = 0.0
        return Piece(time_s, position_deg, speed_deg_s, 0.0)

    def retarget(self, heard_s: float, target_deg: float, duration_s: float | None) -> None:
        """Take up `D target [T duration]` at `heard_s`; what was planned after it is dropped."""
        start = self.state(heard_s)
        travel = self._speed_max_deg_s
        if duration_s is not None and target_deg != start.position_deg:
            travel = min(
                travel,
                travel_speed(start, target_deg, duration_s, self.ramp_deg_s2, self._response),
            )
        while self._pieces and self._pieces[-1].start_s >= heard_s:
            self._pieces.pop()
        self._pieces += trapezoid(start, target_deg, travel, self.ramp_deg_s2)

    def forget_before(self, time_s: float) -> None:
        """Drop history that ends before `time_s`, so that memory stays bounded."""
        while len(self._pieces) > 1 and self._pieces[1].start_s <= time_s:
            del self._pieces[0]

    def pieces(self) -> Iterator[Piece]:
        return iter(self._pieces)

    def copy(self) -> Profile:
        """Return a profile that goes on from here on its own."""
        twin = copy.copy(self)
        twin._pieces = [*self._pieces]  # noqa: SLF001  (its own)
        return twin


class Reference:
    """Where one servo's profile should be at any instant: pieces as arrays, for many samples."""

    def __init__(self, pieces: Iterable[Piece]) -> None:
        rows = [(p.start_s, p.position_deg, p.speed_deg_s, p.accel_deg_s2) for p in pieces]
        table = np.array(rows, dtype=np.float64)
        self._start_s, self._position, self._speed, self._accel = (
            np.ascontiguousarray(column) for column in table.T
        )

    @classmethod
    def of(cls, table: tuple[NDArray[np.float64], ...]) -> Reference:
        """Return what has that `table`."""
        made = cls.__new__(cls)
        made._start_s, made._position, made._speed, made._accel = table  # noqa: SLF001  (its own)
        return made

    @property
    def table(self) -> tuple[NDArray[np.float64], ...]:
        """Return the pieces: when each starts, and position, speed and acceleration there."""
        return self._start_s, self._position, self._speed, self._accel

    def followed_by(self, later: Reference, since_s: float) -> Reference:
        """Return what is known of this until `later` begins, and then `later`.

        What ended before `since_s` is forgotten.
        """
        end = int(np.searchsorted(self._start_s, later.table[0][0], side="left"))
        first = max(int(np.searchsorted(self._start_s, since_s, side="right")) - 1, 0)
        parts = zip(self.table, later.table, strict=True)
        return Reference.of(tuple(np.concatenate([own[first:end], new]) for own, new in parts))

    @property
    def end_s(self) -> float:
        """When the last piece, which is at rest, begins; -inf if there is no other."""
        return float(self._start_s[-1])

    def sample(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions in degrees at `times_s`; at rest before the first piece."""
        index = np.maximum(np.searchsorted(self._start_s, times_s, side="right") - 1, 0)
        return _along(times_s, *(column[index] for column in self.table))

    def on_grid(self, start_s: float, step_s: float, count: int) -> NDArray[np.float64]:
        """Return what `sample` does at `count` instants every `step_s`, quicker for many."""
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
        index = max(int(np.searchsorted(self._start_s, time_s, side="right")) - 1, 0)
        dt = time_s - float(self._start_s[index])
        if not 0.0 <= dt < float("inf"):
            return float(self._position[index]), 0.0
        speed, accel = float(self._speed[index]), float(self._accel[index])
        return float(self._position[index]) + dt * (speed + 0.5 * accel * dt), speed + accel * dt


def _along(
    times_s: NDArray[np.float64],
    start_s: NDArray[np.float64],
    position_deg: NDArray[np.float64],
    speed_deg_s: NDArray[np.float64],
    accel_deg_s2: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return positions on pieces, one an instant; before a piece it stands where that begins."""
    dt = np.maximum(times_s - start_s, 0.0)
    dt[~np.isfinite(dt)] = 0.0
    found: NDArray[np.float64] = position_deg + dt * (speed_deg_s + 0.5 * accel_deg_s2 * dt)
    return found
