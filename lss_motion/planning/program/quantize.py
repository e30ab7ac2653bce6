"""Quantizes travel speeds to what the wire carries: targets on a lattice, T in whole ms."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.planning.program.cones import ramped
from lss_motion.planning.program.reference_grid import DURATION_MAX_MS
from lss_motion.planning.program.response import States, durations_for, speeds_for
from lss_motion.robot.profile import DURATION_MIN_MS
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from lss_motion.planning.program.reference_grid import LimitArrays, ServoLimits
    from lss_motion.planning.program.response import FloatArray

LATEST_ARRIVAL_S: Final = 0.06
"""A successor may be this late before the servo begins to brake. Chosen: three times the longest
wait for a line on which 18 servos start at once at 115200 bps."""
AIM_CANDIDATES: Final = 8
"""Number of neighbouring targets among which the one nearest to the requested speed is chosen."""
SPEED_LEAST_DEG_S: Final = 0.01
"""A slower motion counts as standing still: a wire unit of 0.1° in ten seconds."""


def quantized(
    state: States, speed_deg_s: FloatArray, next_s: FloatArray, limits: LimitArrays
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return target, T and travel speed that are nearest to `speed_deg_s`.

    Target in wire units, T in ms. The target lies beyond the position of the profile at `next_s`,
    when the servo receives the next move.
    """
    sign = np.where(speed_deg_s >= 0.0, 1.0, -1.0)
    speed = np.abs(speed_deg_s)
    reached_deg, _ = ramped(
        state.position_deg,
        state.speed_deg_s,
        speed_deg_s,
        next_s - state.time_s,
        limits.ramp_deg_s2,
    )
    beyond = speed * LATEST_ARRIVAL_S + 0.5 * speed * speed / limits.ramp_deg_s2
    steps = sign * np.arange(AIM_CANDIDATES)[:, None]
    wire = nearest_wires((reached_deg + sign * beyond) * limits.wire_per_deg + steps, limits)
    target_deg = wire / limits.wire_per_deg
    duration_ms = durations_ms(state, target_deg, speed, limits)
    duration_s = duration_ms / MS_PER_S
    hit = speeds_for(state, target_deg, duration_s, limits.ramp_deg_s2, limits.is_exact)
    hit = np.minimum(hit, limits.speed_max_deg_s)
    best = np.argmin(np.abs(hit - speed), axis=0), np.arange(len(speed))
    return wire[best], duration_ms[best], hit[best]


def durations_ms(
    start: States, target_deg: FloatArray, speed_deg_s: FloatArray, limits: LimitArrays
) -> FloatArray:
    """Return T for travel speeds: rounded, but never so that a move exceeds its speed limit."""
    speed = np.maximum(speed_deg_s, SPEED_LEAST_DEG_S)
    requested_s = durations_for(start, target_deg, speed, limits.ramp_deg_s2, limits.is_exact)
    duration_ms = np.rint(MS_PER_S * requested_s)
    np.minimum(duration_ms, DURATION_MAX_MS, out=duration_ms)
    np.maximum(duration_ms, DURATION_MIN_MS, out=duration_ms)
    away_deg = np.abs(target_deg - start.position_deg)
    duration_ms += away_deg * MS_PER_S > limits.speed_max_deg_s * duration_ms
    return duration_ms


def nearest_wires(wire: FloatArray, limits: LimitArrays) -> FloatArray:
    """Return the whole wire values nearest to `wire` inside the range of the joints."""
    whole: FloatArray = np.rint(wire)
    np.minimum(whole, limits.wire_max, out=whole)
    np.maximum(whole, limits.wire_min, out=whole)
    return whole


def nearest_wire(position_deg: float, limits: ServoLimits) -> int:
    """Return the wire value nearest to `position_deg` inside the joint's range."""
    per_deg = limits.wire_per_deg / limits.wire_step
    low = math.ceil(limits.position_min_deg * per_deg - 1e-6)
    high = math.floor(limits.position_max_deg * per_deg + 1e-6)
    return limits.wire_step * min(max(round(position_deg * per_deg), low), high)
