"""Values on disk, found by what they depend on: plans and shows that need not be made again.

The name of an entry is a hash of all that its value depends on. An entry counts only if

- its mark proves that a program of this user wrote it (`files.cache`), for this name, with this
  version of the program, of Python and of the packages, and
- the check of its owner accepts the value, as if a stranger had written it.

Everything else is a miss: the value is made as if there were no cache, and replaces the entry. The
values are pickled, and only classes of values are taken from the pickle (`_Values`).
"""

from __future__ import annotations

import io
import os
import pickle
import sys
from contextlib import suppress
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from lss_motion.errors import InputError, LssMotionError
from lss_motion.files.cache import BYTES_MAX, MARK_BYTES, cache_directory, mark_of, store
from lss_motion.files.source import bounded_data

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Value = TypeVar("Value")

PROTOCOL: Final = 5
"""Of pickle: arrays are stored as they are."""

VALUE_BYTES_MAX: Final = BYTES_MAX // 4
"""A larger value is not kept: it would remove most others. Chosen: an hour of 40 joints is less."""

MAKERS: Final = (
    *("files", "interchange", "planning", "planning/program", "planning/trajectory"),
    *("protocol", "robot", "show", "show/gait", "sound"),
)
"""The folders, beside the modules of the top folder, that make plans and shows."""

LIBRARIES: Final = (
    "clarabel",
    "msgspec",
    "numpy",
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
        ("numpy", "ndarray"),
        ("numpy._core.multiarray", "_reconstruct"),  # of every array, by numpy 2.0
        ("numpy._core.numeric", "_frombuffer"),
        ("pathlib", "PosixPath"),
        ("pathlib", "WindowsPath"),
        ("pathlib._local", "PosixPath"),  # Python 3.13
        ("pathlib._local", "WindowsPath"),
    }
)
"""What a pickle may name."""


class MissError(Exception):
    """There is no entry whose value may be used."""


def keep(path_suffix: str, name: str, value: object) -> None:
    """Keep a value under a name."""
    content = pickle.dumps(value, PROTOCOL)
    if len(content) <= VALUE_BYTES_MAX:
        mark = mark_of([name.encode(), *versions(), content], may_make_key=True)
        if mark is not None:
            store(cache_directory() / f"{name}{path_suffix}", [mark, content])


def loaded(path_suffix: str, name: str, check: Callable[[Value], None]) -> Value:
    """Return the value of an entry, or raise `MissError`."""
    try:
        whole = bounded_data(cache_directory() / f"{name}{path_suffix}", BYTES_MAX)
    except InputError as error:
        raise MissError from error
    content = memoryview(whole)[MARK_BYTES:]
    if mark_of([name.encode(), *versions(), content]) != whole[:MARK_BYTES]:
        raise MissError
    try:
        value: Value = _Values(io.BytesIO(content)).load()
        check(value)
    except (
        # What pickle raises for bytes that are not its own.
        *(pickle.UnpicklingError, ArithmeticError, AssertionError, AttributeError, EOFError),
        *(ImportError, LookupError, MemoryError, OSError, TypeError, ValueError, LssMotionError),
    ) as error:
        raise MissError from error
    return value


class _Values(pickle.Unpickler):
    """Makes values of this package, and arrays and paths; nothing else that can be called."""

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401  as pickle has it
        if (module, name) in _OTHER_VALUES:
            return super().find_class(module, name)
        if f"{module}.".startswith(_VALUES) and isinstance(
            found := super().find_class(module, name), type
        ):
            return found
        raise pickle.UnpicklingError(f"{module}.{name} is no value")


@cache
def versions() -> tuple[bytes, ...]:
    """Return what is different with another version of this program, of Python or of a library.

    Of this program that is every source file, so that a developer never plays an old show; of the
    libraries their folders, which an installation makes anew.
    """
    return tuple(_versions())


def _versions() -> Iterator[bytes]:
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
