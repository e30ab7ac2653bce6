"""Show time as a function of the run clock; the moves due on it, and how late each left."""

from __future__ import annotations

import heapq
from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import accumulate, chain, takewhile
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.planning.program.moves import LATEST_ARRIVAL_S
from lss_motion.playing.player.estimators import LAG_MAX_S
from lss_motion.system.clock_leg import ClockLeg
from lss_motion.units import NS_PER_S, NS_PER_US, US_PER_S, ns_from_s, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from lss_motion.planning.program.model import Move

TRIM_MAX_RATIO: Final = 300e-6
"""No servo can notice a change of the rate by this much, and no crystal of a sound device is
further off. Limits are kept: plans may exceed them by 0.1 %."""
CLOSING_S: Final = 10.0
"""A follower makes up its error over this time. Chosen: the noise of a leader is smoothed, and
a drift of 200 ppm that begins is 2 ms off at most."""
KEPT_NS: Final = 20 * NS_PER_S
"""Legs that ended longer ago are forgotten. Chosen: longer than any answer, stall or wait that is
judged by a past show time."""

PAST_MAX: Final = 4000
"""Ends of forgotten legs that are kept for the report. Chosen: more than a picture has pixels."""

ASKED_MAX: Final = 16
"""Show times whose instants are kept: the same few are asked for several times in every turn."""


class LeaderPosition(NamedTuple):
    """Where a leader is: at `show_s` at the run instant `instant_ns`, with this rate."""

    instant_ns: int
    show_s: float
    rate: float

    def at_s(self, now_ns: int) -> float:
        return self.show_s + self.rate * (now_ns - self.instant_ns) / NS_PER_S


class ShowClock:
    """Show time in seconds since the start. Rate 1 is as planned, 0 a pause.

    A leader (`follow`) trims it; rates are without the trim.
    """

    def __init__(self, start_ns: int, start_s: float, rate: float) -> None:
        self.trim_ratio = 0.0
        """By how much the clock is faster than its rate, to follow a leader."""
        self._past: list[tuple[int, float]] = []
        """Ends of forgotten legs, for reports."""
        self._legs: list[ClockLeg] = []
        self._reached_ns: dict[float, int] = {}
        """By show times that `instant_ns` was asked for in this leg: those of moves and marks."""
        self._begin(start_ns, start_s, rate, rate)

    def show_s(self, now_ns: int) -> float:
        """Return the show time at `now_ns`, also for a past instant, up to `KEPT_NS` ago."""
        leg = self.leg
        if now_ns >= self.ramp_end_ns:  # Nearly always: as `ClockLeg.show_s`, without a call.
            steady_s = (now_ns - leg.start_ns) / NS_PER_S - self._ramp_s
            return leg.start_s + (1.0 + leg.trim_ratio) * (self._ramped_s + leg.to_rate * steady_s)
        for leg in reversed(self._legs):
            if leg.start_ns <= now_ns:
                return leg.show_s(now_ns)
        return self._legs[0].show_s(now_ns)

    def rate(self, now_ns: int) -> float:
        return self._legs[-1].rate(now_ns)

    def is_ramping(self, now_ns: int) -> bool:
        return now_ns < self.ramp_end_ns

    def follow(
        self,
        leader: LeaderPosition,
        now_ns: int,
        trim_max_ratio: float = TRIM_MAX_RATIO,
        closing_s: float = CLOSING_S,
    ) -> float | None:
        """Trim the clock so that it meets `leader` in `closing_s`; return how far off it is, in s.

        Its rate differs from the target rate by at most `trim_max_ratio`. A clock that stands or
        ramps is not trimmed: None. What is further off than a trim makes up in time is for the
        caller to decide about.
        """
        if self.target_rate <= 0.0 or now_ns < self.ramp_end_ns:
            return None
        off_s = leader.at_s(now_ns) - self.show_s(now_ns)
        wanted = leader.rate / self.target_rate - 1.0 + off_s / (closing_s * self.target_rate)
        trim_ratio = max(-trim_max_ratio, min(wanted, trim_max_ratio))
        if trim_ratio != self.trim_ratio and now_ns >= self.leg.start_ns:
            show_s = self.show_s(now_ns)
            self.trim_ratio = trim_ratio
            self._begin(now_ns, show_s, self.target_rate, self.target_rate)
        return off_s

    def ramp_to(self, rate: float, now_ns: int, over_s: float) -> None:
        """Change the rate evenly from its present value to `rate`, over `over_s`."""
        self._begin(now_ns, self.show_s(now_ns), self.rate(now_ns), rate, ns_from_s(over_s))

    def stand_at(self, show_s: float, now_ns: int) -> None:
        """Stop at `show_s` from the instant on at which the show reached it, by `now_ns`."""
        reached_ns = self.instant_ns(show_s)
        start_ns = now_ns if reached_ns is None else min(max(reached_ns, self.ramp_end_ns), now_ns)
        self._begin(start_ns, show_s, 0.0, 0.0)

    def jump_to(self, show_s: float, now_ns: int) -> None:
        """Stand at `show_s` from now on, wherever the show was; for a show that stands."""
        self._begin(now_ns, show_s, 0.0, 0.0)

    def run_from(self, show_s: float, now_ns: int) -> None:
        """Be at `show_s` now and run at rate 1; for a show of which every joint rests meanwhile."""
        self.trim_ratio = 0.0
        self._begin(now_ns, show_s, 1.0, 1.0)

    def go_back(self, by_s: float, now_ns: int) -> None:
        """Go on from an earlier show time, at which every joint rests as it does now."""
        left_ns = max(0, self.ramp_end_ns - now_ns)
        show_s = self.show_s(now_ns) - by_s
        self._begin(now_ns, show_s, self.rate(now_ns), self.target_rate, left_ns)

    def halt(self, since_ns: int) -> None:
        """Stand since `since_ns`, a past instant, where the show was then."""
        start_ns = max(since_ns, self._legs[-1].start_ns)
        self._begin(start_ns, self.show_s(start_ns), 0.0, 0.0)

    def instant_ns(self, show_s: float) -> int | None:
        """Return when the show reaches `show_s` at the present target rate; None: never."""
        if self.target_rate <= 0.0:
            return None
        reached_ns = self._reached_ns.get(show_s)
        if reached_ns is None:
            rate = self.target_rate * (1.0 + self.trim_ratio)
            reached_ns = self.ramp_end_ns + ns_from_s((show_s - self._ramp_end_s) / rate)
            if len(self._reached_ns) >= ASKED_MAX:
                self._reached_ns.clear()
            self._reached_ns[show_s] = reached_ns
        return reached_ns

    def knots(self, since_ns: int, until_ns: int, step_ns: int) -> Iterator[tuple[int, float]]:
        """Yield `(instant, show time)` between which show time may be interpolated.

        These are every change of the rate, and steps of `step_ns` within its ramps, from `since_ns`
        on, which is at most `KEPT_NS` before the start of the present leg.
        """
        for index, leg in enumerate(self._legs):
            is_last = index + 1 == len(self._legs)
            end_ns = until_ns if is_last else min(self._legs[index + 1].start_ns, until_ns)
            start_ns = max(leg.start_ns, since_ns)
            if end_ns < start_ns:
                continue
            ramp_end_ns = max(min(leg.ramp_end_ns, end_ns), start_ns)
            for instant_ns in range(start_ns, ramp_end_ns, step_ns):
                yield instant_ns, leg.show_s(instant_ns)
            yield ramp_end_ns, leg.show_s(ramp_end_ns)
            if end_ns > ramp_end_ns:
                yield end_ns, leg.show_s(end_ns)

    def course(self, until_ns: int, step_ns: int) -> Iterator[tuple[int, float]]:
        """Yield `(instant, show time)` as `knots`, from the start of the show on.

        What is longer ago than legs are kept is coarser: its ramps are straight, and after
        thousands of changes every other one is left out.
        """
        yield from self._past
        yield from self.knots(self._legs[0].start_ns, until_ns, step_ns)

    def _begin(
        self, start_ns: int, start_s: float, from_rate: float, to_rate: float, ramp_ns: int = 0
    ) -> None:
        leg = ClockLeg(start_ns, start_s, from_rate, to_rate, ramp_ns, self.trim_ratio)
        self._legs.append(leg)
        self.leg = leg
        """The present leg: another one after every change of the clock."""
        while len(self._legs) > 1 and self._legs[1].start_ns < start_ns - KEPT_NS:
            past = self._legs.pop(0)
            self._past.append((past.start_ns, past.start_s))
            if past.ramp_ns:
                self._past.append((past.ramp_end_ns, past.show_s(past.ramp_end_ns)))
            if len(self._past) > PAST_MAX:
                del self._past[1::2]
        self.target_rate = to_rate
        self.ramp_end_ns = leg.ramp_end_ns
        """When the rate is, or was, steady again."""
        self._ramp_s = ramp_ns / NS_PER_S
        self._ramped_s = 0.5 * (from_rate + to_rate) * self._ramp_s
        """How far the show goes in the ramp of this leg, without the trim."""
        self._ramp_end_s = leg.show_s(leg.ramp_end_ns)
        self._reached_ns.clear()


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
