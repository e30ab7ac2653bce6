"""`lss-motion COMMAND`: everything around playing. One module a group of commands."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from lss_motion.cli import (
    completion,
    configure,
    doctor,
    examples,
    exchange,
    hands,
    identify,
    monitor,
    planning,
    play,
    record,
    reference,
    replay,
    scan,
    send,
    simulate,
    walk,
)
from lss_motion.cli.commands import CommandParser, add_version
from lss_motion.cli.messages import guarded

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

GROUPS = (
    examples,
    planning,
    play,
    simulate,
    doctor,
    scan,
    configure,
    monitor,
    send,
    record,
    replay,
    hands,
    exchange,
    identify,
    walk,
    reference,
    completion,
)
"""Each has `add_to(commands)`, and imports nothing heavy before a command of its own runs."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `lss-motion`; return its exit code."""
    arguments = make_parser().parse_args(argv)
    handler: Callable[[argparse.Namespace], int] = arguments.handler
    return guarded("lss-motion", lambda: handler(arguments))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `lss-motion` with all its commands."""
    parser = argparse.ArgumentParser(
        prog="lss-motion",
        description="Plan, check, compile and simulate motion of smart servos.",
        epilog="Tab completion: lss-motion completion --help",
    )
    add_version(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=CommandParser)
    for group in GROUPS:
        group.add_to(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
