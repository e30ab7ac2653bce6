"""The motion of one joint that is closest to a wanted one, within its limits: a convex problem.

The motion is a uniform cubic B-spline over cells of equal length. Its speed, acceleration and jerk
are bounded by the first, second and third differences of its coefficients, and its angle by the
coefficients themselves, so the limits hold at every instant and not only at samples. Minimised is
the squared deviation over time, and a little of the squared acceleration, without which the
acceleration would switch between both limits ever faster behind each place where a limit binds.

Clarabel solves it. It is imported here only, and only when a problem is to be solved.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import PlanningError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

SMOOTHING_S: Final = 0.02
"""Weight of the acceleration, as a time. Measured on fingers: half as many switches of the
acceleration, and 0.02 % more deviation; with 0.05 s the deviation of speech grows by 4 %."""

PRICE_DEG: Final = 1e5
"""Linear price of a degree by which a tie is missed where ties may be. Measured: 100 misses ties
that can be met; this one does not."""

TIE_SLACK_DEG: Final = 0.01
"""A tie that is missed by less is met: a tenth of the finest unit of an LSS."""

NEAR_RANGE_RATIO: Final = 0.25
"""Rows for a range limit are given at once if the wanted angles come nearer to it than this share
of their span; else only if the solution needs them. They are a third of all rows."""

NEAR_SPEED_RATIO: Final = 0.7
"""The same for the speed limit, as a share of it."""

_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(4)
GAUSS_SHARES: Final = 0.5 * (_NODES + 1.0)
"""Where the deviation is sampled in each cell, as shares of the cell."""

GAUSS_WEIGHTS: Final = 0.5 * _NODE_WEIGHTS
"""Weights of these samples; their sum is 1."""


def basis(shares: FloatArray) -> FloatArray:
    """Return the weights of the four coefficients of a cell at shares of its length, (n, 4)."""
    u = np.asarray(shares, dtype=np.float64)
    rest = 1.0 - u
    return np.stack(
        [
            rest**3 / 6.0,
            (3.0 * u**3 - 6.0 * u**2 + 4.0) / 6.0,
            (3.0 * rest**3 - 6.0 * rest**2 + 4.0) / 6.0,
            u**3 / 6.0,
        ],
        axis=-1,
    )


def basis_slope(shares: FloatArray) -> FloatArray:
    """Return the derivative of `basis` by the share, (n, 4)."""
    u = np.asarray(shares, dtype=np.float64)
    rest = 1.0 - u
    return np.stack(
        [
            -0.5 * rest**2,
            0.5 * (3.0 * u**2 - 4.0 * u),
            -0.5 * (3.0 * rest**2 - 4.0 * rest),
            0.5 * u**2,
        ],
        axis=-1,
    )


class Bounds(Struct, frozen=True, kw_only=True):
    """The limits of one joint."""

    low_deg: float
    high_deg: float
    speed_deg_s: float
    accel_deg_s2: float
    jerk_deg_s3: float = math.inf


class Tie(Struct, frozen=True, kw_only=True):
    """An angle, speed or acceleration (`order` 0, 1, 2) that the motion must have at an instant.

    With `same_as_s` the motion must have there what it has at that other instant, and `value` is
    not used. `slack_deg` is how far it may be off.
    """

    at_s: float
    value: float = 0.0
    order: int = 0
    same_as_s: float | None = None
    slack_deg: float = 0.0


class Pull(Struct, frozen=True, kw_only=True):
    """An angle at an instant, whose squared deviation counts `weight_s` seconds more."""

    at_s: float
    deg: float
    weight_s: float


class Wanted(Struct, frozen=True, kw_only=True):
    """The wanted motion over `cells` cells of `cell_s`, from `from_s` on.

    `deg` has its angles at the Gauss points of each cell, (cells, 4), `weights` how much each
    counts. `may_miss` are ties that are priced instead of required. `accel_shares` are the shares
    of the acceleration limit that may be used at the ends of the cells; None: all of it.
    """

    from_s: float
    cell_s: float
    deg: FloatArray
    weights: FloatArray
    speed_peak_deg_s: float
    ties: tuple[Tie, ...] = ()
    may_miss: tuple[Tie, ...] = ()
    pulls: tuple[Pull, ...] = ()
    accel_shares: FloatArray | None = None

    @property
    def cells(self) -> int:
        return len(self.deg)


class Closest(Struct, frozen=True):
    """The coefficients of the closest motion, and by how much each of `may_miss` is missed."""

    coefficients: FloatArray
    missed_deg: FloatArray

    def accels(self, cell_s: float) -> FloatArray:
        """Return the acceleration at the ends of the cells, between which it is linear."""
        return np.asarray(np.diff(self.coefficients, 2) / cell_s**2)

    def cubics(self, cell_s: float) -> FloatArray:
        """Return the cubics of the cells in rising powers of the time in the cell, (cells, 4)."""
        c0, c1, c2, c3 = (self.coefficients[k : len(self.coefficients) - 3 + k] for k in range(4))
        return np.stack(
            [
                (c0 + 4.0 * c1 + c2) / 6.0,
                (c2 - c0) / (2.0 * cell_s),
                (c0 - 2.0 * c1 + c2) / (2.0 * cell_s**2),
                (c3 - 3.0 * c2 + 3.0 * c1 - c0) / (6.0 * cell_s**3),
            ],
            axis=1,
        )


def closest(wanted: Wanted, bounds: Bounds) -> Closest | None:
    """Return the motion closest to `wanted` within `bounds`; None if no motion has all ties."""
    rows = _ProblemRows(wanted, bounds)
    while True:
        found = _solved(wanted, rows)
        if found is None or not rows.add_missing(found.coefficients):
            return found


class _ProblemRows:
    """The rows of the problem: limits, of which those that cannot bind are left out, and ties."""

    def __init__(self, wanted: Wanted, bounds: Bounds) -> None:
        self.wanted = wanted
        self.origin_deg = float(wanted.deg.mean())
        span_deg = float(np.ptp(wanted.deg))
        reach_deg = NEAR_RANGE_RATIO * span_deg
        step = bounds.speed_deg_s * wanted.cell_s
        shares = 1.0 if wanted.accel_shares is None else wanted.accel_shares
        bend = bounds.accel_deg_s2 * wanted.cell_s**2 * shares
        low_deg, high_deg = bounds.low_deg - self.origin_deg, bounds.high_deg - self.origin_deg
        self.kinds: dict[str, tuple[int, float | FloatArray, float | FloatArray]] = {
            "bend": (2, -bend, bend),
            "step": (1, -step, step),
            "low": (0, low_deg, np.inf),
            "high": (0, -np.inf, high_deg),
        }
        self.given = {"bend"}
        if math.isfinite(bounds.jerk_deg_s3):
            sway = bounds.jerk_deg_s3 * wanted.cell_s**3
            self.kinds["sway"] = (3, -sway, sway)
            self.given.add("sway")
        if wanted.speed_peak_deg_s > NEAR_SPEED_RATIO * bounds.speed_deg_s:
            self.given.add("step")
        if wanted.deg.min() - reach_deg < bounds.low_deg:
            self.given.add("low")
        if wanted.deg.max() + reach_deg > bounds.high_deg:
            self.given.add("high")

    def add_missing(self, coefficients: FloatArray) -> bool:
        """Add the limits that a solution breaks because they were left out; False if none."""
        missing = set()
        for kind, (order, low, high) in self.kinds.items():
            values = np.diff(coefficients, order)
            values = values - self.origin_deg if order == 0 else values
            if kind not in self.given and ((values < low) | (values > high)).any():
                missing.add(kind)
        self.given |= missing
        return bool(missing)

    def limits(self) -> tuple[list[Any], list[FloatArray]]:
        """Return matrices M and columns b with M c <= b for the limits."""
        matrices, rights = [], []
        count = self.wanted.cells + 3
        for kind in sorted(self.given):
            order, low, high = self.kinds[kind]
            matrix = _differences(count, order)
            for sign, bound in ((1.0, high), (-1.0, -low)):
                if np.isfinite(bound).all():
                    matrices.append(sign * matrix)
                    rights.append(np.broadcast_to(bound, count - order))
        return matrices, rights

    def ties(self, ties: Iterable[Tie]) -> tuple[Any, FloatArray, FloatArray]:
        """Return matrix M, column b and slack of each tie: M c = b, within the slack."""
        rights, slacks = [], []
        rows: list[int] = []
        columns: list[int] = []
        values: list[float] = []
        for row, tie in enumerate(ties):
            for at_s, sign in ((tie.at_s, 1.0), (tie.same_as_s, -1.0)):
                if at_s is None:
                    continue
                first, weights = self.coefficients_at(at_s, tie.order)
                rows += [row] * 4
                columns += range(first, first + 4)
                values += (sign * weights).tolist()
            is_angle = tie.same_as_s is None and tie.order == 0
            right = tie.value if tie.same_as_s is None else 0.0
            rights.append(right - self.origin_deg if is_angle else right)
            slacks.append(tie.slack_deg)
        from scipy import sparse

        shape = (len(rights), self.wanted.cells + 3)
        matrix = sparse.csr_matrix((values, (rows, columns)), shape=shape)
        return matrix, np.array(rights), np.array(slacks)

    def coefficients_at(self, at_s: float, order: int) -> tuple[int, FloatArray]:
        """Return the first of the four coefficients that count at an instant, and their weights."""
        wanted = self.wanted
        place = (at_s - wanted.from_s) / wanted.cell_s
        cell = min(max(int(place), 0), wanted.cells - 1)
        share = np.array(min(max(place - cell, 0.0), 1.0))
        match order:
            case 0:
                return cell, basis(share)
            case 1:
                return cell, basis_slope(share) / wanted.cell_s
            case _:
                bend = np.array([1.0 - share, 3.0 * share - 2.0, 1.0 - 3.0 * share, share])
                return cell, bend / wanted.cell_s**2


def _differences(count: int, order: int) -> Any:  # noqa: ANN401  scipy is untyped here
    """Return the matrix of the differences of that order of `count` numbers."""
    from scipy import sparse

    stencil = ((1.0,), (-1.0, 1.0), (1.0, -2.0, 1.0), (-1.0, 3.0, -3.0, 1.0))[order]
    return sparse.diags_array(
        stencil, offsets=range(order + 1), shape=(count - order, count), format="csr"
    )


def _quadratic(wanted: Wanted, rows: _ProblemRows) -> tuple[Any, FloatArray]:
    """Return the upper half of P and q of the cost c'Pc / 2 + q'c, divided by `cell_s`."""
    from scipy import sparse

    count, cell_s = wanted.cells + 3, wanted.cell_s
    shapes = basis(GAUSS_SHARES)
    weights = wanted.weights * GAUSS_WEIGHTS
    blocks = np.einsum("cg,gi,gj->cij", weights, shapes, shapes, optimize=True)
    pulls = (weights * (wanted.deg - rows.origin_deg)) @ shapes
    linear = np.zeros(count)
    bands = [np.zeros(count - offset) for offset in range(4)]
    for one in range(4):
        linear[one : one + wanted.cells] -= pulls[:, one]
        for other in range(one, 4):
            bands[other - one][one : one + wanted.cells] += blocks[:, one, other]
    for pull in wanted.pulls:
        first, shape = rows.coefficients_at(pull.at_s, 0)
        share = pull.weight_s / cell_s
        linear[first : first + 4] -= share * (pull.deg - rows.origin_deg) * shape
        for offset in range(4):
            bands[offset][first : first + 4 - offset] += (
                share * shape[: 4 - offset] * shape[offset:]
            )
    bend = _differences(count, 2)
    square = (SMOOTHING_S / cell_s) ** 4 * (bend.T @ bend)
    banded = sparse.diags_array(bands, offsets=range(4), shape=(count, count))
    return sparse.csc_matrix(sparse.triu(banded + square)), linear


def _solved(wanted: Wanted, rows: _ProblemRows) -> Closest | None:
    """Return the solution with the rows that are given; None if there is none."""
    from scipy import sparse

    count, priced = wanted.cells + 3, len(wanted.may_miss)
    square, linear = _quadratic(wanted, rows)
    matrices, rights = rows.limits()
    required = [tie for tie in wanted.ties if tie.slack_deg == 0.0]
    equal, equal_right, _ = rows.ties(required)
    near, near_right, near_slack = rows.ties(tie for tie in wanted.ties if tie.slack_deg > 0.0)
    matrices += [near, -near]
    rights += [near_right + near_slack, near_slack - near_right]
    bounded = sparse.vstack(matrices, format="csr")
    if priced:
        miss, miss_right, miss_slack = rows.ties(wanted.may_miss)
        unit = sparse.eye_array(priced, format="csr")
        bounded = sparse.block_array(
            [[bounded, None], [miss, -unit], [-miss, -unit], [None, -unit]], format="csr"
        )
        rights += [miss_right + miss_slack, miss_slack - miss_right, np.zeros(priced)]
        equal = sparse.hstack([equal, sparse.csr_matrix((len(required), priced))])
        square = sparse.block_diag([square, sparse.csc_matrix((priced, priced))], format="csc")
        linear = np.append(linear, np.full(priced, PRICE_DEG))
    matrix = sparse.csc_matrix(sparse.vstack([equal, bounded]))
    right = np.concatenate([equal_right, *rights])
    solution = _minimum(square, linear, (matrix, right), len(required))
    if solution is None:
        return None
    return Closest(solution[:count] + rows.origin_deg, solution[count:])


def _minimum(
    square: Any,  # noqa: ANN401  scipy is untyped here
    linear: FloatArray,
    constraints: tuple[Any, FloatArray],
    equal_count: int,
) -> FloatArray | None:
    """Return the minimum of a convex problem, whose first rows are equations; None: infeasible."""
    clarabel = solver()
    matrix, right = constraints
    cones = [clarabel.ZeroConeT(equal_count)] if equal_count else []
    cones.append(clarabel.NonnegativeConeT(len(right) - equal_count))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    found = clarabel.DefaultSolver(square, linear, matrix, right, cones, settings).solve()
    status = str(found.status)
    if status in ("Solved", "AlmostSolved"):
        return np.array(found.x)
    if status in ("PrimalInfeasible", "AlmostPrimalInfeasible"):
        return None
    raise PlanningError(f"the solver of keep: time ended with {status}; please report the file")


def solver() -> Any:  # noqa: ANN401  Clarabel is untyped
    """Return the module `clarabel`; raise `PlanningError` where it is not installed."""
    try:
        import clarabel
    except ImportError:
        raise PlanningError(
            "keep: time needs the solver Clarabel, which is not installed; run `pip install "
            "clarabel`, or remove keep: time"
        ) from None
    return clarabel
