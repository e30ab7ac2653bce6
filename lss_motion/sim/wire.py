"""The two serial lines of a bus, byte by byte: when each arrives and what collisions leave."""

from __future__ import annotations

import heapq
from collections import deque
from typing import TYPE_CHECKING

from lss_motion.units import line_time_ns

if TYPE_CHECKING:
    from collections.abc import Sequence
    from random import Random

    from lss_motion.sim.adapter import Adapter

LINE_KEPT_BYTES = 4096
"""A line without CR is cut after this many bytes; forty servos in one group need under 1000."""

Spans = list[tuple[int, int]]
"""Stretches of time in which something does not work: from, until."""


class HostLine:
    """From the host to all servos: bytes queue behind each other, each ten bits long."""

    def __init__(self, baud_bps: int) -> None:
        self._baud_bps = baud_bps
        self._burst_ns = 0
        self._burst_bytes = 0
        self._free_ns = 0
        self._partial = bytearray()
        self._clogs_ns: Sequence[tuple[int, int]] = ()
        self._outages_ns: Sequence[tuple[int, int]] = ()
        self.lines: deque[tuple[int, bytes]] = deque()
        """Whole lines (CR included) and the instants at which their CR has arrived."""

    def start(self, clogs_ns: Spans, outages_ns: Spans) -> None:
        """In a clog no byte leaves the adapter; in an outage what was not heard yet is lost."""
        self._clogs_ns = clogs_ns
        self._outages_ns = outages_ns

    def set_rate(self, baud_bps: int) -> None:
        """Go on at another rate; what was written before is no line that anybody understands."""
        self._baud_bps = baud_bps
        self._partial.clear()
        self._burst_bytes = 0

    def write(self, data: bytes, now_ns: int) -> None:
        """Take the host's bytes; the first leaves as soon as the line is free."""
        if now_ns > self._free_ns or not self._burst_bytes:
            self._burst_ns = now_ns
            self._burst_bytes = 0
        *lines, rest = data.split(b"\r")
        for line in lines:
            self._burst_bytes += len(line) + 1
            arrival_ns = self._arrival_ns()
            if not self._is_lost(now_ns, arrival_ns):
                self.lines.append((arrival_ns, bytes(self._partial) + line + b"\r"))
            self._partial.clear()
        self._burst_bytes += len(rest)
        self._partial = (self._partial + rest)[-LINE_KEPT_BYTES:]
        self._free_ns = self._arrival_ns()

    def backlog_ns(self, now_ns: int) -> int:
        """Return how long the bytes written so far will still occupy the line."""
        return max(self._free_ns - now_ns, 0)

    def _arrival_ns(self) -> int:
        left_ns = line_time_ns(self._burst_bytes, self._baud_bps)
        at_ns = self._burst_ns
        for from_ns, until_ns in self._clogs_ns:
            if until_ns > at_ns and from_ns < at_ns + left_ns:
                left_ns -= max(from_ns - at_ns, 0)
                at_ns = until_ns
        return at_ns + left_ns

    def _is_lost(self, now_ns: int, arrival_ns: int) -> bool:
        return any(
            from_ns < arrival_ns and now_ns < until_ns for from_ns, until_ns in self._outages_ns
        )


class ServoLine:
    """From all servos to the host. Servos that talk at once damage each other's bytes.

    A receiver takes one byte after the other: one that starts while another is under way is
    lost, and damages that one.
    """

    def __init__(self, baud_bps: int, random: Random, adapter: Adapter) -> None:
        self._baud_bps = baud_bps
        self._edges_ns: list[int] = []
        self._random = random
        self._adapter = adapter
        self._coming: list[tuple[int, int, int, int]] = []
        self._ends_ns: list[int] = []
        self._count = 0
        self._current: tuple[int, int] | None = None

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

    def set_rate(self, baud_bps: int) -> None:
        """Let replies that begin from now on take the time of another rate."""
        self._baud_bps = baud_bps
        self._edges_ns.clear()

    def read(self, now_ns: int) -> bytes:
        """Return what has arrived by `now_ns`; all that starts until then must have been sent."""
        coming, current, adapter = self._coming, self._current, self._adapter
        while coming and coming[0][0] <= now_ns:
            begin_ns, _, end_ns, value = heapq.heappop(coming)
            if current is not None and begin_ns < current[0]:
                current = (current[0], self._random.getrandbits(8))
                continue
            if current is not None:
                adapter.take(*current)
            current = (end_ns, value)
        if current is not None and current[0] <= now_ns:
            adapter.take(*current)
            current = None
        self._current = current
        while self._ends_ns and adapter.due_ns(self._ends_ns[0]) <= now_ns:
            heapq.heappop(self._ends_ns)
        return adapter.read(now_ns)

    def next_end_ns(self) -> int | None:
        """Return when the earliest reply that was not read to its end is complete.

        Behind an adapter with packets: when the host gets it, or a full packet before it.
        """
        if not self._ends_ns:
            return None
        due_ns = self._adapter.due_ns(self._ends_ns[0])
        room_bytes = self._adapter.room_bytes()
        is_under_way = self._current is not None
        if room_bytes is None or len(self._coming) + is_under_way < room_bytes:
            return due_ns
        ends_ns = [end_ns for _, _, end_ns, _ in heapq.nsmallest(room_bytes, self._coming)]
        if self._current is not None:
            ends_ns = [self._current[0], *ends_ns]
        return min(due_ns, ends_ns[room_bytes - 1])
