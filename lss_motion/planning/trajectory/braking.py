"""Braking in closed form: back to the author's pace exactly where a motion is on time.

A motion that is late goes as fast as it can and would soon be early. `braked` finds where it must
begin to brake, without another solution of the whole: all limits are linear in the squared rates,
so that each row of a cell bounds one end by the other, and every mixture of two legal motions is
legal. One of the two is late at that instant and the other early.

`hasty_square` says how fast a seam can be passed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.planning.trajectory.solver import (
    FEASIBLE_RATIO,
    RATE_SLACK,
    RateWindow,
    is_legal,
    solve,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.solver import RateTask

    FloatArray = NDArray[np.float64]
    BoolArray = NDArray[np.bool_]

REACH_S: Final = 0.6
"""Braking begins at most this long before it ends. Measured: from rate 2 it takes up to 0.4 s."""

CELLS_MAX: Final = 64
"""Grid points that are tried as the end of braking."""

MARGIN_CELLS: Final = 2
"""Braking ends so many cells before a slow part, which is solved again on another grid."""

LATE_MIN_S: Final = 1e-5
"""A motion that is less late where braking ends is on time."""

SEAM_REACH_S: Final = 3.0
"""So much around a seam decides how fast it can be passed. Chosen: longer than the motion needs to
take up speed."""

NO_ROW: Final = 1e-12
"""A row with a smaller factor does not depend on the square."""

MIX_STEPS: Final = 60
"""Steps to find a mixture. Measured: at most 12."""


class Brakes:
    """The squared rates from which, and to which, a window can go with rate 1 at a grid point.

    Covers the cells from `low` to before `high`.
    """

    def __init__(self, task: RateTask, window: RateWindow, low: int, high: int) -> None:
        points_s = window.grid_s[low : high + 1]
        segments = task.path.segments_of(0.5 * (points_s[:-1] + points_s[1:]))
        limits = task.accel_limits_deg_s2(segments) * FEASIBLE_RATIO
        left, left_bend = task.slopes(points_s[:-1], segments)
        right, right_bend = task.slopes(points_s[1:], segments)
        doubled_s = 2.0 * np.diff(points_s)[:, None]
        left, right = left / limits / doubled_s, right / limits / doubled_s
        self.by_start = np.concatenate([left_bend / limits - left, -right], axis=1)
        self.by_end = np.concatenate([left, right + right_bend / limits], axis=1)
        self.width, self.tilt = _bounds(self.by_start, self.by_end)
        self.squares = window.squares
        self.low = low

    def bounds_behind(self, first: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return width and tilt of the square at the end of each cell from `first` on."""
        return _bounds(self.by_end[first:], self.by_start[first:])

    def before(self, at: int) -> FloatArray | None:
        """Return the squares up to grid point `at`, 1 there; None if that cannot be reached."""
        square = 1.0
        falling = [square]
        for point in range(at - 1, self.low - 1, -1):
            width, middle = self.width[point - self.low], self.tilt[point - self.low] * square
            square = float((width - middle).min())
            if square < float((-width - middle).max()) or square < 1.0:
                return None
            if square >= self.squares[point]:
                return np.concatenate([self.squares[: point + 1], falling[::-1]])
            falling.append(square)
        return None

    def after(self, at: int, slow: int) -> FloatArray | None:
        """Return the squares behind grid point `at`, 1 there, up to where they are the window's.

        They do not exceed 1 before grid point `slow`. None: the window is not met.
        """
        width, tilt = self.bounds_behind(at - self.low)
        square = 1.0
        found = []
        for cell in range(len(width)):
            point, middle = at + cell + 1, tilt[cell] * square
            bound = float(self.squares[point])
            most = bound if point >= slow else min(1.0, bound)
            square = min(float((width[cell] - middle).min()), most)
            if square < float((-width[cell] - middle).max()) or square <= 0.0:
                return None
            found.append(square)
            if square >= bound:
                return np.array(found)
        return None


def _bounds(by_one: FloatArray, by_other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return width and tilt: |one + tilt · other| ≤ width at both ends of a cell."""
    is_bound = np.abs(by_one) > NO_ROW
    inverse = np.divide(1.0, by_one, out=np.zeros_like(by_one), where=is_bound)
    return np.where(is_bound, np.abs(inverse), math.inf), by_other * inverse


def braked(
    task: RateTask,
    whole: RateWindow,
    early: int,
    lateness: Callable[[RateWindow], FloatArray],
    is_due: BoolArray,
) -> RateWindow | None:
    """Return `whole` with brakes, so that it is not early at grid point `early`, the first such.

    The window ends where the motion is on time, at rate 1. If it has to be slow before that could
    be, it is as long as `whole`, and on time for an instant before that slow part. None: there is
    no such motion in closed form. `lateness` returns that of a window on the first grid points of
    `whole`; it counts at those that are due.
    """

    def least_s(window: RateWindow) -> float:
        late_s = lateness(window)
        return float(late_s[is_due[: len(late_s)]].min(initial=math.inf))

    grid_s, end = whole.grid_s, len(whole.grid_s) - 1
    high = min(end, early + CELLS_MAX)
    slow = early - 1 + int(np.argmax(whole.squares[early - 1 : high + 1] < 1.0 - RATE_SLACK))
    is_slow = whole.squares[slow] < 1.0 - RATE_SLACK
    last = slow - 1 - MARGIN_CELLS if is_slow else high
    if last < 1:
        return None
    low = max(0, int(np.searchsorted(grid_s, grid_s[min(early, last)] - REACH_S)) - 1)
    brakes = Brakes(task, whole, low, high)
    found = _around(brakes, whole, (early, last), lateness)
    if found is None:
        return None
    faster, slower = found
    if faster is None:
        more = brakes.after(last, slow) if is_slow else None
        if more is None:
            return None
        squares = np.concatenate([slower.squares, more])
        until = len(squares)
        slower = RateWindow(grid_s[:until], squares)
        faster = RateWindow(grid_s[:until], whole.squares[:until])
    else:
        until = len(faster.grid_s)
        ones = np.ones(until - len(slower.grid_s))
        slower = RateWindow(faster.grid_s, np.append(slower.squares, ones))
    first = int(np.argmax(slower.squares < whole.squares[:until]))
    mixture = mixed(slower, faster, least_s)
    if not is_legal(task, mixture, max(0, first - 1)):
        return None
    if found[0] is None:
        return RateWindow(grid_s, np.append(mixture.squares, whole.squares[until:]))
    return mixture if lateness(mixture)[-1] < LATE_MIN_S else None


def _around(
    brakes: Brakes,
    whole: RateWindow,
    bounds: tuple[int, int],
    lateness: Callable[[RateWindow], FloatArray],
) -> tuple[RateWindow | None, RateWindow] | None:
    """Return the motions that brake to two neighbouring grid points, early with one, late after it.

    `bounds`: the first grid point at which the motion is early, and the last one to which it may
    brake. The early motion is None if it is late even there; the result is None if there is none.
    """
    early, last = bounds
    unbraked_s = lateness(whole)

    def late(at: int) -> tuple[float, RateWindow | None]:
        squares = brakes.before(at)
        if squares is None:
            return math.nan, None
        window = RateWindow(whole.grid_s[: at + 1], squares)
        return float(lateness(window)[-1]), window

    at = min(early, last)
    late_s, found = late(at)
    if found is None:
        return None
    # Braking costs about the same time everywhere near.
    costs_s = late_s - float(unbraked_s[at])
    is_early = unbraked_s[at : last + 1] + costs_s <= 0.0
    at = at + int(np.argmax(is_early)) if is_early.any() else last
    late_s, found = late(at)
    step = 1 if late_s > 0.0 else -1
    while found is not None:
        before_s, before = late_s, found
        at += step
        if at > last:
            return None, before
        if at < max(1, early - 1):
            return None
        late_s, found = late(at)
        if found is not None and (late_s > 0.0) != (before_s > 0.0):
            return (found, before) if step > 0 else (before, found)
    return None


def mixed(
    slower: RateWindow, faster: RateWindow, least_s: Callable[[RateWindow], float]
) -> RateWindow:
    """Return the fastest mixture of two windows with the same ends that is nowhere early.

    `least_s` returns the least lateness of a window.
    """
    grid_s = np.union1d(slower.grid_s, faster.grid_s)
    from_squares = np.interp(grid_s, slower.grid_s, slower.squares)
    growth = np.interp(grid_s, faster.grid_s, faster.squares) - from_squares

    def mixture(share: float) -> RateWindow:
        return RateWindow(grid_s, from_squares + share * growth)

    low, high, at_low, at_high = 0.0, 1.0, least_s(slower), least_s(faster)
    if at_high >= 0.0:
        return mixture(1.0)
    # Regula falsi with the Illinois rule: the value that stays twice in a row is halved.
    side = 0
    for _ in range(MIX_STEPS):
        share = low + (high - low) * at_low / (at_low - at_high) if at_low > 0.0 else low
        found = least_s(mixture(share))
        if abs(found) < 1e-12 or share in (low, high):
            return mixture(share)
        if found > 0.0:
            low, at_low, at_high, side = share, found, at_high * (0.5 if side > 0 else 1.0), 1
        else:
            high, at_high, at_low, side = share, found, at_low * (0.5 if side < 0 else 1.0), -1
    return mixture(low)


def square_at(windows: Sequence[RateWindow], at_s: float) -> float:
    """Return the squared rate at a position, 1 outside of the windows."""
    for window in windows:
        if window.from_s <= at_s <= window.to_s:
            return float(np.interp(at_s, window.grid_s, window.squares))
    return 1.0


def hasty_square(task: RateTask, stops_s: FloatArray, seam_s: float, rate_max: float) -> float:
    """Return the largest squared rate at a seam, for which its surroundings are enough."""
    from_s = max(seam_s - SEAM_REACH_S, float(stops_s[stops_s <= seam_s].max()))
    to_s = min(seam_s + SEAM_REACH_S, float(stops_s[stops_s >= seam_s].min()))
    hasty = replace(task, rate_max=rate_max, knot_caps={})
    return square_at([solve(hasty, from_s, to_s)], seam_s)
