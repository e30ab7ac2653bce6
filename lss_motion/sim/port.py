"""The simulated bus as a port of the runner: `sim://`, in real or in virtual time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.errors import BusError, LostPortError
from lss_motion.system.port import Outbox

if TYPE_CHECKING:
    from lss_motion.sim.bus import SimBus
    from lss_motion.system.clock import Clock


class SimPort:
    """A `SimBus` read and written at the instants of `clock`.

    After the bus was unplugged, `write` and `read` raise `BusError` for the rest of its life, as
    those of a real port do. Opening another port raises `BusError` until the bus is back. While the
    port is blocked it holds what is written, and raises when that takes too long.
    """

    def __init__(self, bus: SimBus, clock: Clock) -> None:
        self.url = "sim://"
        self.bus = bus
        self._clock = clock
        self._opened_ns = clock.now_ns()
        bus.advance(self._opened_ns)
        if any(from_ns <= self._opened_ns < until_ns for from_ns, until_ns in bus.outages_ns()):
            raise BusError(f"cannot open port {self.url}: it is unplugged", url=self.url)
        self._blocks_ns = bus.blocks_ns()
        self._outbox = Outbox(self.url, bus.baud_bps, self._take, lambda: 0)

    def write(self, data: bytes) -> None:
        if self.bus.has_outages:
            self._check_plugged()
        if self._blocks_ns:
            self._outbox.write(data, self._clock.now_ns())
        else:
            self.bus.write(data, self._clock.now_ns())

    def read(self) -> bytes:
        if self.bus.has_outages:
            self._check_plugged()
        if self._blocks_ns:
            self._outbox.flush(self._clock.now_ns())
        return self.bus.read(self._clock.now_ns())

    def fileno(self) -> int | None:
        return None

    def next_arrival_ns(self) -> int | None:
        if not self._blocks_ns:
            return self.bus.next_arrival_ns()
        instants_ns = (self.bus.next_arrival_ns(), *self._outbox_turns_ns())
        return min((at_ns for at_ns in instants_ns if at_ns is not None), default=None)

    def has_sent_all(self) -> bool:
        return not self._outbox.held_bytes

    def close(self) -> None:
        """Advance the bus until the servos have received what is still on the line.

        Raises `BlockedPortError` if the port does not take what it holds.
        """
        while self._outbox.held_bytes and self._is_plugged():
            turns_ns = [at_ns for at_ns in self._outbox_turns_ns() if at_ns is not None]
            self._clock.wait_until(min(turns_ns))
            self._outbox.flush(self._clock.now_ns())
        now_ns = self._clock.now_ns()
        self.bus.advance(now_ns + self.bus.backlog_ns(now_ns))

    def _outbox_turns_ns(self) -> tuple[int | None, int | None]:
        """Return when the port takes bytes again, and when it is lost if it does not."""
        if not self._outbox.held_bytes:
            return None, None
        return self._blocked_until_ns(), self._outbox.lost_ns

    def _take(self, data: bytes) -> int:
        if self._blocked_until_ns() is not None:
            return 0
        self.bus.write(data, self._clock.now_ns())
        return len(data)

    def _blocked_until_ns(self) -> int | None:
        """Return when the port takes bytes again; None: it does so now."""
        if not self._blocks_ns:
            return None
        now_ns = self._clock.now_ns()
        return max((z_ns for a_ns, z_ns in self._blocks_ns if a_ns <= now_ns < z_ns), default=None)

    def _is_plugged(self) -> bool:
        if not (outages_ns := self.bus.outages_ns()):
            return True
        now_ns = self._clock.now_ns()
        return not any(self._opened_ns < from_ns <= now_ns for from_ns, _ in outages_ns)

    def _check_plugged(self) -> None:
        """Raise `BusError` if the port was unplugged since it was opened."""
        if not self._is_plugged():
            raise LostPortError(f"lost port {self.url}: it was unplugged", url=self.url)
