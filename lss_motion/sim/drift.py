"""Two clocks that do not agree: the host's instants and the servos'."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.sim.faults import Fault

PPM = 1_000_000


class Drift:
    """What rows of `clock_drift` make of time. Both clocks agree at power-up."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._faults = tuple(faults)
        self._spans: list[tuple[int, int, int]] = []

    def start(self, now_ns: int) -> None:
        self._spans = [(*fault.span_ns(now_ns), round(fault.drift_ppm)) for fault in self._faults]

    def bus_ns(self, host_ns: int) -> int:
        """Return the servos' instant; later for a later host instant."""
        if not self._spans:
            return host_ns
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
