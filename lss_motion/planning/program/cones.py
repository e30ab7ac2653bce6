"""Which travel speeds keep profiles near their references, and for how long: *cones*, closed form.

A profile at `position`, `speed` that receives a move ramps to the travel speed of the move and
keeps it. Its position after `tau` grows with that speed, so each instant of the reference, widened
by the tolerance, allows an interval of speeds. The intersection of all intervals up to an instant
is the cone there.

The fit spends most of its time on cones, so their layout is made for speed: an instant a row and a
servo a column, so that an intersection reads memory in order; single precision, whose rounding
(1e-5 deg) is far below one wire unit; both sides at once, the upper one negated.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from msgspec import Struct

from lss_motion.planning.program.reference_grid import GRID_S

if TYPE_CHECKING:
    from lss_motion.planning.program.reference_grid import Points, References
    from lss_motion.planning.program.response import FloatArray, IntArray, SingleArray, States


Floats = TypeVar("Floats", "SingleArray", "FloatArray")

CONE_RATIO: Final = 0.98
"""The share of the tolerance that a cone uses; the rest is for the rounding of the wire."""
ROOM_RATIO: Final = 0.15
"""A profile at or beyond the edge of the tolerance gets this share of it as room. Without it, the
profile could not even stay in step with the reference."""
DIVISOR_LEAST: Final = np.float32(1e-20)
"""Turns an offset that no ramp reaches in time into a speed beyond all others, without a branch."""


class Cones(Struct, frozen=True):
    """The cones of some servos at some instants: `sides_deg_s` has shape (instants, 2, servos).

    Row `k` is `k` strides after the first grid instant that is not before the start. A side is the
    lowest travel speed, and the highest negated; both are relative to the speed at the start. Each
    cone is open for `held` rows; an empty cone stays empty.
    """

    sides_deg_s: SingleArray
    speed_deg_s: SingleArray
    held: IntArray

    def at(self, servos: IntArray, rows: IntArray) -> tuple[SingleArray, SingleArray]:
        """Return the lowest and the highest speed of some servos in `rows`, (any, servos).

        For a row in which the cone is empty, the last ones before.
        """
        known = np.maximum(np.minimum(rows, self.held[servos] - 1), 0)
        speed, count = self.speed_deg_s[servos], self.sides_deg_s.shape[2]
        flat = 2 * count * known + servos
        low, high = (self.sides_deg_s.take(flat + side * count) for side in (0, 1))
        return speed + low, speed - high


def ramped(
    position_deg: Floats,
    speed_deg_s: Floats,
    travel_deg_s: Floats,
    tau_s: Floats,
    ramp_deg_s2: Floats,
) -> tuple[Floats, Floats]:
    """Return position and speed after a ramp to `travel_deg_s` and a cruise, `tau_s` in all."""
    change = travel_deg_s - speed_deg_s
    ramp_s = np.minimum(np.abs(change) / ramp_deg_s2, tau_s)
    gained = np.copysign(ramp_deg_s2, change) * ramp_s
    position = position_deg + speed_deg_s * tau_s + gained * (tau_s - 0.5 * ramp_s)
    return position, speed_deg_s + gained


def excursion_deg(position_deg: SingleArray, speed_deg_s: SingleArray, at: Points) -> SingleArray:
    """Return the largest error of profiles until they are in step with their references again.

    `at` holds the points of their references, and the ramp that is left for corrections there.
    """
    error = position_deg - at.position_deg
    faster = speed_deg_s - at.speed_deg_s
    is_faster = faster > 0.0
    faster *= faster
    faster /= 2.0 * np.where(is_faster, at.down_deg_s2, at.up_deg_s2)
    faster += np.where(is_faster, error, -error)
    excursion: SingleArray = np.maximum(faster, np.abs(error, out=error), out=faster)
    return excursion


class Starts(Struct, frozen=True):
    """Profiles that receive a move `after_s` before the grid point `first` of their references.

    An array of one element stands for the same value for all.
    """

    joint: IntArray
    first: IntArray
    after_s: SingleArray
    position_deg: SingleArray
    speed_deg_s: SingleArray

    @classmethod
    def of(cls, references: References, joint: IntArray, first: IntArray, state: States) -> Starts:
        """Return those of servos in `state`; `first` is the first grid point not before it."""
        after_s = references.times_s(first) - state.time_s
        columns = after_s, state.position_deg, state.speed_deg_s
        return cls(joint, first, *(column.astype(np.float32) for column in columns))


def open_cones(references: References, starts: Starts, rows: int, stride: int, block: int) -> Cones:
    """Return the cones of profiles in so many rows.

    The rows are computed `block` by block, and only for the cones that are still open.
    """
    cones, count = _GrowingCones(references, starts), len(starts.joint)
    every = np.empty((rows, 2, count), dtype=np.float32)
    held = cones.fill(every[:block], 0, stride)
    some, still = np.arange(count), np.flatnonzero(held == block)
    for begin in range(block, rows, block):
        if not len(still):
            break
        some, cones = some[still], cones.after(every[begin - 1], some[still], still)
        sides = np.empty((block, 2, len(some)), dtype=np.float32)
        now_held = cones.fill(sides, begin, stride)
        every[begin : begin + block, :, some] = sides
        held[some] += now_held
        still = np.flatnonzero(now_held == block)
    return Cones(every, starts.speed_deg_s, held)


class _GrowingCones:
    """Cones under construction: where they begin, and the sides that they have reached."""

    def __init__(self, references: References, starts: Starts) -> None:
        self._references, self._joint, self._first = references, starts.joint, starts.first
        ramp, tolerance, speed_max = references.reach(starts.joint)
        position, speed, self._after_s = starts.position_deg, starts.speed_deg_s, starts.after_s
        off_deg = references.position_deg(starts.joint, starts.first) - position
        off_deg -= speed * self._after_s
        np.abs(off_deg, out=off_deg)
        room = np.maximum(off_deg + ROOM_RATIO * tolerance, CONE_RATIO * tolerance)
        self._columns = position, speed, room, ramp
        self._least = np.stack((-speed_max - speed, speed - speed_max))

    def after(self, sides: SingleArray, servos: IntArray, chosen: IntArray) -> _GrowingCones:
        """Return the `chosen` cones, whose `servos` have reached `sides`."""
        some = object.__new__(_GrowingCones)
        some._references = self._references
        some._joint, some._first = self._joint[chosen], self._first[chosen]
        some._after_s = np.broadcast_to(self._after_s, self._joint.shape)[chosen]
        position, speed, room, ramp = self._columns
        some._columns = position[chosen], speed[chosen], room[chosen], ramp[chosen]
        some._least = sides[:, servos]
        return some

    def fill(self, sides: SingleArray, begin: int, stride: int) -> IntArray:
        """Fill in `sides` from row `begin` on; return in how many of these rows cones are open."""
        (position, speed, room, ramp), rows = self._columns, len(sides)
        row = np.arange(begin, begin + rows, dtype=np.float32)
        tau = self._after_s + (GRID_S * stride * row)[:, None]
        offset = self._references.ahead_deg(self._joint, self._first + begin * stride, rows, stride)
        offset -= position
        offset -= speed * tau
        np.subtract(offset, room, out=sides[:, 0])
        np.subtract(-room, offset, out=sides[:, 1])
        _change(sides, tau, ramp)
        np.maximum(sides[0], self._least, out=sides[0])
        _intersect(sides)
        is_open = np.add(sides[:, 0], sides[:, 1], out=offset) <= 0.0
        held: IntArray = is_open.view(np.uint8).sum(axis=0, dtype=np.uint16).astype(np.intp)
        return held


def _intersect(sides: SingleArray) -> None:
    """Replace every row by the maximum of all rows up to it, block by block.

    Blocks need few numpy calls for many rows.
    """
    size = next(n for n in range(math.isqrt(len(sides)), 0, -1) if len(sides) % n == 0)
    blocks = sides.reshape(-1, size, *sides.shape[1:])
    for row in range(1, size):
        np.maximum(blocks[:, row], blocks[:, row - 1], out=blocks[:, row])
    for block, before in zip(blocks[1:], blocks, strict=False):
        np.maximum(block, before[-1], out=block)


def _change(offset_deg: SingleArray, tau_s: SingleArray, ramp_deg_s2: SingleArray) -> None:
    """Replace offsets after `tau`, relative to the unchanged motion, by changes of speed.

    A ramp to a change `c` lasts c/a, so the offset is c·tau - c²/(2a). An offset that no ramp
    reaches in that time has no root; the change becomes close to infinite, with the sign of the
    offset.
    """
    half_s = 0.5 * tau_s
    divisor = np.abs(offset_deg)
    divisor *= -0.5 / ramp_deg_s2
    divisor += (half_s * half_s)[:, None]
    with np.errstate(invalid="ignore"):
        np.sqrt(divisor, out=divisor)
    divisor += half_s[:, None]
    offset_deg /= np.fmax(divisor, DIVISOR_LEAST, out=divisor)


def reach_steps(references: References, starts: Starts, rows: int, stride: int) -> IntArray:
    """Return for how many grid steps one move of each profile can keep the tolerance."""
    return stride * open_cones(references, starts, rows, stride, rows).held
