"""Puts a travel speed into what the wire can say: a target on its lattice, whole milliseconds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from lss_motion.program.cone import DURATION_MAX_MS, ramped
from lss_motion.program.response import expected_duration, travel_speed
from lss_motion.units import MS_PER_S, s_from_ms

if TYPE_CHECKING:
    from lss_motion.program.cone import ServoLimits
    from lss_motion.program.response import Piece

LATEST_ARRIVAL_S: Final = 0.06
"""A successor may be this late before the servo begins to brake. Chosen: three times the worst
wait for a line on which 18 servos start at once at 115200 bps."""
AIM_TRIALS: Final = 12
"""Neighbouring lattice targets tried for the one that hits the wanted speed best."""
SPEED_LEAST_DEG_S: Final = 0.01
"""Slower than this is standing still: a lattice step of 0.1° in ten seconds."""


def aim(state: Piece, speed_deg_s: float, next_s: float, limits: ServoLimits) -> tuple[int, int]:
    """Return target and T that make the servo travel at `speed_deg_s` beyond `next_s`."""
    sign = 1 if speed_deg_s >= 0.0 else -1
    braking_deg = 0.5 * speed_deg_s * speed_deg_s / limits.ramp_deg_s2
    reached_deg, _ = ramped(
        state.position_deg,
        state.speed_deg_s,
        speed_deg_s,
        next_s - state.start_s,
        limits.ramp_deg_s2,
    )
    beyond_deg = float(reached_deg) + sign * (abs(speed_deg_s) * LATEST_ARRIVAL_S + braking_deg)
    trials = []
    for step in range(AIM_TRIALS):
        wire = lattice(beyond_deg + sign * step / limits.wire_per_deg, limits)
        target_deg = wire / limits.wire_per_deg
        duration_ms = duration_for(state, target_deg, abs(speed_deg_s), limits)
        hit_deg_s = travel_speed(
            state, target_deg, s_from_ms(duration_ms), limits.ramp_deg_s2, limits.response
        )
        trials.append((abs(hit_deg_s - abs(speed_deg_s)), step, wire, duration_ms))
    _, _, wire, duration_ms = min(trials)
    return wire, duration_ms


def duration_for(state: Piece, target_deg: float, speed_deg_s: float, limits: ServoLimits) -> int:
    """Return T for a travel speed: rounded, but never so that it breaks the speed limit."""
    speed_deg_s = max(speed_deg_s, SPEED_LEAST_DEG_S)
    wanted_s = expected_duration(
        state, target_deg, speed_deg_s, limits.ramp_deg_s2, limits.response
    )
    duration_ms = min(max(1, round(MS_PER_S * wanted_s)), DURATION_MAX_MS)
    if abs(target_deg - state.position_deg) > limits.speed_max_deg_s * s_from_ms(duration_ms):
        duration_ms += 1
    return duration_ms


def lattice(position_deg: float, limits: ServoLimits) -> int:
    """Return the wire value nearest to `position_deg` inside the joint's range."""
    per_deg = limits.wire_per_deg / limits.wire_step
    low = math.ceil(limits.position_min_deg * per_deg - 1e-6)
    high = math.floor(limits.position_max_deg * per_deg + 1e-6)
    return limits.wire_step * min(max(round(position_deg * per_deg), low), high)
