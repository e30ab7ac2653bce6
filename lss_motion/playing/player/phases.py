"""The phases of a run, one after the other: what is done in each, and what follows.

In every phase the machine has one activity: a dialogue (`handshake`), a streamer, or it waits.
`session` holds what the phases share, `repertoire` what is played, `added_show` what is played
beside it, `faults` decides about faults. `TRANSITIONS` has every change of the phase.
"""

from __future__ import annotations

from collections import deque
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

from lss_motion.errors import LssMotionError
from lss_motion.playing.player.added_show import READINGS_NS, STILL_NS, AddedShows
from lss_motion.playing.player.events import Phase, PhaseEntered, Warned
from lss_motion.playing.player.faults import FaultHandler, Verdict
from lss_motion.playing.player.handshake import Preparation, SettingsDialogue
from lss_motion.playing.player.preflight import Preflight
from lss_motion.playing.player.query_tracker import AWAY_NS
from lss_motion.playing.player.repertoire import PresentShow, Start
from lss_motion.playing.player.session import COUNT_IN_NS, Arrival
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.playing.player.events import Event, ShowOutcome
    from lss_motion.playing.player.handshake import Answers, Dialogue
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.playing.player.session import Session
    from lss_motion.playing.player.streamer import Streamer

    Outcome = Literal["finished", "stopped", "fault"]


TRANSITIONS: Final[Mapping[Phase, Mapping[Phase, str]]] = MappingProxyType(
    {
        Phase.CONNECT: {
            Phase.READY: "every servo may do what the show requires; a person starts it",
            Phase.PREPARE: "the same, and nobody is asked",
            Phase.RESTORE: "a servo is missing or unfit; a stop",
            Phase.DONE: "an abort",
        },
        Phase.READY: {
            Phase.PREPARE: "a person starts it",
            Phase.RESTORE: "a stop",
            Phase.DONE: "an abort",
        },
        Phase.PREPARE: {
            Phase.PREPARE: "every servo is the same as before a person was waited for",
            Phase.APPROACH: "every servo has its settings and says where it stands",
            Phase.RECOVER: "a servo was away or has restarted while others were set; a lost port",
            Phase.RESTORE: "a servo does not take its settings, or is in another turn; a stop",
            Phase.DONE: "an abort",
        },
        Phase.APPROACH: {
            Phase.SHOW: "every joint is where the show begins, or goes on",
            Phase.STANDING: "the same after a recovery without a show; all joints are to hold",
            Phase.SEEK: "another place or show is wanted while joints move",
            Phase.RECOVER: "a fault that resumes",
            Phase.STOP: "a fault that ends; a stop",
            Phase.RESTORE: "the same while no joint moves",
            Phase.DONE: "an abort",
        },
        Phase.SHOW: {
            Phase.SEEK: "another place or show is wanted while joints move",
            Phase.APPROACH: "the same while all joints rest",
            Phase.STANDING: "of many shows, this one is over; all joints are to hold",
            Phase.RECOVER: "a fault that resumes",
            Phase.STOP: "a fault that ends; a stop",
            Phase.RESTORE: "the only show is over",
            Phase.DONE: "an abort",
        },
        Phase.STANDING: {
            Phase.APPROACH: "a show is wanted",
            Phase.SEEK: "the same while joints move",
            Phase.STANDING: "all joints are to hold, as they do",
            Phase.RECOVER: "a fault that resumes",
            Phase.STOP: "a fault that ends; a stop",
            Phase.DONE: "an abort",
        },
        Phase.SEEK: {
            Phase.APPROACH: "all joints rest",
            Phase.STANDING: "all joints rest, and are to hold",
            Phase.RECOVER: "a fault that resumes",
            Phase.STOP: "a fault that ends; a stop",
            Phase.RESTORE: "the same before it has begun to brake",
            Phase.DONE: "an abort",
        },
        Phase.RECOVER: {
            Phase.PREPARE: "what was missing is back",
            Phase.RECOVER: "another port is lost; a servo that is back does not say what it is",
            Phase.STOP: "what is missing did not come back in time; a stop",
            Phase.RESTORE: "the same while no joint moves; another servo came back",
            Phase.DONE: "an abort",
        },
        Phase.STOP: {
            Phase.RESTORE: "all joints rest",
            Phase.DONE: "an abort",
        },
        Phase.RESTORE: {
            Phase.DONE: "every servo has its own settings again; an abort",
        },
        Phase.DONE: {
            Phase.DONE: "an abort: the last bytes are sent once more",
        },
    }
)
"""Every change of the phase, and when it comes: by phase, the phases that may follow."""
PLAYING: Final = (Phase.SHOW, Phase.STANDING)
DRIVING: Final = (*PLAYING, Phase.APPROACH, Phase.SEEK)
ENDING: Final = (Phase.RECOVER, Phase.STOP, Phase.RESTORE, Phase.DONE)
"""Nothing else can begin."""


class PhaseMachine:
    """The phases of one run. Its owner calls `step`, and passes on what a person wants."""

    def __init__(
        self,
        repertoire: Repertoire,
        session: Session,
        present: PresentShow,
        *,
        must_ask: bool,
    ) -> None:
        """Begin with what is present."""
        self.phase = Phase.CONNECT
        self.outcome: Outcome | None = None
        self.error: LssMotionError | None = None
        """Why the show could not begin or go on, where no joint is the cause."""
        self.events: deque[Event] = deque([PhaseEntered(Phase.CONNECT)])
        self.session = session
        self.faults = FaultHandler(session)
        self.present = present
        self.added = AddedShows(repertoire, session, present)
        self.dialogue: Dialogue | SettingsDialogue | Preflight | None
        self.dialogue = session.preflight(present.program)
        self.streamer: Streamer | None = None
        self.rate = 1.0
        """The rate that a person set; a fault may reduce it further."""
        self.now_ns = 0
        """The instant of the present step."""
        self.seek_s: float | None = None
        """Show time from which the show goes on once the robot stands."""
        self.show_ended_ns: int | None = None
        """When the show, if there was one, was over."""
        self.has_moved = False
        self.has_set = False
        """Whether orders may have changed settings of the servos."""
        self._repertoire = repertoire
        self._must_ask = must_ask
        self._approaches = 0
        self._preparation = Preparation()
        self._ready_ns = 0
        """When a person was asked to start."""
        self._asked_ns = 0
        """When the servos were asked last where they stand, before or after an approach."""
        self._arrived_ns: int | None = None
        """When the approach had come to its end while added shows go on."""

    @property
    def show(self) -> Streamer | None:
        """The show itself, once it has begun."""
        return self.present.streamer

    def wakeups_ns(self, others_ns: Iterable[int]) -> list[int | None]:
        """Return when `step` must be called again, apart from what comes in, and `others_ns`."""
        wakeups_ns: list[int | None] = [*others_ns]
        phase, present = self.phase, self.present
        if self.dialogue is not None:
            wakeups_ns.append(self.dialogue.next_wakeup_ns())
        elif self.streamer is not None:
            wakeups_ns.append(self.streamer.next_wakeup_ns(self.now_ns))
        is_judged = self.session.has_feedback and self.dialogue is None
        if phase in DRIVING and is_judged:
            wakeups_ns += self.faults.escalation.wakeups_ns()
        if phase in PLAYING:
            lines = self.session.lines
            agenda_ns = present.agenda.wakeup_ns(present.streamer, lines, self.now_ns)
            wakeups_ns += (agenda_ns, present.goal_ns)
        elif phase is Phase.RECOVER and self.faults.recovery is not None:
            wakeups_ns.append(self.faults.recovery.give_up_ns)
        if self.added.shows:
            wakeups_ns += [one.next_wakeup_ns(self.now_ns) for one in self.added.apart]
        return wakeups_ns

    # ---- one step, in any phase

    def step(self, now_ns: int) -> bool:
        """Do what is due in the present phase; return whether more may be due at once."""
        if self.phase in (Phase.DONE, Phase.READY):
            return False
        if self.phase is Phase.RECOVER and self.faults.is_over(now_ns):
            answers = {} if self.dialogue is None else self.dialogue.answers
            self.error = self.faults.give_up(answers, now_ns)
            self.end("fault", now_ns)
            return True
        if self.dialogue is not None:
            self.dialogue.advance(now_ns)
            self.report_faults()
            if not self.dialogue.is_finished:
                return False
            self._after_dialogue(now_ns)
            return True
        self._advance_streamer(now_ns)
        if self.phase in DRIVING and self.streamer is not None and self._judge_faults(now_ns):
            return True
        if not self._has_streamed(now_ns):
            return False
        self._after_streamer(now_ns)
        return True

    def _advance_streamer(self, now_ns: int) -> None:
        if self.added.shows:
            self._advance_added(now_ns)
        if self.streamer is None:
            return
        if self.phase in PLAYING:
            self.events += self.present.agenda.advance(self.streamer, self.session.lines, now_ns)
        self.streamer.advance(now_ns)
        if self.streamer.has_waited:
            self.events += self.present.note_wait(self.streamer)

    def _advance_added(self, now_ns: int) -> None:
        for one in [*self.added.apart]:
            self.events += one.advance(now_ns)
            if one.astray is not None:
                self.faults.note_astray(*one.astray)
                self.end("fault", now_ns)
        self.added.take_back(self.streamer, now_ns)

    def _judge_faults(self, now_ns: int) -> bool:
        """Act on the faults that the streamer has found; return whether the phase changed."""
        assert self.streamer is not None
        verdict = self.faults.judge(self.streamer, now_ns)
        self.report_faults()
        match verdict:
            case Verdict.END:
                self.end("fault", now_ns)
            case Verdict.RECOVER:
                self.recover(now_ns)
            case Verdict.CONTINUE:
                self.apply_rate(now_ns)
        return verdict is not Verdict.CONTINUE

    def _has_streamed(self, now_ns: int) -> bool:
        """Return whether the streamers have finished their part of this phase."""
        if self.phase in (Phase.STOP, Phase.RECOVER, Phase.SEEK):
            is_standing = self.streamer is None or self.streamer.is_standing(now_ns)
            if not is_standing or (self.phase is Phase.RECOVER and self.faults.lost_ports):
                self._arrived_ns = None
                return False
            if self.phase is Phase.SEEK:
                return not any(one.is_leaving for one in self.added.apart)
            return all(one.streamer.is_standing(now_ns) for one in self.added.apart)
        assert self.streamer is not None
        if not self.streamer.is_finished(now_ns):
            # A fault at the end may have set the joints in motion again.
            self.present.goal_ns = self._arrived_ns = None
            return False
        if self.phase is Phase.APPROACH:
            return self._has_read(self.streamer, now_ns)
        return self.phase is not Phase.SHOW or self._has_reached_goal(self.streamer, now_ns)

    def _has_read(self, approach: Streamer, now_ns: int) -> bool:
        """Return whether it is known where the joints stand after an approach.

        While added shows move others, no dialogue can ask for it: the readings do.
        """
        if not (self.added.apart and self.session.has_feedback):
            return True
        if self._arrived_ns is None:
            self._arrived_ns = now_ns
        is_read = self.session.note_readings(approach, s_from_ns(self._arrived_ns - STILL_NS))
        return is_read or now_ns >= self._arrived_ns + READINGS_NS

    def _has_reached_goal(self, show: Streamer, now_ns: int) -> bool:
        """Return whether no joint has time left to come within its goal tolerance.

        The show has not finished if one is beyond it after its time.
        """
        misses = self.faults.goal_misses(show)
        present, joints = self.present, self.session.robot.joints
        if present.ended_ns is None:
            present.ended_ns = now_ns
        ends_ns = [present.ended_ns + ns_from_s(joints[name].goal_time_s) for name in misses]
        present.goal_ns = min((end_ns for end_ns in ends_ns if end_ns > now_ns), default=None)
        if present.goal_ns is not None:
            return False
        for name, off_deg in misses.items():
            if self.faults.note_goal(name, off_deg) is Verdict.END:
                self.outcome = self.outcome or "fault"
        self.report_faults()
        return True

    def _after_streamer(self, now_ns: int) -> None:
        if self.phase is Phase.RECOVER:
            self.events += self.added.come_together(self.streamer, now_ns)
            self.streamer = None
            self.dialogue = self.faults.recovery_dialogue(now_ns)
        elif self.phase is Phase.SEEK:
            self.go_on(now_ns)
        elif self.phase is not Phase.APPROACH:
            self._after_show(now_ns)
        elif not self.session.has_feedback:
            self._begin(now_ns)
        elif self.added.apart:
            self._arrived_ns = None
            self._judge_arrival(now_ns)
        else:
            self.streamer = None
            self._examine(now_ns)

    def _after_show(self, now_ns: int) -> None:
        """End the run: its only show is over, or the robot has stopped; else hold all joints."""
        if self.phase is not Phase.SHOW or self._repertoire.only is not None:
            self.outcome = self.outcome or "finished"
            self._restore()
            return
        self.present.next = Start(None, None)
        self._change("fault" if self.outcome == "fault" else "finished", now_ns)
        self.outcome = None
        self._stand(now_ns)

    def _after_dialogue(self, now_ns: int) -> None:
        dialogue, self.dialogue = self.dialogue, None
        assert dialogue is not None
        match self.phase:
            case Phase.CONNECT if isinstance(dialogue, Preflight):
                self._connected(dialogue)
            case Phase.RECOVER | Phase.PREPARE if isinstance(dialogue, Preflight):
                self._proved(dialogue, now_ns)
            case Phase.PREPARE if isinstance(dialogue, SettingsDialogue):
                self._prepared(dialogue, now_ns)
            case Phase.RECOVER:
                self.dialogue = self.faults.proof(dialogue.answers, now_ns)
            case Phase.PREPARE | Phase.APPROACH:
                self._examined(dialogue.answers, now_ns)
            case _:
                self.finish(now_ns)
        self.report_faults()

    # ---- from one phase to the next

    def _enter(self, phase: Phase) -> None:
        self.report_faults()
        self.phase = phase
        self.events.append(PhaseEntered(phase))

    def report_faults(self) -> None:
        self.events += self.faults.take_events()
        if self.now_ns >= self.session.unasked.look_ns:
            self.events += map(Warned, self.session.unasked.advance(self.now_ns))

    def _connected(self, preflight: Preflight) -> None:
        try:
            self.events += self.session.note_original(
                preflight, self.present.program, self.present.start_deg()
            )
        except LssMotionError as error:
            self._fail(error)
            return
        self.present.hold_at(self.session.standing_deg)
        self.session.note_proved(self.session.joints, self.now_ns)
        if self._must_ask:
            self._ready_ns = self.now_ns
            self._enter(Phase.READY)
        else:
            self.prepare()

    def _proved(self, preflight: Preflight, now_ns: int) -> None:
        """Go on with servos that were away if they are the same as before; wait for the others."""
        if (error := self.faults.prove(preflight, now_ns)) is not None:
            self._fail(error)
            return
        if preflight.unproved:
            self._enter(Phase.RECOVER)
            return
        self.session.note_proved(preflight.joints, now_ns)
        if self.phase is Phase.PREPARE and self.has_set:
            self._examine(now_ns)
        else:
            self.prepare()

    def go(self) -> None:
        """Begin to move, as a person wants it.

        Nothing was asked of the servos while the person was waited for. If that took long enough to
        exchange one, they are compared with what they were.
        """
        if self.now_ns - self._ready_ns < AWAY_NS:
            self.prepare()
            return
        self._enter(Phase.PREPARE)
        self.dialogue = self.session.proof(self.session.driven, {})

    def prepare(self) -> None:
        self.has_set, self._approaches = True, 0
        self._preparation = Preparation(self.now_ns, self.session.timeouts)
        self._enter(Phase.PREPARE)
        self.dialogue = self.session.settings_dialogue(self.now_ns)

    def _prepared(self, settings: SettingsDialogue, now_ns: int) -> None:
        if self._has_lost_turns(settings.answers, now_ns):
            return
        silent = self.session.note_positions(settings.answers)
        if settings.wrong or silent:
            if error := self.faults.wait_again(silent, settings.wrong, settings.answers, now_ns):
                self._fail(error)
            else:
                self._enter(Phase.RECOVER)
        elif self._preparation.has_missed(self.session.timeouts, now_ns):
            self.dialogue = self.session.proof(self.session.driven, settings.answers)
        elif away := self.session.unproved():  # While others were waited for.
            self.dialogue = self.session.proof(away, settings.answers)
        elif self._preparation.is_doubtful(self.session.timeouts, now_ns):
            self._examine(now_ns)
        else:
            self._approach(now_ns)

    def _examine(self, now_ns: int) -> None:
        """Ask the servos, which rest, where they stand, and whether they have their settings."""
        self.dialogue, self._asked_ns = self.session.arrival_dialogue(now_ns), now_ns

    def _has_lost_turns(self, answers: Answers, now_ns: int) -> bool:
        """End the run if a joint is in another turn than it was: no move takes it back."""
        verdict = self.faults.lose_turns(self.session.turned(answers, now_ns), now_ns)
        if verdict is Verdict.END:
            self.streamer = None
            self.end("fault", now_ns)
        return verdict is Verdict.END

    def leave(self, now_ns: int) -> None:
        """Brake, to go on elsewhere once the robot stands."""
        if self.streamer is not None and self.phase in (Phase.APPROACH, *PLAYING):
            self.streamer.set_rate(0.0, now_ns)
            self._enter(Phase.SEEK)
        elif self.phase is Phase.APPROACH:
            self.dialogue = None
            self._enter(Phase.SEEK)

    def go_on(self, now_ns: int) -> None:
        """Go on elsewhere: the robot stands."""
        self.session.note_standing(now_ns)
        if self.present.next is not None and self.present.next.program is None:
            self._change("left", now_ns)
            self._stand(now_ns)
        else:
            self._approaches = 0
            self._approach(now_ns)

    def _change(self, outcome: ShowOutcome, now_ns: int) -> None:
        """Let the next program take the place of the present one, where all joints stand."""
        self.events += self.present.change(outcome, self.streamer or self.show, now_ns)
        self.faults.escalation.change_show(self.present.program.on_fault)

    def _stand(self, now_ns: int) -> None:
        """Hold all joints where they are until the next show."""
        self._enter(Phase.STANDING)
        self.streamer = self.present.begin(now_ns)
        self.apply_rate(now_ns)
        self.begin_added(now_ns)

    def _approach(self, now_ns: int) -> None:
        if self.present.next is not None:
            self._change("left", now_ns)
        self._approaches += 1
        self.has_moved = True
        if self.seek_s is not None:
            self.present.seek(self.seek_s, now_ns)
            self.seek_s = None
        if self.phase is not Phase.APPROACH:
            self._enter(Phase.APPROACH)
        pose_deg = self.present.pose_deg(now_ns)
        self.streamer = self.session.approach(self.added.places(pose_deg, now_ns), now_ns)
        self.present.held_deg |= pose_deg

    def pose_deg(self, now_ns: int) -> dict[str, float]:
        """Return the angles of the driven joints from which the show begins, or goes on."""
        return self.added.places(self.present.pose_deg(now_ns), now_ns)

    def _examined(self, answers: Answers, now_ns: int) -> None:
        """Go on if every servo has its settings: with the approach, or with what follows it."""
        if self._has_lost_turns(answers, now_ns):
            return
        silent = self.session.note_positions(answers)
        restarted, unknown = self.session.restarted(answers, self._asked_ns)
        for joint in unknown:
            if joint not in (*silent, *restarted):
                silent.append(joint)
        match self.faults.arrive(restarted, silent, now_ns):
            case Verdict.END:
                self.end("fault", now_ns)
            case Verdict.RECOVER:
                self.recover(now_ns)
            case Verdict.CONTINUE if self.phase is Phase.PREPARE:
                self._approach(now_ns)
            case Verdict.CONTINUE:
                self._judge_arrival(now_ns)

    def _judge_arrival(self, now_ns: int) -> None:
        """Go on with the show if every joint is near enough to its place; else approach again."""
        session, count = self.session, self._approaches
        match session.judge_arrival(self.pose_deg(now_ns), count, now_ns):
            case Arrival.THERE, _, _:
                self._begin(now_ns)
            case Arrival.AGAIN, _, _:
                self._approach(now_ns)
            case Arrival.ASTRAY, joint, off_deg:
                self.faults.note_astray(joint, off_deg, count)
                self.end("fault", now_ns)

    def _begin(self, now_ns: int) -> None:
        """Begin the show, or go on with it."""
        present = self.present
        self.events += present.begun(now_ns)
        self._enter(present.phase)
        self.faults.clear()
        if present.streamer is None:
            self.streamer = present.begin(now_ns + COUNT_IN_NS)
            if present.is_held and present.phase is Phase.SHOW:
                present.is_held = False  # The next show of a run with many is another one.
                self.streamer.hold_before_start(now_ns)
        else:
            self.session.resume(present.streamer, now_ns)
            self.streamer = present.streamer
        self.apply_rate(now_ns)
        if self.added.is_together:
            self.events += self.added.go_on(self.streamer, now_ns)
            self.apply_rate(now_ns)
        self.begin_added(now_ns)

    def begin_added(self, now_ns: int) -> None:
        """Begin the programs that were to be added, if that can be now."""
        if self.phase in PLAYING:
            self.events += self.added.begin_waiting(self.streamer, now_ns)

    def apply_rate(self, now_ns: int) -> None:
        """Set the show clock to the rate of the person, as far as the faults allow it."""
        rate_max = self.faults.escalation.rate_max
        if self.streamer is not None and self.phase in (Phase.APPROACH, *PLAYING):
            rate = min(rate_max, self.rate if self.phase is Phase.SHOW else 1.0)
            self.streamer.set_rate(rate, now_ns)
        if self.added.shows and self.phase in DRIVING:
            for one in self.added.apart:
                one.set_rate(self.rate, rate_max, now_ns)

    def recover(self, now_ns: int) -> None:
        """Brake, and wait for the servos that are gone.

        They are sent no move before they have their settings again, not even to brake: their last
        move ends by itself.
        """
        self.dialogue = None
        if self.streamer is not None:
            self.streamer.leave_out(self.session.left_out | self.faults.missing)
            self.streamer.set_rate(0.0, now_ns)
        self._enter(Phase.RECOVER)
        self.added.hold(now_ns)

    # ---- the end

    def _fail(self, error: LssMotionError) -> None:
        self.error, self.outcome = error, "fault"
        self._restore()

    def end(self, outcome: Outcome, now_ns: int) -> None:
        """Brake if anything moves, then restore and end."""
        self.outcome = self.outcome or outcome
        if self.streamer is not None and self.phase in (*DRIVING, Phase.RECOVER):
            self.streamer.set_rate(0.0, now_ns)
            self._enter(Phase.STOP)
        elif self.phase is not Phase.STOP:
            self._restore()
        self.added.hold(now_ns)

    def _restore(self) -> None:
        """Give back the settings, if the show changed them."""
        self.end_show(self.now_ns)
        self.streamer = None
        self._enter(Phase.RESTORE)
        session = self.session
        self.dialogue = session.restoring_dialogue() if self.has_set else session.dialogue([])

    def finish(self, now_ns: int) -> None:
        self.end_show(now_ns)
        self.dialogue = self.streamer = None
        for name, data in self.safe_bytes().items():
            self.session.lines[name].send(data, now_ns)
        self._enter(Phase.DONE)

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes for each bus if the run ends now; none if it only sent queries."""
        if not self.has_set:
            return {}
        is_limp = self.session.robot.end == "limp" and self.outcome == "finished"
        return self.session.safe_bytes(is_limp=is_limp)

    def end_show(self, now_ns: int) -> None:
        """Note that the show, if there was one, is over; the first call counts."""
        if self.show is not None and self.show_ended_ns is None:
            self.show_ended_ns = now_ns
        outcome: ShowOutcome = "fault" if self.outcome == "fault" else "stopped"
        self.events += self.present.over(outcome, now_ns)
        self.events += self.added.end_all(outcome, now_ns)
