"""One trial as the fit sees it, and what lies between the horn of the model and a reading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.motion import Order
    from lss_motion.maintenance.identify.recording import Trial

    Array = NDArray[np.float64]

FALLING_DEG: Final = 0.05
"""Gears fall from one side to the other while the load changes by about this. Chosen: half a wire
unit, so that the fit has a slope to go along."""


@dataclass(frozen=True, slots=True)
class FitTrial:
    """One trial as the fit sees it: its readings as arrays, thinned."""

    start_deg: float
    arrived: float
    """Which way the horn last moved before: 1, -1, or 0 where nobody knows."""
    orders: tuple[Order, ...]
    times_s: Array
    readings_deg: Array


def thinned(trial: Trial, arrived: float, most: int) -> FitTrial:
    count = len(trial.times_s)
    kept = np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))
    return FitTrial(
        trial.start_deg,
        arrived,
        tuple(trial.orders),
        np.array(trial.times_s)[kept],
        np.array(trial.readings_deg)[kept],
    )


def fallen_deg(droop_deg: Array, play_deg: float) -> Array:
    """Return how much further the horn hangs since its gears lie on the side of the load."""
    fallen: Array = 0.5 * play_deg * np.tanh(droop_deg / FALLING_DEG)
    return fallen


def with_play(horn: Array, arrived: float, play_deg: float) -> Array:
    """Return where the shaft behind gears with play is: pushed along at either end of it."""
    if play_deg <= 0.0 or not len(horn):
        return horn
    half = 0.5 * play_deg
    shaft = np.empty_like(horn)
    at = float(horn[0]) - arrived * half
    for index, angle in enumerate(horn.tolist()):
        at = min(max(at, angle - half), angle + half)
        shaft[index] = at
    return shaft
