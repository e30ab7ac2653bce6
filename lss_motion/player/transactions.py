"""Lists of questions and orders that are worked through on every bus.

A list of questions and orders, worked through on every bus at once: for before and after.

Questions and orders alone, without a show: for tools that look at a robot or set it up.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.player.query_tracker import QueryTracker
from lss_motion.player.serial_line import SerialLine
from lss_motion.protocol.line import encode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.events import Event
    from lss_motion.player.query_tracker import PendingQuery
    from lss_motion.protocol.line import Command, Reply
    from lss_motion.robot.model import Bus


TRIES: Final = 6
"""A question is asked so often before the servo counts as silent: on a line that loses every third
answer, one of 700 questions stays open. A servo that has not answered any is not asked the rest."""
AGREE_TRIES: Final = 8
"""A question whose answer must be heard twice is asked no oftener than this: on a line that
corrupts every third answer, one of 500 questions stays open."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One command for one bus. A question waits for its answer, an order does not.

    With `agree_within`, a number is believed when two answers differ by no more than that (wire
    units), and a word when it was said twice: a bus without checksums can deliver a wrong one.
    """

    bus: str
    command: Command
    is_query: bool
    tries: int = TRIES
    agree_within: int | None = None


@dataclass(slots=True, eq=False)
class _Entry:
    item: Item
    tries_left: int
    heard: list[int | str | None] = field(default_factory=list)

    def believes(self, value: int | str | None) -> bool:
        """Take in an answer; return whether it is the one."""
        within = self.item.agree_within
        if within is None or any(_agree(value, earlier, within) for earlier in self.heard):
            return True
        self.heard.append(value)
        return False


class Dialogue:
    """Works through items in order, bus by bus at the same time.

    Different questions to one servo fly together; an order waits until all before it is answered.
    `answers` maps `(bus, servo id, keyword)` to the value; a question without an answer is absent.
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
        for asked, said in self._trackers[bus].receive(reply, now_ns):
            if (entry := self._entry_of(bus, asked)) is not None:
                self._in_flight[bus].remove(entry)
                self._answering.add((bus, asked.command.servo_id))
                if entry.believes(said.value):
                    self.answers[bus, asked.command.servo_id, asked.command.keyword] = said.value
                elif len(entry.heard) < AGREE_TRIES:
                    entry.tries_left = entry.item.tries  # It is not silent.
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
        """Return from when on `item` may leave; None: something must be answered first."""
        command, in_flight = item.command, self._in_flight[bus]
        if not item.is_query:
            return None if in_flight else 0
        if any(entry.item.command == command for entry in in_flight):
            return None
        return self._trackers[bus].earliest_ns(command.servo_id, len(encode(command)))

    def _take_back(self, bus: str) -> None:
        """Put what was not answered in front again, as long as it has tries left.

        Nothing of a servo is in flight: what it was asked was given up, or not believed. A servo
        that is late with one answer is late with those behind it: they lose no try.
        """
        tracker = self._trackers[bus]
        entries = [
            entry
            for entry in self._in_flight[bus]
            if not tracker.is_waiting(entry.item.command.servo_id)
        ]
        blamed: set[int] = set()
        for entry in entries:
            if entry.item.command.servo_id in blamed:
                entry.tries_left += 1
            blamed.add(entry.item.command.servo_id)
        for entry in reversed(entries):
            self._in_flight[bus].remove(entry)
            if entry.tries_left > 0:
                self._queues[bus].appendleft(entry)
            elif (bus, entry.item.command.servo_id) not in self._answering:
                self._give_up(bus, entry.item.command.servo_id)

    def _give_up(self, bus: str, servo_id: int) -> None:
        """Ask no more of a servo that has answered nothing; what it is told may still be heard."""
        kept = [
            entry
            for entry in self._queues[bus]
            if not (entry.item.is_query and entry.item.command.servo_id == servo_id)
        ]
        self._queues[bus] = deque(kept)

    def _entry_of(self, bus: str, asked: PendingQuery) -> _Entry | None:
        """Return the entry that asked this: one may be left in flight by what came before."""
        for entry in self._in_flight[bus]:
            if entry.item.command is asked.command:
                return entry
        return None


def _agree(one: int | str | None, other: int | str | None, within: int) -> bool:
    if isinstance(one, int) and isinstance(other, int):
        return abs(one - other) <= within
    return one == other


class Conversation:
    """A `Dialogue` that the runner can drive by itself. Moves nothing that its items do not."""

    def __init__(self, items: Iterable[Item], buses: Mapping[str, Bus]) -> None:
        self.lines = {name: SerialLine(bus) for name, bus in buses.items()}
        trackers = {name: QueryTracker(line) for name, line in self.lines.items()}
        self._dialogue = Dialogue(items, self.lines, trackers)

    @property
    def answers(self) -> Mapping[tuple[str, int, str], int | str | None]:
        """Return what was answered: `(bus, servo id, keyword)` → value."""
        return self._dialogue.answers

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        self._dialogue.advance(leaves_ns)
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        for reply in self.lines[bus].receive(data):
            self._dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return None if self._dialogue.is_finished else self._dialogue.next_wakeup_ns()

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}
