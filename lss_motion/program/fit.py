"""Fits the fewest timed moves to the courses of all joints: the heart of the `timed` drive.

A move in mid-course is used for its travel speed: its target lies beyond the instant of the next
move, so that the servo ramps to that speed and keeps it, and never brakes before its successor
arrives. Only where the course comes to rest does a move end on its target.

All lanes (`lanes`) go forward together, a move each, as rows of arrays. All angles are servo angles
in degrees; instants are those at which the servo hears a move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.course import Courses, LimitArrays
from lss_motion.program.lanes import Lane, lanes_of
from lss_motion.program.moves import Begin, Moves, joined, nothing, unjoined
from lss_motion.program.next_move import FOLLOW_RATIO
from lss_motion.program.run import Run, Task, microseconds

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Sequence

    from lss_motion.program.course import Course, ServoLimits
    from lss_motion.program.run import Grant

TURN_S: Final = 0.1
"""A move waits for those of its stretch that are wanted this much earlier: where the line is given
away in the order of time, nobody has to be late for whom is wanted later."""


class Fit:
    """The courses of some joints, and the moves that follow them.

    `grant(joints, wanted_us, after_us)` returns when moves will be heard, each of which is wanted
    at `wanted_us` at the latest and must not be heard before `after_us`: instants of the schedule.
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
        course, all servos stand where their courses do. A shorter turn fills the line better and
        takes longer to fit; with `run.RIVALRY_S` nobody waits.
        """
        self._each = list(zip(courses, limits, begins or (None,) * len(courses), strict=True))
        self._task = Task(
            courses=Courses(courses, limits),
            limits=LimitArrays(limits),
            seams=np.array(sorted(courses[0].index(s) for s in seams_s), dtype=np.intp),
            turn_s=turn_s,
        )

    def moves(self, new_line: Callable[[], Grant]) -> Moves:
        """Return the moves, by joint and time. `new_line` gives a free line for every attempt.

        A stop that a servo cannot reach in time is travelled through in the next attempt; what the
        other lanes have been granted they keep.
        """
        refused: set[tuple[int, int]] = set()
        known: list[Lane] = []
        made, of_lane = nothing(), np.zeros(0, dtype=np.intp)
        while True:
            lanes = self._lanes(refused)
            before, now = set(known), set(lanes)
            is_kept = np.array([lane in now for lane in known], dtype=bool)[of_lane]
            made, of_lane = made.take(is_kept), of_lane[is_kept]
            new = [lane for lane in lanes if lane not in before]
            grant, heard_us = new_line(), microseconds(made.heard_s)
            grant(made.joint, heard_us, heard_us)
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

    def _lanes(self, refused: Container[tuple[int, int]]) -> list[Lane]:
        """Return all lanes in the order in which they begin."""
        lanes = [
            lane
            for joint, (course, limits, begin) in enumerate(self._each)
            for lane in lanes_of(
                joint, course, limits, FOLLOW_RATIO * limits.tolerance_deg, refused, begin
            )
        ]
        return sorted(lanes, key=lambda lane: lane.onset_s)
