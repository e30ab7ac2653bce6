"""Lateness of the moves of a run, for the report and the display."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Final

from lss_motion.planning.program.moves import LATEST_ARRIVAL_S
from lss_motion.units import NS_PER_US, ns_from_s

MISSED_NS: Final = ns_from_s(LATEST_ARRIVAL_S)
"""A move that leaves later than this counts as missed: the move before it had begun to brake."""
LATEST_COMMANDS: Final = 100
BIN_BITS: Final = 7
"""A bin is narrower than 2^-6 of its lateness, so percentiles are right to 1.6 %. Chosen."""


@dataclass(slots=True)
class Statistics:
    """Lateness of every move, in ns after the instant at which it was due to leave.

    Lateness is counted in bins, so the memory that this needs does not grow with the run.
    """

    latest_ns: deque[int] = field(default_factory=lambda: deque(maxlen=LATEST_COMMANDS))
    """Lateness of the last moves, for the display."""
    missed: int = 0
    max_ns: int = 0
    _bins: Counter[int] = field(default_factory=Counter, repr=False)
    """Number of moves by the upper end of their bin in ns."""

    def left_out(self) -> None:
        """Count a move that was not sent, since the next one of its joint was due as well."""
        self.missed += 1

    def sent(self, late_ns: int) -> None:
        """Count a move that left `late_ns` late."""
        late_ns = late_ns if late_ns > 0 else 0
        self.latest_ns.append(late_ns)
        self.missed += late_ns > MISSED_NS
        if late_ns > self.max_ns:
            self.max_ns = late_ns
        shift = late_ns.bit_length() - BIN_BITS if late_ns >> BIN_BITS else 0
        self._bins[late_ns >> shift << shift | ((1 << shift) - 1)] += 1

    def histogram_us(self) -> list[tuple[int, int]]:
        """Return `(µs, moves)`: moves later than the entry before, by at most so many µs."""
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
