"""The programs of one run, and what they need together: joints, drives, sensors, lights, functions.

The servos are checked and get their settings once, for all programs. So what can be played later is
what the run was prepared for (`Repertoire.require`). While one program is played, the other joints
of the run hold: `Repertoire.widened` adds them to it as joints without moves. The run of one show
has a repertoire of one program, and ends with it (`Repertoire.single`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.source import known_names
from lss_motion.planning.program.model import TIMED, Driving, Program
from lss_motion.planning.trajectory.model import WaitPoint
from lss_motion.playing.player.query_choice import BY_NEED, ON_STAGE
from lss_motion.show.model import Wait

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from lss_motion.playing.player.query_choice import Pace
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
        program of a run that ends with it, and then is the one in `programs`.
        """
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
