"""Plays many programs in one run: the servos are checked and set up once, and stay so.

    change_to(program, now_ns)   plays another program in place of the present one
    add(program, now_ns)         plays another program beside it, on joints that it does not move
    end_added(name, now_ns)      ends a program that was added
    stop(now_ns)                 ends the run, as in a run of one program

Between two shows the robot is never without a streamer. What plays brakes; an approach leads to the
start of the next program; or a program without moves holds all joints (`Phase.STANDING`), and the
servos are polled, corrected and watched as in a show. A joint that the present program does not
move stays where it is, unless a program that was added moves it (`added_show`). Faults, stalls,
lost ports, signals and stops work in every phase as they do in a run of one program.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.errors import InputError
from lss_motion.files.source import known_names
from lss_motion.playing.player.added_show import READINGS_NS, STILL_NS, AddedShow
from lss_motion.playing.player.approach import approach_s
from lss_motion.playing.player.cues import SensorWatch
from lss_motion.playing.player.events import Phase, ShowBegan, ShowOver, Warned
from lss_motion.playing.player.player import DRIVING, PLAYING, Player
from lss_motion.playing.player.query_choice import ON_STAGE
from lss_motion.playing.player.show_summary import summary_of
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import ShowOutcome
    from lss_motion.playing.player.player import Outcome
    from lss_motion.playing.player.preflight import Preflight
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.robot.model import Robot


LINE_RATIO: Final = 0.85
"""Shows that are played together may use so much of a line, each in its busiest 100 ms, if these
fall together. Chosen: the rest is for queries, and for moves that wait for each other."""


def why_not_beside(program: Program) -> str:
    """Return what only a program can do that plays alone; empty if this one can be added.

    A wait stops the show clock of the run, and the sounds are on one clock.
    """
    if program.waits:
        return "waits for a sensor"
    return "has sounds" if any(cue.sound for cue in program.cues) else ""


class _Next(NamedTuple):
    """The program that takes the place of the present one; None: all joints hold."""

    program: Program | None
    start_s: float | None


class StagePlayer(Player):
    """Plays the programs of a repertoire, one after the other, until it is stopped."""

    def __init__(
        self,
        repertoire: Repertoire,
        robot: Robot,
        *,
        first: Program | None = None,
        has_feedback: bool = True,
        must_ask: bool = False,
        is_forced: bool = False,
        pace: Pace | None = ON_STAGE,
    ) -> None:
        """Begin with `first`; None: all joints hold where they are. The others: see `Player`."""
        if first is not None:
            repertoire.require(first)
        super().__init__(
            repertoire.needs(first),
            robot,
            has_feedback=has_feedback,
            must_ask=must_ask,
            is_forced=is_forced,
            pace=pace,
        )
        self.repertoire = repertoire
        self.watched = SensorWatch(self.robot.sensors[name] for name in repertoire.watched)
        """The sensors of the repertoire that a caller watches."""
        self._session.watched = self.watched
        self._held_deg: dict[str, float] = {}
        """Joint angles where the joints are to stand that no show moves."""
        self._next: _Next | None = _Next(first, None)
        """What is played once the robot stands, in place of the present program."""
        self._played: Program | None = None
        """The present program, without the joints that it does not move; None: all hold."""
        self._began_ns: int | None = None
        """When the present show began; None: it has not, or nothing is played."""
        self._added: list[AddedShow] = []
        self._to_add: list[_Next] = []
        """Programs that are added as soon as a show plays, or all joints hold."""
        self._is_together = False
        """After a recovery: one approach leads all joints to where their shows go on."""
        self._arrived_ns: int | None = None
        """When the approach had come to its end while added shows go on."""

    # ---- state

    @property
    def is_idle(self) -> bool:
        """Whether all joints hold, and no show is to come."""
        return self.phase is Phase.STANDING and not self._added

    @property
    def added(self) -> tuple[str, ...]:
        """The names of the programs that are played beside the present one, or will be."""
        to_add = [one.program for one in self._to_add if one.program is not None]
        return tuple(program.name for program in (*(one.program for one in self._added), *to_add))

    @property
    def moved_joints(self) -> set[str]:
        """The joints of the present show, and of those beside it."""
        return self._own_joints.union(*(one.joints for one in self._added))

    @property
    def _own_joints(self) -> set[str]:
        return set() if self._played is None else set(self._played.start_deg)

    @property
    def is_leaving(self) -> bool:
        return self._next is not None

    def show_s(self, now_ns: int) -> float:
        """Return the show time of the present show; 0 before it has begun."""
        return 0.0 if self.show is None else self.show.show_s(now_ns)

    def way_s(self, program: Program, show_s: float | None, now_ns: int) -> float:
        """Return about how long the way to a show time of a program takes, without braking.

        None: to its beginning.
        """
        to_deg = self._session.start_of(program, show_s)
        return approach_s(self.robot, to_deg | self._pose_deg(now_ns), to_deg)

    # ---- commands

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
        if self.phase in (Phase.RECOVER, Phase.STOP, Phase.RESTORE, Phase.DONE):
            raise InputError(f"no other show can begin now, the run is {self.phase.value}")
        self._note_stall(now_ns)
        self._next, self._seek_s = _Next(program, start_s), None
        self._is_held = False
        joints = set() if program is None else set(program.start_deg)
        in_the_way = [one for one in self._added if one.joints & joints]
        for one in in_the_way:
            self._leave_added(one, now_ns)
        is_resting = self._streamer is not None and self._streamer.is_resting(now_ns)
        if is_resting and not in_the_way and self.phase in (*PLAYING, Phase.APPROACH):
            self._go_on(now_ns)
        else:
            self._leave(now_ns)

    def finish(self, now_ns: int) -> None:
        """End the run as one that was played to its end, so that it ends as the robot file says.

        What plays brakes. The joints of a robot with `end: limp` are limp then.
        """
        if self.outcome is None and self.phase is not Phase.DONE:
            self._end("finished", now_ns)

    def seek(self, place: float | str, now_ns: int) -> None:
        if self._show_phase is Phase.STANDING or self._next is not None:
            raise InputError("no show is played that could go to another place")
        super().seek(place, now_ns)

    def add(self, program: Program, now_ns: int, *, start_s: float | None = None) -> None:
        """Play a program beside the present one, with a show clock of its own.

        While another program takes the place of the present one, it begins after that. Raises
        `InputError` if its joints are in use, the lines have no room, or as `change_to`.
        """
        self._require_addable(program)
        start_s = None if start_s is None else program.instant_of(start_s)
        self._note_stall(now_ns)
        self._to_add.append(_Next(program, start_s))
        self._add_waiting(now_ns)

    def end_added(self, name: str, now_ns: int) -> None:
        """Brake a program that was added; its joints stay there. Raises `InputError`."""
        if name not in self.added:
            raise InputError(f"no show {name!r} was added; {known_names(name, self.added)}")
        self._note_stall(now_ns)
        self._to_add = [one for one in self._to_add if one.program and one.program.name != name]
        for one in [one for one in self._added if one.program.name == name]:
            self._leave_added(one, now_ns)

    def _wakeups_ns(self) -> list[int | None]:
        return super()._wakeups_ns() + [one.next_wakeup_ns(self._now_ns) for one in self._beside]

    # ---- from one program to the next

    def _connected(self, preflight: Preflight) -> None:
        super()._connected(preflight)
        joints = self.robot.joints
        standing_deg = self._session.standing_deg
        self._held_deg = {name: joints[name].joint_deg(deg) for name, deg in standing_deg.items()}

    def _go_on(self, now_ns: int) -> None:
        if self._next is None or self._next.program is not None:
            super()._go_on(now_ns)
            return
        self._session.note_standing(now_ns)
        self._change("left", now_ns)
        self._stand(now_ns)

    def _approach(self, now_ns: int) -> None:
        if self._next is not None:
            self._change("left", now_ns)
        super()._approach(now_ns)
        self._held_deg |= self._session.pose_deg(self.show, now_ns)

    def _after_show(self, now_ns: int) -> None:
        if self.phase is not Phase.SHOW:
            super()._after_show(now_ns)
            return
        self._next = _Next(None, None)
        self._change("fault" if self.outcome == "fault" else "finished", now_ns)
        self.outcome = None
        self._stand(now_ns)

    def _change(self, outcome: ShowOutcome, now_ns: int) -> None:
        """Take the next program in place of the present one, where all joints stand."""
        assert self._next is not None
        self._end_summary(outcome, now_ns)
        if (last := self._streamer or self.show) is not None:
            self._held_deg |= last.pose_deg(now_ns)
        (program, self.start_s), self._next = self._next, None
        self._played = program
        self.changes += 1
        self._show_phase = Phase.STANDING if program is None else Phase.SHOW
        self.program = self._whole()
        self._session.change(self.program, self.start_s)
        self._faults.escalation.change_show(self.program.on_fault)
        self.show = self._ended_ns = self._goal_ns = None

    def _whole(self) -> Program:
        """Return the present program with all joints of the run."""
        if self._played is None:
            return self.repertoire.standing(self._held_deg)
        return self.repertoire.widened(self._played, self._held_deg)

    def _stand(self, now_ns: int) -> None:
        """Hold all joints where they are until the next show."""
        self._enter(Phase.STANDING)
        self.show = self._streamer = self._session.begin(now_ns, is_open=False)
        self._apply_rate(now_ns)
        self._add_waiting(now_ns)

    def _begin(self, now_ns: int) -> None:
        if self.show is None and self._show_phase is Phase.SHOW:
            self._began_ns = now_ns
            self._events.append(ShowBegan(self.program.name, self.start_s or 0.0))
        super()._begin(now_ns)
        if self._is_together:
            self._is_together = False
            for one in self._added:
                self._events += one.go_on(now_ns)
            self._share_lines()
            self._apply_rate(now_ns)
        self._add_waiting(now_ns)

    def end_show(self, now_ns: int) -> None:
        super().end_show(now_ns)
        outcome: ShowOutcome = "fault" if self.outcome == "fault" else "stopped"
        self._end_summary(outcome, now_ns)
        for one in self._added:
            self._events += one.end(outcome, now_ns)

    def _end_summary(self, outcome: ShowOutcome, now_ns: int) -> None:
        """Report the present show, if it has begun."""
        began_ns, self._began_ns = self._began_ns, None
        if self.show is not None and began_ns is not None:
            summary = summary_of(
                self.program,
                self.show,
                outcome=outcome,
                from_s=self.start_s or 0.0,
                began_ns=began_ns,
                ended_ns=now_ns,
                joints=self._own_joints,
            )
            self._events.append(ShowOver(summary))

    # ---- shows beside the present one

    @property
    def _beside(self) -> Sequence[AddedShow]:
        """The added shows that have streamers of their own now."""
        return () if self._is_together or self._dialogue is not None else self._added

    def _require_addable(self, program: Program) -> None:
        """Raise `InputError` if a program cannot be played beside the present one."""
        self.repertoire.require(program)
        ending = (Phase.RECOVER, Phase.STOP, Phase.RESTORE, Phase.DONE)
        if self.phase in ending:
            raise InputError(f"no show can be added now, the run is {self.phase.value}")
        main = self._played if self._next is None else self._next.program
        others = [
            main,
            *(one.program for one in self._added if not one.is_leaving),
            *(one.program for one in self._to_add),
        ]
        for other in others:
            shared = [] if other is None else [n for n in program.start_deg if n in other.start_deg]
            if other is not None and shared:
                raise InputError(
                    f"show {program.name!r} cannot be added: show {other.name!r} moves its joint "
                    f"{shared[0]!r}; play it in place of that show, or after it"
                )
        if what := why_not_beside(program):
            raise InputError(
                f"show {program.name!r} cannot be added: it {what}, which only the show that plays "
                f"alone can; play it in place of the other, or take that part out"
            )
        for bus, use in program.line_use.items():
            uses = [one.line_use[bus] for one in others if one is not None and bus in one.line_use]
            ratio = sum(one.worst_100_ms_ratio for one in (*uses, use))
            if ratio > LINE_RATIO:
                raise InputError(
                    f"show {program.name!r} cannot be added: together the shows need "
                    f"{100.0 * ratio:.0f} % of line {bus!r} in their busiest 100 ms, and have "
                    f"{100.0 * LINE_RATIO:.0f} %; raise the baud rate, or use a second bus"
                )

    def _add_waiting(self, now_ns: int) -> None:
        """Begin the programs that were to be added, if that can be now."""
        if self.phase not in PLAYING or self._is_together:
            return
        to_add, self._to_add = self._to_add, []
        for program, start_s in to_add:
            assert program is not None
            try:
                self._require_addable(program)  # Another one may have come meanwhile.
            except InputError as refused:
                self._events.append(Warned(str(refused)))
                continue
            self._added.append(AddedShow(program, start_s, self._session, now_ns))
            self._share_lines()

    def _share_lines(self) -> None:
        """Let the servos of all added shows be polled by the present streamer."""
        streamers = [one.streamer for one in self._beside]
        if streamers != self._session.beside:
            self._session.beside = streamers
            if self._streamer is not None:
                self._streamer.play_beside(streamers)

    def _leave_added(self, one: AddedShow, now_ns: int) -> None:
        """Brake an added show; in a recovery all stand, so it is over at once."""
        if self._is_together:
            self._events += one.end("left", now_ns)
            self._added.remove(one)
        else:
            one.leave(now_ns)

    def _take_back(self, one: AddedShow, now_ns: int) -> None:
        """Let the present streamer hold the joints of an added show that is over."""
        self._added.remove(one)
        self._share_lines()
        self._held_deg |= one.streamer.pose_deg(now_ns)
        states = self._session.take_back(one.streamer, now_ns)
        if self.show is None:
            self.program = self._whole()
            self._session.hold(self.program)
        for streamer in {id(s): s for s in (self.show, self._streamer) if s is not None}.values():
            streamer.adopt(states)
            streamer.play_beside(self._session.beside)

    def _advance_streamer(self, now_ns: int) -> None:
        for one in self._beside:
            self._events += one.advance(now_ns)
            if one.astray is not None:
                self._faults.note_astray(*one.astray)
                self._end("fault", now_ns)
        self._share_lines()
        for one in [one for one in self._beside if one.is_over]:
            self._take_back(one, now_ns)
        super()._advance_streamer(now_ns)

    def _has_streamed(self, now_ns: int) -> bool:
        if not super()._has_streamed(now_ns):
            self._arrived_ns = None
            return False
        match self.phase:
            case Phase.STOP | Phase.RECOVER:
                return all(one.streamer.is_standing(now_ns) for one in self._beside)
            case Phase.SEEK:
                return not any(one.is_leaving for one in self._beside)
            case Phase.APPROACH:
                return self._has_read(now_ns)
            case _:
                return True

    def _has_read(self, now_ns: int) -> bool:
        """Return whether it is known where the joints stand after an approach.

        While added shows move others, no dialogue can ask for it: the readings do.
        """
        if not (self._beside and self._session.has_feedback) or self._streamer is None:
            return True
        if self._arrived_ns is None:
            self._arrived_ns = now_ns
        since_s = s_from_ns(self._arrived_ns - STILL_NS)
        is_read = self._session.note_readings(self._streamer, since_s)
        return is_read or now_ns >= self._arrived_ns + READINGS_NS

    def _after_streamer(self, now_ns: int) -> None:
        if self.phase is Phase.RECOVER:
            for one in [one for one in self._added if one.is_leaving]:
                self._events += one.end("left", now_ns)
                self._take_back(one, now_ns)
            self._is_together = True
            self._session.beside = []
        if self.phase is Phase.APPROACH and self._beside and self._session.has_feedback:
            self._arrived_ns = None
            self._judge_arrival(now_ns)
        else:
            super()._after_streamer(now_ns)

    def _pose_deg(self, now_ns: int) -> dict[str, float]:
        pose_deg = super()._pose_deg(now_ns)
        if self._is_together:
            for one in self._added:
                own_deg = one.pose_deg(now_ns)
                pose_deg |= {name: own_deg[name] for name in own_deg if name in pose_deg}
        return pose_deg

    def _recover(self, now_ns: int) -> None:
        super()._recover(now_ns)
        self._brake_added(now_ns)

    def _end(self, outcome: Outcome, now_ns: int) -> None:
        super()._end(outcome, now_ns)
        self._brake_added(now_ns)

    def _brake_added(self, now_ns: int) -> None:
        for one in self._beside:
            one.hold(now_ns)

    def _apply_rate(self, now_ns: int) -> None:
        super()._apply_rate(now_ns)
        if self.phase in DRIVING:
            for one in self._beside:
                one.set_rate(self._rate, self._faults.escalation.rate_max, now_ns)
