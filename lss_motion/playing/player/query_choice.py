"""Which servo is polled next, and for what: by need in a show, or as often as the line allows.

`ByNeed`: the target of a move once after it, the angle of a joint ten times a second and twice as
often where it strays, and now and then its health. More readings would make no horn follow better
(FACTS.md N13), and each costs processor time. `FullLine`: rows of queries that keep the answers'
line busy, where every reading is wanted.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain, cycle
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.protocol.codec import FAMILY_TABLES
from lss_motion.protocol.constants import Family
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from lss_motion.playing.player.health import HealthMonitor
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.query_tracker import QueryTracker


PLACE_KEYWORD: Final = "QD"
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


HEALTH_NS: Final = NS_PER_S // 4
"""Period of the health queries to a servo, one keyword after the other."""
HEALTH_LATE_NS: Final = NS_PER_S
"""Where queries are few, as on a host that is always late, health gets one at least this often:
angles and probes would leave it none. Chosen: a hot or blocked servo is found within seconds."""
HEALTH_LEAST: Final = 8
"""Where the line is slow, at most one query in this many is about health."""
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
STRAYED_DEG: Final = 0.5
"""A joint has strayed if it is further off its plan than this. Measured (FACTS.md N13); the
tolerance of a good plan is 0.2 deg."""
UNCORRECTED_DEG: Final = 0.3
"""It counts as strayed, too, if its correction differs from what it should be by more than this."""


class Pace(Struct, frozen=True):
    """How often a second the angle of a joint is queried, where its line has room."""

    steady_hz: float
    strayed_hz: float
    """While the joint strays, is in doubt, or is not corrected yet."""
    resting_hz: float | None = None
    """Of a joint that has stood in its place for `RESTED_NS`, with one query about its health each
    time; None: as `steady_hz`."""


BY_NEED: Final = Pace(10.0, 20.0)
"""Measured over a walk, a lively show, and a show under load (FACTS.md N13): below 5 a second lost
moves and loads are found late, above 20 no horn follows better."""
ON_STAGE: Final = Pace(10.0, 20.0, resting_hz=3.0)
"""Chosen: a figure rests for most of an evening. A joint that is pushed is polled as one that
strays from the next reading on, and a servo that restarts, which takes 1.25 s, leaves three queries
unanswered."""
RESTED_NS: Final = 2 * NS_PER_S
"""Longer than the corrections at rest need (`standing.STEADY_S`, `standing.PUSH_S`)."""


def has_strayed(state: JointState) -> bool:
    """Return whether the next readings of a joint are worth more than usual."""
    load = state.disturbance
    if state.in_doubt or not -STRAYED_DEG <= load.error_deg <= STRAYED_DEG:
        return True
    if not -UNCORRECTED_DEG <= load.offset_deg - load.estimate_deg <= UNCORRECTED_DEG:
        return True
    if state.standing.is_undecided:
        return True
    return state.lost_moves is not None and state.lost_moves.is_doubtful


def is_led(state: JointState) -> bool:
    """Return whether the last target found a streamed joint in motion."""
    at_ns = state.last_arrival_ns
    return state.setpoints is not None and at_ns is not None and state.place(at_ns)[1] != 0.0


class Polled(Struct, frozen=True):
    """What a choice depends on: the joints of each bus that answer, and what is known of them."""

    by_bus: Mapping[str, Sequence[JointState]]
    trackers: Mapping[str, QueryTracker]
    doubted: Collection[str]
    """The joints whose settings are in doubt."""
    health: HealthMonitor


class QueryChoice(ABC):
    """Chooses the next query on each bus."""

    def __init__(self, polled: Polled) -> None:
        self._by_bus = polled.by_bus
        self._trackers = polled.trackers
        self._lines = {bus: tracker.line for bus, tracker in polled.trackers.items()}
        self._doubted = polled.doubted
        self._health = polled.health
        self._health_wait: dict[str, int] = dict.fromkeys(polled.by_bus, 0)
        """Number of queries on each bus since the last one about health."""
        self._visits_ns: dict[str, int] = {}
        """By joint, when a query that was chosen here was last sent to its servo."""
        self._places_ns: dict[str, int] = {}
        """By joint, when it was last queried for its angle here."""
        self._healths_ns: dict[str, int] = {}
        """By joint, when its servo was last asked about its health, with no probe."""
        self._rested_ns: int | None = None
        """Period of queries to a servo that rests in its place; None: as of any other."""
        self._late_counts: dict[str, int] = {}
        self._health_periods_ns = {
            state.joint.name: HEALTH_NS // 2 if state.settings.keywords else HEALTH_NS
            for states in polled.by_bus.values()
            for state in states
        }
        """By joint, the period of the queries about health; probes are every other one."""

    @abstractmethod
    def next_query(self, bus: str, now_ns: int) -> tuple[JointState, str] | None:
        """Return the joint to poll next and the keyword of its query; None: none now."""

    @abstractmethod
    def next_ns(self, bus: str, now_ns: int) -> int | None:
        """Return when `next_query` has one again, after it had none; None: that is not known."""

    @abstractmethod
    def is_due(self, bus: str, now_ns: int) -> bool:
        """Return whether `next_query` may return one now."""

    @abstractmethod
    def is_behind(self, bus: str, now_ns: int) -> bool:
        """Return whether a query has waited so long that each answer should be read at once."""

    @abstractmethod
    def touch(self, bus: str, state: JointState | None = None) -> None:
        """Note that a servo has answered; without `state`: that any servo of a bus may have not."""

    def begin_visit(self, bus: str, now_ns: int, soon_ns: int) -> bool:  # noqa: ARG002
        """Choose a servo that is due by `soon_ns`; return whether there is one.

        None is chosen where queries are late: then nothing may delay the moves.
        """
        return False

    def next_of_visit(self, bus: str, now_ns: int) -> tuple[JointState, str] | None:
        """Return the next query of the visit that goes on; None: there is none."""
        raise NotImplementedError

    def end_visit(self, bus: str) -> None:
        """Ask nothing more in the visit that goes on."""
        raise NotImplementedError

    def note_timeout(self, bus: str) -> None:  # noqa: B027  (only one kind of choice uses it)
        """Note that a query was not answered."""

    def note_sent(self, bus: str, state: JointState, keyword: str, now_ns: int) -> None:
        """Note that the query which `next_query` returned was sent."""
        name = state.joint.name
        state.settings.note_query(keyword, now_ns)
        self._health_wait[bus] += 1
        self._visits_ns[name] = now_ns
        if keyword == PLACE_KEYWORD:
            self._places_ns[name] = now_ns
        elif keyword == TARGET_KEYWORD:
            state.note_target_query()
        else:
            self._health_wait[bus] = 0
            self.note_health_sent(state, keyword, now_ns)

    def fresh(self, bus: str, state: JointState) -> str:
        """Return a keyword for whose answer no overdue answer of the servo can be taken."""
        tracker, servo_id = self._trackers[bus], state.joint.servo_id
        words = (PLACE_KEYWORD, *self._health_round(state))
        return next((one for one in words if not tracker.is_overdue(servo_id, one)), PLACE_KEYWORD)

    def overdue_words(self, bus: str, state: JointState, now_ns: int) -> list[str]:
        """Return the queries to a servo that was not polled for too long: its angle, its health."""
        words = [self.fresh(bus, state)]
        if words != [PLACE_KEYWORD]:
            return words
        word = self._late_health(state, now_ns) or state.settings.read_back(now_ns)
        return words if word is None else [*words, word]

    def note_health_sent(self, state: JointState, keyword: str, now_ns: int) -> None:
        """Note a query about health, or a probe, to the servo of a joint."""
        if not state.settings.judges(keyword):
            self._healths_ns[state.joint.name] = now_ns
        # What went along early makes the next one no earlier.
        planned_ns = min(self._health_due_ns(state), now_ns + self._health_period_ns(state))
        state.note_health_query(max(planned_ns, now_ns))

    def _late_health(
        self, state: JointState, now_ns: int, late_ns: int = HEALTH_LATE_NS
    ) -> str | None:
        """Return what a servo is asked about its health too late; None: it is not late.

        Probes do not count. The words take turns apart from those of the health round.
        """
        name = state.joint.name
        if now_ns - self._healths_ns.setdefault(name, now_ns) <= late_ns:
            return None
        words = health_words(state.joint.model.family)
        self._late_counts[name] = count = self._late_counts.get(name, -1) + 1
        return words[count % len(words)]

    def _health_round(self, state: JointState) -> tuple[str, ...]:
        return health_round(state.joint.model.family, state.settings.keywords)

    def _health_word(self, state: JointState) -> str:
        words = self._health_round(state)
        return words[state.health_count % len(words)]

    def _health_due_ns(self, state: JointState) -> int:
        """Return when the next query about the health of a servo is due."""
        return 0 if state.health_ns is None else state.health_ns + self._health_period_ns(state)

    def _health_period_ns(self, state: JointState) -> int:
        if self._rested_ns is not None and (rested_ns := self._resting_ns(state)) is not None:
            return rested_ns
        return self._health_periods_ns[state.joint.name]

    def _resting_ns(self, state: JointState) -> int | None:  # noqa: ARG002
        """Return the period of queries to a servo that rests in its place; None: it does not."""
        return None

    def _priority_word(self, bus: str, state: JointState, now_ns: int) -> str | None:
        """Return the keyword of a query that comes before any other to this servo; None: none.

        A servo with an overdue answer gets a query for which this answer cannot be taken.
        """
        tracker, servo_id, name = self._trackers[bus], state.joint.servo_id, state.joint.name
        if name in self._doubted:
            return state.settings.urgent
        if tracker.is_overdue(servo_id, PLACE_KEYWORD):
            return self.fresh(bus, state)
        if (probe := state.settings.read_back(now_ns)) is not None:
            return probe
        is_due = state.target_due_ns <= now_ns and not tracker.is_overdue(servo_id, TARGET_KEYWORD)
        return TARGET_KEYWORD if is_due and not tracker.awaits(servo_id, TARGET_KEYWORD) else None

    def _merit(self, state: JointState, now_ns: int) -> tuple[int, float]:
        """Return how urgent a joint is: the age of its last query, by its speed and error."""
        name, error_deg = state.joint.name, state.disturbance.error_deg
        if name not in self._visits_ns:
            return DOUBT_NS + now_ns, 0.0
        age_ns = now_ns - self._visits_ns[name]
        _, speed_deg_s = state.profile.at(now_ns / NS_PER_S)
        weight = 1.0 + SPEED_WEIGHT_S_PER_DEG * (speed_deg_s if speed_deg_s > 0.0 else -speed_deg_s)
        weight += ERROR_WEIGHT_PER_DEG * (error_deg if error_deg > 0.0 else -error_deg)
        overdue_ns = age_ns if age_ns > LONGEST_NS else 0
        if name in self._doubted or name in self._health.unconfirmed:
            overdue_ns = DOUBT_NS + age_ns
        lost_moves = state.lost_moves
        is_target_due = lost_moves is not None and lost_moves.target_due_ns <= now_ns
        return overdue_ns, age_ns * weight + VISIT_NS * is_target_due

    def _can_be_polled(self, bus: str, state: JointState, now_ns: int) -> bool:
        tracker, servo_id = self._trackers[bus], state.joint.servo_id
        if tracker.is_waiting(servo_id):
            return False
        return tracker.quiet_until_ns(servo_id) <= now_ns or state.joint.name in self._doubted


RIDE_RATIO: Final = 0.75
"""A query that is due this far into its period goes along with another one to the same servo: that
costs one visit less. Chosen."""


@dataclass(slots=True)
class _Round:
    """The joints of one bus: when each needs a query, and the visit to one of them that goes on."""

    states: Sequence[JointState]
    dues_ns: list[float]
    """By joint; infinite while a query to its servo is in flight."""
    targets_ns: list[float]
    """By joint, when its servo must report its target; infinite: it need not, or is asked now."""
    stale: set[int]
    """Joints whose instant must be computed anew."""
    arrivals_ns: list[int | None]
    """By joint, when its last move arrived, at the last look."""
    first_ns: float = 0.0
    """The earliest of `dues_ns`."""
    sent_bytes: int = 0
    """Bytes of the line at the last look: when moves have left, targets must be queried."""
    visited: int = 0
    words: list[str] = field(default_factory=list)
    """What the servo of joint `visited` is still asked in this visit, in reverse order."""

    @classmethod
    def of(cls, states: Sequence[JointState]) -> _Round:
        """Return a round in which every joint is due at once."""
        count, first_ns = len(states), 0.0 if states else math.inf
        return cls(
            states=states,
            dues_ns=[0.0] * count,
            targets_ns=[math.inf] * count,
            stale=set(range(count)),
            arrivals_ns=[None] * count,
            first_ns=first_ns,
        )


class ByNeed(QueryChoice):
    """Queries when their answers are worth it. Each visit asks a servo for all that is due soon."""

    def __init__(self, polled: Polled, pace: Pace) -> None:
        super().__init__(polled)
        self._steady_ns = ns_from_s(1.0 / pace.steady_hz)
        self._strayed_ns = ns_from_s(1.0 / pace.strayed_hz)
        self._health_later_ns = min(self._steady_ns, HEALTH_NS // 2)
        self._since_ns: dict[str, int] = {}
        """By joint, when it was first queried for its angle here."""
        self._rested_ns = None if pace.resting_hz is None else ns_from_s(1.0 / pace.resting_hz)
        self._lossy: set[str] = set()
        """Buses on which a query was not answered."""
        self._rounds = {bus: _Round.of(states) for bus, states in polled.by_bus.items()}
        self._indices = {
            state.joint.name: index
            for states in polled.by_bus.values()
            for index, state in enumerate(states)
        }
        self._doubts: tuple[set[str], ...] = ()
        """Joints in doubt, to be confirmed, and held back, at the last look."""

    def touch(self, bus: str, state: JointState | None = None) -> None:
        every = self._rounds[bus]
        if state is None:
            every.stale.update(range(len(every.states)))
        elif state.joint.name in self._indices:
            every.stale.add(self._indices[state.joint.name])

    def next_query(self, bus: str, now_ns: int) -> tuple[JointState, str] | None:
        """Return the next query of the visit to a servo; else of one to the most urgent servo."""
        every = self._rounds[bus]
        if every.words and (found := self.next_of_visit(bus, now_ns)) is not None:
            return found
        if not self.is_due(bus, now_ns):
            return None
        self._visit(bus, now_ns)
        return every.states[every.visited], every.words[-1]

    def next_of_visit(self, bus: str, now_ns: int) -> tuple[JointState, str] | None:
        every = self._rounds[bus]
        if every.words:
            self._look(bus, every)
            state = every.states[every.visited]
            if not self._doubted and self._quiet_until_ns(bus, state) <= now_ns:
                return state, every.words[-1]
            self.end_visit(bus)
        return None

    def begin_visit(self, bus: str, now_ns: int, soon_ns: int) -> bool:
        """Choose a servo; one with a target that it cannot report yet is visited later."""
        every = self._rounds[bus]
        if not self.is_due(bus, soon_ns) or self.is_behind(bus, now_ns):
            return False
        if every.words:
            return True
        if every.first_ns <= now_ns:
            self._visit(bus, now_ns)
            return True
        soon = [
            index
            for index, due_ns in enumerate(every.dues_ns)
            if due_ns <= soon_ns
            and every.targets_ns[index] == math.inf
            and self._quiet_until_ns(bus, every.states[index]) <= now_ns
        ]
        if soon:
            every.visited = max(soon, key=lambda index: self._merit(every.states[index], now_ns))
            every.words = self._words(bus, every.states[every.visited], now_ns, is_alone=True)
        return bool(soon)

    def end_visit(self, bus: str) -> None:
        every = self._rounds[bus]
        every.words.clear()
        every.stale.add(every.visited)

    def _visit(self, bus: str, now_ns: int) -> None:
        """Begin a visit to the most urgent of the joints that are due."""
        every = self._rounds[bus]
        most, targets = (-1, 0.0), 0
        for index, due_ns in enumerate(every.dues_ns):
            if due_ns <= now_ns:
                targets += every.targets_ns[index] <= now_ns
                merit = self._merit(every.states[index], now_ns)
                if merit > most:
                    most, every.visited = merit, index
        is_alone = targets == (every.targets_ns[every.visited] <= now_ns)
        every.words = self._words(bus, every.states[every.visited], now_ns, is_alone=is_alone)

    def is_due(self, bus: str, now_ns: int) -> bool:
        every = self._rounds[bus]
        self._look(bus, every)
        if every.stale:
            while every.stale:
                self._note_due(bus, every, every.stale.pop())
            every.first_ns = min(every.dues_ns)
        return bool(every.words) or every.first_ns <= now_ns

    def is_behind(self, bus: str, now_ns: int) -> bool:
        return self._rounds[bus].first_ns < now_ns - self._strayed_ns

    def next_ns(self, bus: str, now_ns: int) -> int | None:  # noqa: ARG002
        next_ns = self._rounds[bus].first_ns
        return None if next_ns == math.inf else int(next_ns)

    def note_sent(self, bus: str, state: JointState, keyword: str, now_ns: int) -> None:
        super().note_sent(bus, state, keyword, now_ns)
        every = self._rounds[bus]
        every.words.pop()
        every.dues_ns[every.visited] = every.targets_ns[every.visited] = math.inf
        every.first_ns = min(every.dues_ns)
        every.sent_bytes = self._lines[bus].sent_bytes

    def _look(self, bus: str, every: _Round) -> None:
        """Note what has changed besides answers: moves that left, and doubts."""
        if any(self._doubts) or self._doubted or self._health.unconfirmed:
            states = (state for one in self._rounds.values() for state in one.states)
            held_back = {state.joint.name for state in states if state.in_doubt}
            doubts = ({*self._doubted}, {*self._health.unconfirmed}, held_back)
            if doubts != self._doubts:
                self._doubts = doubts
                for one in self._rounds:
                    self.touch(one)
        sent_bytes = self._lines[bus].sent_bytes
        if every.sent_bytes != sent_bytes:
            every.sent_bytes = sent_bytes
            for index, state in enumerate(every.states):
                if state.last_arrival_ns != every.arrivals_ns[index]:
                    every.arrivals_ns[index] = state.last_arrival_ns
                    every.stale.add(index)

    def _quiet_until_ns(self, bus: str, state: JointState) -> int:
        return self._trackers[bus].quiet_until_ns(state.joint.servo_id)

    def _note_due(self, bus: str, every: _Round, index: int) -> None:
        """Compute when a servo must be polled, and when its target is due."""
        state = every.states[index]
        name, servo_id = state.joint.name, state.joint.servo_id
        due_ns = target_ns = math.inf
        if not self._trackers[bus].is_waiting(servo_id):
            quiet_until_ns = self._trackers[bus].quiet_until_ns(servo_id)
            place_ns, target_ns = self._places_ns.get(name), state.target_due_ns
            if name in self._doubted:
                due_ns = 0.0
            elif place_ns is None or name in self._health.unconfirmed:
                due_ns = quiet_until_ns
            else:
                place_ns += self._place_period_ns(state)
                # Health goes along with the next query for the angle, due soon after it.
                health_ns = self._health_due_ns(state) + self._health_later_ns
                due_ns = max(min(place_ns, target_ns, health_ns), quiet_until_ns)
        every.dues_ns[index], every.targets_ns[index] = due_ns, target_ns

    def _place_period_ns(self, state: JointState) -> int:
        """Return how often the angle of a joint is queried.

        If the servo of a streamed joint restarts unnoticed, the next bare `D` leads it to a target
        far ahead, and nothing limits its speed but what it has stored. So it is read more often
        while it moves, but not on a line that loses answers: three in a row hold its moves back.
        """
        if self._rested_ns is not None and (rested_ns := self._resting_ns(state)) is not None:
            return rested_ns
        if state.setpoints is not None and state.joint.bus not in self._lossy and is_led(state):
            return self._strayed_ns
        return self._strayed_ns if has_strayed(state) else self._steady_ns

    def note_timeout(self, bus: str) -> None:
        self._lossy.add(bus)

    def _resting_ns(self, state: JointState) -> int | None:
        place_ns = self._places_ns.get(state.joint.name)
        if self._rested_ns is None or place_ns is None:
            return None
        since_ns = self._since_ns.setdefault(state.joint.name, place_ns)
        has_moved = place_ns < max(since_ns, state.last_arrival_ns or 0) + RESTED_NS
        if has_moved or has_strayed(state) or not state.is_at_rest(place_ns):
            return None
        return self._rested_ns

    def _words(self, bus: str, state: JointState, now_ns: int, *, is_alone: bool) -> list[str]:
        """Return what a servo is asked in one visit, in reverse order.

        Unless it `is_alone`, other servos wait to be asked for their targets: then it is asked only
        what is most urgent. On a line on which angles come late, every `HEALTH_LEAST`-th query is
        about health.
        """
        name = state.joint.name
        first = self._priority_word(bus, state, now_ns)
        if first is None:
            first = self._health.unconfirmed.get(name)
        probes = state.settings.keywords
        period_ns, place_ns = self._place_period_ns(state), self._places_ns.get(name)
        age_ns = math.inf if place_ns is None else now_ns - place_ns
        is_late = age_ns > 2.0 * period_ns
        is_overdue = self._trackers[bus].is_overdue(state.joint.servo_id, PLACE_KEYWORD)
        is_single = is_overdue or name in self._doubted
        if is_single or first not in (None, TARGET_KEYWORD, *probes):
            return [first or PLACE_KEYWORD]
        if first in probes and is_late:
            # Where queries are few, a probe is due at each visit, and would be all that is asked.
            late = self._late_health(state, now_ns)
            other = PLACE_KEYWORD if late is None and name in self._visits_ns else late
            return [first] if other is None else [other, first]
        words = [] if first is None else [first]
        if words and not is_alone:
            return words
        if age_ns >= RIDE_RATIO * period_ns:
            words.append(PLACE_KEYWORD)
        health_ns = self._health_period_ns(state)
        is_due = state.health_ns is None or now_ns - state.health_ns >= RIDE_RATIO * health_ns
        if first in probes:  # At rest one is due at each visit, and would be all that is asked.
            is_resting = self._resting_ns(state) is not None
            word = self._late_health(state, now_ns, 0) if is_resting else None
            words += [] if word is None else [word]
        elif is_due and not (is_late and self._health_wait[bus] < HEALTH_LEAST - 1):
            words.append(self._health_word(state))
        return words[::-1] or [PLACE_KEYWORD]


@dataclass(slots=True)
class _ServoTurn:
    """One servo, and the number of queries that it still gets before the next servo."""

    state: JointState
    left: int
    places: int = 0
    """Number of position queries in this row."""


class FullLine(QueryChoice):
    """Rows of queries to one servo after the other, so that the answers fill their line."""

    def __init__(self, polled: Polled) -> None:
        super().__init__(polled)
        self._rows: dict[str, _ServoTurn | None] = dict.fromkeys(self._by_bus)

    def next_query(self, bus: str, now_ns: int) -> tuple[JointState, str] | None:
        row = self._row(bus, now_ns)
        return None if row is None else (row.state, self._word(bus, row, now_ns))

    def next_ns(self, bus: str, now_ns: int) -> int | None:
        tracker = self._trackers[bus]
        quiet = (tracker.quiet_until_ns(state.joint.servo_id) for state in self._by_bus[bus])
        return min((instant_ns for instant_ns in quiet if instant_ns > now_ns), default=None)

    def is_due(self, bus: str, now_ns: int) -> bool:  # noqa: ARG002
        return True

    def is_behind(self, bus: str, now_ns: int) -> bool:  # noqa: ARG002
        return True

    def touch(self, bus: str, state: JointState | None = None) -> None:
        """Nothing is kept from one query to the next."""

    def note_sent(self, bus: str, state: JointState, keyword: str, now_ns: int) -> None:
        super().note_sent(bus, state, keyword, now_ns)
        row = self._rows[bus]
        assert row is not None
        row.left -= 1
        row.places += keyword == PLACE_KEYWORD

    def _row(self, bus: str, now_ns: int) -> _ServoTurn | None:
        """Return the servo in turn and its number of queries; None: no servo can be polled."""
        row, tracker = self._rows[bus], self._trackers[bus]
        if row is not None and row.left > 0:
            servo_id = row.state.joint.servo_id
            if tracker.quiet_until_ns(servo_id) <= now_ns and not self._doubted:
                return row
        # A row is not cut short for a servo that must report its target: that would cost a tenth
        # of the answers (measured), and that servo waits for a row or two at most.
        free = (one for one in self._by_bus[bus] if self._can_be_polled(bus, one, now_ns))
        state = max(free, key=lambda one: self._merit(one, now_ns), default=None)
        self._rows[bus] = None if state is None else _ServoTurn(state, self._length(bus, state))
        return self._rows[bus]

    def _length(self, bus: str, state: JointState) -> int:
        """Return the length of a row of queries, such that the gap before it is small beside it."""
        tracker, servo_id = self._trackers[bus], state.joint.servo_id
        latency = tracker.latency(servo_id)
        if not latency.is_known or tracker.is_overdue(servo_id, PLACE_KEYWORD):
            return 1
        if state.joint.name in self._doubted:
            return 1
        line = self._lines[bus]
        reply_ns = line.time_ns(tracker.reply_bytes(servo_id, PLACE_KEYWORD))
        gap_ns = latency.spread_ns // 2 + line.time_ns(1)
        wanted = math.ceil(FILL_RATIO / (1.0 - FILL_RATIO) * gap_ns / reply_ns)
        most = VISIT_NS // (reply_ns * len(self._by_bus[bus]))
        return max(1, min(wanted, most, tracker.depth(servo_id)))

    def _word(self, bus: str, row: _ServoTurn, now_ns: int) -> str:
        """Return the keyword of the next query: position, target, or health.

        A row ends with a query about health, since equal queries need a different one at their end.
        """
        state = row.state
        if (word := self._priority_word(bus, state, now_ns)) is not None:
            return word
        is_alone = row.left == 1 and row.places == 0
        is_due = now_ns >= self._health_due_ns(state)
        is_due = is_due and self._health_wait[bus] >= HEALTH_LEAST - 1
        doubt = self._health.unconfirmed.get(state.joint.name)
        if row.left > 1 or (is_alone and doubt is None and not is_due):
            return PLACE_KEYWORD
        return doubt or self._health_word(state)
