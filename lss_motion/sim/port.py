"""The simulated bus as a port of the runner: `sim://`, in real or in virtual time."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lss_motion.runtime.clock import Clock
    from lss_motion.sim.bus import SimBus


class SimPort:
    """A `SimBus` read and written at the instants of `clock`."""

    def __init__(self, bus: SimBus, clock: Clock) -> None:
        self.url = "sim://"
        self.bus = bus
        self._clock = clock
        bus.advance(clock.now_ns())

    def write(self, data: bytes) -> None:
        self.bus.write(data, self._clock.now_ns())

    def read(self) -> bytes:
        return self.bus.read(self._clock.now_ns())

    def fileno(self) -> int | None:
        return None

    def next_arrival_ns(self) -> int | None:
        return self.bus.next_arrival_ns()

    def close(self) -> None:
        """Let the servos hear what is still on the line."""
        now_ns = self._clock.now_ns()
        self.bus.advance(now_ns + self.bus.backlog_ns(now_ns))
