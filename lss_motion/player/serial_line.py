"""State of one serial line, without I/O: when it is free, what must be written, what came in."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.protocol.framing import Garbage, Reply, ReplyParser, size_of
from lss_motion.units import line_time_ns

if TYPE_CHECKING:
    from lss_motion.robot.model import Bus


TABLE_BYTES: Final = 64
"""Times of lines shorter than this are computed once: several are needed for each query."""


class SerialLine:
    """One bus. Bytes that are handed over leave in order, at the baud rate."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.free_ns = 0
        self.sent_bytes = 0
        self.replies = 0
        self.garbage = 0
        self._parser = ReplyParser(grouped=False)
        self._out = bytearray()
        self._times_ns = [line_time_ns(size, bus.baud_bps) for size in range(TABLE_BYTES)]

    def time_ns(self, size_bytes: int) -> int:
        """Return how long `size_bytes` occupy the line."""
        if size_bytes < TABLE_BYTES:
            return self._times_ns[size_bytes]
        return line_time_ns(size_bytes, self.bus.baud_bps)

    def arrival_ns(self, size_bytes: int, now_ns: int) -> int:
        """Return when the last of `size_bytes` would arrive if they were handed over now."""
        free_ns = max(now_ns, self.free_ns)
        if size_bytes < TABLE_BYTES:  # As `time_ns`, without a call: it is needed all the time.
            return free_ns + self._times_ns[size_bytes]
        return free_ns + self.time_ns(size_bytes)

    def send(self, data: bytes, now_ns: int) -> int:
        """Hand over `data`; return when its last byte arrives at the servos."""
        self.free_ns = self.arrival_ns(len(data), now_ns)
        self.sent_bytes += len(data)
        self._out += data
        return self.free_ns

    def take(self) -> bytes:
        """Return what was handed over since the last call."""
        if not self._out:
            return b""
        out = bytes(self._out)
        self._out.clear()
        return out

    @property
    def has_unfinished(self) -> bool:
        """Whether bytes came that are no whole reply yet."""
        return self._parser.has_unfinished

    def receive(self, data: bytes, now_ns: int) -> list[tuple[Reply, int]]:
        """Return the replies in `data`, and when each ended at the latest.

        `data` came by `now_ns`. A reply with others behind it ended earlier, by the time that these
        take on the line. What is no reply is counted.
        """
        received: list[Reply] = []
        for item in self._parser.feed(data):
            match item:
                case Reply():
                    self.replies += 1
                    received.append(item)
                case Garbage():
                    self.garbage += 1
        if len(received) < 2:
            return [(reply, now_ns) for reply in received]
        pairs: list[tuple[Reply, int]] = []
        for reply in reversed(received):
            pairs.append((reply, now_ns))
            now_ns -= self.time_ns(size_of(reply))
        return pairs[::-1]
