"""The largest rates along a path, from toppra's solver. No other module imports toppra.

`solve` puts a grid over a part of a path, solves once and repairs. The solver holds the limits at
grid points only; between them they may be exceeded a little. Cells where that matters are divided
or given lower limits, and only their surroundings are solved again, as far as the rates change: the
result is that of solving the whole again.

`fastest_squares` drives toppra's compiled stage solver directly: the same two passes as its
`TOPPRA` class, in a third of the time (measured, identical results), in blocks that bound memory,
with an end rate that may be free, and with second derivatives that differ on both sides of a knot.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct, field

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.curves import peaks
from lss_motion.show.splines import distinct, runs

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.curves import Path
    from lss_motion.planning.trajectory.servo_rows import ServoRows

    FloatArray = NDArray[np.float64]


ROW_LEAST: Final = 1e-200
"""A smaller row bounds no slope that a path can have; its inverse would overflow. Chosen."""

CELL_S: Final = 0.025
"""Longest grid cell, in path seconds. Acceleration is exceeded by at most 0.28 % before repair
(measured: 50 ms 1.8 %, 25 ms 0.28 %, 12.5 ms 0.06 %)."""

CELLS_MIN: Final = 32
"""Least number of cells of a segment. A single move is then 0.4 % slower than its closed form, and
`fastest` as a whole 0.4 % slower than on a fine grid (measured; 20 cells: 1 %)."""

REFINEMENT: Final = 4
"""Cells in which the motion is slower than authored are divided by this, so that the delay, not
only the duration, is within 2 % of the least (measured: 9 % without)."""

KNOT_PARTS: Final = (8, 4, 2)
"""Slow cells that are nearest to a knot, second and third, are divided further into so many. There
the rates change most. Measured: lateness of up to 1.2 times the least without, 1.01 with it."""

CATCH_UP_CELL_S: Final = 0.016
"""Longer cells are halved where lateness is made up, because no other grid follows that could show
how coarse they are. Measured: lateness of 1.03 times the least without, 1.017 with it."""

CELL_MIN_S: Final = 1e-4
"""Least length of a cell. Chosen: a tenth of the 1 ms unit of a timed move."""

POINT_S: Final = 1e-7
"""Grid points are not added nearer than this to another one: rounding."""

FEASIBLE_RATIO: Final = 1.0 + 1e-4
"""Up to this multiple of a limit is legal, so that rounding does not slow a speed authored exactly
at the limit. A tenth of what the verifier allows."""

REPAIR_RATIO: Final = 1.0 + 5e-4
"""Cells that exceed a limit by more are repaired. Half of what the verifier allows."""

SPLIT_RATIO: Final = 1.005
"""A cell that exceeds a limit by more is split in two; below, its limits are lowered a little."""

REPAIRS_MAX: Final = 12
"""Rounds of repair. Measured over random sequences: at most 5 were needed."""

REACH_CELLS: Final = 6
"""Cells on either side of a repaired one that are solved again; doubled until the rates at both
ends stay as they were."""

RATE_SLACK: Final = 1e-7
"""Rates this close are equal: the solver's own precision."""

RATE_FREE: Final = 100.0
"""Largest rate where no authored time counts. Path lengths are near the least durations, so that
rates are of the order of 1."""

MARGIN_RATIO: Final = 1.0 - 1e-3
"""Share of the limits that long paths use where no authored time counts, and motions that make up
for lateness, so that few cells need repair (measured: 2 of 38,000 instead of 2,300, for 0.05 % of
the duration)."""

MARGIN_CELLS: Final = 1000
"""Paths with fewer cells use the whole limits, because they are repaired quickly. Chosen."""

CHECKS: Final = (0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0)
"""Positions in a cell at which the limits are checked. Five did not find an excess of 0.15 %."""

SHORT_CELL_S: Final = 0.016
SHORT_CHECKS: Final = CHECKS[::2]
"""Positions in shorter cells. An excess goes with the square of the length: these miss 0.06 %."""

BLOCK: Final = 2048
"""Cells that are checked at a time. Chosen: the data of 18 joints fit the processor's cache."""

GROUP_ROWS: Final = 12
"""Rows of one toppra constraint. toppra multiplies them by a matrix of that many rows squared, so
that several small constraints are faster than one large one (measured: 4 to 12 are alike)."""

BLOCK_CELLS: Final = 690
"""Cells of one solver object. OpenBLAS runs products of more than 262144 multiplications on several
threads, which takes five times as long for products of this size (measured: 15 µs a cell instead of
3). Small blocks also bound memory."""

KEPT_ROWS: Final = 700_000
"""Cells times joints whose solvers are kept for the second pass; about 200 bytes each. Chosen: this
halves the time for a 10-minute show of 18 joints, and takes 140 MB."""

BISECTIONS: Final = 60
"""Halvings to find the largest square where the solver fails: precise to the last bit."""

PREFER_SMALL_SLOPE: Final = 1e-9
"""Weight of the slope in the objective, as in toppra: of equal squares, the smaller slope."""


class RateTask(Struct, frozen=True, kw_only=True):
    """A path, the limits of its joints, and the largest rate at which it may be followed.

    `knot_caps` bounds the squared rate at single knots, by index. The rate is at most 1 outside of
    the positions `fast_s` and in the spans `calm_s`, (n, 2), and `RATE_FREE` inside of the spans
    `free_s`. If the spans `slow_s` are given, the grid is finer there from the start; elsewhere
    each segment uses its share of the limits, 1 if `shares` is None.
    """

    path: Path
    speed_max_deg_s: FloatArray
    accel_max_deg_s2: FloatArray
    rate_max: float = 1.0
    knot_caps: Mapping[int, float]
    fast_s: tuple[float, float] = (-math.inf, math.inf)
    calm_s: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    free_s: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    slow_s: FloatArray | None = None
    shares: FloatArray | None = None
    accel_shares: FloatArray | None = None
    """Share of the acceleration limit that each segment and joint may use; None: all of it."""
    cells_min: int = CELLS_MIN
    """Least number of cells of a segment; smaller for paths with dense knots."""
    servos: ServoRows | None = None
    """Servos with limits of their own, whose columns come after those of the joints."""

    def slopes(
        self, path_s: FloatArray, segments: NDArray[np.intp] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the first and the second derivative of all columns; see `Path.slopes`."""
        first, second = self.path.slopes(path_s, segments)
        if self.servos is None:
            return first, second
        return self.servos.slopes(self.path.evaluate(path_s), first, second)

    def peaks(self) -> tuple[FloatArray, FloatArray]:
        """Return the largest |first| and |second| derivative of each segment and column."""
        return peaks(self.path) if self.servos is None else self.servos.peaks(self.path)

    def accel_limits_deg_s2(self, segments: NDArray[np.intp]) -> FloatArray:
        """Return the acceleration that joints may use in segments, (n, joints) or (joints,)."""
        if self.accel_shares is None:
            return self.accel_max_deg_s2
        return np.asarray(self.accel_max_deg_s2 * self.accel_shares[segments])


class RateWindow(Struct, frozen=True):
    """Squared rates over a grid of path positions; between grid points they are linear."""

    grid_s: FloatArray
    squares: FloatArray

    @property
    def from_s(self) -> float:
        return float(self.grid_s[0])

    @property
    def to_s(self) -> float:
        return float(self.grid_s[-1])

    @property
    def spent_s(self) -> FloatArray:
        """The duration of each cell."""
        rates = np.sqrt(self.squares)
        return np.asarray(2.0 * np.diff(self.grid_s) / (rates[:-1] + rates[1:]))

    @property
    def duration_s(self) -> float:
        return float(self.spent_s.sum())


class _CellGrid(Struct, frozen=True):
    """Consecutive cells: the segment of each, and the share of the limits that it may use."""

    points_s: FloatArray
    segments: NDArray[np.intp]
    shares: FloatArray

    def part(self, low: int, high: int) -> _CellGrid:
        """Return the cells from `low` to before `high`."""
        return _CellGrid(
            self.points_s[low : high + 1], self.segments[low:high], self.shares[low:high]
        )

    def with_points(self, more_s: FloatArray) -> _CellGrid:
        """Return the grid with further points inside of its cells."""
        cells = np.searchsorted(self.points_s, more_s) - 1
        return _CellGrid(
            np.insert(self.points_s, cells + 1, more_s),
            np.insert(self.segments, cells, self.segments[cells]),
            np.insert(self.shares, cells, self.shares[cells]),
        )

    def divided(self, counts: NDArray[np.intp]) -> _CellGrid:
        """Return the grid with each cell divided into its count of equal parts."""
        steps_s = np.repeat(np.diff(self.points_s) / counts, counts)
        within = np.arange(len(steps_s)) - np.repeat(np.cumsum(counts) - counts, counts)
        starts_s = np.repeat(self.points_s[:-1], counts) + within * steps_s
        return _CellGrid(
            np.append(starts_s, self.points_s[-1]),
            np.repeat(self.segments, counts),
            np.repeat(self.shares, counts),
        )


def solve(
    task: RateTask,
    from_s: float,
    to_s: float,
    *,
    start_max: float = math.inf,
    end_max: float = math.inf,
    known: RateWindow | None = None,
) -> RateWindow:
    """Return the largest rates between two path positions, repaired until limits hold.

    `start_max` and `end_max` bound the squared rates at the ends. `known` has the rates where all
    of the acceleration may be used: only what the task's `accel_shares` change is solved again. An
    excess that is left after `REPAIRS_MAX` rounds is found by the verifier.
    """
    end_maxima = start_max, end_max
    if known is not None and task.accel_shares is not None:
        grid, squares, excess = _with_reserves(task, task.accel_shares, known, end_maxima)
    else:
        grid = _grid(task, from_s, to_s)
        _keep_margin(task, grid)
        squares = _squares(task, grid, start_max, end_max)
        if task.rate_max == 1.0:
            is_slow = np.minimum(squares[:-1], squares[1:]) < 1.0
            grid = grid.divided(np.where(is_slow, REFINEMENT, 1))
            squares = _squares(task, grid, start_max, end_max)
        excess = _excess(task, grid, squares)
    for _ in range(REPAIRS_MAX):
        if not (excess > REPAIR_RATIO).any():
            break
        grid, squares, excess = _repaired(task, grid, squares, excess, end_maxima)
    return RateWindow(grid.points_s, squares)


def _keep_margin(task: RateTask, grid: _CellGrid) -> None:
    """Let the cells of a long window without authored times use less of the limits."""
    if task.rate_max == RATE_FREE and len(grid.segments) > MARGIN_CELLS:
        grid.shares[:] = MARGIN_RATIO


def slow_outline(task: RateTask, from_s: float, to_s: float) -> RateWindow:
    """Return the largest rates on the coarse grid alone: where the motion must be slow, roughly."""
    grid = _grid(task, from_s, to_s)
    return RateWindow(grid.points_s, _squares(task, grid, math.inf, math.inf))


def is_legal(task: RateTask, window: RateWindow, first: int) -> bool:
    """Return whether the limits hold inside the cells of a window from grid point `first` on."""
    points_s = window.grid_s[first:]
    segments = task.path.segments_of(0.5 * (points_s[:-1] + points_s[1:]))
    grid = _CellGrid(points_s, segments, np.ones(len(segments)))
    return bool((_excess(task, grid, window.squares[first:]) <= REPAIR_RATIO).all())


def _grid(task: RateTask, from_s: float, to_s: float) -> _CellGrid:
    """Return grid points between two positions, every knot among them."""
    path = task.path
    first = int(np.searchsorted(path.knots_s, from_s, side="right")) - 1
    end = max(first + 1, int(np.searchsorted(path.knots_s, to_s, side="left")))
    lengths_s = path.segment_lengths_s[first:end]
    counts = np.maximum(np.ceil(lengths_s / CELL_S), task.cells_min)
    counts = np.clip(counts, 1.0, np.maximum(1.0, np.floor(lengths_s / CELL_MIN_S)))
    points_s = path.knots_s[first : end + 1].copy()
    points_s[[0, -1]] = from_s, to_s
    counts = np.maximum(np.ceil(counts * (np.diff(points_s) / lengths_s)), 1.0).astype(np.intp)
    grid = _CellGrid(points_s, np.arange(first, end), np.ones(end - first)).divided(counts)
    if task.slow_s is not None:
        if task.shares is not None:
            grid.shares[:] = task.shares[grid.segments]
        is_first = np.diff(grid.segments, prepend=-1) > 0
        is_near_knot = is_first | np.append(is_first[1:], True)
        is_slow = np.zeros_like(is_near_knot)
        if len(task.slow_s):
            middles_s = 0.5 * (grid.points_s[:-1] + grid.points_s[1:])
            span = np.searchsorted(task.slow_s[:, 0], middles_s) - 1
            is_slow = (span >= 0) & (middles_s < task.slow_s[span, 1])
            grid.shares[is_slow] = 1.0
        is_coarse = np.diff(grid.points_s) > CATCH_UP_CELL_S
        counts = np.where(is_slow, REFINEMENT, np.where(is_coarse | is_near_knot, 2, 1))
        grid = _graded(grid.divided(counts), np.repeat(is_slow, counts))
    inner_s = distinct(np.concatenate([task.calm_s.ravel(), task.free_s.ravel(), task.fast_s]))
    inner_s = inner_s[(inner_s > from_s) & (inner_s < to_s)]
    if len(inner_s):
        nearest_s = grid.points_s[np.abs(grid.points_s - inner_s[:, None]).argmin(axis=1)]
        grid = grid.with_points(inner_s[np.abs(nearest_s - inner_s) > POINT_S])
    return grid


def _graded(grid: _CellGrid, is_slow: NDArray[np.bool_]) -> _CellGrid:
    """Return the grid with the slow cells nearest to knots divided further, the nearer the more."""
    counts = np.ones(len(is_slow), dtype=np.intp)
    is_first = np.diff(grid.segments, prepend=-1) > 0
    is_last = np.append(is_first[1:], True)
    for distance, parts in enumerate(KNOT_PARTS):
        first = np.flatnonzero(is_first) + distance
        last = np.flatnonzero(is_last) - distance
        near = np.concatenate([first[first < len(counts)], last[last >= 0]])
        counts[near] = np.maximum(counts[near], parts)
    return grid.divided(np.where(is_slow, counts, 1))


def _squares(task: RateTask, grid: _CellGrid, start_max: float, end_max: float) -> FloatArray:
    path, points_s, segments = task.path, grid.points_s, grid.segments
    caps = np.full(len(points_s), task.rate_max**2)
    for from_s, to_s in task.free_s.tolist():
        first, end = np.searchsorted(points_s, [from_s - POINT_S, to_s + POINT_S])
        caps[first:end] = RATE_FREE**2
    for low in range(0, len(segments), BLOCK):
        part = grid.part(low, low + BLOCK)
        allowed = task.speed_max_deg_s * (FEASIBLE_RATIO * part.shares[:, None])
        for side, at_s in enumerate((part.points_s[:-1], part.points_s[1:])):
            speed = np.abs(task.slopes(at_s, part.segments)[0])
            ratio = np.maximum((speed / allowed).max(axis=1), 1.0 / RATE_FREE)
            place = slice(low + side, low + side + len(at_s))
            caps[place] = np.minimum(caps[place], 1.0 / ratio**2)
    if task.rate_max > 1.0:
        is_calm = (points_s <= task.fast_s[0]) | (points_s >= task.fast_s[1])
        for from_s, to_s in task.calm_s.tolist():
            is_calm[
                np.searchsorted(points_s, from_s) : np.searchsorted(points_s, to_s, "right")
            ] = True
        caps[is_calm] = np.minimum(caps[is_calm], 1.0)
    for knot, cap in task.knot_caps.items():
        at_knot = points_s == path.knots_s[knot]
        caps[at_knot] = np.minimum(caps[at_knot], cap)

    def cells_of(low: int, high: int) -> Cells:
        part = grid.part(low, high)
        limits = task.accel_limits_deg_s2(part.segments) * (FEASIBLE_RATIO * part.shares[:, None])
        left, left_bend = task.slopes(part.points_s[:-1], part.segments)
        right, right_bend = task.slopes(part.points_s[1:], part.segments)
        return Cells(left / limits, right / limits, left_bend / limits, right_bend / limits)

    squares = fastest_squares(
        points_s,
        cells_of,
        caps,
        joints=len(task.speed_max_deg_s),
        start_max=start_max,
        end_max=end_max,
    )
    squares[np.abs(squares - task.rate_max**2) < RATE_SLACK] = task.rate_max**2
    if task.rate_max > 1.0:
        squares[np.abs(squares - 1.0) < RATE_SLACK] = 1.0
    return squares


def _excess(task: RateTask, grid: _CellGrid, squares: FloatArray) -> FloatArray:
    """Return for each cell the largest share of a limit that is used inside it."""
    steps_s = np.diff(grid.points_s)
    is_short = steps_s <= SHORT_CELL_S
    excess = np.zeros(len(steps_s))
    for cells, shares in (
        (np.flatnonzero(~is_short), CHECKS),
        (np.flatnonzero(is_short), SHORT_CHECKS),
    ):
        for low in range(0, len(cells), BLOCK):
            part = cells[low : low + BLOCK]
            excess[part] = _worst_use(task, grid, squares, part, steps_s[part], shares)
    return excess


def _worst_use(
    task: RateTask,
    grid: _CellGrid,
    squares: FloatArray,
    cells: NDArray[np.intp],
    steps_s: FloatArray,
    shares: Sequence[float],
) -> FloatArray:
    """Return the largest share of a limit that some cells use at the `shares` of their lengths."""
    from_s, segments = grid.points_s[cells], grid.segments[cells]
    starts, growth = squares[cells], squares[cells + 1] - squares[cells]
    slopes = (growth / (2.0 * steps_s))[:, None]
    worst = np.zeros(len(cells))
    accel_max = task.accel_limits_deg_s2(segments)
    for share in shares:
        square = np.maximum(starts + share * growth, 0.0)[:, None]
        first, second = task.slopes(from_s + share * steps_s, segments)
        second *= square
        second += first * slopes
        first *= np.sqrt(square)
        for used, limits in ((first, task.speed_max_deg_s), (second, accel_max)):
            np.abs(used, out=used)
            np.divide(used, limits, out=used)
            np.maximum(worst, used.max(axis=1), out=worst)
    return worst


def _repaired(
    task: RateTask,
    grid: _CellGrid,
    squares: FloatArray,
    excess: FloatArray,
    end_maxima: tuple[float, float],
) -> tuple[_CellGrid, FloatArray, FloatArray]:
    """Divide the worst cells, lower the limits of the others, and solve around both again."""
    is_split = excess > SPLIT_RATIO
    is_lowered = (excess > REPAIR_RATIO) & ~is_split
    shares = np.where(
        is_lowered, grid.shares * FEASIBLE_RATIO / np.maximum(excess, 1.0), grid.shares
    )
    counts = np.where(is_split, 2, 1)
    divided = _CellGrid(grid.points_s, grid.segments, shares).divided(counts)
    # Within a cell the square is linear, so that dividing a cell does not change the rates.
    start = np.interp(divided.points_s, grid.points_s, squares)
    is_new = np.repeat(is_split | is_lowered, counts)
    after, known = _resolved(task, divided, start, is_new, end_maxima)
    known = np.where(np.isnan(known), np.repeat(excess, counts), known)
    return divided, after, known


def _with_reserves(
    task: RateTask, shares: FloatArray, known: RateWindow, end_maxima: tuple[float, float]
) -> tuple[_CellGrid, FloatArray, FloatArray]:
    """Return grid, squares and excess with the shares of acceleration of a task.

    `known` has the rates without them, or with higher ones; its cells hold the limits.
    """
    segments = task.path.segments_of(0.5 * (known.grid_s[:-1] + known.grid_s[1:]))
    grid = _CellGrid(known.grid_s, segments, np.ones(len(segments)))
    _keep_margin(task, grid)
    has_reserve = np.any(shares < 1.0, axis=1)[segments]
    squares, excess = _resolved(task, grid, known.squares, has_reserve, end_maxima)
    return grid, squares, np.nan_to_num(excess)


def _resolved(
    task: RateTask,
    grid: _CellGrid,
    squares: FloatArray,
    is_new: NDArray[np.bool_],
    end_maxima: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return the squares, solved again around the new cells, and the excess where that counts."""
    after = squares.copy()
    places = runs(is_new)
    if sum(high - low + 2 * REACH_CELLS for low, high in places) > len(is_new) // 2:
        places = [(0, len(is_new))]
    for low, high in places:
        _resolve(task, grid, after, (low, high), end_maxima)
    is_changed = after != squares
    excess = np.full(len(is_new), np.nan)
    for low, high in runs(is_new | is_changed[:-1] | is_changed[1:]):
        excess[low:high] = _excess(task, grid.part(low, high), after[low : high + 1])
    return after, excess


def _resolve(
    task: RateTask,
    grid: _CellGrid,
    squares: FloatArray,
    cells: tuple[int, int],
    end_maxima: tuple[float, float],
) -> None:
    """Solve again around `cells`, as far to either side as the rates have to change."""
    count = len(grid.segments)
    left = right = REACH_CELLS
    while True:
        low, high = max(0, cells[0] - left), min(count, cells[1] + right)
        start_max = end_maxima[0] if low == 0 else float(squares[low])
        end_max = end_maxima[1] if high == count else float(squares[high])
        found = _squares(task, grid.part(low, high), start_max, end_max)
        is_left_met = low == 0 or found[0] >= squares[low] - RATE_SLACK
        is_right_met = high == count or found[-1] >= squares[high] - RATE_SLACK
        if is_left_met and is_right_met:
            squares[low : high + 1] = found
            return
        left, right = left * (1 if is_left_met else 2), right * (1 if is_right_met else 2)


class Cells(Struct, frozen=True):
    """Derivatives of the path at both ends of consecutive cells, (n, joints).

    All are divided by the acceleration limits, so that the limit of every row is 1.
    """

    speed_left: FloatArray
    speed_right: FloatArray
    accel_left: FloatArray
    accel_right: FloatArray


def fastest_squares(
    grid_s: FloatArray,
    cells_of: Callable[[int, int], Cells],
    caps: FloatArray,
    *,
    joints: int,
    start_max: float = math.inf,
    end_max: float = math.inf,
) -> FloatArray:
    """Return the largest squared rate at every grid point that the limits allow.

    The acceleration rows hold at both ends of every cell (toppra's `Interpolation` scheme, with
    each cell's own one-sided derivatives). `caps` bounds the squared rates; `start_max` and
    `end_max` bound them further at the ends. Raises `PlanningError` with the path position if
    the path itself is not finite there; rate 0 is possible on any other.
    """
    upper = caps.copy()
    upper[-1] = min(upper[-1], end_max)
    count = len(grid_s) - 1
    size = BLOCK_CELLS
    starts = range(0, count, size)

    def block(first: int) -> _CellBlock:
        end = min(first + size, count)
        return _CellBlock(grid_s[first : end + 1], cells_of(first, end), caps[first : end + 1])

    kept: dict[int, _CellBlock] = {}
    for first in reversed(starts):
        backward = block(first)
        backward.fill_upper(upper[first : first + size + 1])
        if first * joints < KEPT_ROWS:
            kept[first] = backward
    squares = np.zeros(count + 1)
    squares[0] = min(upper[0], start_max)
    for first in starts:
        part = slice(first, first + size + 1)
        forward = kept.pop(first) if first in kept else block(first)
        forward.fill_squares(squares[part], upper[part])
    return squares


class _CellBlock:
    """Consecutive cells and a toppra solver for them.

    Each row is |row · slope + tilt · square| ≤ 1, for a joint at the left or the right of a cell.
    """

    def __init__(self, grid_s: FloatArray, cells: Cells, caps: FloatArray) -> None:
        self.doubled_s = 2.0 * np.diff(grid_s)
        right = cells.speed_right + self.doubled_s[:, None] * cells.accel_right
        self.rows = np.concatenate([cells.speed_left, right], axis=1)
        self.tilts = np.concatenate([cells.accel_left, cells.accel_right], axis=1)
        if not (np.isfinite(self.rows).all() and np.isfinite(self.tilts).all()):
            at_s = float(grid_s[0])
            raise PlanningError(f"the path is not finite near {at_s:g} s", time_s=at_s)
        self.caps = caps
        self.solve = _stage_solver(grid_s - grid_s[0], self.rows, self.tilts, caps)

    def fill_upper(self, upper: FloatArray) -> None:
        """Fill all but the last with the largest square from which the rest can be followed.

        The smallest square needs no solving: it is 0, because rate 0 is always possible.
        """
        objective = np.array([PREFER_SMALL_SLOPE, -1.0])
        following = float(upper[-1])
        for cell in range(len(self.doubled_s) - 1, -1, -1):
            found = self.solve(cell, None, objective, math.nan, math.nan, 0.0, following)[1]
            if math.isnan(found):
                found = self._largest_square(cell, following)
            upper[cell] = following = max(found, 0.0)

    def fill_squares(self, squares: FloatArray, upper: FloatArray) -> None:
        """Fill all but the first, each with the largest square that the one before allows."""
        objective = np.array([0.0, -1.0])
        square = float(squares[0])
        limits = upper[1:].tolist()
        for cell, step_s in enumerate(self.doubled_s.tolist()):
            limit = limits[cell]
            objective[0] = -step_s
            slope = self.solve(cell, None, objective, square, square, 0.0, limit)[0]
            if math.isnan(slope):
                slope = self._slopes(cell, square)[1]
            square = min(max(square + step_s * slope, 0.0), limit)
            squares[cell + 1] = square

    # The solver's tolerances are absolute. It sometimes reports a stage as infeasible that is
    # feasible within rounding. toppra then lowers the rate by 0.1 %, which is a visible delay where
    # thousands of stages run at rate 1; the two functions below solve such a stage exactly.

    def _slopes(self, cell: int, square: float) -> tuple[float, float]:
        """Return the smallest and largest slope that the rows of a cell allow at a square."""
        rows, middles = self.rows[cell], self.tilts[cell] * square
        is_bound = np.abs(rows) > ROW_LEAST
        width, middle = 1.0 / np.abs(rows[is_bound]), -middles[is_bound] / rows[is_bound]
        return (
            float(np.max(middle - width, initial=-math.inf)),
            float(np.min(middle + width, initial=math.inf)),
        )

    def _largest_square(self, cell: int, following: float) -> float:
        """Return the largest square of a cell from which `following` is not exceeded."""
        steepest = float(np.abs(self.tilts[cell][self.rows[cell] == 0.0]).max(initial=0.0))
        low, high = 0.0, float(self.caps[cell])
        if steepest > 0.0:
            high = min(high, 1.0 / steepest)
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            smallest, largest = self._slopes(cell, middle)
            smallest = max(smallest, -middle / self.doubled_s[cell])
            largest = min(largest, (following - middle) / self.doubled_s[cell])
            low, high = (middle, high) if smallest <= largest else (low, middle)
        return low


def _stage_solver(
    grid_s: FloatArray, rows: FloatArray, tilts: FloatArray, caps: FloatArray
) -> Callable[..., Any]:
    """Return toppra's `solve_stagewise_optim` for these cells. Importing toppra takes a second."""
    with warnings.catch_warnings():
        # Python prints faults of toppra's docstrings where it compiles them.
        warnings.simplefilter("ignore", SyntaxWarning)
        warnings.simplefilter("ignore", DeprecationWarning)
        from toppra.constraint import LinearConstraint
        from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper

    class Limits(LinearConstraint):  # type: ignore[misc]  # toppra is untyped
        """Rows in both directions, or caps. The last grid point has no rows of its own."""

        def __init__(self, *parameters: FloatArray | None) -> None:
            super().__init__()
            self.identical = True
            self.parameters = parameters

        def compute_constraint_params(self, *_: object) -> tuple[FloatArray | None, ...]:
            return self.parameters

    class Duration:
        """Stands for the path; the solver reads its length only, and gets a scale of 1."""

        duration = float(grid_s[-1])

    bounds = np.stack([np.zeros_like(caps), caps], axis=1)
    limits = [Limits(None, None, None, None, None, None, bounds)]
    moving = np.flatnonzero(rows.any(axis=0) | tilts.any(axis=0))
    for first in range(0, len(moving), GROUP_ROWS):
        group = moving[first : first + GROUP_ROWS]
        by_slope, by_square = np.zeros((2, len(caps), len(group)))
        by_slope[:-1], by_square[:-1] = rows[:, group], tilts[:, group]
        unit = np.eye(len(group))
        both, ones = np.concatenate([unit, -unit]), np.ones(2 * len(group))
        nothing = np.zeros_like(by_slope)
        limits.append(Limits(by_slope, by_square, nothing, both, ones, None, None))
    solve: Callable[..., Any] = seidelWrapper(limits, Duration(), grid_s).solve_stagewise_optim
    return solve
