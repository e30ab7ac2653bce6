"""How a command of `lss-motion` is declared."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, TypeAlias

from lss_motion import __version__
from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # noqa: SLF001
    """What `add_subparsers` returns; argparse has no public name for it."""


def add_command(
    commands: Commands,
    name: str,
    handler: Callable[[argparse.Namespace], int],
    text: str,
    description: str | None = None,
) -> argparse.ArgumentParser:
    """Add a command that runs `handler`, which returns the exit code; return its parser."""
    added = commands.add_parser(
        name,
        help=text,
        description=description or text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    added.set_defaults(handler=handler)
    return added


def add_version(parser: argparse.ArgumentParser) -> None:
    """Add `--version`, which prints the program and its version."""
    parser.add_argument(
        "--version", action="version", version=f"%(prog)s {__version__}", help="print the version"
    )


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add `--force`, for `refuse_overwriting`."""
    parser.add_argument("--force", action="store_true", help="overwrite a file that is there")


def refuse_overwriting(path: Path | None, *, is_forced: bool) -> None:
    """Raise `InputError` if `path` is there already.

    The rule of all commands: a YAML file (robot, sequence, map, backup) may have been edited, so it
    is overwritten only with `--force`. What a command can make again or has just measured (tables,
    pictures, compiled programs, reports, logs) is replaced. `jog`, `calibrate` and `identify`
    change single values of the robot file that they are given.
    """
    if path is not None and path.exists() and not is_forced:
        raise InputError("is there already; choose another name, or add --force", path=path)
