"""What an edit may make of a file: nothing that is run, no port, no path out of the folder.

The rules are about values, not about operations: whatever an operation does, the value before and
the value after it are compared.
"""

from __future__ import annotations

import json
from collections import Counter
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.texts import counted
from lss_motion.files.yaml_source import DEPTH_MAX, YamlSource, parse_yaml

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lss_motion.files.keys import FileModel

FIXED: Final = {
    "run": "a function that is run",
    "port": "a port",
    **dict.fromkeys(("listen", "alerts", "network", "address", "sync", "log"), "a way out"),
}
"""Keys whose values an edit neither adds nor changes, and what they are. Those behind `port` are of
stages: where a computer listens, and what it sends and writes."""
BY_JOINT: Final = frozenset({"deg", "led", "poses", "mouth", "joints_deg"})
"""Keys whose mappings have names of joints or poses, which may be called `run`."""
WORDS: Final = frozenset({"say", "label", "sequence", "gait", "stage", "title", "notes"})
"""Keys whose text is for people; any other text may be the name of a file."""
KINDS: Final = ("sequence", "gait", "stage", "joints")
"""Keys that say what a file is."""
VALUES_MAX: Final = 200_000
"""Values of one message. Chosen: 10,000 keyframes of 20 joints."""


class ReadText(Struct, frozen=True):
    """A text as it is read: its values, and what is wrong with them."""

    source: YamlSource
    problems: dict[str, int]
    """Each reason with its line."""


@lru_cache(maxsize=8)
def remembered(text: str, path: Path) -> YamlSource:
    """Return what a text holds, as `parse_yaml`; callers do not change it."""
    return parse_yaml(text, path)


@lru_cache(maxsize=8)
def read(path: Path, text: str) -> ReadText:
    """Return what a text holds; raises `InputError` where it is no YAML."""
    from lss_motion.files.validation import validate

    source = remembered(text, path)
    model = _model(source.value)
    problems = list(source.problems) if model is None else validate(model, source)[1]
    return ReadText(source, {one.reason: source.line(one.location) for one in problems})


def path_inside(folder: Path, name: str) -> Path:
    """Return the path of a file below the folder; raises `InputError` if it is not below."""
    try:
        path = (folder / name).resolve()
    except (ValueError, OSError, RuntimeError):
        raise InputError("is no name of a file") from None
    if not path.is_relative_to(folder):
        raise InputError("is not in the folder of the show", path=name)
    return path


def require_allowed(folder: Path, path: Path, before: str, after: str) -> None:
    """Raise `InputError` with the line for a text that an edit may not make of another one.

    The text is harmless (`require_harmless`), and has no mistake of a single key that the old one
    did not have.
    """
    old, new = read(path, before), read(path, after)
    require_harmless(folder, path, old.source.value, new.source.value)
    fresh = [(line, reason) for reason, line in new.problems.items() if reason not in old.problems]
    if fresh:
        line, reason = min(fresh)
        raise InputError(reason, path=path, line=line)


def require_new(folder: Path, path: Path, text: str) -> None:
    """Raise `InputError` for a text that an edit may not make of nothing.

    It is a sequence, gait or robot without a mistake of a single key, with nothing under the keys
    of `FIXED`, and no path that leads out of `folder`.
    """
    if path.suffix.lower() not in (".yaml", ".yml") or path.name.startswith("."):
        raise InputError("a file of a show ends in .yaml", path=path.name)
    new = read(path, text)
    value = new.source.value
    require_harmless(folder, path, {key: None for key in KINDS if key in value}, value)
    if "stage" in value:
        raise InputError("a stage is made with an editor of this computer", path=path.name)
    for reason, line in new.problems.items():
        raise InputError(reason, path=path.name, line=line)


def require_harmless(
    folder: Path, path: Path, before: dict[str, Any], after: dict[str, Any]
) -> None:
    """Raise `InputError` for values that an edit may not make of others.

    Nothing is added to what the file has under the keys of `FIXED`, no path leads out of `folder`,
    and it stays a file of its kind.
    """
    if _model(after) is not _model(before):
        raise InputError("a file stays what it is: a sequence, gait, robot or stage", path=path)
    if _model(after) is None:
        raise InputError("is no sequence, gait, robot or stage, which can be edited", path=path)
    kept = Counter(_fixed(before))
    for (key, value), count in Counter(_fixed(after)).items():
        if count > kept[key, value]:
            raise InputError(
                f"{key}: {FIXED[key]} is neither added nor changed here; edit the file with an "
                "editor of this computer",
                path=path,
            )
    known = set(_names(before))
    for name in set(_names(after)) - known:
        if not _is_inside(folder, path, name):
            raise InputError(f"{name!r} leads out of the folder of the show", path=path)


def require_plain(value: object) -> None:
    """Raise `InputError` for a value of a message that no file holds."""
    waiting: list[tuple[object, int]] = [(value, 0)]
    count = 0
    while waiting:
        one, depth = waiting.pop()
        count += 1
        if depth > DEPTH_MAX:
            raise InputError(f"nested more than {DEPTH_MAX} deep")
        if count > VALUES_MAX:
            raise InputError(f"more than {counted(VALUES_MAX, 'value')}")
        match one:
            case dict():
                waiting += [(part, depth + 1) for part in one.values()]
                waiting += [(key, depth + 1) for key in one]
            case list() | tuple():
                waiting += [(part, depth + 1) for part in one]
            case None:
                raise InputError(
                    "null is no value of a file; it removes a key where it stands alone"
                )
            case str() if not one.isprintable() and any(
                "\ud800" <= char <= "\udfff" for char in one
            ):
                raise InputError("half of a character is no text of a file")
            case _:
                pass


def _model(value: dict[str, Any]) -> type[FileModel] | None:
    """Return the class of keys of a file; None: it is of no kind that is edited."""
    if "sequence" in value:
        from lss_motion.show.file import SequenceFile

        return SequenceFile
    if "gait" in value:
        from lss_motion.show.gait.file import GaitFile

        return GaitFile
    if "stage" in value:
        from lss_motion.stage.file import StageFile

        return StageFile
    if "joints" in value:
        from lss_motion.robot.file import RobotFile

        return RobotFile
    return None


def _fixed(value: object) -> Iterator[tuple[str, str]]:
    """Yield the keys of `FIXED` of a file, each with its value as JSON."""
    if isinstance(value, list):
        for one in value:
            yield from _fixed(one)
    if isinstance(value, dict):
        for key, one in value.items():
            if key in FIXED:
                yield key, json.dumps(one, sort_keys=True)
            elif key not in BY_JOINT:
                yield from _fixed(one)


def _names(value: object, key: str = "") -> Iterator[str]:
    """Yield the texts of a file that may name another one."""
    if isinstance(value, dict):
        for name, one in value.items():
            yield from _names(one, name)
    elif isinstance(value, list):
        for one in value:
            yield from _names(one, key)
    elif isinstance(value, str) and key not in WORDS:
        yield value


def _is_inside(folder: Path, path: Path, name: str) -> bool:
    """Return whether a name of a file leads to a place below the folder."""
    try:
        path_inside(folder, str(path.parent / name))
    except InputError:
        return False
    return not name.startswith("~")
