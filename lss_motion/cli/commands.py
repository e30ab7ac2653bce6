"""How a command of `lss-motion` is declared."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, TypeAlias

from lss_motion import __version__

if TYPE_CHECKING:
    from collections.abc import Callable

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
