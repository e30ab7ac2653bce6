"""Which travel speeds keep a profile near its course, and for how long: the *cone*, closed form.

A profile at `position`, `speed` that hears a move ramps to the move's travel speed and keeps it.
Its position after `tau` grows with that speed, so each instant of the course, widened by the
tolerance, allows an interval of speeds; the intersection of all up to an instant is the cone there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.robot.model import Response

    FloatArray = NDArray[np.float64]

GRID_S: Final = 0.005
"""Step of the course. At 1000 deg/s² the course bends 3 thousandths of a degree within it, and
1 ms steps save no command that is worth five times the work (performance.md, section C)."""
REST_MIN_S: Final = 0.02
"""A standstill shorter than this is travelled through."""
CONE_RATIO: Final = 0.98
"""How much of the tolerance a cone uses; the rest is for what the wire rounds."""
ROOM_RATIO: Final = 0.15
"""A profile at or beyond the edge of the tolerance is given this share of it as room, or it could
not even stay in step with the course."""
AUTHORITY_STEPS: Final = 24
"""Over so many grid steps ahead the course must leave ramp to spare for a correction."""
AUTHORITY_LEAST_RATIO: Final = 0.01
"""A course at its limit leaves no ramp at all; this keeps the division finite."""
DURATION_MAX_MS: Final = 9_999
"""The largest T sent. The documents name no limit; with four digits a move keeps to the 15
characters that an LSS-2IO on the bus can bear (lss_facts 3)."""
STILL_DEG: Final = 1e-7
"""Less than this between two grid steps is standing still."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """What the profile of one servo should do: positions every `GRID_S` from `start_s` on."""

    start_s: float
    position_deg: FloatArray

    @property
    def end_s(self) -> float:
        return self.time_s(len(self.position_deg) - 1)

    def time_s(self, index: int) -> float:
        return self.start_s + GRID_S * index

    def times_s(self, index: NDArray[np.intp]) -> FloatArray:
        times: FloatArray = self.start_s + GRID_S * index.astype(np.float64)
        return times

    def index(self, time_s: float) -> int:
        """Return the first index whose instant is not before `time_s`, inside the course."""
        index = int(np.ceil((time_s - self.start_s) / GRID_S - 1e-9))
        return min(max(index, 0), len(self.position_deg) - 1)

    def speed_deg_s(self, index: NDArray[np.intp]) -> FloatArray:
        """Return the speed at grid points, by central differences; at rest beyond the end."""
        index = np.minimum(index, len(self.position_deg) - 1)
        low = np.maximum(index - 1, 0)
        high = np.minimum(index + 1, len(self.position_deg) - 1)
        span_s = GRID_S * np.maximum(high - low, 1)
        speed: FloatArray = (self.position_deg[high] - self.position_deg[low]) / span_s
        return speed

    def bends(self, accel_deg_s2: float) -> NDArray[np.intp]:
        """Return the grid points at which the acceleration jumps by `accel_deg_s2` or more."""
        accel = np.diff(self.position_deg, 2, prepend=self.position_deg[:1], append=0.0)[:-1]
        jump = np.abs(np.diff(accel, prepend=0.0))
        found: NDArray[np.intp] = np.flatnonzero(jump > accel_deg_s2 * GRID_S * GRID_S)
        return found

    def rests(self) -> list[tuple[int, int]]:
        """Return `(first, last)` index of every standstill."""
        still = np.abs(np.diff(self.position_deg)) < STILL_DEG
        edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(np.int8), [0]))))
        least = round(REST_MIN_S / GRID_S)
        spans = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return [span for span in spans if span[1] - span[0] >= least]


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoLimits:
    """What a move may ask of one servo, in servo degrees, and the lattice of its targets."""

    position_min_deg: float
    position_max_deg: float
    speed_max_deg_s: float
    ramp_deg_s2: float
    wire_per_deg: int
    tolerance_deg: float
    response: Response
    wire_step: int = 1


def ramped(
    position_deg: FloatArray | float,
    speed_deg_s: FloatArray | float,
    travel_deg_s: FloatArray | float,
    tau_s: FloatArray | float,
    ramp_deg_s2: float,
) -> tuple[FloatArray, FloatArray]:
    """Return position and speed after `tau_s` of ramping to, then keeping, `travel_deg_s`."""
    change = np.asarray(travel_deg_s, dtype=np.float64) - speed_deg_s
    ramp_s = np.minimum(np.abs(change) / ramp_deg_s2, tau_s)
    gained = np.sign(change) * ramp_deg_s2 * ramp_s
    position = position_deg + speed_deg_s * np.asarray(tau_s) + gained * (tau_s - 0.5 * ramp_s)
    return position, speed_deg_s + gained


def change_for(offset_deg: FloatArray, tau_s: FloatArray, ramp_deg_s2: float) -> FloatArray:
    """Return the change of speed that is `offset_deg` off the unchanged course after `tau_s`.

    What no ramp reaches in that time is infinite, with the sign of the offset.
    """
    root = tau_s * tau_s - 2.0 * np.abs(offset_deg) / ramp_deg_s2
    reachable = ramp_deg_s2 * (tau_s - np.sqrt(np.maximum(root, 0.0)))
    change: FloatArray = np.sign(offset_deg) * np.where(root >= 0.0, reachable, np.inf)
    return change


class Cones:
    """The cones of one course under one servo's limits."""

    def __init__(self, course: Course, limits: ServoLimits) -> None:
        self.course = course
        self.limits = limits
        grid = course.position_deg
        accel = np.diff(grid, 2, prepend=grid[:1], append=grid[-1:]) / (GRID_S * GRID_S)
        padded = np.pad(accel, (0, AUTHORITY_STEPS - 1), mode="edge")
        ahead = np.lib.stride_tricks.sliding_window_view(padded, AUTHORITY_STEPS)
        least = AUTHORITY_LEAST_RATIO * limits.ramp_deg_s2
        self._up_deg_s2 = np.maximum(limits.ramp_deg_s2 - ahead.max(axis=1), least)
        self._down_deg_s2 = np.maximum(limits.ramp_deg_s2 + ahead.min(axis=1), least)

    def excursion_deg(
        self, index: NDArray[np.intp], positions_deg: FloatArray, speeds_deg_s: FloatArray
    ) -> FloatArray:
        """Return how far profiles stray before they are in step with the course again.

        They are at `positions_deg`, `speeds_deg_s` at the grid points `index`, and have the ramp
        that the course leaves them.
        """
        index = np.minimum(index, len(self.course.position_deg) - 1)
        error = positions_deg - self.course.position_deg[index]
        faster = speeds_deg_s - self.course.speed_deg_s(index)
        ramp = np.where(faster > 0.0, self._down_deg_s2[index], self._up_deg_s2[index])
        strays = error * np.sign(faster) + 0.5 * faster * faster / ramp
        excursion: FloatArray = np.maximum(strays, np.abs(error))
        return excursion

    def open(
        self,
        times_s: FloatArray,
        positions_deg: FloatArray,
        speeds_deg_s: FloatArray,
        steps: int,
        stride: int = 1,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest travel speed, per start state (row) and grid step (column).

        Column 0 is the first grid instant not before the start. An empty cone has lowest above
        highest, and stays empty.
        """
        limits, grid = self.limits, self.course.position_deg
        first = np.ceil((times_s - self.course.start_s) / GRID_S - 1e-9).astype(np.int64)
        index = np.maximum(first, 0)[:, None] + stride * np.arange(steps)
        tau = self.course.start_s + GRID_S * index - times_s[:, None]
        offset = grid[np.minimum(index, len(grid) - 1)] - positions_deg[:, None]
        offset -= speeds_deg_s[:, None] * tau
        room = np.abs(offset[:, :1]) + ROOM_RATIO * limits.tolerance_deg
        tolerance = np.maximum(room, CONE_RATIO * limits.tolerance_deg)
        lowest = change_for(offset - tolerance, tau, limits.ramp_deg_s2)
        highest = change_for(offset + tolerance, tau, limits.ramp_deg_s2)
        lowest = np.maximum.accumulate(lowest + speeds_deg_s[:, None], axis=1)
        highest = np.minimum.accumulate(highest + speeds_deg_s[:, None], axis=1)
        return (
            np.maximum(lowest, -limits.speed_max_deg_s),
            np.minimum(highest, limits.speed_max_deg_s),
        )

    def reach_s(
        self,
        times_s: FloatArray,
        positions_deg: FloatArray,
        speeds_deg_s: FloatArray,
        steps: int,
        stride: int,
    ) -> FloatArray:
        """Return, per start state, up to when one move can keep the tolerance."""
        lowest, highest = self.open(times_s, positions_deg, speeds_deg_s, steps, stride)
        held = np.logical_and.accumulate(lowest <= highest, axis=1).sum(axis=1)
        reach: FloatArray = times_s + GRID_S * stride * held
        return reach
