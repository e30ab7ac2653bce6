"""How the body goes over the ground: velocities blended into one another, integrated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.gait.curves import blend, hermite

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.gait.model import Walk

    FloatArray = NDArray[np.float64]

CELLS_PER_CYCLE: Final = 64
"""Cells of the integration. Measured: at 90 degrees a cycle and 500 mm/s, off by 1e-6 mm."""


@dataclass(frozen=True, slots=True)
class Travel:
    """Position over the ground: x, y in mm and heading in rad."""

    starts_s: FloatArray
    """When each walk begins."""
    _times_s: FloatArray
    _places: FloatArray
    _rates: FloatArray

    @property
    def duration_s(self) -> float:
        return float(self._times_s[-1])

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return x, y, heading, (n, 3), at rest before the first and after the last instant."""
        inside_s = np.clip(times_s, self._times_s[0], self._times_s[-1])
        step_s = self._times_s[1] - self._times_s[0]
        cell = ((inside_s - self._times_s[0]) / step_s).astype(np.intp)
        cell = np.clip(cell, 0, len(self._times_s) - 2)
        return hermite(
            step_s,
            (self._places[cell], self._places[cell + 1]),
            (self._rates[cell], self._rates[cell + 1]),
            (inside_s - self._times_s[cell])[:, None],
        )


def travel(walks: Sequence[Walk], cycle_s: float) -> Travel:
    """Return the way of the body over `walks`, one after the other without a stop, rest to rest.

    Every walk takes its whole cycles; its velocity is blended in over the first of them, and out
    over one more cycle at the end. So each walk covers exactly its velocity times its cycles.
    """
    twists = np.array(
        [
            (0.0, 0.0, 0.0),
            *((w.forward_mm_s, w.left_mm_s, np.radians(w.turn_deg_s)) for w in walks),
            (0.0, 0.0, 0.0),
        ]
    )
    starts_s: FloatArray = cycle_s * np.cumsum([0, *(walk.cycles for walk in walks)])

    def own(times_s: FloatArray) -> FloatArray:
        part = np.clip(np.searchsorted(starts_s, times_s, side="right") - 1, 0, len(starts_s) - 1)
        share = blend((times_s - starts_s[part]) / cycle_s)[:, None]
        return np.asarray(twists[part] * (1.0 - share) + twists[part + 1] * share)

    cells = CELLS_PER_CYCLE * (sum(walk.cycles for walk in walks) + 1)
    return integrated(own, cells=cells, cell_s=cycle_s / CELLS_PER_CYCLE, starts_s=starts_s[:-1])


def integrated(
    twist: Callable[[FloatArray], FloatArray],
    *,
    cells: int,
    cell_s: float,
    starts_s: FloatArray,
    from_s: float = 0.0,
    place: FloatArray | None = None,
) -> Travel:
    """Return the way of a body whose velocity in its own frame is `twist(times_s)`, (n, 3).

    mm/s forward and left, rad/s; from `place` (default: the origin) at `from_s` on.
    """
    begins = np.zeros(3) if place is None else place
    # Two points a cell, for Simpson's rule.
    fine_s: FloatArray = from_s + np.arange(2 * cells + 1, dtype=np.float64) * (0.5 * cell_s)
    own = twist(fine_s)
    # Headings at middles too, each from the parabola through its cell.
    heading = np.zeros(2 * cells + 1)
    left, middle, right = own[:-2:2, 2], own[1::2, 2], own[2::2, 2]
    heading[2::2] = np.cumsum(cell_s / 6.0 * (left + 4.0 * middle + right))
    heading[1::2] = heading[:-2:2] + cell_s / 24.0 * (5.0 * left + 8.0 * middle - right)
    cosine, sine = np.cos(begins[2] + heading), np.sin(begins[2] + heading)
    rates = np.stack(
        [cosine * own[:, 0] - sine * own[:, 1], sine * own[:, 0] + cosine * own[:, 1], own[:, 2]],
        axis=1,
    )
    places = np.zeros((cells + 1, 3))
    simpson = cell_s / 6.0 * (rates[:-2:2] + 4.0 * rates[1::2] + rates[2::2])
    places[1:] = np.cumsum(simpson, axis=0)
    return Travel(
        starts_s=starts_s, _times_s=fine_s[::2], _places=begins + places, _rates=rates[::2]
    )
