"""Chooses the next timed move of every joint: its speed and its length.

Which move comes next: its travel speed, and when its successor is to be heard.

Chosen is what lets two moves reach furthest. Only what the servo can follow from there counts: its
excursion, with the ramp that the course leaves it, must stay within the tolerance. Where nothing
does, the least excursion.

The last move before a standstill: it ends on its target, together with the course.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.cones import (
    CONE_RATIO,
    ROOM_RATIO,
    Starts,
    excursion_deg,
    open_cones,
    ramped,
    reach_steps,
)
from lss_motion.program.quantize import SPEED_LEAST_DEG_S, durations_ms
from lss_motion.program.reference import AHEAD_MAX_STEPS, AUTHORITY_STEPS, GRID_S, Points
from lss_motion.program.response import States, exact_speeds, speeds_for, trapezoids
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from lss_motion.program.cones import Cones
    from lss_motion.program.reference import LimitArrays, References
    from lss_motion.program.response import BoolArray, FloatArray, IntArray, SingleArray


SEGMENT_MIN_S: Final = 0.01
"""The least between two moves of a joint: two control ticks of the servo."""
LANDING_RATIOS: Final = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2)
"""Travel speeds tried for a landing, by the one that comes to rest together with the course."""

ALIKE_RATIO: Final = 0.5
TOGETHER_DEG_S: Final = 0.05
"""Errors below this share of the tolerance count alike, and coming to rest a second too early or
late counts as much as this error: chosen, so that no landing creeps on when the course rests."""
TOO_LATE_DEG: Final = 1e6
"""Counts as the error of a move that is under way when the standstill is over."""


@dataclass(frozen=True, slots=True)
class Landings:
    """The best landing of each of many servos.

    The largest error until course and servo rest, from when on the servo does, T and travel speed.
    """

    error_deg: FloatArray
    landed_s: FloatArray
    duration_ms: FloatArray
    travel_deg_s: FloatArray

    def put(self, chosen: BoolArray, found: Landings) -> None:
        """Take over what was found for the `chosen` of these servos."""
        self.error_deg[chosen] = found.error_deg
        self.landed_s[chosen] = found.landed_s
        self.duration_ms[chosen] = found.duration_ms
        self.travel_deg_s[chosen] = found.travel_deg_s


def best_landings(
    references: References,
    joint: IntArray,
    state: States,
    wire: FloatArray,
    rest: tuple[IntArray, IntArray],
    limits: LimitArrays,
) -> Landings:
    """Return how moves from `state` land on `wire`, where the courses stand over `rest`."""
    first_s, last_s = (references.times_s(index) for index in rest)
    ramp, most = limits.ramp_deg_s2, limits.speed_max_deg_s
    target_deg = wire / limits.wire_per_deg
    left_s = np.maximum(first_s - state.time_s, SEGMENT_MIN_S)
    exact = np.clip(exact_speeds(state, target_deg, left_s, ramp), SPEED_LEAST_DEG_S, most)
    candidates = np.array(LANDING_RATIOS)[:, None] * exact
    duration_ms = durations_ms(state, target_deg, candidates, limits)
    travel = speeds_for(state, target_deg, duration_ms / MS_PER_S, ramp, limits.is_exact)
    travel = np.minimum(travel, most)
    moves = trapezoids(state, target_deg, travel, ramp)
    landed_s = moves.end_s

    first = references.first_index(state.time_s)
    end = np.maximum(references.first_index(np.minimum(landed_s, last_s)), rest[0])
    # On a line that is too full, the standstill may be over before the move is heard.
    lasts = 1 + np.maximum(end - first, 0)
    counts = lasts.max(axis=0)
    starts = np.cumsum(counts) - counts
    of = np.repeat(np.arange(len(wire)), counts)
    step = np.arange(len(of)) - starts[of]
    index = first[of] + step
    reference_deg = references.position_deg(joint[of], index)
    stray = moves.take(of).positions_deg(references.times_s(index))
    stray -= reference_deg
    np.abs(stray, out=stray)
    stray[step >= lasts.take(of, axis=1)] = 0.0
    error_deg = np.maximum.reduceat(stray, starts, axis=1)
    late_s = landed_s - (last_s + SEGMENT_MIN_S)
    error_deg = np.where(late_s > 0.0, TOO_LATE_DEG + late_s, error_deg)
    merit = np.maximum(error_deg, ALIKE_RATIO * limits.tolerance_deg)
    merit += TOGETHER_DEG_S * np.abs(landed_s - first_s)
    best = np.argmin(merit, axis=0), np.arange(len(wire))
    return Landings(error_deg[best], landed_s[best], duration_ms[best], travel[best])


SEGMENT_MIN_STEPS: Final = round(SEGMENT_MIN_S / GRID_S)
FOLLOW_RATIO: Final = CONE_RATIO - ROOM_RATIO
"""An excursion up to this share of the tolerance is chosen; the rest is for what the wire rounds
and for the slot that a move is really granted."""
BEND_MIN_STEPS: Final = 6
"""A bend that comes sooner is passed: for its sake alone no two moves are 30 ms apart."""
VIEW_STRIDE: Final = 3
"""How far ahead is seen in steps of so many grid steps: every one would be three times the work and
saves no move (`tools/bench.py compress`, and the show of `compile`)."""
VIEW_BLOCK: Final = 25
"""Rows of a cone looked at at once: 375 ms, and three moves in four are shorter."""
REACH: Final = (12, 7)
"""Steps and stride in which it is judged how far a successor reaches (420 ms); it is only compared,
so every seventh grid step will do: that costs one move in two hundred."""
HARD_RATIO: Final = 0.3
"""A course that leaves less than this share of the ramp to spare is hard to follow."""


@dataclass(frozen=True, kw_only=True)
class MoveCandidates:
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
    speeds_tried: tuple[int, ...]
    recovery: tuple[int, ...]

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray, SingleArray]:
        """Return the cut or bend of each trial, and of those in the cone, and their places there.

        Those with the course's own speed come first, one for each cut and bend.
        """
        own = np.arange(len(self.speeds_tried))
        inside = np.repeat(own, np.array(self.speeds_tried) - 1)
        places = np.concatenate([self.speeds[: count - 1] for count in self.speeds_tried])
        return np.append(own, inside), inside, places.astype(np.float32)[:, None]


QUICK: Final = MoveCandidates(
    cuts=(0.98, 0.93, 0.85, 0.75),
    bends=1,
    speeds=(0.5, 0.2),
    speeds_tried=(1, 3, 3, 1, 1, 1),
    recovery=(2, 4, 7, 12, 20, 32),
)
"""Chosen by measurement (`tools/bench.py compress`): one cut less costs one move in fifty; more
save nothing, and half as many speeds again save one move in 250."""
WIDE: Final = MoveCandidates(
    cuts=(1.0, 0.93, 0.85, 0.75, 0.6, 0.45, 0.3),
    bends=2,
    speeds=(0.5, 0.25, 0.75, 0.05, 0.95),
    speeds_tried=(6,) * 11,
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

    def take(self, chosen: IntArray) -> Servos:
        return Servos(
            self.joint[chosen],
            self.limits.take(chosen),
            self.state.take(chosen),
            self.first[chosen],
            self.latest[chosen],
        )


@dataclass(frozen=True, slots=True)
class NextMoves:
    """The travel speed of each servo's next move, and when its successor is wanted.

    `held_steps`: for how many grid steps one move can keep the tolerance.
    """

    speed_deg_s: FloatArray
    requested_s: FloatArray
    held_steps: IntArray


def next_moves(references: References, servos: Servos) -> NextMoves:
    """Return how servos that cannot land yet go on."""
    starts = Starts.of(references, servos.joint, servos.first, servos.state)
    cones = open_cones(references, starts, AHEAD_MAX_STEPS // VIEW_STRIDE, VIEW_STRIDE, VIEW_BLOCK)
    held_steps = VIEW_STRIDE * (cones.held - 1)
    is_hard = _is_hard(references, servos) | (held_steps < SEGMENT_MIN_STEPS)
    speed_deg_s, requested_s = np.empty(len(is_hard)), np.empty(len(is_hard))
    for candidates, some in ((QUICK, ~is_hard), (WIDE, is_hard)):
        rows = np.flatnonzero(some)
        if len(rows):
            best = _best(references, servos.take(rows), candidates, cones, rows)
            speed_deg_s[rows], requested_s[rows] = best
    return NextMoves(speed_deg_s, requested_s, held_steps)


def _is_hard(references: References, servos: Servos) -> BoolArray:
    """Return where the course leaves little ramp for the next moves."""
    least = HARD_RATIO * servos.limits.ramp_deg_s2
    index = servos.first + np.array([[0], [AUTHORITY_STEPS]])
    at = references.at(servos.joint, index)
    hard: BoolArray = (np.minimum(at.up_deg_s2, at.down_deg_s2) < least).any(axis=0)
    return hard


def _best(
    references: References, servos: Servos, candidates: MoveCandidates, cones: Cones, rows: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the best of the trials: travel speeds and instants of the successors.

    The servos are `rows` of the cones. Cuts and bends, and after them the trials, are rows here.
    """
    cuts, is_held, is_new = _cuts(
        references, servos, candidates, VIEW_STRIDE * (cones.held[rows] - 1)
    )
    low, high = _cone(servos, cones.at(rows, -(-cuts // VIEW_STRIDE)), cuts, is_held)
    index = servos.first + cuts
    at = references.at(servos.joint, index)
    pair, inside, place = candidates.pairs
    spread = place * (high - low).take(inside, axis=0) + low.take(inside, axis=0)
    speeds = np.concatenate((np.minimum(np.maximum(at.speed_deg_s, low), high), spread))
    times_s = references.times_s(index)
    tau_s = (times_s - servos.state.time_s).astype(np.float32)
    position, reached = ramped(
        servos.state.position_deg.astype(np.float32),
        servos.state.speed_deg_s.astype(np.float32),
        speeds,
        tau_s.take(pair, axis=0),
        servos.limits.ramp_deg_s2.astype(np.float32),
    )
    excursion = excursion_deg(position, reached, Points(*(own.take(pair, axis=0) for own in at)))
    follows = excursion <= (FOLLOW_RATIO * servos.limits.tolerance_deg).astype(np.float32)
    follows &= (is_new & is_held).take(pair, axis=0)
    merit = -excursion
    some = np.flatnonzero(follows)
    if len(some):
        candidate = some // merit.shape[1]
        row = some - candidate * merit.shape[1]
        cut = pair.take(candidate) * merit.shape[1] + row
        after = Starts(
            servos.joint.take(row),
            index.take(cut),
            np.zeros(1, dtype=np.float32),
            position.take(some),
            reached.take(some),
        )
        merit = np.where(follows.any(axis=0), np.float32(-np.inf), merit)
        steps = reach_steps(references, after, *REACH)
        # Where two reach as far, the later successor: it is the longer move.
        merit.put(some, tau_s.take(cut) + GRID_S * steps + 1e-6 * cuts.take(cut))
    best = np.argmax(merit, axis=0), np.arange(merit.shape[1])
    return speeds[best], times_s[pair[best[0]], best[1]]


def _cuts(
    references: References, servos: Servos, candidates: MoveCandidates, held: IntArray
) -> tuple[IntArray, BoolArray, BoolArray]:
    """Return steps until the successor to try, whether the tolerance is kept, and which are new."""
    least, first = SEGMENT_MIN_STEPS, servos.first
    latest = np.maximum(servos.latest - first, least)
    is_held = held >= least
    last = np.maximum(np.minimum(held, latest), least)
    cuts = np.rint(last * np.array(candidates.cuts)[:, None]).astype(np.intp)
    cuts = np.maximum(cuts, least)
    rows, is_new = [cuts], [np.ones(cuts.shape, dtype=bool)]
    before, after = first + last, first + BEND_MIN_STEPS
    for _ in range(candidates.bends):
        before = references.bend_before(servos.joint, before)
        after = references.bend_after(servos.joint, after)
        bends = np.stack((before, after)) - first
        is_within = (bends >= BEND_MIN_STEPS) & (bends <= last)
        rows.append(np.where(is_within, bends, cuts[0]))
        is_new.append(is_within)
        before, after = np.maximum(before - 1, 0), after + 1
    steps = np.concatenate(rows)
    if not is_held.all():
        recovery = np.minimum(np.array(candidates.recovery)[:, None], latest)
        steps = np.where(is_held, steps, recovery)
    return steps, is_held, np.concatenate(is_new)


def _cone(
    servos: Servos, sides_deg_s: tuple[SingleArray, SingleArray], cuts: IntArray, is_held: BoolArray
) -> tuple[SingleArray, SingleArray]:
    """Return the lowest and highest speed of each cut; with no cone, what the ramps can reach."""
    low, high = sides_deg_s
    if is_held.all():
        return low, high
    gain = servos.limits.ramp_deg_s2 * GRID_S * cuts
    most, now = servos.limits.speed_max_deg_s, servos.state.speed_deg_s
    slowest = np.clip(now - gain, -most, most).astype(np.float32)
    fastest = np.clip(now + gain, -most, most).astype(np.float32)
    return np.where(is_held, low, slowest), np.where(is_held, high, fastest)
