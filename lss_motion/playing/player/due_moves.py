"""The moves of a program in the order in which they leave, and how late each left.

Each leaves earlier by the lag of its joint. `Statistics` counts lateness, for report and display.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import accumulate, chain, takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.planning.program.moves import LATEST_ARRIVAL_S
from lss_motion.playing.player.estimators import LAG_MAX_S
from lss_motion.units import NS_PER_US, US_PER_S, ns_from_s, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from lss_motion.planning.program.model import Move
    from lss_motion.playing.player.show_clock import ShowClock
    from lss_motion.system.clock_leg import ClockLeg


EARLY_MAX_US: Final = us_from_s(LAG_MAX_S)


def earliest_after(now_ns: int, instants_ns: Iterable[int | None]) -> int | None:
    """Return the first of these instants that is later than `now_ns`; None: there is none."""
    first_ns = None
    for at_ns in instants_ns:
        if at_ns is not None and at_ns > now_ns and (first_ns is None or at_ns < first_ns):
            first_ns = at_ns
    return first_ns


class Due(NamedTuple):
    """A move that leaves at show time `at_us`; the program has it at `due_us`."""

    at_us: int
    number: int
    due_us: int
    move: Move


class DueMoves:
    """Moves `(due_us, move)` in order of time, each earlier by `early_us(move)`.

    The estimate of a lag changes, but no move overtakes an earlier one of the same servo for that.
    """

    def __init__(self, moves: Iterator[tuple[int, Move]], early_us: Callable[[Move], int]) -> None:
        self._upcoming = moves
        self._head: tuple[int, Move] | None = next(moves, None)
        self._early_us = early_us
        self._soon: list[Due] = []
        self._newest_us: dict[tuple[str, int], int] = {}
        """By servo, when its last move that was looked at leaves."""
        self._number = 0
        self._first_ns: int | None = None
        self._kept_for: tuple[ClockLeg | None, float] = None, 0.0
        """The leg of the show clock and the show time for which `_first_ns` was computed."""

    def first_ns(self, clock: ShowClock, before_s: float) -> int | None:
        """Return when the next move leaves; None: none is due before the show time `before_s`.

        It is computed anew only if the moves, the clock or `before_s` have changed since.
        """
        leg, kept_before_s = self._kept_for
        if leg is not clock.leg or kept_before_s != before_s:
            due = self.first(US_PER_S * before_s)
            self._first_ns = None if due is None else clock.instant_ns(s_from_us(due.at_us))
            self._kept_for = clock.leg, before_s
        return self._first_ns

    def first(self, before_us: float) -> Due | None:
        """Return the next move to leave among those that are due before `before_us`."""
        soon = self._soon
        while self._head is not None and self._head[0] < before_us:
            due_us, move = self._head
            if soon and due_us - EARLY_MAX_US > soon[0].at_us:
                break
            self._number += 1
            servo = (move.bus, move.servo_id)
            at_us = due_us - min(self._early_us(move), EARLY_MAX_US)
            at_us = self._newest_us[servo] = max(at_us, self._newest_us.get(servo, at_us))
            heapq.heappush(soon, Due(at_us, self._number, due_us, move))
            self._head = next(self._upcoming, None)
        return soon[0] if soon else None

    def pop(self) -> Due:
        """Remove the move that `first` returned; return it."""
        self._kept_for = None, 0.0
        return heapq.heappop(self._soon)

    def next_us(self, servo: tuple[str, int], before_us: float) -> int | None:
        """Return when the next move of `servo` leaves; None: not soon, or not `before_us`."""
        self.first(before_us)
        own = (due.at_us for due in self._soon if (due.move.bus, due.move.servo_id) == servo)
        return min(own, default=None)

    def pass_by(self, until_us: float) -> list[tuple[int, Move]]:
        """Remove all moves that are due until then, in order of time, and return them."""
        self._kept_for = None, 0.0
        passed = [due for due in self._soon if due.due_us <= until_us]
        self._soon = [due for due in self._soon if due.due_us > until_us]
        heapq.heapify(self._soon)
        found = [(due.due_us, due.move) for due in sorted(passed, key=lambda due: due.number)]
        while self._head is not None and self._head[0] <= until_us:
            found.append(self._head)
            self._head = next(self._upcoming, None)
        return found

    def replace_from(self, from_us: int, moves: Iterable[Move]) -> None:
        """Replace all that is due at `from_us` or later by `moves`."""
        self._kept_for = None, 0.0
        self._soon = sorted(due for due in self._soon if due.due_us < from_us)
        self._newest_us = {(due.move.bus, due.move.servo_id): due.at_us for due in self._soon}
        waiting = chain([] if self._head is None else [self._head], self._upcoming)
        kept = list(takewhile(lambda due: due[0] < from_us, waiting))
        self._upcoming = chain(kept, ((move.due_us, move) for move in moves))
        self._head = next(self._upcoming, None)


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
