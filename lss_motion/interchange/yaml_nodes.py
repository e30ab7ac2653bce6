"""YAML of other programs as nested texts, lists and mappings with line numbers.

`yaml_trees` constructs no objects, and it bounds size and depth. Unlike `files.yaml_source`, it
keeps every scalar as text. `NodeFields` returns values of the expected kind.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NoReturn

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.yaml_source import DEPTH_MAX, syntax_reason
from lss_motion.interchange.fields import NUMBER_MAX

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NODES_MAX: Final = 4_000_000
"""Maximum number of nodes, as for values of a recording. An alias counts as its content."""


class YamlNode(Struct, frozen=True):
    """A text, a list or a mapping, and the line where it starts."""

    value: str | list[YamlNode] | dict[str, YamlNode]
    line: int
    size: int = 1
    """Number of nodes in it, with itself and with the content of aliases."""


def yaml_trees(text: str, path: Path) -> Iterator[YamlNode]:
    """Yield the documents of `text`, at least one, or raise `InputError` with the line."""
    import yaml

    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    try:
        yield from _NodeBuilder(path, yaml.parse(text, Loader=loader)).documents()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        raise InputError(syntax_reason(error), path=path, line=line) from error


class _NodeBuilder:
    """Builds the tree from the events of the YAML parser."""

    def __init__(self, path: Path, events: Iterator[Any]) -> None:
        self._path = path
        self._events = events
        self._anchors: dict[str, YamlNode] = {}
        self._nodes_count = 0

    def documents(self) -> Iterator[YamlNode]:
        is_empty = True
        for event in self._events:
            match type(event).__name__:
                case "DocumentStartEvent":
                    self._anchors.clear()
                case "ScalarEvent" if not event.value and not is_empty:
                    pass  # An echo ends in `---`.
                case "ScalarEvent" | "AliasEvent" | "MappingStartEvent" | "SequenceStartEvent":
                    is_empty = False
                    yield self._node(event, 0)
        if is_empty:
            raise InputError("is empty", path=self._path)

    def _node(self, event: Any, depth: int) -> YamlNode:  # noqa: ANN401  yaml seam
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
            raise self._error(line, f"tag {event.tag!r:.60} would run code, which is not allowed")
        match type(event).__name__:
            case "ScalarEvent":
                node = YamlNode(str(event.value), line)
            case "MappingStartEvent":
                node = self._mapping(line, depth)
            case _:
                node = self._list(line, depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _mapping(self, line: int, depth: int) -> YamlNode:
        value: dict[str, YamlNode] = {}
        size = 1
        while type(event := next(self._events)).__name__ != "MappingEndEvent":
            key = self._node(event, depth + 1)
            if not isinstance(key.value, str):
                raise self._error(key.line, "a key must be plain text")
            if key.value in value:
                raise self._error(key.line, f"{key.value!r:.60} is given twice")
            value[key.value] = self._node(next(self._events), depth + 1)
            size += key.size + value[key.value].size
        return YamlNode(value, line, size)

    def _list(self, line: int, depth: int) -> YamlNode:
        value: list[YamlNode] = []
        while type(event := next(self._events)).__name__ != "SequenceEndEvent":
            value.append(self._node(event, depth + 1))
        return YamlNode(value, line, 1 + sum(node.size for node in value))

    def _count(self, line: int, size: int) -> None:
        self._nodes_count += size
        if self._nodes_count > NODES_MAX:
            raise self._error(line, f"more than {NODES_MAX:,} keys and values")

    def _error(self, line: int, reason: str) -> InputError:
        return InputError(reason, path=self._path, line=line)


class NodeFields:
    """Typed access to the nodes of one file. Every `InputError` contains the line."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def number(self, node: YamlNode, maximum: float = NUMBER_MAX) -> float:
        """Return the number in `node`, or raise `InputError`."""
        try:
            value = float(node.value) if isinstance(node.value, str) else math.nan
        except ValueError:
            value = math.nan
        if not abs(value) <= maximum:
            self.refuse(node, f"{node.value!r:.60} is not a number, or out of range")
        return value

    def mapping(self, node: YamlNode, where: str) -> dict[str, YamlNode]:
        """Return the mapping in `node`, or raise `InputError`."""
        if not isinstance(node.value, dict):
            self.refuse(node, f"{where:.60} must hold keys and values")
        return node.value

    def items(self, node: YamlNode, where: str) -> list[YamlNode]:
        """Return the list in `node`, which has one entry or more, or raise `InputError`."""
        if not isinstance(node.value, list) or not node.value:
            self.refuse(node, f"{where} must be a list with at least one entry")
        return node.value

    def refuse(self, node: YamlNode, reason: str) -> NoReturn:
        """Raise `InputError` with `reason` and the line."""
        raise InputError(reason, path=self.path, line=node.line)
