"""Waits for a sensor: when the show stands still, what is asked meanwhile, when it goes on."""

from __future__ import annotations

import math
from itertools import dropwhile
from typing import TYPE_CHECKING, Final

from lss_motion.player.events import Waited
from lss_motion.protocol.io2 import IO2_TABLE
from lss_motion.protocol.line import Command
from lss_motion.units import NS_PER_MS, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.events import WaitState
    from lss_motion.player.show_clock import ShowClock
    from lss_motion.robot.model import Sensor
    from lss_motion.sequence.model import Wait
    from lss_motion.trajectory.model import WaitPoint

ASK_NS: Final = 40 * NS_PER_MS
"""A sensor that is waited for is asked so often. The Sharp sensors measure every 40 ms or so."""
TIMES_MET: Final = 2
"""So many answers in a row must say so: no line protects an answer from a flipped bit."""

SUFFIXES: Final = {
    kind.name: number for number, kind in (IO2_TABLE.row("QA").suffixes or {}).items()
}
"""What is added to `QA` so that the board answers in mm of that sensor."""


class Waiting:
    """The waits of one show, one after the other. Times are those of the show clock."""

    def __init__(
        self,
        points: Iterable[tuple[float, WaitPoint]],
        sensors: Mapping[str, Sensor],
        from_s: float,
    ) -> None:
        """Take the waits with their show times; those before `from_s` are left out."""
        self._points = dropwhile(lambda due: due[0] < from_s, points)
        self._sensors = sensors
        self._next: tuple[float, Wait] | None = None
        self._go_on()
        self._since_ns: int | None = None
        self._asked_ns: int | None = None
        self._met = 0
        self._notices: list[Waited] = []
        self.rate_after = 1.0
        """How fast the show goes on after the wait that is under way."""

    @property
    def next_s(self) -> float:
        """When the show has to stand still next; `math.inf`: never."""
        return math.inf if self._next is None else self._next[0]

    @property
    def is_waiting(self) -> bool:
        return self._since_ns is not None

    @property
    def text(self) -> str:
        """What is waited for, for people."""
        assert self._next is not None
        wait = self._next[1]
        unit = self._sensors[wait.sensor].unit
        return f"{wait.sensor} {wait.side} {wait.threshold:g}{' mm' if unit == 'mm' else ''}"

    def advance(self, clock: ShowClock, now_ns: int) -> WaitState | None:
        """Let the show stand still when it has come to a wait, and go on when that is over."""
        state: WaitState | None
        if self.is_waiting:
            text, state = self.text, self._ended(now_ns)
            if state is not None:
                clock.ramp_to(self.rate_after, now_ns, 0.0)
        elif self._next is not None and clock.show_s(now_ns) >= self.next_s:
            text, state = self.text, "begun"
            self.rate_after = clock.target_rate
            clock.stand_at(self.next_s, now_ns)
            self._since_ns, self._asked_ns, self._met = now_ns, None, 0
        else:
            return None
        if state is not None:
            self._notices.append(Waited(text, state))
        return state

    def take_notices(self) -> list[Waited]:
        """Return what happened since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def question(self, bus: str, now_ns: int) -> Command | None:
        """Return what is to be asked now on `bus`, if anything."""
        if self._since_ns is None or self._next is None:
            return None
        sensor = self._sensors[self._next[1].sensor]
        if sensor.bus != bus:
            return None
        if self._asked_ns is not None and now_ns < self._asked_ns + ASK_NS:
            return None
        return Command(sensor.servo_id, "QA", SUFFIXES.get(sensor.kind))

    def asked(self, now_ns: int) -> None:
        self._asked_ns = now_ns

    def answered(self, bus: str, servo_id: int, value: int | str | None) -> None:
        """Take an answer to `QA`; those of other inputs are passed over."""
        if self._since_ns is None or self._next is None or not isinstance(value, int):
            return
        sensor = self._sensors[self._next[1].sensor]
        if (sensor.bus, sensor.servo_id) == (bus, servo_id):
            self._met = self._met + 1 if self._next[1].is_met(value) else 0

    def wakeups_ns(self) -> list[int]:
        """Return when there is something to ask or to end."""
        if self._since_ns is None:
            return []
        asks_ns = [] if self._asked_ns is None else [self._asked_ns + ASK_NS]
        end_ns = self._end_ns()
        return asks_ns if end_ns is None else [*asks_ns, end_ns]

    def _ended(self, now_ns: int) -> WaitState | None:
        """Return whether the show goes on, and why; the next wait is then the one to come."""
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

    def _end_ns(self) -> int | None:
        assert self._next is not None
        if self._since_ns is None or self._next[1].timeout_s is None:
            return None
        return self._since_ns + ns_from_s(self._next[1].timeout_s)
