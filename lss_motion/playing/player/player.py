"""Plays the programs of a repertoire, from the first query to the last byte; no port, no clock.

The calls of the loop are those of `playing.runner.Driven`.

The run of one show ends with it. In a run of many the servos are checked and set up once, and stay
so; between two shows a program without moves holds all joints, and the servos are polled, corrected
and watched as in a show:

    change_to(program, now_ns)   plays another program in place of the present one
    add(program, now_ns)         plays another program beside it, on joints that it does not move
    end_added(name, now_ns)      ends a program that was added
    stop(now_ns)                 brakes, restores and ends

What follows what is decided in `phases`; here are the calls of the loop and of those that steer.
`StallDetector` finds that this process was held up.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError, LostPortError
from lss_motion.files.texts import known_names
from lss_motion.planning.program.verify import driven
from lss_motion.playing.player.events import Phase, Warned
from lss_motion.playing.player.faults import Verdict
from lss_motion.playing.player.phases import DRIVING, ENDING, PLAYING, PhaseMachine
from lss_motion.playing.player.repertoire import PresentShow, Start
from lss_motion.playing.player.session import Session, approach_s
from lss_motion.playing.player.show_clock import CLOSING_S, TRIM_MAX_RATIO
from lss_motion.units import NS_PER_MS, NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.errors import LssMotionError
    from lss_motion.planning.program.live_edit import ProgramEdit
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.program.splice import Extension
    from lss_motion.playing.player.events import Event, Faulted
    from lss_motion.playing.player.phases import Outcome
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.playing.player.show_clock import LeaderPosition
    from lss_motion.playing.player.streamer import Streamer
    from lss_motion.robot.model import Robot


IDLE_NS: Final = 20 * NS_PER_MS
"""The player is called at least this often: a person may press a key, or telemetry be due."""
RATE_LEAST: Final = 0.01
"""A lower rate is a pause: a minute of show would take more than an hour."""
GAP_NS: Final = NS_PER_S // 4
"""A shorter delay is no stall. Chosen: four times the delay at which a move counts as missed
(`quantize.LATEST_ARRIVAL_S`), and longer than any wait on a busy host that was measured."""
HELD_UP_NS: Final = 20 * NS_PER_MS
"""After a longer delay answers are used before moves leave, and a servo that owes one gets no move
before it has answered with its settings. Chosen: the shortest restart."""
LONG_NS: Final = 150 * NS_PER_MS
"""After a longer delay that holds for every servo. Chosen: queries before and after a shorter one
meet a restart of usual length, and to hold all moves back each time would cost a busy host more."""
NAMED_MAX: Final = 10
"""Number of delays that are reported. On a host that is too slow, every move would be one."""
STALL_REASON: Final = (
    "stopped (Ctrl-Z), asleep, or without processor time (lss-motion doctor, --real-time)"
)


class Player:
    """Plays the programs of a repertoire on one robot, one after the other."""

    def __init__(
        self,
        repertoire: Repertoire,
        robot: Robot,
        *,
        first: Program | None = None,
        has_feedback: bool = True,
        start_s: float | None = None,
        must_ask: bool = False,
        is_open: bool = False,
        is_forced: bool = False,
    ) -> None:
        """Begin with `first`, or the only program; None: all joints hold where they are.

        While `is_open` the show does not end but waits for extensions. With `must_ask`, nothing
        moves before `go`. `is_forced`: play without feedback also where servos store higher limits
        than their joints have.
        """
        robot.require_servos("a player")
        if first is not None:
            repertoire.require(first)
        needs = repertoire.needs(first)
        self.repertoire = repertoire
        self.robot = robot = driven(robot, needs)
        session = Session(
            needs,
            robot,
            has_feedback=has_feedback,
            is_forced=is_forced,
            pace=repertoire.pace,
            watched=repertoire.watched,
        )
        self.watched = session.watched
        self.lines = session.lines
        self.trackers = session.trackers
        self.unasked = session.unasked
        self._session = session
        self._present = PresentShow(repertoire, session, needs, first, start_s, is_open=is_open)
        self._machine = PhaseMachine(repertoire, session, self._present, must_ask=must_ask)
        self._added = self._machine.added
        self._stalls, self._stops, self.idle_ns = StallDetector(), 0, IDLE_NS
        self._wakes_ns: list[int] = []
        """Instants at which a caller must be called, a heap."""

    # ---- the four calls

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        """Return what must be written now, per bus; buses with nothing to write are left out.

        `leaves_ns` is the instant at which the bytes will leave, shortly after the call.
        """
        machine = self._machine
        before_ns, machine.now_ns = machine.now_ns, leaves_ns
        if self._stalls.is_held_up(leaves_ns) and machine.streamer is not None:
            is_long = self._stalls.is_held_up(leaves_ns, LONG_NS)
            machine.streamer.hold_back(leaves_ns, is_long=is_long)
        if leaves_ns - before_ns >= GAP_NS:
            self._note_stall(leaves_ns)
        while machine.step(leaves_ns):
            pass
        return {name: line.take() for name, line in self.lines.items() if line.out}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        """Take bytes of a bus. No bytes of any kind raise."""
        dialogue, streamer = self._machine.dialogue, self._machine.streamer
        for reply, ended_ns in self.lines[bus].receive(data, now_ns):
            if dialogue is not None:
                dialogue.receive(bus, reply, now_ns)
            elif streamer is not None and self._session.has_feedback:
                streamer.receive(bus, reply, ended_ns, now_ns)
            else:
                self.trackers[bus].receive(reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        """Return when `data_to_send` must be called at the latest; None when the run is over."""
        wakeup_ns, machine, wakes_ns = None, self._machine, self._wakes_ns
        if machine.phase is not Phase.DONE:
            now_ns = machine.now_ns
            while wakes_ns and wakes_ns[0] <= now_ns:
                heapq.heappop(wakes_ns)
            wakeup_ns = now_ns + self.idle_ns
            for due_ns in machine.wakeups_ns(wakes_ns[:1]):
                if due_ns is not None and due_ns < wakeup_ns:
                    wakeup_ns = due_ns if due_ns > now_ns else now_ns
        self._stalls.wakeup_ns = wakeup_ns
        return wakeup_ns

    def reads_ns(self, bus: str) -> int | None:
        """Return until when bytes of a bus may wait to be handed over; None: they may not."""
        machine = self._machine
        is_streaming = machine.dialogue is None and machine.streamer is not None
        return self.trackers[bus].reads_ns(machine.now_ns) if is_streaming else None

    def is_due(self, leaves_ns: int) -> bool:
        """Return whether a move must leave by then, before answers are used, which takes time.

        Not on a host that was held up: a servo may have restarted meanwhile.
        """
        if self._stalls.is_held_up(leaves_ns):
            return False
        streamer = self._machine.streamer
        due_ns = None if streamer is None else streamer.due_ns()
        return due_ns is not None and due_ns <= leaves_ns

    def next_event(self) -> Event | None:
        return self._machine.events.popleft() if self._machine.events else None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes for each bus if the run ends now; none if it only sent queries."""
        return self._machine.safe_bytes()

    def _note_stall(self, now_ns: int) -> None:
        """Brake if a move was due long ago: this program was held up; then recover or end."""
        gap_ns = self._stalls.gap_ns(now_ns)
        streamer = self._machine.streamer if self._machine.dialogue is None else None
        due_ns = None if streamer is None else streamer.due_ns()
        if streamer is None or due_ns is None or now_ns - due_ns < GAP_NS:
            if gap_ns and self._machine.phase in DRIVING and (text := self._stalls.warning(gap_ns)):
                self._machine.events.append(Warned(text))
            if self._machine.phase is Phase.RECOVER:
                self._machine.faults.extend_recovery(gap_ns)
            return
        streamer.halt(due_ns, now_ns)
        if self._machine.phase not in DRIVING:
            self._machine.faults.extend_recovery(now_ns - due_ns)
            return
        show_s = None if self.show is None else self.show.show_s(due_ns)
        match self._machine.faults.stall(_stall_text(now_ns - due_ns, show_s), now_ns):
            case Verdict.RECOVER:
                self._machine.recover(now_ns)
            case _:
                self._machine.end("fault", now_ns)

    # ---- state of the run

    @property
    def phase(self) -> Phase:
        return self._machine.phase

    @property
    def outcome(self) -> Outcome | None:
        return self._machine.outcome

    @property
    def error(self) -> LssMotionError | None:
        """Why the show could not begin or go on, where no joint is the cause."""
        return self._machine.error

    @property
    def show_ended_ns(self) -> int | None:
        """When the show, if there was one, was over."""
        return self._machine.show_ended_ns

    @property
    def is_finished(self) -> bool:
        return self._machine.phase is Phase.DONE

    @property
    def program(self) -> Program:
        """The present program with all joints of the run; at first what all programs need."""
        return self._present.program

    @property
    def start_s(self) -> float | None:
        """Show time from which the present show is played; None: from its beginning."""
        return self._present.start_s

    @property
    def show(self) -> Streamer | None:
        """The show itself, once it has begun; before that `moving` is its approach."""
        return self._present.streamer

    @property
    def moving(self) -> Streamer | None:
        return self.show or self._machine.streamer

    @property
    def changes(self) -> int:
        """How often another program has taken the place of the one before it."""
        return self._present.changes

    @property
    def is_leaving(self) -> bool:
        """Whether another program takes the place of the present one."""
        return self._present.next is not None

    @property
    def added(self) -> tuple[str, ...]:
        """The names of the programs that are played beside the present one, or will be."""
        return self._added.names

    @property
    def is_paused(self) -> bool:
        """Whether a person has paused the show."""
        return self._machine.rate == 0.0

    @property
    def faults(self) -> list[Faulted]:
        """The faults so far, each with the highest step that was taken about it."""
        return self._machine.faults.escalation.faults

    def is_due_within(self, span_ns: int, now_ns: int) -> bool:
        """Return whether the show has a move to send that soon."""
        due_ns = None if self.show is None else self.show.quiet_ns(now_ns)
        return due_ns is not None and due_ns < now_ns + span_ns

    def show_s(self, now_ns: int) -> float:
        """Return the show time of the present show; 0 before it has begun."""
        return 0.0 if self.show is None else self.show.show_s(now_ns)

    def way_s(self, program: Program, show_s: float | None, now_ns: int) -> float:
        """Return about how long the way to a show time of a program takes, without braking.

        None: to its beginning.
        """
        to_deg = self._session.start_of(program, show_s)
        return approach_s(self.robot, to_deg | self._machine.pose_deg(now_ns), to_deg)

    # ---- commands of a person

    def go(self) -> None:
        """Begin to move, if the player waits for that in `Phase.READY`."""
        if self._machine.phase is Phase.READY:
            self._machine.go()

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Ramp the rate of the show to `rate`: up to 1; below `RATE_LEAST` it is a pause.

        Outside of the show the rate is kept for when the show goes on.
        """
        self._note_stall(now_ns)  # First: the new rate would hide the move that was due.
        self._machine.rate = 0.0 if rate < RATE_LEAST else min(rate, 1.0)
        self._machine.apply_rate(now_ns)

    def follow(
        self,
        leader: LeaderPosition,
        now_ns: int,
        trim_max_ratio: float = TRIM_MAX_RATIO,
        closing_s: float = CLOSING_S,
    ) -> float | None:
        """Trim the show clock so that it meets `leader`; return how far off it is, in seconds.

        None, and nothing happens, while no show plays at a steady rate.
        """
        if self.show is None or self._machine.phase is not Phase.SHOW:
            return None
        return self.show.clock.follow(leader, now_ns, trim_max_ratio, closing_s)

    def hold_before_start(self, now_ns: int) -> None:
        """Stand before the start of a show of which no joint has moved yet, until `run_from`.

        Also before the approach: then the show waits when it has come to its start.
        """
        self._machine.rate, self._present.is_held = 0.0, self.show is None
        if self.show is not None and self._machine.phase is Phase.SHOW:
            self.show.hold_before_start(now_ns)

    def run_from(self, show_s: float, now_ns: int) -> None:
        """Let a show that stands before its start be at `show_s` now, and run from there on.

        At most at its first instant: until then nothing moves.
        """
        self._note_stall(now_ns)
        if self.show is not None and self._machine.phase is Phase.SHOW:
            self._machine.rate = 1.0
            self.show.run_from(show_s, now_ns)

    def seek(self, place: float | str, now_ns: int) -> None:
        """Go on from a show time or a label: brake, move there at the approach speed, rejoin.

        A paused show stands there until it is resumed. Raises `InputError` for a place that is not
        in the show, and where the run cannot seek: a walk, or a run that recovers or ends.
        """
        if self._present.phase is Phase.STANDING or self.is_leaving:
            raise InputError("no show is played that could go to another place")
        show_s = self.program.instant_of(place)
        if self._present.was_open:
            raise InputError("a walk has no times to go to")
        self._refuse_at_end("the show cannot go to another place now, it")
        self._note_stall(now_ns)
        self._machine.seek_s = show_s
        self._machine.leave(now_ns)

    def change_to(
        self, program: Program | None, now_ns: int, *, start_s: float | None = None
    ) -> None:
        """Play another program in place of the present one, from `start_s` on; None: only hold.

        What plays brakes; if it rests, the way to the new start begins at once. Raises `InputError`
        for a program that the run was not prepared for, and while it recovers or ends.
        """
        if program is not None:
            self.repertoire.require(program)
            start_s = None if start_s is None else program.instant_of(start_s)
        self._refuse_at_end("no other show can begin now, the run")
        self._note_stall(now_ns)
        self._present.next, self._machine.seek_s = Start(program, start_s), None
        self._present.is_held = False
        joints = set() if program is None else set(program.start_deg)
        in_the_way = [one for one in self._added.shows if one.joints & joints]
        self._machine.events += self._added.leave(in_the_way, now_ns)
        is_resting = self._machine.streamer is not None and self._machine.streamer.is_resting(
            now_ns
        )
        if is_resting and not in_the_way and self._machine.phase in (*PLAYING, Phase.APPROACH):
            self._machine.go_on(now_ns)
        else:
            self._machine.leave(now_ns)

    def add(self, program: Program, now_ns: int, *, start_s: float | None = None) -> None:
        """Play a program beside the present one, with a show clock of its own.

        While another program takes the place of the present one, it begins after that. Raises
        `InputError` if its joints are in use, the lines have no room, or as `change_to`.
        """
        self.repertoire.require(program)
        self._refuse_at_end("no show can be added now, the run")
        self._added.require(program)
        start_s = None if start_s is None else program.instant_of(start_s)
        self._note_stall(now_ns)
        self._added.add(program, start_s)
        self._machine.begin_added(now_ns)

    def end_added(self, name: str, now_ns: int) -> None:
        """Brake a program that was added; its joints stay there. Raises `InputError`."""
        if name not in self.added:
            raise InputError(f"no show {name!r} was added; {known_names(name, self.added)}")
        self._note_stall(now_ns)
        self._machine.events += self._added.end(name, now_ns)

    def finish(self, now_ns: int) -> None:
        """End the run as one that was played to its end, so that it ends as the robot file says.

        What plays brakes. The joints of a robot with `end: limp` are limp then.
        """
        if self._machine.outcome is None and self._machine.phase is not Phase.DONE:
            self._machine.end("finished", now_ns)

    def _refuse_at_end(self, what: str) -> None:
        if self._machine.phase in ENDING:
            raise InputError(f"{what} is {self._machine.phase.value}")

    def wake_at(self, instant_ns: int) -> None:
        """Let `next_wakeup_ns` be no later than `instant_ns`, for who acts at that instant."""
        heapq.heappush(self._wakes_ns, instant_ns)

    def extend(self, extension: Extension, now_ns: int) -> bool:
        """Go on with `extension` from its splice on; False if it is too late or no show plays."""
        return self._machine.phase is Phase.SHOW and self._present.extend(extension, now_ns)

    def edit(self, edit: ProgramEdit, now_ns: int) -> None:
        """Go on with an edited program from its splice on; raises `InputError` if it cannot.

        That is while the one show of this run plays or is paused, and not on a way back.
        """
        is_led = self._present.was_open or self._present.own is None
        if self._machine.phase is not Phase.SHOW or is_led or self.repertoire.only is None:
            raise InputError(
                "no show plays that can be edited now; it plays from the next start on"
            )
        self._present.edit(edit, now_ns)

    def close(self) -> None:
        """Accept no more extensions: the show ends where its program does."""
        self._present.close()

    def stop(self, now_ns: int) -> None:
        """Brake within the limits and hold; then restore and end. The second call is `abort`.

        A program that was open is played to its end instead, since it ends at rest. If the show has
        just ended by itself, the first call lets it go on restoring.
        """
        self._stops += 1
        if self._machine.phase is Phase.SHOW and self._present.was_open:
            self._machine.outcome = self._machine.outcome or "stopped"
            self.close()
            if self._stops > 1:
                self.abort(now_ns)
        elif self._machine.phase in (Phase.STOP, Phase.RESTORE):
            if self._stops > 1:
                self.abort(now_ns)
        elif self._machine.phase is not Phase.DONE:
            self._machine.end("stopped", now_ns)

    def abort(self, now_ns: int) -> None:
        """End at once: only the safe state is sent; settings are not given back."""
        self._machine.outcome = self._machine.outcome or "stopped"
        if self._machine.has_set and (text := self._session.unrestored_text()):
            self._machine.events.append(Warned(text))
        self._machine.finish(now_ns)

    def end_show(self, now_ns: int) -> None:
        """Note that the show, if there was one, is over; the first call counts."""
        self._machine.end_show(now_ns)

    def lose_sound(self, text: str, now_ns: int) -> None:
        """Note that a sound cannot be played; end the show if `on_fault` requires it."""
        is_over = self._machine.faults.lose_sound(text) is Verdict.END
        if is_over and self._machine.phase not in (Phase.STOP, Phase.RESTORE, Phase.DONE):
            self._machine.end("fault", now_ns)
        self._machine.report_faults()

    # ---- calls of the owner of the ports

    def waits_for_port(self, bus: str) -> bool:
        """Return whether a port that is lost now should be opened again if it comes back."""
        is_under_way = self._machine.has_moved and self._machine.phase not in (
            Phase.RESTORE,
            Phase.DONE,
        )
        return is_under_way and self._machine.faults.is_resumable(bus)

    def port_lost(self, bus: str, reason: str, now_ns: int) -> None:
        """Brake on the other buses, and wait for this one or end, as `on_fault` requires."""
        verdict = self._machine.faults.lose_port(bus, reason, now_ns)
        if verdict is Verdict.END:
            self._machine.error = LostPortError(reason, url=self.robot.buses[bus].port)
            self._machine.end("fault", now_ns)
        elif self._machine.phase is not Phase.STOP:
            self._machine.recover(now_ns)

    def port_found(self, bus: str) -> None:
        """Go on with a port that was lost."""
        self._machine.faults.find_port(bus)


def _stall_text(gap_ns: int, show_s: float | None) -> str:
    """Return the text of the fault after a stall in which moves were due."""
    where = "" if show_s is None else f" at {show_s:.2f} s of the show"
    return (
        f"this program was held up for {s_from_ns(gap_ns):.2f} s{where}: {STALL_REASON}. The moves "
        f"of that time were not sent"
    )


class StallDetector:
    """Detects that the process was stopped or got no processor time when something was due."""

    def __init__(self) -> None:
        self.wakeup_ns: int | None = None
        """When the player must be called at the latest; its owner sets it."""
        self._named = 0

    def gap_ns(self, now_ns: int) -> int:
        """Return by how much the call at `now_ns` is too late; 0: not by `GAP_NS`."""
        wakeup_ns, self.wakeup_ns = self.wakeup_ns, None
        gap_ns = 0 if wakeup_ns is None else now_ns - wakeup_ns
        return gap_ns if gap_ns >= GAP_NS else 0

    def is_held_up(self, now_ns: int, by_ns: int = HELD_UP_NS) -> bool:
        """Return whether the call at `now_ns` is too late by more than `by_ns`."""
        return self.wakeup_ns is not None and now_ns - self.wakeup_ns > by_ns

    def warning(self, gap_ns: int) -> str | None:
        """Return the warning about a delay in which no move was due; None: there were enough."""
        if self._named == NAMED_MAX:
            return None
        self._named += 1
        last = ". Further delays are not reported" if self._named == NAMED_MAX else ""
        return (
            f"this program was held up for {s_from_ns(gap_ns):.2f} s: {STALL_REASON}. No move was "
            f"due meanwhile{last}"
        )
