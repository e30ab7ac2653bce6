"""A host that does not wake when it wanted to, in virtual time."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from lss_motion.runtime.clock import VirtualClock
from lss_motion.sim.faults import FaultKind
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.sim.faults import Fault


class SleepyClock(VirtualClock):
    """Virtual time in which rows of `oversleep` make a wait end `late_s` after its instant."""

    def __init__(self, faults: Iterable[Fault], *, seed: int) -> None:
        super().__init__()
        self._faults = [fault for fault in faults if fault.kind is FaultKind.OVERSLEEP]
        self._random = Random(f"{seed}/host")

    def advance_to(self, instant_ns: int) -> None:
        if self._faults and instant_ns > self.now_ns():
            instant_ns += self._late_ns(s_from_ns(instant_ns))
        super().advance_to(instant_ns)

    def _late_ns(self, now_s: float) -> int:
        lates_s = [
            fault.late_s
            for fault in self._faults
            if fault.at_s <= now_s < fault.until_s and fault.strikes(self._random)
        ]
        return ns_from_s(max(lates_s, default=0.0))
