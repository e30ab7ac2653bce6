"""YAML of other tools as plain nested values with lines: nothing is constructed, all is bounded.

Unlike `yaml_source`, which reads our own files, this takes the text, keeps every scalar as text,
and stops at the end of the first document (as `ros2 topic echo` separates messages).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NODES_MAX: Final = 4_000_000
"""As many as values of a recording; an alias counts as all that it repeats."""

DEPTH_MAX: Final = 16
"""A goal of a trajectory is 5 deep; without a bound, thousands of brackets overflow the stack."""


@dataclass(frozen=True, slots=True)
class Node:
    """A text, a list or a mapping, and the line that it starts in."""

    value: str | list[Node] | dict[str, Node]
    line: int
    size: int = 1
    """How many nodes it holds, itself included, aliases as what they repeat."""


def yaml_tree(text: str, path: Path) -> Node:
    """Return the first document of `text`, or raise `InputError` with the line."""
    import yaml

    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    try:
        return _Builder(path, yaml.parse(text, Loader=loader)).document()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        reason = getattr(error, "problem", None) or getattr(error, "reason", None) or "odd text"
        line = None if mark is None else mark.line + 1
        raise InputError(f"not YAML: {reason}", path=path, line=line) from error


class _Builder:
    def __init__(self, path: Path, events: Iterator[Any]) -> None:
        self._path = path
        self._events = events
        self._anchors: dict[str, Node] = {}
        self._nodes_count = 0

    def document(self) -> Node:
        for event in self._events:
            if type(event).__name__ in {
                "ScalarEvent",
                "AliasEvent",
                "MappingStartEvent",
                "SequenceStartEvent",
            }:
                return self._node(event, 0)
        raise InputError("is empty", path=self._path)

    def _node(self, event: Any, depth: int) -> Node:  # noqa: ANN401  yaml seam
        line = event.start_mark.line + 1
        if type(event).__name__ == "AliasEvent":
            if event.anchor not in self._anchors:
                raise self._error(line, f"alias *{event.anchor} has no anchor before it")
            node = self._anchors[event.anchor]
            self._count(line, node.size)
            return node
        self._count(line, 1)
        if depth > DEPTH_MAX:
            raise self._error(line, f"nested more than {DEPTH_MAX} deep")
        if event.tag is not None and event.tag.startswith("tag:yaml.org,2002:python"):
            raise self._error(line, f"tag {event.tag!r:.60} asks to run code; that is never done")
        match type(event).__name__:
            case "ScalarEvent":
                node = Node(str(event.value), line)
            case "MappingStartEvent":
                node = self._mapping(line, depth)
            case _:
                node = self._list(line, depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _mapping(self, line: int, depth: int) -> Node:
        value: dict[str, Node] = {}
        size = 1
        while type(event := next(self._events)).__name__ != "MappingEndEvent":
            key = self._node(event, depth + 1)
            if not isinstance(key.value, str):
                raise self._error(key.line, "a key must be plain text")
            if key.value in value:
                raise self._error(key.line, f"{key.value!r:.60} is given twice")
            value[key.value] = self._node(next(self._events), depth + 1)
            size += key.size + value[key.value].size
        return Node(value, line, size)

    def _list(self, line: int, depth: int) -> Node:
        value: list[Node] = []
        while type(event := next(self._events)).__name__ != "SequenceEndEvent":
            value.append(self._node(event, depth + 1))
        return Node(value, line, 1 + sum(node.size for node in value))

    def _count(self, line: int, size: int) -> None:
        self._nodes_count += size
        if self._nodes_count > NODES_MAX:
            raise self._error(line, f"more than {NODES_MAX:,} keys and values")

    def _error(self, line: int, reason: str) -> InputError:
        return InputError(reason, path=self._path, line=line)
