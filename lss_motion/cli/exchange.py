"""`lss-motion import`: motion of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.cli.commands import add_command
from lss_motion.errors import EXIT_FINISHED

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    imported = add_command(
        commands, "import", _import, "turn another tool's motion into a sequence file"
    )
    imported.add_argument("file", type=Path, metavar="FILE")
    imported.add_argument(
        "--from",
        dest="format_name",
        metavar="FORMAT",
        help="bitbots; default: recognised by content",
    )
    imported.add_argument("--robot", type=Path, required=True, metavar="FILE")
    imported.add_argument("-o", "--output", type=Path, required=True, metavar="S.yaml")


def _import(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.check import plan_lines
    from lss_motion.interchange.motions import read_motion, sequence_for
    from lss_motion.robot.load import load_robot
    from lss_motion.sequence.write import write_sequence
    from lss_motion.trajectory.planner import plan

    robot = load_robot(arguments.robot)
    motion = read_motion(arguments.file, format_name=arguments.format_name)
    sequence = sequence_for(motion, robot)
    write_sequence(sequence, arguments.output, comments=motion.comments)
    print(f"{arguments.output}: {len(sequence.keyframes)} keyframes from {arguments.file}")
    print("\n".join([*motion.comments, *plan_lines(plan(sequence, robot), robot)]))
    return EXIT_FINISHED
