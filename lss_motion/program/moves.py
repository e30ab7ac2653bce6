"""Fitted moves as arrays, and the profiles that they make."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.batch import States, Trapezoids, trapezoids
from lss_motion.program.response import Reference
from lss_motion.program.wording import lattice

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.program.batch import FloatArray, Index, IntArray
    from lss_motion.program.course import Course, LimitArrays, ServoLimits
    from lss_motion.program.response import Profile

JOINED_DEG: Final = 1e-6
"""A move starts where its predecessor has brought the profile, up to rounding errors."""


@dataclass(frozen=True, slots=True)
class FittedMove:
    """Move to `target_wire` in `duration_ms` (None: a bare `D`), heard at `heard_s`."""

    heard_s: float
    target_wire: int
    duration_ms: int | None


@dataclass(frozen=True, slots=True)
class Moves:
    """Moves to `target_wire` in `duration_ms`, and what the profile does when one is heard."""

    joint: IntArray
    heard_s: FloatArray
    target_wire: FloatArray
    duration_ms: FloatArray
    travel_deg_s: FloatArray
    position_deg: FloatArray
    speed_deg_s: FloatArray

    def take(self, chosen: Index) -> Moves:
        return Moves(
            self.joint[chosen],
            self.heard_s[chosen],
            self.target_wire[chosen],
            self.duration_ms[chosen],
            self.travel_deg_s[chosen],
            self.position_deg[chosen],
            self.speed_deg_s[chosen],
        )

    def of(self, joint: int) -> Moves:
        """Return the moves of one joint, if they are in order."""
        low, high = np.searchsorted(self.joint, (joint, joint + 1))
        return self.take(slice(int(low), int(high)))

    def __len__(self) -> int:
        return len(self.joint)

    def trapezoids(self, limits: LimitArrays) -> Trapezoids:
        """Return what each move does if no other is heard."""
        states = States(self.heard_s, self.position_deg, self.speed_deg_s)
        own = limits.take(self.joint)
        target_deg = self.target_wire / own.wire_per_deg
        return trapezoids(states, target_deg, self.travel_deg_s, own.ramp_deg_s2)


def in_order(parts: Sequence[Moves]) -> Moves:
    """Return the moves by joint, and of each joint by time."""
    names = Moves.__slots__
    whole = Moves(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    return whole.take(np.lexsort((whole.heard_s, whole.joint)))


def unjoined(moves: Moves, limits: LimitArrays) -> IntArray:
    """Return the indices of moves that do not start where their predecessors end."""
    if len(moves) < 2:
        return np.zeros(0, dtype=np.intp)
    before = moves.take(slice(None, -1)).trapezoids(limits)
    reached = before.at(np.maximum(moves.heard_s[1:], moves.heard_s[:-1]))
    apart = np.abs(reached.position_deg - moves.position_deg[1:]) > JOINED_DEG
    apart &= moves.joint[1:] == moves.joint[:-1]
    found: IntArray = 1 + np.flatnonzero(apart)
    return found


@dataclass(frozen=True, slots=True)
class Begin:
    """What a servo does before its course begins.

    `first_s` is when it must hear its first move at the latest; None if it stands.
    """

    profile: Profile
    first_s: float | None = None


def reference(
    moves: Moves, joint: int, course: Course, limits: ServoLimits, begin: Begin | None = None
) -> Reference:
    """Return the profile that the moves of one joint make of its course."""
    own = moves.of(joint)
    if begin is not None:
        before = Reference(begin.profile.pieces())
        made = Reference.of(_table(own, limits))
        return before.followed_by(made, float("-inf")) if len(own) else before
    begin_deg = lattice(float(course.position_deg[0]), limits) / limits.wire_per_deg
    first = (float("-inf"), begin_deg, 0.0, 0.0)
    table = _table(own, limits)
    return Reference.of(tuple(np.append(v, column) for v, column in zip(first, table, strict=True)))


def _table(own: Moves, limits: ServoLimits) -> tuple[FloatArray, ...]:
    """Return the pieces of a profile, each until the next one: see `Reference.table`."""
    states = States(own.heard_s, own.position_deg, own.speed_deg_s)
    ramp, target_deg = limits.ramp_deg_s2, own.target_wire / limits.wire_per_deg
    made = trapezoids(states, target_deg, own.travel_deg_s, np.full_like(target_deg, ramp))
    ramped_s = own.heard_s + made.first_s
    starts = np.stack([own.heard_s, ramped_s, ramped_s + made.cruise_s, made.end_s], axis=1)
    still, peak = np.zeros_like(target_deg), made.sign * made.peak_deg_s
    braking_deg = target_deg - 0.5 * peak * made.peak_deg_s / ramp
    cruising_deg = braking_deg - peak * made.cruise_s
    accel = made.sign * np.copysign(ramp, made.peak_deg_s - made.first_deg_s)
    until_s = np.append(own.heard_s[1:], np.inf)[:, None]
    is_there = starts < until_s
    is_there[:, :3] &= starts[:, 1:] > starts[:, :3]
    columns = (
        starts,
        np.stack([own.position_deg, cruising_deg, braking_deg, target_deg], axis=1),
        np.stack([own.speed_deg_s, peak, peak, still], axis=1),
        np.stack([accel, still, -made.sign * ramp, still], axis=1),
    )
    return tuple(column[is_there] for column in columns)
