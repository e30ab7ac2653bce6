"""One show from the first question to the last byte, without port, thread or clock.

data_to_send(now_ns)            what must be written now, per bus
receive_data(bus, data, now_ns) what came from a bus
next_wakeup_ns()                when to call again at the latest
next_event()                    what happened, oldest first; None when there is no more

What comes after what in a show, and what becomes of it when something goes wrong.

Connect (who is there?), ready (may it go?), prepare (session settings), approach (to where the
show starts), show, and whatever happens, restore the settings and send the safe state as the last
bytes. From approach and show it may go to recover, and from there again through prepare and
approach to where the show stands.

What all phases of a show share: lines, what the servos had, who is driven, where they are.

Notices when nobody called the player for a while: the process was stopped, or had no time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Literal

from lss_motion.errors import LostPortError, LssMotionError
from lss_motion.player import handshake
from lss_motion.player.approach import approach
from lss_motion.player.cues import Agenda
from lss_motion.player.events import Checked, Event, Phase, PhaseEntered, Warned
from lss_motion.player.faults import Troubles, Verdict
from lss_motion.player.handshake import (
    SettingsDialogue,
    changing_orders,
    is_answered,
    not_applied,
    not_applied_error,
    read_back,
    restart_probes,
)
from lss_motion.player.query_tracker import QueryTracker
from lss_motion.player.serial_line import SerialLine
from lss_motion.player.streamer import Streamer
from lss_motion.player.transactions import Dialogue
from lss_motion.program.verify import driven, profiles
from lss_motion.units import NS_PER_MS, NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from lss_motion.player.events import Faulted
    from lss_motion.player.handshake import Answers
    from lss_motion.player.joint_state import JointState
    from lss_motion.player.transactions import Item
    from lss_motion.program.model import Program
    from lss_motion.program.splice import Extension
    from lss_motion.protocol.line import Reply
    from lss_motion.robot.model import Joint, Robot

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
        self.active_faults = Troubles(session)
        self.has_moved = False
        self._session = session
        self._must_ask = must_ask
        self._streamer: Streamer | None = None
        questions = handshake.queries(session.joints, session.agenda.led_joints)
        questions += handshake.sensor_queries(session.program, session.robot)
        self._dialogue: Dialogue | SettingsDialogue | None = session.dialogue(questions)
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
            wakeups_ns.append(self.active_faults.escalation.next_wakeup_ns())
        if self.phase is Phase.RECOVER and self.active_faults.recovery is not None:
            wakeups_ns.append(self.active_faults.recovery.give_up_ns)
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
        if self.phase is Phase.RECOVER and self.active_faults.is_over(now_ns):
            answers = {} if self._dialogue is None else self._dialogue.answers
            self.error = self.active_faults.give_up(answers, now_ns)
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
        verdict = self.active_faults.judge(self._streamer, now_ns)
        self._report_faults()
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
            return is_standing and not (self.phase is Phase.RECOVER and self.active_faults.lost)
        assert self._streamer is not None
        return self._streamer.is_finished(now_ns)

    def _after_streamer(self, now_ns: int) -> None:
        if self.phase is Phase.RECOVER:
            self._streamer = None
            self._dialogue = self._session.dialogue(self.active_faults.questions())
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
                assert isinstance(dialogue, SettingsDialogue)
                self._prepared(dialogue, now_ns)
            case Phase.RECOVER:
                self.active_faults.found(dialogue.answers)
                self.prepare()
            case Phase.APPROACH:
                self._arrived(dialogue.answers, now_ns)
            case _:
                self.finish(now_ns)
        self._report_faults()

    def _connected(self) -> None:
        session = self._session
        try:
            robot, trackers = session.robot, session.trackers
            handshake.check_sensors(session.program, robot, session.had)
            self.events += map(
                Warned, handshake.findings(session.joints, session.had, robot, trackers)
            )
        except LssMotionError as error:
            self._fail(error)
            return
        found = handshake.found(session.joints, session.had, robot, session.start_deg())
        self.events.append(Checked(tuple(found)))
        if self._must_ask:
            self._enter(Phase.READY)
        else:
            self.prepare()

    def prepare(self) -> None:
        self.has_set = True
        self._approaches = 0
        self._enter(Phase.PREPARE)
        self._dialogue = self._session.settings_dialogue()

    def _prepared(self, settling: SettingsDialogue, now_ns: int) -> None:
        silent = self._session.note_places(settling.answers)
        if not settling.wrong and not silent:
            self._approach(now_ns)
        elif not self.active_faults.is_over(now_ns):
            self.active_faults.miss_again(silent, settling.wrong)
            self._enter(Phase.RECOVER)
        elif settling.wrong:
            joints = self._session.joints
            self._fail(not_applied_error(settling.wrong[0], settling.answers, joints))
        else:
            self._fail(handshake.silent_error(silent, self._session.joints, self._session.robot))

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
        silent += [joint for joint in session.unreported(answers) if joint not in silent]
        match self.active_faults.arrive(session.restarted(answers), silent, now_ns):
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
        if off_deg <= (handshake.LOADED_DEG if is_uncorrected else handshake.ARRIVED_DEG):
            self._begin(now_ns)
        elif self._approaches < APPROACHES_MAX:
            self._approach(now_ns)
        elif off_deg <= session.robot.joints[joint].following_deg:
            self._begin(now_ns)
        else:
            self.active_faults.strayed(joint, off_deg, self._approaches)
            self.end("fault", now_ns)

    def _begin(self, now_ns: int) -> None:
        """Begin the show, or go on with it."""
        self._enter(Phase.SHOW)
        self.active_faults.forget()
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
        rate = self.active_faults.escalation.rate_max
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
            self._streamer.leave_out(self._session.left_out | self.active_faults.missing)
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
        self._dialogue = session.dialogue(orders)

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
        self._report_faults()
        self.phase = phase
        self.events.append(PhaseEntered(phase))

    def _report_faults(self) -> None:
        self.events += self.active_faults.events
        self.active_faults.events.clear()


UNRESTORED_TEXT: Final = (
    "stopped at once, so the servos were not given back their settings: {} stay as this show "
    "needed them until their power is off, and the next show takes them for the servos' own. "
    "Switch their power off and on, or RESET them; hold the robot, it goes limp"
)


class Session:
    """One robot during one show. It knows no phase."""

    def __init__(
        self, program: Program, robot: Robot, *, has_feedback: bool, start_s: float | None
    ) -> None:
        self.program = program
        self.robot = robot
        self.joints = [robot.joints[name] for name in program.start_deg]
        self.lines = {name: SerialLine(robot.buses[name]) for name in robot.buses}
        self.trackers = {name: QueryTracker(line) for name, line in self.lines.items()}
        self.agenda = Agenda(program, robot)
        self.agenda.begin_at(start_s)
        self.has_feedback = has_feedback
        self.start_s = start_s
        self.had: Answers = {}
        """What every servo answered before anything was changed."""
        self.standing_deg: dict[str, float] = {}
        """Servo angles by joint, as last asked for while nothing moved."""
        self.left_out: set[str] = set()
        """Joints that are sent no move until the end."""
        self.limp: list[Joint] = []
        self._states: dict[str, JointState] = {}
        """Of each joint the last one, for what it learnt."""

    @property
    def driven(self) -> list[Joint]:
        return [joint for joint in self.joints if joint.name not in self.left_out]

    def dialogue(self, items: Iterable[Item]) -> Dialogue:
        return Dialogue(items, self.lines, self.trackers)

    def settings_dialogue(self) -> SettingsDialogue:
        """Return what gives the servos their settings, and asks where they are."""
        orders = handshake.session_orders(self.driven, self.had)
        unconfirmed = handshake.unconfirmed_orders(self.driven, self.had)
        places = handshake.position_queries(self.driven)
        return SettingsDialogue(orders, places, unconfirmed, self.lines, self.trackers)

    def arrival(self) -> Dialogue:
        """Return what asks the servos where they are, and whether one has restarted meanwhile."""
        telling = restart_probes(self.driven, self.had)
        return self.dialogue([*read_back(telling), *handshake.position_queries(self.driven)])

    def restarted(self, answers: Answers) -> list[Joint]:
        """Return the driven servos that no longer have what they were given."""
        return self._with_other_settings(answers, has_reported=True)

    def unreported(self, answers: Answers) -> list[Joint]:
        """Return the driven servos that did not say whether they still have it."""
        return self._with_other_settings(answers, has_reported=False)

    def _with_other_settings(self, answers: Answers, *, has_reported: bool) -> list[Joint]:
        others = {
            (order.bus, order.command.servo_id)
            for order in not_applied(restart_probes(self.driven, self.had), answers)
            if is_answered(order, answers) is has_reported
        }
        return [joint for joint in self.driven if (joint.bus, joint.servo_id) in others]

    def restoring_orders(self) -> list[Item]:
        return handshake.restoring_orders(self.joints, self.had, self.agenda.led_joints)

    def unrestored_text(self) -> str:
        """Return what to say of settings that are not given back; nothing if none was changed."""
        orders = changing_orders(self.joints, self.had)
        words = ", ".join(sorted({order.command.keyword for order in orders}))
        return UNRESTORED_TEXT.format(words) if words else ""

    def note_places(self, answers: Answers) -> list[Joint]:
        """Take in where the driven servos stand; return those who did not say."""
        standing = handshake.standing_deg(self.driven, answers)
        self.standing_deg |= standing
        return [joint for joint in self.driven if joint.name not in standing]

    def learn_loads(self, now_ns: int) -> None:
        """Take in what pulls at every joint that rests where it was sent, or nearly."""
        for joint in self.driven:
            if joint.name in self._states:
                measured_deg = self.standing_deg[joint.name]
                state = self._states[joint.name]
                state.learn_droop(measured_deg, now_ns, handshake.ARRIVED_DEG)

    def start_deg(self) -> dict[str, float]:
        """Return the joint angles at which the show begins, also in its middle."""
        if self.start_s is None:
            return dict(self.program.start_deg)
        start_s = self.program.within(self.start_s)
        return {
            name: self.robot.joints[name].joint_deg(plan.at(start_s)[0])
            for name, plan in profiles(self.program, self.robot).items()
        }

    def place_deg(self, show: Streamer | None, now_ns: int) -> dict[str, float]:
        """Return the joint angles from which the show is to begin, or to go on."""
        place = self.start_deg() if show is None else show.pose_deg(now_ns)
        return {joint.name: place[joint.name] for joint in self.driven}

    def furthest(self, place_deg: Mapping[str, float]) -> tuple[str, float]:
        """Return which driven joint stands furthest from `place_deg`, and by how many degrees."""
        return max(
            (
                (name, abs(self.robot.joints[name].servo_deg(angle) - self.standing_deg[name]))
                for name, angle in place_deg.items()
            ),
            key=lambda far: far[1],
            default=("", 0.0),
        )

    def approach(self, place_deg: Mapping[str, float], now_ns: int) -> Streamer:
        """Return what takes every driven joint from where it stands to `place_deg`."""
        program = approach(self.robot, self.standing_deg, place_deg)
        return self._stream(program, self.standing_deg, now_ns, None)

    def begin(self, start_ns: int) -> Streamer:
        """Return the show, which starts at `start_ns` with every joint at its start.

        Corrected for what pulls at it: servos stand where they were sent.
        """
        standing = {n: self.robot.joints[n].servo_deg(deg) for n, deg in self.start_deg().items()}
        standing |= self._places_deg(start_ns)
        return self._stream(self.program, standing, start_ns, self.start_s)

    def resume(self, show: Streamer, now_ns: int) -> None:
        """Go on with `show` from where the approach sent the servos, and with what it learnt."""
        show.resume(self._places_deg(now_ns), self.left_out)
        self._learn(show)

    def _places_deg(self, now_ns: int) -> dict[str, float]:
        """Return where the last moves sent the servos: servo angles."""
        return {name: state.place(now_ns)[0] for name, state in self._states.items()}

    def _stream(
        self,
        program: Program,
        standing_deg: Mapping[str, float],
        now_ns: int,
        start_s: float | None,
    ) -> Streamer:
        streamer = Streamer(
            program,
            self.robot,
            lines=self.lines,
            trackers=self.trackers,
            standing_deg=standing_deg,
            has_feedback=self.has_feedback,
            start_ns=now_ns,
            start_s=start_s,
        )
        streamer.leave_out(self.left_out)
        self._learn(streamer)
        return streamer

    def _learn(self, streamer: Streamer) -> None:
        for name, state in streamer.joint_states.items():
            if name in self._states:
                state.take_over(self._states[name])
            self._states[name] = state

    def let_go(self, joint: Joint, now_ns: int) -> None:
        """Take the power from one motor, until the end."""
        self.limp.append(joint)
        self.lines[joint.bus].send(handshake.let_go(joint), now_ns)

    def safe_bytes(self, *, is_limp: bool) -> Mapping[str, bytes]:
        return handshake.safe_bytes(self.robot, is_limp=is_limp, limp=self.limp)


GAP_NS: Final = NS_PER_S // 4
"""What is worth a word. Chosen: four times what makes a move count as missed
(`wording.LATEST_ARRIVAL_S`), and longer than any wait on a busy host that was measured."""
NAMED_MAX: Final = 10
"""On a host that is too slow, every move would be told of."""


class StallDetector:
    """Knows when the player wanted to be called, and names each time when that was far later."""

    def __init__(self) -> None:
        self._wakeup_ns: int | None = None
        self._named = 0

    def expect(self, wakeup_ns: int | None) -> None:
        """Note when something will be due at the latest."""
        self._wakeup_ns = wakeup_ns

    def text(self, now_ns: int, show_s: Callable[[int], float] | None) -> str | None:
        """Return what to warn of, if a gap ends now; `show_s` says where the show is, if it is."""
        wakeup_ns, self._wakeup_ns = self._wakeup_ns, None
        if wakeup_ns is None or now_ns - wakeup_ns < GAP_NS or self._named == NAMED_MAX:
            return None
        self._named += 1
        gap_s = s_from_ns(now_ns - wakeup_ns)
        where = "" if show_s is None else f", up to {show_s(now_ns):.2f} s of the show"
        last = ". More of this is not told" if self._named == NAMED_MAX else ""
        return (
            f"this program was held up for {gap_s:.2f} s{where}, and what was due then left late: "
            f"stopped (Ctrl-Z), or without processor time (lss-motion doctor, --real-time){last}"
        )


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
        self.trackers = self._session.trackers
        self._phases = Phases(self._session, must_ask=must_ask, is_open=is_open)
        self._may_grow = is_open
        self._gaps = StallDetector()
        self._stops = 0

    # ---- the four calls

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        """Return what must be written now, per bus; buses with nothing to write are left out."""
        self._note_gap(leaves_ns)
        self._phases.advance(leaves_ns)
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
        return self._phases.active_faults.escalation.faults

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
        return is_under_way and self._phases.active_faults.is_resumable(bus)

    def port_lost(self, bus: str, reason: str, now_ns: int) -> None:
        """Brake on the other buses, and wait for this one, as `on_fault` says."""
        verdict = self._phases.active_faults.lose(bus, reason, now_ns)
        if verdict is Verdict.END:
            self._phases.error = LostPortError(reason, url=self.robot.buses[bus].port)
            self._phases.end("fault", now_ns)
        elif self.phase is not Phase.STOP:
            self._phases.recover(now_ns)

    def port_found(self, bus: str) -> None:
        """Go on with a port that was lost."""
        self._phases.active_faults.lost.pop(bus, None)
