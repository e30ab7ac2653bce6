"""The commands `publish` and `verify`: a show as one page that proves itself."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, EXIT_NOT_FOLLOWED, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.texts import counted

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands

PUBLISH_TEXT: Final = """\
Write a show as one page, to show it to others: the figure that moves, its sounds, the plan of each
joint, the predicted error of each horn, what `check` says, and all files that it is made of.

  lss-motion publish show.yaml -o show.html

The page needs no other file and no network. Whoever has it has the files of the show, sounds
included. Learnt values are not in it; functions of a show are named, and never called.
"""
VERIFY_TEXT: Final = """\
Plan the show in a page of `publish` again, and compare.

  lss-motion verify show.html

Compared are the files with their hashes, the plan (0.01 deg, 1 ms), what `check` says, and the page
itself, if this version of the program made it. That proves that the page is consistent: its curves
and its verdict are those of its files. It does not prove who made it.

Exit codes: 0 consistent; 2 no such page; 5 something differs.
"""
SHOWN_MAX: Final = 10


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    added = add_command(commands, "publish", _publish, PUBLISH_TEXT)
    added.add_argument("file", type=Path, metavar="FILE", help="a sequence or a gait")
    add_options(added, "--robot")
    add_options(added, "--output", required=True, metavar="F.html", help="the page to write")
    add_options(added, "--force")
    added = add_command(commands, "verify", _verify, VERIFY_TEXT)
    added.add_argument("file", type=Path, metavar="FILE", help="a page of publish")


def _publish(arguments: argparse.Namespace) -> int:
    from lss_motion.studio.publish import page_of, published, verdict_of

    require_outputs(
        [Output(arguments.output, OutputKind.PAGE)],
        sources=[arguments.file, arguments.robot],
        is_forced=arguments.force,
    )
    data = published(arguments.file, arguments.robot)
    page = page_of(data)
    write_output(arguments.output, page)
    say(f"{arguments.output}: {len(page) / 1000:.0f} kB, {counted(data['files'], 'file')} in it")
    say("\n".join(verdict_of(data)))
    return EXIT_FINISHED


def _verify(arguments: argparse.Namespace) -> int:
    from lss_motion.files.source import read_text
    from lss_motion.studio.publish import data_of, verified

    page = read_text(arguments.file)
    try:
        data = data_of(page)
        problems = verified(page)
    except InputError as error:
        raise InputError(error.reason, path=arguments.file) from error
    for text in problems[:SHOWN_MAX]:
        say(text, sys.stderr)
    if len(problems) > SHOWN_MAX:
        say(f"and {counted(len(problems) - SHOWN_MAX, 'more difference')}", sys.stderr)
    if problems:
        say(f"{arguments.file}: not consistent", sys.stderr)
        return EXIT_NOT_FOLLOWED
    say(
        f"{arguments.file}: consistent: the files in it give this plan and this verdict. Made by "
        f"lss_motion {data['made_by']['lss_motion']}; by whom, a page cannot prove"
    )
    return EXIT_FINISHED
