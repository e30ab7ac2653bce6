"""What comes after what in a show, and what becomes of it when something goes wrong.

Connect (who is there?), ready (may it go?), prepare (session settings), approach (to where the
show starts), show, and whatever happens, restore the settings and send the safe state as the last
bytes. From approach and show it may go to recover, and from there again through prepare and
approach to where the show stands.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final, Literal

from lss_motion.errors import LssMotionError
from lss_motion.player import setup
from lss_motion.player.events import Checked, Event, Phase, PhaseEntered, Warned
from lss_motion.player.settling import Settling, untaken_error
from lss_motion.player.troubles import Troubles, Verdict
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.player.dialogue import Dialogue
    from lss_motion.player.session import Session
    from lss_motion.player.settings import Answers
    from lss_motion.player.streamer import Streamer
    from lss_motion.protocol.line import Reply

    Outcome = Literal["finished", "stopped", "fault"]

IDLE_NS: Final = 20 * NS_PER_MS
"""While nothing is due, as in a pause without feedback, somebody may still ask for something."""
APPROACHES_MAX: Final = 3
"""Chosen: a move that was lost on the line is said again; a joint that cannot get there is not
pushed for ever."""
COUNT_IN_NS: Final = 200 * NS_PER_MS
"""From when all is in its place to the show's first instant: making a show ready takes time (13 ms
of processor time for 18 joints, measured), and nothing may be due meanwhile."""
DRIVING: Final = (Phase.APPROACH, Phase.SHOW)


class Phases:
    """The state machine of one show. At any time it has a dialogue, or a streamer, or waits."""

    def __init__(self, session: Session, *, must_ask: bool, is_open: bool) -> None:
        self.phase = Phase.CONNECT
        self.outcome: Outcome | None = None
        self.error: LssMotionError | None = None
        self.show: Streamer | None = None
        self.show_ended_ns: int | None = None
        self.rate = 1.0
        """What a person wants; the troubles may allow less."""
        self.events: deque[Event] = deque([PhaseEntered(Phase.CONNECT)])
        self.is_open = is_open
        """Whether the show is to wait at its end for more."""
        self.troubles = Troubles(session)
        self.has_moved = False
        self._session = session
        self._must_ask = must_ask
        self._streamer: Streamer | None = None
        questions = setup.questions(session.joints, session.agenda.lit)
        questions += setup.sensor_questions(session.program, session.robot)
        self._dialogue: Dialogue | Settling | None = session.ask(questions)
        self._approaches = 0
        self._now_ns = 0
        self.has_set = False

    def advance(self, now_ns: int) -> None:
        """Do all that is due."""
        self._now_ns = now_ns
        while self._step(now_ns):
            pass

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        if self._dialogue is not None:
            self._dialogue.receive(bus, reply, now_ns)
        elif self._streamer is not None:
            self._streamer.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        """Return when `advance` must be called at the latest; None when it is over."""
        if self.phase is Phase.DONE:
            return None
        wakeups_ns: list[int | None] = []
        if self.phase in DRIVING and self._dialogue is None:
            wakeups_ns.append(self.troubles.ladder.next_wakeup_ns())
        if self.phase is Phase.RECOVER and self.troubles.recovery is not None:
            wakeups_ns.append(self.troubles.recovery.give_up_ns)
        if self._dialogue is not None:
            wakeups_ns.append(self._dialogue.next_wakeup_ns())
        elif self._streamer is not None:
            wakeups_ns.append(self._streamer.next_wakeup_ns(self._now_ns))
        if self.phase is Phase.SHOW:
            lines = self._session.lines
            wakeups_ns.append(self._session.agenda.wakeup_ns(self.show, lines, self._now_ns))
        wakeup_ns = min((w for w in wakeups_ns if w is not None), default=None)
        return self._now_ns + IDLE_NS if wakeup_ns is None else max(wakeup_ns, self._now_ns)

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes for each bus if it ends here; none if all were only ever asked."""
        if not self.has_set:
            return {}
        is_limp = self._session.robot.end == "limp" and self.outcome == "finished"
        return self._session.safe_bytes(is_limp=is_limp)

    # ---- from one phase to the next

    def _step(self, now_ns: int) -> bool:
        """Do what is due in the present phase; return whether the phase changed."""
        if self.phase in (Phase.DONE, Phase.READY):
            return False
        if self.phase is Phase.RECOVER and self.troubles.is_over(now_ns):
            answers = {} if self._dialogue is None else self._dialogue.answers
            self.error = self.troubles.give_up(answers, now_ns)
            self.end("fault", now_ns)
        elif self._dialogue is not None:
            self._dialogue.advance(now_ns)
            if not self._dialogue.is_finished:
                return False
            self._after_dialogue(now_ns)
        else:
            if self._streamer is not None:
                if self.phase is Phase.SHOW:
                    lines = self._session.lines
                    self.events += self._session.agenda.advance(self._streamer, lines, now_ns)
                self._streamer.advance(now_ns)
                self.events += self._streamer.waiting.take_notices()
            if self.phase in DRIVING and self._has_fallen(now_ns):
                return True
            if not self._is_over(now_ns):
                return False
            self._after_streamer(now_ns)
        return True

    def _has_fallen(self, now_ns: int) -> bool:
        """Do what is due about what is wrong; return whether the phase changed."""
        assert self._streamer is not None
        verdict = self.troubles.judge(self._streamer, now_ns)
        self._tell_troubles()
        match verdict:
            case Verdict.END:
                self.end("fault", now_ns)
            case Verdict.RECOVER:
                self.recover(now_ns)
            case Verdict.GO_ON:
                self.apply_rate(now_ns)
        return verdict is not Verdict.GO_ON

    def _is_over(self, now_ns: int) -> bool:
        """Return whether the streamer has done what it had to do in this phase."""
        if self.phase in (Phase.STOP, Phase.RECOVER):
            is_standing = self._streamer is None or self._streamer.is_standing(now_ns)
            return is_standing and not (self.phase is Phase.RECOVER and self.troubles.lost)
        assert self._streamer is not None
        return self._streamer.is_finished(now_ns)

    def _after_streamer(self, now_ns: int) -> None:
        if self.phase is Phase.RECOVER:
            self._streamer = None
            self._dialogue = self._session.ask(self.troubles.questions())
        elif self.phase is not Phase.APPROACH:
            self.outcome = self.outcome or "finished"
            self._restore()
        elif self._session.has_feedback:
            self._streamer = None
            self._dialogue = self._session.arrival()
        else:
            self._begin(now_ns)

    def _after_dialogue(self, now_ns: int) -> None:
        dialogue, self._dialogue = self._dialogue, None
        assert dialogue is not None
        match self.phase:
            case Phase.CONNECT:
                self._session.had = dialogue.answers
                self._connected()
            case Phase.PREPARE:
                assert isinstance(dialogue, Settling)
                self._prepared(dialogue, now_ns)
            case Phase.RECOVER:
                self.troubles.found(dialogue.answers)
                self.prepare()
            case Phase.APPROACH:
                self._arrived(dialogue.answers, now_ns)
            case _:
                self.finish(now_ns)
        self._tell_troubles()

    def _connected(self) -> None:
        session = self._session
        try:
            robot, questioners = session.robot, session.questioners
            setup.check_sensors(session.program, robot, session.had)
            self.events += map(
                Warned, setup.findings(session.joints, session.had, robot, questioners)
            )
        except LssMotionError as error:
            self._fail(error)
            return
        found = setup.found(session.joints, session.had, robot, session.start_deg())
        self.events.append(Checked(tuple(found)))
        if self._must_ask:
            self._enter(Phase.READY)
        else:
            self.prepare()

    def prepare(self) -> None:
        self.has_set = True
        self._approaches = 0
        self._enter(Phase.PREPARE)
        self._dialogue = self._session.settle()

    def _prepared(self, settling: Settling, now_ns: int) -> None:
        silent = self._session.note_places(settling.answers)
        if not settling.wrong and not silent:
            self._approach(now_ns)
        elif not self.troubles.is_over(now_ns):
            self.troubles.miss_again(silent, settling.wrong)
            self._enter(Phase.RECOVER)
        elif settling.wrong:
            joints = self._session.joints
            self._fail(untaken_error(settling.wrong[0], settling.answers, joints))
        else:
            self._fail(setup.silent_error(silent, self._session.joints, self._session.robot))

    def _approach(self, now_ns: int) -> None:
        self._approaches += 1
        self.has_moved = True
        if self.phase is not Phase.APPROACH:
            self._enter(Phase.APPROACH)
        place_deg = self._session.place_deg(self.show, now_ns)
        self._streamer = self._session.approach(place_deg, now_ns)

    def _arrived(self, answers: Answers, now_ns: int) -> None:
        """Go on with the show if every joint is where it begins; else go there again."""
        session = self._session
        silent = session.note_places(answers)
        silent += [joint for joint in session.untold(answers) if joint not in silent]
        match self.troubles.arrive(session.restarted(answers), silent, now_ns):
            case Verdict.END:
                self.end("fault", now_ns)
                return
            case Verdict.RECOVER:
                self.recover(now_ns)
                return
            case Verdict.GO_ON:
                pass
        learns = self.show is None and session.has_feedback
        if learns:
            session.learn_loads(now_ns)
        joint, off_deg = session.furthest(session.place_deg(self.show, now_ns))
        is_uncorrected = learns and self._approaches == 1
        if off_deg <= (setup.PULLED_DEG if is_uncorrected else setup.ARRIVED_DEG):
            self._begin(now_ns)
        elif self._approaches < APPROACHES_MAX:
            self._approach(now_ns)
        elif off_deg <= session.robot.joints[joint].following_deg:
            self._begin(now_ns)
        else:
            self.troubles.strayed(joint, off_deg, self._approaches)
            self.end("fault", now_ns)

    def _begin(self, now_ns: int) -> None:
        """Begin the show, or go on with it."""
        self._enter(Phase.SHOW)
        self.troubles.forget()
        if self.show is None:
            self.show = self._session.begin(now_ns + COUNT_IN_NS)
            self.show.is_open = self.is_open
        else:
            self._session.resume(self.show, now_ns)
        self._streamer = self.show
        self.apply_rate(now_ns)

    def apply_rate(self, now_ns: int) -> None:
        """Let the show clock go as fast as the person wants and the troubles allow."""
        if self._streamer is None or self.phase not in DRIVING:
            return
        rate = self.troubles.ladder.rate_max
        if self.phase is Phase.SHOW:
            rate = min(rate, self.rate)
        if rate != self._streamer.rate_wanted:
            self._streamer.set_rate(rate, now_ns)

    def recover(self, now_ns: int) -> None:
        """Brake, and wait for those who are gone.

        They hear no move before they have their settings again, not even to brake: their last
        move ends by itself.
        """
        self._dialogue = None
        if self._streamer is not None:
            self._streamer.leave_out(self._session.left_out | self.troubles.missing)
            self._streamer.set_rate(0.0, now_ns)
        self._enter(Phase.RECOVER)

    # ---- the end

    def _fail(self, error: LssMotionError) -> None:
        self.error = error
        self.outcome = "fault"
        self._restore()

    def end(self, outcome: Outcome, now_ns: int) -> None:
        """Brake if anything moves, then restore and end."""
        self.outcome = self.outcome or outcome
        if self._streamer is not None and self.phase in (*DRIVING, Phase.RECOVER):
            self._streamer.set_rate(0.0, now_ns)
            self._enter(Phase.STOP)
        elif self.phase is not Phase.STOP:
            self._restore()

    def _restore(self) -> None:
        """Give back the settings, if they were changed: what was refused is left as it was."""
        self.end_show(self._now_ns)
        self._streamer = None
        self._enter(Phase.RESTORE)
        session = self._session
        orders = session.restoring_orders() if self.has_set else []
        self._dialogue = session.ask(orders)

    def finish(self, now_ns: int) -> None:
        self.end_show(now_ns)
        self._dialogue = self._streamer = None
        for name, data in self.safe_bytes().items():
            self._session.lines[name].send(data, now_ns)
        self._enter(Phase.DONE)

    def end_show(self, now_ns: int) -> None:
        """Note that the show, if there was one, is over; the first time counts."""
        if self.show is not None and self.show_ended_ns is None:
            self.show_ended_ns = now_ns

    # ---- what is said

    def _enter(self, phase: Phase) -> None:
        self._tell_troubles()
        self.phase = phase
        self.events.append(PhaseEntered(phase))

    def _tell_troubles(self) -> None:
        self.events += self.troubles.events
        self.troubles.events.clear()
