"""Counts of one run, and how they become the numbers of the report."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import Final

from lss_motion.program.wording import LATEST_ARRIVAL_S
from lss_motion.units import NS_PER_US, ns_from_s

MISSED_NS: Final = ns_from_s(LATEST_ARRIVAL_S)
"""A move that leaves later than this has been missed: its predecessor had begun to brake."""


@dataclass(slots=True)
class Statistics:
    """Lateness of every move, in ns behind the instant at which it was due to leave."""

    late_ns: array[int] = field(default_factory=lambda: array("q"))

    missed: int = 0

    def sent(self, late_ns: int) -> None:
        self.late_ns.append(max(0, late_ns))
        self.missed += late_ns > MISSED_NS

    def timing(self) -> dict[str, int]:
        """Return the `timing` object of the report (design 10)."""
        ordered = sorted(self.late_ns)

        def at_ratio(ratio: float) -> int:
            return ordered[min(len(ordered) - 1, int(ratio * len(ordered)))] if ordered else 0

        return {
            "commands": len(ordered),
            "missed": self.missed,
            "late_p50_us": at_ratio(0.5) // NS_PER_US,
            "late_p99_us": at_ratio(0.99) // NS_PER_US,
            "late_max_us": (ordered[-1] if ordered else 0) // NS_PER_US,
        }
