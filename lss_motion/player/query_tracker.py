"""The queries in flight on one bus: what was asked, what answers it, when to ask the next.

The line is full duplex: a query may leave while an answer comes in. Two servos that answer at once
destroy both answers, so the next servo is asked such that even its quickest answer begins after
the slowest one of the servo before. One servo answers in the order in which it was asked and never
collides with itself: several questions to it fly together, and its answers follow each other
without a gap. How quick and how slow a servo is, is learnt (`turnaround`).

Nothing in an answer says which of several equal questions it answers. So equal questions end with
another one: its answer shows, since the servo keeps the order, whether exactly as many answers came
as were asked for. If not, one was lost or came twice, and none of them is believed.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.player.polling import ReplyLatency
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from lss_motion.player.serial_line import SerialLine


GRACE_NS: Final = 10 * NS_PER_MS
"""An answer is given up so long after the latest instant that is known of its servo."""
REPLY_MAX_BYTES: Final = 24
"""The longest answer that is waited for: a serial number (FACTS.md C15)."""
STRAY_NS: Final = 100 * NS_PER_MS
"""After a timeout the servo is left alone this long, so that a late answer is not taken for the
answer to the next question."""
WINDOW_MAX: Final = 8
"""Unanswered questions to one servo. Assumed: 8 queries are 48 bytes, which any serial buffer
holds (Arduino's have 64)."""
DEPTH_MAX: Final = 64
"""Questions to one servo in a row. Chosen: at 500000 bps that is the fifth part of a second for
eighteen servos."""
FLIGHTS_MAX: Final = 2
"""Servos with unanswered questions: one that is answering, and the next."""
STARVED_NS: Final = 20 * NS_PER_MS
"""When nothing was asked on a bus for so long, whoever is missed there is asked behind the moves,
however many: on a host that is late every time some are due always. Chosen; a question makes the
next move later by less than another move would."""


@dataclass(frozen=True, slots=True)
class PendingQuery:
    """A query in flight. `heard_ns` is when the servo had it complete."""

    command: Command
    arrival_ns: int
    reply_bytes: int
    """The longest answer that is to be expected."""


@dataclass(slots=True)
class _Flight:
    """Questions to one servo from the first that is not answered on."""

    waiting: deque[PendingQuery] = field(default_factory=deque)
    held: list[tuple[PendingQuery, Reply]] = field(default_factory=list)
    """Answers that could be to one of several questions: believed when all have been answered."""
    counts: Counter[str] = field(default_factory=Counter)
    """How often it asked what."""
    is_doubtful: bool = False
    """An answer was lost or came twice."""
    garbage: int = 0
    """How much the line had seen when it began: garbage may have been an answer, too."""
    arrived_ns: int = 0
    end_ns: int = 0
    """When the last answer has come in at the latest."""
    give_up_ns: int = 0


@dataclass(slots=True)
class _LinkState:
    """What is known of how one servo answers."""

    latency: ReplyLatency = field(default_factory=ReplyLatency)
    depth: int = 1
    """Questions that it may be asked in a row: doubled by a row that it answers whole."""
    failures: int = 0
    quiet_until_ns: int = 0
    overdue: set[str] = field(default_factory=set)
    """Keywords of answers that were given up and may still come."""
    reply_bytes: dict[str, int] = field(default_factory=dict)
    least_bytes: int = 1
    """The shortest answer that is to be expected."""
    last_sent_ns: int = 0
    last_reply_ns: int | None = None

    def note_size(self, keyword: str, size_bytes: int) -> None:
        """Note how long an answer was: the next one may have a digit more."""
        if self.reply_bytes.get(keyword) != size_bytes + 1:
            self.reply_bytes[keyword] = size_bytes + 1
            self.least_bytes = min(self.reply_bytes.values())

    def succeed(self) -> None:
        self.depth = min(2 * self.depth, DEPTH_MAX)
        self.failures = 0

    def fail(self) -> None:
        """Trust the servo less; after two failures in a row, what was learnt no longer holds."""
        self.depth = max(1, self.depth // 2)
        self.failures += 1
        if self.failures > 1:
            self.latency.forget()


class QueryTracker:
    """Asks on one line and knows which answers may be believed."""

    def __init__(self, line: SerialLine) -> None:
        self._line = line
        self._last_ns = 0
        self.query_count = 0
        self.reply_count = 0
        self.timeouts = 0
        self.strays = 0
        self._flights: dict[int, _Flight] = {}
        self._links: dict[int, _LinkState] = {}
        self._lost: list[PendingQuery] = []

    def is_waiting(self, servo_id: int) -> bool:
        """Return whether a question to `servo_id` is in flight."""
        return servo_id in self._flights

    @property
    def give_up_ns(self) -> int | None:
        """When `expire` has something to do at the latest; None: nothing is in flight."""
        return min((flight.give_up_ns for flight in self._flights.values()), default=None)

    def quiet_until_ns(self, servo_id: int) -> int:
        """Return until when a servo is left alone after a timeout."""
        return self._known(servo_id).quiet_until_ns

    def is_starved(self, now_ns: int) -> bool:
        """Return whether nobody was asked for too long."""
        return now_ns - self._last_ns > STARVED_NS

    def last_sent_ns(self, servo_id: int) -> int:
        """Return when a servo was last asked; 0: never."""
        return self._known(servo_id).last_sent_ns

    def last_reply_ns(self, servo_id: int) -> int | None:
        """Return when a servo last answered, be it believed or too late; None: never."""
        return self._known(servo_id).last_reply_ns

    def latency(self, servo_id: int) -> ReplyLatency:
        return self._known(servo_id).latency

    @property
    def shortest_latency_ns(self) -> int | None:
        """The shortest wait for an answer of any servo so far; None: there was no answer."""
        waits_ns = [link.latency.least_ns for link in self._links.values()]
        return min((wait_ns for wait_ns in waits_ns if wait_ns is not None), default=None)

    def depth(self, servo_id: int) -> int:
        """Return how many questions in a row the servo may be asked after what it has shown."""
        return self._known(servo_id).depth

    def reply_bytes(self, servo_id: int, keyword: str) -> int:
        """Return the longest answer to be expected: a digit more than the last one."""
        return self._known(servo_id).reply_bytes.get(keyword, REPLY_MAX_BYTES)

    def is_overdue(self, servo_id: int, keyword: str) -> bool:
        """Return whether a late answer could be taken for the answer to `keyword`.

        The servo answers in order: its answer to anything else ends this.
        """
        return keyword in self._known(servo_id).overdue

    def earliest_ns(self, servo_id: int, size_bytes: int) -> int | None:
        """Return from when on a question of `size_bytes` may begin to leave.

        None: not before something that is in flight was answered or given up.
        """
        link = self._known(servo_id)
        if self._flights and servo_id == next(reversed(self._flights)):
            is_full = len(self._flights[servo_id].waiting) >= self._window(link)
            return None if is_full else link.quiet_until_ns
        if servo_id in self._flights or len(self._flights) >= FLIGHTS_MAX:
            return None
        arrival_ns = 0
        for other_id, flight in self._flights.items():
            if not (link.latency.is_known and self._known(other_id).latency.is_known):
                return None
            arrival_ns = max(arrival_ns, flight.end_ns - link.latency.earliest_ns)
        return max(link.quiet_until_ns, arrival_ns - self._line.time_ns(size_bytes))

    def send(self, command: Command, now_ns: int) -> None:
        """Hand over a question; `earliest_ns` says when it may be."""
        servo_id = command.servo_id
        arrival_ns = self._line.send(encode(command), now_ns)
        if (flight := self._flights.get(servo_id)) is None:
            flight = self._flights[servo_id] = _Flight(garbage=self._line.garbage)
        reply_bytes = self.reply_bytes(servo_id, command.keyword)
        flight.counts[command.keyword] += 1
        flight.waiting.append(PendingQuery(command, arrival_ns, reply_bytes))
        self._predict(servo_id, flight)
        self._known(servo_id).last_sent_ns = self._last_ns = now_ns
        self.query_count += 1

    def receive(self, reply: Reply, now_ns: int) -> list[tuple[PendingQuery, Reply]]:
        """Return the questions that are now answered beyond doubt, with their answers.

        A reply that answers nothing is a stray, which is counted. `*QID5` names no sender; it
        answers a question for an id only.
        """
        servo_id, asked = self._asked_for(reply, now_ns)
        if asked is None:
            self._note_stray(servo_id, reply.keyword, now_ns)
            return []
        flight, link = self._flights[servo_id], self._known(servo_id)
        self.reply_count += 1
        size_bytes = len(encode(reply))
        link.note_size(reply.keyword, size_bytes)
        if flight.arrived_ns <= asked.arrival_ns and asked is flight.waiting[0]:
            began_ns = now_ns - self._line.time_ns(size_bytes)
            link.latency.take(began_ns - asked.arrival_ns)
        while (passed := flight.waiting.popleft()) is not asked:
            flight.is_doubtful = True
            self._lost.append(passed)
        flight.arrived_ns = link.last_reply_ns = now_ns
        flight.held.append((asked, reply))
        link.overdue.clear()
        self._predict(servo_id, flight)
        return self._believed(servo_id, flight)

    def expire(self, now_ns: int) -> list[PendingQuery]:
        """Give up the questions whose time is over; return them."""
        given_up, self._lost = self._lost, []
        late = [one for one, flight in self._flights.items() if now_ns >= flight.give_up_ns]
        for servo_id in late:
            flight, link = self._flights.pop(servo_id), self._known(servo_id)
            given_up += flight.waiting
            self.strays += len(flight.held)
            link.quiet_until_ns = now_ns + STRAY_NS
            link.overdue.update(asked.command.keyword for asked in flight.waiting)
            link.fail()
        self.timeouts += len(given_up)
        return given_up

    def _known(self, servo_id: int) -> _LinkState:
        if (link := self._links.get(servo_id)) is None:
            link = self._links[servo_id] = _LinkState()
        return link

    def _window(self, link: _LinkState) -> int:
        """Return how many questions must fly so that the servo never waits for one."""
        latency = link.latency
        if not latency.is_known:
            return 1
        shortest_ns = self._line.time_ns(link.least_bytes)
        return min(WINDOW_MAX, 3 + latency.latest_ns // shortest_ns)

    def _asked_for(self, reply: Reply, now_ns: int) -> tuple[int, PendingQuery | None]:
        """Return who sent a reply and the oldest question that it can answer."""
        if reply.servo_id is None:
            servo_id = next(iter(self._flights), -1) if reply.keyword == "QID" else -1
        else:
            servo_id = reply.servo_id
        flight = self._flights.get(servo_id)
        for asked in flight.waiting if flight is not None else ():
            if asked.command.keyword == reply.keyword:
                return servo_id, asked if now_ns >= asked.arrival_ns else None
        return servo_id, None

    def _note_stray(self, servo_id: int, keyword: str, now_ns: int) -> None:
        self.strays += 1
        flight, link = self._flights.get(servo_id), self._links.get(servo_id)
        if flight is not None:
            flight.is_doubtful = True
        if link is not None and keyword in link.overdue:
            link.last_reply_ns = now_ns
            if flight is None:
                link.latency.forget()

    def _believed(self, servo_id: int, flight: _Flight) -> list[tuple[PendingQuery, Reply]]:
        """Return, and no longer hold, the answers that no other question could mean."""
        newest = flight.held[-1]
        if flight.waiting:
            if flight.counts[newest[1].keyword] > 1:
                return []
            flight.held.pop()
            return [newest]
        del self._flights[servo_id]
        believed = flight.held
        if flight.is_doubtful or flight.garbage != self._line.garbage:
            self._known(servo_id).fail()
            believed = [pair for pair in believed if flight.counts[pair[1].keyword] == 1]
            self.strays += len(flight.held) - len(believed)
        else:
            self._known(servo_id).succeed()
        return believed

    def _predict(self, servo_id: int, flight: _Flight) -> None:
        """Find out when the last answer of a flight has come in at the latest."""
        latency = self._known(servo_id).latency
        latest_ns = latency.latest_ns
        end_ns = flight.arrived_ns
        for asked in flight.waiting:
            end_ns = max(end_ns, asked.arrival_ns + latest_ns)
            end_ns += self._line.time_ns(asked.reply_bytes)
        flight.end_ns = end_ns
        flight.give_up_ns = end_ns + (GRACE_NS if latency.is_known else 0)
