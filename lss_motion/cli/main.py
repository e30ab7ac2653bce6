"""The program `lss-motion COMMAND`. Each group of commands is a module with `add_to`."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from lss_motion.cli import (
    calibrate,
    completion,
    configure,
    devices,
    doctor,
    examples,
    exchange,
    identify,
    jog,
    monitor,
    planning,
    play,
    record,
    reference,
    replay,
    report,
    scan,
    send,
    simulate,
    walk,
)
from lss_motion.cli.commands import CommandParser, add_version
from lss_motion.cli.messages import guarded
from lss_motion.runtime.signals import as_program

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

GROUPS = (
    examples,
    planning,
    play,
    simulate,
    doctor,
    devices,
    scan,
    configure,
    monitor,
    send,
    record,
    replay,
    report,
    jog,
    calibrate,
    exchange,
    identify,
    walk,
    reference,
)
"""The modules in the order of the help text. Each has `add_to(commands)`."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `lss-motion`; return its exit code."""
    arguments = make_parser().parse_args(argv)
    handler: Callable[[argparse.Namespace], int] = arguments.handler
    return guarded("lss-motion", lambda: handler(arguments))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `lss-motion` with all its commands."""
    parser = argparse.ArgumentParser(
        prog="lss-motion",
        description=(
            "Plan, check, compile, play and simulate motion of smart servos; find, set up and "
            "watch servos. Begin with: lss-motion example"
        ),
        epilog=(
            "`lss-motion COMMAND --help` explains a command. `lss-motion completion --help` "
            "explains how to complete commands with the Tab key."
        ),
    )
    add_version(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=CommandParser)
    for group in GROUPS:
        group.add_to(commands)
    completion.add_to(commands, lambda: (make_parser(), play.make_parser()))
    return parser


if __name__ == "__main__":
    sys.exit(as_program("lss-motion", main))
