"""The program `lss-motion COMMAND`. Each group of commands is a module with `add_to`."""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import CommandParser, add_version
from lss_motion.cli.messages import guarded
from lss_motion.runtime.signals import as_program

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
    "doctor": ("doctor",),
    "devices": ("devices",),
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run `lss-motion`; return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    arguments = make_parser(words[0] if words else None).parse_args(words)
    handler: Callable[[argparse.Namespace], int] = arguments.handler
    return guarded("lss-motion", lambda: handler(arguments))


def make_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of `lss-motion` with the group of `command`; with all if there is none."""
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
    chosen = [group for group, names in GROUPS.items() if command in names]
    for group in chosen or GROUPS:
        importlib.import_module(f"lss_motion.cli.{group}").add_to(commands)
    if not chosen:
        _add_completion(commands)
    return parser


def _add_completion(commands: Commands) -> None:
    """Add the command that has to know all commands."""
    from lss_motion.cli import completion, play

    completion.add_to(commands, lambda: (make_parser(), play.make_parser()))


if __name__ == "__main__":
    sys.exit(as_program("lss-motion", main))
