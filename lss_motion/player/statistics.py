"""Counts of one run, and how they become the numbers of the report.

What is kept does not grow with the run: lateness is counted in bins.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Final

from lss_motion.program.wording import LATEST_ARRIVAL_S
from lss_motion.units import NS_PER_US, ns_from_s

MISSED_NS: Final = ns_from_s(LATEST_ARRIVAL_S)
"""A move that leaves later than this has been missed: its predecessor had begun to brake."""
LATEST_COMMANDS: Final = 100
BIN_BITS: Final = 7
"""A bin is narrower than a 2^-6 of its lateness: percentiles are right to 1.6 %. Chosen."""


@dataclass(slots=True)
class Statistics:
    """Lateness of every move, in ns behind the instant at which it was due to leave."""

    latest_ns: deque[int] = field(default_factory=lambda: deque(maxlen=LATEST_COMMANDS))
    """That of the last moves, for the display."""
    missed: int = 0
    max_ns: int = 0
    _bins: Counter[int] = field(default_factory=Counter, repr=False)
    """How many moves were so late, by the upper end of the bin in ns."""

    def sent(self, late_ns: int) -> None:
        late_ns = max(0, late_ns)
        self.latest_ns.append(late_ns)
        self.missed += late_ns > MISSED_NS
        self.max_ns = max(self.max_ns, late_ns)
        shift = max(0, late_ns.bit_length() - BIN_BITS)
        self._bins[late_ns >> shift << shift | ((1 << shift) - 1)] += 1

    def histogram_us(self) -> list[tuple[int, int]]:
        """Return how many moves were late by at most so many µs, and by more than the last."""
        counts: Counter[int] = Counter()
        for end_ns, count in self._bins.items():
            counts[1 << max(3, (end_ns // NS_PER_US).bit_length())] += count
        return sorted(counts.items())

    def timing(self) -> dict[str, int]:
        """Return the `timing` object of the report."""
        ends_ns = sorted(self._bins)
        sums = list(accumulate(self._bins[end_ns] for end_ns in ends_ns))
        count = sums[-1] if sums else 0

        def at_ratio(ratio: float) -> int:
            rank = int(ratio * count)
            above = (end_ns for end_ns, so_far in zip(ends_ns, sums, strict=True) if so_far > rank)
            return min(next(above, 0), self.max_ns)

        return {
            "commands": count,
            "missed": self.missed,
            "late_p50_us": at_ratio(0.5) // NS_PER_US,
            "late_p99_us": at_ratio(0.99) // NS_PER_US,
            "late_max_us": self.max_ns // NS_PER_US,
        }
