"""From rates along a path to a clock: windows, steady stretches, rests that give time back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lss_motion.trajectory.clock import Clock
from lss_motion.trajectory.keys import SAME_INSTANT_S

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.trajectory.path import Path
    from lss_motion.trajectory.solve import Window

    FloatArray = NDArray[np.float64]


class _Pieces:
    """Collects the pieces of a clock in order."""

    def __init__(self) -> None:
        self.path_s: list[FloatArray] = []
        self.spent_s: list[FloatArray] = []
        self.rates: list[FloatArray] = []
        self.slopes: list[FloatArray] = []
        self.now_s = 0.0

    def follow(self, window: Window) -> None:
        rates = np.sqrt(window.squares)
        steps_s = np.diff(window.grid_s)
        self._add(
            window.grid_s[:-1],
            2.0 * steps_s / (rates[:-1] + rates[1:]),
            rates[:-1],
            np.diff(window.squares) / (2.0 * steps_s),
        )

    def go(self, from_s: float, to_s: float, spent_s: float) -> None:
        """Follow the path at one rate, which takes `spent_s`."""
        rate = (to_s - from_s) / spent_s if spent_s > 0.0 else 0.0
        self._add(np.array([from_s]), np.array([spent_s]), np.array([rate]), np.zeros(1))

    def _add(
        self, path_s: FloatArray, spent_s: FloatArray, rates: FloatArray, slopes: FloatArray
    ) -> None:
        self.path_s.append(path_s)
        self.spent_s.append(spent_s)
        self.rates.append(rates)
        self.slopes.append(slopes)
        self.now_s += float(spent_s.sum())

    def clock(self, end_s: float) -> Clock:
        if not self.spent_s:
            self.go(end_s, end_s, 0.0)
        spent_s = np.concatenate(self.spent_s)
        return Clock(
            times_s=np.concatenate([[0.0], np.cumsum(spent_s)]),
            path_s=np.append(np.concatenate(self.path_s), end_s),
            rates=np.concatenate(self.rates),
            rate_slopes=np.concatenate(self.slopes),
        )


def authored_clock(
    path: Path,
    windows: Sequence[Window],
    seams: Sequence[int],
    authored: Callable[[FloatArray], FloatArray],
) -> Clock:
    """Return the clock that runs at rate 1 outside of `windows`, with a boundary at all `seams`.

    A rest gives up as much of itself as the motion is late when it begins. `authored` maps path
    positions to authored times.
    """
    is_rest = path.rests
    kinds = np.where(is_rest, -1, 0)
    for number, window in enumerate(windows, start=1):
        kinds[window.first : window.end] = number
    changes = 1 + np.flatnonzero(np.diff(kinds))
    bounds = np.unique(
        np.concatenate([[0], changes, np.asarray(seams, dtype=np.intp), [len(kinds)]])
    )
    pieces = _Pieces()
    followed = 0
    for first, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        from_s, to_s = float(path.knots_s[first]), float(path.knots_s[end])
        kind = int(kinds[first])
        if kind > 0:
            if kind > followed:
                pieces.follow(windows[kind - 1])
                followed = kind
            continue
        spent_s = to_s - from_s
        if kind < 0:
            begin_s, finish_s = authored(np.array([from_s, to_s])).tolist()
            if pieces.now_s - begin_s > SAME_INSTANT_S:
                spent_s = max(0.0, finish_s - pieces.now_s)
        pieces.go(from_s, to_s, spent_s)
    return pieces.clock(float(path.knots_s[-1]))


def stopping_clock(
    windows: Sequence[Window], pauses_s: Mapping[float, float], end_s: float
) -> Clock:
    """Return the clock that follows `windows` and stays at path positions for their pause."""
    pieces = _Pieces()
    for window in windows:
        _pause(pieces, float(window.grid_s[0]), pauses_s)
        pieces.follow(window)
    _pause(pieces, end_s, pauses_s)
    return pieces.clock(end_s)


def _pause(pieces: _Pieces, at_s: float, pauses_s: Mapping[float, float]) -> None:
    if (pause_s := pauses_s.get(at_s, 0.0)) > 0.0:
        pieces.go(at_s, at_s, pause_s)


def slowed(clock: Clock, ratio: float) -> Clock:
    """Return the clock with all motion slowed by `ratio`; pauses keep their length."""
    is_pause = (clock.rates == 0.0) & (clock.rate_slopes == 0.0)
    spent_s = np.diff(clock.times_s) * np.where(is_pause, 1.0, ratio)
    return Clock(
        times_s=np.concatenate([[0.0], np.cumsum(spent_s)]),
        path_s=clock.path_s,
        rates=clock.rates / ratio,
        rate_slopes=clock.rate_slopes / ratio**2,
    )


def pause_s(clock: Clock) -> float:
    """Return how long the clock stands still in all."""
    is_pause = (clock.rates == 0.0) & (clock.rate_slopes == 0.0)
    return float(np.diff(clock.times_s)[is_pause].sum())
