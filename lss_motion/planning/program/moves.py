"""Fitted moves as arrays, and the profiles that they make.

`FittedMoves` are timed moves of all joints with the state in which each servo receives them. A
`Setpoint` is a bare `D` of a streamed or stepped joint. Both count the instants at which a servo
receives them; `model.Move` is the command of a finished program, with the instant at which it is
sent. `quantized` rounds to what the wire carries: targets on a lattice, T in whole ms.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct

from lss_motion.planning.program.cones import ramped
from lss_motion.planning.program.reference_grid import DURATION_MAX_MS, LimitArrays
from lss_motion.planning.program.response import (
    PiecewiseProfile,
    States,
    Trapezoids,
    durations_for,
    speeds_for,
    trapezoids,
)
from lss_motion.robot.profile import DURATION_MIN_MS
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.planning.program.reference_grid import Reference, ServoLimits
    from lss_motion.planning.program.response import FloatArray, Index, IntArray
    from lss_motion.robot.profile import Profile

JOINED_DEG: Final = 1e-6
"""A move starts where its predecessor has brought the profile, up to rounding errors."""


class Setpoint(NamedTuple):
    """A bare `D` to `target_wire` that the servo receives at `received_s`."""

    received_s: float
    target_wire: int


class FittedJoint(Struct, frozen=True):
    """The moves of one joint in order, and the profile they make. A T of NaN is a bare `D`."""

    received_s: FloatArray
    target_wire: FloatArray
    duration_ms: FloatArray
    profile: PiecewiseProfile


class FittedMoves(Struct, frozen=True):
    """Timed moves to `target_wire` in `duration_ms`, and the profile's state at their receipt."""

    joint: IntArray
    received_s: FloatArray
    target_wire: FloatArray
    duration_ms: FloatArray
    travel_deg_s: FloatArray
    position_deg: FloatArray
    speed_deg_s: FloatArray

    def take(self, chosen: Index) -> FittedMoves:
        return FittedMoves(
            self.joint[chosen],
            self.received_s[chosen],
            self.target_wire[chosen],
            self.duration_ms[chosen],
            self.travel_deg_s[chosen],
            self.position_deg[chosen],
            self.speed_deg_s[chosen],
        )

    def of(self, joint: int) -> FittedMoves:
        """Return the moves of one joint; the moves must be in order of the joints."""
        low, high = np.searchsorted(self.joint, (joint, joint + 1))
        return self.take(slice(int(low), int(high)))

    def __len__(self) -> int:
        return len(self.joint)

    def trapezoids(self, limits: LimitArrays) -> Trapezoids:
        """Return the motion of each move if the servo receives no other."""
        states = States(self.received_s, self.position_deg, self.speed_deg_s)
        own = limits.take(self.joint)
        target_deg = self.target_wire / own.wire_per_deg
        return trapezoids(states, target_deg, self.travel_deg_s, own.ramp_deg_s2)


def no_moves() -> FittedMoves:
    """Return no moves."""
    none = np.zeros(0)
    return FittedMoves(
        np.zeros(0, dtype=np.intp), *(none,) * (len(FittedMoves.__struct_fields__) - 1)
    )


def concatenated(parts: Sequence[FittedMoves]) -> FittedMoves:
    """Return all moves, one part after the other."""
    names = FittedMoves.__struct_fields__
    return FittedMoves(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def discontinuities(moves: FittedMoves, limits: LimitArrays) -> IntArray:
    """Return the indices of moves that do not start where their predecessors end."""
    if len(moves) < 2:
        return np.zeros(0, dtype=np.intp)
    before = moves.take(slice(None, -1)).trapezoids(limits)
    reached = before.at(np.maximum(moves.received_s[1:], moves.received_s[:-1]))
    apart = np.abs(reached.position_deg - moves.position_deg[1:]) > JOINED_DEG
    apart &= moves.joint[1:] == moves.joint[:-1]
    found: IntArray = 1 + np.flatnonzero(apart)
    return found


def replayed(
    joint: IntArray,
    received_s: FloatArray,
    target_wire: FloatArray,
    duration_ms: FloatArray,
    begin_deg: FloatArray,
    limits: LimitArrays,
) -> FittedMoves:
    """Return the motion of profiles that receive these commands, from the wire values alone.

    Moves are ordered by joint and time; `begin_deg` and `limits` are by joint. A duration of NaN is
    a bare `D`. The states found do not depend on what the fit assumed: the verifier rests on this.
    """
    own, target_deg = limits.take(joint), target_wire / limits.wire_per_deg[joint]
    same = np.append(joint[1:] == joint[:-1], False) if len(joint) else np.zeros(0, dtype=bool)
    is_first = ~np.roll(same, 1)
    position = np.where(is_first, begin_deg[joint], np.roll(target_deg, 1))
    speed, travel = np.zeros(len(joint)), np.full(len(joint), np.nan)
    # Chains advance side by side, each from a move whose servo seems to be at rest. Where it is
    # not at rest, the chain before continues through that move, until no state changes.
    is_guessed = np.roll(duration_ms, 1) <= MS_PER_S * np.diff(received_s, prepend=0.0)
    at = np.flatnonzero(is_first | is_guessed)
    while len(at):
        start = States(received_s[at], position[at], speed[at])
        travel[at] = _travel(start, target_deg[at], duration_ms[at], own.take(at))
        at = at[same[at]]
        start, after = States(received_s[at], position[at], speed[at]), at + 1
        moves = trapezoids(start, target_deg[at], travel[at], own.ramp_deg_s2[at])
        reached = moves.at(received_s[after])
        rests = received_s[after] >= moves.end_s
        position_deg = np.where(rests, target_deg[at], reached.position_deg)
        speed_deg_s = np.where(rests | own.forgets_speed[at], 0.0, reached.speed_deg_s)
        is_known = (position[after] == position_deg) & (speed[after] == speed_deg_s)
        is_known &= ~np.isnan(travel[after])
        position[after], speed[after] = position_deg, speed_deg_s
        at = after[~is_known]
    return FittedMoves(joint, received_s, target_wire, duration_ms, travel, position, speed)


def _travel(
    start: States, target_deg: FloatArray, duration_ms: FloatArray, limits: LimitArrays
) -> FloatArray:
    """Return the travel speeds that servos take, as `response.Profile.retarget` does."""
    is_bare = np.isnan(duration_ms) | (target_deg == start.position_deg)
    duration_s = np.where(is_bare, 1.0, duration_ms) / MS_PER_S
    requested = speeds_for(start, target_deg, duration_s, limits.ramp_deg_s2, limits.is_exact)
    most = limits.speed_max_deg_s
    travel: FloatArray = np.where(is_bare, most, np.minimum(requested, most))
    return travel


class InitialMotion(Struct, frozen=True):
    """The motion of a servo before its reference begins.

    `first_s` is the latest instant at which it must receive its first move; None if it stands.
    """

    profile: Profile
    first_s: float | None = None


def fitted_profiles(
    moves: FittedMoves,
    references: Sequence[Reference],
    limits: Sequence[ServoLimits],
    initial: Sequence[InitialMotion] = (),
) -> list[PiecewiseProfile]:
    """Return the profiles that moves make, one a reference."""
    if not initial:
        firsts = zip(references, limits, strict=True)
        wires = [nearest_wire(float(one.position_deg[0]), limit) for one, limit in firsts]
        per_deg = [limit.wire_per_deg for limit in limits]
        return profiles_from_rest(moves, limits, np.array(wires) / per_deg)
    found = []
    for motion, table in zip(initial, _pieces(moves, limits), strict=True):
        before = PiecewiseProfile(motion.profile.pieces())
        made = PiecewiseProfile.of(table)
        found.append(before.followed_by(made, float("-inf")) if len(table[0]) else before)
    return found


def profiles_from_rest(
    moves: FittedMoves, limits: Sequence[ServoLimits], begins_deg: FloatArray
) -> list[PiecewiseProfile]:
    """Return the profiles that moves make of servos that stand at `begins_deg`, one a joint."""
    found = []
    for begin_deg, table in zip(begins_deg, _pieces(moves, limits), strict=True):
        first = (float("-inf"), begin_deg, 0.0, 0.0)
        columns = zip(first, table, strict=True)
        found.append(
            PiecewiseProfile.of(tuple(np.append(value, column) for value, column in columns))
        )
    return found


def _pieces(moves: FittedMoves, limits: Sequence[ServoLimits]) -> list[tuple[FloatArray, ...]]:
    """Return the pieces of each joint's profile, as `PiecewiseProfile.table`."""
    own = LimitArrays(limits).take(moves.joint)
    ramp, target_deg = own.ramp_deg_s2, moves.target_wire / own.wire_per_deg
    states = States(moves.received_s, moves.position_deg, moves.speed_deg_s)
    made = trapezoids(states, target_deg, moves.travel_deg_s, ramp)
    ramped_s = moves.received_s + made.first_s
    starts_s = (moves.received_s, ramped_s, ramped_s + made.cruise_s, made.end_s)
    ends = np.searchsorted(moves.joint, np.arange(len(limits)), side="right")
    until_s = np.append(moves.received_s[1:], np.inf)[: len(moves)]
    until_s[ends[ends > 0] - 1] = np.inf
    is_there = np.empty((len(moves), len(starts_s)), dtype=bool)
    for piece, (start_s, end_s) in enumerate(pairwise((*starts_s, until_s))):
        is_there[:, piece] = start_s < until_s
        if piece < len(starts_s) - 1:
            is_there[:, piece] &= start_s < end_s
    still, peak = np.zeros_like(target_deg), made.sign * made.peak_deg_s
    braking_deg = target_deg - 0.5 * peak * made.peak_deg_s / ramp
    accel = made.sign * np.copysign(ramp, made.peak_deg_s - made.first_deg_s)
    columns = (
        starts_s,
        (moves.position_deg, braking_deg - peak * made.cruise_s, braking_deg, target_deg),
        (moves.speed_deg_s, peak, peak, still),
        (accel, still, -made.sign * ramp, still),
    )
    edges = np.append(0, np.cumsum(is_there.sum(axis=1)))[ends][:-1]
    chosen = np.flatnonzero(is_there)
    every = (np.stack(column, axis=1).take(chosen) for column in columns)
    return list(zip(*(np.split(column, edges) for column in every), strict=True))


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
    away_deg = np.abs(target_deg - start.position_deg)
    least_ms = np.ceil(away_deg * MS_PER_S / limits.speed_max_deg_s)
    np.maximum(duration_ms, np.maximum(least_ms, DURATION_MIN_MS), out=duration_ms)
    np.minimum(duration_ms, DURATION_MAX_MS, out=duration_ms)
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


def standing_wire(position_deg: float, limits: ServoLimits) -> int:
    """Return the wire value of a servo that was sent to an angle, or stands there by itself.

    It is inside the joint's range if the angle is.
    """
    if limits.position_min_deg - 1e-6 <= position_deg <= limits.position_max_deg + 1e-6:
        return nearest_wire(position_deg, limits)
    return limits.wire_step * round(position_deg * limits.wire_per_deg / limits.wire_step)
