"""The commands that need no servo: `check`, `plan`, `compile`, `schema` and `gait`."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import (
    PLOT_HELP,
    add_command,
    add_force,
    add_json,
    add_robot_options,
    number_from,
    print_json,
    reader,
    refuse_overwriting,
    write_text,
)
from lss_motion.errors import EXIT_FINISHED, InputError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from lss_motion.cli.commands import Commands
    from lss_motion.robot.model import Robot
    from lss_motion.trajectory.model import Trajectory

    FloatArray = NDArray[np.float64]

CHECK_TEXT: Final = """\
Check a file: read it, plan and compile it, and print what was slowed down and why, the use of each
limit and the load of the bus. Nothing is written and no servo is contacted.

  lss-motion check wave.yaml
  lss-motion check robots/desk_arm.yaml --json
"""

PLAN_TEXT: Final = """\
Plan a sequence and print the use of each limit; also as a table or a picture.

  lss-motion plan wave.yaml --plot wave.png
  lss-motion plan wave.yaml --csv wave.csv --rate-hz 50
"""

COMPILE_TEXT: Final = """\
Compile a sequence to a program (.lss): the commands that lss-play sends, with their times. A
program starts without planning.

  lss-motion compile wave.yaml -o wave.lss
"""

ROBOT_KEYS: Final = re.compile(r"^(buses|joints)\s*:", re.MULTILINE)
"""Top-level keys of a robot file that no other file has."""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    check = add_command(
        commands, "check", _check, "check a file; print what was slowed and why", CHECK_TEXT
    )
    check.add_argument(
        "file", type=Path, metavar="FILE", help="a sequence, a gait, a program or a robot"
    )
    add_robot_options(check)
    add_json(check)
    planned = add_command(
        commands, "plan", _plan, "plan a sequence; write it as a table or a picture", PLAN_TEXT
    )
    planned.add_argument("file", type=Path, metavar="FILE", help="a sequence or a gait")
    add_robot_options(planned)
    planned.add_argument(
        "--csv", type=Path, metavar="F", help="write this table: t_s,<joint>,... in degrees"
    )
    planned.add_argument(
        "--rate-hz",
        type=number_from(0.1, 10_000.0, "Hz"),
        default=100.0,
        metavar="N",
        help="rows of the table per second (default 100)",
    )
    planned.add_argument("--plot", type=Path, metavar="F.png", help=PLOT_HELP)
    planned.add_argument(
        "--truth",
        type=Path,
        metavar="F",
        help="also draw the true horn angles, from the file of lss-play --truth",
    )
    compiled = add_command(
        commands, "compile", _compile, "compile a sequence to a program (.lss)", COMPILE_TEXT
    )
    compiled.add_argument("file", type=Path, metavar="FILE", help="a sequence or a gait")
    add_robot_options(compiled)
    compiled.add_argument(
        "-o", "--output", type=Path, metavar="F.lss", help="the program to write (default: print)"
    )
    schema = add_command(
        commands, "schema", _schema, "print the JSON Schema of a robot, sequence or gait file"
    )
    schema.add_argument(
        "kind",
        nargs="?",
        choices=("robot", "sequence", "gait"),
        help="only the schema of this kind of file (default: all three)",
    )
    gait = add_command(
        commands, "gait", _gait, "describe how a gait walks; write keyframes or a picture"
    )
    gait.add_argument("file", type=Path, metavar="FILE", help="a gait file")
    add_robot_options(gait)
    gait.add_argument(
        "-o", "--output", type=Path, metavar="S.yaml", help="write the keyframes as a sequence"
    )
    add_force(gait)
    gait.add_argument("--plot", type=Path, metavar="F.png", help=PLOT_HELP)


def _files(arguments: argparse.Namespace) -> tuple[Path, Path | None, Callable[[Path], Robot]]:
    """Return the file, the robot file or None, and the function that reads robot files."""
    return arguments.file, arguments.robot, reader(arguments, may_query=False)


def _check(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.cli.summaries import program_lines, robot_as_json, robot_lines, show_as_json
    from lss_motion.gait.load import is_gait_file
    from lss_motion.gait.pacing import gait_lines, paced
    from lss_motion.gait.to_sequence import sequence_from

    if is_robot_file(arguments.file):
        robot = reader(arguments, may_query=False)(arguments.file)
        if arguments.json:
            print_json(robot_as_json(robot))
        else:
            print("\n".join(robot_lines(robot)))
        return EXIT_FINISHED
    lines = []
    if shows.is_program(arguments.file) or not is_gait_file(arguments.file):
        show = shows.prepare(*_files(arguments))
    else:
        gait, robot = shows.load_gait(*_files(arguments))
        passages = paced(gait, robot)
        show = shows.compiled(sequence_from(gait, passages), robot)
        lines = gait_lines(gait, passages)
    if arguments.json:
        print_json(show_as_json(show))
    else:
        print("\n".join([*lines, *program_lines(show)]))
    return EXIT_FINISHED


def _plan(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.cli.summaries import plan_lines

    sequence, robot = shows.load(*_files(arguments))
    trajectory = shows.planned(sequence, robot)
    if arguments.csv is not None:
        write_text(arguments.csv, plan_table(trajectory, arguments.rate_hz))
    if arguments.plot is not None:
        from lss_motion.trajectory.plot import plot

        horn = None if arguments.truth is None else read_table(arguments.truth, trajectory.joints)
        plot(trajectory, robot, arguments.plot, horn=horn)
    print("\n".join(plan_lines(trajectory, robot)))
    return EXIT_FINISHED


def _compile(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.cli.summaries import program_lines
    from lss_motion.program.text import to_text

    if arguments.output is not None:
        shows.require_program_suffix(arguments.output)
    show = shows.prepare(*_files(arguments))
    if arguments.output is None:
        print(to_text(show.program, folder=Path.cwd()), end="")
        return EXIT_FINISHED
    write_text(arguments.output, to_text(show.program, folder=arguments.output.absolute().parent))
    print("\n".join(program_lines(show)))
    return EXIT_FINISHED


def _schema(arguments: argparse.Namespace) -> int:
    from lss_motion.gait.load import gait_schema
    from lss_motion.robot.load import robot_schema
    from lss_motion.sequence.load import sequence_schema

    schemas = {"robot": robot_schema, "sequence": sequence_schema, "gait": gait_schema}
    if arguments.kind is not None:
        shown = schemas[arguments.kind]()
    else:
        shown = {kind: make() for kind, make in schemas.items()}
    print(json.dumps(shown, indent=2, ensure_ascii=False))
    return EXIT_FINISHED


def _gait(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.gait.pacing import gait_lines, paced
    from lss_motion.gait.to_sequence import sequence_from
    from lss_motion.sequence.write import write_sequence
    from lss_motion.trajectory.planner import plan

    refuse_overwriting(arguments.output, is_forced=arguments.force)
    gait, robot = shows.load_gait(
        arguments.file, arguments.robot, reader(arguments, may_query=False)
    )
    passages = paced(gait, robot)
    sequence = sequence_from(gait, passages)
    plan(sequence, robot)  # The verifier of the planner must accept it before anything is written.
    if arguments.output is not None:
        write_sequence(sequence, arguments.output, comments=[f"The keyframes of {arguments.file}."])
    if arguments.plot is not None:
        from lss_motion.gait.plot import plot_gait

        plot_gait(gait, passages, arguments.plot)
    print("\n".join(gait_lines(gait, passages)))
    return EXIT_FINISHED


def is_robot_file(path: Path) -> bool:
    """Return whether a file describes a robot; raise `InputError` if it cannot be read."""
    from lss_motion.files.source import read_text

    return path.suffix.lower() in (".yaml", ".yml") and bool(ROBOT_KEYS.search(read_text(path)))


def plan_table(trajectory: Trajectory, rate_hz: float) -> str:
    """Return the plan as CSV, one row every `1 / rate_hz` and one at the end.

    An endless show gives its first pass and one more.
    """
    import numpy as np

    from lss_motion.cli.shows import shown_s

    end_s = shown_s(trajectory)
    times_s = np.arange(int(end_s * rate_hz + 1e-9) + 1) / rate_hz
    if end_s - times_s[-1] > 1e-9:
        times_s = np.append(times_s, end_s)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["t_s", *trajectory.joints])
    for time_s, angles_deg in zip(times_s, trajectory.sample(times_s), strict=True):
        writer.writerow([f"{time_s:.6g}", *(f"{angle:.4f}" for angle in angles_deg)])
    return out.getvalue()


def read_table(path: Path, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Return times and (n, joints) angles of the named joints from a table at `path`."""
    import numpy as np

    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        columns = [rows[0].index(name) for name in ("t_s", *joints)]
        table = np.array([[float(row[column]) for column in columns] for row in rows[1:]])
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    except (ValueError, IndexError) as error:
        raise InputError(
            f"is not a table with the columns t_s,{','.join(joints)} in numbers", path=path
        ) from error
    return table[:, 0], table[:, 1:]
