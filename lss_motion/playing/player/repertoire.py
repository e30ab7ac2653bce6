"""The programs of one run, and what they need together: joints, drives, sensors, lights, functions.

The servos are checked and get their settings once, for all programs. So what can be played later is
what the run was prepared for (`Repertoire.require`). While one program is played, the other joints
of the run hold: `Repertoire.widened` adds them to it as joints without moves. The run of one show
has a repertoire of one program, and ends with it (`Repertoire.single`).

`PresentShow` is what a run plays now: its program, its clock once it has begun, and how it went; of
a run with many shows, also which one is next, and where the joints are held that no show moves.
`summary_of` is how one show went, in a few numbers: for the log and for what decides about the next
one. A run may play thousands of shows, so it is small, has no traces, and is made in less than a
millisecond, between two moves.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.planning.program.model import TIMED, Driving, Program
from lss_motion.planning.trajectory.model import WaitPoint
from lss_motion.playing.player.cues import LED_KEYWORD, Agenda
from lss_motion.playing.player.events import JointSummary, Phase, ShowBegan, ShowOver, ShowSummary
from lss_motion.playing.player.query_choice import BY_NEED, ON_STAGE
from lss_motion.show.model import Wait

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from lss_motion.planning.program.live_edit import ProgramEdit
    from lss_motion.planning.program.splice import Extension
    from lss_motion.playing.player.events import Event, ShowOutcome, Waited
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.playing.player.session import Session
    from lss_motion.playing.player.streamer import Streamer
    from lss_motion.robot.model import Robot


STANDING: Final = "standing"
"""Name of the program that holds all joints where they are."""
STANDING_TOLERANCE_DEG: Final = 0.2
"""Tolerance of a program without moves. Chosen: that of a compiled show."""


class Repertoire:
    """The programs of one run by name. Raises `InputError` if one robot cannot play them all."""

    def __init__(
        self,
        programs: Mapping[str, Program],
        robot: Robot,
        *,
        watched: Iterable[str] = (),
        pace: Pace | None = ON_STAGE,
        only: Program | None = None,
    ) -> None:
        """Take the programs by name, and the sensors that are watched besides theirs.

        `pace`: how often angles are queried; None: as often as the lines allow. `only` is the
        program of a run that ends with it, and then is the one in `programs`. Programs name the
        servos of the robot.
        """
        robot = robot.servo_robot
        self.pace = pace
        self.programs = {name: _named(one, name) for name, one in programs.items()}
        self.only = only
        """The program with which the run ends; None: the run goes on until it is stopped."""
        self._robot = robot
        self._drivings: dict[str, Driving] = {}
        for program in self.programs.values():
            self._add_joints(program)
        names = robot.joints if only is None else only.start_deg
        self.joints = tuple(name for name in names if name in self._drivings)
        """The joints of the run: in the order of the robot file, or of its only program."""
        if not self.joints and only is None:
            raise InputError("a stage needs at least one show that moves a joint")
        self.watched = tuple(watched)
        self._sensors = {p.wait.sensor for one in self.programs.values() for p in one.waits}
        cues = [cue for one in self.programs.values() for cue in one.cues]
        self._lights = {name for cue in cues for name, _ in cue.led}
        self._functions = {cue.run for cue in cues if cue.run}
        self._has_sounds = any(cue.sound for cue in cues)

    @classmethod
    def single(cls, program: Program, robot: Robot, *, pace: Pace | None = BY_NEED) -> Repertoire:
        """Return the repertoire of a run that plays `program` and ends with it."""
        return cls({program.name: program}, robot, pace=pace, only=program)

    def needs(self, first: Program | None) -> Program:
        """Return what all programs need together, as one program that is checked, not played.

        Its joints start where those of `first` do; NaN: they stay where they are. Of a run with an
        only program it is that one, which is played.
        """
        if self.only is not None:
            return self.only
        together, start_deg = self.programs.values(), {} if first is None else first.start_deg
        return self._program(
            "stage",
            {name: start_deg.get(name, math.nan) for name in self.joints},
            waits=(*(point for one in together for point in one.waits), *self._watched_points()),
            cues=tuple(cue for one in together for cue in one.cues),
        )

    def _watched_points(self) -> Iterator[WaitPoint]:
        """Yield a wait for each watched sensor, so that it is checked as those of shows are."""
        for name in self.watched:
            wait = Wait(sensor=name, side="above", threshold=math.inf)
            yield WaitPoint(at_s=math.inf, wait=wait)

    def _add_joints(self, program: Program) -> None:
        for name in program.start_deg:
            if name not in self._robot.joints:
                raise InputError(
                    f"show {program.name!r} moves joint {name!r}, which robot "
                    f"{self._robot.name!r} does not have: {known_names(name, self._robot.joints)}; "
                    f"compile it for this robot"
                )
            known = self._drivings.setdefault(name, _driving(program, name))
            if known != _driving(program, name):
                raise InputError(self._drive_text(program, name, known))

    @staticmethod
    def _drive_text(program: Program, name: str, known: Driving) -> str:
        own = _driving(program, name)
        return (
            f"show {program.name!r} drives joint {name!r} {_drive_words(own)}, another show drives "
            f"it {_drive_words(known)}, and its servo is set up once for all shows. Write "
            f"`drive: timed` or `drive: streamed` at this joint in the robot file instead of `auto`"
        )

    def require(self, program: Program) -> None:
        """Raise `InputError` if this run was not prepared for `program`."""
        lacks: list[str] = []
        if joints := [name for name in program.start_deg if name not in self._drivings]:
            lacks.append(f"joint {', '.join(joints)}")
        for name in program.start_deg:
            known = self._drivings.get(name)
            if known is not None and known != _driving(program, name):
                raise InputError(self._drive_text(program, name, known))
        sensors = {point.wait.sensor for point in program.waits} - self._sensors
        lights = {name for cue in program.cues for name, _ in cue.led} - self._lights
        functions = {cue.run for cue in program.cues if cue.run} - self._functions
        lacks += [f"sensor {name}" for name in sorted(sensors)]
        lacks += [f"the light of {name}" for name in sorted(lights)]
        lacks += [f"function {name}" for name in sorted(functions)]
        if not self._has_sounds and any(cue.sound for cue in program.cues):
            lacks.append("sound")
        if lacks:
            raise InputError(
                f"show {program.name!r} needs what this run was not prepared for: "
                f"{'; '.join(lacks)}. Stop the stage and start it with this show"
            )

    def renew(self, programs: Mapping[str, Program]) -> None:
        """Take newer programs in place of all; raise `InputError`, and take none, as `require`."""
        renewed = {name: _named(one, name) for name, one in programs.items()}
        for program in renewed.values():
            self.require(program)
        self.programs = renewed

    def widened(self, program: Program, held_deg: Mapping[str, float]) -> Program:
        """Return `program` with all joints of the run; those that it lacks stay at `held_deg`."""
        start_deg = {name: program.start_deg.get(name, held_deg[name]) for name in self.joints}
        return replace(program, start_deg=start_deg, drives=self._drives())

    def standing(self, held_deg: Mapping[str, float]) -> Program:
        """Return the program that holds all joints at `held_deg` until it is replaced."""
        return self._program(STANDING, {name: held_deg[name] for name in self.joints})

    def _drives(self) -> dict[str, Driving]:
        return {name: one for name, one in self._drivings.items() if one != TIMED}

    def _program(self, name: str, start_deg: Mapping[str, float], **more: object) -> Program:
        made = Program(
            name=name,
            robot=self._robot.name,
            robot_path=self._robot.path,
            moves=(),
            duration_s=math.inf,
            start_deg=start_deg,
            tolerance_deg=STANDING_TOLERANCE_DEG,
            drives=self._drives(),
        )
        return replace(made, **more)


def _named(program: Program, name: str) -> Program:
    return program if program.name == name else replace(program, name=name)


def _driving(program: Program, name: str) -> Driving:
    return program.drives.get(name, TIMED)


def _drive_words(driving: Driving) -> str:
    if driving.drive != "streamed":
        return f"as {driving.drive}"
    return f"as {driving.drive} with a filter of {driving.filter_count}"


class Start(NamedTuple):
    """A program and the show time from which it is played; None: its beginning."""

    program: Program | None
    """None: no show, all joints hold."""
    start_s: float | None


class PresentShow:
    """What a run plays now, on all joints that no added show moves."""

    def __init__(
        self,
        repertoire: Repertoire,
        session: Session,
        needs: Program,
        first: Program | None,
        start_s: float | None,
        *,
        is_open: bool,
    ) -> None:
        """Begin with the only program of the repertoire, or let `first` be the next one.

        `needs` is what all programs need together.
        """
        self._repertoire = repertoire
        self._session = session
        self.program = needs
        """The program with all joints of the run; before the first show, what all need together."""
        self.own = repertoire.only
        """The program without the joints that it does not move; None: all hold."""
        self.start_s = start_s
        self._from_s = None if self.own is None else start_s
        """Show time at which the show begins: another one if it was sent elsewhere before."""
        self.agenda = Agenda(needs, session.robot)
        self.agenda.begin_at(self._from_s)
        self.streamer: Streamer | None = None
        """The show itself, once it has begun."""
        self.next = None if self.own is not None else Start(first, start_s)
        """What is played once the robot stands, in place of this."""
        self.changes = 0
        """How often another program has taken the place of the one before it."""
        self.is_open = self.was_open = is_open
        """Whether the show may be extended, so that it does not end; and whether it began so."""
        self.is_held = False
        """Whether a show that is to begin stands before its start until `Player.run_from`."""
        self.held_deg: dict[str, float] = {}
        """Joint angles where the joints are to stand that no show moves."""
        self.ended_ns: int | None = None
        """When the show had ended but for its goal tolerances."""
        self.goal_ns: int | None = None
        """When the time of a joint to come within its goal tolerance is over."""
        self._began_ns: int | None = None
        """When it began; None: it has not, all hold, or the run ends with it: its report is that
        of the run."""

    @property
    def phase(self) -> Phase:
        """Return the phase in which this is played."""
        return Phase.STANDING if self.own is None else Phase.SHOW

    @property
    def joints(self) -> set[str]:
        """Return the joints that the show moves."""
        return set() if self.own is None else set(self.own.start_deg)

    @property
    def coming(self) -> Program | None:
        """Return the show, or that which takes its place; None: all hold."""
        return self.own if self.next is None else self.next.program

    def hold_at(self, servo_deg: Mapping[str, float]) -> None:
        """Hold the joints that no show moves at these servo angles."""
        joints = self._session.robot.joints
        self.held_deg = {name: joints[name].joint_deg(deg) for name, deg in servo_deg.items()}

    def change(self, outcome: ShowOutcome, last: Streamer | None, now_ns: int) -> list[Event]:
        """Let the next program take this place, where all joints stand; return what is reported.

        `last` has moved the joints until now. The colours that the show before has given to the
        lights are taken back.
        """
        assert self.next is not None
        events = self.over(outcome, now_ns)
        if last is not None:
            self.held_deg |= last.pose_deg(now_ns)
        (self.own, self.start_s), self.next = self.next, None
        self.changes += 1
        lit = {name for cue in self.program.cues for name, _ in cue.led}
        self.program, self._from_s = self._whole(), self.start_s
        self.agenda = Agenda(self.program, self._session.robot)
        self.agenda.begin_at(self._from_s)
        for joint in self._session.joints:
            colour = self._session.original.get((joint.bus, joint.servo_id, f"Q{LED_KEYWORD}"))
            if joint.name in lit and isinstance(colour, int):
                self.agenda.light(joint, colour)
        self._session.on_fault = self.program.on_fault
        self.streamer = self.ended_ns = self.goal_ns = None
        return events

    def seek(self, show_s: float, now_ns: int) -> None:
        """Let the show, which stands or has not begun, go on from `show_s`."""
        self.agenda.begin_at(show_s)
        self.ended_ns = self.goal_ns = None
        if self.streamer is None:
            self._from_s = show_s
        else:
            self.streamer.jump_to(show_s, now_ns)

    def start_deg(self) -> dict[str, float]:
        """Return the joint angles at which the show begins, also in its middle."""
        return self._session.start_of(self.program, self._from_s)

    def pose_deg(self, now_ns: int) -> dict[str, float]:
        """Return the angles of the driven joints from which the show begins, or goes on."""
        show, session = self.streamer, self._session
        pose_deg, lent = self.start_deg() if show is None else show.pose_deg(now_ns), session.lent
        return {n: pose_deg[n] for n in (joint.name for joint in session.driven) if n not in lent}

    def hold_also(self, deg: Mapping[str, float]) -> None:
        """Hold these joints, of a show that is over, where they are."""
        self.held_deg |= deg
        if self.streamer is None:
            self.program = self._whole()

    def _whole(self) -> Program:
        """Return the present program with all joints of the run."""
        if self.own is None:
            return self._repertoire.standing(self.held_deg)
        return self._repertoire.widened(self.own, self.held_deg)

    def begin(self, start_ns: int) -> Streamer:
        """Return the streamer of the show, which starts at `start_ns`."""
        self.streamer = self._session.begin(self.program, self._from_s, start_ns)
        self.streamer.is_open = self.is_open
        return self.streamer

    def note_wait(self, streamer: Streamer) -> list[Waited]:
        """Return what a streamer has waited for; the agenda goes back where the show did."""
        if (back_at_s := streamer.take_way_back()) is not None:
            self.agenda.go_back(back_at_s)
        return streamer.waiting.take_notices()

    def begun(self, now_ns: int) -> list[Event]:
        """Note that a show begins, if one does; return what is reported of it."""
        if self.streamer is not None or self.own is None or self._repertoire.only is not None:
            return []
        self._began_ns = now_ns
        return [ShowBegan(self.program.name, self.start_s or 0.0)]

    def over(self, outcome: ShowOutcome, now_ns: int) -> list[Event]:
        """Note that the show is over; return what is reported of it, if it has begun."""
        began_ns, self._began_ns = self._began_ns, None
        if self.streamer is None or began_ns is None:
            return []
        summary = summary_of(
            self.program,
            self.streamer,
            outcome=outcome,
            from_s=self.start_s or 0.0,
            began_ns=began_ns,
            ended_ns=now_ns,
            joints=self.joints,
        )
        return [ShowOver(summary)]

    def extend(self, extension: Extension, now_ns: int) -> bool:
        """Go on with `extension` from its splice on; False if it is too late.

        `program` keeps the moves that it had at the start.
        """
        if self.streamer is None or not self.is_open or not self.streamer.extend(extension, now_ns):
            return False
        end_s, use = extension.duration_s, extension.line_use
        self.program = replace(self.program, duration_s=end_s, line_use=use)
        return True

    def edit(self, edit: ProgramEdit, now_ns: int) -> None:
        """Go on with an edited program; raises `InputError` if that comes too late."""
        show = self.streamer
        if show is None or not show.extend(edit.extension, now_ns, edit.program):
            raise InputError(
                f"it comes too late for the splice at {edit.splice_s:.2f} s; it plays from the "
                "next start on"
            )
        self.program = self.own = edit.program
        self.agenda.go_on(edit.program, show.clock.show_s(now_ns))

    def close(self) -> None:
        """Accept no more extensions."""
        self.is_open = False
        if self.streamer is not None:
            self.streamer.is_open = False


def summary_of(
    program: Program,
    show: Streamer,
    *,
    outcome: ShowOutcome,
    from_s: float,
    began_ns: int,
    ended_ns: int,
    joints: Collection[str],
    is_added: bool = False,
) -> ShowSummary:
    """Return the summary of a show that is over at `ended_ns` and has moved `joints`."""
    timing = show.statistics.timing()
    states = show.joint_states
    reached_s = min(max(show.show_s(ended_ns), 0.0), program.duration_s)
    return ShowSummary(
        name=program.name,
        outcome=outcome,
        is_added=is_added,
        from_s=from_s,
        reached_s=reached_s,
        began_ns=began_ns,
        ended_ns=ended_ns,
        commands=timing["commands"],
        missed=timing["missed"],
        late_max_us=timing["late_max_us"],
        joints={name: _joint(states[name]) for name in states if name in joints},
    )


def _joint(state: JointState) -> JointSummary:
    load = state.disturbance
    return JointSummary(
        error_rms_deg=round(load.error_rms_deg, 3),
        error_max_deg=round(load.error_max_deg, 3),
        resent=state.resent,
        temperature_max_c=state.temperature_max_c,
        voltage_min_v=state.voltage_min_v,
        current_max_a=state.current_max_a,
    )
