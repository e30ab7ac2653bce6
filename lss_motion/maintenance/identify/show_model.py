"""The response model of one servo over all pieces of a show, for many sets of parameters at once.

A row is a set of parameters, a column a piece (`show_pieces`). The profile of the servo is that of
`planning.program.response`; the horn follows it with a lag, at most at the top speed, with play,
and pulled by its load.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from lss_motion.planning.program.response import FADED, States, Trapezoids, exact_speeds, trapezoids

if TYPE_CHECKING:
    from lss_motion.maintenance.identify.response_fit import Hypothesis
    from lss_motion.maintenance.identify.show_pieces import Pieces
    from lss_motion.planning.program.response import FloatArray

RAMP, LAG, DEAD, LOAD, PLAY, TOP = 0, 1, 2, 3, 6, 7
SIZE: Final = 8
"""Shared parameters: logarithms of ramp and lag, dead time, three of the load, play, logarithm of
the top speed. Those of a piece: the waits of its moves, then angle and speed of its begin."""
TINY_DEG_S: Final = 1e-6
"""A move to where the servo stands has this speed."""


class Vectors(NamedTuple):
    """Sets of parameters: shared (sets, `SIZE`), and of pieces (sets, pieces, moves + 2)."""

    shared: FloatArray
    own: FloatArray

    @classmethod
    def of(cls, shared: FloatArray, pieces: Pieces) -> Vectors:
        """Return sets without waits, that begin where the pieces say."""
        count, moves = pieces.received_s.shape
        return cls(shared, np.zeros((1, count, moves + 2)))

    def at(self, index: int) -> Vectors:
        """Return one set as a set of sets."""
        own = self.own[index : index + 1] if len(self.own) > 1 else self.own
        return Vectors(self.shared[index : index + 1], own)


class ShowModel:
    """The pieces of one joint, and what its servo does in them under one hypothesis."""

    def __init__(
        self, pieces: Pieces, hypothesis: Hypothesis, *, speed_max_deg_s: float, step_s: float
    ) -> None:
        """Compute horns in steps of `step_s`."""
        self._pieces, self._hypothesis = pieces, hypothesis
        self._speed_max_deg_s, self._step_s = speed_max_deg_s, step_s
        self._grid_s = step_s * np.arange(math.ceil(pieces.last_s / step_s) + 2)

    def speeds_deg_s(self, vectors: Vectors) -> FloatArray:
        """Return the speed of the profile at each reading."""
        profile_deg = self._profiles_deg(vectors)[0]
        speed_deg_s = np.asarray(np.gradient(profile_deg, self._step_s, axis=1), dtype=np.float64)
        found: FloatArray = np.abs(self._at_readings(speed_deg_s[None])[0])
        return found

    def readings_deg(self, vectors: Vectors) -> FloatArray:
        """Return what the servo would read, (sets, readings)."""
        horn_deg = self._at_readings(self._horns_deg(vectors, self._profiles_deg(vectors)))
        angle = np.radians(horn_deg)
        load = vectors.shared[:, LOAD : LOAD + 3, None]
        found: FloatArray = horn_deg - (
            load[:, 0] + load[:, 1] * np.sin(angle) + load[:, 2] * np.cos(angle)
        )
        return found

    def _at_readings(self, values: FloatArray) -> FloatArray:
        """Return values on the grid, (sets, pieces, steps), at the readings."""
        place = self._pieces.time_s / self._step_s
        low = np.clip(place.astype(np.intp), 0, len(self._grid_s) - 2)
        part, row = place - low, self._pieces.piece
        found: FloatArray = (1.0 - part) * values[:, row, low] + part * values[:, row, low + 1]
        return found

    def _profiles_deg(self, vectors: Vectors) -> FloatArray:
        """Return the profiles on the grid, (sets, pieces, steps).

        Each move is four parabolas of time: ramp, cruise, ramp, rest. Each holds for the points of
        the grid up to the next one, or to the next move.
        """
        moves = self._moves(vectors)
        rows = [phase for move in moves for phase in _phases(move)]
        starts_s, positions, speeds, accels = (
            np.stack([row[column] for row in rows], axis=-1) for column in range(4)
        )
        next_s = np.stack([move.start.time_s for move in moves[1:]], axis=-1).repeat(4, axis=-1)
        begins_s = starts_s.copy()
        np.minimum(begins_s[..., :-4], next_s, out=begins_s[..., :-4])
        count = len(self._grid_s)
        first = np.minimum(np.ceil(begins_s / self._step_s), count).astype(np.intp)
        first = np.maximum(np.maximum.accumulate(first, axis=-1), 0)
        first[..., 0] = 0
        counts = np.diff(first, axis=-1, append=count).ravel()
        shape = (*first.shape[:2], count)
        begun_s, position, speed, accel = (
            np.repeat(column.ravel(), counts).reshape(shape)
            for column in (starts_s, positions, speeds, 0.5 * accels)
        )
        passed_s = np.maximum(self._grid_s - begun_s, 0.0)
        found: FloatArray = position + passed_s * (speed + passed_s * accel)
        return found

    def _moves(self, vectors: Vectors) -> list[Trapezoids]:
        """Return each move with the state in which the servo takes it up, (sets, pieces)."""
        pieces, own = self._pieces, vectors.own
        shape = (len(vectors.shared), len(pieces.start_deg))
        ramp = np.broadcast_to(np.exp(vectors.shared[:, RAMP, None]), shape)
        taken_s = pieces.received_s + vectors.shared[:, DEAD, None, None] + own[..., :-2]
        position_deg = pieces.start_deg + own[..., -2]
        speed_deg_s = pieces.start_deg_s + own[..., -1]
        moves: list[Trapezoids] = []
        for index in range(pieces.received_s.shape[1]):
            begin_s = taken_s[:, :, index]
            if moves:
                begin_s = np.maximum(begin_s, moves[-1].start.time_s)
                state = moves[-1].at(begin_s)
                position_deg, speed_deg_s = state.position_deg, state.speed_deg_s
            if self._hypothesis.retarget == "from_rest":
                speed_deg_s = np.zeros(shape)
            start = States(
                begin_s, np.broadcast_to(position_deg, shape), np.broadcast_to(speed_deg_s, shape)
            )
            target_deg = np.broadcast_to(pieces.target_deg[:, index], shape)
            travel_deg_s = self._travel_deg_s(start, target_deg, pieces.duration_s[:, index], ramp)
            moves.append(trapezoids(start, target_deg, travel_deg_s, ramp))
        return moves

    def _travel_deg_s(
        self, start: States, target_deg: FloatArray, duration_s: FloatArray, ramp: FloatArray
    ) -> FloatArray:
        """Return the travel speeds that the servo makes of each T."""
        if self._hypothesis.t_law == "exact":
            asked_deg_s = exact_speeds(start, target_deg, duration_s, ramp)
        else:
            asked_deg_s = np.abs(target_deg - start.position_deg) / duration_s
        asked_deg_s = np.maximum(asked_deg_s, TINY_DEG_S)
        found: FloatArray = np.minimum(asked_deg_s, self._speed_max_deg_s)
        return found

    def _horns_deg(self, vectors: Vectors, profile_deg: FloatArray) -> FloatArray:
        """Return the shafts of horns that follow profiles: with lag, top speed and play."""
        sets, pieces, count = profile_deg.shape
        columns = np.ascontiguousarray(profile_deg.reshape(-1, count).T)
        lag_s, top_deg_s = np.exp(vectors.shared[:, [LAG, TOP]].T)
        half_deg = 0.5 * np.maximum(vectors.shared[:, PLAY], 0.0)
        horn_deg = _horns_deg(
            columns,
            lag_s.repeat(pieces) / self._step_s,
            self._step_s * top_deg_s.repeat(pieces),
            half_deg.repeat(pieces),
        )
        return horn_deg.T.reshape(sets, pieces, count)


def _phases(move: Trapezoids) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return begin, position, speed and acceleration of the four phases of a move."""
    sign, ramp, peak = move.sign, move.ramp_deg_s2, move.peak_deg_s
    change = np.copysign(ramp, peak - move.first_deg_s)
    first_s = move.start.time_s
    second_s = first_s + move.first_s
    third_s, last_s = second_s + move.cruise_s, peak / ramp
    at_deg = move.start.position_deg
    second_deg = at_deg + sign * 0.5 * (move.first_deg_s + peak) * move.first_s
    third_deg = second_deg + sign * peak * move.cruise_s
    end_deg = third_deg + sign * 0.5 * peak * last_s
    none = np.zeros_like(peak)
    return [
        (first_s, at_deg, sign * move.first_deg_s, sign * change),
        (second_s, second_deg, sign * peak, none),
        (third_s, third_deg, sign * peak, -sign * ramp),
        (third_s + last_s, end_deg, none, none),
    ]


def _horns_deg(
    profile_deg: FloatArray, lag_steps: FloatArray, reach_deg: FloatArray, half_deg: FloatArray
) -> FloatArray:
    """Return the shafts of horns that follow profiles, (steps, horns).

    Of each horn: the lag, the way that it can turn in a step, and half its play. Profiles are taken
    as straight between two steps.
    """
    late_deg = lag_steps * np.diff(profile_deg, axis=0)
    goal_deg = np.concatenate([profile_deg[:1], profile_deg[1:]])
    goal_deg[1:] -= late_deg
    goal_deg[0] -= late_deg[0]
    begin_deg = profile_deg[:-1] - late_deg
    keep_ratio = np.exp(-1.0 / lag_steps)
    horn_deg = goal_deg.copy()
    horn_deg[1:] -= keep_ratio * begin_deg
    shift, kept_ratio = 1, keep_ratio
    while kept_ratio.max() > FADED and shift < len(horn_deg):  # As in `response.lagged_deg`.
        horn_deg[shift:] += kept_ratio * horn_deg[:-shift]
        shift, kept_ratio = 2 * shift, kept_ratio * kept_ratio
    is_slow = (np.abs(np.diff(horn_deg, axis=0)) > reach_deg).any(axis=0)
    if is_slow.any():
        slow = np.flatnonzero(is_slow)
        own = (goal_deg[:, slow], begin_deg[:, slow], keep_ratio[slow], reach_deg[slow])
        horn_deg[:, slow] = _slow_horns_deg(*own)
    play = np.flatnonzero(half_deg)
    if len(play):
        low_deg, high_deg = horn_deg[:, play] - half_deg[play], horn_deg[:, play] + half_deg[play]
        shaft_deg = horn_deg[:, play]
        for step in range(1, len(shaft_deg)):
            np.minimum(shaft_deg[step - 1], high_deg[step], out=shaft_deg[step])
            np.maximum(shaft_deg[step], low_deg[step], out=shaft_deg[step])
        horn_deg[:, play] = shaft_deg
    return horn_deg


def _slow_horns_deg(
    goal_deg: FloatArray, begin_deg: FloatArray, keep_ratio: FloatArray, reach_deg: FloatArray
) -> FloatArray:
    """Return the horns of `_horns_deg` that cannot always turn as fast as they should."""
    found = np.empty_like(goal_deg)
    horn_deg = found[0] = goal_deg[0]
    for step in range(1, len(goal_deg)):
        moved_deg = goal_deg[step] + (horn_deg - begin_deg[step - 1]) * keep_ratio - horn_deg
        horn_deg = horn_deg + np.minimum(np.maximum(moved_deg, -reach_deg), reach_deg)
        found[step] = horn_deg
    return found
