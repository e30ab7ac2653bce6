"""The text form of a program: stable, diffable, one move a line as `due_us bus command`.

    # lss_motion program 1
    # name: wave
    # robot: desk_arm
    # robot_file: robots/desk_arm.yaml
    # duration_us: 12200000
    # tolerance_deg: 0.2
    # start_deg: base=0 shoulder=45 lid=10
    # drives: shoulder=streamed:4 lid=stepped
    # on_fault: astray=warn silent=resume,hold
    # mark: 1500000 hello
    # wait: 1750000 eye below 300 timeout 60
    # cue: 1500000 {"led": {"elbow": 1}}
    # cue: 2000000 {"sound": "/home/me/show/bell.wav", "lead_s": 0.1}
    1477500 main #1D-612T384
    1478300 main #2D455

A show that repeats a part of itself has a line `# repeat_us: FROM TO TIMES`, without TIMES and with
`duration_us: forever` if it never ends. The moves from TO on come after the last time.

`due_us` is show time in microseconds; 0 is the start of the plan. `drives` names the joints that
are not timed, with the FPC of the streamed ones; a program whose joints are all timed has no such
line. A cue is its instant and a JSON object; a wait is its instant, a sensor and a threshold.
"""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict

from lss_motion.errors import InputError
from lss_motion.files.source import read_text
from lss_motion.planning.program.model import TIMED, Driving, Move, Program, Repeat
from lss_motion.planning.program.move_table import lines_use
from lss_motion.planning.trajectory.model import Mark, WaitPoint
from lss_motion.protocol.constants import Led
from lss_motion.robot.on_fault import escalations_from, escalations_text
from lss_motion.robot.servo_models import drive_problem
from lss_motion.show.model import Cue, SoundStyle, Wait
from lss_motion.units import s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Container, Mapping

    from lss_motion.robot.model import Joint, Robot
    from lss_motion.robot.on_fault import Escalations

_NUMBER = r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)"
_WAIT: Final = re.compile(
    rf"(\d+) (\S+) (below|above) {_NUMBER}(?: timeout {_NUMBER})?(?: idle (\d+))?"
)
FIRST_LINE: Final = "# lss_motion program 1"
FOREVER: Final = "forever"
TIMES_MAX: Final = 1_000_000
"""As often as a sequence may be looped."""
TEXT_MAX_BYTES: Final = 256 * 1024 * 1024
"""A program of ten hours and forty joints. A larger file is not a program."""
REPEATED_MAX_US: Final = 500_000
"""How long after its end a program may repeat the resting place of streamed joints, so that a
filter that missed some targets settles (`streamed`). Chosen: the longest filter needs less."""

DURATION_READ_MAX_MS: Final = 30_000
"""More than the compiler writes, for programs written by hand; a slip is still found."""
_HEADER = re.compile(r"# (\w+): (.*)")
_MOVE = re.compile(r"(-?\d+) (\S+) #(\d{1,3})D(-?\d+)(?:T(\d+))?")
_DRIVE = re.compile(r"(.+)=(?:(streamed):([1-9]\d{0,2})|(stepped))")
_REQUIRED = ("name", "robot", "duration_us", "tolerance_deg", "start_deg")


def cue_line(cue: Cue) -> str:
    """Return the text of a cue after `# cue: `."""
    plain = asdict(SoundStyle())
    content = {
        "led": dict(cue.led),
        "say": cue.say,
        "run": cue.run,
        "folder": cue.folder,
        "sound": cue.sound,
        "lead_s": cue.lead_s,
        "style": {name: value for name, value in asdict(cue.style).items() if value != plain[name]},
    }
    kept = {key: value for key, value in content.items() if value}
    return f"{us_from_s(cue.at_s)} {json.dumps(kept)}"


def read_cue(text: str, joints: Collection[str]) -> Cue:
    """Return the cue that `cue_line` wrote; raises `ValueError` for any other text."""
    at_us, _, body = text.partition(" ")
    try:
        content = json.loads(body)
        at_s = s_from_us(int(at_us))
    except ValueError as error:
        raise ValueError("a cue is a whole number of us and a JSON object") from error
    if not isinstance(content, dict):
        raise ValueError("a cue is a whole number of us and a JSON object")  # noqa: TRY004
    led, lead_s = content.pop("led", {}), content.pop("lead_s", 0.0)
    style = _style(content.pop("style", {}))
    if not isinstance(led, dict) or not all(code in set(Led) for code in led.values()):
        raise ValueError(f"led is joints with colours from {min(Led)} to {max(Led)}")
    if unknown := sorted(led.keys() - set(joints)):
        raise ValueError(f"the robot has no joint {unknown[0]!r}")
    if not isinstance(lead_s, int | float) or not 0.0 <= lead_s < 1e6:
        raise ValueError("lead_s is a time in seconds from 0 on")
    if not content.keys() <= {"say", "run", "folder", "sound"} or not all(
        isinstance(value, str) for value in content.values()
    ):
        raise ValueError("a cue has led, say, run with folder, or sound with lead_s")
    return Cue(at_s=at_s, led=tuple(led.items()), lead_s=float(lead_s), style=style, **content)


def _style(values: object) -> SoundStyle:
    """Return how a sound is played; raises `ValueError` for anything else."""
    known = {name: type(value) for name, value in asdict(SoundStyle()).items()}
    known["lasts_s"] = float
    if not isinstance(values, dict) or not values.keys() <= known.keys():
        raise ValueError(f"style is an object with {', '.join(known)}")
    for name, value in values.items():
        is_flag = known[name] is bool
        if isinstance(value, bool) is not is_flag or not isinstance(value, bool | int | float):
            raise ValueError(f"style: {name} is {'true or false' if is_flag else 'a number'}")
    return SoundStyle(**values)


def wait_line(point: WaitPoint) -> str:
    """Return `1750000 eye below 300 timeout 60 idle 2300000`.

    Instant, condition, longest wait, and how far the show goes back for its idle motion.
    """
    wait = point.wait
    timeout = "" if wait.timeout_s is None else f" timeout {wait.timeout_s:.9g}"
    at_us = us_from_s(point.at_s)
    idle = "" if point.back_s == 0.0 else f" idle {us_from_s(point.back_s)}"
    return f"{at_us} {wait.sensor} {wait.side} {wait.threshold:.9g}{timeout}{idle}"


def read_wait(text: str, sensors: Container[str]) -> WaitPoint:
    """Return the wait that `wait_line` wrote; raises `ValueError` for any other text."""
    match = _WAIT.fullmatch(text)
    if match is None:
        raise ValueError(
            f"{text!r} is not of the form `<us> <sensor> below|above <value> [timeout <s>] "
            "[idle <us>]`"
        )
    if match[2] not in sensors:
        raise ValueError(f"the robot has no sensor {match[2]!r}")
    wait = Wait(
        sensor=match[2],
        side="below" if match[3] == "below" else "above",
        threshold=float(match[4]),
        timeout_s=None if match[5] is None else float(match[5]),
    )
    back_s = 0.0 if match[6] is None else s_from_us(int(match[6]))
    return WaitPoint(at_s=s_from_us(int(match[1])), wait=wait, back_s=back_s)


def to_text(program: Program, *, folder: Path | None = None) -> str:
    """Return the text form. The robot's file is named relative to `folder`, if one is given."""
    lines = [FIRST_LINE, f"# name: {program.name}", f"# robot: {program.robot}"]
    if program.robot_path is not None:
        shown = program.robot_path
        if folder is not None:
            shown = Path(os.path.relpath(program.robot_path, folder))
        lines.append(f"# robot_file: {shown.as_posix()}")
    if math.isinf(program.duration_s):
        lines.append(f"# duration_us: {FOREVER}")
    else:
        lines.append(f"# duration_us: {us_from_s(program.duration_s)}")
    if program.repeat is not None:
        repeat = program.repeat
        times = "" if repeat.times is None else f" {repeat.times}"
        lines.append(f"# repeat_us: {repeat.from_us} {repeat.to_us}{times}")
    lines.append(f"# tolerance_deg: {program.tolerance_deg:g}")
    start = " ".join(f"{name}={angle:.9g}" for name, angle in program.start_deg.items())
    lines.append(f"# start_deg: {start}")
    if program.drives:
        lines.append(f"# drives: {' '.join(map(_drive_text, program.drives.items()))}")
    if program.on_fault:
        lines.append(f"# on_fault: {escalations_text(program.on_fault)}")
    lines += [f"# mark: {us_from_s(mark.planned_s)} {mark.label}" for mark in program.marks]
    lines += [f"# wait: {wait_line(point)}" for point in program.waits]
    lines += [f"# cue: {cue_line(cue)}" for cue in program.cues]
    lines += [f"{m.due_us} {m.bus} {m.data[:-1].decode('ascii')}" for m in program.moves]
    return "\n".join(lines) + "\n"


def _drive_text(item: tuple[str, Driving]) -> str:
    name, driving = item
    count = f":{driving.filter_count}" if driving.drive == "streamed" else ""
    return f"{name}={driving.drive}{count}"


def load_program(
    path: Path, load_robot: Callable[[Path], Robot], *, robot_path: Path | None = None
) -> tuple[Program, Robot]:
    """Return the program in the file at `path`, and the robot that it names or `robot_path`.

    Raises `InputError` with file and line for anything that is not a program of that robot.
    """
    text = read_text(path, TEXT_MAX_BYTES)
    _check_first_line(text, path)
    if robot_path is None:
        robot_file = re.search(r"^# robot_file: (.+)$", text, re.MULTILINE)
        if robot_file is None:
            raise InputError(
                "names no robot: add a line `# robot_file: PATH`, or give --robot", path=path
            )
        robot_path = path.parent / robot_file[1]
    robot = load_robot(robot_path)
    return from_text(text, robot, path=path), robot


def from_text(text: str, robot: Robot, *, path: Path | None = None) -> Program:
    """Return the program that `to_text` wrote, for `robot`.

    Raises `InputError` with the line for what is not of this form, out of order in time, or
    addressed to a servo that the robot does not have.
    """
    _check_first_line(text, path)
    reader = _ProgramReader(robot.servo_robot, path)
    for number, line in enumerate(text.splitlines()[1:], start=2):
        reader.read(number, line)
    return reader.program()


def _check_first_line(text: str, path: Path | None) -> None:
    first, _, _ = text.partition("\n")
    if first.strip() != FIRST_LINE:
        raise InputError(f"not a program: the first line must be `{FIRST_LINE}`", path=path, line=1)


class _ProgramReader:
    """Collects the lines of one program."""

    def __init__(self, robot: Robot, path: Path | None) -> None:
        self._robot = robot
        self._path = path
        self._header: dict[str, str] = {}
        self._marks: list[Mark] = []
        self._cues: list[Cue] = []
        self._waits: list[WaitPoint] = []
        self._moves: list[Move] = []
        self._move_line = 1
        self._drives: dict[str, Driving] = {}
        self._joints = {(j.bus, j.servo_id): j for j in robot.joints.values()}

    def read(self, number: int, line: str) -> None:
        if not line.strip():
            return
        if match := _HEADER.fullmatch(line):
            if match[1] == "mark":
                due, _, label = match[2].partition(" ")
                planned_s = s_from_us(self._whole(due, number))
                self._marks.append(
                    Mark(label=label, authored_s=None, planned_s=planned_s, is_anchor=False)
                )
            elif match[1] in {"cue", "wait"}:
                self._read_due(match[1], match[2], number)
            else:
                self._header[match[1]] = match[2]
                if match[1] == "drives":
                    self._read_drives(number, match[2])
        elif match := _MOVE.fullmatch(line.strip()):
            self._moves.append(self._move(match, number))
            self._move_line = number
        elif not line.startswith("#"):
            raise self._error(number, f"{line!r} is not of the form `due_us bus #<id>D<n>[T<ms>]`")

    def _read_due(self, what: str, text: str, number: int) -> None:
        try:
            if what == "wait":
                self._waits.append(read_wait(text, self._robot.sensors))
            else:
                self._cues.append(read_cue(text, self._robot.joints))
        except ValueError as error:
            raise self._error(number, str(error)) from error

    def _read_drives(self, number: int, text: str) -> None:
        if self._moves:
            raise self._error(number, "`# drives:` must stand above the moves")
        for item in text.split():
            match = _DRIVE.fullmatch(item)
            if match is None:
                raise self._error(
                    number, f"{item!r} is neither `<joint>=streamed:<FPC>` nor `<joint>=stepped`"
                )
            if match[1] not in self._robot.joints:
                raise self._error(number, f"robot {self._robot.name!r} has no joint {match[1]!r}")
            driving = Driving("streamed", int(match[3])) if match[2] else Driving("stepped")
            self._drives[match[1]] = driving

    def _move(self, match: re.Match[str], number: int) -> Move:
        bus, servo_id = match[2], int(match[3])
        joint = self._joints.get((bus, servo_id))
        if joint is None:
            raise self._error(
                number, f"robot {self._robot.name!r} has no servo {servo_id} on bus {bus!r}"
            )
        move = Move(
            due_us=int(match[1]),
            bus=bus,
            servo_id=servo_id,
            target_wire=int(match[4]),
            duration_ms=None if match[5] is None else int(match[5]),
        )
        self._check_drive(joint, move, number)
        angle_deg = joint.joint_deg(move.target_wire / joint.model.wire_per_deg)
        slack_deg = 1.0 / joint.model.wire_per_deg
        low, high = joint.position_min_deg - slack_deg, joint.position_max_deg + slack_deg
        if not low <= angle_deg <= high:
            raise self._error(
                number,
                f"joint {joint.name!r} would go to {angle_deg:.1f} deg, allowed "
                f"{joint.position_min_deg:g} to {joint.position_max_deg:g} deg",
            )
        if self._moves and move.due_us < self._moves[-1].due_us:
            raise self._error(number, "due before the line above; moves must be in order of time")
        return move

    def _check_drive(self, joint: Joint, move: Move, number: int) -> None:
        driving = self._drives.get(joint.name, TIMED)
        if problem := drive_problem(joint.model, driving.drive):
            raise self._error(number, f"joint {joint.name!r}: {problem}")
        if (move.duration_ms is not None) != (driving.drive == "timed"):
            required = "needs a T" if driving.drive == "timed" else "takes no T"
            raise self._error(number, f"joint {joint.name!r} is {driving.drive}: its D {required}")
        if move.duration_ms is not None and not 1 <= move.duration_ms <= DURATION_READ_MAX_MS:
            raise self._error(
                number, f"T{move.duration_ms} is not in 1 to {DURATION_READ_MAX_MS} ms"
            )
        if move.target_wire % joint.model.wire_step:
            raise self._error(
                number, f"D{move.target_wire} is not a multiple of {joint.model.wire_step}"
            )

    def program(self) -> Program:
        for key in _REQUIRED:
            if key not in self._header:
                raise self._error(1, f"the header line `# {key}: …` is missing")
        header = self._header
        repeat = self._repeat(header)
        is_endless = repeat is not None and repeat.times is None
        duration_us = 0 if is_endless else self._whole(header["duration_us"], 1)
        end_us = duration_us
        if repeat is not None:
            end_us = repeat.to_us if is_endless else duration_us - repeat.added_us
            if end_us < repeat.to_us:
                raise self._error(1, "`# repeat_us:` repeats more than `# duration_us:` allows")
        last = self._moves[-1] if self._moves else None
        after_us = REPEATED_MAX_US if last is not None and last.duration_ms is None else 0
        if last is not None and last.due_us > end_us + after_us:
            raise self._error(self._move_line, f"due after the end of the program at {end_us} us")
        return Program(
            name=header["name"],
            robot=header["robot"],
            robot_path=self._robot.path,
            moves=tuple(self._moves),
            duration_s=math.inf if is_endless else s_from_us(duration_us),
            start_deg=self._start_deg(header),
            tolerance_deg=self._number(header["tolerance_deg"]),
            drives=self._drives,
            repeat=repeat,
            marks=tuple(self._marks),
            cues=tuple(self._cues),
            waits=tuple(self._waits),
            line_use=lines_use(self._moves, self._robot),
            on_fault=self._on_fault(header.get("on_fault", "")),
        )

    def _on_fault(self, text: str) -> Escalations:
        try:
            return escalations_from(text)
        except ValueError as error:
            raise self._error(1, f"on_fault: {error}") from None

    def _repeat(self, header: Mapping[str, str]) -> Repeat | None:
        is_endless = header["duration_us"] == FOREVER
        if not is_endless and "repeat_us" not in header:
            return None
        numbers = [self._whole(text, 1) for text in header.get("repeat_us", "").split()]
        if is_endless and len(numbers) != 2:
            raise self._error(1, "a program that lasts forever needs `# repeat_us: FROM TO`")
        if not is_endless and len(numbers) != 3:
            raise self._error(
                1,
                f"`# repeat_us:` needs `FROM TO TIMES`; or `FROM TO` with `duration_us: {FOREVER}`",
            )
        repeat = Repeat(**dict(zip(("from_us", "to_us", "times"), numbers, strict=False)))
        if repeat.to_us <= repeat.from_us:
            raise self._error(1, "`# repeat_us: FROM TO` needs FROM before TO")
        if repeat.times is not None and not 2 <= repeat.times <= TIMES_MAX:
            raise self._error(1, f"`# repeat_us:` allows 2 to {TIMES_MAX:,} TIMES")
        return repeat

    def _start_deg(self, header: Mapping[str, str]) -> dict[str, float]:
        start = {}
        for item in header["start_deg"].split():
            name, _, angle = item.rpartition("=")
            if name not in self._robot.joints:
                raise self._error(1, f"robot {self._robot.name!r} has no joint {name!r}")
            joint, start[name] = self._robot.joints[name], self._number(angle)
            slack_deg = 1.0 / joint.model.wire_per_deg
            low, high = joint.position_min_deg - slack_deg, joint.position_max_deg + slack_deg
            if not low <= start[name] <= high:
                raise self._error(1, f"start_deg: {name} at {angle} deg is outside of its range")
        moved = {(m.bus, m.servo_id) for m in self._moves}
        known = {(self._robot.joints[n].bus, self._robot.joints[n].servo_id) for n in start}
        if missing := sorted(moved - known):
            raise self._error(1, f"start_deg lacks the joint with id {missing[0][1]}")
        return start

    def _whole(self, text: str, number: int) -> int:
        try:
            return int(text)
        except ValueError:
            raise self._error(number, f"{text!r} is not a whole number") from None

    def _number(self, text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self._error(1, f"{text!r} is not a number")
        return value

    def _error(self, number: int, reason: str) -> InputError:
        return InputError(reason, path=self._path, line=number)
