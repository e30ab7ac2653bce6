"""The fence around toppra: the fastest rates along a path, stage by stage, from its own solver.

toppra's compiled stage solver is driven directly: the same two passes as its `TOPPRA` class makes,
in a third of the time (measured, identical results), in blocks that bound memory, with an end
rate that may be free, and with second derivatives that differ on both sides of a knot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion.errors import PlanningError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

GROUP_ROWS: Final = 12
"""Rows of one toppra constraint. It multiplies them by a matrix of so many rows squared, so that
many small constraints are made quicker than one of all rows (measured: 4 to 12 are alike)."""

BLOCK_CELLS: Final = 690
"""Cells of one solver object. OpenBLAS runs products of more than 262144 multiplications on
several threads, which for such small ones costs five times as much (measured: 15 µs a cell
instead of 3); and small blocks bound memory."""

KEPT_ROWS: Final = 700_000
"""Cells times joints whose solvers are kept for the second pass; about 200 bytes each. Chosen:
half of the time for a 10-minute show of 18 joints, in 140 MB."""

BISECTIONS: Final = 60
"""Halvings to find the largest square where the solver fails: to the last bit."""

PREFER_SMALL_SLOPE: Final = 1e-9
"""Weight of the slope beside the square in the objective, as in toppra: of equals, the smaller."""


@dataclass(frozen=True, slots=True)
class Cells:
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

    def block(first: int) -> _Block:
        end = min(first + size, count)
        return _Block(grid_s[first : end + 1], cells_of(first, end), caps[first : end + 1])

    kept: dict[int, _Block] = {}
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


class _Block:
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
        """Fill all but the last with the largest square from which the rest can be driven.

        Rate 0 is always possible (nothing moves), so the smallest one needs no solving.
        """
        objective = np.array([PREFER_SMALL_SLOPE, -1.0])
        following = float(upper[-1])
        for cell in range(len(self.doubled_s) - 1, -1, -1):
            found = self.solve(cell, None, objective, math.nan, math.nan, 0.0, following)[1]
            if math.isnan(found):
                found = self._largest_square(cell, following)
            upper[cell] = following = max(found, 0.0)

    def fill_squares(self, squares: FloatArray, upper: FloatArray) -> None:
        """Fill all but the first, each as large as the one before allows."""
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

    # The solver's tolerances are absolute, so that it now and then calls a stage infeasible that
    # is not, or just by rounding (toppra then lowers the rate by 0.1 %, which would be a visible
    # delay where thousands of stages run at rate 1). These two answer for it then.

    def _slopes(self, cell: int, square: float) -> tuple[float, float]:
        """Return the smallest and largest slope that the rows of a cell allow at a square."""
        rows, middles = self.rows[cell], self.tilts[cell] * square
        is_bound = rows != 0.0
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
    """Return toppra's `solve_stagewise_optim` for these cells; importing it takes a second."""
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
        """All that the solver asks of a path: how long it is, for a scale that is then 1."""

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
