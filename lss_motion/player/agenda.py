"""What comes at its time in a show and is not motion: marks that are passed, cues that are due."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from lss_motion.player.events import CueReached, MarkPassed
from lss_motion.protocol.line import Command, encode
from lss_motion.units import NS_PER_US

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.player.events import Event
    from lss_motion.player.line import Line
    from lss_motion.player.streamer import Streamer
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Robot

LIT_KEYWORD = "LED"
"""What a cue may change at a servo."""


class Agenda:
    """Marks and cues of one program, in every pass. Lights the LEDs of servos between moves."""

    def __init__(self, program: Program, robot: Robot) -> None:
        self._robot = robot
        self._marks = program.unrolled_marks()
        self._cues = program.unrolled_cues()
        self._mark = next(self._marks, None)
        self._cue = next(self._cues, None)
        self._lights: deque[tuple[str, Command]] = deque()
        self.lit = {name for cue in program.cues for name, _ in cue.led}
        """Joints whose LEDs this show changes."""

    def begin_at(self, show_s: float | None) -> None:
        """Pass over what a show that starts at `show_s` leaves out; None is its beginning."""
        if show_s is None:
            return
        while self._mark is not None and self._mark[0] < show_s:
            self._mark = next(self._marks, None)
        while self._cue is not None and self._cue[0] < show_s:
            self._cue = next(self._cues, None)

    def advance(self, streamer: Streamer, lines: Mapping[str, Line], now_ns: int) -> list[Event]:
        """Return what the show has come to, and hand over the LED orders that fit between moves."""
        show_s = streamer.show_s(now_ns)
        events: list[Event] = []
        while self._mark is not None and self._mark[0] <= show_s:
            events.append(MarkPassed(self._mark[1].label, self._mark[0]))
            self._mark = next(self._marks, None)
        while self._cue is not None and self._cue[0] <= show_s:
            start_s, cue = self._cue
            events.append(CueReached(cue, start_s + cue.lead_s))
            for name, colour in cue.led:
                joint = self._robot.joints[name]
                order = Command(joint.servo_id, LIT_KEYWORD, colour)
                self._lights.append((joint.bus, order))
            self._cue = next(self._cues, None)
        if self._lights:
            self._light(streamer.quiet_ns(now_ns), lines, now_ns)
        return events

    def wakeup_ns(
        self, streamer: Streamer | None, lines: Mapping[str, Line], now_ns: int
    ) -> int | None:
        """Return when `advance` has something to do at the latest, if the rate stays as it is.

        While it changes, and when only moves leave no room, the streamer is awake often enough.
        """
        wakeups_ns = []
        if self._lights and lines[self._lights[0][0]].free_ns > now_ns:
            wakeups_ns.append(lines[self._lights[0][0]].free_ns)
        nexts = [due[0] for due in (self._mark, self._cue) if due is not None]
        if nexts and streamer is not None and not streamer.clock.is_ramping(now_ns):
            due_ns = streamer.clock.instant_ns(min(nexts))
            if due_ns is not None:
                # What was rounded down is not passed yet.
                wakeups_ns.append(max(due_ns, now_ns + NS_PER_US))
        return min(wakeups_ns, default=None)

    def _light(self, quiet_ns: int | None, lines: Mapping[str, Line], now_ns: int) -> None:
        while self._lights:
            bus, order = self._lights[0]
            data = encode(order)
            is_free = lines[bus].free_ns <= now_ns
            if not is_free or (quiet_ns and lines[bus].heard_ns(len(data), now_ns) > quiet_ns):
                return
            lines[bus].send(data, now_ns)
            self._lights.popleft()
