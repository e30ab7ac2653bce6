"""Marks, cues and waits for sensors: events of a show at their time, besides motion.

`Agenda` reports marks that are passed and cues that are due, and sends LED orders between moves.
`Waiting` stops the show clock at a wait, polls its sensor, and lets the show go on. `SensorWatch`
polls sensors all the time, for a caller that acts on their values.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import dropwhile
from typing import TYPE_CHECKING, Final, Literal, Protocol

from lss_motion.playing.player.events import CueReached, MarkPassed, Waited
from lss_motion.protocol.framing import Command, encode
from lss_motion.protocol.io2 import IO2_TABLE
from lss_motion.units import NS_PER_MS, NS_PER_US, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import WaitPoint
    from lss_motion.playing.player.events import Event, WaitState
    from lss_motion.playing.player.query_tracker import SerialLine
    from lss_motion.playing.player.show_clock import ShowClock
    from lss_motion.robot.model import Joint, Robot, Sensor
    from lss_motion.show.model import Wait


LED_KEYWORD = "LED"
"""What a cue may change at a servo."""


class Streaming(Protocol):
    """What `Agenda` needs of a show: its clock, and the time that its moves leave on the lines."""

    clock: ShowClock

    def quiet_ns(self, now_ns: int) -> int | None:
        """Return until when no move is due; None: no move is planned."""
        ...


class Agenda:
    """Marks and cues of one program, in every pass. Sends LED orders between moves."""

    def __init__(self, program: Program, robot: Robot) -> None:
        self._program = program
        self._robot = robot
        self._marks = program.unrolled_marks()
        self._cues = program.unrolled_cues()
        self._mark = next(self._marks, None)
        self._cue = next(self._cues, None)
        self._note_next()
        self._lights: deque[tuple[str, Command]] = deque()

    def begin_at(self, show_s: float | None) -> None:
        """Go on from `show_s`, also back in time, without what is before; None: the beginning."""
        if show_s is None:
            return
        self._lights.clear()
        self.go_back(show_s)

    def go_back(self, show_s: float) -> None:
        """Report again what is at `show_s` or later; LED orders that are to be sent are kept."""
        self._marks = self._program.unrolled_marks(show_s)
        self._cues = self._program.unrolled_cues(show_s)
        self._mark, self._cue = next(self._marks, None), next(self._cues, None)
        while self._mark is not None and self._mark[0] < show_s:
            self._mark = next(self._marks, None)
        while self._cue is not None and self._cue[0] < show_s:
            self._cue = next(self._cues, None)
        self._note_next()

    def go_on(self, program: Program, show_s: float) -> None:
        """Go on with marks and cues of an edited program; what is not reported yet, will be."""
        self._program = program
        self.go_back(min(show_s, self._next_s))

    def _note_next(self) -> None:
        self._next_s = min((due[0] for due in (self._mark, self._cue) if due), default=math.inf)
        """Show time of the next mark or cue."""

    def advance(self, show: Streaming, lines: Mapping[str, SerialLine], now_ns: int) -> list[Event]:
        """Return the marks and cues reached; send the LED orders that fit between moves."""
        if self._next_s == math.inf and not self._lights:
            return []
        show_s = show.clock.show_s(now_ns)
        events: list[Event] = []
        while self._mark is not None and self._mark[0] <= show_s:
            events.append(MarkPassed(self._mark[1].label, self._mark[0]))
            self._mark = next(self._marks, None)
        while self._cue is not None and self._cue[0] <= show_s:
            start_s, cue = self._cue
            events.append(CueReached(cue, start_s + cue.lead_s))
            for name, colour in cue.led:
                self.light(self._robot.joints[name], colour)
            self._cue = next(self._cues, None)
        if self._next_s <= show_s:
            self._note_next()
        if self._lights:
            self._light(show.quiet_ns(now_ns), lines, now_ns)
        return events

    def light(self, joint: Joint, colour: int) -> None:
        """Set the LED of a servo as soon as its line has room."""
        self._lights.append((joint.bus, Command(joint.servo_id, LED_KEYWORD, colour)))

    def wakeup_ns(
        self, show: Streaming | None, lines: Mapping[str, SerialLine], now_ns: int
    ) -> int | None:
        """Return when `advance` must be called at the latest, if the rate stays as it is.

        While the rate changes, and while only moves leave no room, the show wakes often enough.
        """
        wakeup_ns = None
        if self._lights and lines[self._lights[0][0]].free_ns > now_ns:
            wakeup_ns = lines[self._lights[0][0]].free_ns
        if self._next_s < math.inf and show is not None and now_ns >= show.clock.ramp_end_ns:
            due_ns = show.clock.instant_ns(self._next_s)
            if due_ns is not None:
                if due_ns < now_ns + NS_PER_US:  # What was rounded down is not passed yet.
                    due_ns = now_ns + NS_PER_US
                wakeup_ns = due_ns if wakeup_ns is None else min(wakeup_ns, due_ns)
        return wakeup_ns

    def _light(self, quiet_ns: int | None, lines: Mapping[str, SerialLine], now_ns: int) -> None:
        while self._lights:
            bus, order = self._lights[0]
            data = encode(order)
            is_free = lines[bus].free_ns <= now_ns
            if not is_free or (quiet_ns and lines[bus].arrival_ns(len(data), now_ns) > quiet_ns):
                return
            lines[bus].send(data, now_ns)
            self._lights.popleft()


POLL_PERIOD_NS: Final = 40 * NS_PER_MS
"""Period of the queries to a sensor. The Sharp sensors measure every 40 ms or so."""
WATCH_PERIOD_NS: Final = 100 * NS_PER_MS
"""Period of the queries to a sensor that is watched all evening. Chosen: two readings in a row are
taken within a fifth of a second, faster than a visitor expects, at a tenth of a percent of a line.
"""
READINGS_MAX: Final = 1000
"""Readings that are kept for a caller that does not take them."""
TIMES_MET: Final = 2
"""So many answers in a row must meet the condition: the line does not protect an answer from a
flipped bit."""

SUFFIXES: Final = {
    kind.name: number for number, kind in (IO2_TABLE.row("QA").suffixes or {}).items()
}
"""Suffix of `QA` with which the board answers in mm of that sensor."""


class SensorWatch:
    """Sensors that are read all the time, also between shows; a caller takes the readings."""

    def __init__(self, sensors: Iterable[Sensor]) -> None:
        self.sensors = {(sensor.bus, sensor.servo_id): sensor for sensor in sensors}
        """By bus and servo id."""
        self._polled_ns: dict[tuple[str, int], int] = {}
        self._readings: deque[tuple[str, int]] = deque(maxlen=READINGS_MAX)

    def query(self, bus: str, now_ns: int) -> Command | None:
        """Return the query that is overdue for longest on `bus`; None: none is due."""
        due = [
            (self._polled_ns.get(place, -WATCH_PERIOD_NS) + WATCH_PERIOD_NS, place)
            for place in self.sensors
            if place[0] == bus
        ]
        due_ns, place = min(due, default=(now_ns + 1, ("", 0)))
        if due_ns > now_ns:
            return None
        return Command(place[1], "QA", SUFFIXES.get(self.sensors[place].kind))

    def note_query_sent(self, bus: str, servo_id: int, now_ns: int) -> None:
        self._polled_ns[bus, servo_id] = now_ns

    def take_reply(self, bus: str, servo_id: int, value: int | str | None) -> None:
        """Keep an answer to `QA`; answers of other inputs are ignored."""
        sensor = self.sensors.get((bus, servo_id))
        if sensor is not None and isinstance(value, int):
            self._readings.append((sensor.name, value))

    def take_readings(self) -> list[tuple[str, int]]:
        """Return the sensors that have answered since the last call, with their values."""
        found = list(self._readings)
        self._readings.clear()
        return found

    def wakeups_ns(self) -> list[int]:
        """Return when queries are due."""
        return [polled_ns + WATCH_PERIOD_NS for polled_ns in self._polled_ns.values()]


class Waiting:
    """The waits of one show, one after the other. Times are those of the show clock."""

    def __init__(
        self,
        points: Iterable[tuple[float, WaitPoint]],
        sensors: Mapping[str, Sensor],
        from_s: float,
    ) -> None:
        """Take the waits with their show times; those before `from_s` are skipped."""
        self._sensors = sensors
        self._polled_ns: int | None = None
        self._met = 0
        self._notices: list[Waited] = []
        self.rate_after = 1.0
        """Rate at which the show goes on after the present wait."""
        self.begin_at(points, from_s)

    def begin_at(self, points: Iterable[tuple[float, WaitPoint]], from_s: float) -> None:
        """Go on from `from_s` with these waits, also back in time; a present wait is over."""
        self._points = dropwhile(lambda due: due[0] < from_s, points)
        self._next: tuple[float, Wait] | None = None
        self._since_ns: int | None = None
        self.next_s = math.inf
        """Show time of the next wait; `math.inf`: there is none."""
        self.back_s = 0.0
        """How far the show goes back for the idle motion of this wait; 0: it stands instead."""
        self._go_on()

    @property
    def is_waiting(self) -> bool:
        return self._since_ns is not None

    @property
    def is_standing(self) -> bool:
        """Whether the show waits without idle motion."""
        return self._since_ns is not None and self.back_s == 0.0

    @property
    def text(self) -> str:
        """Condition of the present or next wait, for people."""
        assert self._next is not None
        wait = self._next[1]
        unit = self._sensors[wait.sensor].unit
        return f"{wait.sensor} {wait.side} {wait.threshold:g}{' mm' if unit == 'mm' else ''}"

    def advance(self, clock: ShowClock, now_ns: int) -> WaitState | Literal["again"] | None:
        """Stop the show clock at a wait, and let it go on when the wait is over.

        With idle motion the clock does not stop; it goes back where the idle motion ends.
        """
        state: WaitState | None
        back_s = self.back_s
        if self.is_waiting:
            text, state = self.text, self._ended(now_ns)
            if state is None and back_s and clock.show_s(now_ns) >= self.next_s:
                clock.go_back(back_s, now_ns)
                return "again"
            if state is not None and not back_s:
                clock.ramp_to(self.rate_after, now_ns, 0.0)
        elif self._next is not None and clock.show_s(now_ns) >= self.next_s - back_s:
            text, state = self.text, "begun"
            self.rate_after = clock.target_rate
            if not back_s:
                clock.stand_at(self.next_s, now_ns)
            self._since_ns, self._polled_ns, self._met = now_ns, None, 0
        else:
            return None
        if state is not None:
            self._notices.append(Waited(text, state))
        return state

    def take_notices(self) -> list[Waited]:
        """Return what happened since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def query(self, bus: str, now_ns: int) -> Command | None:
        """Return the query that is due on `bus`, if there is one."""
        if self._since_ns is None or self._next is None:
            return None
        sensor = self._sensors[self._next[1].sensor]
        if sensor.bus != bus:
            return None
        if self._polled_ns is not None and now_ns < self._polled_ns + POLL_PERIOD_NS:
            return None
        return Command(sensor.servo_id, "QA", SUFFIXES.get(sensor.kind))

    def note_query_sent(self, now_ns: int) -> None:
        self._polled_ns = now_ns

    def take_reply(self, bus: str, servo_id: int, value: int | str | None) -> None:
        """Use an answer to `QA`; answers of other inputs are ignored."""
        if self._since_ns is None or self._next is None or not isinstance(value, int):
            return
        sensor = self._sensors[self._next[1].sensor]
        if (sensor.bus, sensor.servo_id) == (bus, servo_id):
            self._met = self._met + 1 if self._next[1].is_met(value) else 0

    def wakeups_ns(self) -> list[int]:
        """Return when a query is due, or the wait times out."""
        if self._since_ns is None:
            return []
        asks_ns = [] if self._polled_ns is None else [self._polled_ns + POLL_PERIOD_NS]
        end_ns = self._end_ns()
        return asks_ns if end_ns is None else [*asks_ns, end_ns]

    def _ended(self, now_ns: int) -> WaitState | None:
        """Return whether and why the wait is over; then prepare the next one."""
        outcome: WaitState | None = "met" if self._met >= TIMES_MET else None
        end_ns = self._end_ns()
        if outcome is None and end_ns is not None and now_ns >= end_ns:
            outcome = "timeout"
        if outcome is not None:
            self._go_on()
        return outcome

    def _go_on(self) -> None:
        self._since_ns = None
        due = next(self._points, None)
        self._next = None if due is None else (due[0], due[1].wait)
        self.next_s = math.inf if due is None else due[0]
        self.back_s = 0.0 if due is None else due[1].back_s

    def _end_ns(self) -> int | None:
        assert self._next is not None
        if self._since_ns is None or self._next[1].timeout_s is None:
            return None
        return self._since_ns + ns_from_s(self._next[1].timeout_s)
