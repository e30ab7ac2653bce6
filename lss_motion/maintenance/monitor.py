"""Watches servos: polls every servo in turn and raises alarms.

Watching servos: question after question, round after round, as fast as each line allows.

A round asks every servo for what changes quickly, and for one of the things that change slowly.
Nothing is ordered, so nothing moves; what a servo does while it is watched is others' business.

When somebody should look: a servo that is hot, overloaded, badly supplied, stuck or silent.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.maintenance.discovery import (
    BAD_STATUS,
    CURRENT_MAX_A,
    HOT_C,
    SUPPLY_MAX_V,
    SUPPLY_MIN_V,
)
from lss_motion.player.query_tracker import QueryTracker
from lss_motion.player.serial_line import SerialLine
from lss_motion.player.transactions import Dialogue, Item
from lss_motion.protocol.codec import FAMILY_TABLES, read_reply
from lss_motion.protocol.constants import Family, Status, status_from
from lss_motion.protocol.line import Command, Reply
from lss_motion.protocol.table import Device
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.maintenance.settings import Target
    from lss_motion.player.events import Event
    from lss_motion.robot.model import Bus


QUICK: Final = ("QD", "QWD", "QC")
SLOW: Final = ("Q", "QT", "QV")
"""Asked in turn, one a round, if the servo's family has a word for it."""
HISTORY: Final = 40
"""Positions that a sparkline shows."""
MISSES_MAX: Final = 3
"""Rounds without any answer after which a servo counts as silent."""
BENCHED_NS: Final = 2 * NS_PER_S
"""How long a silent servo is left out, so that the others do not wait for it all the time; the
maker's library waits 15 s (FACTS.md H6)."""


@dataclass(slots=True, kw_only=True)
class ServoState:
    """What is known of one servo; None: not said yet. Angles and speeds are the servo's own."""

    target: Target
    at_ns: int = 0
    position_deg: float | None = None
    speed_deg_s: float | None = None
    current_a: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    status: Status | None = None
    raw: float | None = None
    """Of an analog pin of a 2IO."""
    misses: int = 0
    positions_deg: deque[float] = field(default_factory=lambda: deque(maxlen=HISTORY))

    @property
    def is_silent(self) -> bool:
        return self.misses >= MISSES_MAX

    def take(self, keyword: str, value: int | str | None) -> None:
        """Take an answer; one that cannot be read changes nothing."""
        said = read_reply(self.target.family, Reply(self.target.servo_id, keyword, value))
        if said is None or not isinstance(said.value, int | float):
            return
        match keyword:
            case "QD":
                self.position_deg = float(said.value)
                self.positions_deg.append(float(said.value))
            case "QWD":
                self.speed_deg_s = float(said.value)
            case "QC":
                self.current_a = float(said.value)
            case "QV":
                self.voltage_v = float(said.value)
            case "QT":
                self.temperature_c = float(said.value)
            case "QA":
                self.raw = float(said.value)
            case _:
                assert isinstance(value, int)
                self.status = status_from(value, self.target.family, self.target.firmware)


@dataclass(slots=True)
class _Lane:
    """One bus: its rounds are its own, however slow another bus is."""

    readings: list[ServoState]
    line: SerialLine
    questioner: QueryTracker
    dialogue: Dialogue
    rounds: int = 0
    began_ns: int = 0
    benched: dict[int, int] = field(default_factory=dict)
    """Servo id → until when it is not asked."""


class Watch:
    """Asks until `stop`, for the runner. `readings` are always the newest.

    `take_fresh()` gives what the rounds since the last call have read.
    """

    def __init__(self, targets: Sequence[Target], buses: Mapping[str, Bus]) -> None:
        self.readings = [ServoState(target=target) for target in targets]
        self._fresh: list[ServoState] = []
        self._is_stopped = False
        self._lanes: dict[str, _Lane] = {}
        for name in dict.fromkeys(target.bus for target in targets):
            line = SerialLine(buses[name])
            questioner = QueryTracker(line)
            on_bus = [reading for reading in self.readings if reading.target.bus == name]
            dialogue = Dialogue([], {name: line}, {name: questioner})
            self._lanes[name] = _Lane(on_bus, line, questioner, dialogue)

    @property
    def rounds(self) -> dict[str, int]:
        """Return how many rounds each bus has completed."""
        return {name: max(lane.rounds - 1, 0) for name, lane in self._lanes.items()}

    @property
    def has_asked_all(self) -> bool:
        """Return whether every servo that answers has been asked everything once."""
        return all(rounds > len(SLOW) for rounds in self.rounds.values())

    def stop(self) -> None:
        self._is_stopped = True

    def take_fresh(self) -> list[ServoState]:
        """Return the servos that answered in the rounds completed since the last call."""
        fresh, self._fresh = self._fresh, []
        return fresh

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        out = {}
        for name, lane in self._lanes.items():
            lane.dialogue.advance(leaves_ns)
            if lane.dialogue.is_finished and not self._is_stopped:
                self._end_round(lane, leaves_ns)
                self._begin_round(name, lane, leaves_ns)
                lane.dialogue.advance(leaves_ns)
            if data := lane.line.take():
                out[name] = data
        return out

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        if bus in self._lanes:
            lane = self._lanes[bus]
            for reply in lane.line.receive(data):
                lane.dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        if self._is_stopped:
            return None
        wakeups_ns = []
        for lane in self._lanes.values():
            wakeup_ns = lane.dialogue.next_wakeup_ns()
            if wakeup_ns is None:  # Everybody is left out: look again when the first is not.
                wakeup_ns = min(lane.benched.values(), default=lane.began_ns)
            wakeups_ns.append(wakeup_ns)
        return min(wakeups_ns, default=None)

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}

    def _begin_round(self, name: str, lane: _Lane, now_ns: int) -> None:
        lane.rounds += 1
        lane.began_ns = now_ns
        items = [
            Item(bus=name, command=Command(servo_id, keyword), is_query=True, tries=1)
            for reading in lane.readings
            for servo_id in [reading.target.servo_id]
            if lane.benched.get(servo_id, 0) <= now_ns
            for keyword in _keywords(reading, lane.rounds)
        ]
        lane.dialogue = Dialogue(items, {name: lane.line}, {name: lane.questioner})

    def _end_round(self, lane: _Lane, now_ns: int) -> None:
        if not lane.rounds:
            return
        answers = lane.dialogue.answers
        for reading in lane.readings:
            servo_id = reading.target.servo_id
            if lane.benched.get(servo_id, 0) > lane.began_ns:
                continue
            said = {
                key: value for (_, asked_id, key), value in answers.items() if asked_id == servo_id
            }
            for keyword, value in said.items():
                reading.take(keyword, value)
            lane.benched.pop(servo_id, None)
            reading.misses = 0 if said else reading.misses + 1
            if reading.is_silent:
                lane.benched[servo_id] = now_ns + BENCHED_NS
            if said:
                reading.at_ns = now_ns
                self._fresh.append(reading)


def _keywords(reading: ServoState, round_: int) -> tuple[str, ...]:
    """Return what to ask a servo in a round: one thing only, until it has answered."""
    target = reading.target
    if target.family is Family.IO2:
        return ("QA",) if target.device is Device.ANALOG else ("QD",)
    if reading.misses or not reading.at_ns:
        return ("QD",)
    known = FAMILY_TABLES[target.family].by_keyword
    slow = [word for word in SLOW if word in known]
    return (*QUICK, slow[round_ % len(slow)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """Beyond these a servo is told of. The defaults and their sources are in `look`."""

    temperature_max_c: float = HOT_C
    current_max_a: float = CURRENT_MAX_A
    supply_min_v: float = SUPPLY_MIN_V
    supply_max_v: float = SUPPLY_MAX_V

    def alarms(self, reading: ServoState) -> list[tuple[str, str]]:
        """Return kind and text of everything that is wrong with a servo now."""
        name = reading.target.name
        found = []
        if reading.is_silent:
            return [("silent", f"{name} does not answer")]
        if reading.status in BAD_STATUS and reading.status is not None:
            found.append(("status", f"{name}: {reading.status.value}"))
        if reading.temperature_c is not None and reading.temperature_c >= self.temperature_max_c:
            found.append(
                (
                    "temperature",
                    f"{name}: {reading.temperature_c:.0f} °C, from {self.temperature_max_c:g} on "
                    f"it is too hot",
                )
            )
        if reading.current_a is not None and reading.current_a > self.current_max_a:
            found.append(
                ("current", f"{name}: {reading.current_a:.2f} A, more than {self.current_max_a:g}")
            )
        if reading.voltage_v is not None and not (
            self.supply_min_v <= reading.voltage_v <= self.supply_max_v
        ):
            found.append(
                (
                    "voltage",
                    f"{name}: {reading.voltage_v:.1f} V, not {self.supply_min_v:g} to "
                    f"{self.supply_max_v:g}",
                )
            )
        return found


class Alarms:
    """Remembers what is wrong, so that each thing is told once until it is over."""

    def __init__(self, thresholds: Thresholds) -> None:
        self._thresholds = thresholds
        self.active: dict[tuple[str, str], str] = {}
        """Servo and kind → text, newest words."""

    def update(self, readings: Iterable[ServoState]) -> list[str]:
        """Return the texts of what has begun to be wrong since the last call."""
        now = {
            (reading.target.name, kind): text
            for reading in readings
            for kind, text in self._thresholds.alarms(reading)
        }
        fresh = [text for key, text in now.items() if key not in self.active]
        self.active = now
        return fresh
