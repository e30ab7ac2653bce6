"""One show from the first question to the last byte, without port, thread or clock.

    data_to_send(now_ns)            what must be written now, per bus
    receive_data(bus, data, now_ns) what came from a bus
    next_wakeup_ns()                when to call again at the latest
    next_event()                    what happened, oldest first; None when there is no more

Phases: connect (who is there?), prepare (session settings), approach (to where the show starts),
show, and whatever happens, restore the settings and send the safe state as the last bytes.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Literal

from lss_motion.errors import LssMotionError
from lss_motion.player import setup
from lss_motion.player.agenda import Agenda
from lss_motion.player.approach import approach
from lss_motion.player.dialogue import Dialogue
from lss_motion.player.events import Event, Faulted, Phase, PhaseEntered, Warned
from lss_motion.player.line import Line
from lss_motion.player.queries import Questioner
from lss_motion.player.streamer import Streamer
from lss_motion.program.predict import driven, profiles
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.player.dialogue import Item
    from lss_motion.player.setup import Answers
    from lss_motion.program.growth import Extension
    from lss_motion.program.model import Program
    from lss_motion.protocol.line import Reply
    from lss_motion.robot.model import Robot

    Outcome = Literal["finished", "stopped", "fault"]

RATE_LEAST: Final = 0.01
"""A minute of show in more than an hour is a pause."""
IDLE_NS: Final = 20 * NS_PER_MS
"""While nothing is due, as in a pause without feedback, somebody may still ask for something."""


class Player:
    """Plays one program on one robot. `error` is set when the show could not begin."""

    def __init__(
        self,
        program: Program,
        robot: Robot,
        *,
        has_feedback: bool = True,
        start_s: float | None = None,
        is_open: bool = False,
    ) -> None:
        """Play `program`; while `is_open` it does not end there, but waits to be extended."""
        self.program = program
        self.robot = robot = driven(robot, program)
        self.phase = Phase.CONNECT
        self.outcome: Outcome | None = None
        self.error: LssMotionError | None = None
        self.show: Streamer | None = None
        self.show_ended_ns: int | None = None
        self.faults: list[Faulted] = []
        self.lines = {name: Line(robot.buses[name]) for name in robot.buses}
        self.questioners = {name: Questioner(line) for name, line in self.lines.items()}
        self._has_feedback = has_feedback
        self._start_s = start_s
        self._joints = [robot.joints[name] for name in program.start_deg]
        self._answers: Answers = {}
        self._events: deque[Event] = deque([PhaseEntered(Phase.CONNECT)])
        self._streamer: Streamer | None = None
        self._dialogue: Dialogue | None = self._ask(setup.questions(self._joints))
        self._agenda = Agenda(program, robot)
        self._now_ns = 0
        self._has_set = False
        self._has_moved = False
        self._stops = 0
        self._is_open = self._may_grow = is_open

    # ---- the four calls

    def data_to_send(self, now_ns: int) -> Mapping[str, bytes]:
        """Return what must be written now, per bus; buses with nothing to write are left out."""
        self._now_ns = now_ns
        while self._step(now_ns):
            pass
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        """Take in bytes of a bus. No byte of any kind raises."""
        for reply in self.lines[bus].receive(data):
            self._receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        """Return when `data_to_send` must be called at the latest; None when it is over."""
        if self.phase is Phase.DONE:
            return None
        if self._dialogue is not None:
            wakeup_ns = self._dialogue.next_wakeup_ns()
        else:
            assert self._streamer is not None
            wakeup_ns = self._streamer.next_wakeup_ns(self._now_ns)
            due_ns = self._agenda.wakeup_ns(self.show, self.lines, self._now_ns)
            wakeup_ns = min((w for w in (wakeup_ns, due_ns) if w is not None), default=None)
        return self._now_ns + IDLE_NS if wakeup_ns is None else max(wakeup_ns, self._now_ns)

    def next_event(self) -> Event | None:
        return self._events.popleft() if self._events else None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes for each bus if it ends here; none if nothing was ever moved."""
        if not self._has_moved:
            return {}
        is_limp = self.robot.end == "limp" and self.outcome == "finished"
        return setup.safe_bytes(self.robot, is_limp=is_limp)

    # ---- what a person may ask for

    @property
    def is_finished(self) -> bool:
        return self.phase is Phase.DONE

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Ramp the speed of the show to `rate`: up to 1; below `RATE_LEAST` it is a pause.

        Ignored outside of the show.
        """
        if self.phase is Phase.SHOW and self._streamer is not None:
            self._streamer.set_rate(0.0 if rate < RATE_LEAST else min(rate, 1.0), now_ns)

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
        self._is_open = False
        if self.show is not None:
            self.show.is_open = False

    def stop(self, now_ns: int) -> None:
        """Brake within the limits and hold; then restore and end. Asked twice: `abort`.

        A program that is still open is played to its end instead: it ends at rest. A show that
        has just ended by itself goes on restoring when it is asked once.
        """
        self._stops += 1
        if self.phase is Phase.SHOW and self._may_grow:
            self.outcome = self.outcome or "stopped"
            self.close()
            if self._stops > 1:
                self.abort(now_ns)
        elif self.phase in (Phase.STOP, Phase.RESTORE):
            if self._stops > 1:
                self.abort(now_ns)
        elif self.phase in (Phase.APPROACH, Phase.SHOW):
            self.outcome = self.outcome or "stopped"
            self._brake(now_ns)
        elif self.phase is not Phase.DONE:
            self.outcome = self.outcome or "stopped"
            self._restore()

    def abort(self, now_ns: int) -> None:
        """End at once: the safe state is all that is still sent, if anything ever moved."""
        self.outcome = self.outcome or "stopped"
        self._finish(now_ns)

    def end_show(self, now_ns: int) -> None:
        """Note that the show, if there was one, is over; the first time counts."""
        if self.show is not None and self.show_ended_ns is None:
            self.show_ended_ns = now_ns

    # ---- phases

    def _step(self, now_ns: int) -> bool:
        """Do what is due in the present phase; return whether the phase changed."""
        if self._dialogue is not None:
            self._dialogue.advance(now_ns)
            if not self._dialogue.is_finished:
                return False
            return self._after_dialogue(now_ns)
        if self.phase is Phase.DONE:
            return False
        assert self._streamer is not None
        if self.phase is Phase.SHOW:
            self._events += self._agenda.advance(self._streamer, self.lines, now_ns)
        self._streamer.advance(now_ns)
        if self._take_faults(now_ns):
            return True
        if self.phase is Phase.STOP:
            if self._streamer.is_standing(now_ns):
                self._restore()
                return True
        elif self._streamer.is_finished(now_ns):
            self._after_streamer(now_ns)
            return True
        return False

    def _after_dialogue(self, now_ns: int) -> bool:
        assert self._dialogue is not None
        self._answers = {**self._answers, **self._dialogue.answers}
        match self.phase:
            case Phase.CONNECT:
                self._connected()
            case Phase.PREPARE:
                self._approach(now_ns)
            case _:
                self._finish(now_ns)
        return True

    def _connected(self) -> None:
        try:
            found = setup.findings(self._joints, self._answers, self.robot, self.questioners)
            self._events += map(Warned, found)
        except LssMotionError as error:
            self.error = error
            self.outcome = "fault"
            self._restore()
            return
        self._has_set = True
        self._enter(Phase.PREPARE)
        orders = setup.session_orders(self._joints, self._answers)
        lit = self._agenda.lit
        self._dialogue = self._ask([*setup.settings_questions(self._joints, lit), *orders])

    def _approach(self, now_ns: int) -> None:
        start = self._plan_start()
        standing = {
            joint.name: angle
            for joint in self._joints
            if (angle := setup.stored(joint, self._answers, "QD")) is not None
        }
        self._dialogue = None
        self._has_moved = True
        self._enter(Phase.APPROACH)
        program = approach(self.robot, standing, start)
        self._streamer = self._stream(program, standing, now_ns, None)

    def _plan_start(self) -> dict[str, float]:
        """Return the joint angles at which the show begins, also in its middle."""
        if self._start_s is None:
            return dict(self.program.start_deg)
        start_s = self.program.within(self._start_s)
        return {
            name: self.robot.joints[name].joint_deg(plan.at(start_s)[0])
            for name, plan in profiles(self.program, self.robot).items()
        }

    def _after_streamer(self, now_ns: int) -> None:
        if self.phase is Phase.APPROACH:
            self._enter(Phase.SHOW)
            self._agenda.begin_at(self._start_s)
            standing = {
                name: self.robot.joints[name].servo_deg(angle)
                for name, angle in self._plan_start().items()
            }
            self._streamer = self._stream(self.program, standing, now_ns, self._start_s)
            self.show = self._streamer
            self.show.is_open = self._is_open
            return
        self.outcome = self.outcome or "finished"
        self._restore()

    def _stream(
        self,
        program: Program,
        standing_deg: Mapping[str, float],
        now_ns: int,
        start_s: float | None,
    ) -> Streamer:
        return Streamer(
            program,
            self.robot,
            lines=self.lines,
            questioners=self.questioners,
            standing_deg=standing_deg,
            has_feedback=self._has_feedback,
            start_ns=now_ns,
            start_s=start_s,
        )

    def _brake(self, now_ns: int) -> None:
        assert self._streamer is not None
        self._streamer.set_rate(0.0, now_ns)
        self._enter(Phase.STOP)

    def _restore(self) -> None:
        """Give back the settings, if they were changed: what was refused is left as it was."""
        self.end_show(self._now_ns)
        self._streamer = None
        if self._dialogue is not None:
            self._answers = {**self._answers, **self._dialogue.answers}
        self._enter(Phase.RESTORE)
        lit = self._agenda.lit
        orders = setup.restoring_orders(self._joints, self._answers, lit) if self._has_set else []
        self._dialogue = self._ask(orders)

    def _finish(self, now_ns: int) -> None:
        self.end_show(now_ns)
        self._dialogue = self._streamer = None
        for name, data in self.safe_bytes().items():
            self.lines[name].send(data, now_ns)
        self._enter(Phase.DONE)

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._events.append(PhaseEntered(phase))

    def _ask(self, items: list[Item]) -> Dialogue:
        return Dialogue(items, self.lines, self.questioners)

    # ---- what comes in

    def _receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        if self._dialogue is not None:
            self._dialogue.receive(bus, reply, now_ns)
        elif self._streamer is not None:
            self._streamer.receive(bus, reply, now_ns)

    def _take_faults(self, now_ns: int) -> bool:
        reader = self._streamer.reader if self._streamer is not None else None
        if reader is None or not reader.faults:
            return False
        while reader.faults:
            fault = reader.faults.popleft()
            if all(fault.joint != known.joint for known in self.faults):
                self.faults.append(fault)
                self._events.append(fault)
        if self.phase is Phase.STOP:
            return False
        self.outcome = "fault"
        self._brake(now_ns)
        return True
