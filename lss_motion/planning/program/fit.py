"""Fits the fewest timed moves to the references of all joints: the core of the `timed` drive.

A move in mid-reference is used for its travel speed: its target lies beyond the instant of the next
move, so that the servo ramps to that speed and keeps it, and never brakes before its successor
arrives. Only where the reference comes to rest does a move end on its target.

All segments (`segments`) advance together, one move each, as rows of arrays. Angles are servo
angles in degrees; instants are those at which a servo receives a move.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.planning.program.cones import CONE_RATIO, Starts, reach_steps
from lss_motion.planning.program.given import given_moves
from lss_motion.planning.program.moves import (
    FittedMoves,
    InitialMotion,
    concatenated,
    discontinuities,
    no_moves,
    quantized,
)
from lss_motion.planning.program.reference_grid import (
    GRID_S,
    SEGMENT_MAX_S,
    LimitArrays,
    References,
)
from lss_motion.planning.program.response import States, concatenated_states, trapezoids
from lss_motion.planning.program.search import (
    FOLLOW_RATIO,
    SEGMENT_MIN_S,
    SEGMENT_MIN_STEPS,
    Landings,
    Servos,
    best_landings,
    next_moves,
)
from lss_motion.planning.program.segments import Segment, segments_of
from lss_motion.units import US_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Sequence

    from lss_motion.planning.program.reference_grid import Reference, ServoLimits
    from lss_motion.planning.program.response import BoolArray, FloatArray, IntArray

    Grant = Callable[[IntArray, IntArray, IntArray], IntArray]

DEPARTURES: Final = 7
"""Number of candidate instants for the first move after a stop."""
DEPARTURE_STEPS: Final = 80
"""Grid steps in which the reach of these candidates is computed: every step, since what a servo at
rest cannot follow shows at once."""
RIVALRY_S: Final = 1.0
"""A move that is requested this much later than another belongs to another part of the show."""
SEGMENTS_MAX: Final = 2048
"""This many segments are fitted side by side: ten minutes of 18 joints, in bounded memory."""
NEVER: Final = 2**62
"""The index of a stop that never comes."""

TIGHT_TURN_S: Final = 0.02
"""Where some command was late when moves were not ordered, commands are placed strictly in the
order of time: a third more of them fit, in two to three times the time."""
TURN_S: Final = 0.1
"""A move waits for the moves of its part that are requested this much earlier. Slots are then given
away in the order of time, and no move is delayed by one that is requested later."""


def microseconds(times_s: FloatArray) -> IntArray:
    """Return instants in whole microseconds."""
    whole: IntArray = np.rint(US_PER_S * times_s).astype(np.intp)
    return whole


class _SegmentRows(Struct, frozen=True):
    """The segments under way, a row each. `travel_deg_s` belongs to the move at `state`."""

    segment: IntArray
    state: States
    travel_deg_s: FloatArray
    requested_s: FloatArray

    def take(self, chosen: BoolArray) -> _SegmentRows:
        return _SegmentRows(
            self.segment[chosen],
            self.state.take(chosen),
            self.travel_deg_s[chosen],
            self.requested_s[chosen],
        )


def _concatenated(one: _SegmentRows, other: _SegmentRows) -> _SegmentRows:
    return _SegmentRows(
        np.concatenate((one.segment, other.segment)),
        concatenated_states(one.state, other.state),
        np.concatenate((one.travel_deg_s, other.travel_deg_s)),
        np.concatenate((one.requested_s, other.requested_s)),
    )


def _is_next(requested_s: FloatArray, line: IntArray, turn_s: float) -> BoolArray:
    """Return which moves to grant now: those with no request of the same part a turn earlier.

    Moves on other lines belong to other parts.
    """
    if turn_s >= RIVALRY_S:
        return np.ones(len(requested_s), dtype=bool)
    span_s = RIVALRY_S + np.ptp(requested_s) if len(requested_s) else 0.0
    along_s = requested_s + 2.0 * span_s * line
    ordered = np.sort(along_s)
    earlier = np.searchsorted(ordered, along_s - turn_s)
    rivals = np.searchsorted(ordered, along_s - RIVALRY_S)
    is_next: BoolArray = earlier == rivals
    return is_next


class FitProblem(Struct, frozen=True, kw_only=True):
    """What all segments share: `seams` are indices of the grid, `line` the lines of the joints."""

    references: References
    limits: LimitArrays
    seams: IntArray
    line: IntArray


class SegmentRun:
    """One run of all segments from their first move to their last."""

    def __init__(
        self, problem: FitProblem, segments: Sequence[Segment], grant: Grant, turn_s: float
    ) -> None:
        self._references, self._limits, self._seams = (
            problem.references,
            problem.limits,
            problem.seams,
        )
        self._grant, self._line, self._turn_s = grant, problem.line, turn_s
        self._joint = np.array([segment.joint for segment in segments], dtype=np.intp)
        self._wire = np.array([segment.wire for segment in segments], dtype=np.float64)
        self._stop_wire = np.array([segment.stop_wire for segment in segments], dtype=np.float64)
        stops = [segment.stop or (NEVER, NEVER) for segment in segments]
        self._stop_first = np.array([stop[0] for stop in stops], dtype=np.intp)
        self._stop_last = np.array([stop[1] for stop in stops], dtype=np.intp)
        self._after_s = np.array([segment.after_s for segment in segments])
        self._segments = segments
        self._made: list[FittedMoves] = [no_moves()]
        self._of: list[IntArray] = [np.zeros(0, dtype=np.intp)]
        self._late: list[tuple[IntArray, FloatArray]] = []

    def moves(self) -> tuple[FittedMoves, IntArray]:
        """Return the moves, in any order, and the segment of each."""
        waiting = deque(range(len(self._segments)))
        rows = self._entered(np.zeros(0, dtype=np.intp))
        while waiting or len(rows.segment):
            room = SEGMENTS_MAX - len(rows.segment)
            new = [waiting.popleft() for _ in range(min(len(waiting), room))]
            if new:
                # By joint: the data of neighbours then lies close together in memory.
                by_joint = np.array(new)[np.argsort(self._joint[new], kind="stable")]
                rows = _concatenated(rows, self._entered(by_joint))
            line = self._line[self._joint[rows.segment]]
            is_next = _is_next(rows.requested_s, line, self._turn_s)
            if is_next.all():
                rows = self._advanced(rows)
            else:
                rows = _concatenated(rows.take(~is_next), self._advanced(rows.take(is_next)))
        return concatenated(self._made), np.concatenate(self._of)

    def crowded(self) -> BoolArray:
        """Return which segments are under way where a command on their line was late."""
        found = np.zeros(len(self._segments), dtype=bool)
        if not self._late:
            return found
        lines, times_s = (np.concatenate(column) for column in zip(*self._late, strict=True))
        begins_s = self._after_s - RIVALRY_S
        ends_s = self._references.times_s(self._stop_last) + RIVALRY_S
        for line in np.unique(lines):
            late_s = np.sort(times_s[lines == line])
            is_near = np.searchsorted(late_s, begins_s) < np.searchsorted(late_s, ends_s)
            found |= is_near & (self._line[self._joint] == line)
        return found

    def _entered(self, segment: IntArray) -> _SegmentRows:
        """Return segments that wait for their first move; they have no travel speed yet."""
        none = np.full(len(segment), np.nan)
        requested_s = self._departures_s(segment) if len(segment) else np.zeros(0)
        return _SegmentRows(segment, States(self._after_s[segment], none, none), none, requested_s)

    def _advanced(self, rows: _SegmentRows) -> _SegmentRows:
        """Reserve slots for the next moves, quantize those under way, choose the moves after."""
        in_turn = np.argsort(rows.requested_s, kind="stable")
        joint, requested_us = (
            self._joint[rows.segment[in_turn]],
            microseconds(rows.requested_s[in_turn]),
        )
        granted_us = self._grant(joint, requested_us, microseconds(rows.state.time_s[in_turn]))
        is_late = granted_us > requested_us
        if is_late.any():
            self._late.append((self._line[joint[is_late]], requested_us[is_late] / US_PER_S))
        granted_s = np.empty(len(in_turn))
        granted_s[in_turn] = granted_us / US_PER_S
        is_new = np.isnan(rows.travel_deg_s)
        begun = self._begun(rows.segment[is_new], granted_s[is_new])
        moved = self._quantized(rows.take(~is_new), granted_s[~is_new])
        segment = np.concatenate((rows.segment[is_new], rows.segment[~is_new]))
        return self._settled(segment, concatenated_states(begun, moved))

    def _begun(self, segment: IntArray, granted_s: FloatArray) -> States:
        """Return the states of profiles that receive their first move, at rest or in motion."""
        position = self._wire[segment] / self._limits.wire_per_deg[self._joint[segment]]
        speed = np.zeros(len(segment))
        for row, at in enumerate(segment):
            initial = self._segments[at].initial
            if initial is not None:
                state = initial.profile.state(float(granted_s[row]))
                position[row], speed[row] = state.position_deg, state.speed_deg_s
        return States(granted_s, position, speed)

    def _quantized(self, rows: _SegmentRows, granted_s: FloatArray) -> States:
        """Quantize the moves under way; the instants of their successors are known now."""
        limits = self._limits.take(self._joint[rows.segment])
        wire, duration_ms, travel = quantized(rows.state, rows.travel_deg_s, granted_s, limits)
        self._record(rows.segment, rows.state, wire, duration_ms, travel)
        target_deg = wire / limits.wire_per_deg
        reached = trapezoids(rows.state, target_deg, travel, limits.ramp_deg_s2).at(granted_s)
        speed = np.where(limits.forgets_speed, 0.0, reached.speed_deg_s)
        return States(granted_s, reached.position_deg, speed)

    def _record(
        self,
        segment: IntArray,
        state: States,
        wire: FloatArray,
        duration_ms: FloatArray,
        travel: FloatArray,
    ) -> None:
        self._of.append(segment)
        self._made.append(
            FittedMoves(
                self._joint[segment],
                state.time_s,
                wire,
                duration_ms,
                travel,
                state.position_deg,
                state.speed_deg_s,
            )
        )

    # ---- first moves

    def _departures_s(self, segment: IntArray) -> FloatArray:
        """Return when the first move of each segment is requested."""
        joint = self._joint[segment]
        limits = self._limits.take(joint)
        some = [self._segments[at] for at in segment]
        onset_s = np.array([one.onset_s for one in some])
        departs_s = np.array([one.departs_s for one in some])
        latest_s = np.array([one.latest_s for one in some])
        begin_deg, still = self._wire[segment] / limits.wire_per_deg, np.zeros(len(segment))
        state = States(departs_s, begin_deg, still)
        error_deg = self._landings(segment, state, self._is_near(segment, state)).error_deg
        candidates_s = np.linspace(onset_s, np.maximum(latest_s, onset_s), DEPARTURES)
        rows = np.tile(np.arange(len(segment)), DEPARTURES)
        candidates = States(candidates_s.ravel(), begin_deg[rows], still[rows])
        first = self._references.first_index(candidates.time_s)
        starts = Starts.of(self._references, joint[rows], first, candidates)
        steps = reach_steps(self._references, starts, DEPARTURE_STEPS, 1)
        best = np.argmax(candidates_s + GRID_S * steps.reshape(candidates_s.shape), axis=0)
        lands = error_deg <= CONE_RATIO * limits.tolerance_deg
        return np.where(lands, departs_s, candidates_s[best, np.arange(len(segment))])

    # ---- landings

    def _is_near(self, segment: IntArray, state: States) -> BoolArray:
        """Return whether the stop is near enough for a landing with one move."""
        limits = self._limits.take(self._joint[segment])
        left_s = self._references.times_s(self._stop_first[segment]) - state.time_s
        near: BoolArray = left_s <= SEGMENT_MAX_S + limits.speed_max_deg_s / limits.ramp_deg_s2
        return near

    def _landings(self, segment: IntArray, state: States, chosen: BoolArray) -> Landings:
        """Return how the `chosen` segments land on their stops; infinite error for the others."""
        every = Landings(*(np.full(len(segment), np.inf) for _ in range(4)))
        if chosen.any():
            at = segment[chosen]
            joint = self._joint[at]
            found = best_landings(
                self._references,
                joint,
                state.take(chosen),
                self._stop_wire[at],
                (self._stop_first[at], self._stop_last[at]),
                self._limits.take(joint),
            )
            every.put(chosen, found)
        return every

    def _settled(self, segment: IntArray, state: States) -> _SegmentRows:
        """Land the segments that can land, end those at the end; choose how the others continue."""
        joint, first = self._joint[segment], self._references.first_index(state.time_s)
        limits = self._limits.take(joint)
        found = next_moves(
            self._references, Servos(joint, limits, state, first, self._latest(segment, first))
        )
        stop_s = self._references.times_s(self._stop_first[segment])
        is_overdue = state.time_s + SEGMENT_MIN_S >= stop_s
        kept_s = state.time_s + GRID_S * found.held_steps
        is_near = kept_s + self._braking_s(segment, state, limits) >= stop_s
        landings = self._landings(segment, state, is_near | is_overdue)
        lands = (landings.error_deg <= CONE_RATIO * limits.tolerance_deg) | is_overdue
        if lands.any():
            self._record(
                segment[lands],
                state.take(lands),
                self._stop_wire[segment[lands]],
                landings.duration_ms[lands],
                landings.travel_deg_s[lands],
            )
        goes_on = ~lands & (state.time_s < self._references.end_s)
        return _SegmentRows(segment, state, found.speed_deg_s, found.requested_s).take(goes_on)

    def _braking_s(self, segment: IntArray, state: States, limits: LimitArrays) -> FloatArray:
        """Return how long a landing brakes at most: before that, it is a move like any other.

        A landing is at most twice as fast as the mean of its way, unless it begins faster.
        """
        left_s = self._references.times_s(self._stop_first[segment]) - state.time_s
        away_deg = np.abs(self._stop_wire[segment] / limits.wire_per_deg - state.position_deg)
        mean_deg_s = away_deg / np.maximum(left_s, SEGMENT_MIN_S)
        speed = np.maximum(np.abs(state.speed_deg_s), 2.0 * mean_deg_s)
        braking_s: FloatArray = np.minimum(speed, limits.speed_max_deg_s) / limits.ramp_deg_s2
        return braking_s

    def _latest(self, segment: IntArray, first: IntArray) -> IntArray:
        """Return the last index at which a successor may be received.

        No successor comes after the begin of the next stop, where the move must land, or after a
        seam.
        """
        latest = self._stop_first[segment] - SEGMENT_MIN_STEPS
        for seam in self._seams:
            is_ahead = first + SEGMENT_MIN_STEPS < seam
            latest = np.where(is_ahead, np.minimum(latest, seam), latest)
        return latest


class TimedFit:
    """The references of some joints, and the timed moves that follow them.

    `grant(joints, requested_us, after_us)` returns when servos will receive moves, in microseconds
    of show time: each at `requested_us` at the latest if there is a slot, and not before
    `after_us`.
    """

    def __init__(
        self,
        references: Sequence[Reference],
        limits: Sequence[ServoLimits],
        seams_s: Sequence[float] = (),
        initial: Sequence[InitialMotion] = (),
        turn_s: float = TURN_S,
        lines: Sequence[int] = (),
    ) -> None:
        """Take references on one grid, and the seams at which a moving reference needs a move.

        A move is received at or shortly before each seam, so that the moves between two seams can
        be repeated without end. Without `initial`, one motion a reference, all servos stand where
        their references do. A shorter turn fills the line better and takes longer to fit; with
        `RIVALRY_S` no move waits for another, except around those that come late then: there,
        all are placed anew with `TIGHT_TURN_S`. `lines` numbers the line of each reference; all are
        on one without it.
        """
        self._each = list(
            zip(references, limits, initial or (None,) * len(references), strict=True)
        )
        self._problem = FitProblem(
            references=References(references, limits),
            limits=LimitArrays(limits),
            seams=np.array(sorted(references[0].index(s) for s in seams_s), dtype=np.intp),
            line=np.array(lines or (0,) * len(references), dtype=np.intp),
        )
        self._turn_s = turn_s

    def moves(self, new_line: Callable[[], Grant]) -> FittedMoves:
        """Return the moves, by joint and time. `new_line` returns a free line for every run.

        Segments that fit with the commands that are given for them are not searched. A stop that a
        servo cannot reach in time is no stop in the next run. The other segments keep the slots
        that they have.
        """
        refused: set[tuple[int, int]] = set()
        turn_s = self._turn_s
        references, limits, _ = zip(*self._each, strict=True)
        known, made, of_segment = given_moves(references, limits, self._segments(refused), new_line)
        while True:
            segments = self._segments(refused)
            before, now = set(known), set(segments)
            is_kept = np.array([segment in now for segment in known], dtype=bool)[of_segment]
            made, of_segment = made.take(is_kept), of_segment[is_kept]
            new = [segment for segment in segments if segment not in before]
            grant, received_us = new_line(), microseconds(made.received_s)
            grant(made.joint, received_us, received_us)
            run = SegmentRun(self._problem, new, grant, turn_s)
            found, of_new = run.moves()
            is_whole = True
            if turn_s >= RIVALRY_S and (crowded := run.crowded()).any():
                turn_s, is_whole, is_free = TIGHT_TURN_S, False, ~crowded[of_new]
                found, of_new = found.take(is_free), (np.cumsum(~crowded) - 1)[of_new[is_free]]
                new = [one for one, is_late in zip(new, crowded, strict=True) if not is_late]
            made, of_segment = (
                concatenated((made, found)),
                np.append(of_segment, len(known) + of_new),
            )
            order = np.lexsort((made.received_s, made.joint))
            made, of_segment = made.take(order), of_segment[order]
            known += new
            late = [
                known[segment]
                for segment in of_segment[discontinuities(made, self._problem.limits)]
            ]
            if not late and is_whole:
                return made
            stops = {(segment.joint, segment.first) for segment in late}
            assert not stops & refused, "a segment without stops always joins"
            refused |= stops

    def _segments(self, refused: Container[tuple[int, int]]) -> list[Segment]:
        """Return all segments in the order in which they begin."""
        segments = [
            segment
            for joint, (reference, limits, initial) in enumerate(self._each)
            for segment in segments_of(
                joint, reference, limits, FOLLOW_RATIO * limits.tolerance_deg, refused, initial
            )
        ]
        return sorted(segments, key=lambda segment: segment.onset_s)
