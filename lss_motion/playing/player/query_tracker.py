"""Queries in flight on one bus: which answer belongs to which query, and when the next may leave.

`SerialLine` is the line itself: when it is free, what must be written, what came in.

The line is full duplex: a query may leave while an answer comes in. Two servos that answer at once
destroy both answers. So the query to the next servo is sent such that even its quickest answer
begins after the slowest one of the servo before. One servo answers in the order of its queries and
never collides with itself: several queries to it are in flight together, and their answers follow
each other without a gap. `ReplyLatency` learns how quick each servo is.

An answer does not show which of several equal queries it belongs to. So a row of equal queries ends
with a different one. Since the servo keeps the order, the answer to that shows whether exactly as
many answers came as queries were sent. If not, one was lost or came twice, and all are rejected.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.playing.player.echo import EchoFilter
from lss_motion.playing.player.twins import Twins
from lss_motion.protocol.framing import Command, Garbage, Reply, ReplyParser, encode_query, size_of
from lss_motion.units import NS_PER_MS, NS_PER_S, line_time_ns

if TYPE_CHECKING:
    from lss_motion.robot.model import Bus


class LineTimes(dict[int, int]):
    """How long so many bytes occupy a line, each computed once: several are needed per query."""

    def __init__(self, baud_bps: int) -> None:
        super().__init__()
        self._baud_bps = baud_bps

    def __missing__(self, size_bytes: int) -> int:
        self[size_bytes] = time_ns = line_time_ns(size_bytes, self._baud_bps)
        return time_ns


class SerialLine:
    """One bus. Bytes that are handed over leave in order, at the baud rate."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.free_ns = 0
        self.sent_bytes = 0
        self.replies = 0
        self.garbage = 0
        self.echo = EchoFilter()
        self._parser = ReplyParser(grouped=False)
        self.out = bytearray()
        """What was handed over since the last call of `take`."""
        self.times_ns = LineTimes(bus.baud_bps)

    def time_ns(self, size_bytes: int) -> int:
        """Return how long `size_bytes` occupy the line."""
        return self.times_ns[size_bytes]

    def arrival_ns(self, size_bytes: int, now_ns: int) -> int:
        """Return when the last of `size_bytes` would arrive if they were handed over now."""
        free_ns = self.free_ns
        return (now_ns if now_ns > free_ns else free_ns) + self.times_ns[size_bytes]

    def send(self, data: bytes, now_ns: int) -> int:
        """Hand over `data`; return when its last byte arrives at the servos."""
        size_bytes = len(data)
        self.free_ns = self.arrival_ns(size_bytes, now_ns)
        self.sent_bytes += size_bytes
        self.out += data
        self.echo.note_sent(data)
        return self.free_ns

    def take(self) -> bytes:
        """Return what was handed over since the last call."""
        data, self.out = bytes(self.out), bytearray()
        return data

    @property
    def has_unfinished(self) -> bool:
        """Whether bytes came that are no whole reply yet."""
        return self._parser.has_unfinished

    def receive(self, data: bytes, now_ns: int) -> list[tuple[Reply, int]]:
        """Return the replies in `data`, and when each ended at the latest.

        `data` came by `now_ns`. A reply with others behind it ended earlier, by the time that these
        take on the line. What is no reply is counted.
        """
        pairs: list[tuple[Reply, int]] = []
        for item in reversed(self._parser.feed(self.echo.without_echo(data))):
            if isinstance(item, Garbage):
                self.garbage += 1
                continue
            self.replies += 1
            if pairs:
                now_ns -= self.times_ns[size_of(pairs[-1][0])]
            pairs.append((item, now_ns))
        return pairs[::-1]


GRACE_NS: Final = 10 * NS_PER_MS
"""Time after the latest known answer of a servo until a query is given up."""
QUERY_MAX_BYTES: Final = 8
"""Longest query during a show, `#254QFPC`, without its CR."""
REPLY_MAX_BYTES: Final = 24
"""Longest expected answer: a serial number (FACTS.md C15)."""
STRAY_NS: Final = 100 * NS_PER_MS
"""After a timeout the servo is not polled for this long, so that a late answer is not taken for the
answer to the next query."""
WINDOW_MAX: Final = 8
"""Unanswered queries to one servo. Assumed: 8 queries are 48 bytes, which any serial buffer holds
(Arduino's have 64)."""
DEPTH_MAX: Final = 64
"""Queries to one servo in a row. Chosen: at 500000 bps this takes a fifth of a second for eighteen
servos."""
FLIGHTS_MAX: Final = 2
"""Servos with unanswered queries: the one that is answering, and the next."""
STARVED_NS: Final = 20 * NS_PER_MS
"""If no query was sent on a bus for this long, overdue servos are polled although moves are due: on
a host that is always late, moves are always due. Chosen; a query delays the next move less than
another move does."""
WINDOW: Final = 32
"""Number of remembered answers. Chosen: one in 33 exceeds all of them by chance."""
SAMPLES_LEAST: Final = 4
"""With fewer answers the latency is unknown: then only one servo is polled at a time."""
SAMPLES_ENOUGH: Final = 12
"""With so many answers most flights may be patient. Chosen: the range of the latency is then known
to a third of its spread (`MARGIN_SAMPLES`), after a second of ordinary polling."""
PROMPT_EVERY: Final = 16
"""One flight in so many is prompt all the same, so that a latency that changes is noticed."""
PATIENT_SPREAD: Final = 4
"""The last answer of a patient flight may be later than that of a prompt one by this part of the
spread: few of its answers are timed, and where lines are not filled there is room."""
PATIENCE_NS: Final = 4 * NS_PER_MS
"""Answers of a patient flight wait this long after the last one should have come in. Chosen: most
are read with the next query or move then, and a lost move is sent again only this much later."""
REPLY_TIMEOUT_NS: Final = 30 * NS_PER_MS
"""Time for the answer of an unknown servo: the stricter libraries wait 10 ms (FACTS.md H5), and a
USB adapter may add its 16 ms timer."""
SLOW_TIMEOUT_NS: Final = 100 * NS_PER_MS
"""The answer of a servo that has turned out to be slower is waited for no longer than this. Chosen:
a query to a servo that is silent holds up the others for so long."""
SLOWER_RATIO: Final = 1.25
"""A servo that is slower than was assumed gets so much of the time that it needed. Chosen."""
AWAY_NS: Final = 4 * NS_PER_S // 10
"""Another servo is not put in the place of one in less. Chosen: three lost answers at 9600 bps."""
MARGIN_SAMPLES: Final = 4
"""The next answer may be earlier or later than all n remembered ones by 4/n of their spread.
Chosen: of evenly spread values, one in some hundred exceeds it."""


class ReplyLatency:
    """Estimate for one servo. It includes the delay of adapter and host."""

    def __init__(self) -> None:
        self._waits_ns: deque[int] = deque(maxlen=WINDOW)
        self.is_known = False
        self.earliest_ns = 0
        """No answer begins sooner after its query has arrived."""
        self.latest_ns = REPLY_TIMEOUT_NS
        """No answer begins later, as far as is known."""

    @property
    def spread_ns(self) -> int:
        return self.latest_ns - self.earliest_ns

    @property
    def least_ns(self) -> int | None:
        """The shortest remembered latency; None: there is none."""
        return min(self._waits_ns, default=None)

    def take(self, waited_ns: int) -> None:
        """Use an answer that began `waited_ns` after its query had arrived."""
        self._waits_ns.append(waited_ns if waited_ns > 0 else 0)
        count = len(self._waits_ns)
        if count < SAMPLES_LEAST:
            return
        least_ns, most_ns = min(self._waits_ns), max(self._waits_ns)
        margin_ns = MARGIN_SAMPLES * (most_ns - least_ns) // count
        self.earliest_ns = least_ns - margin_ns if least_ns > margin_ns else 0
        self.latest_ns = most_ns + margin_ns
        self.is_known = True

    @property
    def is_well_known(self) -> bool:
        """Whether enough answers are remembered that another one teaches little."""
        return len(self._waits_ns) >= SAMPLES_ENOUGH

    def forget(self, waited_ns: int = 0) -> None:
        """Start anew: the servo answers differently now, lately after `waited_ns`."""
        self._waits_ns.clear()
        self.is_known = False
        is_slow = REPLY_TIMEOUT_NS < SLOWER_RATIO * waited_ns <= SLOW_TIMEOUT_NS
        self.earliest_ns = 0
        self.latest_ns = int(SLOWER_RATIO * waited_ns) if is_slow else REPLY_TIMEOUT_NS


class PendingQuery(NamedTuple):
    """A query in flight. The servo has received it completely at `arrival_ns`."""

    command: Command
    arrival_ns: int
    reply_bytes: int
    """Longest expected answer."""


@dataclass(slots=True)
class _Flight:
    """Queries to one servo, from the first unanswered one on."""

    waiting: deque[PendingQuery] = field(default_factory=deque)
    held: list[tuple[PendingQuery, Reply]] = field(default_factory=list)
    """Answers that may belong to one of several queries: accepted when all are answered."""
    counts: dict[str, int] = field(default_factory=dict)
    """Number of queries by keyword."""
    is_patient: bool = False
    """Its answers are read when that costs no turn of the loop. They show no latency."""
    is_doubtful: bool = False
    """An answer was lost or came twice."""
    garbage: int = 0
    """Garbage count of the line at the first query: garbage may have been an answer."""
    arrived_ns: int = 0
    end_ns: int = 0
    """Latest instant at which the last answer has come in."""
    give_up_ns: int = 0


@dataclass(slots=True)
class _LinkState:
    """What is known about the answers of one servo."""

    latency: ReplyLatency = field(default_factory=ReplyLatency)
    depth: int = 1
    """Queries in a row that the servo may get; doubled after a complete row."""
    failures: int = 0
    quiet_until_ns: int = 0
    overdue: dict[str, int] = field(default_factory=dict)
    """Keywords of answers that were given up and may still come; when their queries arrived."""
    reply_bytes: dict[str, int] = field(default_factory=dict)
    least_bytes: int = 1
    """Shortest expected answer."""
    last_sent_ns: int = 0
    last_reply_ns: int | None = None
    missed_ns: int | None = None
    """When the first query without an answer had arrived since the last one with one."""
    back_ns: int = 0
    """When an answer ended the last absence of `AWAY_NS` or more; 0: there was none."""
    gap_ns: int = 0
    """The same with times in which it was not asked."""
    flights: int = 0

    def note_size(self, keyword: str, size_bytes: int) -> None:
        """Note the size of an answer; the next one may have a digit more."""
        if self.reply_bytes.get(keyword) != size_bytes + 1:
            self.reply_bytes[keyword] = size_bytes + 1
            self.least_bytes = min(self.reply_bytes.values())

    def succeed(self) -> None:
        self.depth = min(2 * self.depth, DEPTH_MAX)
        self.failures = 0

    def fail(self) -> None:
        """Shorten the rows; after two failures in a row the latency is learnt anew."""
        self.depth = max(1, self.depth // 2)
        self.failures += 1
        if self.failures > 1:
            self.latency.forget()


class QueryTracker:
    """Sends queries on one line and decides which answers are accepted."""

    def __init__(self, line: SerialLine) -> None:
        self.line = line
        self.starves_ns = STARVED_NS
        """After this instant no query was sent for too long."""
        self.query_count = 0
        self.reply_count = 0
        self.timeouts = 0
        self.strays = 0
        self.unasked: Counter[tuple[int, str]] = Counter()
        """Of the strays, by id and keyword, those that are no late answers."""
        self.twins = Twins()
        self._flights: dict[int, _Flight] = {}
        self._links: defaultdict[int, _LinkState] = defaultdict(_LinkState)
        self._lost: list[PendingQuery] = []
        self._newest_id = -1
        """The servo of the newest flight."""
        self.give_up_ns: int | None = None
        """When `expire` must be called at the latest; None: no query is in flight."""
        self._first_end_ns: int | None = 0
        """When the first flight ends, 0 without any; None: not all of them are patient."""
        self._last_end_ns = 0
        """When the last flight ends, 0 without any."""
        self._quickest_ns: int | None = None
        """The latest of the earliest answers of all servos; None: an answer may have changed it."""

    def is_waiting(self, servo_id: int) -> bool:
        """Return whether a query to `servo_id` is in flight."""
        return servo_id in self._flights

    def awaits(self, servo_id: int, keyword: str) -> bool:
        """Return whether a query for `keyword` is in flight, or its answer is not accepted yet."""
        flight = self._flights.get(servo_id)
        if flight is None:
            return False
        queries = [*flight.waiting, *(query for query, _ in flight.held)]
        return any(query.command.keyword == keyword for query in queries)

    def quiet_until_ns(self, servo_id: int) -> int:
        """Return until when a servo is not polled after a timeout."""
        return self._links[servo_id].quiet_until_ns

    def last_sent_ns(self, servo_id: int) -> int:
        """Return when the last query to a servo was sent; 0: never."""
        return self._links[servo_id].last_sent_ns

    def last_reply_ns(self, servo_id: int) -> int | None:
        """Return when a servo last answered, accepted or too late; None: never."""
        return self._links[servo_id].last_reply_ns

    def back_ns(self, servo_id: int) -> int:
        """Return when a servo answered again after an absence of `AWAY_NS` or more; 0: never."""
        return self._links[servo_id].back_ns

    def gap_ns(self, servo_id: int) -> int:
        """Return when a servo answered after `AWAY_NS` or more without an answer; 0: never.

        It may not have been asked meanwhile.
        """
        return self._links[servo_id].gap_ns

    def latency(self, servo_id: int) -> ReplyLatency:
        return self._links[servo_id].latency

    @property
    def shortest_latency_ns(self) -> int | None:
        """Shortest latency of any answer so far; None: there was no answer."""
        waits_ns = [link.latency.least_ns for link in self._links.values()]
        return min((wait_ns for wait_ns in waits_ns if wait_ns is not None), default=None)

    def depth(self, servo_id: int) -> int:
        """Return how many queries in a row the servo may get."""
        return self._links[servo_id].depth

    def reply_bytes(self, servo_id: int, keyword: str) -> int:
        """Return the longest expected answer: a digit more than the last one."""
        return self._links[servo_id].reply_bytes.get(keyword, REPLY_MAX_BYTES)

    def is_overdue(self, servo_id: int, keyword: str) -> bool:
        """Return whether a late answer could be taken for the answer to `keyword`.

        The servo answers in order, so its answer to any other query ends this.
        """
        return keyword in self._links[servo_id].overdue

    def reads_ns(self, now_ns: int) -> int | None:
        """Return until when answers may wait to be handed over; None: they may not.

        Answers of prompt flights may not, since they show the latency of a servo.
        """
        first_ns = self._first_end_ns
        if first_ns is None or first_ns + PATIENCE_NS <= now_ns:
            return None
        return first_ns + PATIENCE_NS

    def free_ns(self) -> int | None:
        """Return when the next query may leave if the answers in flight come on time.

        None: that is not known. For a time at which to look again, after `earliest_ns` had none.
        """
        first_ns = self._first_end_ns
        return None if first_ns is None else max(first_ns, self.not_before_ns())

    def _note_ends(self) -> None:
        """Keep when the present flights end, which is asked in every turn."""
        first_ns: int | None = 0
        last_ns, give_up_ns = 0, None
        for servo_id, flight in self._flights.items():
            self._newest_id = servo_id
            if not flight.is_patient:
                first_ns = None
            elif first_ns == 0 or (first_ns is not None and flight.end_ns < first_ns):
                first_ns = flight.end_ns
            if flight.end_ns > last_ns:
                last_ns = flight.end_ns
            if give_up_ns is None or flight.give_up_ns < give_up_ns:
                give_up_ns = flight.give_up_ns
        self._first_end_ns, self._last_end_ns, self.give_up_ns = first_ns, last_ns, give_up_ns

    def earliest_ns(self, servo_id: int, size_bytes: int, *, is_urgent: bool = False) -> int | None:
        """Return the earliest instant at which a query of `size_bytes` may begin to leave.

        None: a query in flight must be answered or given up first. An urgent one may leave soon
        after a timeout: a late answer to an earlier one is as good.
        """
        link = self._links[servo_id]
        quiet_until_ns = 0 if is_urgent else link.quiet_until_ns
        if not self._flights:
            return quiet_until_ns
        if servo_id in self._flights:
            is_newest = servo_id == self._newest_id
            is_free = is_newest and len(self._flights[servo_id].waiting) < self._window(link)
            return quiet_until_ns if is_free else None
        if len(self._flights) >= FLIGHTS_MAX:
            return None
        arrival_ns = 0
        for other_id, flight in self._flights.items():
            if not (link.latency.is_known and self._links[other_id].latency.is_known):
                return None
            own_ns = flight.end_ns - link.latency.earliest_ns
            arrival_ns = own_ns if own_ns > arrival_ns else arrival_ns
        leaves_ns = arrival_ns - self.line.times_ns[size_bytes]
        return leaves_ns if leaves_ns > quiet_until_ns else quiet_until_ns

    def not_before_ns(self) -> int:
        """Return an instant before which no query to a servo without one in flight may leave."""
        if not self._flights:
            return 0
        if self._quickest_ns is None:
            self._quickest_ns = max([link.latency.earliest_ns for link in self._links.values()])
        return self._last_end_ns - self._quickest_ns - self.line.times_ns[QUERY_MAX_BYTES]

    def send(self, command: Command, now_ns: int, *, is_patient: bool = False) -> None:
        """Send a query; `earliest_ns` returns when that is allowed.

        `is_patient`: its answer need not be read at once.
        """
        servo_id, keyword = command.servo_id, command.keyword
        link = self._links[servo_id]
        arrival_ns = self.line.send(encode_query(command), now_ns)
        if servo_id not in self._flights:
            link.flights += 1
            self.twins.note_asked(servo_id)
            is_prompt = link.flights % PROMPT_EVERY == 0 or not link.latency.is_well_known
            self._flights[servo_id] = _Flight(
                garbage=self.line.garbage, is_patient=is_patient and not is_prompt
            )
        flight = self._flights[servo_id]
        reply_bytes = link.reply_bytes.get(keyword, REPLY_MAX_BYTES)
        flight.counts[keyword] = flight.counts[keyword] + 1 if keyword in flight.counts else 1
        flight.waiting.append(PendingQuery(command, arrival_ns, reply_bytes))
        self._predict(servo_id, flight)
        link.last_sent_ns = now_ns
        self.starves_ns = now_ns + STARVED_NS
        self.query_count += 1

    def receive(self, reply: Reply, now_ns: int) -> list[tuple[PendingQuery, Reply]]:
        """Return the queries that are now answered beyond doubt, with their answers.

        A reply that belongs to no query is counted as a stray. `*QID5` carries no sender; it
        answers only a query for an id.
        """
        servo_id, query = self._query_for(reply, now_ns)
        if query is None:
            self._note_stray(servo_id, reply, now_ns)
            return []
        flight, link = self._flights[servo_id], self._links[servo_id]
        self.reply_count += 1
        size_bytes = size_of(reply)
        link.note_size(reply.keyword, size_bytes)
        is_timed = flight.arrived_ns <= query.arrival_ns and query is flight.waiting[0]
        # After `give_up_ns` this program was held up: that is no latency of the servo.
        if is_timed and now_ns < flight.give_up_ns and not flight.is_patient:
            began_ns = now_ns - self.line.times_ns[size_bytes]
            link.latency.take(began_ns - query.arrival_ns)
            self._quickest_ns = None
        while (skipped := flight.waiting.popleft()) is not query:
            flight.is_doubtful = True
            self._lost.append(skipped)
        if link.last_reply_ns is not None and now_ns - link.last_reply_ns >= AWAY_NS:
            link.gap_ns = now_ns
        flight.arrived_ns = link.last_reply_ns = now_ns
        if link.missed_ns is not None:
            link.back_ns = now_ns if now_ns - link.missed_ns >= AWAY_NS else link.back_ns
            link.missed_ns = None
        self.twins.note_answer(servo_id, reply, now_ns, flight.garbage, self.line.garbage)
        flight.held.append((query, reply))
        if link.overdue:
            link.overdue.clear()
        if flight.waiting:
            self._predict(servo_id, flight)
            return self._accepted(servo_id, flight)
        accepted = self._accepted(servo_id, flight)
        self._note_ends()
        return accepted

    def expire(self, now_ns: int) -> list[PendingQuery]:
        """Give up the queries whose time is over; return them."""
        if self.twins.unclear:
            self.twins.settle(now_ns, self.line.garbage)
        if not self._lost and (self.give_up_ns is None or now_ns < self.give_up_ns):
            return []
        given_up, self._lost = self._lost, []
        late = [one for one, flight in self._flights.items() if now_ns >= flight.give_up_ns]
        for servo_id in late:
            flight, link = self._flights.pop(servo_id), self._links[servo_id]
            given_up += flight.waiting
            if flight.garbage != self.line.garbage:
                self.twins.note_damaged(servo_id)
            if link.missed_ns is None and flight.waiting:
                link.missed_ns = flight.waiting[0].arrival_ns
            self.strays += len(flight.held)
            self._quickest_ns = None
            link.quiet_until_ns = now_ns + STRAY_NS
            link.overdue |= {query.command.keyword: query.arrival_ns for query in flight.waiting}
            link.fail()
        if late:
            self._note_ends()
        self.timeouts += len(given_up)
        return given_up

    def _window(self, link: _LinkState) -> int:
        """Return how many queries must be in flight so that the servo never idles."""
        latency = link.latency
        if not latency.is_known:
            return 1
        shortest_ns = self.line.times_ns[link.least_bytes]
        return min(WINDOW_MAX, 3 + latency.latest_ns // shortest_ns)

    def _query_for(self, reply: Reply, now_ns: int) -> tuple[int, PendingQuery | None]:
        """Return the sender of a reply and the oldest query that it can answer."""
        if reply.servo_id is None:
            servo_id = next(iter(self._flights), -1) if reply.keyword == "QID" else -1
        else:
            servo_id = reply.servo_id
        flight = self._flights.get(servo_id)
        for query in flight.waiting if flight is not None else ():
            if query.command.keyword == reply.keyword:
                return servo_id, query if now_ns >= query.arrival_ns else None
        return servo_id, None

    def _note_stray(self, servo_id: int, reply: Reply, now_ns: int) -> None:
        self.strays += 1
        keyword = reply.keyword
        flight, link = self._flights.get(servo_id), self._links.get(servo_id)
        is_late = link is not None and keyword in link.overdue
        if not is_late:
            self.unasked[servo_id, keyword] += 1
            self.twins.note_again(servo_id, reply, now_ns)
        if link is not None and is_late:
            link.last_reply_ns = now_ns
            link.latency.forget(now_ns - link.overdue[keyword])
            self._quickest_ns = None
        if flight is not None:
            flight.is_doubtful |= not is_late
            self._predict(servo_id, flight)

    def _accepted(self, servo_id: int, flight: _Flight) -> list[tuple[PendingQuery, Reply]]:
        """Return, and stop holding, the answers that can belong to one query only."""
        newest = flight.held[-1]
        if flight.waiting:
            if flight.counts[newest[1].keyword] > 1:
                return []
            flight.held.pop()
            return [newest]
        del self._flights[servo_id]
        accepted = flight.held
        if flight.is_doubtful or flight.garbage != self.line.garbage:
            self._links[servo_id].fail()
            self._quickest_ns = None
            accepted = [pair for pair in accepted if flight.counts[pair[1].keyword] == 1]
            self.strays += len(flight.held) - len(accepted)
        else:
            self._links[servo_id].succeed()
        return accepted

    def _predict(self, servo_id: int, flight: _Flight) -> None:
        """Compute when the last answer of a flight has come in at the latest."""
        latency = self._links[servo_id].latency
        latest_ns = latency.latest_ns
        if flight.is_patient:
            latest_ns += latency.spread_ns // PATIENT_SPREAD
        end_ns, times_ns = flight.arrived_ns, self.line.times_ns
        for query in flight.waiting:
            begins_ns = query.arrival_ns + latest_ns
            end_ns = (begins_ns if begins_ns > end_ns else end_ns) + times_ns[query.reply_bytes]
        flight.end_ns = end_ns
        flight.give_up_ns = end_ns + (GRACE_NS if latency.is_known else 0)
        self._note_ends()
