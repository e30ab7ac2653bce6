"""`lss-motion completion`: what a shell needs to complete commands, options and files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.errors import EXIT_FINISHED

if TYPE_CHECKING:
    from lss_motion.cli.commands import Commands

DESCRIPTION: Final = """\
Print the completion of lss-motion and lss-play for the Tab key of a shell.

  eval "$(lss-motion completion bash)"      in ~/.bashrc
  eval "$(lss-motion completion zsh)"       in ~/.zshrc, after compinit
  lss-motion completion tcsh | source /dev/stdin
"""

SHELLS: Final = ("bash", "zsh", "tcsh")


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    completion = add_command(
        commands, "completion", _completion, "complete commands with the Tab key", DESCRIPTION
    )
    completion.add_argument("shell", choices=SHELLS)


def _completion(arguments: argparse.Namespace) -> int:
    import shtab

    from lss_motion.cli import main, play

    for parser in (main.make_parser(), play.make_parser()):
        _complete_files(parser)
        print(shtab.complete(parser, arguments.shell))
    return EXIT_FINISHED


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Let every argument that is a path be completed with files, those of commands included."""
    import shtab

    for action in parser._actions:  # noqa: SLF001  (argparse has no public list of arguments)
        if action.type is Path or action.dest == "robot":
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # shtab looks for it
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                _complete_files(inner)
