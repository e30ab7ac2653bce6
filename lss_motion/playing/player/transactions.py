"""Lists of queries and orders that are sent on every bus at the same time.

`Dialogue` sends one list, repeats lost queries, and collects the answers; the phases before and
after a show use it. `Conversation` wraps one with its own lines, for tools that examine or set up
servos without a show.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Protocol

from msgspec import Struct

from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.protocol.framing import encode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.query_tracker import PendingQuery
    from lss_motion.protocol.framing import Command, Reply
    from lss_motion.robot.model import Bus


TRIES: Final = 6
"""A query is sent this often before the servo counts as silent: on a line that loses every third
answer, one of 700 queries stays open. A servo without any answer does not get its other queries."""
AGREE_TRIES: Final = 8
"""A query whose answer must be confirmed is sent this often at most: on a line that corrupts every
third answer, one of 500 queries stays open."""


class Item(Struct, frozen=True, kw_only=True):
    """One command for one bus. A query waits for its answer, an order does not.

    With `agree_within`, a number is accepted when `agreeing` answers differ by no more than that
    (wire units), and a word when it came so often: a bus without checksums can deliver a wrong one.
    """

    bus: str
    command: Command
    is_query: bool
    tries: int = TRIES
    agree_within: int | None = None
    agreeing: int = 2


@dataclass(slots=True, eq=False)
class _Entry:
    item: Item
    tries_left: int
    earlier_values: list[int | str | None] = field(default_factory=list)

    def accepts(self, value: int | str | None) -> bool:
        """Use an answer; return whether it is accepted."""
        within = self.item.agree_within
        if within is None:
            return True
        agreeing = 1 + sum(_agree(value, earlier, within) for earlier in self.earlier_values)
        self.earlier_values.append(value)
        return agreeing >= self.item.agreeing

    @property
    def may_agree(self) -> bool:
        """Whether it is worth sending it again, after an answer that was not accepted."""
        return len(self.earlier_values) < AGREE_TRIES * (self.item.agreeing - 1)


class Transactions(Protocol):
    """Queries and orders that are sent on all buses until they are finished."""

    answers: dict[tuple[str, int, str], int | str | None]

    @property
    def is_finished(self) -> bool: ...

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None: ...

    def next_wakeup_ns(self) -> int | None: ...


class Dialogue:
    """Sends items in order, on all buses at the same time.

    Different queries to one servo are in flight together; an order waits until all queries before
    it are answered. `answers` maps `(bus, servo id, keyword)` to the value; a query without an
    answer is absent.
    """

    def __init__(
        self,
        items: Iterable[Item],
        lines: Mapping[str, SerialLine],
        trackers: Mapping[str, QueryTracker],
    ) -> None:
        self.answers: dict[tuple[str, int, str], int | str | None] = {}
        self._lines = lines
        self._trackers = trackers
        self._queues: dict[str, deque[_Entry]] = {bus: deque() for bus in lines}
        self._in_flight: dict[str, list[_Entry]] = {bus: [] for bus in lines}
        self._answering: set[tuple[str, int]] = set()
        for item in items:
            self._queues[item.bus].append(_Entry(item, item.tries))

    @property
    def is_finished(self) -> bool:
        return not any(self._queues.values()) and not any(self._in_flight.values())

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""
        for bus in self._queues:
            self._trackers[bus].expire(now_ns)
            self._take_back(bus)
            queue = self._queues[bus]
            while queue and self._can_send(bus, queue[0].item, now_ns):
                entry = queue.popleft()
                if entry.item.is_query:
                    self._trackers[bus].send(entry.item.command, now_ns)
                    entry.tries_left -= 1
                    self._in_flight[bus].append(entry)
                else:
                    self._lines[bus].send(encode(entry.item.command), now_ns)

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        for query, answer in self._trackers[bus].receive(reply, now_ns):
            if (entry := self._entry_of(bus, query)) is not None:
                self._in_flight[bus].remove(entry)
                self._answering.add((bus, query.command.servo_id))
                if entry.accepts(answer.value):
                    self.answers[bus, query.command.servo_id, query.command.keyword] = answer.value
                elif entry.may_agree:
                    entry.tries_left = entry.item.tries  # It answers, so it is not silent.
                    self._queues[bus].appendleft(entry)

    def next_wakeup_ns(self) -> int | None:
        wakeups_ns = []
        for bus, queue in self._queues.items():
            tracker = self._trackers[bus]
            if (give_up_ns := tracker.give_up_ns) is not None:
                wakeups_ns.append(give_up_ns)
            if queue and (earliest_ns := self._earliest_ns(bus, queue[0].item)) is not None:
                wakeups_ns.append(max(self._lines[bus].free_ns, earliest_ns))
        return min(wakeups_ns, default=None)

    def _can_send(self, bus: str, item: Item, now_ns: int) -> bool:
        earliest_ns = self._earliest_ns(bus, item)
        return earliest_ns is not None and max(self._lines[bus].free_ns, earliest_ns) <= now_ns

    def _earliest_ns(self, bus: str, item: Item) -> int | None:
        """Return when `item` may leave; None: a query must be answered first."""
        command, in_flight = item.command, self._in_flight[bus]
        if not item.is_query:
            return None if in_flight else 0
        if any(entry.item.command == command for entry in in_flight):
            return None
        return self._trackers[bus].earliest_ns(command.servo_id, len(encode(command)))

    def _take_back(self, bus: str) -> None:
        """Queue unanswered queries again, in front, as long as they have tries left.

        Only those of servos without a query in flight: theirs were given up, or not accepted. A
        servo that is late with one answer is late with those behind it, which therefore lose no
        try.
        """
        tracker = self._trackers[bus]
        entries = [
            entry
            for entry in self._in_flight[bus]
            if not tracker.is_waiting(entry.item.command.servo_id)
        ]
        late: set[int] = set()
        for entry in entries:
            if entry.item.command.servo_id in late:
                entry.tries_left += 1
            late.add(entry.item.command.servo_id)
        for entry in reversed(entries):
            self._in_flight[bus].remove(entry)
            if entry.tries_left > 0:
                self._queues[bus].appendleft(entry)
            elif (bus, entry.item.command.servo_id) not in self._answering:
                self._give_up(bus, entry.item.command.servo_id)

    def _give_up(self, bus: str, servo_id: int) -> None:
        """Drop the queries to a servo that has answered none; it may still receive orders."""
        kept = [
            entry
            for entry in self._queues[bus]
            if not (entry.item.is_query and entry.item.command.servo_id == servo_id)
        ]
        self._queues[bus] = deque(kept)

    def _entry_of(self, bus: str, query: PendingQuery) -> _Entry | None:
        """Return the entry of a query; None: an earlier dialogue has sent the query."""
        for entry in self._in_flight[bus]:
            if entry.item.command is query.command:
                return entry
        return None


def _agree(one: int | str | None, other: int | str | None, within: int) -> bool:
    if isinstance(one, int) and isinstance(other, int):
        return abs(one - other) <= within
    return one == other


class Conversation:
    """A `Dialogue` that the runner can drive by itself. It sends nothing but its items."""

    def __init__(self, items: Iterable[Item], buses: Mapping[str, Bus]) -> None:
        self.lines = {name: SerialLine(bus) for name, bus in buses.items()}
        self.trackers = {name: QueryTracker(line) for name, line in self.lines.items()}
        self._dialogue: Transactions = Dialogue(items, self.lines, self.trackers)

    @property
    def answers(self) -> Mapping[tuple[str, int, str], int | str | None]:
        """Answers by `(bus, servo id, keyword)`."""
        return self._dialogue.answers

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        self._dialogue.advance(leaves_ns)
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        for reply, _ in self.lines[bus].receive(data, now_ns):
            self._dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return None if self._dialogue.is_finished else self._dialogue.next_wakeup_ns()

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}
