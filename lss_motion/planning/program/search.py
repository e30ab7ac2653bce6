"""Chooses the next timed move of every joint: its travel speed and its length.

In mid-reference the choice is the candidate with which two moves reach furthest. A candidate only
counts if the servo can follow from its end: its excursion, with the ramp that the reference leaves,
must stay within the tolerance. If there is no such candidate, the one with the least excursion.

Before a standstill the choice is a landing: a move that ends on its target together with the
reference.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.planning.program.cones import (
    CONE_RATIO,
    ROOM_RATIO,
    Starts,
    excursion_deg,
    open_cones,
    ramped,
    reach_steps,
)
from lss_motion.planning.program.moves import SPEED_LEAST_DEG_S, durations_ms
from lss_motion.planning.program.reference_grid import (
    AHEAD_MAX_STEPS,
    AUTHORITY_STEPS,
    GRID_S,
    Points,
)
from lss_motion.planning.program.response import States, exact_speeds, speeds_for, trapezoids
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from lss_motion.planning.program.cones import Cones
    from lss_motion.planning.program.reference_grid import LimitArrays, References
    from lss_motion.planning.program.response import BoolArray, FloatArray, IntArray, SingleArray

SEGMENT_MIN_S: Final = 0.01
"""The least time between two moves of a joint: two control ticks of the servo."""
LANDING_RATIOS: Final = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2)
"""Candidate travel speeds of a landing, relative to the one that comes to rest with the
reference."""

ALIKE_RATIO: Final = 0.5
TOGETHER_DEG_S: Final = 0.05
"""Errors below `ALIKE_RATIO` of the tolerance count alike. A landing that comes to rest a second
too early or too late counts as much as an error of `TOGETHER_DEG_S`. Chosen: with it, no landing
still creeps when the reference rests."""
TOO_LATE_DEG: Final = 1e6
"""Counts as the error of a move that still runs when the standstill is over."""

SEGMENT_MIN_STEPS: Final = round(SEGMENT_MIN_S / GRID_S)
FOLLOW_RATIO: Final = CONE_RATIO - ROOM_RATIO
"""An excursion up to this share of the tolerance is accepted. The rest is for the rounding of the
wire and for the difference between the slot that is requested and the one that is granted."""
BEND_MIN_STEPS: Final = 6
"""A bend that comes sooner is ignored: it alone is no reason for two moves within 30 ms."""
VIEW_STRIDE: Final = 3
"""Cones are computed at every third grid step: every step would be three times the work and saves
no move (`tools/bench.py compress`, and the show of `compile`)."""
VIEW_BLOCK: Final = 25
"""Rows of a cone that are computed at once: 375 ms; three moves in four are shorter."""
REACH: Final = (12, 7)
"""Steps and stride in which the reach of a successor is computed (420 ms). Reaches are only
compared, so every seventh grid step is enough: that costs one move in two hundred."""
HARD_RATIO: Final = 0.3
"""A reference that leaves less than this share of the ramp to spare is hard to follow."""


class Landings(Struct, frozen=True):
    """The best landing of each of many servos.

    The largest error until reference and servo rest, the instant at which the servo rests, T, and
    travel speed.
    """

    error_deg: FloatArray
    landed_s: FloatArray
    duration_ms: FloatArray
    travel_deg_s: FloatArray

    def put(self, chosen: BoolArray, found: Landings) -> None:
        """Store what was found for the `chosen` of these servos."""
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
    """Return how moves from `state` land on `wire`, where the references stand over `rest`."""
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
    # On a line that is too full, the standstill may be over before the servo receives the move.
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


class MoveCandidates(Struct, frozen=True, kw_only=True, dict=True):
    """Which moves are candidates: some instants of the successor, each with some travel speeds.

    cuts          shares of the longest possible move; the best has the successor that reaches
                  furthest
    bends         number of jumps of the acceleration from either end of that move
    speeds        places in the cone. The speed of the reference itself is always a candidate: where
                  the reference is at its acceleration limit, only that one stays in step with it
    speeds_tried  how many of those speeds a cut or bend is combined with, the reference's own first
    recovery      grid steps until the successor where the tolerance is lost and must be regained;
                  as many as there are cuts and bends
    """

    cuts: tuple[float, ...]
    bends: int
    speeds: tuple[float, ...]
    speeds_tried: tuple[int, ...]
    recovery: tuple[int, ...]

    @cached_property
    def pairs(self) -> tuple[IntArray, IntArray, SingleArray]:
        """The cut or bend of each candidate, those of the inner ones, and their places in the cone.

        The candidates with the speed of the reference come first, one for each cut and bend.
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
cuts save nothing, and half as many speeds again save one move in 250."""
WIDE: Final = MoveCandidates(
    cuts=(1.0, 0.93, 0.85, 0.75, 0.6, 0.45, 0.3),
    bends=2,
    speeds=(0.5, 0.25, 0.75, 0.05, 0.95),
    speeds_tried=(6,) * 11,
    recovery=(2, 3, 4, 5, 7, 9, 12, 16, 20, 26, 48),
)
"""Chosen: near the acceleration limit of a reference, fewer candidates lose it bit by bit."""


class Servos(Struct, frozen=True):
    """Servos that need a move, an element each. Each successor is received up to index `latest`."""

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


class NextMoves(Struct, frozen=True):
    """The travel speed of each servo's next move, and when its successor is requested.

    `held_steps`: for how many grid steps one move can keep the tolerance.
    """

    speed_deg_s: FloatArray
    requested_s: FloatArray
    held_steps: IntArray


def next_moves(references: References, servos: Servos) -> NextMoves:
    """Return the next moves of servos that cannot land yet."""
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
    """Return where the reference leaves little ramp for the next moves."""
    least = HARD_RATIO * servos.limits.ramp_deg_s2
    index = servos.first + np.array([[0], [AUTHORITY_STEPS]])
    at = references.at(servos.joint, index)
    hard: BoolArray = (np.minimum(at.up_deg_s2, at.down_deg_s2) < least).any(axis=0)
    return hard


def _best(
    references: References, servos: Servos, candidates: MoveCandidates, cones: Cones, rows: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the best candidates: travel speeds and instants of the successors.

    The servos are `rows` of the cones. Cuts and bends, and after them the candidates, are rows
    here.
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
        # Of two that reach equally far, the later successor: it is the longer move.
        merit.put(some, tau_s.take(cut) + GRID_S * steps + 1e-6 * cuts.take(cut))
    best = np.argmax(merit, axis=0), np.arange(merit.shape[1])
    return speeds[best], times_s[pair[best[0]], best[1]]


def _cuts(
    references: References, servos: Servos, candidates: MoveCandidates, held: IntArray
) -> tuple[IntArray, BoolArray, BoolArray]:
    """Return steps until the candidate successors, whether the tolerance is kept, and whether new.

    A row that only repeats another is not new.
    """
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
    """Return the lowest and highest speed of each cut; without a cone, what the ramps can reach."""
    low, high = sides_deg_s
    if is_held.all():
        return low, high
    gain = servos.limits.ramp_deg_s2 * GRID_S * cuts
    most, now = servos.limits.speed_max_deg_s, servos.state.speed_deg_s
    slowest = np.clip(now - gain, -most, most).astype(np.float32)
    fastest = np.clip(now + gain, -most, most).astype(np.float32)
    return np.where(is_held, low, slowest), np.where(is_held, high, fastest)
