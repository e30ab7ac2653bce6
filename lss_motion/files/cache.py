"""Files of the cache: results that are kept for the next time, and who wrote them.

An entry is written as a whole and is named by its owner. `mark_of` proves that a program of this
user wrote it: it is a keyed hash, and the key is a file in the user's state folder that others
cannot read. It is worth what the answers beside it are worth, which let a show run functions.
A cache that cannot be written or read is no error; its results are made each time.
"""

from __future__ import annotations

import hashlib
import os
import stat
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.files.output import state_directory, user_folder
from lss_motion.files.source import bounded_data

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

DIRECTORY_VARIABLE: Final = "LSS_MOTION_CACHE_DIR"
"""Environment variable with the folder of the cache."""

BYTES_MAX: Final = 128 * 1024 * 1024
"""The oldest entries are removed beyond this size. Chosen: some fifty long shows."""

PLAN_SUFFIX: Final = ".plan"
SHOW_SUFFIX: Final = ".show"
_UNFINISHED: Final = ".lss_part"
_SUFFIXES: Final = (PLAN_SUFFIX, SHOW_SUFFIX, _UNFINISHED)
"""Of the files that may be removed: the folder is chosen by its user, and may hold others."""

KEY_NAME: Final = "cache.key"
KEY_BYTES: Final = 32
MARK_BYTES: Final = 32


def cache_directory() -> Path:
    """Return the folder of the entries: `LSS_MOTION_CACHE_DIR`, else the user's cache folder."""
    return user_folder(DIRECTORY_VARIABLE, "cache", "plans")


def store(path: Path, parts: Iterable[bytes | memoryview]) -> None:
    """Write an entry; then remove the oldest ones beyond `BYTES_MAX`."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, parts)
        _trim(path.parent)


def mark_of(parts: Iterable[bytes | memoryview], *, may_make_key: bool = False) -> bytes | None:
    """Return what only this user's programs can compute; None if the user has no key.

    `may_make_key`: one is made then.
    """
    path = state_directory() / KEY_NAME
    key = _key(path)
    if key is None and may_make_key:
        with suppress(OSError):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(path, [os.urandom(KEY_BYTES)])
        key = _key(path)
    if key is None:
        return None
    mark = hashlib.blake2b(key=key, digest_size=MARK_BYTES)
    for part in parts:
        mark.update(part)
    return mark.digest()


def _key(path: Path) -> bytes | None:
    key = own_secret(path, KEY_BYTES)
    return key if key is not None and len(key) == KEY_BYTES else None


def own_secret(path: Path, most_bytes: int) -> bytes | None:
    """Return the content of a file that belongs to this user and that no other can open."""
    try:
        state = path.stat()
        content = bounded_data(path, most_bytes)
    except (OSError, InputError):
        return None
    if hasattr(os, "geteuid"):
        others = stat.S_IRWXG | stat.S_IRWXO
        if state.st_uid != os.geteuid() or state.st_mode & others:
            return None
    return content


def _write(path: Path, parts: Iterable[bytes | memoryview]) -> None:
    """Write a file that only this user can read.

    It is renamed when complete, so that another process never reads a part of it. It is not put on
    the disk at once: an entry that power loss damages is found and made again.
    """
    fresh = path.with_name(f"{os.urandom(8).hex()}{_UNFINISHED}")
    created_fd = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o600)
    try:
        with os.fdopen(created_fd, "wb") as stream:
            stream.writelines(parts)
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


_BINARY: Final = getattr(os, "O_BINARY", 0)
"""Without it, Windows writes another end of line."""


def _trim(folder: Path) -> None:
    """Remove the oldest files beyond `BYTES_MAX`, also those that an ended process left."""
    entries = sorted(
        ((path.stat(), path) for path in folder.iterdir() if path.name.endswith(_SUFFIXES)),
        key=lambda pair: pair[0].st_mtime_ns,
        reverse=True,
    )
    total = 0
    for status, entry in entries:
        total += status.st_size
        if total > BYTES_MAX:
            entry.unlink(missing_ok=True)
