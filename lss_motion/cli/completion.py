"""The command `completion`: the script with which a shell completes commands, options, files."""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import say
from lss_motion.errors import EXIT_FINISHED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from lss_motion.cli.commands import Commands

    MakeParsers = Callable[[], Iterable[argparse.ArgumentParser]]

DESCRIPTION: Final = """\
Print a script for your shell. With it, the Tab key completes the commands, options and files of
lss-motion and lss-play.

  eval "$(lss-motion completion bash)"      add this line to ~/.bashrc
  eval "$(lss-motion completion zsh)"       add this line to ~/.zshrc, after compinit
  lss-motion completion tcsh | source /dev/stdin
"""

SHELLS: Final = ("bash", "zsh", "tcsh")


def add_to(commands: Commands, make_parsers: MakeParsers) -> None:
    """Add the command. `make_parsers` returns the parsers of all programs."""
    completion = add_command(
        commands,
        "completion",
        functools.partial(_completion, make_parsers),
        DESCRIPTION,
    )
    completion.add_argument("shell", choices=SHELLS, help="the shell that you use")


def _completion(make_parsers: MakeParsers, arguments: argparse.Namespace) -> int:
    import shtab

    for parser in make_parsers():
        _complete_files(parser)
        say(shtab.complete(parser, arguments.shell))
    return EXIT_FINISHED


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Complete every argument that is a path with files, in the parser and its commands."""
    import shtab

    for action in parser._actions:  # noqa: SLF001  (argparse has no public list of arguments)
        if action.type is Path or action.dest == "robot":
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # shtab reads it
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                _complete_files(inner)
