"""Plans on disk, found by content: what is loaded is checked as if a stranger had written it.

The name of an entry is a hash of everything that the plan depends on. An entry holds a plan that
passed the verifier, and a hash of name and content, so that a renamed or damaged entry is found. A
hash is no proof of who wrote it: a loaded plan must also fit what was asked for, and
`recheck.is_within_limits` must find it within all limits. Everything else is a miss: the plan is
made again, and replaces the entry.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import tokenize
import zipfile
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from msgspec import to_builtins

from lss_motion.errors import InputError
from lss_motion.files.cache import BYTES_MAX, PLAN_SUFFIX, cache_directory, store
from lss_motion.files.source import bounded_data
from lss_motion.planning.trajectory.curves import Path as JointPath
from lss_motion.planning.trajectory.model import (
    AskedSpan,
    CommandedMove,
    GivenUp,
    Mark,
    MissedKey,
    PathClock,
    PathMotion,
    SlowSpan,
    Smoothing,
    Trajectory,
    motions_of,
)
from lss_motion.planning.trajectory.recheck import is_within_limits

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot

    Value = TypeVar(
        "Value", Mark, SlowSpan, MissedKey, GivenUp, AskedSpan, CommandedMove, Smoothing
    )

PLANNER_VERSION: Final = 17
"""Part of the name of every entry. Raise it whenever the plan of an unchanged sequence changes."""

PIECES_MIN: Final = 64
"""Plans with fewer polynomials and clock pieces are not stored: they are made as fast as loaded."""

_DIGEST_BYTES: Final = 32
"""Length of the SHA-256 hash before the content."""

_PATH: Final = {"knots_s": 1, "coefficients": 3}
_CLOCK: Final = {"times_s": 1, "path_s": 1, "rates": 1, "rate_slopes": 1}
"""The arrays of an entry, and how many dimensions each has."""

_TYPES: Final[Mapping[str, tuple[type, ...]]] = {
    "str": (str,),
    "bool": (bool,),
    "float": (float, int),
    "float | None": (float, int, type(None)),
    "Literal['speed', 'acceleration', 'jerk']": (str,),
    "tuple[MissedKey, ...]": (tuple,),
    "tuple[float, ...]": (tuple,),
    "tuple[str, ...]": (tuple,),
}
"""What an entry may hold for the annotation of a field of `Mark`, `SlowSpan` and `Smoothing`."""


_known_fields: dict[type[Any], list[tuple[str, tuple[type, ...]]]] = {}
"""What `_fields` has returned: a long show has thousands of marks."""


class _MissError(Exception):
    """An entry is not there, or is not a plan that may be played."""


def cached(
    name: str,
    make: Callable[[], Trajectory],
    fits: Callable[[Trajectory], bool],
    robot: Robot,
) -> Trajectory:
    """Return the plan stored under `name`, else that of `make`, which must have been verified.

    `fits` returns whether a stored plan, within the limits of `robot`, is the one asked for. An
    entry that is damaged or does not fit is replaced. A cache that cannot be written is no error;
    the plan is then not stored.
    """
    path = cache_directory() / f"{name}{PLAN_SUFFIX}"
    try:
        return _loaded(path, name, fits, robot)
    except _MissError:
        trajectory = make()
    motions = {id(part): part for part in motions_of(trajectory)}.values()
    if sum(len(m.path.knots_s) + len(m.clock.rates) for m in motions) >= PIECES_MIN:
        _store(path, name, trajectory)
    return trajectory


def _loaded(path: Path, name: str, fits: Callable[[Trajectory], bool], robot: Robot) -> Trajectory:
    """Return the plan of an entry, or raise `_MissError`."""
    try:
        whole = bounded_data(path, BYTES_MAX)
    except InputError as error:
        raise _MissError from error
    content = memoryview(whole)[_DIGEST_BYTES:]
    if _digest(name, content) != whole[:_DIGEST_BYTES]:
        raise _MissError
    try:
        trajectory = _read(content)
        is_right = (
            all(joint in robot.joints for joint in trajectory.joints)
            and is_within_limits(trajectory, robot)
            and fits(trajectory)
        )
    except (
        # What json, zipfile and numpy raise for bytes that are not theirs.
        *(ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, OSError),
        *(RecursionError, SyntaxError, TypeError, ValueError, NotImplementedError),
        *(tokenize.TokenError, zipfile.BadZipFile),
    ) as error:
        raise _MissError from error
    if not is_right:
        raise _MissError
    return trajectory


def _digest(name: str, content: memoryview) -> bytes:
    digest = hashlib.sha256(name.encode())
    digest.update(content)
    return digest.digest()


def _read(content: memoryview) -> Trajectory:
    """Return the plan of an entry; raises any of the errors that `_loaded` lists."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        # Nothing is compressed, so that a small file cannot become a large one.
        if sum(entry.file_size for entry in archive.infolist()) > len(content):
            raise ValueError("an entry that grows")
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        facts: dict[str, Any] = json.loads(stored["facts"].tobytes())
        numbers = [int(number) for number in facts["parts"]]
        motions = {
            number: PathMotion(
                path=JointPath(**_arrays(stored, number, _PATH)),
                clock=PathClock(**_arrays(stored, number, _CLOCK)),
            )
            for number in dict.fromkeys(numbers)
        }
        asked_deg = np.asarray(stored["asked_deg"], dtype=np.float64).ravel()
    first, middle, last = parts = [motions[number] for number in numbers]
    joints = tuple(str(joint) for joint in facts["joints"])
    if any(part.path.coefficients.shape[2] != len(joints) for part in parts):
        raise ValueError("not one column a joint")
    if not isinstance(facts["loop"], int | None) or not isinstance(facts["is_periodic"], bool):
        raise TypeError("loop or is_periodic")
    return Trajectory(
        name=str(facts["name"]),
        joints=joints,
        first=first,
        middle=middle,
        last=last,
        loop=facts["loop"],
        is_periodic=facts["is_periodic"],
        stretched=tuple(_made(SlowSpan, stretch) for stretch in facts["stretched"]),
        given_up=tuple(_given_up(span) for span in facts["given_up"]),
        asked=tuple(_asked(span, asked_deg) for span in facts["asked"]),
        commands=tuple(_made(CommandedMove, move) for move in facts["commands"]),
        marks=tuple(_made(Mark, {**mark, "kept": _names(mark)}) for mark in facts["marks"]),
        smoothing=tuple(_made(Smoothing, part) for part in facts["smoothing"]),
    )


def _names(mark: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(str(name) for name in mark["kept"])


def _given_up(stored: Mapping[str, Any]) -> GivenUp:
    missed = tuple(_made(MissedKey, key) for key in stored["missed"])
    return _made(GivenUp, {**stored, "missed": missed})


def _asked(stored: Mapping[str, Any], deg: NDArray[np.float64]) -> AskedSpan:
    first, end = stored["deg"]
    if not 0 <= first < end <= len(deg) or not np.isfinite(deg[first:end]).all():
        raise ValueError("asked")
    return _made(AskedSpan, {**stored, "deg": tuple(deg[first:end].tolist())})


def _arrays(
    stored: Mapping[str, Any], number: int, names: Mapping[str, int]
) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    found = {key: stored[f"{number}.{key}"] for key in names}
    for key, array in found.items():
        if array.dtype != np.float64 or array.ndim != names[key]:
            raise ValueError(key)
    return found


def _made(kind: type[Value], stored: Mapping[str, Any]) -> Value:
    for name, types in _fields(kind):
        value = stored[name]
        if not isinstance(value, types):
            raise TypeError(name)
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(name)
    return kind(**stored)


def _fields(kind: type[Any]) -> list[tuple[str, tuple[type, ...]]]:
    """Return the fields of a kind of value, and what an entry may hold for each."""
    if kind not in _known_fields:
        _known_fields[kind] = [
            (field, _TYPES[kind.__annotations__[field]]) for field in kind.__struct_fields__
        ]
    return _known_fields[kind]


def _store(path: Path, name: str, trajectory: Trajectory) -> None:
    motions: list[PathMotion] = []
    numbers = []
    for motion in motions_of(trajectory):
        if not any(motion is earlier for earlier in motions):
            motions.append(motion)
        numbers.append(next(n for n, earlier in enumerate(motions) if motion is earlier))
    facts = {
        "parts": numbers,
        "name": trajectory.name,
        "joints": trajectory.joints,
        "loop": trajectory.loop,
        "is_periodic": trajectory.is_periodic,
        "stretched": to_builtins(trajectory.stretched),
        "given_up": to_builtins(trajectory.given_up),
        "commands": to_builtins(trajectory.commands),
        "marks": to_builtins(trajectory.marks),
        "smoothing": to_builtins(trajectory.smoothing),
    }
    ends = np.cumsum([0, *(len(span.deg) for span in trajectory.asked)]).tolist()
    facts["asked"] = [
        {"from_s": span.from_s, "to_s": span.to_s, "joint": span.joint, "deg": [first, end]}
        for span, first, end in zip(trajectory.asked, ends, ends[1:], strict=False)
    ]
    asked_deg = [np.array(span.deg) for span in trajectory.asked]
    arrays = {"facts": np.frombuffer(json.dumps(facts).encode(), dtype=np.uint8)}
    arrays["asked_deg"] = np.concatenate([np.zeros(0), *asked_deg])
    for number, motion in enumerate(motions):
        arrays |= {f"{number}.{key}": getattr(motion.path, key) for key in _PATH}
        arrays |= {f"{number}.{key}": getattr(motion.clock, key) for key in _CLOCK}
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    packed = content.getbuffer()
    store(path, [_digest(name, packed), packed])
