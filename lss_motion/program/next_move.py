"""Which move comes next: its travel speed, and when its successor is to be heard.

Chosen is what lets two moves reach furthest. Only what the servo can follow from there counts: its
excursion, with the ramp that the course leaves it, must stay within the tolerance. Where nothing
does, the least excursion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.batch import States
from lss_motion.program.cone import (
    CONE_RATIO,
    ROOM_RATIO,
    excursion_deg,
    opened,
    ramped,
    reach_s,
)
from lss_motion.program.course import AHEAD_MAX_STEPS, AUTHORITY_STEPS, GRID_S
from lss_motion.program.landing import SEGMENT_MIN_S

if TYPE_CHECKING:
    from lss_motion.program.batch import BoolArray, FloatArray, Index, IntArray
    from lss_motion.program.course import Courses, LimitArrays

SEGMENT_MIN_STEPS: Final = round(SEGMENT_MIN_S / GRID_S)
FOLLOW_RATIO: Final = CONE_RATIO - ROOM_RATIO
"""An excursion up to this share of the tolerance is chosen; the rest is for what the wire rounds
and for the slot that a move is really granted."""
BEND_MIN_STEPS: Final = 6
"""A bend that comes sooner is passed: for its sake alone no two moves are 30 ms apart."""
NEAR: Final = (64, 1)
FAR: Final = (AHEAD_MAX_STEPS, 1)
"""Instants and stride looked ahead at first, and where the cone is still open then."""
REACH: Final = (12, 7)
"""Steps and stride in which it is judged how far a successor reaches (420 ms); it is only compared,
so every seventh grid step will do: that costs one move in two hundred."""
HARD_RATIO: Final = 0.3
"""A course that leaves less than this share of the ramp to spare is hard to follow."""


@dataclass(frozen=True, kw_only=True)
class Trials:
    """Which moves are tried: some instants of the successor, each with some travel speeds.

    `cuts`       how much of the longest possible move; what counts is how far its successor reaches
    `bends`      how many jumps of the acceleration from either end of that move
    `speeds`     where in its cone; besides them, the course's own speed: where the course is at
                 its acceleration limit, only that leaves the servo in step with it
    `tried`      how many of those speeds a cut or bend is tried with, the course's own first
    `recovery`   grid steps until the successor where the tolerance is lost and must be won back;
                 as many as there are cuts and bends
    """

    cuts: tuple[float, ...]
    bends: int
    speeds: tuple[float, ...]
    tried: tuple[int, ...]
    recovery: tuple[int, ...]

    @cached_property
    def pairs(self) -> tuple[IntArray, FloatArray]:
        """Return the cut or bend of each trial, and its place in the cone; NaN: as the course."""
        places = [(np.nan, *self.speeds)[:count] for count in self.tried]
        return np.repeat(np.arange(len(places)), self.tried), np.concatenate(places)


QUICK: Final = Trials(
    cuts=(0.98, 0.93, 0.85, 0.75),
    bends=1,
    speeds=(0.5, 0.2, 0.8),
    tried=(1, 4, 4, 2, 2, 2),
    recovery=(2, 4, 7, 12, 20, 32),
)
"""Chosen by measurement (`tools/bench.py compress`): one cut less costs one move in fifty; more
save nothing, nor do the speeds left out, which won in one of a hundred moves."""
WIDE: Final = Trials(
    cuts=(1.0, 0.93, 0.85, 0.75, 0.6, 0.45, 0.3),
    bends=2,
    speeds=(0.5, 0.25, 0.75, 0.05, 0.95),
    tried=(6,) * 11,
    recovery=(2, 3, 4, 5, 7, 9, 12, 16, 20, 26, 48),
)
"""Chosen: where the course is near its acceleration limit, fewer trials lose it by degrees."""


@dataclass(frozen=True, slots=True)
class Servos:
    """Servos that need a move, an element each. No successor is heard after index `latest`."""

    joint: IntArray
    limits: LimitArrays
    state: States
    first: IntArray
    latest: IntArray

    def take(self, chosen: Index) -> Servos:
        return Servos(
            self.joint[chosen],
            self.limits.take(chosen),
            self.state.take(chosen),
            self.first[chosen],
            self.latest[chosen],
        )


@dataclass(frozen=True, slots=True)
class Chosen:
    """The travel speed of each servo's next move, and when its successor is wanted.

    `held_steps`: for how many grid steps one move can keep the tolerance.
    """

    speed_deg_s: FloatArray
    wanted_s: FloatArray
    held_steps: IntArray


def chosen(courses: Courses, servos: Servos) -> Chosen:
    """Return how servos that cannot land yet go on."""
    view = _View(courses, servos)
    is_hard = _is_hard(courses, servos) | (view.held_steps < SEGMENT_MIN_STEPS)
    speed_deg_s, wanted_s = np.empty(len(is_hard)), np.empty(len(is_hard))
    for trials, some in ((QUICK, ~is_hard), (WIDE, is_hard)):
        rows = np.flatnonzero(some)
        if len(rows):
            best = _best(courses, servos.take(rows), trials, view, rows)
            speed_deg_s[rows], wanted_s[rows] = best
    return Chosen(speed_deg_s, wanted_s, view.held_steps)


class _View:
    """The cones of servos: near by, and further ahead of those whose cone is still open there."""

    def __init__(self, courses: Courses, servos: Servos) -> None:
        self._near = opened(courses, servos.joint, servos.state, servos.limits, *NEAR)
        self.held_steps = self._near.held - 1
        self._is_far = self.held_steps == NEAR[0] - 1
        if self._is_far.any():
            some = servos.take(self._is_far)
            self._far = opened(courses, some.joint, some.state, some.limits, *FAR)
            self.held_steps[self._is_far] = FAR[1] * (self._far.held - 1)
            self._far_row = np.cumsum(self._is_far) - 1

    def at(self, rows: IntArray, steps: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest speed of `rows` after `steps`, (rows, any)."""
        low, high = self._near.at(rows, steps)
        is_far = self._is_far[rows]
        if is_far.any():
            far_rows = self._far_row[rows[is_far]]
            low[is_far], high[is_far] = self._far.at(far_rows, steps[is_far])
        return low, high


def _is_hard(courses: Courses, servos: Servos) -> BoolArray:
    """Return where the course leaves little ramp for the next moves."""
    least = HARD_RATIO * servos.limits.ramp_deg_s2
    hard = np.zeros(len(servos.joint), dtype=bool)
    for ahead in (0, AUTHORITY_STEPS):
        flat = courses.flat(servos.joint, servos.first + ahead)
        hard |= np.minimum(courses.up_deg_s2[flat], courses.down_deg_s2[flat]) < least
    return hard


def _best(
    courses: Courses, servos: Servos, trials: Trials, view: _View, rows: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the best of the trials: travel speeds and instants of the successors."""
    cuts, is_held, is_new = _cuts(courses, servos, trials, view.held_steps[rows])
    low, high = _cone(servos, view.at(rows, cuts), cuts, is_held)
    index = servos.first[:, None] + cuts
    flat = courses.flat(servos.joint[:, None], index)
    own = np.clip(courses.speed_deg_s[flat], low, high)
    pair, place = trials.pairs
    spread = low[:, pair] + np.nan_to_num(place) * (high - low)[:, pair]
    speeds = np.where(np.isnan(place), own[:, pair], spread)
    times_s = courses.times_s(index)[:, pair]
    start, limits = servos.state.column(), servos.limits
    ramp = limits.ramp_deg_s2[:, None]
    tau_s = times_s - start.time_s
    position, reached = ramped(start.position_deg, start.speed_deg_s, speeds, tau_s, ramp)
    excursion = excursion_deg(courses, flat[:, pair], position, reached)
    follows = excursion <= (FOLLOW_RATIO * limits.tolerance_deg)[:, None]
    follows &= (is_new & is_held[:, None])[:, pair]
    merit = -excursion
    some = row, trial = np.nonzero(follows)
    if len(row):
        after = States(times_s[some], position[some], reached[some])
        merit[follows.any(axis=1)] = -np.inf
        reach = reach_s(courses, servos.joint[row], after, limits.take(row), *REACH)
        merit[some] = reach + 1e-6 * index[row, pair[trial]]
    best = np.arange(len(merit)), np.argmax(merit, axis=1)
    return speeds[best], times_s[best]


def _cuts(
    courses: Courses, servos: Servos, trials: Trials, held: IntArray
) -> tuple[IntArray, BoolArray, BoolArray]:
    """Return steps until the successor to try, whether the tolerance is kept, and which are new."""
    least, first = SEGMENT_MIN_STEPS, servos.first
    latest = np.maximum(servos.latest - first, least)
    is_held = held >= least
    last = np.maximum(np.minimum(held, latest), least)
    cuts = np.maximum(np.rint(last[:, None] * np.array(trials.cuts)).astype(np.intp), least)
    columns, is_new = [cuts], [np.ones(cuts.shape, dtype=bool)]
    before, after = first + last, first + BEND_MIN_STEPS
    for _ in range(trials.bends):
        before = courses.bend_before(servos.joint, before)
        after = courses.bend_after(servos.joint, after)
        bends = np.stack((before, after), axis=1) - first[:, None]
        is_within = (bends >= BEND_MIN_STEPS) & (bends <= last[:, None])
        columns.append(np.where(is_within, bends, cuts[:, :1]))
        is_new.append(is_within)
        before, after = np.maximum(before - 1, 0), after + 1
    recovery = np.minimum(trials.recovery, latest[:, None])
    steps = np.where(is_held[:, None], np.concatenate(columns, axis=1), recovery)
    return steps, is_held, np.concatenate(is_new, axis=1)


def _cone(
    servos: Servos, sides_deg_s: tuple[FloatArray, FloatArray], cuts: IntArray, is_held: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest speed of each cut; with no cone, what the ramps can reach."""
    low, high = sides_deg_s
    if is_held.all():
        return low, high
    gain = servos.limits.ramp_deg_s2[:, None] * GRID_S * cuts
    most = servos.limits.speed_max_deg_s[:, None]
    now, held = servos.state.speed_deg_s[:, None], is_held[:, None]
    low = np.where(held, low, np.clip(now - gain, -most, most))
    return low, np.where(held, high, np.clip(now + gain, -most, most))
