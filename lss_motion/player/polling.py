"""Polls the servos in the gaps between the moves, and passes their answers on.

`PollScheduler` chooses the next query on each bus: position, target, or health. Positions and
targets go to the joint's own `JointState`, health to the `HealthMonitor`, sensors to `Waiting`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, cycle
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.player.health import HealthMonitor
from lss_motion.player.settings_watch import HOLD_SIGNS, SettingsWatch
from lss_motion.protocol.codec import FAMILY_TABLES, read_reply
from lss_motion.protocol.constants import Family, Status
from lss_motion.protocol.framing import Command, Reply, encode
from lss_motion.units import NS_PER_MS, NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from lss_motion.player.cues import Waiting
    from lss_motion.player.joint_state import JointState
    from lss_motion.player.query_tracker import PendingQuery, QueryTracker
    from lss_motion.player.serial_line import SerialLine
    from lss_motion.player.settings_watch import Probe


TARGET_KEYWORD: Final = "QDT"
"""The answer shows whether a servo received its last move."""
HEALTH_KEYWORDS: Final = ("Q", "QT", "Q", "QV", "Q", "QC")
"""Status, temperature, voltage, current: a fault is found within half a second. A servo gets no
query that its family does not support, such as an LSS-PRO for its voltage."""


@lru_cache(maxsize=len(Family))
def health_words(family: Family) -> tuple[str, ...]:
    """Return the health queries that a family supports, in turn."""
    known = FAMILY_TABLES[family].by_keyword
    return tuple(word for word in HEALTH_KEYWORDS if word in known)


@lru_cache(maxsize=1024)
def health_round(family: Family, probes: tuple[str, ...]) -> tuple[str, ...]:
    """Return the health queries to one servo in turn: every other one is a probe, if it has any."""
    words = health_words(family)
    if not probes:
        return words
    return tuple(chain.from_iterable(zip(cycle(probes), words, strict=False)))


@lru_cache(maxsize=1024)
def query_of(servo_id: int, keyword: str) -> tuple[Command, int]:
    """Return a query and its size in bytes; cached, since the same few are sent all the time."""
    question = Command(servo_id, keyword)
    return question, len(encode(question))


HEALTH_NS: Final = NS_PER_S // 4
"""Period of the health queries to a servo, one keyword after the other."""
HEALTH_LEAST: Final = 8
"""Where the line is slow, at most one query in this many is about health."""
BACKLOG_BYTES: Final = 12
"""Queries that have not left yet are never more than this, `#12D-450T50`: an unexpected command,
such as a stop, waits no longer than for one other command."""
FILL_RATIO: Final = 0.95
"""A servo gets so many queries in a row that answers fill this share of their line: between two
servos there is a gap, since the start of the next answer is not known exactly."""
VISIT_NS: Final = NS_PER_S // 4
"""All servos of a bus are polled at least this often. A servo that must report its target is as
urgent as one at rest that was not polled for this long."""
DOUBT_NS: Final = 3600 * NS_PER_S
"""A servo whose answer must be confirmed comes before all others."""
LONGEST_NS: Final = NS_PER_S // 2
"""A servo that was not polled for this long comes next, however fast others move: a restart takes
more than a second, and must be noticed before the servo is back."""
SPEED_WEIGHT_S_PER_DEG: Final = 0.05
ERROR_WEIGHT_PER_DEG: Final = 2.0
"""A joint is read sooner the faster it moves and the further it is off (FACTS.md A25). Chosen: at
20 deg/s, or at half a degree of error, twice as often as a joint at rest in its place."""


LATE_NS: Final = NS_PER_MS
"""A host that wakes later than this has other work. A wait on an idle host ends 0.2 ms late."""
REST_RATIO: Final = 4
REST_MAX_NS: Final = NS_PER_S // 20
"""After a late wake-up no query is sent for `REST_RATIO` times the delay, up to this: a process
that leaves its processor alone is woken sooner when a move is due. Chosen; the maximum lets all
joints still be read."""


@dataclass(slots=True)
class _Turn:
    """One servo, and the number of queries that it still gets before the next servo."""

    state: JointState
    left: int
    places: int = 0
    """Number of position queries in this turn."""


class PollScheduler:
    """The queries of one show."""

    def __init__(
        self,
        joint_states: Mapping[str, JointState],
        trackers: Mapping[str, QueryTracker],
        lines: Mapping[str, SerialLine],
        waiting: Waiting,
        probes: Mapping[str, Sequence[Probe]] = MappingProxyType({}),
    ) -> None:
        self._waiting = waiting
        self._probes = probes
        self.watch = SettingsWatch(probes)
        self.health = HealthMonitor()
        self.rejected: dict[str, int] = dict.fromkeys(lines, 0)
        self.to_resend: dict[str, JointState] = {}
        """Joints whose servo has lost a move; the caller that sends it again removes them."""
        self._trackers = trackers
        self._lines = lines
        self._by_bus: dict[str, list[JointState]] = {bus: [] for bus in lines}
        for state in joint_states.values():
            if state.joint.drive != "stepped":  # It answers with its last command only.
                self._by_bus[state.joint.bus].append(state)
        self._by_address = {(t.joint.bus, t.joint.servo_id): t for t in joint_states.values()}
        self._turns: dict[str, _Turn | None] = dict.fromkeys(lines)
        self._next_ns: dict[str, int | None] = dict.fromkeys(lines)
        self._health_wait: dict[str, int] = dict.fromkeys(lines, 0)
        self._wakeup_ns: int | None = None
        self._rest_until_ns = 0

    def anew(self) -> PollScheduler:
        """Return a scheduler without faults; the count of rejected readings goes on."""
        joint_states = {state.joint.name: state for state in self._by_address.values()}
        scheduler = PollScheduler(
            joint_states, self._trackers, self._lines, self._waiting, self._probes
        )
        scheduler.rejected = self.rejected
        return scheduler

    def is_starved(self, now_ns: int) -> bool:
        """Return whether on some bus with servos no query was sent for too long."""
        return any(
            self._trackers[bus].is_starved(now_ns) for bus, own in self._by_bus.items() if own
        )

    def poll(self, now_ns: int, quiet_until_ns: int | None) -> None:
        """Send queries on every bus while its line is free by `quiet_until_ns`; None: for ever."""
        self._note_lateness(now_ns)
        for bus, tracker in self._trackers.items():
            for expired in tracker.expire(now_ns):
                self._note_timeout(bus, expired, now_ns)
            if tracker.is_starved(now_ns):
                self._poll_overdue(bus, now_ns)
            if now_ns < self._rest_until_ns:
                self._next_ns[bus] = self._rest_until_ns
                continue
            while self._poll_one(bus, now_ns, quiet_until_ns):
                pass
        self.health.advance(now_ns)

    def _note_lateness(self, now_ns: int) -> None:
        """Poll less on a host that has other work: queries cost time, and moves come first."""
        late_ns = 0 if self._wakeup_ns is None else now_ns - self._wakeup_ns
        self._wakeup_ns = None
        if late_ns > LATE_NS:
            self._rest_until_ns = now_ns + min(REST_RATIO * late_ns, REST_MAX_NS)

    def _poll_one(self, bus: str, now_ns: int, quiet_until_ns: int | None) -> bool:
        tracker = self._trackers[bus]
        self._next_ns[bus] = None
        question = self._waiting.query(bus, now_ns)
        if question is not None and tracker.quiet_until_ns(question.servo_id) <= now_ns:
            if self._send_if_allowed(bus, question, len(encode(question)), now_ns, quiet_until_ns):
                self._waiting.note_query_sent(now_ns)
            return False
        turn = self._turn(bus, now_ns)
        if turn is None:
            return False
        keyword = self._keyword(bus, turn, now_ns)
        question, size_bytes = query_of(turn.state.joint.servo_id, keyword)
        is_urgent = keyword == self.watch.urgent(turn.state.joint.name)
        if not self._send_if_allowed(
            bus, question, size_bytes, now_ns, quiet_until_ns, is_urgent=is_urgent
        ):
            return False
        turn.left -= 1
        turn.state.note_visit(now_ns)
        self.watch.note_query(turn.state.joint.name, keyword, now_ns)
        self._health_wait[bus] += 1
        if keyword == "QD":
            turn.places += 1
        elif keyword == TARGET_KEYWORD:
            turn.state.note_target_query()
        else:
            self._health_wait[bus] = 0
            turn.state.note_health_query(now_ns)
        return True

    def _send_if_allowed(
        self,
        bus: str,
        question: Command,
        size_bytes: int,
        now_ns: int,
        quiet_until_ns: int | None,
        *,
        is_urgent: bool = False,
    ) -> bool:
        """Send a query if line and servo allow it now; otherwise note when to try again."""
        tracker, line = self._trackers[bus], self._lines[bus]
        earliest_ns = tracker.earliest_ns(question.servo_id, size_bytes, is_urgent=is_urgent)
        if earliest_ns is None or earliest_ns > max(now_ns, line.free_ns):
            self._next_ns[bus] = earliest_ns
            return False
        arrival_ns, room_ns = line.arrival_ns(size_bytes, now_ns), line.time_ns(BACKLOG_BYTES)
        if arrival_ns > now_ns + room_ns:
            self._next_ns[bus] = arrival_ns - room_ns
            return False
        if quiet_until_ns is not None and arrival_ns > quiet_until_ns:
            return False
        tracker.send(question, now_ns)
        return True

    def _poll_overdue(self, bus: str, now_ns: int) -> None:
        """Poll overdue, silent or doubted servos even when moves are queued.

        This is no visit: the order of the turns does not change.
        """
        tracker, quiet = self._trackers[bus], self.health.unresponsive()
        waits_ns = [(tracker.last_sent_ns(t.joint.servo_id), t) for t in self._by_bus[bus]]
        for last_sent_ns, state in sorted(waits_ns, key=lambda wait: wait[0]):
            urgent = self.watch.urgent(state.joint.name)
            is_due = now_ns - last_sent_ns > LONGEST_NS or state.joint.name in quiet
            if urgent is None and not is_due:
                continue
            servo_id = state.joint.servo_id
            question, size_bytes = query_of(servo_id, urgent or self._fresh(bus, state))
            is_urgent = urgent is not None
            earliest_ns = tracker.earliest_ns(servo_id, size_bytes, is_urgent=is_urgent)
            if earliest_ns is not None and earliest_ns <= now_ns:
                tracker.send(question, now_ns)
                return

    def receive(
        self, bus: str, reply: Reply, now_ns: int, plan_deg: Callable[[JointState, int], float]
    ) -> None:
        tracker = self._trackers[bus]
        accepted = tracker.receive(reply, now_ns)
        state = None if reply.servo_id is None else self._by_address.get((bus, reply.servo_id))
        if state is not None and tracker.last_reply_ns(state.joint.servo_id) == now_ns:
            self.health.answered(state)
        for query, answer in accepted:
            if answer.keyword == "QA":
                self._waiting.take_reply(bus, query.command.servo_id, answer.value)
            if state is not None and not self._take_probe(state, answer):
                self._take(bus, state, query, answer, plan_deg)

    def _take(
        self,
        bus: str,
        state: JointState,
        query: PendingQuery,
        reply: Reply,
        plan_deg: Callable[[JointState, int], float],
    ) -> None:
        answer = read_reply(state.joint.model.language, reply)
        if answer is None or not isinstance(answer.value, int | float):
            self._note_no_target(state, reply, query.arrival_ns)
            return
        match reply.keyword:
            case "QD":
                self._take_position(bus, state, answer.value, query, plan_deg)
            case "QDT":
                if state.take_target(answer.value, s_from_ns(query.arrival_ns)):
                    self._note_lost_move(state)
            case "Q":
                self._take_status(state, int(answer.value), query.arrival_ns)
            case "QT":
                self.health.temperature(state, answer.value)
            case "QV":
                self.health.voltage(state, answer.value)
            case "QC":
                state.note_current(answer.value)
            case _:
                pass

    def _note_no_target(self, state: JointState, reply: Reply, arrival_ns: int) -> None:
        """Note an LSS without a target although it was sent a move: it may have restarted."""
        is_lss = state.joint.model.family is Family.LSS  # A PRO answers with the last target.
        if is_lss and reply.keyword == TARGET_KEYWORD and reply.value is None:
            sent_ns = state.last_arrival_ns
            if sent_ns is not None and sent_ns < arrival_ns:
                self.watch.note_sign(state, arrival_ns, count=HOLD_SIGNS)

    def doubt_all(self, buses: Collection[str]) -> None:
        """Examine all servos of some buses: what made one restart may have hit the others."""
        for bus in buses:
            for state in self._by_bus[bus]:
                self.watch.note_sign(state, self._trackers[bus].last_sent_ns(state.joint.servo_id))

    def _note_lost_move(self, state: JointState) -> None:
        """Send the rest of a lost move; where it may be in another turn, only after a reading."""
        name = state.joint.name
        if state.joint.turns is None:
            self.to_resend[name] = state
            return
        state.hold_back(has_missed=True)
        self.health.unconfirmed[name] = "QD"

    def _take_status(self, state: JointState, code: int, arrival_ns: int) -> None:
        self.health.status(state, code)
        if state.status is Status.LIMP:
            self.watch.note_sign(state, arrival_ns, count=HOLD_SIGNS)

    def _take_probe(self, state: JointState, reply: Reply) -> bool:
        """Judge by the answer to a probe whether a servo has restarted; False: it is another.

        A servo that has not restarted gets the moves that were held back.
        """
        name, value = state.joint.name, reply.value
        if reply.keyword not in self.watch.keywords(name):
            return False
        number = value if isinstance(value, int) else None
        fault = self.watch.take(state, reply.keyword, number)
        if fault is not None:
            self.health.lost_settings(state, fault)
        else:
            self._release(state)
        return True

    def _release(self, state: JointState) -> None:
        """Send a servo the moves that were held back, if it is in doubt no more."""
        may_move = self.watch.allows_moves(state.joint.name)
        if state.in_doubt and may_move and state.release():
            self.to_resend[state.joint.name] = state

    def wakeups_ns(self, now_ns: int) -> list[int]:
        """Return when something may be due, besides an answer that comes in."""
        wakeups_ns = [*self._waiting.wakeups_ns(), *self.health.wakeups_ns()]
        for bus, tracker in self._trackers.items():
            if (give_up_ns := tracker.give_up_ns) is not None:
                wakeups_ns.append(give_up_ns)
            if (next_ns := self._next_ns[bus]) is not None:
                wakeups_ns.append(next_ns)
            if self._turns[bus] is None:
                quiet = (tracker.quiet_until_ns(t.joint.servo_id) for t in self._by_bus[bus])
                wakeups_ns += [instant_ns for instant_ns in quiet if instant_ns > now_ns]
        self._wakeup_ns = min((w for w in wakeups_ns if w > now_ns), default=None)
        return wakeups_ns

    def _turn(self, bus: str, now_ns: int) -> _Turn | None:
        """Return the servo in turn and its number of queries; None: no servo can be polled."""
        turn, tracker = self._turns[bus], self._trackers[bus]
        if turn is not None and turn.left > 0:
            servo_id = turn.state.joint.servo_id
            if tracker.quiet_until_ns(servo_id) <= now_ns and not self.watch.doubted:
                return turn
        # A row is not cut short for a servo that must report its target: that would cost a tenth
        # of the answers (measured), and that servo waits for a row or two at most.
        state = self._most_urgent(bus, now_ns)
        self._turns[bus] = None if state is None else _Turn(state, self._depth(bus, state))
        return self._turns[bus]

    def _depth(self, bus: str, state: JointState) -> int:
        """Return the length of a row of queries, such that the gap before it is small beside it."""
        tracker, servo_id = self._trackers[bus], state.joint.servo_id
        latency = tracker.latency(servo_id)
        if not latency.is_known or tracker.is_overdue(servo_id, "QD"):
            return 1
        if state.joint.name in self.watch.doubted:
            return 1
        line = self._lines[bus]
        reply_ns = line.time_ns(tracker.reply_bytes(servo_id, "QD"))
        gap_ns = latency.spread_ns // 2 + line.time_ns(1)
        wanted = math.ceil(FILL_RATIO / (1.0 - FILL_RATIO) * gap_ns / reply_ns)
        most = VISIT_NS // (reply_ns * len(self._by_bus[bus]))
        return max(1, min(wanted, most, tracker.depth(servo_id)))

    def _keyword(self, bus: str, turn: _Turn, now_ns: int) -> str:
        """Return the keyword of the next query: position, target, or health.

        A row of queries ends with one about health, since equal queries need a different one at
        their end. A servo with an overdue answer gets a query for which this answer cannot be
        taken.
        """
        tracker, state = self._trackers[bus], turn.state
        servo_id = state.joint.servo_id
        if (urgent := self.watch.urgent(state.joint.name)) is not None:
            return urgent
        if tracker.is_overdue(servo_id, "QD"):
            return self._fresh(bus, state)
        if (probe := self.watch.read_back(state.joint.name, now_ns)) is not None:
            return probe
        if state.needs_target(now_ns) and not (
            tracker.is_overdue(servo_id, TARGET_KEYWORD) or tracker.awaits(servo_id, TARGET_KEYWORD)
        ):
            return TARGET_KEYWORD
        is_alone = turn.left == 1 and turn.places == 0
        period_ns = HEALTH_NS // 2 if self.watch.keywords(state.joint.name) else HEALTH_NS
        is_due = state.health_ns is None or now_ns - state.health_ns >= period_ns
        is_due = is_due and self._health_wait[bus] >= HEALTH_LEAST - 1
        doubt = self.health.unconfirmed.get(state.joint.name)
        words = self._health_round(state)
        if turn.left > 1 or (is_alone and doubt is None and not is_due):
            return "QD"
        return doubt or words[state.health_count % len(words)]

    def _fresh(self, bus: str, state: JointState) -> str:
        """Return a keyword for whose answer no overdue answer of the servo can be taken."""
        tracker, servo_id = self._trackers[bus], state.joint.servo_id
        words = ("QD", *self._health_round(state))
        return next((word for word in words if not tracker.is_overdue(servo_id, word)), "QD")

    def _health_round(self, state: JointState) -> tuple[str, ...]:
        return health_round(state.joint.model.family, self.watch.keywords(state.joint.name))

    def _most_urgent(self, bus: str, now_ns: int) -> JointState | None:
        """Return the joint with the oldest reading, weighted by its speed and error."""
        best, best_merit = None, (-1, -1.0)
        doubted = self.watch.doubted
        now_s = s_from_ns(now_ns)
        tracker = self._trackers[bus]
        for state in self._by_bus[bus]:
            servo_id = state.joint.servo_id
            if tracker.is_waiting(servo_id):
                continue
            is_urgent = state.joint.name in doubted
            if tracker.quiet_until_ns(servo_id) > now_ns and not is_urgent:
                continue
            if state.visited_ns is None:
                return state
            _, speed_deg_s = state.profile.at(now_s)
            weight = 1.0 + SPEED_WEIGHT_S_PER_DEG * abs(speed_deg_s)
            weight += ERROR_WEIGHT_PER_DEG * abs(state.disturbance.error_deg)
            age_ns = now_ns - state.visited_ns
            overdue_ns = age_ns if age_ns > LONGEST_NS else 0
            if is_urgent or state.joint.name in self.health.unconfirmed:
                overdue_ns = DOUBT_NS + age_ns
            merit = overdue_ns, age_ns * weight + VISIT_NS * state.needs_target(now_ns)
            if merit > best_merit:
                best, best_merit = state, merit
        return best

    def _take_position(
        self,
        bus: str,
        state: JointState,
        measured_deg: float,
        query: PendingQuery,
        plan_deg: Callable[[JointState, int], float],
    ) -> None:
        read_s = s_from_ns(query.arrival_ns)
        if self.health.turn(state, measured_deg, read_s):
            self.rejected[bus] += 1
            return
        self._release(state)
        planned_deg = plan_deg(state, query.arrival_ns)
        missed = state.take_position(measured_deg, read_s, planned_deg)
        if missed is None:
            self.rejected[bus] += 1
            self.watch.note_sign(state, query.arrival_ns)
            return
        if missed:
            self.to_resend[state.joint.name] = state
        self.health.position(state, query.arrival_ns)
        joint_deg = state.joint.joint_deg
        state.trace.add(read_s - state.origin_s, joint_deg(planned_deg), joint_deg(measured_deg))

    def _note_timeout(self, bus: str, expired: PendingQuery, now_ns: int) -> None:
        state = self._by_address.get((bus, expired.command.servo_id))
        if state is not None:
            since_ns = self._trackers[bus].last_reply_ns(state.joint.servo_id)
            self.health.unanswered(state, now_ns, now_ns if since_ns is None else since_ns)
            if since_ns is None or since_ns <= expired.arrival_ns:  # No later query was answered.
                was_held = state.in_doubt
                self.watch.note_sign(state, now_ns)
                if state.in_doubt and not was_held:  # Its power may be that of the others.
                    self.doubt_all([bus])
