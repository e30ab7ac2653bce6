"""Reads text files with a bound on their size; values with their place.

Every failure is an `InputError` with the path and, where there is one, the line.
"""

from __future__ import annotations

import stat
from typing import TYPE_CHECKING, BinaryIO, ClassVar, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.record import note_content

if TYPE_CHECKING:
    from pathlib import Path


FILE_MAX_BYTES: Final = 16_000_000
"""Twice the 8 MB of 10,000 keyframes of 40 joints."""

RECORDING_MAX_BYTES: Final = 64_000_000
"""The most that is read of a recording, a report or a table. Ten minutes of 20 joints at 100 Hz are
42 MB in the longest format (pypot). Measured: 50 MB of CSV need 0.2 to 0.6 GB of memory, 50 MB of
JSON 0.6 GB, and 1 GB in the worst case."""


class Located(Struct, frozen=True, kw_only=True, eq=False):
    """A value that knows where it was written, which is not compared.

    `_where` of its class names the fields with files and lines.
    """

    _where: ClassVar[frozenset[str]]

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self._content() == other._content()

    def __hash__(self) -> int:
        return hash(self._content())

    def _content(self) -> tuple[object, ...]:
        fields = (name for name in self.__struct_fields__ if name not in self._where)
        return tuple([getattr(self, name) for name in fields])


def _opened(path: Path) -> BinaryIO:
    """Return a regular file or raise `InputError` or `OSError`; nothing else is even opened."""
    if not path.is_dir() and not stat.S_ISREG(path.stat().st_mode):
        raise InputError("is a device or a pipe; a file is needed", path=path)
    return path.open("rb")


def read_data(path: Path, max_bytes: int = FILE_MAX_BYTES) -> bytes:
    """Return the content of a file of at most `max_bytes`, or raise `InputError`.

    The record of what is read notes it (`record`).
    """
    data = bounded_data(path, max_bytes)
    note_content(path, data)
    return data


def bounded_data(path: Path, max_bytes: int = FILE_MAX_BYTES) -> bytes:
    """Return the content of a file on which no result depends; otherwise as `read_data`.

    Only regular files are opened: a pipe might never deliver a byte, a device never end.
    """
    try:
        with _opened(path) as stream:
            data = stream.read(max_bytes + 1)
    except FileNotFoundError:
        raise InputError("file not found; check the name", path=path) from None
    except IsADirectoryError:
        raise InputError("is a folder; name a file in it", path=path) from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have.
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot be read: {reason}", path=path) from error
    if len(data) > max_bytes:
        most = f"{max_bytes // 1_000_000} MB"
        raise InputError(f"is larger than {most}, the most that is read", path=path)
    return data


def text_of(data: bytes, path: Path) -> str:
    """Return UTF-8 text without its byte-order mark, or raise `InputError`."""
    if b"\0" in data:
        raise InputError("is a binary file (or UTF-16); a text file in UTF-8 is needed", path=path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # `error.object` is what was decoded: `data` without its byte-order mark.
        line = error.object.count(b"\n", 0, error.start) + 1
        reason = f"byte 0x{error.object[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise InputError(reason, path=path, line=line) from error


def read_text(path: Path, max_bytes: int = FILE_MAX_BYTES) -> str:
    """Return the UTF-8 text of a file of at most `max_bytes`, or raise `InputError`."""
    return text_of(read_data(path, max_bytes), path)
