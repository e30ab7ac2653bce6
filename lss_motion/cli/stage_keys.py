"""The command `stage-keys`: keys for the computers of a stage."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, print_json
from lss_motion.cli.messages import put
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, InputError

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands

DESCRIPTION: Final = """\
Make keys for the computers of a stage, so that no other computer can take part: a small authority
(ca.pem, ca.key) and, for each figure of the stage, a certificate and its key.

  lss-motion stage-keys hall.yaml              into the folder that the stage names
  lss-motion stage-keys hall.yaml keys         into this folder

Name the folder in the stage file: `network: {keys: keys}`. Copy ca.pem, FIGURE.pem and FIGURE.key
to the computer of each figure, and ca.key to none: with it more figures can be made. Figures that
have keys keep them; what is there is never overwritten. A computer that was lost or stolen keeps
its key: make new keys for all, in an empty folder.

Exit codes: 0 every figure has keys; 2 the stage file or the folder must change, or the extra
[network] is missing.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    keys = add_command(commands, "stage-keys", _keys, DESCRIPTION)
    keys.add_argument("stage", type=Path, metavar="STAGE", help="the stage file (.yaml)")
    keys.add_argument(
        "folder",
        type=Path,
        nargs="?",
        metavar="FOLDER",
        help="where the keys are written (default: the folder that the stage names, or else keys "
        "beside its file)",
    )
    add_options(keys, "--json")


def _keys(arguments: argparse.Namespace) -> int:
    from lss_motion.stage.hosts.peer import make_keys
    from lss_motion.stage.load import load_stage

    stage = load_stage(arguments.stage)
    if not stage.figures:
        raise InputError(
            "has no figures: a stage on one computer needs no keys", path=arguments.stage
        )
    folder = arguments.folder or stage.keys or arguments.stage.parent / "keys"
    written = make_keys(stage.name, stage.figures, folder)
    copies = {name: ["ca.pem", f"{name}.pem", f"{name}.key"] for name in stage.figures}
    if arguments.json:
        print_json(
            {
                "folder": str(folder),
                "written": [path.name for path in written],
                "copy": copies,
            }
        )
        return EXIT_FINISHED
    for path in written:
        put(f"wrote {path}")
    if not written:
        put(f"{folder} has keys for every figure already")
    for name, files in copies.items():
        put(f"the computer of {name} needs {', '.join(files)}")
    if stage.keys is None:
        put(f"name the folder in {arguments.stage}: network: {{keys: {folder.name}}}")
    return EXIT_FINISHED
