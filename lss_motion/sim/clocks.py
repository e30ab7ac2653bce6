"""Faults of clocks.

`Drift` converts between the instants of the host and those of the servos, whose clocks drift.
`SleepyClock` is a virtual clock for the runner of a host that wakes late.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from lss_motion.sim.faults import FaultKind
from lss_motion.system.clock import VirtualClock
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.sim.faults import Fault


PPM = 1_000_000


class Drift:
    """Converts instants as rows of `clock_drift` say. Both clocks agree at power-up."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._faults = tuple(faults)
        self._spans: list[tuple[int, int, int]] = []
        self.is_there = bool(self._faults)
        """Whether the two clocks ever differ."""

    def start(self, now_ns: int) -> None:
        self._spans = [(*fault.span_ns(now_ns), round(fault.drift_ppm)) for fault in self._faults]

    def bus_ns(self, host_ns: int) -> int:
        """Return the servos' instant; later for a later host instant."""
        ahead_ns = 0
        for from_ns, until_ns, drift_ppm in self._spans:
            passed_ns = min(host_ns, until_ns) - from_ns
            if passed_ns > 0:
                ahead_ns += passed_ns * drift_ppm // PPM
        return host_ns + ahead_ns

    def host_ns(self, bus_ns: int) -> int:
        """Return the first instant of the host at which the servos' is `bus_ns`."""
        if not self._spans:
            return bus_ns
        near_ns = bus_ns - (self.bus_ns(bus_ns) - bus_ns)
        away_ns = 1
        while not self.bus_ns(near_ns - away_ns) < bus_ns <= self.bus_ns(near_ns + away_ns):
            away_ns *= 2
        low_ns, high_ns = near_ns - away_ns, near_ns + away_ns
        while low_ns < high_ns:
            middle_ns = (low_ns + high_ns) // 2
            if self.bus_ns(middle_ns) < bus_ns:
                low_ns = middle_ns + 1
            else:
                high_ns = middle_ns
        return low_ns


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
