"""One show from the first question to the last byte, without port, thread or clock.

data_to_send(now_ns)            what must be written now, per bus
receive_data(bus, data, now_ns) what came from a bus
next_wakeup_ns()                when to call again at the latest
next_event()                    what happened, oldest first; None when there is no more
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from lss_motion.errors import LostPortError, LssMotionError
from lss_motion.player.events import Event, Phase, Warned
from lss_motion.player.gaps import Gaps
from lss_motion.player.phases import DRIVING, Phases
from lss_motion.player.session import Session
from lss_motion.player.troubles import Verdict
from lss_motion.program.predict import driven

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.player.events import Faulted
    from lss_motion.player.phases import Outcome
    from lss_motion.player.streamer import Streamer
    from lss_motion.program.growth import Extension
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Robot

RATE_LEAST: Final = 0.01
"""A minute of show in more than an hour is a pause."""


class Player:
    """Plays one program on one robot."""

    def __init__(
        self,
        program: Program,
        robot: Robot,
        *,
        has_feedback: bool = True,
        start_s: float | None = None,
        must_ask: bool = False,
        is_open: bool = False,
    ) -> None:
        """Play `program`; while `is_open` it does not end there, but waits to be extended.

        With `must_ask`, nothing moves before `go`.
        """
        self.program = program
        self.robot = robot = driven(robot, program)
        self._session = Session(program, robot, has_feedback=has_feedback, start_s=start_s)
        self.lines = self._session.lines
        self.questioners = self._session.questioners
        self._phases = Phases(self._session, must_ask=must_ask, is_open=is_open)
        self._may_grow = is_open
        self._gaps = Gaps()
        self._stops = 0

    # ---- the four calls

    def data_to_send(self, now_ns: int) -> Mapping[str, bytes]:
        """Return what must be written now, per bus; buses with nothing to write are left out."""
        self._note_gap(now_ns)
        self._phases.advance(now_ns)
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        """Take in bytes of a bus. No byte of any kind raises."""
        for reply in self.lines[bus].receive(data):
            self._phases.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        """Return when `data_to_send` must be called at the latest; None when it is over."""
        wakeup_ns = self._phases.next_wakeup_ns()
        self._gaps.expect(wakeup_ns)
        return wakeup_ns

    def next_event(self) -> Event | None:
        return self._phases.events.popleft() if self._phases.events else None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes for each bus if it ends here; none if all were only ever asked."""
        return self._phases.safe_bytes()

    def _note_gap(self, now_ns: int) -> None:
        text = self._gaps.text(now_ns, None if self.show is None else self.show.show_s)
        if text is not None and self.phase in DRIVING:
            self._phases.events.append(Warned(text))

    # ---- what there is to know

    @property
    def phase(self) -> Phase:
        return self._phases.phase

    @property
    def is_finished(self) -> bool:
        return self.phase is Phase.DONE

    @property
    def is_paused(self) -> bool:
        """Whether a person wants the show to stand still for a while."""
        return self._phases.rate == 0.0

    @property
    def outcome(self) -> Outcome | None:
        return self._phases.outcome

    @property
    def error(self) -> LssMotionError | None:
        """Why the show could not begin or go on, where it is not a joint's fault."""
        return self._phases.error

    @property
    def show(self) -> Streamer | None:
        """The show itself, once it has begun."""
        return self._phases.show

    def is_due_within(self, span_ns: int, now_ns: int) -> bool:
        """Return whether the show has a move to send that soon."""
        due_ns = None if self.show is None else self.show.quiet_ns(now_ns)
        return due_ns is not None and due_ns < now_ns + span_ns

    @property
    def show_ended_ns(self) -> int | None:
        return self._phases.show_ended_ns

    @property
    def faults(self) -> list[Faulted]:
        """What went wrong, each with the highest step that was taken about it."""
        return self._phases.troubles.ladder.faults

    # ---- what a person may ask for

    def go(self) -> None:
        """Let it move, if it waits for that in `Phase.READY`."""
        if self.phase is Phase.READY:
            self._phases.prepare()

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Ramp the speed of the show to `rate`: up to 1; below `RATE_LEAST` it is a pause.

        Outside of the show it is kept for when the show goes on.
        """
        self._phases.rate = 0.0 if rate < RATE_LEAST else min(rate, 1.0)
        self._phases.apply_rate(now_ns)

    def extend(self, extension: Extension, now_ns: int) -> bool:
        """Go on with `extension` from its splice on; False if it comes too late, or nothing plays.

        `program` keeps the moves that it had at the start.
        """
        show = self.show if self.phase is Phase.SHOW else None
        if show is None or not show.extend(extension, now_ns):
            return False
        end_s, use = extension.duration_s, extension.line_use
        self.program = replace(self.program, duration_s=end_s, line_use=use)
        return True

    def close(self) -> None:
        """Take no more extensions: the show ends where its program does."""
        self._phases.is_open = False
        if self.show is not None:
            self.show.is_open = False

    def stop(self, now_ns: int) -> None:
        """Brake within the limits and hold; then restore and end. Asked twice: `abort`.

        A program that is still open is played to its end instead: it ends at rest. A show that
        has just ended by itself goes on restoring when it is asked once.
        """
        self._stops += 1
        if self.phase is Phase.SHOW and self._may_grow:
            self._phases.outcome = self.outcome or "stopped"
            self.close()
            if self._stops > 1:
                self.abort(now_ns)
        elif self.phase in (Phase.STOP, Phase.RESTORE):
            if self._stops > 1:
                self.abort(now_ns)
        elif self.phase is not Phase.DONE:
            self._phases.end("stopped", now_ns)

    def abort(self, now_ns: int) -> None:
        """End at once: the safe state is all that is still sent; settings are not given back."""
        self._phases.outcome = self.outcome or "stopped"
        if self._phases.has_set and (text := self._session.unrestored_text()):
            self._phases.events.append(Warned(text))
        self._phases.finish(now_ns)

    def end_show(self, now_ns: int) -> None:
        """Note that the show, if there was one, is over; the first time counts."""
        self._phases.end_show(now_ns)

    # ---- what the owner of the ports has to say

    def waits_for_port(self, bus: str) -> bool:
        """Return whether a port that is lost now is to be opened again, if it comes back."""
        is_under_way = self._phases.has_moved and self.phase not in (Phase.RESTORE, Phase.DONE)
        return is_under_way and self._phases.troubles.is_resumable(bus)

    def port_lost(self, bus: str, reason: str, now_ns: int) -> None:
        """Brake on the other buses, and wait for this one, as `on_fault` says."""
        verdict = self._phases.troubles.lose(bus, reason, now_ns)
        if verdict is Verdict.END:
            self._phases.error = LostPortError(reason, url=self.robot.buses[bus].port)
            self._phases.end("fault", now_ns)
        elif self.phase is not Phase.STOP:
            self._phases.recover(now_ns)

    def port_found(self, bus: str) -> None:
        """Go on with a port that was lost."""
        self._phases.troubles.lost.pop(bus, None)
