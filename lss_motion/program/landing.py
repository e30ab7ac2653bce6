"""The last move before a standstill: it ends on its target, together with the course."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.batch import States, exact_speeds, speeds_for, trapezoids
from lss_motion.program.wording import SPEED_LEAST_DEG_S, durations_ms
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from lss_motion.program.batch import BoolArray, FloatArray, IntArray
    from lss_motion.program.course import Courses, LimitArrays

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
    courses: Courses,
    joint: IntArray,
    state: States,
    wire: FloatArray,
    rest: tuple[IntArray, IntArray],
    limits: LimitArrays,
) -> Landings:
    """Return how moves from `state` land on `wire`, where the courses stand over `rest`."""
    first_s, last_s = (courses.times_s(index)[:, None] for index in rest)
    column = limits.column()
    starts = state.column()
    target_deg = wire[:, None] / column.wire_per_deg
    left_s = np.maximum(first_s - starts.time_s, SEGMENT_MIN_S)
    exact = exact_speeds(starts, target_deg, left_s, column.ramp_deg_s2)
    exact = np.clip(exact, SPEED_LEAST_DEG_S, column.speed_max_deg_s)
    duration_ms = durations_ms(starts, target_deg, exact * np.array(LANDING_RATIOS), column)
    travel = speeds_for(
        starts, target_deg, duration_ms / MS_PER_S, column.ramp_deg_s2, column.is_exact
    )
    travel = np.minimum(travel, column.speed_max_deg_s)
    moves = trapezoids(starts, target_deg, travel, column.ramp_deg_s2)
    landed_s = moves.end_s

    first = courses.first_index(state.time_s)
    end = np.maximum(courses.first_index(np.minimum(landed_s, last_s)), rest[0][:, None])
    lasts = end - first[:, None]
    # On a line that is too full, the standstill may be over before the move is heard.
    steps = np.arange(int(lasts.max(initial=0)) + 1)[:, None]
    times_s = courses.times_s(first + steps)[:, :, None]
    course_deg = courses.position_deg[courses.flat(joint, first + steps)][:, :, None]
    stray = np.abs(moves.at(times_s).position_deg - course_deg)
    error_deg = np.where(steps[:, :, None] <= lasts, stray, 0.0).max(axis=0)
    late_s = landed_s - (last_s + SEGMENT_MIN_S)
    error_deg = np.where(late_s > 0.0, TOO_LATE_DEG + late_s, error_deg)
    merit = np.maximum(error_deg, ALIKE_RATIO * column.tolerance_deg)
    merit += TOGETHER_DEG_S * np.abs(landed_s - first_s)
    row = np.arange(len(wire)), np.argmin(merit, axis=1)
    return Landings(error_deg[row], landed_s[row], duration_ms[row], travel[row])
