"""`lss-motion check | plan | compile | schema`: everything before a robot is involved."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.cli.commands import add_command, add_json, print_json
from lss_motion.cli.robots import add_cache_option, reader
from lss_motion.errors import EXIT_FINISHED, InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.cli.commands import Commands
    from lss_motion.robot.model import Robot


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    check = add_command(
        commands, "check", _check, "validate, plan, compile; say what was slowed and why"
    )
    add_json(check)
    plan = add_command(commands, "plan", _plan, "plan a sequence; write it as a table or a picture")
    plan.add_argument("--csv", type=Path, metavar="F", help="write t_s,<joint>... in degrees")
    plan.add_argument("--plot", type=Path, metavar="F.png", help="draw it; the suffix says how")
    plan.add_argument("--rate-hz", type=_rate, default=100.0, metavar="N", help="of the table")
    plan.add_argument(
        "--truth",
        type=Path,
        metavar="F",
        help="draw also the horn angles that lss-play --truth wrote",
    )
    compiled = add_command(commands, "compile", _compile, "compile a sequence to a program (.lss)")
    compiled.add_argument("-o", "--output", type=Path, metavar="F.lss", help="default: print it")
    for added in (check, plan, compiled):
        kinds = "a sequence, a gait, a program or a robot" if added is check else "a sequence"
        added.add_argument("file", type=Path, metavar="FILE", help=kinds)
        added.add_argument("--robot", type=Path, metavar="FILE", help="use this robot file")
        add_cache_option(added)
    schema = add_command(
        commands, "schema", _schema, "print the JSON Schema of a robot, sequence or gait file"
    )
    schema.add_argument(
        "kind", nargs="?", choices=("robot", "sequence", "gait"), help="one of them"
    )


def _files(arguments: argparse.Namespace) -> tuple[Path, Path | None, Callable[[Path], Robot]]:
    """Return the file, that of its robot if one is given, and what reads robot files."""
    return arguments.file, arguments.robot, reader(arguments, may_ask=False)


def _check(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.cli.check import (
        is_robot_file,
        program_lines,
        robot_as_json,
        robot_lines,
        show_as_json,
    )
    from lss_motion.gait.explain import gait_lines
    from lss_motion.gait.load import is_gait_file
    from lss_motion.gait.pacing import paced
    from lss_motion.gait.sequence import sequence_from

    if is_robot_file(arguments.file):
        robot = reader(arguments, may_ask=False)(arguments.file)
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
    from lss_motion.cli.check import plan_lines
    from lss_motion.cli.tables import plan_table, read_table, write_text

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
    from lss_motion.cli.check import program_lines
    from lss_motion.cli.tables import write_text
    from lss_motion.program.text import to_text

    if arguments.output is not None and not shows.is_program(arguments.output):
        raise InputError(
            "must end in .lss, or lss-play takes it for a sequence", path=arguments.output
        )
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


def _rate(text: str) -> float:
    value = float(text)
    if not 0.1 <= value <= 10_000.0:
        raise argparse.ArgumentTypeError(f"{text} is not in 0.1 to 10000")
    return value
