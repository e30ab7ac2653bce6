"""When each key of a show can be reached at the earliest, without code of the planner.

The curves between keys are written here again, from their definitions (`smooth`, `spline`). The
motion may follow them in any way that the limits allow: ahead of the author's times inside of a
span, but at no key. On a fine grid along the path, the earliest and the latest instant are computed
at which each grid point can be reached with each of many squared rates. A key cuts off what is too
early; an anchor what is too late; a stop lets every rate follow; under a hold the motion takes at
least its length. Layers are added up from their definition; without them and alone, show and layers
must be within the limits at the author's pace (`is_legal`).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

if TYPE_CHECKING:
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Keyframe, Layer, Sequence

CELL_S: Final = 0.004
CELLS_MIN: Final = 60
"""Least number of cells between two keys."""
LEVELS: Final = 72
TRIALS: Final = 14
"""Rates at the start of a cell that are tried for each one at its end."""
STILL: Final = 1e-5
"""Slopes (deg/s) and second derivatives below this are rest."""
RATE_MAX: Final = 1e3
LEAST: Final = 1e-9
CUTS: Final = 4


@dataclass(frozen=True)
class Cells:
    """Limits of all joints at both ends of each cell: |by_start x + by_end y| <= 1."""

    at_s: np.ndarray
    by_start: np.ndarray
    by_end: np.ndarray
    top: np.ndarray
    """The squared rate at each grid point at which a joint has its largest speed."""
    is_stop: np.ndarray


def curve_of(show: Sequence, joint: str) -> list[tuple[float, float, CubicHermiteSpline]]:
    """Return the cubics of a joint between its keys, from where to where each; still elsewhere."""
    keys = [frame for frame in show.keyframes if joint in frame.deg]
    at = np.array([frame.at_s for frame in keys])
    left = at + np.array([frame.hold_s for frame in keys])
    deg = np.array([frame.deg[joint] for frame in keys])
    slopes = np.zeros(len(keys))
    along = np.concatenate([[0.0], np.cumsum(at[1:] - left[:-1])])
    if len(keys) > 2:
        if all(frame.ease == "spline" for frame in keys[1:]) and not any(k.hold_s for k in keys):
            slopes = CubicSpline(along, deg, bc_type="clamped")(along, 1)
        else:
            inner = PchipInterpolator(along, deg).derivative()(along)
            slopes = np.where([frame.hold_s > 0.0 for frame in keys], 0.0, inner)
        slopes[[0, -1]] = 0.0
    cubic = CubicHermiteSpline
    return [
        (left[k], at[k + 1], cubic([left[k], at[k + 1]], deg[k : k + 2], slopes[k : k + 2]))
        for k in range(len(keys) - 1)
    ]


def frames_of(show: Sequence) -> list[Keyframe]:
    """Return the keyframes of the show, then those of its layers, at times of the show."""
    return [
        *show.keyframes,
        *(
            replace(frame, at_s=frame.at_s + layer.from_s)
            for layer in show.layers
            for frame in layer.sequence.keyframes
        ),
    ]


def motion_of(show: Sequence, joint: str, at_s: np.ndarray, middle_s: np.ndarray) -> np.ndarray:
    """Return angle, slope and second derivative, (3, n), in the pieces around `middle_s`."""
    found = np.zeros((3, len(at_s)))
    keys = [frame for frame in show.keyframes if joint in frame.deg]
    if keys:
        found[0] = keys[0].deg[joint]
    for start, end, cubic in curve_of(show, joint) if keys else ():
        inside = (middle_s > start) & (middle_s < end)
        for order in range(3):
            found[order, inside] = cubic(at_s[inside], order)
        found[0, middle_s > end] = cubic(end)
    for layer in show.layers:
        to_s = layer.from_s + layer.sequence.keyframes[-1].at_s
        inside = (middle_s > layer.from_s) & (middle_s < to_s)
        if joint not in layer.joints or not inside.any():
            continue
        own = motion_of(
            layer.sequence, joint, at_s[inside] - layer.from_s, middle_s[inside] - layer.from_s
        )
        weight = weight_of(layer, to_s, at_s[inside], middle_s[inside])
        if layer.mode == "override":
            own -= found[:, inside]
        found[:, inside] += [
            weight[0] * own[0],
            weight[1] * own[0] + weight[0] * own[1],
            weight[2] * own[0] + 2.0 * weight[1] * own[1] + weight[0] * own[2],
        ]
    return found


def weight_of(layer: Layer, to_s: float, at_s: np.ndarray, middle_s: np.ndarray) -> np.ndarray:
    """Return the weight of a layer and its two derivatives, (3, n): smooth steps at both ends."""
    found = np.array([[layer.weight], [0.0], [0.0]]) * np.ones(len(at_s))
    for share, is_in, sign in (
        ((at_s - layer.from_s) / layer.fade_s, middle_s < layer.from_s + layer.fade_s, 1.0),
        ((to_s - at_s) / layer.fade_s, middle_s > to_s - layer.fade_s, -1.0),
    ):
        step = np.array([
            share**2 * (3.0 - 2.0 * share),
            sign * 6.0 * share * (1.0 - share) / layer.fade_s,
            (6.0 - 12.0 * share) / layer.fade_s**2,
        ])  # fmt: skip
        found[:, is_in] = layer.weight * step[:, is_in]
    return found


def is_legal(show: Sequence, robot: Robot) -> bool:
    """Return whether show and layers, each alone, keep the limits at the author's pace."""
    parts = [replace(show, layers=()), *(layer.sequence for layer in show.layers)]
    return all(bool(inside_legal_spans(p, cells_of(p, robot)).all()) for p in parts)


def cells_of(show: Sequence, robot: Robot) -> Cells:
    """Return the grid over all keys, with the limits in every cell."""
    frames = frames_of(show)
    names = sorted({name for frame in frames for name in frame.deg})
    marks = {round(t, 9) for f in frames for t in (f.at_s, f.at_s + f.hold_s)} | {0}
    for layer in show.layers:
        marks |= {round(layer.from_s + layer.fade_s, 9)}
        marks |= {round(layer.from_s + layer.sequence.keyframes[-1].at_s - layer.fade_s, 9)}
    marks = sorted(marks)
    at_s = np.append(
        np.concatenate([
            np.linspace(low, high, max(CELLS_MIN, int(np.ceil((high - low) / CELL_S))) + 1)[:-1]
            for low, high in itertools.pairwise(marks)
        ]),
        marks[-1],
    )  # fmt: skip
    step_s = np.diff(at_s)
    middle = at_s[:-1] + 0.5 * step_s
    slopes = np.zeros((2, 2, len(step_s), len(names)))
    for column, name in enumerate(names):
        for side, ends in enumerate((at_s[:-1], at_s[1:])):
            slopes[side, :, :, column] = motion_of(show, name, ends, middle)[1:]
    slopes[np.abs(slopes) < STILL] = 0.0
    speed = np.array([robot.joints[name].speed_max_deg_s for name in names])
    accel = np.array([robot.joints[name].accel_max_deg_s2 for name in names])
    half = 0.5 / step_s[:, None]
    (left, left_bend), (right, right_bend) = slopes / accel
    most = np.abs(slopes[:, 0] / speed).max(axis=2)
    at_points = np.maximum(np.append(most[0], 0.0), np.append(0.0, most[1]))
    return Cells(
        at_s=at_s,
        by_start=np.concatenate([left_bend - left * half, -right * half], axis=1),
        by_end=np.concatenate([left * half, right_bend + right * half], axis=1),
        top=np.minimum(1.0 / np.maximum(at_points, 1.0 / RATE_MAX), RATE_MAX) ** 2,
        is_stop=at_points == 0.0,
    )


def inside_legal_spans(show: Sequence, cells: Cells) -> np.ndarray:
    """Return the grid points in spans between keys in which rate 1 breaks no limit."""
    marks = {f.at_s for f in show.keyframes} | {f.at_s + f.hold_s for f in show.keyframes}
    edges = sorted({int(np.abs(cells.at_s - at_s).argmin()) for at_s in marks} | {0})
    worst = np.abs(cells.by_start + cells.by_end).max(axis=1)
    is_legal = (worst <= 1.0 + 1e-3) & (np.minimum(cells.top[:-1], cells.top[1:]) >= 1.0 - 1e-3)
    found = np.zeros(len(cells.at_s), dtype=bool)
    for low, high in itertools.pairwise(edges):
        found[low : high + 1] |= is_legal[low:high].all()
    return found


def starts_for(cells: Cells, cell: int, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest square at the start of a cell for each at its end."""
    factor, base = cells.by_start[cell], np.multiply.outer(ends, cells.by_end[cell])
    is_flat = np.abs(factor) < 1e-13
    by = np.where(is_flat, 1.0, factor)
    one, two = (-1.0 - base) / by, (1.0 - base) / by
    low = np.where(is_flat, -np.inf, np.minimum(one, two)).max(axis=-1)
    high = np.where(is_flat, np.inf, np.maximum(one, two)).min(axis=-1)
    is_over = (is_flat & (np.abs(base) > 1.0 + 1e-9)).any(axis=-1)
    return low, np.where(is_over, -np.inf, high)


def highest(cells: Cells) -> np.ndarray:
    """Return for each grid point the largest square from which the way to the end is possible."""
    top = cells.top.copy()
    for cell in range(len(top) - 2, -1, -1):
        if cells.is_stop[cell + 1]:  # Any rate may follow, but the one on this side has its own.
            trial = np.concatenate([[0.0], np.geomspace(1e-6, RATE_MAX**2, 400)])
        else:
            trial = np.linspace(0.0, top[cell + 1], 200)
        low, high = starts_for(cells, cell, trial)
        high = high[(high >= low) & (high >= 0.0)]
        top[cell] = min(top[cell], float(high.max(initial=0.0)))
    return top


class Reach:
    """Earliest and latest instants at a grid point, for `LEVELS` squared rates.

    With a `pace`, spans between keys that are within the limits at the author's pace are nowhere
    early, and nowhere faster than that.
    """

    def __init__(self, show: Sequence, robot: Robot, pace: float | None = None) -> None:
        self.show = show
        self.cells = cells_of(show, robot)
        self.legal = np.zeros(len(self.cells.at_s), dtype=bool)
        if pace is not None:
            self.legal = inside_legal_spans(show, self.cells)
            self.cells.top[self.legal] = np.minimum(self.cells.top[self.legal], pace**2)
        self.top = highest(self.cells)
        share = np.linspace(0.0, 1.0, LEVELS)
        self.shares = np.maximum(0.5 * (1.0 - np.cos(np.pi * share)), 1e-6)

    def lateness(self, tolerance_s: float = 0.0) -> list[float]:
        """Return the least lateness at each keyframe; infinite behind an anchor that is missed."""
        cells, frames = self.cells, frames_of(self.show)
        points = {float(f.at_s): int(np.abs(cells.at_s - f.at_s).argmin()) for f in frames}
        due = {point: at_s for at_s, point in points.items()}
        due |= {
            int(np.abs(cells.at_s - (f.at_s + f.hold_s)).argmin()): f.at_s + f.hold_s
            for f in frames
        }
        anchored = {points[float(f.at_s)] for f in frames if f.is_anchor}
        holds = {
            points[float(f.at_s)]: int(np.abs(cells.at_s - (f.at_s + f.hold_s)).argmin())
            for f in frames
            if f.hold_s > 0.0
        }
        least = {0: 0.0}
        early, late = np.zeros((1, LEVELS)), np.zeros((1, LEVELS))
        squares = self.shares * self._top_behind(0)
        point = 0
        while point < len(cells.at_s) - 1:
            end = holds.get(point, point + 1)
            if point in holds and end > point:
                early, late, squares = self._held(early, late, squares, (point, end))
            else:
                early, late, squares = self._cell(early, late, squares, point)
            point = end
            if point in due:
                best = float(early.min())
                least[point] = best - due[point]
            if point in due or self.legal[point]:
                due_s = float(cells.at_s[point])
                is_in = late >= due_s - LEAST
                if point in anchored:
                    is_in &= early <= due_s + tolerance_s
                    late = np.minimum(late, due_s + tolerance_s)
                early = np.where(is_in, np.maximum(early, due_s), np.inf)
                late = np.where(is_in, late, -np.inf)
                if not is_in.any():
                    break
            early, late, squares = self._behind_stop(early, late, squares, point)
        return [max(0.0, least.get(points[float(f.at_s)], np.inf)) for f in frames]

    def _top_behind(self, point: int) -> float:
        """Return the largest square at the start of the cell behind a grid point."""
        return float(self.top[point])

    def _behind_stop(
        self, early: np.ndarray, late: np.ndarray, squares: np.ndarray, point: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where no joint moves the motion may wait, and go on at any rate."""
        if not self.cells.is_stop[point]:
            return early, late, squares
        first = early.min(axis=1, keepdims=True)
        is_any = np.isfinite(first)
        early = np.repeat(first, LEVELS, axis=1)
        late = np.where(is_any, np.full(early.shape, np.inf), -np.inf)
        return early, late, self.shares * self._top_behind(point)

    def _cell(
        self, early: np.ndarray, late: np.ndarray, squares: np.ndarray, cell: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return instants and squares at the end of a cell. Rows: what each square began with."""
        cells = self.cells
        step_s = float(cells.at_s[cell + 1] - cells.at_s[cell])
        is_in = np.isfinite(early).any(axis=0)
        low_in, high_in = float(squares[is_in].min()), float(squares[is_in].max())
        most = self._end_top(cell, squares[is_in])
        ends = self.shares * most
        low, high = starts_for(cells, cell, ends)
        low, high = np.maximum(low, low_in), np.minimum(high, high_in)
        share = np.linspace(0.0, 1.0, TRIALS)
        starts = low[:, None] + (high - low)[:, None] * share
        is_good = (high >= low - 1e-12)[:, None] & np.ones_like(starts, dtype=bool)
        spent_s = (
            2.0
            * step_s
            / np.maximum(np.sqrt(np.maximum(starts, 0.0)) + np.sqrt(ends)[:, None], 1e-9)
        )
        rows = range(len(early))
        found = [np.full((len(early), LEVELS), np.inf), np.full((len(early), LEVELS), -np.inf)]
        for row in rows:
            has = np.isfinite(early[row])
            if not has.any():
                continue
            inside = (
                is_good & (starts >= squares[has][0] - 1e-12) & (starts <= squares[has][-1] + 1e-12)
            )
            first = np.interp(starts, squares[has], early[row][has]) + spent_s
            last = np.interp(starts, squares[has], np.minimum(late[row][has], 1e6)) + spent_s
            found[0][row] = np.where(inside, first, np.inf).min(axis=1)
            found[1][row] = np.where(inside, last, -np.inf).max(axis=1)
        return found[0], found[1], ends

    def _end_top(self, cell: int, starts: np.ndarray) -> float:
        """Return the largest square at the end of a cell for these at its start."""
        cells = self.cells
        factor, base = cells.by_end[cell], np.multiply.outer(starts, cells.by_start[cell])
        is_flat = np.abs(factor) < 1e-13
        by = np.where(is_flat, 1.0, factor)
        high = np.where(is_flat, np.inf, np.maximum((-1.0 - base) / by, (1.0 - base) / by))
        cap = RATE_MAX**2 if cells.is_stop[cell + 1] else float(self.top[cell + 1])
        return min(float(high.min(axis=-1).max()), cap)

    def _held(
        self, early: np.ndarray, late: np.ndarray, squares: np.ndarray, span: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return instants and squares at the end of a hold, which takes at least its length."""
        first, end = span
        hold_s = float(self.cells.at_s[end] - self.cells.at_s[first])
        if self.cells.is_stop[first : end + 1].all():
            soon = np.full((1, LEVELS), early.min() + hold_s)
            return soon, np.full((1, LEVELS), np.inf), self.shares * self._top_behind(end)
        begun = np.where(np.eye(LEVELS, dtype=bool), 0.0, np.inf)
        ended = np.where(np.eye(LEVELS, dtype=bool), 0.0, -np.inf)
        if self.cells.is_stop[first]:
            begun, ended = np.zeros((1, LEVELS)), np.full((1, LEVELS), np.inf)
            early, late = early.min(axis=1, keepdims=True), late.max(axis=1, keepdims=True)
        else:
            is_in = np.isfinite(early[0])
            begun, ended = begun[is_in], ended[is_in]
            early, late = early[:, is_in], late[:, is_in]
        for cell in range(first, end):
            begun, ended, squares = self._cell(begun, ended, squares, cell)
            begun, ended, squares = self._behind_stop(begun, ended, squares, cell + 1)
        least = np.maximum(begun, hold_s)
        is_in = (ended >= hold_s - LEAST) & np.isfinite(begun)
        soon = np.where(is_in, least + early.T, np.inf).min(axis=0, keepdims=True)
        last = np.where(is_in, ended + late.T, -np.inf).max(axis=0, keepdims=True)
        return soon, last, squares
