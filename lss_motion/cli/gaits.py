"""`lss-motion gait`: what a gait file comes to, before a robot is involved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.cli.commands import add_command, add_force, refuse_overwriting
from lss_motion.cli.robots import add_cache_option, reader
from lss_motion.errors import EXIT_FINISHED

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    gait = add_command(
        commands, "gait", _gait, "say how a gait walks; write it as keyframes or a picture"
    )
    gait.add_argument("file", type=Path, metavar="FILE", help="a gait file")
    gait.add_argument("--robot", type=Path, metavar="FILE", help="use this robot file")
    add_cache_option(gait)
    gait.add_argument(
        "-o", "--output", type=Path, metavar="S.yaml", help="write the keyframes as a sequence"
    )
    add_force(gait)
    gait.add_argument("--plot", type=Path, metavar="F.png", help="draw it; the suffix says how")


def _gait(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.gait.explain import gait_lines
    from lss_motion.gait.pacing import paced
    from lss_motion.gait.sequence import sequence_from
    from lss_motion.sequence.write import write_sequence
    from lss_motion.trajectory.planner import plan

    refuse_overwriting(arguments.output, is_forced=arguments.force)
    gait, robot = shows.load_gait(arguments.file, arguments.robot, reader(arguments, may_ask=False))
    passages = paced(gait, robot)
    sequence = sequence_from(gait, passages)
    plan(sequence, robot)  # Its own judge has to agree before anything is written.
    if arguments.output is not None:
        write_sequence(sequence, arguments.output, comments=[f"What {arguments.file} comes to."])
    if arguments.plot is not None:
        from lss_motion.gait.plot import plot_gait

        plot_gait(gait, passages, arguments.plot)
    print("\n".join(gait_lines(gait, passages)))
    return EXIT_FINISHED
