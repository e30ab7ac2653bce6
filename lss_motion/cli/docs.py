"""The command `docs`: open the guides."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import say
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.texts import known_names

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands

DESCRIPTION: Final = """\
Open the guides in the browser, or print where they are.

  lss-motion docs              open them
  lss-motion docs --list       print the names of the pages
  lss-motion docs recipes      print this page

They are web pages where these were built before the package, and Markdown else.
"""
PACKAGE: Final = Path(__file__).resolve().parent.parent
CHECKOUT: Final = PACKAGE.parent


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    added = add_command(commands, "docs", _docs, DESCRIPTION)
    added.add_argument("page", nargs="?", metavar="PAGE", help="print this page")
    added.add_argument("--list", action="store_true", help="print the names of the pages")


def _docs(arguments: argparse.Namespace) -> int:
    folder = guides_folder()
    names = sorted(path.stem for path in folder.glob("*.md"))
    if arguments.list:
        say("\n".join(names))
        return EXIT_FINISHED
    if arguments.page is not None:
        if arguments.page not in names:
            known = known_names(arguments.page, names)
            raise InputError(f"there is no page {arguments.page!r}; {known}")
        say((folder / f"{arguments.page}.md").read_text(encoding="utf-8"), end="")
        return EXIT_FINISHED
    sites = (PACKAGE / "site" / "index.html", CHECKOUT / "build" / "site" / "index.html")
    shown = next((path for path in sites if path.is_file()), None)
    if shown is not None and webbrowser.open(shown.as_uri()):
        say(f"opened {shown}")
    else:
        say(f"the guides are in {shown or folder}; lss-motion docs --list names them")
    return EXIT_FINISHED


def guides_folder() -> Path:
    """Return the folder of the guides: in a wheel in the package, in a checkout beside it."""
    packaged = PACKAGE / "guides"
    folder = packaged if packaged.is_dir() else CHECKOUT / "sequences" / "guides"
    if not folder.is_dir():
        raise InputError("the guides are not here; install the package again", path=folder)
    return folder
