"""The program `lss-motion COMMAND`. Each command has a module with `add_to(commands)`.

Only the module of the command that runs is imported: all of them take a third of the time that a
short command takes.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

from lss_motion.cli.commands import COMMANDS, ProgramParser, SubcommandParser, add_version
from lss_motion.cli.messages import guarded
from lss_motion.errors import EXIT_FINISHED
from lss_motion.system.signals import as_program

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from lss_motion.cli.commands import Commands


def main(argv: Sequence[str] | None = None) -> int:
    """Run `lss-motion`; return its exit code. Without a command it prints the list of them."""
    words = sys.argv[1:] if argv is None else argv
    arguments = _parser_for(words).parse_args(words)
    handler: Callable[[argparse.Namespace], int] = arguments.handler
    return guarded("lss-motion", lambda: handler(arguments))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `lss-motion` with all commands."""
    parser, commands = _empty_parser()
    for module in dict.fromkeys(module for module, _ in COMMANDS.values()):
        _add_module(commands, module)
    return parser


def _parser_for(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser with the module of the command in `words`, or with names alone."""
    command = next((word for word in words if not word.startswith("-")), None)
    parser, commands = _empty_parser()
    if command in COMMANDS:
        _add_module(commands, COMMANDS[command][0])
        return parser
    for name, (_, text) in COMMANDS.items():
        commands.add_parser(name, help=text)
    return parser


def _empty_parser() -> tuple[argparse.ArgumentParser, Commands]:
    parser = ProgramParser(
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
    parser.set_defaults(handler=lambda _: _print_help(parser))
    return parser, parser.add_subparsers(metavar="COMMAND", parser_class=SubcommandParser)


def _print_help(parser: argparse.ArgumentParser) -> int:
    parser.print_help()
    return EXIT_FINISHED


def _add_module(commands: Commands, module: str) -> None:
    importlib.import_module(f"lss_motion.cli.{module}").add_to(commands)


if __name__ == "__main__":
    sys.exit(as_program("lss-motion", main))
