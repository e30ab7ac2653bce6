"""Polls servos in turn, as fast as each line allows, and raises alarms.

A round queries every servo for the values that change quickly and for one of those that change
slowly. Nothing is commanded and nothing moves; another program may move the servos meanwhile. An
alarm reports a servo that is hot, overloaded, badly supplied, stuck or silent.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.maintenance.discovery import (
    BAD_STATUS,
    CURRENT_MAX_A,
    HOT_C,
    SUPPLY_MAX_V,
    SUPPLY_MIN_V,
)
from lss_motion.maintenance.findings import unasked_text, unreadable_text
from lss_motion.player.query_tracker import QueryTracker
from lss_motion.player.serial_line import SerialLine
from lss_motion.player.transactions import Dialogue, Item
from lss_motion.protocol.codec import language_table, read_reply
from lss_motion.protocol.constants import Family, Status, status_from
from lss_motion.protocol.framing import Command, Reply
from lss_motion.protocol.table import Device
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.maintenance.settings import Target
    from lss_motion.player.events import Event
    from lss_motion.robot.model import Bus


QUICK: Final = ("QD", "QWD", "QC")
SLOW: Final = ("Q", "QT", "QV")
"""One of these a round, in turn, as far as the servo's family has the query."""
HISTORY: Final = 40
"""The positions of a sparkline."""
MISSES_MAX: Final = 3
"""Rounds without any answer after which a servo is silent."""
UNASKED_ROUNDS: Final = 50
UNASKED_MAX: Final = 2
"""More replies than queries in so many rounds: another host asks, or the servo sends by itself."""
SUSPENDED_NS: Final = 2 * NS_PER_S
"""How long a silent servo is not polled, so that it does not delay the others all the time; the
maker's library takes 15 s (FACTS.md H6)."""


@dataclass(slots=True, kw_only=True)
class ServoState:
    """The newest values of one servo; None: not answered yet. Angles and speeds are the servo's."""

    target: Target
    at_ns: int = 0
    position_deg: float | None = None
    speed_deg_s: float | None = None
    current_a: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    status: Status | None = None
    raw: float | None = None
    """The value of an analog pin of a 2IO."""
    misses: int = 0
    unasked: int = 0
    """How many more replies than queries there were in the last rounds."""
    surplus: deque[int] = field(default_factory=lambda: deque(maxlen=UNASKED_ROUNDS))
    positions_deg: deque[float] = field(default_factory=lambda: deque(maxlen=HISTORY))

    @property
    def is_silent(self) -> bool:
        return self.misses >= MISSES_MAX

    def take_round(self, answers: Mapping[str, int | str | None], now_ns: int) -> None:
        """Take the answers of a round, by keyword; a round without any is a miss."""
        for keyword, value in answers.items():
            self.take(keyword, value)
        self.misses = 0 if answers else self.misses + 1
        if answers:
            self.at_ns = now_ns

    def take(self, keyword: str, value: int | str | None) -> None:
        """Take an answer; an unreadable one changes nothing."""
        statement = read_reply(self.target.language, Reply(self.target.servo_id, keyword, value))
        if statement is None or not isinstance(statement.value, int | float):
            return
        match keyword:
            case "QD":
                self.position_deg = float(statement.value)
                self.positions_deg.append(float(statement.value))
            case "QWD":
                self.speed_deg_s = float(statement.value)
            case "QC":
                self.current_a = float(statement.value)
            case "QV":
                self.voltage_v = float(statement.value)
            case "QT":
                self.temperature_c = float(statement.value)
            case "QA":
                self.raw = float(statement.value)
            case _:
                assert isinstance(value, int)
                self.status = status_from(value, self.target.family, self.target.firmware)


@dataclass(slots=True)
class _BusRounds:
    """The rounds of one bus, which do not depend on those of a slower bus."""

    name: str
    servos: list[ServoState]
    line: SerialLine
    tracker: QueryTracker
    dialogue: Dialogue
    rounds: int = 0
    began_ns: int = 0
    replies: Counter[int] = field(default_factory=Counter)
    """The replies of this round by servo id."""
    suspended: dict[int, int] = field(default_factory=dict)
    """Servo id → end of the time in which it is not polled."""
    asked: int = 0
    """Number of queries of this round."""
    seen_garbage: int = 0
    """Unreadable pieces that came before this round."""
    surplus: deque[int] = field(default_factory=lambda: deque(maxlen=UNASKED_ROUNDS))
    """For each round: unreadable pieces less the queries without an answer, which may be these."""

    def begin(self, now_ns: int) -> None:
        """Begin the next round."""
        self.rounds += 1
        self.began_ns = now_ns
        self.replies.clear()
        items = [
            Item(bus=self.name, command=Command(servo_id, keyword), is_query=True, tries=1)
            for servo in self.servos
            for servo_id in [servo.target.servo_id]
            if self.suspended.get(servo_id, 0) <= now_ns
            for keyword in _keywords(servo, self.rounds)
        ]
        self.asked = len(items)
        self.dialogue = Dialogue(items, {self.name: self.line}, {self.name: self.tracker})

    def end(self, now_ns: int) -> list[ServoState]:
        """Take the answers of the round that ends; return the servos that answered."""
        if not self.rounds:
            return []
        fresh = []
        unanswered = self.asked - len(self.dialogue.answers)
        self.surplus.append(self.line.garbage - self.seen_garbage - unanswered)
        self.seen_garbage = self.line.garbage
        for servo in self.servos:
            servo_id = servo.target.servo_id
            if self.suspended.get(servo_id, 0) > self.began_ns:
                continue
            self.suspended.pop(servo_id, None)
            answered = {
                key: value
                for (_, asked_id, key), value in self.dialogue.answers.items()
                if asked_id == servo_id
            }
            servo.take_round(answered, now_ns)
            asked = len(_keywords(servo, self.rounds)) if answered else 0
            servo.surplus.append(self.replies[servo_id] - max(asked, len(answered)))
            servo.unasked = max(sum(servo.surplus), 0)
            if servo.is_silent:
                self.suspended[servo_id] = now_ns + SUSPENDED_NS
            if answered:
                fresh.append(servo)
        return fresh


class Watch:
    """Polls until `stop`, for the run loop. `readings` always hold the newest values.

    `take_fresh()` returns the servos that answered in the rounds since the last call.
    """

    def __init__(self, targets: Sequence[Target], buses: Mapping[str, Bus]) -> None:
        self.readings = [ServoState(target=target) for target in targets]
        self._fresh: list[ServoState] = []
        self._is_stopped = False
        self._buses: dict[str, _BusRounds] = {}
        for name in dict.fromkeys(target.bus for target in targets):
            line = SerialLine(buses[name])
            tracker = QueryTracker(line)
            on_bus = [servo for servo in self.readings if servo.target.bus == name]
            dialogue = Dialogue([], {name: line}, {name: tracker})
            self._buses[name] = _BusRounds(name, on_bus, line, tracker, dialogue)

    @property
    def rounds(self) -> dict[str, int]:
        """Return how many rounds each bus has completed."""
        return {name: max(bus.rounds - 1, 0) for name, bus in self._buses.items()}

    @property
    def unreadable(self) -> list[str]:
        """Return the buses with unreadable bytes that no query here can have caused."""
        return [name for name, bus in self._buses.items() if sum(bus.surplus) > UNASKED_MAX]

    @property
    def has_asked_all(self) -> bool:
        """Return whether every servo that answers was queried for everything once."""
        return all(rounds > len(SLOW) for rounds in self.rounds.values())

    def stop(self) -> None:
        self._is_stopped = True

    def take_fresh(self) -> list[ServoState]:
        """Return the servos that answered in the rounds completed since the last call."""
        fresh, self._fresh = self._fresh, []
        return fresh

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        out = {}
        for name, bus in self._buses.items():
            bus.dialogue.advance(leaves_ns)
            if bus.dialogue.is_finished and not self._is_stopped:
                self._fresh += bus.end(leaves_ns)
                bus.begin(leaves_ns)
                bus.dialogue.advance(leaves_ns)
            if data := bus.line.take():
                out[name] = data
        return out

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        if (rounds := self._buses.get(bus)) is not None:
            for reply, _ in rounds.line.receive(data, now_ns):
                if reply.servo_id is not None:
                    rounds.replies[reply.servo_id] += 1
                rounds.dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        if self._is_stopped:
            return None
        wakeups_ns = []
        for bus in self._buses.values():
            wakeup_ns = bus.dialogue.next_wakeup_ns()
            if wakeup_ns is None:  # All are suspended: continue with the first to end.
                wakeup_ns = min(bus.suspended.values(), default=bus.began_ns)
            wakeups_ns.append(wakeup_ns)
        return min(wakeups_ns, default=None)

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}


def _keywords(servo: ServoState, round_: int) -> tuple[str, ...]:
    """Return the queries to a servo in a round; a single one until it has answered."""
    target = servo.target
    if target.family is Family.IO2:
        return ("QA",) if target.device is Device.ANALOG else ("QD",)
    if servo.misses or not servo.at_ns:
        return ("QD",)
    known = language_table(target.language).by_keyword
    slow = [word for word in SLOW if word in known]
    return (*QUICK, slow[round_ % len(slow)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """The limits of the alarms. `discovery` defines the defaults and their sources."""

    temperature_max_c: float = HOT_C
    current_max_a: float = CURRENT_MAX_A
    supply_min_v: float = SUPPLY_MIN_V
    supply_max_v: float = SUPPLY_MAX_V

    def alarms(self, servo: ServoState) -> list[tuple[str, str]]:
        """Return kind and text of every present problem of a servo."""
        name = servo.target.name
        found = []
        if servo.is_silent:
            return [("silent", f"{name} does not answer")]
        if servo.unasked > UNASKED_MAX:
            found.append(("unasked", unasked_text({servo.target.servo_id: servo.unasked})))
        if servo.status in BAD_STATUS and servo.status is not None:
            found.append(("status", f"{name}: {servo.status.value}"))
        if servo.temperature_c is not None and servo.temperature_c >= self.temperature_max_c:
            found.append(
                (
                    "temperature",
                    f"{name}: {servo.temperature_c:.0f} °C, from {self.temperature_max_c:g} on "
                    f"it is too hot",
                )
            )
        if servo.current_a is not None and servo.current_a > self.current_max_a:
            found.append(
                ("current", f"{name}: {servo.current_a:.2f} A, more than {self.current_max_a:g}")
            )
        if servo.voltage_v is not None and not (
            self.supply_min_v <= servo.voltage_v <= self.supply_max_v
        ):
            found.append(
                (
                    "voltage",
                    f"{name}: {servo.voltage_v:.1f} V, not {self.supply_min_v:g} to "
                    f"{self.supply_max_v:g}",
                )
            )
        return found


class Alarms:
    """Keeps the active alarms, so that each is reported once until it ends."""

    def __init__(self, thresholds: Thresholds) -> None:
        self._thresholds = thresholds
        self.active: dict[tuple[str, str], str] = {}
        """Servo and kind → the newest text."""

    def update(self, readings: Iterable[ServoState], unreadable: Iterable[str] = ()) -> list[str]:
        """Return the texts of the alarms that have begun since the last call.

        `unreadable` are the buses of `Watch.unreadable`.
        """
        now = {
            (servo.target.name, kind): text
            for servo in readings
            for kind, text in self._thresholds.alarms(servo)
        }
        now |= {(bus, "unreadable"): unreadable_text(bus) for bus in unreadable}
        fresh = [text for key, text in now.items() if key not in self.active]
        self.active = now
        return fresh
