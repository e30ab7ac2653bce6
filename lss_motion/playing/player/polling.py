"""Polls the servos in the gaps between the moves, and passes their answers on.

Which query is next on each bus is the choice of `query_choice`; `PollScheduler` sends it when the
line allows. Positions and targets go to the joint's own `JointState`, health to the
`HealthMonitor`, sensors to `Waiting` and `SensorWatch`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.playing.player.cues import SensorWatch
from lss_motion.playing.player.health import HealthMonitor
from lss_motion.playing.player.query_choice import (
    BY_NEED,
    LONGEST_NS,
    TARGET_KEYWORD,
    ByNeed,
    FullLine,
    Pace,
    Polled,
)
from lss_motion.playing.player.servo_model import HOLD_SIGNS, CommonSilence, ServoSettings
from lss_motion.playing.player.show_clock import earliest_after
from lss_motion.protocol.codec import reply_number
from lss_motion.protocol.constants import Family, Status
from lss_motion.protocol.framing import Command, Reply, encode
from lss_motion.units import NS_PER_MS, NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from lss_motion.playing.player.cues import Waiting
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.query_tracker import PendingQuery, QueryTracker
    from lss_motion.playing.player.servo_model import Probe


BESIDE_NS: Final = 150 * NS_PER_MS
"""While a servo is probed that does not answer, each other one is asked so often: a probe without
an answer takes the line for 30 ms, and who answers twice must be noticed. Chosen: half of a move of
0.3 s."""


@lru_cache(maxsize=1024)
def query_of(servo_id: int, keyword: str) -> tuple[Command, int]:
    """Return a query and its size in bytes; cached, since the same few are sent all the time."""
    question = Command(servo_id, keyword)
    return question, len(encode(question))


BACKLOG_BYTES: Final = 20
"""Queries that have not left yet are never more than this: three to one servo. An unexpected
command, such as a stop, waits for little more than another command, `#12D-450T1500`."""
BEHIND_MOVE_NS: Final = 3_200_000
"""Queries that leave behind a move, and that move, are never more than a line carries in this time:
at 115200 bps 36 bytes, a move with three queries. Chosen: a stop may find the player asleep for six
times as long (`player.IDLE_NS`)."""
AHEAD_NS: Final = 10 * NS_PER_MS
"""A query that is due so soon leaves behind a move: that saves a turn of the loop. Chosen: the mean
time between two moves of a robot of 18 joints."""
SLACK_NS: Final = 8 * NS_PER_MS
"""A query waits so long for a move with which it can leave. Chosen: less than a servo takes to
report a target, so that a lost move is sent again little later."""

QUERY_LEAST_BYTES: Final = 4
"""The shortest query, `#5Q` and its CR."""
LATE_NS: Final = NS_PER_MS
"""A host that wakes later than this has other work. A wait on an idle host ends 0.2 ms late."""
REST_RATIO: Final = 4
REST_MAX_NS: Final = NS_PER_S // 20
"""After a late wake-up no query is sent for `REST_RATIO` times the delay, up to this: a process
that leaves its processor alone is woken sooner when a move is due. Chosen; the maximum lets all
joints still be read."""

DOUBLED_TEXT: Final = "answers every query twice: it is examined whether two servos have the id"
BEHIND_DEG: Final = 3.0
"""A joint in EM0 that is so far from its model may have restarted: then it has stood still, and
nothing limits its speed but what it has stored. Chosen: more than a load and a wrong lag make of
slow motion; fast motion costs it a query of its settings with each reading."""


class PollScheduler:
    """The queries of one show."""

    def __init__(
        self,
        joint_states: Mapping[str, JointState],
        trackers: Mapping[str, QueryTracker],
        waiting: Waiting,
        probes: Mapping[str, Sequence[Probe]] = MappingProxyType({}),
        pace: Pace | None = BY_NEED,
        known: PollScheduler | None = None,
    ) -> None:
        """`pace`: how often angles are queried; None: as often as the lines allow.

        What `known` knows of faults and doubts is kept.
        """
        self._pace = pace
        self._waiting = waiting
        self._probes = probes
        self.settings: dict[str, ServoSettings] = {} if known is None else known.settings
        self.doubted: set[str] = set() if known is None else known.doubted
        """The joints whose settings are in doubt."""
        for name, state in joint_states.items():
            fresh = ServoSettings(state.joint, probes.get(name, ()), self.doubted)
            state.settings = self.settings.setdefault(name, fresh)
        self.health: HealthMonitor = HealthMonitor() if known is None else known.health
        self.rejected: dict[str, int] = dict.fromkeys(trackers, 0)
        self.to_resend: dict[str, JointState] = {}
        """Joints whose servo has lost a move; the caller that sends it again removes them."""
        self._unclear: dict[str, JointState] = {}
        """Joints whose answers came twice, and not once since."""
        self._trackers = trackers
        self._lines = {bus: tracker.line for bus, tracker in trackers.items()}
        self._by_bus: dict[str, list[JointState]] = {bus: [] for bus in trackers}
        for state in joint_states.values():
            if state.joint.drive != "stepped":  # It answers with its last command only.
                self._by_bus[state.joint.bus].append(state)
        self._by_address = {(t.joint.bus, t.joint.servo_id): t for t in joint_states.values()}
        polled = Polled(self._by_bus, trackers, self.doubted, self.health)
        self._choice = FullLine(polled) if pace is None else ByNeed(polled, pace)
        self._next_ns: dict[str, int | None] = dict.fromkeys(trackers)
        self._wakeup_ns: int | None = None
        self._rest_until_ns = 0
        self._silences = {bus: CommonSilence() for bus in trackers}
        self.watched = SensorWatch(())
        """Sensors that are polled although no show waits for them."""

    def renewed(self, joint_states: Mapping[str, JointState] | None = None) -> PollScheduler:
        """Return a scheduler for these states of the same joints, with all that is known so far.

        None: for the present states, without faults. The count of rejected readings goes on.
        """
        known = None if joint_states is None else self
        if joint_states is None:
            joint_states = {state.joint.name: state for state in self._by_address.values()}
        own = self._trackers, self._waiting, self._probes, self._pace
        scheduler = PollScheduler(joint_states, *own, known=known)
        scheduler.rejected, scheduler.watched = self.rejected, self.watched
        return scheduler

    def is_starved(self, now_ns: int) -> bool:
        """Return whether on some bus with servos a query was due, but not sent for too long."""
        return any(self._is_starved(bus, now_ns) for bus, own in self._by_bus.items() if own)

    def _is_starved(self, bus: str, now_ns: int) -> bool:
        if now_ns <= self._trackers[bus].starves_ns:
            return False
        next_ns = self._next_ns[bus]
        # A rest does not count: on a host that is always late, one follows the other.
        return next_ns is None or next_ns <= max(now_ns, self._rest_until_ns)

    def poll(self, now_ns: int, quiet_until_ns: int | None) -> None:
        """Send queries on every bus while its line is free by `quiet_until_ns`; None: for ever."""
        self._note_lateness(now_ns)
        for bus, tracker in self._trackers.items():
            for expired in tracker.expire(now_ns):
                self._note_timeout(bus, expired, now_ns)
                self._choice.touch(bus)
                self._choice.note_timeout(bus)
                self._note_silence(bus, expired.command.servo_id, now_ns)
            if tracker.twins.unclear:
                self._suspect_twins(bus, now_ns)
            if self._is_starved(bus, now_ns):
                self._poll_overdue(bus, now_ns, quiet_until_ns)
            if now_ns < self._rest_until_ns:
                self._next_ns[bus] = self._rest_until_ns
                continue
            while self._poll_one(bus, now_ns, quiet_until_ns):
                pass
        if self._unclear:
            self._release_clear()
        if self.health.awaited:
            self.health.advance(now_ns)

    def hold_back(self, now_ns: int, *, is_long: bool) -> None:
        """Hold servos back until they answer to a probe: they may have restarted in a pause.

        In a long one any; in a short one those that owe an answer, or were in doubt before.
        """
        for bus, tracker in self._trackers.items():
            for state in self._by_bus[bus]:
                servo_id, name = state.joint.servo_id, state.joint.name
                if is_long or tracker.is_waiting(servo_id) or name in self.doubted:
                    state.doubt(now_ns, HOLD_SIGNS)

    def poll_behind(self, now_ns: int, quiet_until_ns: int | None) -> None:
        """Poll a servo of each bus that is due soon, behind the moves that leave now.

        To choose one delays these moves. So this is left out on a line on which queries are late
        already, and on a host that is late.
        """
        if now_ns < self._rest_until_ns:
            return
        for bus, line in self._lines.items():
            least_ns = line.arrival_ns(QUERY_LEAST_BYTES, now_ns)
            if quiet_until_ns is not None and least_ns > quiet_until_ns:
                continue
            if self._choice.begin_visit(bus, now_ns, now_ns + AHEAD_NS):
                self._visit_behind(bus, now_ns, quiet_until_ns)

    def _visit_behind(self, bus: str, now_ns: int, quiet_until_ns: int | None) -> None:
        """Send what the visit that has begun asks, as far as the line has room."""
        backlog_ns = max(BEHIND_MOVE_NS, self._lines[bus].times_ns[BACKLOG_BYTES])
        while (found := self._choice.next_of_visit(bus, now_ns)) is not None:
            if not self._send_found(bus, found, now_ns, quiet_until_ns, backlog_ns):
                self._choice.end_visit(bus)
                return

    def _note_lateness(self, now_ns: int) -> None:
        """Poll less on a host that has other work: queries cost time, and moves come first."""
        late_ns = 0 if self._wakeup_ns is None else now_ns - self._wakeup_ns
        self._wakeup_ns = None
        if late_ns > LATE_NS:
            self._rest_until_ns = now_ns + min(REST_RATIO * late_ns, REST_MAX_NS)

    def _poll_one(self, bus: str, now_ns: int, quiet_until_ns: int | None) -> bool:
        self._next_ns[bus] = None
        question = self._waiting.query(bus, now_ns) if self._waiting.next_s < math.inf else None
        if question and self._trackers[bus].quiet_until_ns(question.servo_id) <= now_ns:
            if self._send_if_allowed(bus, question, len(encode(question)), now_ns, quiet_until_ns):
                self._waiting.note_query_sent(now_ns)
            return False
        if self.watched.sensors and self._poll_watched(bus, now_ns, quiet_until_ns):
            return True
        found = self._choice.next_query(bus, now_ns)
        if found is None:
            self._note_next(bus, now_ns, quiet_until_ns)
            return False
        return self._send_found(bus, found, now_ns, quiet_until_ns)

    def _send_found(
        self,
        bus: str,
        found: tuple[JointState, str],
        now_ns: int,
        quiet_until_ns: int | None,
        backlog_ns: int | None = None,
    ) -> bool:
        """Send a query that was chosen, if line and servo allow it now."""
        state, keyword = found
        question, size_bytes = query_of(state.joint.servo_id, keyword)
        is_urgent = bool(self.doubted) and keyword == state.settings.urgent
        if not self._send_if_allowed(
            bus,
            question,
            size_bytes,
            now_ns,
            quiet_until_ns,
            is_urgent=is_urgent,
            backlog_ns=backlog_ns,
        ):
            return False
        self._choice.note_sent(bus, state, keyword, now_ns)
        return True

    def _poll_watched(self, bus: str, now_ns: int, quiet_until_ns: int | None) -> bool:
        question = self.watched.query(bus, now_ns)
        if question is None or self._trackers[bus].quiet_until_ns(question.servo_id) > now_ns:
            return False
        is_sent = self._send_if_allowed(
            bus, question, len(encode(question)), now_ns, quiet_until_ns
        )
        if is_sent:
            self.watched.note_query_sent(bus, question.servo_id, now_ns)
        return is_sent

    def _note_next(self, bus: str, now_ns: int, quiet_until_ns: int | None) -> None:
        """Note when a query can be due on a bus and its line can be free for it.

        If a move is due at about that time, the query leaves behind it.
        """
        next_ns = self._choice.next_ns(bus, now_ns)
        if next_ns is not None:
            next_ns = max(next_ns, self._trackers[bus].not_before_ns())
            is_near = quiet_until_ns is not None and abs(quiet_until_ns - next_ns) < SLACK_NS
            if is_near and not self._choice.is_behind(bus, now_ns):
                next_ns += SLACK_NS
        self._next_ns[bus] = next_ns

    def look_ahead(self, now_ns: int, quiet_until_ns: int | None) -> bool:
        """Note when the next queries are due after moves have left; return whether any is now."""
        is_due = self._waiting.next_s < math.inf and bool(self._waiting.wakeups_ns())
        if self.watched.sensors and not is_due:
            is_due = any(self.watched.query(bus, now_ns) for bus in self._trackers)
        for bus, tracker in self._trackers.items():
            is_own_due = self._choice.is_due(bus, now_ns)
            line = self._lines[bus]
            room_ns = line.arrival_ns(QUERY_LEAST_BYTES, now_ns) - line.times_ns[BACKLOG_BYTES]
            if is_own_due and room_ns > now_ns:
                self._next_ns[bus] = max(room_ns, tracker.not_before_ns())
                is_own_due = False
            elif not is_own_due or tracker.not_before_ns() > now_ns:
                self._note_next(bus, now_ns, quiet_until_ns)
                is_own_due = is_own_due and self._next_ns[bus] is None
            is_due = is_due or is_own_due
        return is_due

    def _send_if_allowed(
        self,
        bus: str,
        question: Command,
        size_bytes: int,
        now_ns: int,
        quiet_until_ns: int | None,
        *,
        is_urgent: bool = False,
        backlog_ns: int | None = None,
    ) -> bool:
        """Send a query if line and servo allow it now; otherwise note when to try again.

        With it, what is queued keeps the line busy for `backlog_ns` at most; None: for the time of
        `BACKLOG_BYTES`.
        """
        tracker, line = self._trackers[bus], self._lines[bus]
        earliest_ns = tracker.earliest_ns(question.servo_id, size_bytes, is_urgent=is_urgent)
        if earliest_ns is None or (earliest_ns > now_ns and earliest_ns > line.free_ns):
            self._next_ns[bus] = tracker.free_ns() if earliest_ns is None else earliest_ns
            return False
        arrival_ns = line.arrival_ns(size_bytes, now_ns)
        room_ns = arrival_ns - (backlog_ns or line.times_ns[BACKLOG_BYTES])
        if room_ns > now_ns:
            self._next_ns[bus] = room_ns
            return False
        if quiet_until_ns is not None and arrival_ns > quiet_until_ns:
            return False
        tracker.send(question, now_ns, is_patient=not self._choice.is_behind(bus, now_ns))
        return True

    def _poll_overdue(self, bus: str, now_ns: int, quiet_until_ns: int | None) -> None:
        """Poll an overdue, silent or doubted servo even when moves are queued.

        This is no visit: the order of the turns does not change. A move that is due meanwhile is
        delayed by one query at most, that about health if it is late, for a servo in EM0 brakes
        without its next target.
        """
        tracker, quiet = self._trackers[bus], self.health.awaited
        waits_ns = [(tracker.last_sent_ns(t.joint.servo_id), t) for t in self._by_bus[bus]]
        is_urgent = any(state.settings.urgent is not None for _, state in waits_ns)
        longest_ns = BESIDE_NS if is_urgent else LONGEST_NS
        for last_sent_ns, state in sorted(waits_ns, key=lambda wait: wait[0]):
            urgent = state.settings.urgent
            is_due = now_ns - last_sent_ns > longest_ns or state.joint.name in quiet
            if urgent is None and not is_due:
                continue
            servo_id = state.joint.servo_id
            if tracker.is_waiting(servo_id):  # An equal query would keep its flight open for ever.
                continue
            words = [urgent] if urgent else self._choice.overdue_words(bus, state, now_ns)
            health = words[1] if words[1:] else None
            size_bytes = sum(query_of(servo_id, word)[1] for word in words)
            both_ns = self._lines[bus].arrival_ns(size_bytes, now_ns)
            if quiet_until_ns is not None and both_ns > quiet_until_ns:
                words = words[-1:]
            is_sent = False
            for word in words:
                if not self._send_overdue(bus, state, word, now_ns, is_urgent=word == urgent):
                    break
                is_sent = True
                if word == health:
                    self._choice.note_health_sent(state, word, now_ns)
                    state.settings.note_query(word, now_ns)
            if is_sent:
                return

    def _send_overdue(
        self, bus: str, state: JointState, keyword: str, now_ns: int, *, is_urgent: bool = False
    ) -> bool:
        """Send a query behind the moves that are queued, if the servo may be sent it now."""
        tracker, servo_id = self._trackers[bus], state.joint.servo_id
        question, size_bytes = query_of(servo_id, keyword)
        earliest_ns = tracker.earliest_ns(servo_id, size_bytes, is_urgent=is_urgent)
        if earliest_ns is None or earliest_ns > max(now_ns, self._lines[bus].free_ns):
            return False
        tracker.send(question, now_ns)
        return True

    def receive(
        self, bus: str, reply: Reply, now_ns: int, plan_deg: Callable[[JointState, int], float]
    ) -> None:
        tracker = self._trackers[bus]
        accepted = tracker.receive(reply, now_ns)
        self._silences[bus].answered(reply.servo_id)
        if tracker.twins.unclear:
            self._suspect_twins(bus, now_ns)
        state = None if reply.servo_id is None else self._by_address.get((bus, reply.servo_id))
        if state is not None and tracker.last_reply_ns(state.joint.servo_id) == now_ns:
            self.health.answered(state)
            is_back = tracker.back_ns(state.joint.servo_id) == now_ns
            if is_back and state.settings.note_away(now_ns):
                state.hold_back()
        for query, answer in accepted:
            if answer.keyword == "QA":
                self._waiting.take_reply(bus, query.command.servo_id, answer.value)
                self.watched.take_reply(bus, query.command.servo_id, answer.value)
            if state is not None and not self._take_probe(state, answer):
                self._take(bus, state, query, answer, plan_deg)
        if state is not None:
            self._choice.touch(bus, state)

    def _suspect_twins(self, bus: str, now_ns: int) -> None:
        """Send no move to servos whose answers come twice until one comes once.

        They are asked at once. After several in a row each is examined before it moves on.
        """
        twins = self._trackers[bus].twins
        for servo_id in twins.unclear:
            state = self._by_address.get((bus, servo_id))
            if state is not None and state.joint.name not in self._unclear:
                self._unclear[state.joint.name] = state
                state.settings.note_sign(now_ns, HOLD_SIGNS)
                state.hold_back()
        for servo_id in twins.doubled:
            if (state := self._by_address.get((bus, servo_id))) is not None:
                state.drive(is_driven=False)
                self.health.doubled.add(state.joint.name)
                self.health.lost_settings(state, f"{DOUBLED_TEXT} {servo_id}")
        twins.doubled.clear()

    def _release_clear(self) -> None:
        """Release the servos that have given an answer that came once."""
        for name, state in list(self._unclear.items()):
            if state.joint.servo_id not in self._trackers[state.joint.bus].twins.unclear:
                del self._unclear[name]
                self._release(state)

    def _take(
        self,
        bus: str,
        state: JointState,
        query: PendingQuery,
        reply: Reply,
        plan_deg: Callable[[JointState, int], float],
    ) -> None:
        number = reply_number(state.joint.model.language, reply)
        if number is None:
            self._note_no_target(state, reply, query.arrival_ns)
            return
        match reply.keyword:
            case "QD":
                self._take_position(bus, state, number, query, plan_deg)
            case "QDT":
                if state.take_target(number, s_from_ns(query.arrival_ns)):
                    self._note_lost_move(state)
            case "Q":
                self._take_status(state, int(number), query.arrival_ns)
            case "QT":
                self.health.temperature(state, number)
            case "QV":
                self.health.voltage(state, number)
            case "QC":
                self.health.current(state, number)
            case _:
                pass

    def _note_no_target(self, state: JointState, reply: Reply, arrival_ns: int) -> None:
        """Note an LSS without a target although it was sent a move: it may have restarted."""
        is_lss = state.joint.model.family is Family.LSS  # A PRO answers with the last target.
        if is_lss and reply.keyword == TARGET_KEYWORD and reply.value is None:
            sent_ns = state.last_arrival_ns
            if sent_ns is not None and sent_ns < arrival_ns:
                state.doubt(arrival_ns, HOLD_SIGNS)

    def doubt_all(self, buses: Collection[str]) -> None:
        """Examine all servos of some buses: what made one restart may have hit the others."""
        for bus in buses:
            for state in self._by_bus[bus]:
                state.doubt(self._trackers[bus].last_sent_ns(state.joint.servo_id))

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
            state.doubt(arrival_ns, HOLD_SIGNS)

    def _take_probe(self, state: JointState, reply: Reply) -> bool:
        """Judge by the answer to a probe whether a servo has restarted; False: it is another.

        A servo that has not restarted gets the moves that were held back.
        """
        if not state.settings.judges(reply.keyword):
            return False
        if (fault := state.take_probe(reply.keyword, reply.value)) is not None:
            self.health.lost_settings(state, fault)
        else:
            self._release(state)
        return True

    def _release(self, state: JointState) -> None:
        """Send a servo the moves that were held back, if it is in doubt no more."""
        is_sure = state.settings.has_settings and state.joint.name not in self._unclear
        if state.in_doubt and is_sure and state.release():
            self.to_resend[state.joint.name] = state

    def next_wakeup_ns(self, now_ns: int) -> int | None:
        """Return when something may be due after `now_ns`, besides an answer that comes in."""
        wakeups_ns: list[int | None] = []
        if self.health.awaited:
            wakeups_ns += self.health.wakeups_ns()
        if self._waiting.next_s < math.inf:
            wakeups_ns += self._waiting.wakeups_ns()
        if self.watched.sensors:
            wakeups_ns += self.watched.wakeups_ns()
        for bus, tracker in self._trackers.items():
            wakeups_ns += (tracker.give_up_ns, self._next_ns[bus])
            if tracker.twins.unclear:
                wakeups_ns.append(tracker.twins.settles_ns())
        self._wakeup_ns = earliest_after(now_ns, wakeups_ns)
        return self._wakeup_ns

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
        seen = state.observe(measured_deg, read_s, plan_deg(state, query.arrival_ns))
        if seen is None:
            self.rejected[bus] += 1
            state.doubt(query.arrival_ns)
            return
        if seen.has_lost_move:
            self.to_resend[state.joint.name] = state
        if state.joint.drive == "streamed" and abs(seen.model_error_deg) > BEHIND_DEG:
            state.doubt(query.arrival_ns)
        self.health.position(state.joint, seen, query.arrival_ns)

    def _note_timeout(self, bus: str, expired: PendingQuery, now_ns: int) -> None:
        state = self._by_address.get((bus, expired.command.servo_id))
        if state is not None:
            since_ns = self._trackers[bus].last_reply_ns(state.joint.servo_id)
            self.health.unanswered(state, now_ns, now_ns if since_ns is None else since_ns)
            if since_ns is None or since_ns <= expired.arrival_ns:  # No later query was answered.
                was_held = state.in_doubt
                state.doubt(now_ns)
                if state.in_doubt and not was_held:  # Its power may be that of the others.
                    self.doubt_all([bus])

    def _note_silence(self, bus: str, servo_id: int, now_ns: int) -> None:
        """Hold all servos of a bus back if several fell silent at once: all may have restarted."""
        if self._silences[bus].unanswered(servo_id):
            for state in self._by_bus[bus]:
                state.doubt(now_ns, HOLD_SIGNS)
