"""How long one servo takes from the end of a query to the start of its answer, as it goes along."""

from __future__ import annotations

from collections import deque
from typing import Final

from lss_motion.units import NS_PER_MS

WINDOW: Final = 32
"""Answers that are remembered. Chosen: one in 33 goes beyond all of them by chance."""
SAMPLES_LEAST: Final = 4
"""Before so many answers nothing is known: then no two servos are asked at once."""
REPLY_TIMEOUT_NS: Final = 30 * NS_PER_MS
"""What a servo that is not known yet may take: 10 ms is what the tighter libraries wait
(FACTS.md H5), and a USB adapter may add its 16 ms timer."""
MARGIN_SAMPLES: Final = 4
"""The next answer may be earlier or later than any of n that are remembered by 4/n of their spread.
Chosen: of values spread evenly, one in some hundred goes beyond."""


class Turnaround:
    """The estimate for one servo. It holds what the adapter and the host add to it, too."""

    def __init__(self) -> None:
        self._waits_ns: deque[int] = deque(maxlen=WINDOW)
        self.is_known = False
        self.earliest_ns = 0
        """No answer begins sooner after its query was heard."""
        self.latest_ns = REPLY_TIMEOUT_NS
        """No answer begins later, as far as is known."""

    @property
    def spread_ns(self) -> int:
        return self.latest_ns - self.earliest_ns

    @property
    def least_ns(self) -> int | None:
        """The shortest wait that is remembered; None: none is."""
        return min(self._waits_ns, default=None)

    def take(self, waited_ns: int) -> None:
        """Note an answer that began `waited_ns` after its query was heard."""
        self._waits_ns.append(max(waited_ns, 0))
        if len(self._waits_ns) < SAMPLES_LEAST:
            return
        least_ns, most_ns = min(self._waits_ns), max(self._waits_ns)
        margin_ns = MARGIN_SAMPLES * (most_ns - least_ns) // len(self._waits_ns)
        self.earliest_ns = max(least_ns - margin_ns, 0)
        self.latest_ns = most_ns + margin_ns
        self.is_known = True

    def forget(self) -> None:
        """Begin anew: the servo has changed its ways."""
        self._waits_ns.clear()
        self.is_known = False
        self.earliest_ns, self.latest_ns = 0, REPLY_TIMEOUT_NS
