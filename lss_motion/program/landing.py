"""The last move before a standstill: it ends on its target, together with the course."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.response import Reference, trapezoid, travel_speed
from lss_motion.program.wording import SPEED_LEAST_DEG_S, duration_for, lattice
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from lss_motion.program.cone import Course, ServoLimits
    from lss_motion.program.response import Piece

SEGMENT_MIN_S: Final = 0.01
"""The least between two moves of a joint: two control ticks of the servo."""
LANDING_RATIOS: Final = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2)
"""Travel speeds tried for a landing, by the one that comes to rest together with the course."""


def best_landing(
    state: Piece, rest: tuple[int, int], course: Course, limits: ServoLimits
) -> tuple[float, float, int, int]:
    """Return how a move from `state` lands on the standstill `rest` of the course at its best.

    The largest error until course and servo rest, from when on the servo does, target and T.
    """
    wire = lattice(float(course.position_deg[rest[0]]), limits)
    return min(
        _landing(state, wire, duration_ms, rest, course, limits)
        for duration_ms in _durations_ms(state, wire, course.time_s(rest[0]), limits)
    )


def _durations_ms(state: Piece, wire: int, rest_s: float, limits: ServoLimits) -> list[int]:
    """Return the T to try: around the one that comes to rest with the course."""
    target_deg = wire / limits.wire_per_deg
    distance_deg = abs(target_deg - state.position_deg)
    left_s = max(rest_s - state.start_s, SEGMENT_MIN_S)
    low, high = 0.5 * max(distance_deg / left_s, SPEED_LEAST_DEG_S), limits.speed_max_deg_s
    for _ in range(12):
        middle = 0.5 * (low + high)
        end_s = trapezoid(state, target_deg, middle, limits.ramp_deg_s2)[-1].start_s
        low, high = (middle, high) if end_s > rest_s else (low, middle)
    return sorted({duration_for(state, target_deg, high * r, limits) for r in LANDING_RATIOS})


def _landing(
    state: Piece,
    wire: int,
    duration_ms: int,
    rest: tuple[int, int],
    course: Course,
    limits: ServoLimits,
) -> tuple[float, float, int, int]:
    target_deg = wire / limits.wire_per_deg
    travel_deg_s = travel_speed(
        state, target_deg, s_from_ms(duration_ms), limits.ramp_deg_s2, limits.response
    )
    travel_deg_s = min(travel_deg_s, limits.speed_max_deg_s)
    pieces = trapezoid(state, target_deg, travel_deg_s, limits.ramp_deg_s2)
    landed_s = pieces[-1].start_s
    if landed_s > course.time_s(rest[1]) + SEGMENT_MIN_S:
        return float("inf"), landed_s, wire, duration_ms
    last = max(course.index(landed_s), rest[0])
    steps = np.arange(course.index(state.start_s), last + 1)
    profile_deg = Reference(pieces).sample(course.times_s(steps))
    error_deg = float(np.abs(profile_deg - course.position_deg[steps]).max())
    return error_deg, landed_s, wire, duration_ms
