"""Which move comes next: its travel speed, and when its successor is to be heard.

Chosen is what lets two moves reach furthest. Only what the servo can follow from there counts: its
excursion, with the ramp that the course leaves it, must stay within the tolerance. Where nothing
does, the least excursion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.batch import States
from lss_motion.program.cone import (
    CONE_RATIO,
    ROOM_RATIO,
    excursion_deg,
    open_steps,
    opened,
    ramped,
    reach_s,
)
from lss_motion.program.course import AUTHORITY_STEPS, GRID_S
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
WINDOW_STEPS: Final = (48, 300)
"""Grid steps looked ahead at first, and where the cone is still open then: `SEGMENT_MAX_S`."""
REACH: Final = (20, 5)
"""Steps and stride in which it is judged how far a successor reaches (500 ms); it is only compared,
so every fifth grid step will do."""
HARD_RATIO: Final = 0.3
"""A course that leaves less than this share of the ramp to spare is hard to follow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trials:
    """Which moves are tried: every one of some instants with every one of some travel speeds.

    `cuts`       how much of the longest possible move; what counts is how far its successor reaches
    `bends`      how many jumps of the acceleration from either end of that move
    `speeds`     where in its cone; besides them, the course's own speed: where the course is at
                 its acceleration limit, only that leaves the servo in step with it
    `recovery`   grid steps until the successor where the tolerance is lost and must be won back;
                 as many as there are cuts and bends
    """

    cuts: tuple[float, ...]
    bends: int
    speeds: tuple[float, ...]
    recovery: tuple[int, ...]


QUICK: Final = Trials(
    cuts=(0.98, 0.93, 0.85, 0.75),
    bends=1,
    speeds=(0.5, 0.2, 0.8),
    recovery=(2, 4, 7, 12, 20, 32),
)
"""Chosen by measurement (`tools/bench.py compress`): one cut or speed less costs one move in
fifty; more save nothing."""
WIDE: Final = Trials(
    cuts=(1.0, 0.93, 0.85, 0.75, 0.6, 0.45, 0.3),
    bends=2,
    speeds=(0.5, 0.25, 0.75, 0.05, 0.95),
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


def chosen(courses: Courses, servos: Servos) -> tuple[FloatArray, FloatArray]:
    """Return the travel speed of each servo's next move, and when its successor is wanted."""
    speed_deg_s, wanted_s = np.empty(len(servos.joint)), np.empty(len(servos.joint))
    is_hard = _is_hard(courses, servos)
    for trials in (QUICK, WIDE):
        rest = np.flatnonzero(is_hard if trials is WIDE else ~is_hard)
        for steps in WINDOW_STEPS:
            if not len(rest):
                break
            some = servos.take(rest)
            cone = opened(courses, some.joint, some.state, some.limits, steps)
            held = open_steps(*cone)
            is_long = (held == steps) & (steps < WINDOW_STEPS[-1])
            is_lost = (held <= SEGMENT_MIN_STEPS) & (trials is QUICK)
            is_hard[rest[is_lost]] = True
            now = np.flatnonzero(~is_long & ~is_lost)
            if len(now):
                done = rest[now]
                speed_deg_s[done], wanted_s[done] = _best(
                    courses, some.take(now), trials, (cone[0][now], cone[1][now])
                )
            rest = rest[is_long]
    return speed_deg_s, wanted_s


def _is_hard(courses: Courses, servos: Servos) -> BoolArray:
    """Return where the course leaves little ramp for the next moves."""
    least = HARD_RATIO * servos.limits.ramp_deg_s2
    hard = np.zeros(len(servos.joint), dtype=bool)
    for ahead in (0, AUTHORITY_STEPS):
        flat = courses.flat(servos.joint, servos.first + ahead)
        hard |= np.minimum(courses.up_deg_s2[flat], courses.down_deg_s2[flat]) < least
    return hard


def _best(
    courses: Courses, servos: Servos, trials: Trials, cone: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the best of the trials: travel speeds and instants of the successors."""
    cuts, is_held = _cuts(courses, servos, trials, open_steps(*cone))
    speeds, each = _speeds(courses, servos, trials, cone, cuts, is_held)
    index = np.repeat(servos.first[:, None] + cuts, each, axis=1)
    times_s = courses.times_s(index)
    start, limits = servos.state.column(), servos.limits.column()
    position, reached = ramped(
        start.position_deg, start.speed_deg_s, speeds, times_s - start.time_s, limits.ramp_deg_s2
    )
    flat = courses.flat(servos.joint[:, None], index)
    excursion = excursion_deg(courses, flat, position, reached)
    follows = (excursion <= FOLLOW_RATIO * limits.tolerance_deg) & is_held[:, None]
    merit = -excursion
    row, column = np.nonzero(follows)
    if len(row):
        after = States(times_s[row, column], position[row, column], reached[row, column])
        joint = servos.joint[row]
        merit[follows.any(axis=1)] = -np.inf
        merit[row, column] = reach_s(courses, joint, after, servos.limits.take(row), *REACH)
        merit[row, column] += 1e-6 * index[row, column]
    best = np.arange(len(merit)), np.argmax(merit, axis=1)
    return speeds[best], times_s[best]


def _cuts(
    courses: Courses, servos: Servos, trials: Trials, held: IntArray
) -> tuple[IntArray, BoolArray]:
    """Return steps until the successor to try, and whether the tolerance is kept so far."""
    least, first = SEGMENT_MIN_STEPS, servos.first
    latest = np.maximum(servos.latest - first, least)
    is_held = held > least
    last = np.maximum(np.minimum(held - 1, latest), least)
    cuts = np.maximum(np.rint(last[:, None] * np.array(trials.cuts)).astype(np.intp), least)
    columns = [cuts]
    before, after = first + last, first + BEND_MIN_STEPS
    for _ in range(trials.bends):
        before = courses.bend_before[courses.flat(servos.joint, before)]
        after = courses.bend_after[courses.flat(servos.joint, after)]
        bends = np.stack((before, after), axis=1) - first[:, None]
        is_within = (bends >= BEND_MIN_STEPS) & (bends <= last[:, None])
        columns.append(np.where(is_within, bends, cuts[:, :1]))
        before, after = np.maximum(before - 1, 0), after + 1
    recovery = np.minimum(trials.recovery, latest[:, None])
    return np.where(is_held[:, None], np.concatenate(columns, axis=1), recovery), is_held


def _speeds(
    courses: Courses,
    servos: Servos,
    trials: Trials,
    cone: tuple[FloatArray, FloatArray],
    cuts: IntArray,
    is_held: BoolArray,
) -> tuple[FloatArray, int]:
    """Return the travel speeds to try, cut by cut, and how many a cut.

    They lie in the cone; where that is closed, between what the ramps can reach.
    """
    columns = np.minimum(cuts, cone[0].shape[1] - 1)
    low, high = (np.take_along_axis(side, columns, axis=1) for side in cone)
    if not is_held.all():
        gain = servos.limits.ramp_deg_s2[:, None] * GRID_S * cuts
        most = servos.limits.speed_max_deg_s[:, None]
        now, held = servos.state.speed_deg_s[:, None], is_held[:, None]
        low = np.where(held, low, np.clip(now - gain, -most, most))
        high = np.where(held, high, np.clip(now + gain, -most, most))
    flat = courses.flat(servos.joint[:, None], servos.first[:, None] + cuts)
    own = np.clip(courses.speed_deg_s[flat], low, high)
    spread = low[:, :, None] + np.array(trials.speeds) * (high - low)[:, :, None]
    speeds = np.concatenate((own[:, :, None], spread), axis=2)
    return speeds.reshape(len(cuts), -1), speeds.shape[2]
