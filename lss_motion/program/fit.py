"""Fits the fewest timed moves to the courses of all joints: the heart of the `timed` drive.

A move in mid-course is used for its travel speed: its target lies beyond the instant of the next
move, so that the servo ramps to that speed and keeps it, and never brakes before its successor
arrives. Only where the course comes to rest does a move end on its target.

All lanes (`lanes`) go forward together, a move each, as rows of arrays. All angles are servo angles
in degrees; instants are those at which the servo hears a move.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.batch import States, both, trapezoids
from lss_motion.program.cone import CONE_RATIO, reach_s
from lss_motion.program.course import GRID_S, Courses, LimitArrays
from lss_motion.program.landing import SEGMENT_MIN_S, Landings, best_landings
from lss_motion.program.lanes import Lane, lanes_of
from lss_motion.program.moves import Begin, Moves, in_order, unjoined
from lss_motion.program.next_move import FOLLOW_RATIO, SEGMENT_MIN_STEPS, Servos, chosen
from lss_motion.program.wording import aim
from lss_motion.units import US_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.program.batch import BoolArray, FloatArray, IntArray
    from lss_motion.program.course import Course, ServoLimits

    Grant = Callable[[int, int, int], int]

SEGMENT_MAX_S: Final = 1.5
"""The longest that one move is relied on: a lost command is repaired by its successor."""
DEPARTURES: Final = 7
"""Instants tried for the first move after a stop."""
DEPARTURE_STEPS: Final = 80
"""Grid steps in which it is judged how far they reach: every one, since what a servo at rest cannot
follow shows at once."""
RIVALRY_S: Final = 1.0
"""A move that is wanted this much later than another is of another stretch of the show."""
LANES_MAX: Final = 256
"""So many lanes are fitted side by side: their arrays fit into the processor's cache."""
TURN_S: Final = 0.1
"""A move waits for those of its stretch that are wanted this much earlier. The line is given away
in the order of time, or its free time would be cut into pieces too short for what comes."""
NEVER: Final = 2**62
"""The index of a stop that never comes."""


class Fit:
    """The courses of some joints, and the moves that follow them.

    `grant(joint, wanted_us, after_us)` returns when a move will be heard that is wanted at
    `wanted_us` at the latest and must not be heard before `after_us`: instants of the schedule.
    """

    def __init__(
        self,
        courses: Sequence[Course],
        limits: Sequence[ServoLimits],
        seams_s: Sequence[float] = (),
        begins: Sequence[Begin] = (),
        turn_s: float = TURN_S,
    ) -> None:
        """Take courses on one grid. While one moves, a move is heard at or shortly before a seam.

        Between two seams the moves can then be repeated without end. Without `begins`, one a
        course, all servos stand where their courses do. A shorter turn fills the line better, and
        takes longer to fit.
        """
        self._each = list(zip(courses, limits, begins or (None,) * len(courses), strict=True))
        self.turn_s = turn_s
        self.courses = Courses(courses, limits)
        self.limits = LimitArrays(limits)
        self.seams = np.array(sorted(courses[0].index(s) for s in seams_s), dtype=np.intp)

    def moves(self, new_line: Callable[[], Grant]) -> Moves:
        """Return the moves, by joint and time. `new_line` gives a free line for every attempt.

        A stop that a servo cannot reach in time is travelled through in the next attempt.
        """
        refused: set[tuple[int, int]] = set()
        while True:
            lanes = [
                lane
                for joint, (course, limits, begin) in enumerate(self._each)
                for lane in lanes_of(
                    joint, course, limits, FOLLOW_RATIO * limits.tolerance_deg, refused, begin
                )
            ]
            lanes.sort(key=lambda lane: lane.onset_s)
            made = _Run(self, lanes, new_line()).moves()
            late = {
                (int(made.joint[at]), self._stop_before(lanes, made, int(at)))
                for at in unjoined(made, self.limits)
            }
            if not late:
                return made
            assert not late & refused, "a lane without stops always joins"
            refused |= late

    def _stop_before(self, lanes: Sequence[Lane], moves: Moves, at: int) -> int:
        """Return the index of the stop from which the move `at` departs."""
        joint, heard_s = moves.joint[at], moves.heard_s[at]
        after_s = max(
            lane.after_s for lane in lanes if lane.joint == joint and lane.after_s <= heard_s + 1e-9
        )
        return round((after_s - self.courses.start_s) / GRID_S)


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


def _joined(one: _Rows, other: _Rows) -> _Rows:
    return _Rows(
        np.concatenate((one.lane, other.lane)),
        both(one.state, other.state),
        np.concatenate((one.wish_deg_s, other.wish_deg_s)),
        np.concatenate((one.wanted_s, other.wanted_s)),
    )


def _is_next(wanted_s: FloatArray, turn_s: float) -> BoolArray:
    """Return which moves to grant now: none that is wanted a turn after one of its stretch."""
    ordered = np.sort(wanted_s)
    earlier = np.searchsorted(ordered, wanted_s - turn_s)
    rivals = np.searchsorted(ordered, wanted_s - RIVALRY_S)
    is_next: BoolArray = earlier == rivals
    return is_next


class _Run:
    """One attempt: all lanes from their first move to their last."""

    def __init__(self, fit: Fit, lanes: Sequence[Lane], grant: Grant) -> None:
        self._courses, self._limits, self._seams = fit.courses, fit.limits, fit.seams
        self._grant, self._turn_s = grant, fit.turn_s
        self._joint = np.array([lane.joint for lane in lanes], dtype=np.intp)
        self._wire = np.array([lane.wire for lane in lanes], dtype=np.float64)
        self._stop_wire = np.array([lane.stop_wire for lane in lanes], dtype=np.float64)
        stops = [lane.stop or (NEVER, NEVER) for lane in lanes]
        self._stop_first = np.array([stop[0] for stop in stops], dtype=np.intp)
        self._stop_last = np.array([stop[1] for stop in stops], dtype=np.intp)
        self._after_s = np.array([lane.after_s for lane in lanes])
        self._lanes = lanes
        self._made: list[Moves] = []

    def moves(self) -> Moves:
        waiting = deque(range(len(self._lanes)))
        empty = np.zeros(0)
        nobody = np.zeros(0, dtype=np.intp)
        self._record(nobody, States(empty, empty, empty), empty, empty, empty)
        rows = self._entered(nobody)
        while waiting or len(rows.lane):
            room = LANES_MAX - len(rows.lane)
            new = [waiting.popleft() for _ in range(min(len(waiting), room))]
            if new:
                rows = _joined(rows, self._entered(np.array(new, dtype=np.intp)))
            is_next = _is_next(rows.wanted_s, self._turn_s)
            rows = _joined(rows.take(~is_next), self._advanced(rows.take(is_next)))
        return in_order(self._made)

    def _entered(self, lane: IntArray) -> _Rows:
        """Return lanes that wait for their first move; they have no travel speed yet."""
        none = np.full(len(lane), np.nan)
        wanted_s = self._departures_s(lane) if len(lane) else np.zeros(0)
        return _Rows(lane, States(self._after_s[lane], none, none), none, wanted_s)

    def _advanced(self, rows: _Rows) -> _Rows:
        """Have the next moves granted, put those under way into words, and choose what follows."""
        in_turn = np.argsort(rows.wanted_s, kind="stable")
        wanted_us, after_us = (
            np.rint(US_PER_S * times_s[in_turn]).astype(np.intp).tolist()
            for times_s in (rows.wanted_s, rows.state.time_s)
        )
        joints = self._joint[rows.lane[in_turn]].tolist()
        granted_us = list(map(self._grant, joints, wanted_us, after_us))
        granted_s = np.empty(len(in_turn))
        granted_s[in_turn] = np.array(granted_us, dtype=np.float64) / US_PER_S
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
        self._made.append(
            Moves(
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
        trials_s = np.linspace(onset_s, np.maximum(latest_s, onset_s), DEPARTURES, axis=1)
        rows = np.repeat(np.arange(len(lane)), DEPARTURES)
        trials = States(trials_s.ravel(), begin_deg[rows], still[rows])
        reached_s = reach_s(
            self._courses, joint[rows], trials, limits.take(rows), DEPARTURE_STEPS, 1
        )
        best = np.argmax(reached_s.reshape(-1, DEPARTURES), axis=1)
        lands = error_deg <= CONE_RATIO * limits.tolerance_deg
        return np.where(lands, leaves_s, trials_s[np.arange(len(lane)), best])

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
        stop_s = self._courses.times_s(self._stop_first[lane])
        is_overdue = state.time_s + SEGMENT_MIN_S >= stop_s
        tolerance = CONE_RATIO * self._limits.tolerance_deg[self._joint[lane]]
        landings = self._landings(lane, state, self._is_near(lane, state) | is_overdue)
        lands = (landings.error_deg <= tolerance) | is_overdue
        if lands.any():
            self._record(
                lane[lands],
                state.take(lands),
                self._stop_wire[lane[lands]],
                landings.duration_ms[lands],
                landings.travel_deg_s[lands],
            )
        goes_on = np.flatnonzero(~lands & (state.time_s < self._courses.end_s))
        lane, state = lane[goes_on], state.take(goes_on)
        joint, first = self._joint[lane], self._courses.first_index(state.time_s)
        latest = self._latest(lane, first)
        servos = Servos(joint, self._limits.take(joint), state, first, latest)
        return _Rows(lane, state, *chosen(self._courses, servos))

    def _latest(self, lane: IntArray, first: IntArray) -> IntArray:
        """Return the last index at which a successor may be heard.

        After the next stop began there is none (it has to land there), nor after a seam.
        """
        latest = self._stop_first[lane] - SEGMENT_MIN_STEPS
        for seam in self._seams:
            is_ahead = first + SEGMENT_MIN_STEPS < seam
            latest = np.where(is_ahead, np.minimum(latest, seam), latest)
        return latest
