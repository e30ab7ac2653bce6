"""Polls servos in turn, as fast as each line allows, and raises alarms.

A round queries every servo for the values that change quickly and for one of those that change
slowly. Nothing is commanded and nothing moves; another program may move the servos meanwhile. An
alarm reports a servo that is hot, overloaded, badly supplied, stuck or silent.

Where more arrives than was asked for, nothing is asked for a moment. What arrives all the same is
of another host, or of a servo that sends by itself; if nothing does, several servos share an id. A
host that asks seldom is not noticed by that on a full line, so every few seconds nothing is asked
for a shorter time.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.playing.discovery import (
    BAD_STATUS,
    CURRENT_MAX_A,
    HOT_C,
    SUPPLY_MAX_V,
    SUPPLY_MIN_V,
)
from lss_motion.playing.player.echo import echo_text
from lss_motion.playing.player.handshake import Dialogue, Item
from lss_motion.playing.player.query_tracker import SLOW_TIMEOUT_NS, QueryTracker, SerialLine
from lss_motion.playing.player.unasked import UnaskedWatch, disturbed_text
from lss_motion.protocol.codec import language_table, read_reply
from lss_motion.protocol.constants import Family, Status, status_from
from lss_motion.protocol.framing import Command, Reply
from lss_motion.protocol.table import Device
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.maintenance.settings import Target
    from lss_motion.playing.player.events import Event
    from lss_motion.robot.model import Bus


QUICK: Final = ("QD", "QWD", "QC")
SLOW: Final = ("Q", "QT", "QV")
"""One of these a round, in turn, as far as the servo's family has the query."""
HISTORY: Final = 40
"""The positions of a sparkline."""
MISSES_MAX: Final = 3
"""Rounds without any answer after which a servo is silent."""
LATE_NS: Final = SLOW_TIMEOUT_NS
"""What arrives so shortly after the last query may be a late reply to it."""
SILENCE_NS: Final = 1200 * NS_PER_MS
"""How long nothing is asked. Chosen: a host that asks once a second is noticed by then."""
CHECK_NS: Final = 300 * NS_PER_MS
"""How long nothing is asked in between, if nothing arrives; otherwise `SILENCE_NS` longer."""
CHECK_EVERY_NS: Final = 5 * NS_PER_S
"""How often nothing is asked in between. Chosen: it costs 7 % of the readings."""
CHECK_FIRST_NS: Final = 3 * NS_PER_S
"""When that happens first."""
CHECK_ARRIVALS: Final = 2
"""So many arrivals show another host; one may be a very late reply."""
FIRST_NS: Final = 300 * NS_PER_MS
"""How long nothing is asked after the first arrival. Chosen: other programs ask all servos in
that time, so that all are named."""
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
class _ListeningGap:
    """A time in which nothing is asked, and what arrives in it."""

    from_ns: int
    until_ns: int
    is_check: bool
    """Whether nothing has arrived yet that was not asked for."""
    replies: Counter[int] = field(default_factory=Counter)
    """Replies by servo id."""
    unreadable: int = 0
    """Deliveries without a whole reply."""

    def take(self, replies: Sequence[Reply], now_ns: int) -> None:
        """Use a delivery with these whole replies."""
        if now_ns < self.from_ns:
            return
        if not replies:
            self.unreadable += 1
        self.replies.update(one.servo_id for one in replies if one.servo_id is not None)
        if self.is_check and self.arrivals == 1:
            self.until_ns = now_ns + SILENCE_NS
        else:
            self.until_ns = min(self.until_ns, now_ns + FIRST_NS)

    @property
    def arrivals(self) -> int:
        return self.replies.total() + self.unreadable


@dataclass(slots=True)
class _BusRounds:
    """The rounds of one bus, which do not depend on those of a slower bus."""

    name: str
    servos: list[ServoState]
    line: SerialLine
    tracker: QueryTracker
    dialogue: Dialogue
    watch: UnaskedWatch
    rounds: int = 0
    began_ns: int = 0
    suspended: dict[int, int] = field(default_factory=dict)
    """Servo id → end of the time in which it is not polled."""
    silence: _ListeningGap | None = None
    check_ns: int | None = None
    """When nothing is asked again; None: the first round has not begun."""
    found: str = ""
    """Why more arrives than was asked for, as a text for a person; empty if that is not so."""
    is_other: bool = False
    """Whether `found` is about another host."""

    def listen(self, now_ns: int) -> bool:
        """Return whether nothing may be asked now: it is found out whether others send."""
        if self.check_ns is None:
            self.check_ns = now_ns + CHECK_FIRST_NS
        if self.silence is not None:
            if now_ns >= self.silence.until_ns:
                heard, self.silence = self.silence, None
                self.check_ns = now_ns + CHECK_EVERY_NS
                self._judge(heard)
            return self.silence is not None
        is_excess = self.watch.advance(now_ns)
        if is_excess or now_ns >= self.check_ns:
            from_ns = now_ns + LATE_NS
            until_ns = from_ns + (SILENCE_NS if is_excess else CHECK_NS)
            self.silence = _ListeningGap(from_ns, until_ns, is_check=not is_excess)
        elif not self.is_other and not self.watch.is_disturbed:
            self.found = self._echo_text()
        return self.silence is not None

    def _echo_text(self) -> str:
        """Return what is said of a port that returns what is sent; empty: it does not."""
        if not self.line.echo.count:
            return ""
        return echo_text(self.line.bus.port, is_alone=not self.line.replies)

    def _judge(self, heard: _ListeningGap) -> None:
        """Use what arrived while nothing was asked."""
        if heard.arrivals >= (CHECK_ARRIVALS if heard.is_check else 1):
            self.is_other = True
            where = f"bus {self.name}"
            self.found = disturbed_text(where, heard.replies, heard.unreadable)
        elif not heard.is_check:
            self.is_other = False
            self.found = _shared_text(f"bus {self.name}", self.watch.replies)
        elif self.is_other:
            self.is_other, self.found = False, ""

    def begin(self, now_ns: int) -> None:
        """Begin the next round."""
        self.rounds += 1
        self.began_ns = now_ns
        items = [
            Item(bus=self.name, command=Command(servo_id, keyword), tries=1)
            for servo in self.servos
            for servo_id in [servo.target.servo_id]
            if self.suspended.get(servo_id, 0) <= now_ns
            for keyword in _keywords(servo, self.rounds)
        ]
        self.dialogue = Dialogue(items, {self.name: self.tracker})

    def end(self, now_ns: int) -> list[ServoState]:
        """Take the answers of the round that ends; return the servos that answered."""
        if not self.rounds:
            return []
        fresh = []
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
            if servo.is_silent:
                self.suspended[servo_id] = now_ns + SUSPENDED_NS
            if answered:
                fresh.append(servo)
        return fresh


class Polling:
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
            dialogue = Dialogue([], {name: tracker})
            watch = UnaskedWatch(tracker)
            self._buses[name] = _BusRounds(name, on_bus, line, tracker, dialogue, watch)

    @property
    def rounds(self) -> dict[str, int]:
        """Return how many rounds each bus has completed."""
        return {name: max(bus.rounds - 1, 0) for name, bus in self._buses.items()}

    @property
    def disturbed(self) -> dict[str, str]:
        """Return, by bus, why more arrives than was asked for, as a text for a person."""
        return {name: bus.found for name, bus in self._buses.items() if bus.found}

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
                if bus.silence is None:
                    self._fresh += bus.end(leaves_ns)
                if not bus.listen(leaves_ns):
                    bus.begin(leaves_ns)
                    bus.dialogue.advance(leaves_ns)
            if data := bus.line.take():
                out[name] = data
        return out

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        if (rounds := self._buses.get(bus)) is not None:
            replies = [reply for reply, _ in rounds.line.receive(data, now_ns)]
            for reply in replies:
                rounds.dialogue.receive(bus, reply, now_ns)
            if rounds.silence is not None:
                rounds.silence.take(replies, now_ns)

    def next_wakeup_ns(self) -> int | None:
        if self._is_stopped:
            return None
        wakeups_ns = []
        for bus in self._buses.values():
            wakeup_ns = bus.dialogue.next_wakeup_ns()
            if bus.silence is not None:
                wakeup_ns = bus.silence.until_ns
            elif wakeup_ns is None:  # All are suspended: continue with the first to end.
                wakeup_ns = min(bus.suspended.values(), default=bus.began_ns)
            wakeups_ns.append(wakeup_ns)
        return min(wakeups_ns, default=None)

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}


def _shared_text(where: str, replies: Mapping[int, int]) -> str:
    """Return the text for a bus on which queries bring more than one reply, or damaged ones."""
    ids = ", ".join(str(one) for one, count in sorted(replies.items()) if count > 1)
    return (
        f"{where}: queries{f' to id {ids}' if ids else ''} bring several replies, or damaged ones, "
        f"and nothing comes while nothing is asked: several servos share an id, or the cable is "
        f"disturbed. `lss-motion scan` names the id"
    )


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


class Thresholds(Struct, frozen=True, kw_only=True):
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

    def update(
        self, readings: Iterable[ServoState], disturbed: Mapping[str, str] = MappingProxyType({})
    ) -> list[str]:
        """Return the texts of the alarms that have begun since the last call.

        `disturbed` is `Polling.disturbed`.
        """
        now = {
            (servo.target.name, kind): text
            for servo in readings
            for kind, text in self._thresholds.alarms(servo)
        }
        now |= {(bus, "unasked"): text for bus, text in disturbed.items()}
        fresh = [text for key, text in now.items() if key not in self.active]
        self.active = now
        return fresh
