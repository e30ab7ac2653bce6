"""Operations on files → the new texts of these files; pure."""

from __future__ import annotations

from collections.abc import Mapping  # noqa: TC003  (read by msgspec)
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.texts import counted
from lss_motion.files.yaml_edit import (
    Edit,
    Insert,
    Remove,
    Rename,
    Reorder,
    SetValues,
    edited,
    with_edits_made,
)
from lss_motion.files.yaml_text import in_rows
from lss_motion.playing.remote import edit_messages as m
from lss_motion.show import key_edit
from lss_motion.studio.allowed import read, remembered, require_plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.show.key_edit import KeyRef, NewKey

    TextOf = Callable[[str], tuple[Path, str]]
    """Returns the full path and the text of a file by the name that clients know."""

KeyOperation = m.KeyMove | m.KeyScale | m.KeyMirror | m.KeySet | m.KeyAdd | m.KeyDelete
ItemOperation = m.ItemInsert | m.ItemDelete | m.ItemMove | m.ValueSet | m.ValueRename


class RobotNames(Struct, frozen=True):
    """What the edits of keys need of the robot: its poses, and the mirror images of its joints."""

    poses: Mapping[str, Mapping[str, float]] = {}
    mirror: Mapping[str, tuple[str, int]] = {}


def new_texts(
    operation: m.AnyChange,
    text_of: TextOf,
    robot: RobotNames,
) -> dict[Path, tuple[str, str]]:
    """Return the text of each file of an operation, before and after it.

    Raises `InputError` with the reason for what cannot be done; then nothing is.
    """
    if isinstance(operation, m.TextSet):
        path, text = text_of(operation.file)
        return {path: (text, _with_lines(operation, text))}
    return {
        path: (text, edited(path, text, edits, remembered))
        for path, text, edits in _edits(operation, text_of, robot)
    }


def new_values(
    operation: m.AnyChange,
    text_of: TextOf,
    robot: RobotNames,
) -> dict[Path, YamlSource]:
    """Return what each file of an operation would hold after it; raises as `new_texts`."""
    if isinstance(operation, m.TextSet):
        path, text = text_of(operation.file)
        return {path: read(path, _with_lines(operation, text)).source}
    return {
        path: with_edits_made(path, read(path, text).source, edits)
        for path, text, edits in _edits(operation, text_of, robot)
    }


def _edits(
    operation: KeyOperation | ItemOperation,
    text_of: TextOf,
    robot: RobotNames,
) -> Iterator[tuple[Path, str, list[Edit]]]:
    """Yield each file of an operation with its text and the edits of it."""
    if not isinstance(operation, KeyOperation):
        path, text = text_of(operation.file)
        yield path, text, _item_edits(operation, read(path, text).source.value)
        return
    for file in dict.fromkeys(key.file for key in operation.keys):
        path, text = text_of(file)
        yield path, text, _key_edits(operation, file, read(path, text).source.value, robot)


def word_of(operation: m.EditOperation) -> str:
    """Return what a person reads of a step: "move 3 keys"."""
    match operation:
        case m.KeyMove() | m.KeyScale() | m.KeyMirror() | m.KeySet() | m.KeyAdd() | m.KeyDelete():
            return f"{operation.op.partition('.')[2]} {counted(operation.keys, 'key')}"
        case m.TextSet():
            return f"edit the text of {operation.file}"
        case m.ItemInsert() | m.ItemDelete() | m.ItemMove() | m.ValueSet() | m.ValueRename():
            return f"{operation.op.partition('.')[2]} {'.'.join(map(str, operation.place))}"
        case _:
            return operation.op


def _key_edits(
    operation: KeyOperation,
    file: str,
    value: Mapping[str, Any],
    robot: RobotNames,
) -> list[Edit]:
    poses = robot.poses
    if isinstance(operation, m.KeyAdd):
        return key_edit.add_keys(value, _new_keys(operation, file), poses)
    keys = list(_refs(operation.keys, file))
    match operation:
        case m.KeyMove():
            return key_edit.move_keys(
                value,
                keys,
                poses,
                by_s=operation.by_s,
                by_deg=operation.by_deg,
                ripple=operation.ripple,
            )
        case m.KeyScale():
            return key_edit.scale_keys(
                value,
                keys,
                poses,
                ratio=operation.ratio,
                about_s=operation.about_s,
                about_deg=operation.about_deg,
            )
        case m.KeyMirror():
            return key_edit.mirror_keys(value, keys, poses, robot.mirror)
        case m.KeySet():
            require_plain([one for one in operation.values.values() if one is not None])
            return key_edit.set_keys(
                value,
                keys,
                poses,
                deg=operation.deg,
                slope_deg_s=operation.slope_deg_s,
                values=operation.values,
                ripple=operation.ripple,
            )
        case m.KeyDelete():
            return key_edit.delete_keys(value, keys, poses, ripple=operation.ripple)


def _refs(keys: Iterable[m.KeyOf], file: str) -> Iterable[KeyRef]:
    for key in keys:
        if key.file == file:
            joints = None if key.joints is None else frozenset(key.joints)
            yield key_edit.KeyRef(key.place, joints)


def _new_keys(operation: m.KeyAdd, file: str) -> Iterable[NewKey]:
    for key in operation.keys:
        if key.file == file:
            require_plain([one for one in key.values.values() if one is not None])
            yield key_edit.NewKey(key.place, key.at_s, key.deg, key.values)


def _item_edits(operation: ItemOperation, value: Mapping[str, Any]) -> list[Edit]:
    place = operation.place
    match operation:
        case m.ItemInsert():
            return [_insertion(operation, value)]
        case m.ItemDelete():
            items = _items(value, place, operation.index)
            gone = place if len(items) == 1 else (*place, operation.index)
            return [Remove((gone,))]
        case m.ItemMove():
            items = _items(value, place, max(operation.index, operation.to))
            order = [index for index in range(len(items)) if index != operation.index]
            order.insert(operation.to, operation.index)
            return [Reorder(place, tuple(order))]
        case m.ValueSet():
            if operation.value is not None:
                require_plain(operation.value)
                return [SetValues({place: in_rows(operation.value)})]
            if _at(value, place) is None:
                raise InputError(f"there is no {_shown(place)}")
            return [Remove((place,))]
        case m.ValueRename():
            return [Rename({place: operation.name})]


def _insertion(operation: m.ItemInsert, value: Mapping[str, Any]) -> Edit:
    place, index = operation.place, operation.index
    require_plain(operation.value)
    if place and index == 0 and _at(value, place) is None:
        return SetValues({place: [operation.value]})
    if index > 0:
        _items(value, place, index - 1)
    return Insert(place, ((index, None, operation.value),))


def _at(value: Any, place: m.Place) -> Any:  # noqa: ANN401  (what YAML holds)
    """Return the value at a place; None if there is none."""
    for part in place:
        if isinstance(value, dict) and isinstance(part, str):
            value = value.get(part)
        elif isinstance(value, list) and isinstance(part, int) and part < len(value):
            value = value[part]
        else:
            return None
    return value


def _items(value: Mapping[str, Any], place: m.Place, index: int) -> list[Any]:
    """Return the list at a place; raises `InputError` unless it has that item."""
    items = _at(value, place)
    if not isinstance(items, list):
        raise InputError(f"{_shown(place)} is no list")
    if index >= len(items):
        raise InputError(f"{_shown(place)} has {counted(items, 'item')}")
    return items


def _shown(place: m.Place) -> str:
    return ".".join(map(str, place)) or "the file"


def _with_lines(operation: m.TextSet, text: str) -> str:
    """Return the text with other lines; lines that stay keep their ends."""
    newline = "\r\n" if "\r\n" in text else "\n"
    lines = _lines(text)
    start, end = operation.from_line - 1, operation.to_line - 1
    if not start <= end <= len(lines):
        raise InputError(f"the text has {counted(lines, 'line')}")
    if any("\n" in line or "\r" in line for line in operation.lines):
        raise InputError("a line has no line end inside")
    made = [line + newline for line in operation.lines]
    before, after = "".join(lines[:start]), "".join(lines[end:])
    if made and before and not before.endswith("\n"):
        before += newline
    if made and not after and (not lines or not lines[-1].endswith("\n")):
        made[-1] = made[-1].removesuffix(newline)
    return before + "".join(made) + after


def _lines(text: str) -> list[str]:
    """Return the lines of a text with their ends; only a line feed ends one."""
    parts = text.split("\n")
    return [*(part + "\n" for part in parts[:-1]), *([parts[-1]] if parts[-1] else [])]
