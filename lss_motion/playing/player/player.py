"""State machine of a show, from the first query to the last byte; without port, thread or clock.

    data_to_send(leaves_ns)          returns the bytes that must be written now, per bus
    receive_data(bus, data, now_ns)  takes the bytes that came from a bus
    next_wakeup_ns()                 returns when `data_to_send` must be called at the latest
    next_event()                     returns what happened, oldest first; None: there is no more

The phases (`events.Phase`): connect (check the servos), ready (wait for a person), prepare (session
settings), approach (move to the start), show, and in any case restore (the settings) and done (the
safe state is the last that is sent). A person may send the show elsewhere: from approach or show
to seek, which brakes, and to the approach of another place. From these three, a fault or a stall of
this program may lead to recover, and from there through prepare and approach back to the show; or
to stop, which brakes. `stage_player` adds standing, between the shows of a run with many.

In every phase the player has one activity: a dialogue (`handshake`), a streamer, or it waits.
`session` holds what the phases share, `faults` decides about faults, `StallDetector` finds stalls.
"""

from __future__ import annotations

import heapq
from collections import deque
from typing import TYPE_CHECKING, Final, Literal

from msgspec.structs import replace

from lss_motion.errors import InputError, LostPortError, LssMotionError
from lss_motion.planning.program.verify import driven
from lss_motion.playing.player.events import Phase, PhaseEntered, Warned
from lss_motion.playing.player.faults import FaultHandler, Verdict
from lss_motion.playing.player.handshake import Preparation, SettingsDialogue
from lss_motion.playing.player.preflight import Preflight
from lss_motion.playing.player.query_choice import BY_NEED
from lss_motion.playing.player.session import COUNT_IN_NS, Arrival, Session
from lss_motion.playing.player.show_clock import CLOSING_S, TRIM_MAX_RATIO
from lss_motion.playing.player.stalls import GAP_NS, StallDetector, stall_text
from lss_motion.units import NS_PER_MS, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.program.splice import Extension
    from lss_motion.playing.player.events import Event, Faulted
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.playing.player.show_clock import Leg
    from lss_motion.playing.player.streamer import Streamer
    from lss_motion.playing.player.transactions import Dialogue
    from lss_motion.robot.model import Robot

    Outcome = Literal["finished", "stopped", "fault"]


IDLE_NS: Final = 20 * NS_PER_MS
"""The player is called at least this often: a person may press a key, or telemetry be due."""
RATE_LEAST: Final = 0.01
"""A lower rate is a pause: a minute of show would take more than an hour."""
PLAYING: Final = (Phase.SHOW, Phase.STANDING)
DRIVING: Final = (*PLAYING, Phase.APPROACH, Phase.SEEK)


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
        is_forced: bool = False,
        pace: Pace | None = BY_NEED,
    ) -> None:
        """Play `program`; while `is_open` the show does not end there but waits for extensions.

        With `must_ask`, nothing moves before `go`. `is_forced`: play without feedback also where
        servos store higher limits than their joints have. `pace`: how often angles are queried;
        None: as often as the lines allow.
        """
        self.program = program
        self.start_s = start_s
        """Show time from which the show is played; None: from its beginning."""
        self.robot = robot = driven(robot, program)
        self.phase = Phase.CONNECT
        self.outcome: Outcome | None = None
        self.error: LssMotionError | None = None
        """Why the show could not begin or go on, where no joint is the cause."""
        self.show: Streamer | None = None
        """The show itself, once it has begun; before that `moving` is its approach."""
        self.show_ended_ns: int | None = None
        self.changes = 0
        """How often another program has taken the place of the one before it."""
        self._show_phase = Phase.SHOW
        """Phase in which the present program is played."""
        options = {"has_feedback": has_feedback, "is_forced": is_forced}
        self._session = Session(program, robot, start_s=start_s, pace=pace, **options)
        self.lines = self._session.lines
        self.trackers = self._session.trackers
        self.unasked = self._session.unasked
        self._faults, self._stalls = FaultHandler(self._session), StallDetector()
        self._events: deque[Event] = deque([PhaseEntered(Phase.CONNECT)])
        self._must_ask = must_ask
        self._is_open = self._was_open = is_open
        self._is_held = False
        """Whether the show that is to begin stands before its start until `run_from`."""
        self._rate = 1.0
        """The rate that a person set; a fault may reduce it further."""
        self._dialogue: Dialogue | SettingsDialogue | Preflight | None = self._session.preflight()
        self._streamer: Streamer | None = None
        self._now_ns = self._approaches = 0
        self._preparation = Preparation()
        self._has_set = False
        """Whether orders may have changed settings of the servos."""
        self._has_moved, self._stops, self.idle_ns = False, 0, IDLE_NS
        self._ended_ns: int | None = None
        """When the show had ended but for its goal tolerances."""
        self._seek_s: float | None = None
        """Show time from which the show goes on once the robot stands."""
        self._goal_ns: int | None = None
        """When the time of a joint to come within its goal tolerance is over."""
        self._wakes_ns: list[int] = []
        """Instants at which a caller must be called, a heap."""

    # ---- the four calls

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        """Return what must be written now, per bus; buses with nothing to write are left out.

        `leaves_ns` is the instant at which the bytes will leave, shortly after the call.
        """
        before_ns, self._now_ns = self._now_ns, leaves_ns
        if leaves_ns - before_ns >= GAP_NS:
            self._note_stall(leaves_ns)
        while self._step(leaves_ns):
            pass
        return {name: line.take() for name, line in self.lines.items() if line.out}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        """Take bytes of a bus. No bytes of any kind raise."""
        for reply, ended_ns in self.lines[bus].receive(data, now_ns):
            if self._dialogue is not None:
                self._dialogue.receive(bus, reply, now_ns)
            elif self._streamer is not None and self._session.has_feedback:
                self._streamer.receive(bus, reply, ended_ns, now_ns)
            else:
                self.trackers[bus].receive(reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        """Return when `data_to_send` must be called at the latest; None when the run is over."""
        wakeup_ns = None
        if self.phase is not Phase.DONE:
            wakeup_ns = self._now_ns + self.idle_ns
            for due_ns in self._wakeups_ns():
                if due_ns is not None and due_ns < wakeup_ns:
                    wakeup_ns = due_ns if due_ns > self._now_ns else self._now_ns
        self._stalls.wakeup_ns = wakeup_ns
        return wakeup_ns

    def reads_ns(self, bus: str) -> int | None:
        """Return until when bytes of a bus may wait to be handed over; None: they may not."""
        is_streaming = self._dialogue is None and self._streamer is not None
        return self.trackers[bus].reads_ns(self._now_ns) if is_streaming else None

    def is_due(self, leaves_ns: int) -> bool:
        """Return whether a move must leave by then, before answers are used, which takes time."""
        due_ns = None if self._streamer is None else self._streamer.due_ns()
        return due_ns is not None and due_ns <= leaves_ns

    def next_event(self) -> Event | None:
        return self._events.popleft() if self._events else None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes for each bus if the run ends now; none if it only sent queries."""
        if not self._has_set:
            return {}
        is_limp = self.robot.end == "limp" and self.outcome == "finished"
        return self._session.safe_bytes(is_limp=is_limp)

    def _wakeups_ns(self) -> list[int | None]:
        while self._wakes_ns and self._wakes_ns[0] <= self._now_ns:
            heapq.heappop(self._wakes_ns)
        wakeups_ns: list[int | None] = [*self._wakes_ns[:1]]
        if self._dialogue is not None:
            wakeups_ns.append(self._dialogue.next_wakeup_ns())
        elif self._streamer is not None:
            wakeups_ns.append(self._streamer.next_wakeup_ns(self._now_ns))
        if self.phase in DRIVING and self._dialogue is None:
            wakeups_ns += self._faults.escalation.wakeups_ns()
        if self.phase in PLAYING:
            agenda_ns = self._session.agenda.wakeup_ns(self.show, self.lines, self._now_ns)
            wakeups_ns += (agenda_ns, self._goal_ns)
        elif self.phase is Phase.RECOVER and self._faults.recovery is not None:
            wakeups_ns.append(self._faults.recovery.give_up_ns)
        return wakeups_ns

    def _note_stall(self, now_ns: int) -> None:
        """Brake if a move was due long ago: this program was held up; then recover or end."""
        gap_ns = self._stalls.gap_ns(now_ns)
        streamer = self._streamer if self._dialogue is None else None
        due_ns = None if streamer is None else streamer.due_ns()
        if streamer is None or due_ns is None or now_ns - due_ns < GAP_NS:
            if gap_ns and self.phase in DRIVING and (text := self._stalls.warning(gap_ns)):
                self._events.append(Warned(text))
            if self.phase is Phase.RECOVER:
                self._faults.extend_recovery(gap_ns)
            return
        streamer.halt(due_ns, now_ns)
        if self.phase not in DRIVING:
            self._faults.extend_recovery(now_ns - due_ns)
            return
        show_s = None if self.show is None else self.show.show_s(due_ns)
        match self._faults.stall(stall_text(now_ns - due_ns, show_s), now_ns):
            case Verdict.RECOVER:
                self._recover(now_ns)
            case _:
                self._end("fault", now_ns)

    # ---- state of the run

    @property
    def is_finished(self) -> bool:
        return self.phase is Phase.DONE

    @property
    def moving(self) -> Streamer | None:
        return self.show or self._streamer

    @property
    def is_paused(self) -> bool:
        """Whether a person has paused the show."""
        return self._rate == 0.0

    @property
    def faults(self) -> list[Faulted]:
        """The faults so far, each with the highest step that was taken about it."""
        return self._faults.escalation.faults

    def is_due_within(self, span_ns: int, now_ns: int) -> bool:
        """Return whether the show has a move to send that soon."""
        due_ns = None if self.show is None else self.show.quiet_ns(now_ns)
        return due_ns is not None and due_ns < now_ns + span_ns

    @property
    def is_leaving(self) -> bool:
        """Whether another program takes the place of the present one; only on a stage."""
        return False

    # ---- commands of a person

    def go(self) -> None:
        """Begin to move, if the player waits for that in `Phase.READY`."""
        if self.phase is Phase.READY:
            self._prepare()

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Ramp the rate of the show to `rate`: up to 1; below `RATE_LEAST` it is a pause.

        Outside of the show the rate is kept for when the show goes on.
        """
        self._note_stall(now_ns)  # First: the new rate would hide the move that was due.
        self._rate = 0.0 if rate < RATE_LEAST else min(rate, 1.0)
        self._apply_rate(now_ns)

    def follow(
        self,
        leader: Leg,
        now_ns: int,
        trim_max_ratio: float = TRIM_MAX_RATIO,
        closing_s: float = CLOSING_S,
    ) -> float | None:
        """Trim the show clock so that it meets `leader`; return how far off it is, in seconds.

        None, and nothing happens, while no show plays at a steady rate.
        """
        if self.show is None or self.phase is not Phase.SHOW:
            return None
        return self.show.clock.follow(leader, now_ns, trim_max_ratio, closing_s)

    def hold_before_start(self, now_ns: int) -> None:
        """Stand before the start of a show of which no joint has moved yet, until `run_from`.

        Also before the approach: then the show waits when it has come to its start.
        """
        self._rate, self._is_held = 0.0, self.show is None
        if self.show is not None and self.phase is Phase.SHOW:
            self.show.hold_before_start(now_ns)

    def run_from(self, show_s: float, now_ns: int) -> None:
        """Let a show that stands before its start be at `show_s` now, and run from there on.

        At most at its first instant: until then nothing moves.
        """
        self._note_stall(now_ns)
        if self.show is not None and self.phase is Phase.SHOW:
            self._rate = 1.0
            self.show.run_from(show_s, now_ns)

    def seek(self, place: float | str, now_ns: int) -> None:
        """Go on from a show time or a label: brake, move there at the approach speed, rejoin.

        A paused show stands there until it is resumed. Raises `InputError` for a place that is not
        in the show, and where the run cannot seek: a walk, or a run that recovers or ends.
        """
        show_s = self.program.instant_of(place)
        if self._was_open:
            raise InputError("a walk has no times to go to")
        if self.phase in (Phase.RECOVER, Phase.STOP, Phase.RESTORE, Phase.DONE):
            raise InputError(f"the show cannot go to another place now, it is {self.phase.value}")
        self._note_stall(now_ns)
        self._seek_s = show_s
        self._leave(now_ns)

    def _leave(self, now_ns: int) -> None:
        """Brake, to go on elsewhere once the robot stands."""
        if self._streamer is not None and self.phase in (Phase.APPROACH, *PLAYING):
            self._brake(now_ns)
            self._enter(Phase.SEEK)
        elif self.phase is Phase.APPROACH:
            self._dialogue = None
            self._enter(Phase.SEEK)

    def wake_at(self, instant_ns: int) -> None:
        """Let `next_wakeup_ns` be no later than `instant_ns`, for who acts at that instant."""
        heapq.heappush(self._wakes_ns, instant_ns)

    def extend(self, extension: Extension, now_ns: int) -> bool:
        """Go on with `extension` from its splice on; False if it is too late or no show plays.

        `program` keeps the moves that it had at the start.
        """
        show = self.show if self.phase is Phase.SHOW else None
        if show is None or not show.extend(extension, now_ns):
            return False
        end_s, use = extension.duration_s, extension.line_use
        self.program = replace(self.program, duration_s=end_s, line_use=use)
        return True

    def close(self) -> None:
        """Accept no more extensions: the show ends where its program does."""
        self._is_open = False
        if self.show is not None:
            self.show.close()

    def stop(self, now_ns: int) -> None:
        """Brake within the limits and hold; then restore and end. The second call is `abort`.

        A program that was open is played to its end instead, since it ends at rest. If the show has
        just ended by itself, the first call lets it go on restoring.
        """
        self._stops += 1
        if self.phase is Phase.SHOW and self._was_open:
            self.outcome = self.outcome or "stopped"
            self.close()
            if self._stops > 1:
                self.abort(now_ns)
        elif self.phase in (Phase.STOP, Phase.RESTORE):
            if self._stops > 1:
                self.abort(now_ns)
        elif self.phase is not Phase.DONE:
            self._end("stopped", now_ns)

    def abort(self, now_ns: int) -> None:
        """End at once: only the safe state is sent; settings are not given back."""
        self.outcome = self.outcome or "stopped"
        if self._has_set and (text := self._session.unrestored_text()):
            self._events.append(Warned(text))
        self._finish(now_ns)

    def end_show(self, now_ns: int) -> None:
        """Note that the show, if there was one, is over; the first call counts."""
        if self.show is not None and self.show_ended_ns is None:
            self.show_ended_ns = now_ns

    def lose_sound(self, text: str, now_ns: int) -> None:
        """Note that a sound cannot be played; end the show if `on_fault` requires it."""
        is_over = self._faults.lose_sound(text) is Verdict.END
        if is_over and self.phase not in (Phase.STOP, Phase.RESTORE, Phase.DONE):
            self._end("fault", now_ns)
        self._report_faults()

    # ---- calls of the owner of the ports

    def waits_for_port(self, bus: str) -> bool:
        """Return whether a port that is lost now should be opened again if it comes back."""
        is_under_way = self._has_moved and self.phase not in (Phase.RESTORE, Phase.DONE)
        return is_under_way and self._faults.is_resumable(bus)

    def port_lost(self, bus: str, reason: str, now_ns: int) -> None:
        """Brake on the other buses, and wait for this one or end, as `on_fault` requires."""
        verdict = self._faults.lose_port(bus, reason, now_ns)
        if verdict is Verdict.END:
            self.error = LostPortError(reason, url=self.robot.buses[bus].port)
            self._end("fault", now_ns)
        elif self.phase is not Phase.STOP:
            self._recover(now_ns)

    def port_found(self, bus: str) -> None:
        """Go on with a port that was lost."""
        self._faults.find_port(bus)

    # ---- one step, in any phase

    def _step(self, now_ns: int) -> bool:
        """Do what is due in the present phase; return whether more may be due at once."""
        if self.phase in (Phase.DONE, Phase.READY):
            return False
        if self.phase is Phase.RECOVER and self._faults.is_over(now_ns):
            answers = {} if self._dialogue is None else self._dialogue.answers
            self.error = self._faults.give_up(answers, now_ns)
            self._end("fault", now_ns)
            return True
        if self._dialogue is not None:
            self._dialogue.advance(now_ns)
            self._report_faults()
            if not self._dialogue.is_finished:
                return False
            self._after_dialogue(now_ns)
            return True
        self._advance_streamer(now_ns)
        if self.phase in DRIVING and self._streamer is not None and self._judge_faults(now_ns):
            return True
        if not self._has_streamed(now_ns):
            return False
        self._after_streamer(now_ns)
        return True

    def _advance_streamer(self, now_ns: int) -> None:
        if self._streamer is None:
            return
        if self.phase in PLAYING:
            self._events += self._session.agenda.advance(self._streamer, self.lines, now_ns)
        self._streamer.advance(now_ns)
        if self._streamer.has_waited:
            self._events += self._session.note_wait(self._streamer)

    def _judge_faults(self, now_ns: int) -> bool:
        """Act on the faults that the streamer has found; return whether the phase changed."""
        assert self._streamer is not None
        verdict = self._faults.judge(self._streamer, now_ns)
        self._report_faults()
        match verdict:
            case Verdict.END:
                self._end("fault", now_ns)
            case Verdict.RECOVER:
                self._recover(now_ns)
            case Verdict.CONTINUE:
                self._apply_rate(now_ns)
        return verdict is not Verdict.CONTINUE

    def _has_streamed(self, now_ns: int) -> bool:
        """Return whether the streamer has finished its part of this phase."""
        if self.phase in (Phase.STOP, Phase.RECOVER, Phase.SEEK):
            is_standing = self._streamer is None or self._streamer.is_standing(now_ns)
            return is_standing and not (self.phase is Phase.RECOVER and self._faults.lost_ports)
        assert self._streamer is not None
        if not self._streamer.is_finished(now_ns):
            self._goal_ns = None  # A fault at the end may have set the joints in motion again.
            return False
        return self.phase is not Phase.SHOW or self._has_reached_goal(self._streamer, now_ns)

    def _has_reached_goal(self, show: Streamer, now_ns: int) -> bool:
        """Return whether no joint has time left to come within its goal tolerance.

        The show has not finished if one is beyond it after its time.
        """
        misses = self._faults.goal_misses(show)
        if self._ended_ns is None:
            self._ended_ns = now_ns
        joints = self.robot.joints
        ends_ns = [self._ended_ns + ns_from_s(joints[name].goal_time_s) for name in misses]
        self._goal_ns = min((end_ns for end_ns in ends_ns if end_ns > now_ns), default=None)
        if self._goal_ns is not None:
            return False
        for name, off_deg in misses.items():
            if self._faults.note_goal(name, off_deg) is Verdict.END:
                self.outcome = self.outcome or "fault"
        self._report_faults()
        return True

    def _after_streamer(self, now_ns: int) -> None:
        if self.phase is Phase.RECOVER:
            self._streamer = None
            self._dialogue = self._session.dialogue(self._faults.recovery_queries())
        elif self.phase is Phase.SEEK:
            self._go_on(now_ns)
        elif self.phase is not Phase.APPROACH:
            self._after_show(now_ns)
        elif self._session.has_feedback:
            self._streamer = None
            self._dialogue = self._session.arrival_dialogue()
        else:
            self._begin(now_ns)

    def _after_show(self, now_ns: int) -> None:  # noqa: ARG002  (a stage goes on)
        """End the run: the show is over, or the robot has stopped."""
        self.outcome = self.outcome or "finished"
        self._restore()

    def _after_dialogue(self, now_ns: int) -> None:
        dialogue, self._dialogue = self._dialogue, None
        assert dialogue is not None
        match self.phase:
            case Phase.CONNECT if isinstance(dialogue, Preflight):
                self._connected(dialogue)
            case Phase.RECOVER | Phase.PREPARE if isinstance(dialogue, Preflight):
                self._proved(dialogue, now_ns)
            case Phase.PREPARE if isinstance(dialogue, SettingsDialogue):
                self._prepared(dialogue, now_ns)
            case Phase.RECOVER:
                self._dialogue = self._faults.proof(dialogue.answers)
            case Phase.APPROACH:
                self._arrived(dialogue.answers, now_ns)
            case _:
                self._finish(now_ns)
        self._report_faults()

    # ---- from one phase to the next

    def _enter(self, phase: Phase) -> None:
        self._report_faults()
        self.phase = phase
        self._events.append(PhaseEntered(phase))

    def _report_faults(self) -> None:
        self._events += self._faults.take_events()
        if self._now_ns >= self.unasked.look_ns:
            self._events += map(Warned, self.unasked.advance(self._now_ns))

    def _connected(self, preflight: Preflight) -> None:
        try:
            self._events += self._session.note_original(preflight)
        except LssMotionError as error:
            self._fail(error)
            return
        if self._must_ask:
            self._enter(Phase.READY)
        else:
            self._prepare()

    def _proved(self, preflight: Preflight, now_ns: int) -> None:
        """Go on with servos that were away if they are the same as before; wait for the others."""
        if (error := self._faults.prove(preflight, now_ns)) is not None:
            self._fail(error)
        elif preflight.unproved:
            self._enter(Phase.RECOVER)
        elif self.phase is Phase.PREPARE and self._preparation.is_repeated:
            self._approach(now_ns)
        else:
            self._prepare(is_repeated=self.phase is Phase.PREPARE)

    def _prepare(self, *, is_repeated: bool = False) -> None:
        self._has_set, self._approaches = True, 0
        self._preparation = Preparation(self._now_ns, self._session.timeouts, is_repeated)
        self._enter(Phase.PREPARE)
        self._dialogue = self._session.settings_dialogue()

    def _prepared(self, settings: SettingsDialogue, now_ns: int) -> None:
        if self._has_lost_turns(settings.answers, now_ns):
            return
        silent = self._session.note_positions(settings.answers)
        if settings.wrong or silent:
            if error := self._faults.wait_again(silent, settings.wrong, settings.answers, now_ns):
                self._fail(error)
            else:
                self._enter(Phase.RECOVER)
        elif self._preparation.has_missed(self._session.timeouts, now_ns):
            self._dialogue = self._session.proof(self._session.driven, settings.answers)
        elif self._preparation.is_stale(now_ns):
            self._prepare(is_repeated=True)
        else:
            self._approach(now_ns)

    def _has_lost_turns(self, answers: Answers, now_ns: int) -> bool:
        """End the run if a joint is in another turn than it was: no move takes it back."""
        verdict = self._faults.lose_turns(self._session.turned(answers, now_ns), now_ns)
        if verdict is Verdict.END:
            self._streamer = None
            self._end("fault", now_ns)
        return verdict is Verdict.END

    def _go_on(self, now_ns: int) -> None:
        """Go on elsewhere: the robot stands."""
        self._approaches = 0
        self._session.note_standing(now_ns)
        self._approach(now_ns)

    def _approach(self, now_ns: int) -> None:
        self._approaches += 1
        self._has_moved = True
        if self._seek_s is not None:
            self._session.seek(self.show, self._seek_s, now_ns)
            self._seek_s = self._ended_ns = self._goal_ns = None
        if self.phase is not Phase.APPROACH:
            self._enter(Phase.APPROACH)
        self._streamer = self._session.approach(self._pose_deg(now_ns), now_ns)

    def _pose_deg(self, now_ns: int) -> dict[str, float]:
        """Return the angles of the driven joints from which the show begins, or goes on."""
        return self._session.pose_deg(self.show, now_ns)

    def _arrived(self, answers: Answers, now_ns: int) -> None:
        """Go on with the show if every joint is where it begins; else repeat the approach."""
        if self._has_lost_turns(answers, now_ns):
            return
        session = self._session
        silent = session.note_positions(answers)
        silent += [joint for joint in session.unreported(answers) if joint not in silent]
        match self._faults.arrive(session.restarted(answers), silent, now_ns):
            case Verdict.END:
                self._end("fault", now_ns)
            case Verdict.RECOVER:
                self._recover(now_ns)
            case Verdict.CONTINUE:
                self._judge_arrival(now_ns)

    def _judge_arrival(self, now_ns: int) -> None:
        """Go on with the show if every joint is near enough to its place; else approach again."""
        session, count = self._session, self._approaches
        match session.judge_arrival(self._pose_deg(now_ns), count, now_ns):
            case Arrival.THERE, _, _:
                self._begin(now_ns)
            case Arrival.AGAIN, _, _:
                self._approach(now_ns)
            case Arrival.ASTRAY, joint, off_deg:
                self._faults.note_astray(joint, off_deg, count)
                self._end("fault", now_ns)

    def _begin(self, now_ns: int) -> None:
        """Begin the show, or go on with it."""
        self._enter(self._show_phase)
        self._faults.clear()
        if self.show is None:
            self.show = self._session.begin(now_ns + COUNT_IN_NS, is_open=self._is_open)
            if self._is_held and self._show_phase is Phase.SHOW:
                self._is_held = False  # The next show of a stage is another one.
                self.show.hold_before_start(now_ns)
        else:
            self._session.resume(self.show, now_ns)
        self._streamer = self.show
        self._apply_rate(now_ns)

    def _apply_rate(self, now_ns: int) -> None:
        """Set the show clock to the rate of the person, as far as the faults allow it."""
        if self._streamer is None or self.phase not in (Phase.APPROACH, *PLAYING):
            return
        own_rate = self._rate if self.phase is Phase.SHOW else 1.0
        rate = min(self._faults.escalation.rate_max, own_rate)
        if rate != self._streamer.rate_wanted:
            self._streamer.set_rate(rate, now_ns)

    def _recover(self, now_ns: int) -> None:
        """Brake, and wait for the servos that are gone.

        They are sent no move before they have their settings again, not even to brake: their last
        move ends by itself.
        """
        self._dialogue = None
        if self._streamer is not None:
            self._streamer.leave_out(self._session.left_out | self._faults.missing)
            self._brake(now_ns)
        self._enter(Phase.RECOVER)

    def _brake(self, now_ns: int) -> None:
        """Ramp the rate to 0, unless that was done."""
        if self._streamer is not None and self._streamer.rate_wanted != 0.0:
            self._streamer.set_rate(0.0, now_ns)

    # ---- the end

    def _fail(self, error: LssMotionError) -> None:
        self.error, self.outcome = error, "fault"
        self._restore()

    def _end(self, outcome: Outcome, now_ns: int) -> None:
        """Brake if anything moves, then restore and end."""
        self.outcome = self.outcome or outcome
        if self._streamer is not None and self.phase in (*DRIVING, Phase.RECOVER):
            self._brake(now_ns)
            self._enter(Phase.STOP)
        elif self.phase is not Phase.STOP:
            self._restore()

    def _restore(self) -> None:
        """Give back the settings, if the show changed them."""
        self.end_show(self._now_ns)
        self._streamer = None
        self._enter(Phase.RESTORE)
        session = self._session
        self._dialogue = session.restoring_dialogue() if self._has_set else session.dialogue([])

    def _finish(self, now_ns: int) -> None:
        self.end_show(now_ns)
        self._dialogue = self._streamer = None
        for name, data in self.safe_bytes().items():
            self.lines[name].send(data, now_ns)
        self._enter(Phase.DONE)
