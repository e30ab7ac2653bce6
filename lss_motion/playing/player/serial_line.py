"""State of one serial line, without I/O: when it is free, what must be written, what came in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.protocol.framing import Garbage, Reply, ReplyParser, size_of
from lss_motion.units import line_time_ns

if TYPE_CHECKING:
    from lss_motion.robot.model import Bus


class LineTimes(dict[int, int]):
    """How long so many bytes occupy a line, each computed once: several are needed per query."""

    def __init__(self, baud_bps: int) -> None:
        super().__init__()
        self._baud_bps = baud_bps

    def __missing__(self, size_bytes: int) -> int:
        self[size_bytes] = time_ns = line_time_ns(size_bytes, self._baud_bps)
        return time_ns


class SerialLine:
    """One bus. Bytes that are handed over leave in order, at the baud rate."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.free_ns = 0
        self.sent_bytes = 0
        self.replies = 0
        self.garbage = 0
        self._parser = ReplyParser(grouped=False)
        self.out = bytearray()
        """What was handed over since the last call of `take`."""
        self.times_ns = LineTimes(bus.baud_bps)

    def time_ns(self, size_bytes: int) -> int:
        """Return how long `size_bytes` occupy the line."""
        return self.times_ns[size_bytes]

    def arrival_ns(self, size_bytes: int, now_ns: int) -> int:
        """Return when the last of `size_bytes` would arrive if they were handed over now."""
        free_ns = self.free_ns
        return (now_ns if now_ns > free_ns else free_ns) + self.times_ns[size_bytes]

    def send(self, data: bytes, now_ns: int) -> int:
        """Hand over `data`; return when its last byte arrives at the servos."""
        size_bytes = len(data)
        self.free_ns = self.arrival_ns(size_bytes, now_ns)
        self.sent_bytes += size_bytes
        self.out += data
        return self.free_ns

    def take(self) -> bytes:
        """Return what was handed over since the last call."""
        data, self.out = bytes(self.out), bytearray()
        return data

    @property
    def has_unfinished(self) -> bool:
        """Whether bytes came that are no whole reply yet."""
        return self._parser.has_unfinished

    def receive(self, data: bytes, now_ns: int) -> list[tuple[Reply, int]]:
        """Return the replies in `data`, and when each ended at the latest.

        `data` came by `now_ns`. A reply with others behind it ended earlier, by the time that these
        take on the line. What is no reply is counted.
        """
        pairs: list[tuple[Reply, int]] = []
        for item in reversed(self._parser.feed(data)):
            if isinstance(item, Garbage):
                self.garbage += 1
                continue
            self.replies += 1
            if pairs:
                now_ns -= self.times_ns[size_of(pairs[-1][0])]
            pairs.append((item, now_ns))
        return pairs[::-1]
