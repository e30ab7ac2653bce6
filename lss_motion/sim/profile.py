"""The motion profiles of simulated servos.

The trapezoid of EM1 goes from any position and speed to a target, in closed form. The order classes
are the commands of the firmware to its motor; `Motion` is the state that the motor reports. Angles
are raw.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Literal, NamedTuple

from msgspec import Struct

TINY_S = 1e-9
"""Phases shorter than this are left out: one nanosecond, the resolution of an instant."""


TINY_DEG = 1e-12
"""A horn this near to its target has arrived: a phase over the rest takes under 1 ns."""


class ProfilePhase(NamedTuple):
    """A time of constant acceleration. `duration_s` is infinite in the last phase."""

    duration_s: float
    position_deg: float
    speed_deg_s: float
    accel_deg_s2: float

    def end(self) -> tuple[float, float]:
        """Return position and speed at the end."""
        duration_s = self.duration_s
        speed_deg_s = self.speed_deg_s + self.accel_deg_s2 * duration_s
        return (
            self.position_deg + 0.5 * (self.speed_deg_s + speed_deg_s) * duration_s,
            speed_deg_s,
        )


class Ramps(NamedTuple):
    """The limits that shape a profile: magnitudes above 0."""

    speed_deg_s: float
    accel_deg_s2: float
    decel_deg_s2: float


def rest_at(position_deg: float) -> ProfilePhase:
    return ProfilePhase(math.inf, position_deg, 0.0, 0.0)


def plan_stop(
    position_deg: float, speed_deg_s: float, decel_deg_s2: float
) -> tuple[list[ProfilePhase], float]:
    """Return the phase that brakes to rest (none at rest), and its final position."""
    if abs(speed_deg_s) < decel_deg_s2 * TINY_S:
        return [], position_deg
    brake = ProfilePhase(
        abs(speed_deg_s) / decel_deg_s2,
        position_deg,
        speed_deg_s,
        -math.copysign(decel_deg_s2, speed_deg_s),
    )
    return [brake], brake.end()[0]


def plan_move(
    position_deg: float, speed_deg_s: float, target_deg: float, ramps: Ramps
) -> list[ProfilePhase]:
    """Return the phases that end at rest exactly on `target_deg`.

    One that moves the wrong way, or too fast to stop in time, brakes to rest first and comes
    back. One above the travel speed slows down to it with `decel_deg_s2`.
    """
    away = target_deg - position_deg
    overshoots = speed_deg_s**2 > 2.0 * ramps.decel_deg_s2 * abs(away) * (1.0 + 1e-9)
    if speed_deg_s != 0.0 and (speed_deg_s * away < 0.0 or overshoots):
        phases, position_deg = plan_stop(position_deg, speed_deg_s, ramps.decel_deg_s2)
        speed_deg_s = 0.0
    else:
        phases = []
    away_deg = target_deg - position_deg
    if abs(away_deg) > TINY_DEG:
        sign = 1.0 if away_deg > 0.0 else -1.0
        towards_deg_s = abs(speed_deg_s)
        stretches = _trapezoid(abs(away_deg), towards_deg_s, ramps)
        speed_deg_s = sign * towards_deg_s
        for duration_s, accel_deg_s2 in stretches:
            if duration_s > TINY_S:
                phase = ProfilePhase(duration_s, position_deg, speed_deg_s, sign * accel_deg_s2)
                phases.append(phase)
                position_deg, speed_deg_s = phase.end()
    phases.append(rest_at(target_deg))
    return phases


def plan_wheel(
    position_deg: float, speed_deg_s: float, target_deg_s: float, ramps: Ramps
) -> list[ProfilePhase]:
    """Return the phases that reach `target_deg_s` and keep it for ever."""
    phases: list[ProfilePhase] = []
    if speed_deg_s * target_deg_s < 0.0:
        phases, position_deg = plan_stop(position_deg, speed_deg_s, ramps.decel_deg_s2)
        speed_deg_s = 0.0
    faster = abs(target_deg_s) > abs(speed_deg_s)
    rate_deg_s2 = ramps.accel_deg_s2 if faster else ramps.decel_deg_s2
    change_deg_s = target_deg_s - speed_deg_s
    if abs(change_deg_s) > rate_deg_s2 * TINY_S:
        ramp = ProfilePhase(
            abs(change_deg_s) / rate_deg_s2,
            position_deg,
            speed_deg_s,
            math.copysign(rate_deg_s2, change_deg_s),
        )
        phases.append(ramp)
        position_deg = ramp.end()[0]
    phases.append(ProfilePhase(math.inf, position_deg, target_deg_s, 0.0))
    return phases


def travel_speed_deg_s(
    distance_deg: float,
    duration_s: float,
    speed_deg_s: float,
    ramps: Ramps,
    t_law: Literal["cruise", "exact"],
) -> float:
    """Return the travel speed that T requires, at most `ramps.speed_deg_s`.

    `speed_deg_s` is the present speed towards the target; it counts for `exact` only.
    """
    if t_law == "cruise":
        asked_deg_s = distance_deg / duration_s
    else:
        asked_deg_s = _exact_speed_deg_s(distance_deg, duration_s, max(speed_deg_s, 0.0), ramps)
    return min(asked_deg_s, ramps.speed_deg_s)


def _exact_speed_deg_s(
    distance_deg: float, duration_s: float, speed_deg_s: float, ramps: Ramps
) -> float:
    """Return the travel speed of the trapezoid that lasts `duration_s`, infinite if none does.

    The ramps cost (c - v)²/2a and c²/2d of the distance that c would make alone.
    """
    accel, decel = ramps.accel_deg_s2, ramps.decel_deg_s2
    slowing = duration_s - speed_deg_s / decel
    if slowing > 0.0:
        slower = (distance_deg - speed_deg_s**2 / (2.0 * decel)) / slowing
        if 0.0 < slower <= speed_deg_s:
            return slower
    square = 0.5 / accel + 0.5 / decel
    linear = duration_s + speed_deg_s / accel
    constant = distance_deg + speed_deg_s**2 / (2.0 * accel)
    discriminant = linear**2 - 4.0 * square * constant
    return math.inf if discriminant < 0.0 else (linear - math.sqrt(discriminant)) / (2.0 * square)


def _trapezoid(distance_deg: float, speed_deg_s: float, ramps: Ramps) -> list[tuple[float, float]]:
    """Return (duration, acceleration) of up to three phases over a distance ahead."""
    cruise_deg_s, accel, decel = ramps
    if speed_deg_s > cruise_deg_s:
        first_accel, first_rate = -decel, decel
        peak = cruise_deg_s
    else:
        first_accel, first_rate = accel, accel
        reach = (2.0 * decel * distance_deg * accel + decel * speed_deg_s**2) / (accel + decel)
        peak = min(cruise_deg_s, math.sqrt(max(reach, 0.0)))
        peak = max(peak, speed_deg_s)
    ramp_s = abs(peak - speed_deg_s) / first_rate
    ramps_deg = abs(peak**2 - speed_deg_s**2) / (2.0 * first_rate) + peak**2 / (2.0 * decel)
    cruised_deg = distance_deg - ramps_deg
    cruise_s = cruised_deg / peak if cruised_deg > 0.0 < peak else 0.0
    return [(ramp_s, first_accel), (cruise_s, 0.0), (peak / decel, -decel)]


class Motion(IntEnum):
    """The state of a servo; the values are the status codes of LSS (FACTS.md S1)."""

    LIMP = 1
    FREE_MOVING = 2
    ACCELERATING = 3
    TRAVELING = 4
    DECELERATING = 5
    HOLDING = 6
    OUTSIDE_LIMITS = 7
    STUCK = 8
    BLOCKED = 9
    SAFE_MODE = 10


class SafeCause(IntEnum):
    """Why a servo is in safe mode; the values are the answers to Q1 (FACTS.md S5)."""

    NONE = 0
    CURRENT = 1
    VOLTAGE = 2
    TEMPERATURE = 3


class ProfileMove(Struct, frozen=True):
    """Go to `target_deg` by the profile, in `duration_s` or at the travel speed of `ramps`."""

    target_deg: float
    ramps: Ramps
    duration_s: float | None = None


class FilterMove(Struct, frozen=True):
    """Go to `target_deg` through the EM0 filter.

    With `is_repeated` (IPE) the filter steps by itself every 20 ms, without once an order.
    """

    target_deg: float
    filter_count: int
    is_repeated: bool


class Wheel(Struct, frozen=True):
    """Turn for ever; without ramps (EM0) at full speed from one control loop to the next.

    `is_free`: a share of the motor's power and nothing that controls it (RDM).
    """

    speed_deg_s: float
    ramps: Ramps | None
    is_free: bool = False


class Halt(Struct, frozen=True):
    """Stop the profile at once where it is, and hold; the horn closes up within its lag."""


class PowerOff(Struct, frozen=True):
    """Take the power off. Friction keeps the horn where it is."""


Order = ProfileMove | FilterMove | Wheel | Halt | PowerOff
