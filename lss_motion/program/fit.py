"""Fits the fewest timed moves to the courses of all joints: the heart of the `timed` drive.

A move in mid-course is used for its travel speed: its target lies beyond the instant of the next
move, so that the servo ramps to that speed and keeps it, and never brakes before its successor
arrives. Only where the course comes to rest does a move end on its target.

All lanes (`lanes`) go forward together, a move each, as rows of arrays. All angles are servo angles
in degrees; instants are those at which the servo hears a move.

One attempt at fitting: all lanes from their first move to their last, side by side.

The lanes under way are the rows of arrays; each goes forward by one move at a time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.cones import CONE_RATIO, Starts, reach_steps
from lss_motion.program.moves import Begin, FittedMoves, joined, nothing, unjoined
from lss_motion.program.quantize import aim
from lss_motion.program.reference import GRID_S, SEGMENT_MAX_S, LimitArrays, References
from lss_motion.program.response import States, both, trapezoids
from lss_motion.program.search import (
    FOLLOW_RATIO,
    SEGMENT_MIN_S,
    SEGMENT_MIN_STEPS,
    Landings,
    Servos,
    best_landings,
    chosen,
)
from lss_motion.program.segments import Segment, segments_of
from lss_motion.units import US_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Sequence

    from lss_motion.program.reference import Reference, ServoLimits
    from lss_motion.program.response import BoolArray, FloatArray, IntArray

    Grant = Callable[[IntArray, IntArray, IntArray], IntArray]


DEPARTURES: Final = 7
"""Instants tried for the first move after a stop."""
DEPARTURE_STEPS: Final = 80
"""Grid steps in which it is judged how far they reach: every one, since what a servo at rest cannot
follow shows at once."""
RIVALRY_S: Final = 1.0
"""A move that is wanted this much later than another is of another stretch of the show."""
LANES_MAX: Final = 2048
"""So many lanes are fitted side by side: enough for ten minutes of 18 joints, in bounded memory."""
NEVER: Final = 2**62
"""The index of a stop that never comes."""


def microseconds(times_s: FloatArray) -> IntArray:
    whole: IntArray = np.rint(US_PER_S * times_s).astype(np.intp)
    return whole


@dataclass(frozen=True, slots=True)
class _Rows:
    """The lanes under way, a row each. `wish_deg_s` is the travel speed of the move at `state`."""

    lane: IntArray
    state: States
    wish_deg_s: FloatArray
    wanted_s: FloatArray

    def take(self, chosen: BoolArray) -> _Rows:
        return _Rows(
            self.lane[chosen],
            self.state.take(chosen),
            self.wish_deg_s[chosen],
            self.wanted_s[chosen],
        )


def _together(one: _Rows, other: _Rows) -> _Rows:
    return _Rows(
        np.concatenate((one.lane, other.lane)),
        both(one.state, other.state),
        np.concatenate((one.wish_deg_s, other.wish_deg_s)),
        np.concatenate((one.wanted_s, other.wanted_s)),
    )


def _is_next(wanted_s: FloatArray, turn_s: float) -> BoolArray:
    """Return which moves to grant now: none that is wanted a turn after one of its stretch."""
    if turn_s >= RIVALRY_S:
        return np.ones(len(wanted_s), dtype=bool)
    ordered = np.sort(wanted_s)
    earlier = np.searchsorted(ordered, wanted_s - turn_s)
    rivals = np.searchsorted(ordered, wanted_s - RIVALRY_S)
    is_next: BoolArray = earlier == rivals
    return is_next


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What all lanes share: by joint, the seams as indices of the grid; `fit.TURN_S`."""

    courses: References
    limits: LimitArrays
    seams: IntArray
    turn_s: float


class Run:
    """All lanes from their first move to their last."""

    def __init__(self, task: Task, lanes: Sequence[Segment], grant: Grant) -> None:
        self._courses, self._limits, self._seams = task.courses, task.limits, task.seams
        self._grant, self._turn_s = grant, task.turn_s
        self._joint = np.array([lane.joint for lane in lanes], dtype=np.intp)
        self._wire = np.array([lane.wire for lane in lanes], dtype=np.float64)
        self._stop_wire = np.array([lane.stop_wire for lane in lanes], dtype=np.float64)
        stops = [lane.stop or (NEVER, NEVER) for lane in lanes]
        self._stop_first = np.array([stop[0] for stop in stops], dtype=np.intp)
        self._stop_last = np.array([stop[1] for stop in stops], dtype=np.intp)
        self._after_s = np.array([lane.after_s for lane in lanes])
        self._lanes = lanes
        self._made: list[FittedMoves] = [nothing()]
        self._of: list[IntArray] = [np.zeros(0, dtype=np.intp)]

    def moves(self) -> tuple[FittedMoves, IntArray]:
        """Return the moves, in any order, and of which lane each is."""
        waiting = deque(range(len(self._lanes)))
        rows = self._entered(np.zeros(0, dtype=np.intp))
        while waiting or len(rows.lane):
            room = LANES_MAX - len(rows.lane)
            new = [waiting.popleft() for _ in range(min(len(waiting), room))]
            if new:
                # By joint: what is looked up for neighbours then lies near each other, too.
                by_joint = np.array(new)[np.argsort(self._joint[new], kind="stable")]
                rows = _together(rows, self._entered(by_joint))
            is_next = _is_next(rows.wanted_s, self._turn_s)
            if is_next.all():
                rows = self._advanced(rows)
            else:
                rows = _together(rows.take(~is_next), self._advanced(rows.take(is_next)))
        return joined(self._made), np.concatenate(self._of)

    def _entered(self, lane: IntArray) -> _Rows:
        """Return lanes that wait for their first move; they have no travel speed yet."""
        none = np.full(len(lane), np.nan)
        wanted_s = self._departures_s(lane) if len(lane) else np.zeros(0)
        return _Rows(lane, States(self._after_s[lane], none, none), none, wanted_s)

    def _advanced(self, rows: _Rows) -> _Rows:
        """Have the next moves granted, put those under way into words, and choose what follows."""
        in_turn = np.argsort(rows.wanted_s, kind="stable")
        granted_us = self._grant(
            self._joint[rows.lane[in_turn]],
            microseconds(rows.wanted_s[in_turn]),
            microseconds(rows.state.time_s[in_turn]),
        )
        granted_s = np.empty(len(in_turn))
        granted_s[in_turn] = granted_us / US_PER_S
        is_new = np.isnan(rows.wish_deg_s)
        begun = self._begun(rows.lane[is_new], granted_s[is_new])
        moved = self._worded(rows.take(~is_new), granted_s[~is_new])
        lane = np.concatenate((rows.lane[is_new], rows.lane[~is_new]))
        return self._settled(lane, both(begun, moved))

    def _begun(self, lane: IntArray, granted_s: FloatArray) -> States:
        """Return the states of profiles that hear their first move, at rest or under way."""
        position = self._wire[lane] / self._limits.wire_per_deg[self._joint[lane]]
        speed = np.zeros(len(lane))
        for row, at in enumerate(lane):
            begin = self._lanes[at].begin
            if begin is not None:
                state = begin.profile.state(float(granted_s[row]))
                position[row], speed[row] = state.position_deg, state.speed_deg_s
        return States(granted_s, position, speed)

    def _worded(self, rows: _Rows, granted_s: FloatArray) -> States:
        """Put the moves under way into words, now that their successors are known."""
        limits = self._limits.take(self._joint[rows.lane])
        wire, duration_ms, travel = aim(rows.state, rows.wish_deg_s, granted_s, limits)
        self._record(rows.lane, rows.state, wire, duration_ms, travel)
        target_deg = wire / limits.wire_per_deg
        reached = trapezoids(rows.state, target_deg, travel, limits.ramp_deg_s2).at(granted_s)
        speed = np.where(limits.forgets_speed, 0.0, reached.speed_deg_s)
        return States(granted_s, reached.position_deg, speed)

    def _record(
        self,
        lane: IntArray,
        state: States,
        wire: FloatArray,
        duration_ms: FloatArray,
        travel: FloatArray,
    ) -> None:
        self._of.append(lane)
        self._made.append(
            FittedMoves(
                self._joint[lane],
                state.time_s,
                wire,
                duration_ms,
                travel,
                state.position_deg,
                state.speed_deg_s,
            )
        )

    # ---- out of rest

    def _departures_s(self, lane: IntArray) -> FloatArray:
        """Return when the first move of each lane should be heard."""
        joint = self._joint[lane]
        limits = self._limits.take(joint)
        some = [self._lanes[at] for at in lane]
        onset_s = np.array([one.onset_s for one in some])
        leaves_s = np.array([one.leaves_s for one in some])
        latest_s = np.array([one.latest_s for one in some])
        begin_deg, still = self._wire[lane] / limits.wire_per_deg, np.zeros(len(lane))
        state = States(leaves_s, begin_deg, still)
        error_deg = self._landings(lane, state, self._is_near(lane, state)).error_deg
        trials_s = np.linspace(onset_s, np.maximum(latest_s, onset_s), DEPARTURES)
        rows = np.tile(np.arange(len(lane)), DEPARTURES)
        trials = States(trials_s.ravel(), begin_deg[rows], still[rows])
        first = self._courses.first_index(trials.time_s)
        starts = Starts.of(self._courses, joint[rows], first, trials)
        steps = reach_steps(self._courses, starts, DEPARTURE_STEPS, 1)
        best = np.argmax(trials_s + GRID_S * steps.reshape(trials_s.shape), axis=0)
        lands = error_deg <= CONE_RATIO * limits.tolerance_deg
        return np.where(lands, leaves_s, trials_s[best, np.arange(len(lane))])

    # ---- to rest

    def _is_near(self, lane: IntArray, state: States) -> BoolArray:
        """Return whether the stop is near enough to be landed on with one move."""
        limits = self._limits.take(self._joint[lane])
        left_s = self._courses.times_s(self._stop_first[lane]) - state.time_s
        near: BoolArray = left_s <= SEGMENT_MAX_S + limits.speed_max_deg_s / limits.ramp_deg_s2
        return near

    def _landings(self, lane: IntArray, state: States, chosen: BoolArray) -> Landings:
        """Return how the `chosen` lanes land on their stops, with infinite error for the others."""
        every = Landings(*(np.full(len(lane), np.inf) for _ in range(4)))
        if chosen.any():
            at = lane[chosen]
            joint = self._joint[at]
            found = best_landings(
                self._courses,
                joint,
                state.take(chosen),
                self._stop_wire[at],
                (self._stop_first[at], self._stop_last[at]),
                self._limits.take(joint),
            )
            every.put(chosen, found)
        return every

    def _settled(self, lane: IntArray, state: States) -> _Rows:
        """Land the lanes that can land, end those at the end; choose how the others go on."""
        joint, first = self._joint[lane], self._courses.first_index(state.time_s)
        limits = self._limits.take(joint)
        found = chosen(
            self._courses, Servos(joint, limits, state, first, self._latest(lane, first))
        )
        stop_s = self._courses.times_s(self._stop_first[lane])
        is_overdue = state.time_s + SEGMENT_MIN_S >= stop_s
        kept_s = state.time_s + GRID_S * found.held_steps
        is_near = kept_s + self._braking_s(lane, state, limits) >= stop_s
        landings = self._landings(lane, state, is_near | is_overdue)
        lands = (landings.error_deg <= CONE_RATIO * limits.tolerance_deg) | is_overdue
        if lands.any():
            self._record(
                lane[lands],
                state.take(lands),
                self._stop_wire[lane[lands]],
                landings.duration_ms[lands],
                landings.travel_deg_s[lands],
            )
        goes_on = ~lands & (state.time_s < self._courses.end_s)
        return _Rows(lane, state, found.speed_deg_s, found.wanted_s).take(goes_on)

    def _braking_s(self, lane: IntArray, state: States, limits: LimitArrays) -> FloatArray:
        """Return how long a landing brakes at the most: until then it is a move like any other.

        None is more than twice as fast as the mean of its way, unless it begins as fast.
        """
        left_s = self._courses.times_s(self._stop_first[lane]) - state.time_s
        away_deg = np.abs(self._stop_wire[lane] / limits.wire_per_deg - state.position_deg)
        mean_deg_s = away_deg / np.maximum(left_s, SEGMENT_MIN_S)
        speed = np.maximum(np.abs(state.speed_deg_s), 2.0 * mean_deg_s)
        braking_s: FloatArray = np.minimum(speed, limits.speed_max_deg_s) / limits.ramp_deg_s2
        return braking_s

    def _latest(self, lane: IntArray, first: IntArray) -> IntArray:
        """Return the last index at which a successor may be heard.

        After the next stop began there is none (it has to land there), nor after a seam.
        """
        latest = self._stop_first[lane] - SEGMENT_MIN_STEPS
        for seam in self._seams:
            is_ahead = first + SEGMENT_MIN_STEPS < seam
            latest = np.where(is_ahead, np.minimum(latest, seam), latest)
        return latest


TURN_S: Final = 0.1
"""A move waits for those of its stretch that are wanted this much earlier: where the line is given
away in the order of time, nobody has to be late for whom is wanted later."""


class TimedFit:
    """The courses of some joints, and the moves that follow them.

    `grant(joints, wanted_us, after_us)` returns when moves will be heard, each of which is wanted
    at `wanted_us` at the latest and must not be heard before `after_us`: instants of the schedule.
    """

    def __init__(
        self,
        courses: Sequence[Reference],
        limits: Sequence[ServoLimits],
        seams_s: Sequence[float] = (),
        begins: Sequence[Begin] = (),
        turn_s: float = TURN_S,
    ) -> None:
        """Take courses on one grid. While one moves, a move is heard at or shortly before a seam.

        Between two seams the moves can then be repeated without end. Without `begins`, one a
        course, all servos stand where their courses do. A shorter turn fills the line better and
        takes longer to fit; with `run.RIVALRY_S` nobody waits.
        """
        self._each = list(zip(courses, limits, begins or (None,) * len(courses), strict=True))
        self._task = Task(
            courses=References(courses, limits),
            limits=LimitArrays(limits),
            seams=np.array(sorted(courses[0].index(s) for s in seams_s), dtype=np.intp),
            turn_s=turn_s,
        )

    def moves(self, new_line: Callable[[], Grant]) -> FittedMoves:
        """Return the moves, by joint and time. `new_line` gives a free line for every attempt.

        A stop that a servo cannot reach in time is travelled through in the next attempt; what the
        other lanes have been granted they keep.
        """
        refused: set[tuple[int, int]] = set()
        known: list[Segment] = []
        made, of_lane = nothing(), np.zeros(0, dtype=np.intp)
        while True:
            lanes = self._lanes(refused)
            before, now = set(known), set(lanes)
            is_kept = np.array([lane in now for lane in known], dtype=bool)[of_lane]
            made, of_lane = made.take(is_kept), of_lane[is_kept]
            new = [lane for lane in lanes if lane not in before]
            grant, received_us = new_line(), microseconds(made.heard_s)
            grant(made.joint, received_us, received_us)
            found, of_new = Run(self._task, new, grant).moves()
            made, of_lane = joined((made, found)), np.append(of_lane, len(known) + of_new)
            order = np.lexsort((made.heard_s, made.joint))
            made, of_lane = made.take(order), of_lane[order]
            known += new
            late = [known[lane] for lane in of_lane[unjoined(made, self._task.limits)]]
            if not late:
                return made
            stops = {(lane.joint, lane.first) for lane in late}
            assert not stops & refused, "a lane without stops always joins"
            refused |= stops

    def _lanes(self, refused: Container[tuple[int, int]]) -> list[Segment]:
        """Return all lanes in the order in which they begin."""
        lanes = [
            lane
            for joint, (course, limits, begin) in enumerate(self._each)
            for lane in segments_of(
                joint, course, limits, FOLLOW_RATIO * limits.tolerance_deg, refused, begin
            )
        ]
        return sorted(lanes, key=lambda lane: lane.onset_s)
