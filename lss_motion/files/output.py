"""Writes the files that commands make, and refuses to lose what stands in their place.

`require_outputs` comes before any work. It refuses an output that is a file of the input, and an
existing file that is not of the kind that would be written. `write_output` replaces a file as a
whole or not at all: other programs, and a computer that loses power, see the old text or the new.
"""

from __future__ import annotations

import os
import re
import stat
import sys
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


STATE_VARIABLE: Final = "LSS_MOTION_STATE_DIR"
"""Environment variable with the folder of what the program remembers."""

APP_NAME: Final = "lss_motion"
_BELOW_HOME: Final = {"linux": {"cache": ".cache", "state": ".local/state"}}
"""The user's folders by system, where they are known without platformdirs: to import that takes 9 %
of what numpy takes (measured)."""


class OutputKind(StrEnum):
    """What an output holds. An existing file of the same kind, or an empty one, is replaced."""

    YAML = "YAML file"
    """May have been edited by a person: never replaced without consent."""
    TABLE = "table of angles"
    READINGS = "table of readings"
    PROGRAM = "compiled program"
    LOG = "log of lss-play"
    REPORT = "report of lss-play"
    PICTURE = "picture"
    ROS = "ROS trajectory"
    BLENDER = "Blender animation"
    ARDUINO = "Arduino sketch"
    MCAP = "MCAP recording"
    LEARNT = "file of learnt values"
    PAGE = "web page"
    ARCHIVE = "archive"


HEAD_BYTES: Final = 256
"""The start of an existing file that tells its kind; the patterns below need less."""

_HEADS: Final = {
    OutputKind.TABLE: rb"(# fps: [^\n]*\r?\n)?(t_s,(?!servo,position_deg)|frame,)",
    OutputKind.READINGS: rb"t_s,servo,position_deg",
    OutputKind.PROGRAM: rb"# lss_motion program ",
    OutputKind.LOG: rb'# lss_motion log |\{"format":"lss_motion log",',
    OutputKind.REPORT: rb'\{\s*"schema": \d+,\s*"sequence": ',
    # PNG, JPEG, GIF, PDF, PostScript, TIFF, WebP, compressed SVG, SVG, PGF.
    OutputKind.PICTURE: rb"\x89PNG|\xff\xd8\xff|GIF8|%PDF|%!PS|II\*\0|MM\0\*|RIFF....WEBP|\x1f\x8b"
    rb"|(<\?xml[^>]*>\s*)?(<!DOCTYPE svg|<svg)|%% Creator: Matplotlib",
    OutputKind.ROS: rb"joint_names: \[",
    OutputKind.BLENDER: rb'\{"description": ',
    OutputKind.ARDUINO: rb"// lss_motion sketch",
    OutputKind.MCAP: rb"\x89MCAP0\r\n",
    OutputKind.LEARNT: rb"# lss_motion learnt ",
    OutputKind.PAGE: rb"<!doctype html>",
    OutputKind.ARCHIVE: rb"PK\x03\x04",
}
"""How the files of each kind begin."""

FORCE_REMEDY: Final = "choose another name, or add --force"
OTHER_NAME_REMEDY: Final = "choose another name, or remove it first"


OWN_STREAMS: Final = {"/dev/stdout": 1, "/dev/stderr": 2}
"""Names of the open streams of this process, and their descriptors."""


class Output(NamedTuple):
    """A file that a command is to write; `path` is None if it was not requested."""

    path: Path | None
    kind: OutputKind


def require_outputs(
    outputs: Iterable[Output],
    *,
    sources: Iterable[Path | None] = (),
    is_forced: bool = False,
    remedy: str = FORCE_REMEDY,
) -> None:
    """Raise `InputError` if one of the files must not or cannot be written.

    `sources` are the files that the command reads: they are never replaced, not even `is_forced`.
    A device or a pipe loses nothing, so it may always be written.
    """
    read = [path for path in sources if path is not None]
    wanted: list[Path] = []
    for path, kind in outputs:
        if path is None:
            continue
        if not path.absolute().parent.is_dir():
            raise InputError("cannot be written: its folder does not exist", path=path)
        if path.is_dir():
            raise InputError("is a folder; name a file in it", path=path)
        if any(_is_same(path, other) for other in read):
            raise InputError(
                "is read by this command, so it is not overwritten; choose another name", path=path
            )
        if any(path == other or _is_same(path, other) for other in wanted):
            raise InputError("is named for two outputs; choose another name", path=path)
        if not is_forced and (reason := _in_the_way(path, kind)):
            raise InputError(f"{reason}; {remedy}", path=path)
        wanted.append(path)


def _is_same(path: Path, other: Path) -> bool:
    """Return whether both names lead to one regular file, links included."""
    try:
        return path.samefile(other) and path.is_file()
    except (OSError, ValueError):
        return False


def _in_the_way(path: Path, kind: OutputKind) -> str:
    """Return why an existing file is not replaced; an empty text if it may be."""
    if not path.exists() or not path.is_file():
        return ""
    if kind is OutputKind.YAML:
        return "exists already"
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError as error:
        return f"exists already, and cannot be read ({error.strerror})"
    if not head or re.match(_HEADS[kind], head, re.DOTALL):
        return ""
    return f"exists already, and is no {kind}"


def write_output(
    path: Path,
    data: str | bytes,
    *,
    check: Callable[[Path], None] | None = None,
    like: Path | None = None,
) -> None:
    """Replace the file at `path` as a whole, or raise `InputError` and leave the old one.

    A symbolic link stays, and the file that it names is replaced. Permissions stay as they were; a
    new file gets those of `like`, by default those that the user has set. `check` is called with
    the new file before it takes the place of the old one; what it raises ends the call. Devices and
    pipes are written directly.
    """
    content = data.encode("utf-8") if isinstance(data, str) else data
    try:
        if _is_stream(path):
            own = OWN_STREAMS.get(str(path))
            # Duplicated, because a file that is opened again has a position of its own.
            with path.open("wb") if own is None else os.fdopen(os.dup(own), "wb") as stream:
                stream.write(content)
        else:
            target = Path(os.path.realpath(path))
            _replace(target, content, check, target if like is None or target.exists() else like)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", path=path) from error


def create_output(path: Path, text: str) -> None:
    """Write a file that does not exist yet, or raise `InputError` and leave none."""
    content = text.encode("utf-8")
    try:
        with path.open("xb") as file:
            try:
                file.write(content)
            except OSError:
                path.unlink(missing_ok=True)
                raise
    except FileExistsError:
        raise InputError("is there already, and is not overwritten", path=path.name) from None
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", path=path.name) from None


def _is_stream(path: Path) -> bool:
    """Return whether `path` is no file to be replaced: a device, a pipe, standard output."""
    # A redirected /dev/stdout is a regular file, but must stay the one that the shell has opened.
    if path.absolute().parts[1:2] in (("dev",), ("proc",)):
        return True
    return path.exists() and not path.is_file() and not path.is_dir()


def _replace(
    target: Path, content: bytes, check: Callable[[Path], None] | None, like: Path
) -> None:
    # A name of its own length: that of the target may be as long as the file system allows.
    fresh = target.with_name(f".{os.urandom(8).hex()}.part")
    created_fd = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
    try:
        with os.fdopen(created_fd, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        if check is not None:
            check(fresh)
        with suppress(FileNotFoundError):
            _take_permissions(fresh, like.stat())
        fresh.replace(target)
    finally:
        with suppress(OSError):
            fresh.unlink()
    _sync_folder(target.parent)


_BINARY: Final = getattr(os, "O_BINARY", 0)
"""Without it, Windows writes another end of line."""


def _take_permissions(fresh: Path, old: os.stat_result) -> None:
    if hasattr(os, "chown") and (old.st_uid, old.st_gid) != (os.geteuid(), os.getegid()):
        with suppress(PermissionError):  # Only the superuser gives files away.
            os.chown(fresh, old.st_uid, old.st_gid)
    fresh.chmod(stat.S_IMODE(old.st_mode))


def _sync_folder(folder: Path) -> None:
    """Put the new name on the disk, where the system has a way to do so."""
    with suppress(OSError):
        folder_fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(folder_fd)
        finally:
            os.close(folder_fd)


def state_directory() -> Path:
    """Return the folder of what the program remembers, of the user or `LSS_MOTION_STATE_DIR`."""
    return user_folder(STATE_VARIABLE, "state")


def user_folder(variable: str, kind: Literal["cache", "state"], *below: str) -> Path:
    """Return the folder that an environment variable names, else one `below` the user's own."""
    if chosen := os.environ.get(variable):
        return Path(chosen)
    if (below_home := _BELOW_HOME.get(sys.platform)) is not None:
        if not (own := Path(os.environ.get(f"XDG_{kind.upper()}_HOME", ""))).is_absolute():
            own = Path.home() / below_home[kind]
        return own.joinpath(APP_NAME, *below)
    import platformdirs

    found = {"cache": platformdirs.user_cache_path, "state": platformdirs.user_state_path}[kind]
    return found(APP_NAME, appauthor=False).joinpath(*below)
