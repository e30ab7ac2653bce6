"""The moves of a program in the order in which they leave, each earlier by the lag of its joint."""

from __future__ import annotations

import heapq
from itertools import chain, takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.player.estimators import LAG_MAX_S
from lss_motion.units import us_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from lss_motion.program.model import Move

EARLY_MAX_US: Final = us_from_s(LAG_MAX_S)


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
        return heapq.heappop(self._soon)

    def next_us(self, servo: tuple[str, int], before_us: float) -> int | None:
        """Return when the next move of `servo` leaves; None: not soon, or not `before_us`."""
        self.first(before_us)
        own = (due.at_us for due in self._soon if (due.move.bus, due.move.servo_id) == servo)
        return min(own, default=None)

    def pass_by(self, until_us: float) -> list[tuple[int, Move]]:
        """Remove all moves that are due until then, in order of time, and return them."""
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
        self._soon = sorted(due for due in self._soon if due.due_us < from_us)
        self._newest_us = {(due.move.bus, due.move.servo_id): due.at_us for due in self._soon}
        waiting = chain([] if self._head is None else [self._head], self._upcoming)
        kept = list(takewhile(lambda due: due[0] < from_us, waiting))
        self._upcoming = chain(kept, ((move.due_us, move) for move in moves))
        self._head = next(self._upcoming, None)
