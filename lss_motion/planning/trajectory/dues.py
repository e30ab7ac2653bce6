"""What the author wants along a path, and how late a motion is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct, field

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.solver import RateWindow

    FloatArray = NDArray[np.float64]

EARLY_S: Final = 1e-8
"""Earliness by rounding."""


class Dues(Struct, frozen=True, kw_only=True):
    """What the author wants along a path: times, holds, anchors and where lateness starts anew.

    `keys_s` has where keys are reached and left, in order. `held` has from where to where a hold
    must be kept, (n, 2), in order and apart. Within `rests`, which are held, too, as much time must
    pass as the path is long there. At `seams_s` one pass ends and the next begins. A pass does not
    make up for the lateness of another. The path begins as late as the negative `authored` there.
    """

    authored: Callable[[FloatArray], FloatArray]
    keys_s: FloatArray
    held: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    rests: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    anchors_s: tuple[float, ...] = ()
    seams_s: tuple[float, ...] = ()

    def between(self, from_s: float, to_s: float, late_s: float) -> Dues:
        """Return what the author wants between two keys, from a motion that is late at the first.

        Authored times count from where the motion on time would be at the first.
        """
        start_s = float(self.authored(np.array([from_s]))[0]) + late_s
        authored = self.authored
        return Dues(
            authored=lambda path_s: authored(path_s) - start_s,
            keys_s=self.keys_s[(self.keys_s >= from_s) & (self.keys_s <= to_s)],
            held=self.held[(self.held[:, 1] > from_s) & (self.held[:, 0] < to_s)],
            rests=self.rests[(self.rests[:, 1] > from_s) & (self.rests[:, 0] < to_s)],
            anchors_s=tuple(at_s for at_s in self.anchors_s if from_s < at_s <= to_s),
        )

    def spent(self, from_s: float, to_s: float) -> float:
        """Return the authored time between two positions."""
        start_s, end_s = self.authored(np.array([from_s, to_s])).tolist()
        return float(end_s - start_s)

    def begins_late_s(self, start_s: float) -> float:
        """Return how late the motion is where the path begins."""
        return max(0.0, -float(self.authored(np.array([start_s]))[0]))

    def lateness(self, window: RateWindow, late_s: float) -> FloatArray:
        """Return how late the motion is at each grid point, if it is `late_s` at the first."""
        authored_s = self.authored(window.grid_s)
        passed_s = np.concatenate([[0.0], np.cumsum(window.spent_s)])
        return np.asarray(late_s + passed_s - (authored_s - authored_s[0]))

    def is_held(self, from_s: float, to_s: float) -> bool:
        """Return whether a hold covers these positions, between which no hold starts or ends."""
        return _covers(self.held, from_s, to_s)

    def least_s(self, from_s: float, to_s: float) -> float:
        """Return how long the motion takes at least between two positions as in `is_held`."""
        if _covers(self.rests, from_s, to_s):
            return max(to_s - from_s, self.spent(from_s, to_s))
        return self.spent(from_s, to_s) if self.is_held(from_s, to_s) else 0.0


def _covers(spans: FloatArray, from_s: float, to_s: float) -> bool:
    middle_s = 0.5 * (from_s + to_s)
    return bool(((spans[:, 0] < middle_s) & (middle_s < spans[:, 1])).any())
