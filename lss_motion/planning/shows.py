"""From the file on the command line to a compiled program, for `lss-play` and `lss-motion`.

A file is a sequence, a gait or a program that was compiled before.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.files.source import read_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.model import Sequence

    ReadRobot = Callable[[Path], Robot]

PROGRAM_SUFFIX = ".lss"

ROBOT_KEYS: Final = re.compile(r"^(buses|joints)\s*:", re.MULTILINE)
"""Top-level keys of a robot file that no other file has."""

TABLE_VALUES_MAX: Final = 20_000_000
"""Angles of one table. Chosen: three hours of 18 joints at 100 Hz, 160 MB of text."""

HEADROOM_RATIO: Final = 0.01
"""A show that follows a leader is planned for limits that are lower by this. Trimmed by 0.5 %, its
accelerations grow by 1.0025 %: they stay within the limits."""

GAIT_TOLERANCE_DEG: Final = 0.05
"""The largest deviation of a leg's predicted horn from its plan. Measured on simulated servos with
feedback, nine patterns with seven seeds each: feet slip at most 0.41 mm of the 0.5 mm allowed. With
0.03 deg they slip 0.27 mm, and 1.4 times as many commands are sent; with 0.1 deg 0.51 mm."""


class Show(Struct, frozen=True, kw_only=True):
    """A program ready to play. `trajectory` and `sequence` are None if it was compiled before."""

    robot: Robot
    program: Program
    trajectory: Trajectory | None = None
    sequence: Sequence | None = None
    is_following: bool = False
    """Planned with headroom, to follow a leader."""


def is_program(path: Path) -> bool:
    """Return whether the file on the command line is a compiled program, by its suffix."""
    return path.suffix.lower() == PROGRAM_SUFFIX


def is_robot_file(path: Path) -> bool:
    """Return whether a file describes a robot; raise `InputError` if it cannot be read."""
    return path.suffix.lower() in (".yaml", ".yml") and bool(ROBOT_KEYS.search(read_text(path)))


def require_program_suffix(path: Path) -> None:
    """Raise `InputError` if a program that is to be written would not be read as one."""
    if not is_program(path):
        raise InputError("must end in .lss; lss-play reads other files as sequences", path=path)


def load(
    path: Path, robot_path: Path | None, read_robot: ReadRobot | None = None
) -> tuple[Sequence, Robot]:
    """Return the sequence at `path` and its robot; `robot_path` replaces the robot of the file.

    A gait file gives the sequence that its robot walks. `read_robot` reads robot files.
    """
    from lss_motion.robot.load import load_robot
    from lss_motion.show.gait import gait_as_sequence, is_gait_file
    from lss_motion.show.load import load_sequence

    read_robot = read_robot or load_robot
    if is_program(path):
        raise InputError("is a compiled program; this needs a sequence file", path=path)
    if is_gait_file(path):
        from lss_motion.show.gait.load import sequence_of

        gait, walker = load_gait(path, robot_path, read_robot)
        return sequence_of(gait, walker), walker
    robot = None if robot_path is None else read_robot(robot_path)
    sequence = load_sequence(path, robot, read_other=gait_as_sequence)
    if robot is None:
        assert sequence.robot_path is not None
        robot = read_robot(sequence.robot_path)
        if robot.read_limits:  # A gait in it was paced for other limits.
            sequence = load_sequence(path, robot, read_other=gait_as_sequence)
    return sequence, robot


def files_of(sequence: Sequence) -> Iterator[Path]:
    """Yield every sequence, gait and robot file that a sequence was made of."""
    for path in (sequence.path, sequence.robot_path):
        if path is not None:
            yield path
    parts = [step.sequence for step in sequence.play if step.sequence is not None]
    for part in (*sequence.tracks, *parts, *(layer.sequence for layer in sequence.layers)):
        yield from files_of(part)


def load_gait(
    path: Path, robot_path: Path | None, read_robot: ReadRobot | None = None
) -> tuple[Gait, Robot]:
    """Return the gait at `path` and its robot; `robot_path` replaces the robot of the file."""
    from lss_motion.robot.load import load_robot
    from lss_motion.show.gait import load

    read_robot = read_robot or load_robot
    robot = None if robot_path is None else read_robot(robot_path)
    gait = load.load_gait(path, robot)
    if robot is None:
        assert gait.robot_path is not None
        robot = read_robot(gait.robot_path)
    return gait, robot


def prepare(
    path: Path,
    robot_path: Path | None,
    read_robot: ReadRobot | None = None,
    *,
    speed_ratio: float = 1.0,
    loop: int | str | None = None,
    is_following: bool = False,
) -> Show:
    """Return the show in the file at `path`, planned and compiled.

    `loop` is a count, or `forever`. `is_following`: with headroom, to be trimmed. Raises
    `InputError`, `PlanningError` or `LineLoadError`.
    """
    if is_program(path):
        if speed_ratio != 1.0 or loop is not None:
            raise InputError(
                "--speed and --loop need the sequence, not a compiled program", path=path
            )
        return _read(path, robot_path, read_robot, is_following=is_following)
    loaded = load(path, robot_path, read_robot)
    return compiled(*loaded, speed_ratio=speed_ratio, loop=loop, is_following=is_following)


def compiled(
    sequence: Sequence,
    robot: Robot,
    *,
    speed_ratio: float = 1.0,
    loop: int | str | None = None,
    is_following: bool = False,
) -> Show:
    """Return the show of a sequence; the others as in `prepare`."""
    from lss_motion.planning.program.compile import compile_program
    from lss_motion.planning.program.model import TOLERANCE_DEG

    limits = with_headroom(robot) if is_following else robot
    trajectory = planned(sequence, limits, speed_ratio=speed_ratio, loop=loop)
    tolerance_deg = GAIT_TOLERANCE_DEG if walks(sequence) else TOLERANCE_DEG
    # Its servos get their ramps as ever, so the program is made for these.
    compiled_for = with_headroom(robot, accel=False) if is_following else robot
    program = compile_program(trajectory, compiled_for, tolerance_deg=tolerance_deg)
    return Show(
        robot=robot,
        program=program,
        trajectory=trajectory,
        sequence=sequence,
        is_following=is_following,
    )


def with_headroom(robot: Robot, *, accel: bool = True) -> Robot:
    """Return the robot with lower limits, for a show that a leader may speed up a little."""
    ratio = 1.0 - HEADROOM_RATIO

    def slower(joints: Mapping[str, Joint]) -> dict[str, Joint]:
        return {
            name: replace(
                joint,
                speed_max_deg_s=ratio * joint.speed_max_deg_s,
                accel_max_deg_s2=(ratio if accel else 1.0) * joint.accel_max_deg_s2,
            )
            for name, joint in joints.items()
        }

    return replace(robot, joints=slower(robot.joints), servos=slower(robot.servos))


def walks(sequence: Sequence) -> bool:
    """Return whether a sequence or a part of it is a gait."""
    from lss_motion.show.gait import is_gait_file

    if sequence.path is not None and is_gait_file(sequence.path):
        return True
    inner = [step.sequence for step in sequence.play if step.sequence is not None]
    return any(map(walks, [*inner, *(layer.sequence for layer in sequence.layers)]))


def planned(
    sequence: Sequence, robot: Robot, *, speed_ratio: float = 1.0, loop: int | str | None = None
) -> Trajectory:
    """Return the plan with the speed and the loop of the command line.

    `loop` is the number of passes of the part that the file loops: all of it, or `loop_span_s`.
    """
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.check import check_sequence

    if loop is not None:
        sequence = replace(sequence, loop=None if loop == "forever" else int(loop))
        check_sequence(sequence, robot)
    speed_ratio *= sequence.speed_ratio
    return plan(replace(sequence, speed_ratio=speed_ratio), robot)


def recheck(show: Show) -> None:
    """Raise `PlanningError` or `LineLoadError` if the bytes of a show would break a limit."""
    from lss_motion.planning.program.verify import verify_program

    robot = show.robot
    verify_program(show.program, with_headroom(robot, accel=False) if show.is_following else robot)


def _read(
    path: Path, robot_path: Path | None, read_robot: ReadRobot | None, *, is_following: bool
) -> Show:
    from lss_motion.planning.program.text import load_program
    from lss_motion.planning.program.verify import verify_program
    from lss_motion.robot.load import load_robot

    program, robot = load_program(path, read_robot or load_robot, robot_path=robot_path)
    verify_program(program, robot)
    if is_following:
        try:
            verify_program(program, with_headroom(robot, accel=False))
        except PlanningError as error:
            raise PlanningError(
                f"{error}. A show that follows a leader needs {100 * HEADROOM_RATIO:g} % headroom: "
                f"compile it with `lss-motion compile --follow`, or play its sequence"
            ) from None
    return Show(robot=robot, program=program, is_following=is_following)


def require_rows(trajectory: Trajectory, rate_hz: float) -> None:
    """Raise `InputError` if a table of the plan would be too large, before it is made."""
    values = shown_s(trajectory) * rate_hz * len(trajectory.joints)
    if values > TABLE_VALUES_MAX:
        raise InputError(
            f"a table of {shown_s(trajectory):,.0f} s at {rate_hz:g} Hz would have {values:,.0f} "
            f"angles, at most {TABLE_VALUES_MAX:,} are written; give a lower --rate-hz, or loop "
            "the sequence less often"
        )


def shown_s(trajectory: Trajectory) -> float:
    """Return the duration of a plan; of an endless one, that of its first pass and one more."""
    if trajectory.loop is None:
        return trajectory.first.duration_s + trajectory.middle.duration_s
    return trajectory.duration_s
