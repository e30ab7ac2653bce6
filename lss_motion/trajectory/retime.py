"""How fast a path may be followed: at rate 1 where that is legal, slower only where it is not.

A path whose parameter is the authored time is followed at rate 1 wherever that breaks no limit.
Only windows around the segments where it does are given to the solver, widened until rate 1 is
reached at both of their ends, which makes the result that of solving the whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.trajectory.parameterize import Cells, fastest_squares
from lss_motion.trajectory.path import peaks

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from lss_motion.trajectory.path import Path

    FloatArray = NDArray[np.float64]

CELL_S: Final = 0.025
"""Longest grid cell, in path seconds: acceleration is then exceeded by 0.28 % at most before
repair (measured: 50 ms 1.8 %, 25 ms 0.28 %, 12.5 ms 0.06 %)."""

CELLS_MIN: Final = 32
"""Cells a segment has at least. A single move is then 0.4 % slower than its closed form, and
`fastest` as a whole 0.4 % slower than on a fine grid (measured; 20 cells: 1 %)."""

REFINEMENT: Final = 4
"""Where an author's time is lost, cells are divided by this, because it is the excess, not the
duration, that should be within 2 % of the least (measured: 9 % without)."""

CELL_MIN_S: Final = 1e-4
"""Shorter segments are not divided below this. Chosen: a tenth of what the line can express."""

FEASIBLE_RATIO: Final = 1.0 + 1e-4
"""What is within this of a limit is legal, so that a speed authored exactly at the limit is not
slowed by rounding. A tenth of what the verifier allows."""

REPAIR_RATIO: Final = 1.0 + 5e-4
"""Cells that exceed a limit by more are repaired. Half of what the verifier allows."""

SPLIT_RATIO: Final = 1.005
"""A cell that exceeds a limit by more is split in two; below, its limits are lowered a little."""

REPAIRS_MAX: Final = 12
"""Rounds of repair. Measured over random sequences: at most 5 were needed."""

WINDOW_MIN_S: Final = 0.2
"""How far a window grows at least. Chosen: braking from rate 1 takes a few tenths of a second."""

RATE_SLACK: Final = 1e-7
"""A rate this close to 1 is 1: the solver's own precision."""

RATE_FREE: Final = 100.0
"""Cap of the rate where no author's time binds; path lengths are near the least times, so that
rates are of the order of 1."""

CHECKS: Final = (0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0)
"""Where in a cell the limits are checked for repair. With five, a hump of 0.15 % was missed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A path, the limits of its joints, and how fast it may be followed at most.

    `knot_caps` bounds the squared rate at single knots, by index.
    """

    path: Path
    speed_max_deg_s: FloatArray
    accel_max_deg_s2: FloatArray
    rate_max: float = 1.0
    knot_caps: Mapping[int, float]


@dataclass(frozen=True, slots=True)
class Window:
    """Squared rates over a grid from one knot to another; `first` and `end` are their indices."""

    first: int
    end: int
    grid_s: FloatArray
    squares: FloatArray


def strained(task: Task) -> NDArray[np.bool_]:
    """Return which segments cannot be followed at rate 1."""
    speed, accel = peaks(task.path)
    is_fast = np.any(speed > task.speed_max_deg_s * FEASIBLE_RATIO, axis=1)
    return np.asarray(is_fast | np.any(accel > task.accel_max_deg_s2 * FEASIBLE_RATIO, axis=1))


def slowed_windows(task: Task) -> list[Window]:
    """Return the windows where rate 1 is left, in order; none if the path is legal as it is."""
    is_rest = task.path.rests
    is_active = strained(task)
    for knot, cap in task.knot_caps.items():
        if cap < 1.0:
            is_active[knot - 1 : knot + 1] = True
    solved: dict[tuple[int, int], Window] = {}
    pending = _runs(is_active)
    for first, end in pending:
        _widen(is_active, is_rest, task.path, first, -1)
        _widen(is_active, is_rest, task.path, end - 1, +1)
    while pending := [run for run in _runs(is_active) if run not in solved]:
        for first, end in pending:
            window = solve(task, first, end)
            solved[first, end] = window
            if window.squares[0] < 1.0 and _can_widen(is_rest, first - 1):
                _widen(is_active, is_rest, task.path, first, -1)
            if window.squares[-1] < 1.0 and _can_widen(is_rest, end):
                _widen(is_active, is_rest, task.path, end - 1, +1)
    return [solved[run] for run in _runs(is_active)]


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return (first, end) of every run of set flags; `end` is the first index after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True))


def _can_widen(is_rest: NDArray[np.bool_], segment: int) -> bool:
    """At a rest the rate may jump, and a path has ends."""
    return 0 <= segment < len(is_rest) and not is_rest[segment]


def _widen(
    is_active: NDArray[np.bool_], is_rest: NDArray[np.bool_], path: Path, segment: int, step: int
) -> None:
    """Activate segments beyond `segment`: at least `WINDOW_MIN_S`, or half of the run again."""
    back = segment
    while 0 <= back - step < len(is_active) and is_active[back - step]:
        back -= step
    low, high = min(back, segment), max(back, segment) + 1
    wanted_s = max(WINDOW_MIN_S, 0.5 * float(path.knots_s[high] - path.knots_s[low]))
    segment += step
    while wanted_s > 0.0 and _can_widen(is_rest, segment):
        if not is_active[segment]:
            wanted_s -= float(path.knots_s[segment + 1] - path.knots_s[segment])
            is_active[segment] = True
        segment += step


def solve(
    task: Task, first: int, end: int, *, start_max: float = math.inf, end_max: float = math.inf
) -> Window:
    """Return the largest rates from knot `first` to knot `end`, repaired until limits hold.

    `start_max` and `end_max` bound the squared rates at the ends.
    """
    grid_s, segments = _grid(task.path, first, end)
    shares = np.ones(len(segments))
    repairs = 0
    while True:
        squares = _solve_once(task, grid_s, segments, shares, start_max, end_max)
        squares[np.abs(squares - task.rate_max**2) < RATE_SLACK] = task.rate_max**2
        excess = _excess(task, grid_s, segments, squares)
        is_bad = excess > REPAIR_RATIO
        if repairs == 0 and task.rate_max == 1.0:
            is_slow = np.minimum(squares[:-1], squares[1:]) < 1.0
            counts = np.where(is_slow, REFINEMENT, 1)
        elif repairs == REPAIRS_MAX or not is_bad.any():
            # What is left after so many rounds, if anything, is for the verifier to judge.
            return Window(first, end, grid_s, squares)
        else:
            is_split = excess > SPLIT_RATIO
            shares = np.where(
                is_bad & ~is_split, shares * FEASIBLE_RATIO / np.maximum(excess, 1.0), shares
            )
            counts = np.where(is_split, 2, 1)
        grid_s, segments, shares = _divided(grid_s, segments, shares, counts)
        repairs += 1


def _grid(path: Path, first: int, end: int) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return grid points from knot to knot, every knot among them, and the segment of each cell."""
    lengths_s = path.segment_lengths_s[first:end]
    counts = np.maximum(np.ceil(lengths_s / CELL_S), CELLS_MIN)
    counts = np.clip(counts, 1.0, np.maximum(1.0, np.floor(lengths_s / CELL_MIN_S))).astype(np.intp)
    segments = np.repeat(np.arange(first, end), counts)
    within = np.arange(len(segments)) - np.repeat(np.cumsum(counts) - counts, counts)
    steps_s = np.repeat(lengths_s / counts, counts)
    grid_s = np.append(path.knots_s[segments] + within * steps_s, path.knots_s[end])
    return grid_s, segments


def _divided(
    grid_s: FloatArray, segments: NDArray[np.intp], shares: FloatArray, counts: NDArray[np.intp]
) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
    """Return the grid with each cell divided into its count of equal parts."""
    steps_s = np.repeat(np.diff(grid_s) / counts, counts)
    within = np.arange(len(steps_s)) - np.repeat(np.cumsum(counts) - counts, counts)
    starts_s = np.repeat(grid_s[:-1], counts) + within * steps_s
    return np.append(starts_s, grid_s[-1]), np.repeat(segments, counts), np.repeat(shares, counts)


def _solve_once(
    task: Task,
    grid_s: FloatArray,
    segments: NDArray[np.intp],
    shares: FloatArray,
    start_max: float,
    end_max: float,
) -> FloatArray:
    path = task.path

    def cells_of(low: int, high: int) -> Cells:
        left_s, right_s, chosen = grid_s[low:high], grid_s[low + 1 : high + 1], segments[low:high]
        limits = task.accel_max_deg_s2 * (FEASIBLE_RATIO * shares[low:high, None])
        return Cells(
            *(
                path.evaluate(at_s, order, segments=chosen) / limits
                for order in (1, 2)
                for at_s in (left_s, right_s)
            )
        )

    caps = np.full(len(grid_s), task.rate_max**2)
    for side, at_s in ((slice(None, -1), grid_s[:-1]), (slice(1, None), grid_s[1:])):
        allowed = task.speed_max_deg_s * (FEASIBLE_RATIO * shares[:, None])
        ratio = np.max(np.abs(path.evaluate(at_s, 1, segments=segments)) / allowed, axis=1)
        caps[side] = np.minimum(caps[side], 1.0 / np.maximum(ratio, 1.0 / RATE_FREE) ** 2)
    for knot, cap in task.knot_caps.items():
        at_knot = grid_s == path.knots_s[knot]
        caps[at_knot] = np.minimum(caps[at_knot], cap)
    return fastest_squares(
        grid_s,
        cells_of,
        caps,
        joints=path.coefficients.shape[2],
        start_max=start_max,
        end_max=end_max,
    )


def _excess(
    task: Task, grid_s: FloatArray, segments: NDArray[np.intp], squares: FloatArray
) -> FloatArray:
    """Return for each cell the largest part of a limit that is used inside it."""
    excess = np.zeros(len(segments))
    steps_s = np.diff(grid_s)
    slopes = np.diff(squares) / (2.0 * steps_s)
    for share in CHECKS:
        at_s = grid_s[:-1] + share * steps_s
        square = (squares[:-1] + share * np.diff(squares))[:, None]
        first = task.path.evaluate(at_s, 1, segments=segments)
        second = task.path.evaluate(at_s, 2, segments=segments)
        speed = np.abs(first) * np.sqrt(square) / task.speed_max_deg_s
        accel = np.abs(second * square + first * slopes[:, None]) / task.accel_max_deg_s2
        excess = np.maximum(excess, np.maximum(speed, accel).max(axis=1))
    return excess
