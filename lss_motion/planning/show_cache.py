"""Shows on disk: a show whose files are unchanged is loaded, not read, planned and compiled again.

The name of an entry is a hash of the command line and the folder where it was given. An entry holds
the states of all files that the show was made of (`files.record`), then the show. It counts only if

- its mark proves that a program of this user wrote it (`files.cache`), for this name, with this
  version of the program, of Python and of the packages,
- every file is what it was, and
- the bytes of its program pass the verifier again, on its robot.

Everything else is a miss: the show is made as if there were no cache, and replaces the entry. The
values are pickled, and only classes of values are taken from the pickle (`_Values`). What does not
depend on files alone is never kept: limits that were asked of servos, and functions of a show,
which Python may find elsewhere the next time.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import sys
from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError, LssMotionError
from lss_motion.files.cache import (
    BYTES_MAX,
    MARK_BYTES,
    SHOW_SUFFIX,
    cache_directory,
    mark_of,
    store,
)
from lss_motion.files.record import are_unchanged, recorded
from lss_motion.files.source import bounded_data
from lss_motion.planning.shows import recheck

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lss_motion.planning.shows import Show

PROTOCOL: Final = 5
"""Of pickle: arrays are stored as they are."""

SHOW_BYTES_MAX: Final = BYTES_MAX // 4
"""A larger show is not kept: it would remove most others. Chosen: an hour of 40 joints is less."""

MAKERS: Final = (
    *("files", "interchange", "planning", "planning/program", "planning/trajectory"),
    *("protocol", "robot", "show", "show/gait", "sound"),
)
"""The folders, beside the modules of the top folder, that make a show of files."""

LIBRARIES: Final = (
    "clarabel",
    "msgspec",
    "numpy",
    "pydantic",
    "pydantic_core",
    "scipy",
    "toppra",
    "yaml",
)
"""The packages of others that do."""

_VALUES: Final = tuple(f"lss_motion.{part}." for part in ("planning", "protocol", "robot", "show"))
_OTHER_VALUES: Final = frozenset(
    {
        ("msgspec._utils", "rebuild"),  # of a Struct with keywords, from its class and fields
        ("numpy", "dtype"),
        ("numpy._core.numeric", "_frombuffer"),
        ("pathlib", "PosixPath"),
        ("pathlib", "WindowsPath"),
        ("pathlib._local", "PosixPath"),  # Python 3.13
        ("pathlib._local", "WindowsPath"),
    }
)
"""What a pickle may name."""


class _MissError(Exception):
    """There is no entry that may be played."""


def cached(given: tuple[object, ...], make: Callable[[], Show]) -> Show:
    """Return what `make` returns, if possible from an entry.

    `given` is all that decides about the show beside its files: the words of the command line.
    """
    try:
        name = hashlib.sha256(repr((Path.cwd(), given)).encode()).hexdigest()
    except OSError:  # The folder was removed.
        return make()
    path = cache_directory() / f"{name}{SHOW_SUFFIX}"
    try:
        return _loaded(path, name)
    except _MissError:
        with recorded() as record:
            show = make()
    if record.is_repeatable and not show.robot.read_limits:
        content = pickle.dumps(record.states, PROTOCOL) + pickle.dumps(show, PROTOCOL)
        if len(content) <= SHOW_BYTES_MAX:
            mark = mark_of([name.encode(), *_versions(), content], may_make_key=True)
            if mark is not None:
                store(path, [mark, content])
    return show


def _loaded(path: Path, name: str) -> Show:
    """Return the show of an entry, or raise `_MissError`."""
    try:
        whole = bounded_data(path, BYTES_MAX)
    except InputError as error:
        raise _MissError from error
    content = memoryview(whole)[MARK_BYTES:]
    if mark_of([name.encode(), *_versions(), content]) != whole[:MARK_BYTES]:
        raise _MissError
    stream = io.BytesIO(content)
    try:
        if not are_unchanged(_Values(stream).load(), bounded_data):
            raise _MissError
        show: Show = _Values(stream).load()
        recheck(show)
    except (
        # What pickle raises for bytes that are not its own.
        *(pickle.UnpicklingError, ArithmeticError, AssertionError, AttributeError, EOFError),
        *(ImportError, LookupError, MemoryError, OSError, TypeError, ValueError, LssMotionError),
    ) as error:
        raise _MissError from error
    return show


class _Values(pickle.Unpickler):
    """Makes values of this package, and arrays and paths; nothing else that can be called."""

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401  as pickle has it
        if (module, name) in _OTHER_VALUES:
            return super().find_class(module, name)
        if f"{module}.".startswith(_VALUES) and isinstance(
            found := super().find_class(module, name), type
        ):
            return found
        raise pickle.UnpicklingError(f"{module}.{name} is no value of a show")


def _versions() -> Iterator[bytes]:
    """Yield what is different with another version of this program, of Python or of a library.

    Of this program that is every source file, so that a developer never plays an old show; of the
    libraries their folders, which an installation makes anew.
    """
    yield repr((sys.version, sys.platform)).encode()
    libraries = [f"{place}/{name}" for place in sys.path for name in LIBRARIES]
    for path in (sys.executable, *libraries):
        with suppress(OSError):
            yield _state(path, os.stat(path))  # noqa: PTH116  (a Path takes three times as long)
    top = Path(__file__).parents[1]
    for folder in (top, *(top / name for name in MAKERS)):
        with suppress(OSError), os.scandir(folder) as entries:
            for entry in sorted(entries, key=attrgetter("name")):
                if entry.name.endswith(".py"):
                    yield _state(entry.path, entry.stat())


def _state(path: str, status: os.stat_result) -> bytes:
    return repr((path, status.st_size, status.st_mtime_ns)).encode()
