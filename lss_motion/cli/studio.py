"""The command `studio`: see and run a show in a browser."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli import served
from lss_motion.cli.commands import add_command, print_json
from lss_motion.cli.messages import put
from lss_motion.cli.options import add_options
from lss_motion.cli.terminal import is_at_keyboard
from lss_motion.errors import EXIT_FINISHED, InputError

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands
    from lss_motion.studio.access import RoleName
    from lss_motion.studio.studio import Studio

DESCRIPTION: Final = """\
See and run a show in a browser: its plan, the moving figure, the state of every servo.

  lss-motion studio wave.yaml                              at this computer
  lss-motion studio wave.yaml --port /dev/ttyUSB0          on this port
  lss-motion studio wave.yaml --listen 192.168.1.20        for a tablet, too

Open the address that is printed; it holds the key to the robot, so keep it to yourself. Other
devices pair with a code that the page shows. Everyone who may look may stop, one client operates.
A file that changes on disk is planned again. Ctrl-C stops the show and ends.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    studio = add_command(commands, "studio", _studio, DESCRIPTION)
    studio.add_argument(
        "file", type=Path, metavar="FILE", help="a sequence, a gait, a play list or a robot (.yaml)"
    )
    add_options(studio, "--port", "--robot", "--robot-cache")
    studio.add_argument(
        "--listen",
        default="",
        metavar="ADDRESS[:PORT]",
        help="serve this address of the computer, too; :PORT alone sets the port (default: any)",
    )
    add_options(studio, "--tls-certificate", help="serve that address with TLS")
    add_options(studio, "--tls-key")
    add_options(
        studio,
        "--on-operator-lost",
        help="what a show does when its operator, or the server, is gone (default go_on)",
    )
    studio.add_argument("--no-browser", action="store_true", help="print the address only")
    add_options(studio, "--allow-run", "--json")


def _studio(arguments: argparse.Namespace) -> int:
    with served.needing("the studio needs three packages", "studio"):
        from lss_motion.studio.server import serve
    from lss_motion.files.source import read_data
    from lss_motion.studio.desk import DeskOptions
    from lss_motion.studio.studio import StudioOptions

    read_data(arguments.file)  # What cannot be read is said here, not in the browser.
    host, port = _address(arguments.listen)
    tls = served.tls_of(arguments)
    options = StudioOptions(
        path=arguments.file,
        robot_path=arguments.robot,
        backup=arguments.robot_cache,
        port=arguments.port,
        listen_host=host,
        listen_port=port,
        certificate=tls.certificate,
        key=tls.key,
        desk=DeskOptions(on_lost=arguments.on_operator_lost, may_run=arguments.allow_run),
    )
    serve(
        options,
        lambda studio: _tell(studio, is_json=arguments.json),
        opens=not (arguments.no_browser or arguments.json) and has_desktop(),
    )
    return EXIT_FINISHED


def _tell(studio: Studio, *, is_json: bool) -> None:
    if is_json:
        print_json(served.addresses_json(studio))
        return
    served.print_addresses(studio, "studio")
    if len(studio.addresses) > 1:
        _print_code(studio, "operate")
        _make_codes_on_enter(studio)
    put("Ctrl-C stops the show and ends")


def _print_code(studio: Studio, role: RoleName) -> None:
    code = studio.make_code(role)
    put(f"studio: code {code[:3]} {code[3:]} gives one device the role {role}, for two minutes")


def _make_codes_on_enter(studio: Studio) -> None:
    """Let a person at the terminal make more codes: Enter, or the name of a role."""
    import asyncio

    from lss_motion.studio.access import ROLE_NAMES

    if not is_at_keyboard():
        return
    put("studio: Enter makes another code; so do the words view, operate and edit")

    def read() -> None:
        line = sys.stdin.readline()
        if not line:
            asyncio.get_running_loop().remove_reader(sys.stdin)
            return
        word = line.strip().lower() or "operate"
        for role in ROLE_NAMES:
            if role == word:
                _print_code(studio, role)
                return
        put(f"{word!r} is no role: {', '.join(ROLE_NAMES)}")

    asyncio.get_running_loop().add_reader(sys.stdin, read)


def _address(text: str) -> tuple[str | None, int]:
    """Return host and port of `--listen`."""
    host, colon, port = text.rpartition(":") if text.count(":") == 1 else (text, "", "")
    if host in ("0.0.0.0", "::", "*"):  # noqa: S104  (refused)
        raise InputError(f"--listen {host}: give the one address that the tablet reaches")
    if colon and not (port.isascii() and port.isdigit() and int(port) < 65536):
        raise InputError(f"--listen {text}: the port is a number below 65536")
    return host or None, int(port) if colon else 0


def has_desktop() -> bool:
    """Return whether there is a screen to open a browser on."""
    if sys.platform == "darwin":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
