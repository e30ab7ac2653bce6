"""The program `lss-motion COMMAND`. Each group of commands is a module with `add_to`."""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import COMMANDS, CommandParser, add_version
from lss_motion.cli.messages import guarded
from lss_motion.system.signals import as_program

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from lss_motion.cli.commands import Commands

GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "examples": ("example",),
    "planning": ("check", "plan", "compile", "schema", "gait"),
    "play": ("play",),
    "studio": ("studio",),
    "serve": ("serve",),
    "service": ("install-service",),
    "simulate": ("sim",),
    "doctor": ("doctor", "devices"),
    "scan": ("scan",),
    "configure": ("configure",),
    "monitor": ("monitor",),
    "send": ("send",),
    "record": ("record",),
    "replay": ("replay",),
    "report": ("report",),
    "morning": ("morning",),
    "jog": ("jog",),
    "calibrate": ("calibrate",),
    "exchange": ("import", "export"),
    "beats": ("beats",),
    "identify": ("identify",),
    "walk": ("walk",),
    "stage_keys": ("stage-keys",),
    "reference": ("reference",),
}
"""The modules of `cli` in the order of the help text, with their commands.

Each has `add_to(commands)`. Only the module of the command that runs is imported: all of them take
a third of the time that a short command takes.
"""

COMPLETION: Final = "completion"
"""The command that has to know all commands."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `lss-motion`; return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    arguments = _parser_for(words).parse_args(words)
    handler: Callable[[argparse.Namespace], int] = arguments.handler
    return guarded("lss-motion", lambda: handler(arguments))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `lss-motion` with all commands."""
    parser, commands = _empty_parser()
    for group in GROUPS:
        _add_group(commands, group)
    from lss_motion.cli import completion, play

    completion.add_to(commands, lambda: (make_parser(), play.make_parser()))
    return parser


def _parser_for(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser with the group of the command in `words`, or with names alone."""
    command = next((word for word in words if not word.startswith("-")), None)
    if command == COMPLETION:
        return make_parser()
    parser, commands = _empty_parser()
    group = next((group for group, names in GROUPS.items() if command in names), None)
    if group is not None:
        _add_group(commands, group)
        return parser
    for name, text in COMMANDS.items():
        commands.add_parser(name, help=text)
    return parser


def _empty_parser() -> tuple[argparse.ArgumentParser, Commands]:
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
    return parser, parser.add_subparsers(
        required=True, metavar="COMMAND", parser_class=CommandParser
    )


def _add_group(commands: Commands, group: str) -> None:
    importlib.import_module(f"lss_motion.cli.{group}").add_to(commands)


if __name__ == "__main__":
    sys.exit(as_program("lss-motion", main))
