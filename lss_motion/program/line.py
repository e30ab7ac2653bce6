"""Places commands on one serial line so that no two overlap, and proves it afterwards.

Decision: every command is a line of its own, also where the firmware knows group lines (370 and
later: `#1D0T100#2D0T100` and one CR). A group saves one byte for every command that has no gap
before it. On a lively show that is 0.5 to 1.5 % of what 18 joints send at 115200 bps and at most
2.5 % of what 32 send: less than half a percent of the line, since most commands stand alone where
their joint wants them. For that, one would have to know when a servo takes up a section: at the
next `#`, or all of them at the CR, which is later by the whole group. The seeds do not know groups,
the facts have them from queries (lss_facts 2.3), and nobody recorded how moves in a group did. A
wrong guess costs the horn more than the bytes are worth, and a group that lost one byte or its CR
can lose more than one command.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lss_motion.program.batch import IntArray

WORST_WINDOW_US = 100_000
"""Utilisation is also given for the busiest 100 ms (design 7)."""


BUCKET_US = 524_288
"""Slots (starts, ends) are kept by the stretch in which they begin, so that ten minutes are as
quick to search as one second. Any length will do; this one holds four dozen slots on a busy line,
and few moves meet its edges, where searching takes longer."""


class LineSchedule:
    """The transmit side of one bus: reserved slots, disjoint, in microseconds of show time."""

    def __init__(self) -> None:
        self._buckets: dict[int, tuple[list[int], list[int]]] = {}
        self._longest_us = 0

    def copy(self) -> LineSchedule:
        """Return a schedule of its own with the same slots."""
        made = LineSchedule()
        made._buckets = {key: ([*starts], [*ends]) for key, (starts, ends) in self._buckets.items()}
        made._longest_us = self._longest_us
        return made

    def reserve(self, latest_end_us: int, size_us: int, earliest_us: int) -> int:
        """Reserve the latest free slot that ends by `latest_end_us`; return where it ends.

        When nothing is free after `earliest_us`, take the first free slot beyond
        `latest_end_us`: the caller sees that it is late.
        """
        return self.reserve_all((latest_end_us,), (size_us,), (earliest_us,))[0]

    def reserve_all(
        self, latest_end_us: Iterable[int], size_us: Sequence[int], earliest_us: Iterable[int]
    ) -> list[int]:
        """Do what `reserve` does for many, in their order."""
        self._longest_us = max(self._longest_us, max(size_us, default=0))
        reserved_us = []
        for latest_us, own_us, begin_us in zip(latest_end_us, size_us, earliest_us, strict=True):
            end_us, start_us = latest_us, latest_us - own_us
            key = start_us // BUCKET_US
            bucket = self._buckets.get(key)
            if bucket is not None and end_us <= (key + 1) * BUCKET_US:
                starts_us, ends_us = bucket
                at = bisect_left(starts_us, end_us)
                while at and ends_us[at - 1] > start_us:
                    at -= 1
                    end_us = starts_us[at]
                    start_us = end_us - own_us
                if at and start_us >= begin_us:  # What is before it here is before it anywhere.
                    starts_us.insert(at, start_us)
                    ends_us.insert(at, end_us)
                    reserved_us.append(end_us)
                    continue
            reserved_us.append(self._reserved_anywhere(latest_us, own_us, begin_us))
        return reserved_us

    def _reserved_anywhere(self, latest_end_us: int, size_us: int, earliest_us: int) -> int:
        """Do what `reserve` does, across the edges of buckets."""
        start_us = self._latest_free_end(latest_end_us, size_us) - size_us
        if start_us < earliest_us:
            start_us = self._first_free_start(max(earliest_us, latest_end_us - size_us), size_us)
        starts_us, ends_us = self._buckets.setdefault(start_us // BUCKET_US, ([], []))
        at = bisect_left(starts_us, start_us)
        starts_us.insert(at, start_us)
        ends_us.insert(at, start_us + size_us)
        return start_us + size_us

    def _latest_free_end(self, latest_end_us: int, size_us: int) -> int:
        end_us = latest_end_us
        key = (end_us - 1) // BUCKET_US
        while (key + 1) * BUCKET_US > end_us - size_us - self._longest_us:
            bucket = self._buckets.get(key)
            if bucket is not None:
                starts_us, ends_us = bucket
                at = bisect_left(starts_us, end_us)
                while at:
                    at -= 1
                    if ends_us[at] <= end_us - size_us:
                        return end_us
                    end_us = starts_us[at]
            key -= 1
        return end_us

    def _first_free_start(self, earliest_us: int, size_us: int) -> int:
        start_us = earliest_us
        key = (start_us - self._longest_us) // BUCKET_US
        while key * BUCKET_US < start_us + size_us:
            for slot_us, stop_us in zip(*self._buckets.get(key, ((), ())), strict=True):
                if slot_us >= start_us + size_us:
                    return start_us
                start_us = max(start_us, stop_us)
            key += 1
        return start_us


@dataclass(frozen=True, slots=True, kw_only=True)
class LineUse:
    """How one bus is used by a program: the result of checking its finished schedule."""

    bus: str
    baud_bps: int
    commands: int
    utilisation_ratio: float
    """Share of the time from the first to the last byte in which the line sends commands."""
    worst_100_ms_ratio: float
    overlaps: int
    """Commands that are due before their predecessor has left. A sound schedule has none."""
    late_max_us: int
    """The longest that a command has to wait for the line."""
    reading_rate_hz: float = math.inf
    """How often each joint that answers can be asked where it is, in the worst second."""


def line_use(bus: str, baud_bps: int, slots_us: Sequence[tuple[int, int]] | IntArray) -> LineUse:
    """Return the use of a line on which each `(due, size)` in microseconds is sent in order.

    Independent of how the slots were found: it replays them on a queue.
    """
    slots = np.asarray(slots_us, dtype=np.intp).reshape(-1, 2)
    due_us, size_us = slots[np.lexsort((slots[:, 1], slots[:, 0]))].T
    sent_us = np.cumsum(size_us)
    before_us = sent_us - size_us
    leaves_us = np.maximum.accumulate(due_us - before_us) + before_us
    late_us = leaves_us - due_us
    first = np.searchsorted(due_us, due_us - WORST_WINDOW_US, side="right")
    in_window_us = sent_us - before_us[first]
    length_us = WORST_WINDOW_US
    if len(slots):
        length_us = max(int(leaves_us[-1] + size_us[-1] - due_us[0]), WORST_WINDOW_US)
    return LineUse(
        bus=bus,
        baud_bps=baud_bps,
        commands=len(slots),
        utilisation_ratio=float(size_us.sum()) / length_us,
        worst_100_ms_ratio=min(1.0, float(in_window_us.max(initial=0)) / WORST_WINDOW_US),
        overlaps=int(np.count_nonzero(late_us)),
        late_max_us=int(late_us.max(initial=0)),
    )
