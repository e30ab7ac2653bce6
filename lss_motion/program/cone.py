"""Which travel speeds keep profiles near their courses, and for how long: *cones*, closed form.

A profile at `position`, `speed` that hears a move ramps to the move's travel speed and keeps it.
Its position after `tau` grows with that speed, so each instant of the course, widened by the
tolerance, allows an interval of speeds; the intersection of all up to an instant is the cone there.

Cones are what fitting spends its time on, so they are laid out for it: an instant a row and a
servo a column, so that intersecting goes through memory in order; in single precision, whose
rounding (1e-5 deg) is far below what the wire can say; both sides at once, the upper one negated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.course import GRID_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.program.batch import FloatArray, IntArray, States
    from lss_motion.program.course import Courses, LimitArrays

    SingleArray = NDArray[np.float32]

CONE_RATIO: Final = 0.98
"""How much of the tolerance a cone uses; the rest is for what the wire rounds."""
ROOM_RATIO: Final = 0.15
"""A profile at or beyond the edge of the tolerance is given this share of it as room, or it could
not even stay in step with the course."""
UNREACHED: Final = np.float32(1e20)
"""Makes what no ramp reaches in time a change of speed beyond all others, without a branch."""
DIVISOR_LEAST: Final = np.float32(1e-20)


@dataclass(frozen=True, slots=True)
class Cones:
    """The cones of some servos at some instants: `sides_deg_s` has shape (instants, 2, servos).

    Row `k` is `k` strides after the first grid instant that is not before the start. A side is the
    lowest travel speed, and the highest negated.
    """

    sides_deg_s: SingleArray
    stride: int

    @property
    def held(self) -> IntArray:
        """For how many rows each cone is open: once empty it stays empty."""
        is_open = self.sides_deg_s[:, 0] + self.sides_deg_s[:, 1] <= 0.0
        held: IntArray = is_open.sum(axis=0, dtype=np.intp)
        return held

    def at(self, servos: IntArray, steps: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest speed of some servos after `steps`, (servos, any)."""
        row = np.minimum(-(-steps // self.stride), len(self.sides_deg_s) - 1)
        low = self.sides_deg_s[row, 0, servos[:, None]].astype(np.float64)
        return low, -self.sides_deg_s[row, 1, servos[:, None]].astype(np.float64)


def ramped(
    position_deg: FloatArray,
    speed_deg_s: FloatArray,
    travel_deg_s: FloatArray,
    tau_s: FloatArray,
    ramp_deg_s2: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return position and speed after `tau_s` of ramping to, then keeping, `travel_deg_s`."""
    change = travel_deg_s - speed_deg_s
    ramp_s = np.minimum(np.abs(change) / ramp_deg_s2, tau_s)
    gained = np.copysign(ramp_deg_s2, change) * ramp_s
    position = position_deg + speed_deg_s * tau_s + gained * (tau_s - 0.5 * ramp_s)
    return position, speed_deg_s + gained


def excursion_deg(
    courses: Courses,
    flat: IntArray,
    position_deg: FloatArray,
    speed_deg_s: FloatArray,
) -> FloatArray:
    """Return how far profiles stray before they are in step with their courses again.

    They are at `position_deg`, `speed_deg_s` at the grid points `flat`, and have the ramp that the
    course leaves them.
    """
    error = position_deg - courses.position_deg[flat]
    faster = speed_deg_s - courses.speed_deg_s[flat]
    is_faster = faster > 0.0
    ramp = np.where(is_faster, courses.down_deg_s2[flat], courses.up_deg_s2[flat])
    faster *= faster
    faster /= 2.0 * ramp
    faster += np.where(is_faster, error, -error)
    excursion: FloatArray = np.maximum(faster, np.abs(error, out=error), out=faster)
    return excursion


def opened(
    courses: Courses,
    joint: IntArray,
    state: States,
    limits: LimitArrays,
    steps: int,
    stride: int = 1,
) -> Cones:
    """Return the cones of profiles that hear a move in `state`, at so many grid instants."""
    first = courses.first_index(state.time_s)
    after_s = (courses.times_s(first) - state.time_s).astype(np.float32)
    tau = after_s + (GRID_S * stride * np.arange(steps, dtype=np.float32))[:, None]
    offset = courses.ahead_deg(joint, first, steps, stride)
    offset -= state.position_deg.astype(np.float32)
    speed = state.speed_deg_s.astype(np.float32)
    offset -= speed * tau
    room = np.abs(offset[0]) + ROOM_RATIO * limits.tolerance_deg
    tolerance = np.maximum(room, CONE_RATIO * limits.tolerance_deg).astype(np.float32)
    sides = np.empty((steps, 2, len(joint)), dtype=np.float32)
    np.subtract(offset, tolerance, out=sides[:, 0])
    np.negative(offset, out=offset)
    np.subtract(offset, tolerance, out=sides[:, 1])
    _change(sides, tau, limits.ramp_deg_s2.astype(np.float32))
    sides[:, 0] += speed
    sides[:, 1] -= speed
    np.maximum(sides[0], -limits.speed_max_deg_s.astype(np.float32), out=sides[0])
    _intersect(sides)
    return Cones(sides, stride)


def _intersect(sides: SingleArray) -> None:
    """Let every row be the highest up to it: block by block, in few steps for many rows."""
    size = next(n for n in range(math.isqrt(len(sides)), 0, -1) if len(sides) % n == 0)
    blocks = sides.reshape(-1, size, *sides.shape[1:])
    for row in range(1, size):
        np.maximum(blocks[:, row], blocks[:, row - 1], out=blocks[:, row])
    for block, before in zip(blocks[1:], blocks, strict=False):
        np.maximum(block, before[-1], out=block)


def _change(offset_deg: SingleArray, tau_s: SingleArray, ramp_deg_s2: SingleArray) -> None:
    """Replace offsets by the changes of speed that are so far off the unchanged course after `tau`.

    A ramp to a change `c` lasts c/a, so that the offset is c·tau - c²/(2a). What no ramp reaches in
    that time is next to infinite, with the sign of the offset.
    """
    spare = np.abs(offset_deg)
    spare *= -2.0 / ramp_deg_s2
    spare += (tau_s * tau_s)[:, None]
    divisor = np.minimum(spare, 0.0)
    divisor *= UNREACHED
    np.maximum(spare, 0.0, out=spare)
    np.sqrt(spare, out=spare)
    divisor += spare
    divisor += tau_s[:, None]
    np.maximum(divisor, DIVISOR_LEAST, out=divisor)
    offset_deg *= 2.0
    offset_deg /= divisor


def reach_s(
    courses: Courses,
    joint: IntArray,
    state: States,
    limits: LimitArrays,
    steps: int,
    stride: int,
) -> FloatArray:
    """Return, per start state, up to when one move can keep the tolerance."""
    cones = opened(courses, joint, state, limits, steps, stride)
    reach: FloatArray = state.time_s + GRID_S * stride * cones.held
    return reach
