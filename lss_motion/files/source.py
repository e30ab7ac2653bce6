"""Reads text files with a bound on their size, and notes what a result was read from.

    with recorded() as record:
        show = prepare(path)            # reads files by `read_text` and the like
    record.states                       # each of them with what it was
    are_unchanged(record.states)        # later: whether all of them still are

Inside `recorded`, `read_data` notes each file with a hash of its content, and `looked_for` whether
there was a file. What depends on more than files, such as on the modules that Python finds, calls
`note_unrepeatable`. Inside `with_edits`, files that are being edited have the content that is not
saved yet. Every failure is an `InputError` with the path and, where there is one, the
line.
"""

from __future__ import annotations

import hashlib
import stat
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, ClassVar, Final

from msgspec import Struct

from lss_motion.errors import InputError

Location = tuple[str | int, ...]
"""The path from the top of a file to a value: keys of mappings and indices of lists."""

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

ABSENT: Final = "absent"
PRESENT: Final = "present"
"""There was a file, whose content made no difference."""


class Record:
    """Files by name, as it was given, each with `ABSENT`, `PRESENT` or the hash of its content."""

    def __init__(self) -> None:
        self.states: dict[str, str] = {}
        self.is_repeatable = True
        """False if more than the files decided, or if a file changed while it was read."""

    def note(self, path: Path, state: str) -> None:
        """Note what a file is; its content says more than that it is there."""
        before = self.states.setdefault(str(path), state)
        if before == PRESENT and state != ABSENT:
            self.states[str(path)] = state
        elif state != before and (state != PRESENT or before == ABSENT):
            self.is_repeatable = False


_open: ContextVar[Record | None] = ContextVar("record", default=None)


@contextmanager
def recorded() -> Iterator[Record]:
    """Yield the record of what is read and looked for inside of this block, in this thread."""
    record = Record()
    token = _open.set(record)
    try:
        yield record
    finally:
        _open.reset(token)


_edited: ContextVar[Mapping[Path, bytes] | None] = ContextVar("edited", default=None)


@contextmanager
def with_edits(contents: Mapping[Path, bytes]) -> Iterator[None]:
    """Let files, by their full paths, have another content inside of this block, in this thread."""
    token = _edited.set(contents)
    try:
        yield
    finally:
        _edited.reset(token)


def note_content(path: Path, data: bytes) -> None:
    """Note that a result depends on the content of a file."""
    if (record := _open.get()) is not None:
        record.note(path, _hash(data))


def note_unrepeatable() -> None:
    """Note that a result depends on more than files."""
    if (record := _open.get()) is not None:
        record.is_repeatable = False


def looked_for(path: Path, *, is_found: bool) -> bool:
    """Return `is_found`, and note that a result depends on whether there is a file."""
    if (record := _open.get()) is not None:
        record.note(path, PRESENT if is_found else ABSENT)
    return is_found


def are_unchanged(states: Mapping[str, str], read: Callable[[Path], bytes]) -> bool:
    """Return whether every file is what it was; `read` returns the content of one."""
    return all(_is_unchanged(Path(name), state, read) for name, state in states.items())


def _is_unchanged(path: Path, state: str, read: Callable[[Path], bytes]) -> bool:
    if state == ABSENT:
        return not path.exists()
    if state == PRESENT:
        return path.is_file()
    try:
        return _hash(read(path)) == state
    except InputError:
        return False


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


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
    if (edits := _edited.get()) and (edited := edits.get(path.resolve())) is not None:
        return edited
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
