"""The simulated bus as a port of the runner: `sim://`, in real or in virtual time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.errors import BusError, LostPortError

if TYPE_CHECKING:
    from lss_motion.runtime.clock import Clock
    from lss_motion.sim.bus import SimBus


class SimPort:
    """A `SimBus` read and written at the instants of `clock`.

    After the bus was unplugged, `write` and `read` raise `BusError` for the rest of its life, as
    those of a real port do. Opening another port raises `BusError` until the bus is back.
    """

    def __init__(self, bus: SimBus, clock: Clock) -> None:
        self.url = "sim://"
        self.bus = bus
        self._clock = clock
        self._opened_ns = clock.now_ns()
        bus.advance(self._opened_ns)
        self._outages_ns = bus.outages_ns()
        if any(from_ns <= self._opened_ns < until_ns for from_ns, until_ns in self._outages_ns):
            raise BusError(f"cannot open port {self.url}: it is unplugged", url=self.url)

    def write(self, data: bytes) -> None:
        self.bus.write(data, self._plugged_ns())

    def read(self) -> bytes:
        return self.bus.read(self._plugged_ns())

    def fileno(self) -> int | None:
        return None

    def next_arrival_ns(self) -> int | None:
        return self.bus.next_arrival_ns()

    def close(self) -> None:
        """Advance the bus until the servos have received what is still on the line."""
        now_ns = self._clock.now_ns()
        self.bus.advance(now_ns + self.bus.backlog_ns(now_ns))

    def _plugged_ns(self) -> int:
        """Return the instant; raise `BusError` if the port was unplugged since it was opened."""
        now_ns = self._clock.now_ns()
        if any(self._opened_ns < from_ns <= now_ns for from_ns, _ in self._outages_ns):
            raise LostPortError(f"lost port {self.url}: it was unplugged", url=self.url)
        return now_ns
