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
    first_s, last_s = (courses.times_s(index) for index in rest)
    ramp, most = limits.ramp_deg_s2, limits.speed_max_deg_s
    target_deg = wire / limits.wire_per_deg
    left_s = np.maximum(first_s - state.time_s, SEGMENT_MIN_S)
    exact = np.clip(exact_speeds(state, target_deg, left_s, ramp), SPEED_LEAST_DEG_S, most)
    tried = np.array(LANDING_RATIOS)[:, None] * exact
    duration_ms = durations_ms(state, target_deg, tried, limits)
    travel = speeds_for(state, target_deg, duration_ms / MS_PER_S, ramp, limits.is_exact)
    travel = np.minimum(travel, most)
    moves = trapezoids(state, target_deg, travel, ramp)
    landed_s = moves.end_s

    first = courses.first_index(state.time_s)
    end = np.maximum(courses.first_index(np.minimum(landed_s, last_s)), rest[0])
    # On a line that is too full, the standstill may be over before the move is heard.
    lasts = 1 + np.maximum(end - first, 0)
    counts = lasts.max(axis=0)
    starts = np.cumsum(counts) - counts
    of = np.repeat(np.arange(len(wire)), counts)
    step = np.arange(len(of)) - starts[of]
    index = first[of] + step
    course_deg = courses.position_deg(joint[of], index)
    stray = moves.take(of).positions_deg(courses.times_s(index))
    stray -= course_deg
    np.abs(stray, out=stray)
    stray[step >= lasts.take(of, axis=1)] = 0.0
    error_deg = np.maximum.reduceat(stray, starts, axis=1)
    late_s = landed_s - (last_s + SEGMENT_MIN_S)
    error_deg = np.where(late_s > 0.0, TOO_LATE_DEG + late_s, error_deg)
    merit = np.maximum(error_deg, ALIKE_RATIO * limits.tolerance_deg)
    merit += TOGETHER_DEG_S * np.abs(landed_s - first_s)
    best = np.argmin(merit, axis=0), np.arange(len(wire))
    return Landings(error_deg[best], landed_s[best], duration_ms[best], travel[best])
