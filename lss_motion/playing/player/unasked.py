"""Notices on a bus that another host asks its servos, or that something sends by itself.

A host does not see the commands of another one, only the replies that they cause (FACTS.md W2). So
what arrives is compared with what this program asked for. A lost reply leaves a query open, and a
damaged one leaves a query open and unreadable bytes: neither brings more than was asked for.
`UnaskedWatch` counts what is beyond that. Commands of another host that cause no reply leave no
trace here; nor does a host at a baud rate that no servo has.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Final

from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.playing.player.query_tracker import QueryTracker


LOOK_NS: Final = 250 * NS_PER_MS
"""How often the counts of a bus are compared."""
ALLOWED_HZ: Final = 0.5
"""So many arrivals a second beyond the queries prove nothing: one damaged reply may be two pieces.
Measured: up to 0.2 a second with a tenth of the replies damaged, 0.1 with a hundredth."""
EXCESS_MIN: Final = 8.0
"""From so many arrivals beyond the queries and `ALLOWED_HZ` on, something else causes them. Chosen:
the replies of the longest row of queries may come late, and count before their queries do."""
OVER_NS: Final = 5 * NS_PER_S
"""It is over when nothing came that was not asked for in this time."""


class UnaskedWatch:
    """Counts what arrives on one bus beyond the queries of this program, from the first call on."""

    def __init__(self, tracker: QueryTracker) -> None:
        self.is_disturbed = False
        """Whether more arrives than was asked for."""
        self.total = 0
        """Arrivals beyond the queries, in all the times that it was disturbed."""
        self._line = tracker.line
        self._tracker = tracker
        self._seen: tuple[int, int, int] | None = None
        self._look_ns = self._last_ns = 0
        self._excess = 0.0
        self._pending = 0
        """Arrivals beyond the queries that `total` does not have yet."""
        self._before: Counter[int] = Counter()
        """Replies by id up to the last instant without an excess."""
        self._garbage_before = 0

    def advance(self, now_ns: int) -> bool:
        """Compare the counts, if that is due; return whether the bus is disturbed since now."""
        if now_ns < self._look_ns:
            return False
        self._look_ns = now_ns + LOOK_NS
        counts = (self._tracker.unasked.total(), self._line.garbage, self._tracker.timeouts)
        if self._seen is None:
            self._seen, self._last_ns = counts, now_ns
            self._start_anew()
        unasked, garbage, open_queries = (
            new - old for new, old in zip(counts, self._seen, strict=True)
        )
        self._seen = counts
        more = unasked + garbage - open_queries
        self._pending += more
        self._excess = min(self._excess + more, 2 * EXCESS_MIN)
        if more > 0:
            self._last_ns = now_ns
        self._excess -= ALLOWED_HZ * LOOK_NS / NS_PER_S
        if self._excess <= 0.0 or now_ns - self._last_ns > OVER_NS:
            self._start_anew()
        was_disturbed = self.is_disturbed
        self.is_disturbed = self._excess > (0.0 if was_disturbed else EXCESS_MIN)
        if self.is_disturbed:
            self.total += self._pending
            self._pending = 0
        return self.is_disturbed and not was_disturbed

    def text(self, bus_name: str) -> str:
        """Return the text for a person about a bus that is disturbed."""
        return disturbed_text(bus_name, self.replies, self._line.garbage - self._garbage_before)

    @property
    def replies(self) -> Mapping[int, int]:
        """By id the replies that were not asked for, since there are more than was asked for."""
        return self._by_id() - self._before

    def _start_anew(self) -> None:
        self._excess, self._pending = 0.0, 0
        self._before, self._garbage_before = self._by_id(), self._line.garbage

    def _by_id(self) -> Counter[int]:
        counts: Counter[int] = Counter()
        for (servo_id, _), count in self._tracker.unasked.items():
            counts[servo_id] += count
        return counts


class UnaskedWatches:
    """The `UnaskedWatch` of each bus."""

    def __init__(self, trackers: Mapping[str, QueryTracker]) -> None:
        self._watches = {name: UnaskedWatch(tracker) for name, tracker in trackers.items()}
        self.look_ns: float = math.inf
        """When `advance` must be called next."""

    def start(self) -> None:
        """Watch from now on: no servos share an id, whose replies would damage each other."""
        self.look_ns = 0

    def advance(self, now_ns: int) -> list[str]:
        """Return a text for each bus on which more arrives than was asked for, when it begins."""
        if now_ns < self.look_ns:
            return []
        self.look_ns = now_ns + LOOK_NS
        found = [(name, watch) for name, watch in self._watches.items() if watch.advance(now_ns)]
        return [watch.text(f"bus {name}") for name, watch in found]

    def total(self, bus_name: str) -> int:
        """Return how many arrivals on a bus were beyond the queries while it was disturbed."""
        return self._watches[bus_name].total


def disturbed_text(where: str, replies: Mapping[int, int], unreadable: int) -> str:
    """Return the text for a bus with replies by id and unreadable pieces without a query."""
    if sum(replies.values()) < unreadable:
        return unreadable_text(where)
    # An id that came once may be a damaged one of another servo.
    named = {one: count for one, count in replies.items() if count > 1} or replies
    return f"{where}: {unasked_text(named)}"


def unasked_text(replies: Mapping[int, int]) -> str:
    """Return the text for servos whose replies, so many by id, this program did not ask for."""
    count, is_one = sum(replies.values()), len(replies) == 1
    servos = f"servo{'' if is_one else 's'} {', '.join(map(str, sorted(replies)))}"
    return (
        f"{servos} sent {'a reply' if count == 1 else f'{count} replies'} that this program did "
        f"not ask for: another program or computer asks on this bus, or the servo"
        f"{'' if is_one else 's'} send{'s' if is_one else ''} by "
        f"{'itself' if is_one else 'themselves'}. Two hosts disturb each other: stop the other "
        f"one, or take {'that servo' if is_one else 'those servos'} off the bus"
    )


def unreadable_text(where: str) -> str:
    """Return the text for a bus on which unreadable bytes come that this program did not ask for.

    Only ids with a readable reply can be trusted then.
    """
    return (
        f"{where}: unreadable bytes come that this program did not ask for: another program or "
        f"computer asks several servos at once on this bus, and their replies damage each other, "
        f"or it asks servos at another baud rate, or something sends by itself. Stop the other "
        f"one, or take its cable off; until then replies are lost here, too, and ids that several "
        f"servos share may not be found. Then scan again"
    )
