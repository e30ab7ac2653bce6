"""Free spans: the whole spans between keys in which the motion need not follow the author's pace.

They are those in which it has to be slow somewhere. Inside of them it may run ahead of the author's
curve, and is only not early at their keys. Where an anchor cannot be met so, all spans before it
(`URGENT_S`) and the one behind it are free, too.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.planning.trajectory.dues import EARLY_S
from lss_motion.planning.trajectory.solver import RateWindow
from lss_motion.show.splines import distinct, runs

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.dues import Dues

    FloatArray = NDArray[np.float64]

URGENT_S: Final = 3.0
"""How long before an anchor that would be late the spans are free. Chosen: longer than the motion
needs to take up speed."""

MARGIN_S: Final = 0.03
MARGIN_CELLS: Final = 2
"""Around a slow part so much is solved with it: the grid on which it was found is coarse."""


class FreeSpans(Struct, frozen=True):
    """Consecutive spans between `keys_s`, and the rates up to 1 in them."""

    window: RateWindow
    keys_s: FloatArray


def free_spans(
    windows: Sequence[RateWindow],
    stops_s: FloatArray,
    ends_s: tuple[float, float],
    dues: Dues,
    urgent_s: Sequence[float],
    *,
    is_hasty: bool,
) -> list[FreeSpans]:
    """Return the free spans around the slow parts of windows.

    `windows` have the slow parts at rates up to 1, of a path with these ends. Before the anchors
    `urgent_s` all is free, up to the key behind them, and with `is_hasty` around the seams.
    """
    cuts_s = distinct(np.concatenate([stops_s, dues.seams_s, ends_s]))
    # A hold keeps its length alone.
    keys_s = np.concatenate([dues.keys_s, dues.held.ravel(), dues.rests.ravel()])
    keys_s = keys_s[(keys_s > ends_s[0]) & (keys_s < ends_s[1])]
    keys_s = distinct(np.concatenate([keys_s, cuts_s]))
    parts = [
        part
        for window in windows
        for piece in _pieces(window, dues.seams_s)
        for part in slow_parts(piece)
    ]
    spans_s = [(part.from_s, part.to_s) for part in parts]
    for anchor_s in urgent_s:
        # One that is passed fast leads ahead of the curve, up to the key behind it.
        end = int(np.searchsorted(keys_s, anchor_s, side="right")) + (anchor_s not in cuts_s)
        inside_s = keys_s[:end][keys_s[:end] > anchor_s - URGENT_S]
        spans_s += itertools.pairwise(inside_s.tolist())
    for seam_s in dues.seams_s if is_hasty else ():
        at = int(np.searchsorted(keys_s, seam_s))
        spans_s += itertools.pairwise(keys_s[at - 1 : at + 2].tolist())
    return [
        FreeSpans(_ones_but_for(parts, from_s, to_s), keys_s[(keys_s >= from_s) & (keys_s <= to_s)])
        for from_s, to_s in _between_keys(sorted(spans_s), keys_s, cuts_s)
    ]


def _pieces(window: RateWindow, seams_s: Sequence[float]) -> Iterator[RateWindow]:
    """Yield the pieces of a window between seams, which are grid points."""
    inside_s = [seam_s for seam_s in seams_s if window.from_s < seam_s < window.to_s]
    points = [int(np.abs(window.grid_s - seam_s).argmin()) for seam_s in inside_s]
    for first, end in itertools.pairwise([0, *points, len(window.grid_s) - 1]):
        yield RateWindow(window.grid_s[first : end + 1], window.squares[first : end + 1])


def slow_parts(window: RateWindow) -> Iterator[RateWindow]:
    """Yield the parts of a window in which the rate is below 1, with a margin on both sides."""
    squares, count = window.squares, len(window.squares)
    is_near = np.zeros(count - 1, dtype=np.bool_)
    for first, end in runs(np.minimum(squares[:-1], squares[1:]) < 1.0):
        low = np.searchsorted(window.grid_s, window.grid_s[first] - MARGIN_S, side="right") - 1
        high = np.searchsorted(window.grid_s, window.grid_s[end] + MARGIN_S, side="left")
        low, high = min(low, first - MARGIN_CELLS), max(high, end + MARGIN_CELLS)
        is_near[max(low, 0) : high] = True
    for first, end in runs(is_near):
        yield RateWindow(window.grid_s[first : end + 1], squares[first : end + 1])


def _between_keys(
    spans_s: Sequence[tuple[float, float]], keys_s: FloatArray, cuts_s: FloatArray
) -> list[list[float]]:
    """Return the spans, in order, each as long as to the keys around it, joined where no cut is.

    A cut is where no joint moves, or another pass begins.
    """
    found: list[list[float]] = []
    for from_s, to_s in spans_s:
        low = float(keys_s[np.searchsorted(keys_s, from_s + EARLY_S) - 1])
        high = float(keys_s[np.searchsorted(keys_s, to_s - EARLY_S)])
        if found and (low < found[-1][1] or (low == found[-1][1] and low not in cuts_s)):
            found[-1][1] = max(found[-1][1], high)
        else:
            found.append([low, high])
    return found


def _ones_but_for(parts: Sequence[RateWindow], low_s: float, high_s: float) -> RateWindow:
    """Return a window with the squares of the parts inside, and 1 elsewhere."""
    inside = [part for part in parts if low_s <= part.from_s and part.to_s <= high_s]
    grid_s = np.concatenate([[low_s], *(part.grid_s for part in inside), [high_s]])
    squares = np.concatenate([[1.0], *(part.squares for part in inside), [1.0]])
    is_kept = np.append(True, np.diff(grid_s) > 0.0)
    return RateWindow(grid_s[is_kept], squares[is_kept])


def without(spans_s: FloatArray, others_s: FloatArray) -> FloatArray:
    """Return the parts of spans, (n, 2), that lie in no other span; all begin and end at keys."""
    found = []
    for from_s, to_s in spans_s.tolist():
        inside = others_s[(others_s[:, 1] > from_s) & (others_s[:, 0] < to_s)]
        starts_s = np.append(from_s, inside[:, 1])
        ends_s = np.append(inside[:, 0], to_s)
        is_kept = ends_s > starts_s
        found.append(np.stack([starts_s, ends_s], axis=1)[is_kept])
    return np.concatenate(found) if found else np.zeros((0, 2))
