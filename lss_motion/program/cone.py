"""Which travel speeds keep profiles near their courses, and for how long: *cones*, closed form.

A profile at `position`, `speed` that hears a move ramps to the move's travel speed and keeps it.
Its position after `tau` grows with that speed, so each instant of the course, widened by the
tolerance, allows an interval of speeds; the intersection of all up to an instant is the cone there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.course import GRID_S

if TYPE_CHECKING:
    from lss_motion.program.batch import FloatArray, IntArray, States
    from lss_motion.program.course import Courses, LimitArrays

CONE_RATIO: Final = 0.98
"""How much of the tolerance a cone uses; the rest is for what the wire rounds."""
ROOM_RATIO: Final = 0.15
"""A profile at or beyond the edge of the tolerance is given this share of it as room, or it could
not even stay in step with the course."""


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
    ramp = np.where(faster > 0.0, courses.down_deg_s2[flat], courses.up_deg_s2[flat])
    strays = error * np.sign(faster) + 0.5 * faster * faster / ramp
    excursion: FloatArray = np.maximum(strays, np.abs(error))
    return excursion


def opened(
    courses: Courses,
    joint: IntArray,
    state: States,
    limits: LimitArrays,
    steps: int,
    stride: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest travel speed, per start state (row) and grid step (column).

    Column 0 is the first grid instant not before the start. An empty cone has lowest above
    highest, and stays empty.
    """
    first = courses.first_index(state.time_s)
    index = first[:, None] + stride * np.arange(steps)
    tau = courses.times_s(first) - state.time_s
    tau = tau[:, None] + (GRID_S * stride) * np.arange(steps)
    position, speed = state.position_deg[:, None], state.speed_deg_s[:, None]
    offset = courses.position_deg[courses.flat(joint[:, None], index)]
    offset -= position + speed * tau
    room = np.abs(offset[:, :1]) + (ROOM_RATIO * limits.tolerance_deg)[:, None]
    tolerance = np.maximum(room, (CONE_RATIO * limits.tolerance_deg)[:, None])
    ramp = limits.ramp_deg_s2[:, None]
    lowest = _change_for(offset - tolerance, tau, ramp)
    highest = _change_for(offset + tolerance, tau, ramp)
    lowest += speed
    highest += speed
    np.maximum.accumulate(lowest, axis=1, out=lowest)
    np.minimum.accumulate(highest, axis=1, out=highest)
    most = limits.speed_max_deg_s[:, None]
    return np.maximum(lowest, -most, out=lowest), np.minimum(highest, most, out=highest)


def _change_for(offset_deg: FloatArray, tau_s: FloatArray, ramp_deg_s2: FloatArray) -> FloatArray:
    """Return the change of speed that is `offset_deg` off the unchanged course after `tau_s`.

    What no ramp reaches in that time is infinite, with the sign of the offset.
    """
    change = np.abs(offset_deg)
    change *= -2.0 / ramp_deg_s2
    change += tau_s * tau_s
    with np.errstate(invalid="ignore"):
        np.sqrt(change, out=change)
    np.subtract(tau_s, change, out=change)
    change *= ramp_deg_s2
    np.copyto(change, np.inf, where=np.isnan(change))
    return np.copysign(change, offset_deg, out=change)


def reach_s(
    courses: Courses,
    joint: IntArray,
    state: States,
    limits: LimitArrays,
    steps: int,
    stride: int,
) -> FloatArray:
    """Return, per start state, up to when one move can keep the tolerance."""
    lowest, highest = opened(courses, joint, state, limits, steps, stride)
    reach: FloatArray = state.time_s + GRID_S * stride * open_steps(lowest, highest)
    return reach


def open_steps(lowest: FloatArray, highest: FloatArray) -> IntArray:
    """Return for how many columns a cone is open: once empty it stays empty."""
    held: IntArray = np.count_nonzero(lowest <= highest, axis=1)
    return held
