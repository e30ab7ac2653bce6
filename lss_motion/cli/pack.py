"""The command `pack-report`: one file with what is needed to find a fault."""

from __future__ import annotations

import importlib.metadata
import io
import json
import platform
import re
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import to_builtins

from lss_motion import __version__
from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, InputError, LssMotionError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable

    from lss_motion.cli.commands import Commands

DESCRIPTION: Final = """\
Pack what somebody else needs to find a fault: a show or a stage with all files that it is made of,
logs and reports of it, what `check` and `doctor` say, and the versions of the programs.

  lss-motion pack-report show.yaml show.log report.json -o fault.zip

Sounds, pictures and Python files are named with their size, not packed. Left out are the keys of a
network, whatever stands at a key such as password, token or webhook, user and password in an
address, and the name of your home folder. Look into the file before you send it: names, angles and
times are in it. No port is opened and nothing moves.
"""
PACKED: Final = frozenset({".yaml", ".yml", ".json", ".lss", ".csv", ".log", ".txt", ".urdf"})
"""What is text, and is not a program."""
PACKED_MAX_BYTES: Final = 64_000_000
"""Of one file: the log of eight hours. Larger ones are named only."""

SECRET: Final = re.compile(
    r"(?im)^(?P<key>[^\n#]*?['\"{,\s]?(?:password|passwd|token|secret|webhook|api_?key|psk)['\"]?\s*:)"
    r"[^\n,}]*"
)
LOGIN: Final = re.compile(r"(?P<scheme>[a-z][a-z0-9+.-]*://)[^\s/@'\"]+@", re.IGNORECASE)
QUERY: Final = re.compile(r"(?P<address>https?://[^\s?'\"]+)\?[^\s'\"]+", re.IGNORECASE)
LEFT_OUT: Final = "(left out)"


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    added = add_command(commands, "pack-report", _pack, DESCRIPTION)
    added.add_argument("file", type=Path, metavar="FILE", help="a show, a robot or a stage")
    added.add_argument("more", nargs="*", type=Path, metavar="LOG", help="logs and reports of it")
    add_options(added, "--robot")
    add_options(added, "--output", required=True, metavar="F.zip", help="the file to write")
    add_options(added, "--force")


def _pack(arguments: argparse.Namespace) -> int:
    require_outputs(
        [Output(arguments.output, OutputKind.ARCHIVE)],
        sources=[arguments.file, arguments.robot, *arguments.more],
        is_forced=arguments.force,
    )
    for path in (arguments.file, *arguments.more):
        if not path.is_file():
            raise InputError("file not found; check the name", path=path)
    checked, read = _checked(arguments.file, arguments.robot)
    paths = dict.fromkeys(path.absolute() for path in (arguments.file, *read, *arguments.more))
    packed, named = _sorted(paths)
    names = _short_names(packed)
    about = {
        "format": "lss_motion fault report",
        "version": 1,
        "made": datetime.now(tz=UTC).isoformat(timespec="seconds"),
        "versions": _versions(),
        "check": checked,
        "doctor": _doctor(),
        "files": {name: str(path) for path, name in names.items()},
        "named_only": [{"file": str(path), "bytes": size} for path, size in named],
    }
    texts = {
        f"files/{name}": without_secrets(path.read_text(encoding="utf-8", errors="replace"))
        for path, name in names.items()
    }
    texts["report.json"] = without_secrets(json.dumps(about, indent=2, default=str))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in texts.items():
            archive.writestr(name, text)
    write_output(arguments.output, out.getvalue())
    say(f"{arguments.output}: {counted(texts, 'file')}, {len(out.getvalue()) / 1000:.0f} kB")
    for path, size in named:
        say(f"named, not packed: {path} ({size} bytes)")
    say("look into it before you send it; what it leaves out: lss-motion pack-report --help")
    return EXIT_FINISHED


def without_secrets(text: str) -> str:
    """Return a text without passwords, logins in addresses, and the home folder's name."""
    text = SECRET.sub(rf"\g<key> {LEFT_OUT}", text)
    text = LOGIN.sub(rf"\g<scheme>{LEFT_OUT}@", text)
    text = QUERY.sub(rf"\g<address>?{LEFT_OUT}", text)
    home = str(Path.home())
    return text.replace(home, "~") if len(home) > 1 else text


def _checked(path: Path, robot_path: Path | None) -> tuple[Any, list[Path]]:
    """Return what `check` says, or its error, and the files that were read for it."""
    from lss_motion.files.source import ABSENT, recorded
    from lss_motion.stage.check import file_as_json

    with recorded() as record:
        try:
            found = file_as_json(path, robot_path)
        except LssMotionError as error:
            found = {"error": type(error).__name__, "text": str(error)}
    read = [Path(name) for name, state in record.states.items() if state != ABSENT]
    return found, [one for one in read if one.is_file()]


def _sorted(paths: Iterable[Path]) -> tuple[list[Path], list[tuple[Path, int]]]:
    """Return the files to pack, and those that are only named, with their size."""
    packed: list[Path] = []
    named: list[tuple[Path, int]] = []
    for path in paths:
        size = path.stat().st_size
        if path.suffix.lower() in PACKED and size <= PACKED_MAX_BYTES:
            packed.append(path)
        else:
            named.append((path, size))
    return packed, named


def _short_names(paths: Iterable[Path]) -> dict[Path, str]:
    """Return a name for each file that no other one has."""
    names: dict[Path, str] = {}
    for path in paths:
        name, count = path.name, 1
        while name in names.values():
            count += 1
            name = f"{path.stem}_{count}{path.suffix}"
        names[path] = name
    return names


def _versions() -> dict[str, str]:
    packages = ("msgspec", "numpy", "pyserial", "PyYAML", "rich", "scipy", "toppra")
    return {
        "lss_motion": __version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        **{name: importlib.metadata.version(name) for name in packages},
    }


def _doctor() -> Any:  # noqa: ANN401  JSON
    from lss_motion.system.computer import examine

    return to_builtins(examine())
