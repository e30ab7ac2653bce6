"""The command `morning`: what happened on a stage in a night, from its log."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, print_json
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import Kind, Output, require_outputs, write_output

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands

DESCRIPTION: Final = """\
Sum up a night of a stage from the folder of its log: what played, which cues fired or were refused
and why, faults, the hottest servo, the worst error, and what to look at.

  lss-motion morning log
  lss-motion morning log --since "2026-10-30 18:00" --html night.html
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    morning = add_command(commands, "morning", _morning, DESCRIPTION)
    morning.add_argument("folder", type=Path, metavar="LOG_DIR", help="the folder of the log")
    morning.add_argument(
        "--since",
        metavar="TIME",
        help="from this time on, such as 2026-10-30 18:00 (default: the last 24 hours of the log)",
    )
    morning.add_argument("--html", type=Path, metavar="F.html", help="write a page with plots")
    add_options(morning, "--json", "--force")


def _morning(arguments: argparse.Namespace) -> int:
    from lss_motion.stage.morning import as_json, html_of, read_night, text_of

    require_outputs([Output(arguments.html, Kind.PAGE)], is_forced=arguments.force)
    night = read_night(arguments.folder, _time(arguments.since))
    if arguments.html is not None:
        name = arguments.folder.absolute().parent.name
        write_output(arguments.html, html_of(night, name))
    if arguments.json:
        print_json(as_json(night))
    else:
        say("\n".join(text_of(night)))
    return EXIT_FINISHED


def _time(text: str | None) -> datetime | None:
    if text is None:
        return None
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"--since {text!r} is no time, such as 2026-10-30 18:00") from None
