"""`lss-motion sim`: a simulated robot for this and any other program."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.cli.commands import add_command
from lss_motion.errors import EXIT_INTERRUPTED, EXIT_TERMINATED

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands

DESCRIPTION = """\
Simulate the buses of a robot behind pseudo-terminals: any program that opens a serial port can
talk to them. Prints each port and runs until Ctrl-C.

Not modelled: backlash and inertia of what hangs on a horn, noise on the lines without a collision,
the LED's start-up sequence, RC pulses, EEPROM wear. Physical figures are those of the documents
where they give any, and marked assumptions in lss_motion.sim.physics where they do not.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    sim = add_command(
        commands, "sim", _sim, "simulate a robot behind a pseudo-terminal", DESCRIPTION
    )
    sim.add_argument("robot", type=Path, metavar="ROBOT", help="a robot file")
    sim.add_argument("--link", type=Path, metavar="PATH", help="symbolic link to the port")
    sim.add_argument("--seed", type=int, default=0, metavar="N")


def _sim(arguments: argparse.Namespace) -> int:
    from lss_motion.robot.load import load_robot
    from lss_motion.sim.pty import serve

    number = serve(
        load_robot(arguments.robot),
        arguments.link,
        seed=arguments.seed,
        announce=lambda text: print(text, flush=True),
    )
    return EXIT_TERMINATED if number == signal.SIGTERM else EXIT_INTERRUPTED
