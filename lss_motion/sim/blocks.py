"""Many control loops of a bus at once, while nothing holds a horn back.

A horn that no load, jam or top speed holds back moves as its phases say, whatever the loops do:
they only measure. So the loops are owed, until one of their results is asked for. `Block` notes
the phases meanwhile, and then computes all loops in a few numpy steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from lss_motion.sim.physics import TICK_NS
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

BLOCK_NS: Final = 64 * TICK_NS
"""The loops of so long a time are owed at most. Chosen: a current or a temperature is asked for
more often, and a block stays small."""

Parabola = tuple[float, float, float]
"""Where a horn would end up: a parabola of the seconds since its phase began, in degrees."""


class Loops(NamedTuple):
    """What was measured in control loops, a row each: at the loop, or (`deg_s`) over it."""

    ns: NDArray[np.int64]
    deg: FloatArray
    deg_s: FloatArray
    gap_deg: FloatArray

    def first(self, count: int) -> Loops:
        return Loops(self.ns[:count], self.deg[:count], self.deg_s[:count], self.gap_deg[:count])


class Block:
    """What the horns do from the loop at `ns` on; its arguments are their states there.

    `deg`, `gap_deg` and `deg_s` are those at the loop at `ns`, the last one that is not owed.
    """

    def __init__(
        self,
        ns: int,
        *,
        lags_s: Sequence[float],
        began_ns: Sequence[int],
        finals: Sequence[Parabola],
        deg: Sequence[float],
        gap_deg: Sequence[float],
        deg_s: Sequence[float],
        tops_deg_s: Sequence[float],
    ) -> None:
        self.ns = ns
        self.deg, self.gap_deg, self.deg_s = np.array(deg), np.array(gap_deg), np.array(deg_s)
        self.tops_deg_s = tops_deg_s
        """Speeds that every motor reaches, whatever the others do."""
        self.last_phase_ns = ns
        """When the last phase began."""
        self.is_held = False
        """Whether a motor may hold its horn back from `last_phase_ns` on: the block must end."""
        self._lags_s = np.array(lags_s)
        self._since_ns = np.array([began_ns, [ns] * len(deg)]).T
        """When the phase of each horn began, and when its gap was as large as noted."""
        self._motion = np.column_stack([finals, gap_deg])
        self.phases: list[tuple[int, int, tuple[float, float, float, float]]] = []
        """Phases that have begun: when, of which horn, its final parabola and its gap."""
        self.looks: list[tuple[int, int, float]] = []
        """When which horn was brought to which angle: the speed of its loop counts from there. NaN:
        its phase has ended; then the loop measures only how its gap fades."""

    def loops(self, now_ns: int) -> Loops | None:
        """Return the loops that are owed up to `now_ns`; None: there are none."""
        count = (now_ns - self.ns) // TICK_NS
        if count <= 0:
            return None
        ns = self.ns + TICK_NS * np.arange(1, count + 1)
        loop_ns = ns[:, None]
        since_ns = np.repeat(self._since_ns[None], count, axis=0)
        motion = np.repeat(self._motion[None], count, axis=0)
        until_ns = int(ns[-1])
        for at_ns, index, values in self.phases:
            if at_ns <= until_ns:
                row = max(-((self.ns - at_ns) // TICK_NS) - 1, 0)
                since_ns[row:, index] = at_ns
                motion[row:, index] = values
        at_deg, by_deg_s, by_deg_s2, gap_deg = np.moveaxis(motion, 2, 0)
        phase_s = (loop_ns - since_ns[:, :, 0]) / NS_PER_S
        gap_deg = gap_deg * np.exp((since_ns[:, :, 1] - loop_ns) / NS_PER_S / self._lags_s)
        deg = (by_deg_s2 * phase_s + by_deg_s) * phase_s + at_deg + gap_deg
        loops = Loops(ns, deg, self._speeds_deg_s(ns, deg, gap_deg), gap_deg)
        self._since_ns, self._motion = since_ns[-1], motion[-1]
        self.phases = [phase for phase in self.phases if phase[0] > until_ns]
        self.looks = [look for look in self.looks if look[0] > until_ns]
        return loops

    def measured(self, loops: Loops) -> None:
        """Note that `loops` are no longer owed."""
        self.ns = int(loops.ns[-1])
        self.deg, self.deg_s, self.gap_deg = loops.deg[-1], loops.deg_s[-1], loops.gap_deg[-1]

    def _speeds_deg_s(
        self, ns: NDArray[np.int64], deg: FloatArray, gap_deg: FloatArray
    ) -> FloatArray:
        """Return how fast the horns turned since they were last brought to an instant."""
        from_ns = np.repeat((ns - TICK_NS)[:, None], len(self.deg), axis=1)
        from_deg = np.concatenate([self.deg[None], deg[:-1]])
        if self.looks:
            at_ns, indices, at_deg = map(np.array, zip(*self.looks, strict=True))
            rows = -((self.ns - at_ns) // TICK_NS) - 1
            is_within = (at_ns > self.ns) & (at_ns <= ns[-1])
            is_within &= np.isnan(at_deg) | ((at_ns - self.ns) % TICK_NS > 0)
            place = rows[is_within], indices[is_within]
            from_ns[place], from_deg[place] = at_ns[is_within], at_deg[is_within]
        passed_s = np.maximum(ns[:, None] - from_ns, 1) / NS_PER_S
        deg_s: FloatArray = np.where(
            np.isnan(from_deg), -gap_deg / self._lags_s, (deg - from_deg) / passed_s
        )
        return deg_s
