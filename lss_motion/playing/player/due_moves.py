"""The moves of a program in the order in which they leave, each earlier by the lag of its joint."""

from __future__ import annotations

import heapq
from itertools import chain, takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.playing.player.estimators import LAG_MAX_S
from lss_motion.units import US_PER_S, s_from_us, us_from_s

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
