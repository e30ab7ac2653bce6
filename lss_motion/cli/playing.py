"""`lss-motion play`: the same as `lss-play`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.cli import play
from lss_motion.cli.commands import add_command

if TYPE_CHECKING:
    from lss_motion.cli.commands import Commands


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    description = f"{play.DESCRIPTION}\n\n{play.EPILOG}"
    play.add_arguments(
        add_command(commands, "play", play.play, "the same as lss-play", description)
    )
