"""The least lateness of a show of `smooth` keys, on a fine grid, without code of the planner.

The curves, the limits and both passes over the grid are written here again, from their definitions.
The least lateness is that of a motion which is at rate 1 while it is on time, and as fast as
limits, holds and pace allow while it is late. It brakes in time to be at rate 1 where it is on time
again: a bound without brakes is less than any motion can do.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence

CELL_S = 0.002
TRIALS = 32
ROUNDS = 4
STILL = 1e-5
EARLY_S = 1e-9
GOALS = 256
"""Grid points among which the one is sought at which the motion is on time."""
SNAP_S = 0.001
"""Less lateness there is none: half a cell."""


@dataclass(frozen=True)
class Curve:
    """One joint: its cubics between keys, still elsewhere."""

    starts_s: np.ndarray
    ends_s: np.ndarray
    moves: tuple[CubicHermiteSpline, ...]

    def slopes(self, first_s: np.ndarray, at_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return both derivatives at `at_s`, of the pieces in which `first_s` lie."""
        speed, bend = np.zeros(len(at_s)), np.zeros(len(at_s))
        for start, end, move in zip(self.starts_s, self.ends_s, self.moves, strict=True):
            inside = (first_s > start) & (first_s < end)
            speed[inside] = move(at_s[inside], 1)
            bend[inside] = move(at_s[inside], 2)
        return speed, bend


def curve_of(show: Sequence, joint: str) -> Curve:
    """Return the curve of a joint: monotone slopes at keys that it passes, else at rest there."""
    keys = [frame for frame in show.keyframes if joint in frame.deg]
    at = np.array([frame.at_s for frame in keys])
    left = at + np.array([frame.hold_s for frame in keys])
    deg = np.array([frame.deg[joint] for frame in keys])
    slopes = np.zeros(len(keys))
    if len(keys) > 2:
        gaps = at[1:] - left[:-1]
        along = np.concatenate([[0.0], np.cumsum(gaps)])
        inner = PchipInterpolator(along, deg).derivative()(along)[1:-1]
        slopes[1:-1] = np.where([frame.hold_s > 0.0 for frame in keys[1:-1]], 0.0, inner)
    moves = tuple(
        CubicHermiteSpline([left[k], at[k + 1]], deg[k : k + 2], slopes[k : k + 2])
        for k in range(len(keys) - 1)
    )
    return Curve(left[:-1], at[1:], moves)


class Grid:
    """Rows of all limits at both ends of each cell, and where the motion rests or is held."""

    def __init__(self, show: Sequence, robot: Robot) -> None:
        frames = show.keyframes
        joints = sorted({name for frame in frames for name in frame.deg})
        marks = {float(t) for f in frames for t in (f.at_s, f.at_s + f.hold_s)}
        knots = np.array(sorted({0.0, *marks}))
        pieces = [
            np.linspace(low, high, max(2, int(np.ceil((high - low) / CELL_S)) + 1))[:-1]
            for low, high in itertools.pairwise(knots)
        ]
        self.at_s = np.concatenate([*pieces, knots[-1:]])
        self.step_s = np.diff(self.at_s)
        middle = self.at_s[:-1] + 0.5 * self.step_s
        curves = [curve_of(show, name) for name in joints]
        speed_max = np.array([robot.joints[name].speed_max_deg_s for name in joints])
        accel_max = np.array([robot.joints[name].accel_max_deg_s2 for name in joints])
        ends = (self.at_s[:-1], self.at_s[1:])
        found = [[curve.slopes(middle, end) for curve in curves] for end in ends]
        speed, bend = (
            [np.stack([pair[part] for pair in side], axis=1) for side in found] for part in (0, 1)
        )
        with np.errstate(divide="ignore"):
            self.cap = [(1.0 / np.abs(s / speed_max).max(axis=1)) ** 2 for s in speed]
        is_still = [np.abs(s).max(axis=1) < STILL for s in speed]
        self.is_stop = np.append(is_still[0], True) & np.append(True, is_still[1])
        self.is_rest = is_still[0] & is_still[1] & (np.abs(bend[0]).max(axis=1) < STILL)
        held = [(f.at_s, f.at_s + f.hold_s) for f in frames if f.hold_s and not f.hold_may_shrink]
        self.is_held = np.zeros(len(middle), dtype=bool)
        for low, high in held:
            self.is_held |= (middle > low) & (middle < high)
        # |by_start * x + by_end * y| <= 1 with squared rates x and y at both ends of the cell.
        half = 0.5 / self.step_s[:, None]
        left, right = speed[0] / accel_max * half, speed[1] / accel_max * half
        self.by_start = np.concatenate([bend[0] / accel_max - left, -right], axis=1)
        self.by_end = np.concatenate([left, right + bend[1] / accel_max], axis=1)

    def ends_from(self, cell: int, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and largest squares at the end of a cell, for those at its start."""
        base = self.by_start[cell] * starts[:, None]
        slope = self.by_end[cell]
        is_flat = np.abs(slope) < 1e-12
        factor = np.where(is_flat, 1.0, slope)
        one, two = (-1.0 - base) / factor, (1.0 - base) / factor
        low = np.where(is_flat, -np.inf, np.minimum(one, two)).max(axis=1)
        high = np.where(is_flat, np.inf, np.maximum(one, two)).min(axis=1)
        is_over = (is_flat & (np.abs(base) > 1.0 + 1e-9)).any(axis=1)
        return low, np.where(is_over, -np.inf, high)

    def largest(self, pace: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest squares at the start and the end of each cell that can go on."""
        top = np.where(self.is_held, 1.0, pace**2)
        starts, ends = np.minimum(self.cap[0], top), np.minimum(self.cap[1], top)
        for cell in range(len(self.step_s) - 1, -1, -1):
            if cell + 1 < len(starts) and not self.is_stop[cell + 1]:
                ends[cell] = min(ends[cell], starts[cell + 1])
            starts[cell] = self._start_before(cell, float(starts[cell]), float(ends[cell]))
        return starts, ends

    def _start_before(self, cell: int, high: float, end: float) -> float:
        """Return the largest square at the start of a cell, up to `high`, that can reach `end`."""
        low = 0.0
        for _ in range(ROUNDS):
            trial = np.linspace(low, high, TRIALS)
            least, most = self.ends_from(cell, trial)
            good = (least <= end) & (most >= np.maximum(least, 0.0))
            best = int(np.flatnonzero(good)[-1]) if good.any() else 0
            if best == TRIALS - 1:
                return high
            low, high = float(trial[best]), float(trial[best + 1])
        return low

    def least_late(self, pace: float) -> np.ndarray:
        """Return the lateness at every grid point: rate 1 while on time, else as fast as possible.

        Where it is on time again it must be able to go on at rate 1, so that it brakes before.
        """
        calm, quick = self.largest(1.0), self.largest(pace)
        late, squares = np.zeros(len(self.at_s)), np.ones(len(self.at_s))
        cell = 0
        while cell < len(self.step_s):
            is_late = late[cell] > 0.0
            starts, ends = quick if is_late else calm
            self._go(cell, float(starts[cell]), float(ends[cell]), (late, squares))
            if late[cell + 1] >= -EARLY_S or not is_late:
                late[cell + 1] = max(0.0, late[cell + 1])
                cell += 1
            else:
                cell = self._catch_up(cell, calm, quick, (late, squares))
        return late

    def _go(
        self, cell: int, start: float, end: float, motion: tuple[np.ndarray, np.ndarray]
    ) -> None:
        """Fill lateness and square behind a cell, with these bounds at its ends."""
        late, squares = motion
        begin = min(start, math.inf if self.is_stop[cell] else squares[cell])
        most = min(max(float(self.ends_from(cell, np.array([begin]))[1][0]), 0.0), end)
        step_s = self.step_s[cell]
        spent_s = 2.0 * step_s / (math.sqrt(begin) + math.sqrt(most)) if begin + most else 0.0
        if self.is_rest[cell]:
            spent_s = step_s if self.is_held[cell] else max(0.0, step_s - late[cell])
        late[cell + 1], squares[cell + 1] = late[cell] + spent_s - step_s, most

    def _catch_up(
        self,
        cell: int,
        calm: tuple[np.ndarray, np.ndarray],
        quick: tuple[np.ndarray, np.ndarray],
        motion: tuple[np.ndarray, np.ndarray],
    ) -> int:
        """Brake to the last grid point at which the motion is not early, and return it.

        Without brakes it is early behind `cell`.
        """
        low, high = cell, min(len(self.step_s) - 1, cell + GOALS)
        found = self._braked(low, cell, calm, quick, motion)
        while high - low > 1:
            middle = (low + high) // 2
            trial = self._braked(middle, cell, calm, quick, motion)
            if trial is None:
                high = middle
            else:
                low, found = middle, trial
        assert found is not None
        late, squares = motion
        late[:], squares[:] = found
        if late[low] < SNAP_S:
            late[low] = 0.0
        elif low == cell:  # Slow from here on: as without brakes, on time for an instant.
            starts, ends = quick
            self._go(cell, float(starts[cell]), float(ends[cell]), motion)
            late[cell + 1] = max(0.0, late[cell + 1])
            return cell + 1
        return low

    def _braked(
        self,
        goal: int,
        known: int,
        calm: tuple[np.ndarray, np.ndarray],
        quick: tuple[np.ndarray, np.ndarray],
        motion: tuple[np.ndarray, np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the motion with brakes before a grid point; None if it is early.

        The motion without brakes is known up to the grid point `known`.
        """
        late, squares = (values.copy() for values in motion)
        end, cell = math.inf if self.is_stop[goal] else float(calm[0][goal]), goal
        bounds = []
        is_met = False
        while cell > 0 and not is_met:
            cell -= 1
            end = min(end, float(quick[1][cell]))
            start = self._start_before(cell, float(quick[0][cell]), end)
            bounds.append((cell, start, end))
            is_met = cell <= known and bool(self.is_stop[cell] or start >= squares[cell])
            end = math.inf if self.is_stop[cell] else start
        for at, start, bound in reversed(bounds):
            self._go(at, start, bound, (late, squares))
            if late[at + 1] < -EARLY_S:
                return None
        return late, squares


def least_lateness(
    show: Sequence, robot: Robot, pace: float, grid: Grid | None = None
) -> Mapping[float, float]:
    """Return the least lateness at the time of each keyframe."""
    grid = grid or Grid(show, robot)
    late = grid.least_late(pace)
    return {
        float(frame.at_s): float(late[np.argmin(np.abs(grid.at_s - frame.at_s))])
        for frame in show.keyframes
    }
