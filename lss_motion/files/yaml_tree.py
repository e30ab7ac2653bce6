"""Where every key, value and item of a YAML text stands, as a tree of spans.

`tree_of` reads a text that `yaml_source` accepts. Spans are characters of that text: comments,
blank lines and styles stay where they are, and `yaml_edit` changes only spans.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

from lss_motion.errors import InputError
from lss_motion.files.yaml_source import DEPTH_MAX, syntax_reason

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


_DASH: Final = re.compile(r"\n *(-)(?=[ \t\r\n]|$)")
"""The dash of the next item of a block list: alone in front of its line."""


@dataclass(slots=True)
class Node:
    """A value: `text[start:end]` is what was written of it, without comments behind it."""

    kind: Literal["scalar", "mapping", "list", "alias"]
    start: int
    end: int
    line: int
    """Of its start, from 1."""
    is_flow: bool = True
    """False for a mapping or list in lines, and for a text in lines (`|`, `>`)."""
    anchor: str | None = None
    """Of an alias, what it stands for; else, under what aliases repeat the value."""
    mark_end: int = 0
    """Of a mapping or list in lines: where the parser saw its end, behind comments."""
    entries: list[YamlEntry] = field(default_factory=list)

    def entry(self, name: str | int) -> YamlEntry | None:
        """Return the entry of a key or index; None if there is none. Of equal keys the last."""
        if isinstance(name, int):
            is_there = self.kind == "list" and 0 <= name < len(self.entries)
            return self.entries[name] if is_there else None
        if self.kind != "mapping":
            return None
        return next((one for one in reversed(self.entries) if one.name == name), None)

    def index(self, name: str | int) -> int:
        """Return the place of an entry among the others."""
        found = self.entry(name)
        return next(place for place, one in enumerate(self.entries) if one is found)


@dataclass(slots=True)
class YamlEntry:
    """An item of a list, or a key with its value."""

    name: str | int
    head: int
    """Where it begins: its dash in a list in lines, its key in a mapping."""
    key_end: int
    """Where its key ends; of an item: its head."""
    node: Node


def tree_of(path: Path, text: str) -> Node:
    """Return the tree of a text; raises `InputError` with the line for what is no YAML."""
    import yaml

    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    events = yaml.parse(text, Loader=loader)
    try:
        for event in events:
            if _kind(event) not in ("StreamStart", "DocumentStart"):
                return _TreeReader(path, text, events).node(event, 0)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        raise InputError(syntax_reason(error), path=path, line=line) from error
    raise InputError("is empty", path=path)


def repeated(root: Node) -> frozenset[str]:
    """Return the anchors of values that aliases repeat."""
    found, waiting = set(), [root]
    while waiting:
        node = waiting.pop()
        if node.kind == "alias":
            found.add(node.anchor or "")
        waiting += [entry.node for entry in node.entries]
    return frozenset(found)


def _kind(event: Any) -> str:  # noqa: ANN401  yaml seam
    return type(event).__name__.removesuffix("Event")


class _TreeReader:
    """Makes nodes from the events of the parser."""

    def __init__(self, path: Path, text: str, events: Iterator[Any]) -> None:
        self._path, self._text, self._events = path, text, events

    def node(self, event: Any, depth: int) -> Node:  # noqa: ANN401  yaml seam
        start, end = event.start_mark.index, event.end_mark.index
        line = event.start_mark.line + 1
        if depth > DEPTH_MAX + 1:
            raise InputError(f"nested more than {DEPTH_MAX} deep", path=self._path, line=line)
        match _kind(event):
            case "Alias":
                return Node("alias", start, end, line, anchor=event.anchor)
            case "Scalar":
                is_block = event.style in ("|", ">")
                content = self._text[start:end].rstrip() if is_block else ""
                end = start + len(content) if is_block else end
                return Node("scalar", start, end, line, not is_block, event.anchor)
            case "MappingStart":
                node = Node("mapping", start, end, line, bool(event.flow_style), event.anchor)
                closing = self._mapping(node, depth)
            case _:
                node = Node("list", start, end, line, bool(event.flow_style), event.anchor)
                closing = self._list(node, depth)
        node.mark_end = closing.end_mark.index
        node.end = node.mark_end if node.is_flow else node.entries[-1].node.end
        return node

    def _mapping(self, node: Node, depth: int) -> Any:  # noqa: ANN401  yaml seam
        while _kind(event := next(self._events)) != "MappingEnd":
            key = self.node(event, depth + 1)
            if key.kind != "scalar":
                raise InputError("a key must be plain text", path=self._path, line=key.line)
            value = self.node(next(self._events), depth + 1)
            value.end = max(value.end, key.end)  # Of a key without a value.
            node.entries.append(YamlEntry(str(event.value), key.start, key.end, value))
        return event

    def _list(self, node: Node, depth: int) -> Any:  # noqa: ANN401  yaml seam
        while _kind(event := next(self._events)) != "SequenceEnd":
            head = event.start_mark.index
            if not node.is_flow:
                head = self._dash(node)
            item = self.node(event, depth + 1)
            item.end = max(item.end, head)
            node.entries.append(YamlEntry(len(node.entries), head, head, item))
        return event

    def _dash(self, node: Node) -> int:
        """Return where the dash of the next item of a list in lines stands."""
        if not node.entries and self._text[node.start] == "-":
            return node.start
        before = node.entries[-1].node.end if node.entries else node.start  # Or an anchor.
        found = _DASH.search(self._text, before)
        assert found is not None, "an item without a dash"
        return found.start(1)
