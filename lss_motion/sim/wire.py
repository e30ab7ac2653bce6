"""The two serial lines of a bus, byte by byte: when each arrives and what collisions leave."""

from __future__ import annotations

import heapq
from collections import deque
from typing import TYPE_CHECKING

from lss_motion.units import line_time_ns

if TYPE_CHECKING:
    from random import Random

LINE_KEPT_BYTES = 4096
"""A line without CR is cut after this many bytes; forty servos in one group need under 1000."""


class HostLine:
    """From the host to all servos: bytes queue behind each other, each ten bits long."""

    def __init__(self, baud_bps: int) -> None:
        self._baud_bps = baud_bps
        self._burst_ns = 0
        self._burst_bytes = 0
        self._free_ns = 0
        self._partial = bytearray()
        self.lines: deque[tuple[int, bytes]] = deque()
        """Whole lines (CR included) and the instants at which their CR has arrived."""

    def write(self, data: bytes, now_ns: int) -> None:
        """Take the host's bytes; the first leaves as soon as the line is free."""
        if now_ns > self._free_ns or not self._burst_bytes:
            self._burst_ns = now_ns
            self._burst_bytes = 0
        *lines, rest = data.split(b"\r")
        for line in lines:
            self._burst_bytes += len(line) + 1
            self.lines.append((self._arrival_ns(), bytes(self._partial) + line + b"\r"))
            self._partial.clear()
        self._burst_bytes += len(rest)
        self._partial = (self._partial + rest)[-LINE_KEPT_BYTES:]
        self._free_ns = self._arrival_ns()

    def backlog_ns(self, now_ns: int) -> int:
        """Return how long the bytes written so far will still occupy the line."""
        return max(self._free_ns - now_ns, 0)

    def _arrival_ns(self) -> int:
        return self._burst_ns + line_time_ns(self._burst_bytes, self._baud_bps)


class ServoLine:
    """From all servos to the host. Servos that talk at once damage each other's bytes.

    A receiver takes one byte after the other: one that starts while another is under way is
    lost, and damages that one.
    """

    def __init__(self, baud_bps: int, random: Random) -> None:
        self._baud_bps = baud_bps
        self._edges_ns: list[int] = []
        self._random = random
        self._coming: list[tuple[int, int, int, int]] = []
        self._ends_ns: list[int] = []
        self._count = 0
        self._current: tuple[int, int] | None = None
        self._arrived: deque[tuple[int, int]] = deque()

    def send(self, data: bytes, start_ns: int) -> int:
        """Let a servo send `data` from `start_ns` on; return when its last byte has arrived."""
        while len(self._edges_ns) <= len(data):
            self._edges_ns.append(line_time_ns(len(self._edges_ns), self._baud_bps))
        end_ns = start_ns
        for edge_ns, value in zip(self._edges_ns[1:], data, strict=False):
            self._count += 1
            begin_ns, end_ns = end_ns, start_ns + edge_ns
            heapq.heappush(self._coming, (begin_ns, self._count, end_ns, value))
        heapq.heappush(self._ends_ns, end_ns)
        return end_ns

    def read(self, now_ns: int) -> bytes:
        """Return what has arrived by `now_ns`; all that starts until then must have been sent."""
        while self._coming and self._coming[0][0] <= now_ns:
            begin_ns, _, end_ns, value = heapq.heappop(self._coming)
            if self._current is not None and begin_ns < self._current[0]:
                self._current = (self._current[0], self._random.getrandbits(8))
                continue
            self._finish()
            self._current = (end_ns, value)
        if self._current is not None and self._current[0] <= now_ns:
            self._finish()
        while self._ends_ns and self._ends_ns[0] <= now_ns:
            heapq.heappop(self._ends_ns)
        data = bytearray()
        while self._arrived and self._arrived[0][0] <= now_ns:
            data.append(self._arrived.popleft()[1])
        return bytes(data)

    def next_end_ns(self) -> int | None:
        """Return when the earliest reply that was not read to its end is complete."""
        return self._ends_ns[0] if self._ends_ns else None

    def _finish(self) -> None:
        if self._current is not None:
            self._arrived.append(self._current)
            self._current = None
