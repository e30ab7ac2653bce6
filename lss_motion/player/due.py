"""The moves of a program in the order in which they leave, each earlier by what its joint lags."""

from __future__ import annotations

import heapq
from itertools import chain, takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.player.lag import LAG_MAX_S
from lss_motion.units import us_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from lss_motion.program.model import Move

EARLY_MAX_US: Final = us_from_s(LAG_MAX_S)


class Due(NamedTuple):
    """A move that leaves at the show time `at_us`; the program has it at `due_us`."""

    at_us: int
    number: int
    due_us: int
    move: Move


class DueMoves:
    """Moves `(due_us, move)` in order of time; `early_us` says how much earlier one is to leave.

    What is believed of a lag changes: no move overtakes one of the same servo for that.
    """

    def __init__(self, moves: Iterator[tuple[int, Move]], early_us: Callable[[Move], int]) -> None:
        self._upcoming = moves
        self._head: tuple[int, Move] | None = next(moves, None)
        self._early_us = early_us
        self._soon: list[Due] = []
        self._newest_us: dict[tuple[str, int], int] = {}
        """When the last move of each servo that was looked at leaves."""
        self._number = 0

    def first(self, before_us: float) -> Due | None:
        """Return the next move to leave of those that are due before `before_us`."""
        while self._head is not None and self._head[0] < before_us:
            due_us, move = self._head
            if self._soon and due_us - EARLY_MAX_US > self._soon[0].at_us:
                break
            self._number += 1
            servo = (move.bus, move.servo_id)
            at_us = due_us - min(self._early_us(move), EARLY_MAX_US)
            at_us = self._newest_us[servo] = max(at_us, self._newest_us.get(servo, at_us))
            heapq.heappush(self._soon, Due(at_us, self._number, due_us, move))
            self._head = next(self._upcoming, None)
        return self._soon[0] if self._soon else None

    def pop(self) -> Due:
        """Return what `first` returned, and go on to the next."""
        return heapq.heappop(self._soon)

    def pass_by(self, until_us: float) -> list[tuple[int, Move]]:
        """Return all that is due until then and has not left, in order of time; it never will."""
        passed = [due for due in self._soon if due.due_us <= until_us]
        self._soon = [due for due in self._soon if due.due_us > until_us]
        heapq.heapify(self._soon)
        found = [(due.due_us, due.move) for due in sorted(passed, key=lambda due: due.number)]
        while self._head is not None and self._head[0] <= until_us:
            found.append(self._head)
            self._head = next(self._upcoming, None)
        return found

    def replace_from(self, from_us: int, moves: Iterable[Move]) -> None:
        """Let `moves` follow in place of all that is due at `from_us` or later."""
        self._soon = sorted(due for due in self._soon if due.due_us < from_us)
        self._newest_us = {(due.move.bus, due.move.servo_id): due.at_us for due in self._soon}
        waiting = chain([] if self._head is None else [self._head], self._upcoming)
        kept = list(takewhile(lambda due: due[0] < from_us, waiting))
        self._upcoming = chain(kept, ((move.due_us, move) for move in moves))
        self._head = next(self._upcoming, None)
