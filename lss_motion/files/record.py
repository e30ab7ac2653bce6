"""What a result was read from, so that it can be told later whether it would be the same again.

    with recorded() as record:
        show = prepare(path)            # reads files by `source`
    record.states                       # each of them with what it was
    are_unchanged(record.states)        # later: whether all of them still are

Inside `recorded`, `source.read_data` notes each file with a hash of its content, and `looked_for`
whether there was a file. What depends on more than files, such as on the modules that Python finds,
calls `note_unrepeatable`.
"""

from __future__ import annotations

import hashlib
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError

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
