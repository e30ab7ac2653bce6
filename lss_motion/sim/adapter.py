"""The USB adapter between the host and the line: what it holds back, and when it is not there."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

PACKET_BYTES = 62
"""What an adapter of the FTDI kind collects at most: 64 bytes of USB, two of them its status.
Common knowledge about the chip; see FACTS.md H3."""


@dataclass(slots=True)
class Packet:
    """Bytes that reach the host together."""

    due_ns: int
    data: bytearray = field(default_factory=bytearray)


class Adapter:
    """Delivers the servos' bytes: each as it comes, or, with a latency, in packets.

    With a latency the bytes of a packet wait for the next tick of a timer, or until the packet
    is full (FACTS.md H1: 16 ms, or 1 ms where the host asks for it).
    """

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns
        self._origin_ns = 0
        self._outages_ns: Sequence[tuple[int, int]] = ()
        self._packets: deque[Packet] = deque()
        self._delivered = bytearray()
        """Without a latency: what has come since the last `read`."""

    def start(self, now_ns: int, outages_ns: Sequence[tuple[int, int]]) -> None:
        """Start the timer. In an outage the adapter is unplugged."""
        self._origin_ns = now_ns
        self._outages_ns = outages_ns

    def take(self, end_ns: int, value: int) -> None:
        """Take a byte that has arrived at `end_ns`; bytes come in order of time."""
        if not self._latency_ns:
            if not self._is_lost(end_ns):
                self._delivered.append(value)
            return
        last = self._packets[-1] if self._packets else None
        is_full = last is not None and len(last.data) == PACKET_BYTES
        if last is None or is_full or last.due_ns < end_ns:
            last = Packet(self.due_ns(end_ns))
            self._packets.append(last)
        last.data.append(value)
        if len(last.data) == PACKET_BYTES:
            last.due_ns = end_ns

    def read(self, now_ns: int) -> bytes:
        """Return what has been delivered by `now_ns`, the present instant."""
        data, self._delivered = self._delivered, bytearray()
        while self._packets and self._packets[0].due_ns <= now_ns:
            packet = self._packets.popleft()
            if not self._is_lost(packet.due_ns):
                data += packet.data
        return bytes(data)

    def due_ns(self, end_ns: int) -> int:
        """Return when a byte that arrives at `end_ns` is delivered at the latest."""
        if not self._latency_ns:
            return end_ns
        return end_ns + (self._origin_ns - end_ns) % self._latency_ns

    def room_bytes(self) -> int | None:
        """Return how many bytes still fill the present packet; None: there are no packets."""
        if not self._latency_ns:
            return None
        used = len(self._packets[-1].data) if self._packets else 0
        return PACKET_BYTES - used % PACKET_BYTES

    def _is_lost(self, due_ns: int) -> bool:
        outages_ns = self._outages_ns
        return bool(outages_ns) and any(a_ns <= due_ns < z_ns for a_ns, z_ns in outages_ns)
