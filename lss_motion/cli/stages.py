"""The commands around a stage: `stage-keys`, `morning` and `install-service`."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, print_json
from lss_motion.cli.messages import put, say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands
    from lss_motion.system.service import ServiceUnit

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
    """Add the commands of this module."""
    _add_service(commands)
    _add_morning(commands)
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


MORNING_TEXT: Final = """\
Sum up a night of a stage from the folder of its log: what played, which cues fired or were refused
and why, faults, the hottest servo, the worst error, and what to look at.

  lss-motion morning log
  lss-motion morning log --since "2026-10-30 18:00" --html night.html
"""


def _add_morning(commands: Commands) -> None:
    morning = add_command(commands, "morning", _morning, MORNING_TEXT)
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

    require_outputs([Output(arguments.html, OutputKind.PAGE)], is_forced=arguments.force)
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


SERVICE_TEXT: Final = """\
Start a stage with the computer, by systemd: write a unit, check it, and start it. The stage begins
at every boot, waits for its port and servos, is started again if it ends, and is stopped safely
when the computer is shut down. The unit is printed with its reasons; nothing else is changed.

  lss-motion install-service hall.yaml --print       what would be written
  sudo lss-motion install-service hall.yaml          write it, and start the stage now
  sudo lss-motion install-service hall.yaml --remove
  journalctl -u lss-hall -f                          what the stage tells

The user is the owner of the stage file, or the one of --user; it needs no other rights than those
of the unit, and never runs as root.
"""
UNITS: Final = Path("/etc/systemd/system")
GROUPS: Final = ("dialout", "uucp", "audio", "gpio")
"""Groups of serial ports (Debian, Arch), sound devices and pins (Raspberry Pi OS)."""


def _add_service(commands: Commands) -> None:
    service = add_command(
        commands,
        "install-service",
        _install,
        SERVICE_TEXT,
    )
    service.add_argument("stage", type=Path, metavar="STAGE", help="the stage file (.yaml)")
    service.add_argument("--user", metavar="NAME", help="the user that runs the stage")
    add_options(service, "--port", "--allow-run")
    service.add_argument(
        "--print", action="store_true", dest="is_shown", help="print the unit; change nothing"
    )
    service.add_argument(
        "--remove", action="store_true", help="stop the stage, and remove its unit"
    )
    service.add_argument("--folder", type=Path, default=UNITS, help=f"of units (default {UNITS})")


def _install(arguments: argparse.Namespace) -> int:
    from lss_motion.system.service import unit_text

    if not sys.platform.startswith("linux"):
        raise InputError("install-service is for systemd, which only Linux has")
    path = arguments.folder / f"{unit_name(arguments.stage)}.service"
    if arguments.remove:
        return _remove(path)
    unit = _unit(arguments)
    text = unit_text(unit)
    if arguments.is_shown:
        put(text, end="")
        return EXIT_FINISHED
    _require_ours(path)
    _require_root(path, arguments)
    _verify(path.name, text)
    put(f"{path}:\n{text}", end="")
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", path=path) from None
    _control(path, ("daemon-reload",), ("enable", path.name), ("restart", path.name))
    put(f"the stage starts with this computer; what it tells: journalctl -u {path.stem} -f")
    return EXIT_FINISHED


def unit_name(stage: Path) -> str:
    """Return the name of the unit of a stage file."""
    return "lss-" + re.sub(r"[^A-Za-z0-9_.-]", "_", stage.stem)


def _unit(arguments: argparse.Namespace) -> ServiceUnit:
    from lss_motion.files.source import read_data
    from lss_motion.system.service import ServiceUnit

    read_data(arguments.stage)
    stage = arguments.stage.resolve()
    user, groups = _user(arguments.user, stage)
    command = [sys.executable, "-P", "-m", "lss_motion.cli.start", "serve", str(stage)]
    command += ["--wait-port", "--real-time"]
    if arguments.port is not None:
        command += ["--port", arguments.port]
    if arguments.allow_run:
        command.append("--allow-run")
    try:
        return ServiceUnit(
            stage=stage.stem,
            command=tuple(command),
            folder=stage.parent,
            user=user,
            groups=groups,
            is_networked=True,
            variables={"PYTHONUNBUFFERED": "1"},
        )
    except ValueError as error:
        raise InputError(str(error)) from None


def _user(name: str | None, stage: Path) -> tuple[str, tuple[str, ...]]:
    """Return the user that runs the stage, and the groups of devices that this system has."""
    import grp
    import pwd

    owner = name or os.environ.get("SUDO_USER")
    try:
        found = pwd.getpwnam(owner) if owner else pwd.getpwuid(stage.stat().st_uid)
    except KeyError:
        known = owner or f"number {stage.stat().st_uid}"
        raise InputError(f"there is no user {known}; name one with --user") from None
    if found.pw_uid == 0:
        raise InputError(
            "a stage does not run as root; name its user with --user, which can read its files"
        )
    present = {group.gr_name for group in grp.getgrall()}
    return found.pw_name, tuple(group for group in GROUPS if group in present)


def _require_ours(path: Path) -> None:
    """Refuse to replace or remove a unit that another program or person has written."""
    from lss_motion.system.service import MARK

    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(MARK):
        raise InputError("was not written by install-service, and is left as it is", path=path)


def _require_root(path: Path, arguments: argparse.Namespace) -> None:
    if os.access(path.parent, os.W_OK):
        return
    words = [sys.executable, "-m", "lss_motion.cli.start", "install-service"]
    words.append(str(arguments.stage.resolve()))
    raise InputError(
        f"{path.parent} cannot be written; run it as root: sudo {' '.join(words)} (with the same "
        f"options), or see the unit with --print"
    )


def _verify(name: str, text: str) -> None:
    """Let systemd check the unit, where it is installed; raises `InputError` with its words."""
    if shutil.which("systemd-analyze") is None:
        put("systemd-analyze is not here: the unit is not checked")
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_text(text, encoding="utf-8")
        done = subprocess.run(  # noqa: S603
            ["systemd-analyze", "verify", "--man=no", str(path)],  # noqa: S607
            capture_output=True,
            text=True,
            check=False,
        )
    wrong = [line for line in done.stderr.splitlines() if name in line]
    if done.returncode and wrong:
        raise InputError("systemd refuses the unit: " + "; ".join(wrong))


def _control(path: Path, *orders: tuple[str, ...]) -> None:
    """Let systemd do this; where it does not run, print what to do."""
    if path.parent != UNITS or not Path("/run/systemd/system").is_dir():
        put("systemd does not run here; on the computer of the robot:")
        for order in orders:
            put(f"  sudo systemctl {' '.join(order)}")
        return
    for order in orders:
        done = subprocess.run(  # noqa: S603
            ["systemctl", *order],  # noqa: S607
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise InputError(f"systemctl {' '.join(order)}: {done.stderr.strip()}")


def _remove(path: Path) -> int:
    if not path.exists():
        raise InputError("there is no such unit; nothing was changed", path=path)
    _require_ours(path)
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path.parent} cannot be written; run it as root, with sudo")
    _control(path, ("disable", "--now", path.name))
    path.unlink()
    _control(path, ("daemon-reload",))
    put(f"{path} is removed; the stage does not start any more")
    return EXIT_FINISHED
