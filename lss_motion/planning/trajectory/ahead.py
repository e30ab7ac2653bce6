"""Running ahead of the author's curve between two keys, on time at the second one.

Where a limit binds in a span between keys, the motion is as fast as the limits allow, and as much
slower elsewhere that it is not early at the key. It passes the key at the same rate as the fastest
motion, so that what comes behind it does not change.

All limits are linear in the squared rates and allow rate 0. Hence every mixture of two motions that
keep them, and the larger one at each point, keeps them, too, as long as the fastest motion is
nowhere slower. `slowest_squares` are the least rates from one rate to another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.planning.trajectory.braking import Brakes, mixed
from lss_motion.planning.trajectory.dues import EARLY_S
from lss_motion.planning.trajectory.solver import RATE_SLACK, RateWindow, is_legal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.dues import Dues
    from lss_motion.planning.trajectory.solver import RateTask

    FloatArray = NDArray[np.float64]

CELL_S: Final = 0.004
"""Longest cell of a span that is made slower: the limits hold at the ends of cells. Chosen: an
excess inside of them goes with the square of the length, and is 0.28 % with 25 ms."""

CELL_LEAST_S: Final = 0.001
"""Cells are halved down to this where they exceed a limit. Measured: once in 400 random shows, by
0.006 % too much."""

FLOOR_RATIO: Final = 0.01
"""The least squared rates are at least this share of those up to 1, so that times are finite."""


class KeptKeys(Struct, frozen=True):
    """A motion that is early at no key of its spans: for each span, the key at its end.

    `late_s` has how late the key is, `is_slowed` whether it would have been early, `squares` the
    squared rate there. `calm` has the rates up to 1, if they were needed.
    """

    window: RateWindow
    at_s: FloatArray
    late_s: FloatArray
    is_slowed: NDArray[np.bool_]
    squares: FloatArray
    calm: RateWindow | None

    def hasty_s(self, stops_s: frozenset[float]) -> tuple[float, ...]:
        """Return the keys that are passed faster than authored although there is time."""
        is_hasty = self.is_slowed & (self.squares > 1.0 + RATE_SLACK)
        return tuple(at_s for at_s in self.at_s[is_hasty].tolist() if at_s not in stops_s)


def kept_keys(
    task: RateTask,
    fastest: RateWindow,
    calm: RateWindow | None,
    spans_s: FloatArray,
    dues: Dues,
    late_s: float,
) -> KeptKeys | tuple[float, float] | None:
    """Return the motion with each span so slow that the key at its end is not early.

    It is `late_s` late at its start. A span under a hold takes at least its time. `calm`
    has the rates up to 1. If a span cannot be slow enough, the two keys around it are returned:
    they are passed too fast. None: `calm` is needed.
    """
    points = [int(np.abs(fastest.grid_s - at_s).argmin()) for at_s in spans_s.ravel()]
    spent_s = np.append(0.0, np.cumsum(fastest.spent_s))
    made: list[RateWindow] = []
    late, slowed = [], []
    now_s, low = late_s, 0
    for (from_s, to_s), first, end in zip(spans_s.tolist(), points[::2], points[1::2], strict=True):
        now_s += float(spent_s[first] - spent_s[low]) - dues.spent(_at(fastest, low), from_s)
        made.append(_part(fastest, low, first))
        part, low = _part(fastest, first, end), end
        due_s = dues.spent(from_s, to_s)
        floor_s = max(0.0, now_s + dues.least_s(from_s, to_s) - due_s)
        reached_s = now_s + float(spent_s[end] - spent_s[first]) - due_s
        is_early = reached_s < floor_s - EARLY_S
        if is_early:
            if calm is None:
                return None
            found = _lasting(task, part, calm, due_s + floor_s - now_s)
            if found is None:
                return from_s, to_s
            part, reached_s = found, floor_s
        made.append(part)
        now_s = reached_s
        late.append(reached_s)
        slowed.append(is_early)
    made.append(_part(fastest, low, len(fastest.grid_s) - 1))
    window = RateWindow(
        np.append(np.concatenate([part.grid_s[:-1] for part in made]), fastest.grid_s[-1]),
        np.append(np.concatenate([part.squares[:-1] for part in made]), fastest.squares[-1]),
    )
    ends = points[1::2]
    return KeptKeys(
        window, spans_s[:, 1], np.array(late), np.array(slowed), fastest.squares[ends], calm
    )


def _at(window: RateWindow, point: int) -> float:
    return float(window.grid_s[point])


def _part(window: RateWindow, first: int, end: int) -> RateWindow:
    return RateWindow(window.grid_s[first : end + 1], window.squares[first : end + 1])


def _lasting(
    task: RateTask,
    fastest: RateWindow,
    calm: RateWindow,
    wanted_s: float,
    cell_s: float = CELL_S,
) -> RateWindow | None:
    """Return a motion that lasts that long, with the rates of `fastest` at both ends.

    It is a mixture of `fastest` and a motion that is close to `calm`; if even that is too short, of
    the latter and the slowest one. None: the slowest one is too short, or limits do not hold.
    """
    counts = np.ceil(np.diff(fastest.grid_s) / cell_s).astype(np.intp)
    steps_s = np.repeat(np.diff(fastest.grid_s) / counts, counts)
    within = np.arange(len(steps_s)) - np.repeat(np.cumsum(counts) - counts, counts)
    grid_s = np.append(np.repeat(fastest.grid_s[:-1], counts) + within * steps_s, fastest.to_s)
    largest = np.interp(grid_s, fastest.grid_s, fastest.squares)
    whole = RateWindow(grid_s, largest)
    near = np.minimum(np.interp(grid_s, calm.grid_s, calm.squares), largest)
    slowest = RateWindow(grid_s, slowest_squares(task, whole, FLOOR_RATIO * near))
    slower, faster = RateWindow(grid_s, np.maximum(slowest.squares, near)), whole
    if slower.duration_s < wanted_s:
        slower, faster = slowest, slower
    if slower.duration_s < wanted_s:
        return None
    found = mixed(slower, faster, lambda window: window.duration_s - wanted_s)
    if is_legal(task, found, 0):
        return found
    finer_s = 0.5 * cell_s
    return None if finer_s < CELL_LEAST_S else _lasting(task, fastest, calm, wanted_s, finer_s)


def slowest_squares(task: RateTask, fastest: RateWindow, floor: FloatArray) -> FloatArray:
    """Return the least squared rates above `floor` with those of `fastest` at both ends."""
    last = len(fastest.grid_s) - 1
    brakes = Brakes(task, fastest, 0, last)
    squares = floor.copy()
    least = float(fastest.squares[0])
    for cell, (width, tilt) in enumerate(zip(*brakes.bounds_behind(), strict=True)):
        squares[cell] = max(least, squares[cell])
        least = float((-width - tilt * least).max())
        if least <= squares[cell + 1]:
            break
    least = float(fastest.squares[last])
    for cell in range(last - 1, -1, -1):
        squares[cell + 1] = max(least, squares[cell + 1])
        least = float((-brakes.width[cell] - brakes.tilt[cell] * least).max())
        if least <= squares[cell]:
            break
    squares[[0, last]] = fastest.squares[[0, last]]
    return squares
