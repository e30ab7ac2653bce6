"""Changes values, keys and items of a YAML text in place.

    text = edited(path, text, [SetValues({("keyframes", 2, "deg", "jaw"): 12.5})])

Comments, blank lines, order, quotes and styles are kept, because only the characters of what is
changed are replaced. An edit says at once what the value of the file shall be (`on_value`) and how
its text changes (`splices`). `edited` parses the text again: it is the intended value, or the edit
is refused.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.yaml_source import parse_yaml, place_text
from lss_motion.files.yaml_text import WrittenValue, entry_text, flow_text, item_text
from lss_motion.files.yaml_tree import Node, YamlEntry, repeated, tree_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from lss_motion.files.source import Location
    from lss_motion.files.yaml_source import YamlSource


class Splice(Struct, frozen=True):
    """Replace `removed` at character `start` with `inserted`; valid for one text."""

    start: int
    removed: str
    inserted: str

    @classmethod
    def between(cls, old: str, new: str) -> Splice:
        """Return the shortest one that makes the new text of the old one."""
        most = min(len(old), len(new))
        start = _alike(old, new, most)
        end = _alike(old[::-1], new[::-1], most - start)
        return cls(start, old[start : len(old) - end], new[start : len(new) - end])

    def apply(self, text: str) -> str:
        """Return the edited text; raises `InputError` unless `removed` is at `start`."""
        end = self.start + len(self.removed)
        if text[self.start : end] != self.removed:
            raise InputError("the text has changed since then; look at it again")
        return text[: self.start] + self.inserted + text[end:]

    def inverse(self) -> Splice:
        """Return the edit that restores the text given to `apply`."""
        return Splice(self.start, self.inserted, self.removed)


class SetValues(Struct, frozen=True):
    """Set values by their places; keys and mappings that do not exist are made."""

    values: Mapping[Location, object]

    def on_value(self, root: Any) -> None:  # noqa: ANN401  (what YAML holds)
        """Change the plain value of a file."""
        for place, value in self.values.items():
            node = root
            for part in place[:-1]:
                node = node[part] if isinstance(part, int) else node.setdefault(part, {})
            if isinstance(place[-1], int) or not isinstance(node, dict):
                node[place[-1]]  # It is there, or raises.
            node[place[-1]] = _value_of(value)

    def splices(self, page: Page) -> Iterator[Splice]:
        """Yield what changes in the text."""
        missing: dict[Location, dict[str, Any]] = {}
        for place, value in self.values.items():
            depth, node = page.reached(place)
            if depth == len(place):
                shown = flow_text(value).replace("\n", page.newline)
                yield page.over(node.start, node.end, shown)
                continue
            at = missing.setdefault(place[:depth], {})
            for part in place[depth:-1]:
                at = at.setdefault(str(part), {})
            at[str(place[-1])] = value
        for place, entries in missing.items():
            node = page.node(place)
            new = [(len(node.entries), key, value) for key, value in entries.items()]
            yield from page.inserted(node, new, at_end_of_file=not place)


class Insert(Struct, frozen=True):
    """Insert items into a list, or keys into a mapping, each before the entry of its index."""

    place: Location
    items: tuple[tuple[int, str | None, object], ...]
    """Index, key (None: an item of a list) and value; indices are those before the edit."""

    def on_value(self, root: Any) -> None:  # noqa: ANN401
        """Change the plain value of a file."""
        node = _at(root, self.place)
        if isinstance(node, list):
            for index, _, value in sorted(self.items, key=lambda one: one[0])[::-1]:
                node.insert(index, _value_of(value))  # Items of one index keep their order.
            return
        entries = list(node.items())
        before: dict[int, list[tuple[str, object]]] = {}
        for index, key, value in self.items:
            before.setdefault(index, []).append((str(key), _value_of(value)))
        node.clear()
        for index in range(len(entries) + 1):
            node.update(before.get(index, ()))
            node.update(entries[index : index + 1])

    def splices(self, page: Page) -> Iterator[Splice]:
        """Yield what changes in the text."""
        yield from page.inserted(page.node(self.place), self.items)


class Remove(Struct, frozen=True):
    """Remove items of lists and keys of mappings, with the comments above them."""

    places: tuple[Location, ...]
    """As before the edit; none inside of another."""

    def _by_parent(self) -> dict[Location, list[Any]]:
        found: dict[Location, list[Any]] = {}
        for place in self.places:
            found.setdefault(place[:-1], []).append(place[-1])
        return found

    def on_value(self, root: Any) -> None:  # noqa: ANN401
        """Change the plain value of a file."""
        for parent, names in self._by_parent().items():
            node = _at(root, parent)
            for name in sorted(names, reverse=True) if isinstance(node, list) else names:
                del node[name]

    def splices(self, page: Page) -> Iterator[Splice]:
        """Yield what changes in the text."""
        for parent, names in self._by_parent().items():
            node = page.node(parent)
            yield from page.removed(node, {node.index(name) for name in names})


class Reorder(Struct, frozen=True):
    """Give a list another order: its item `i` becomes the one that was `order[i]`.

    Items move with the comments above them; blank lines stay.
    """

    place: Location
    order: tuple[int, ...]

    def on_value(self, root: Any) -> None:  # noqa: ANN401
        """Change the plain value of a file."""
        node = _at(root, self.place)
        node[:] = [node[index] for index in self.order]

    def splices(self, page: Page) -> Iterator[Splice]:
        """Yield what changes in the text."""
        node = page.node(self.place)
        spans = [page.span(node, index) for index in range(len(node.entries))]
        for slot, index in enumerate(self.order):
            if slot != index:
                yield page.over(*spans[slot], page.text[slice(*spans[index])])


class Rename(Struct, frozen=True):
    """Give keys of mappings other names."""

    names: Mapping[Location, str]

    def on_value(self, root: Any) -> None:  # noqa: ANN401
        """Change the plain value of a file."""
        for place, name in self.names.items():
            node = _at(root, place[:-1])
            if place[-1] not in node or name in node:
                raise InputError(f"{name!r} is there already, or {place[-1]!r} is not")
            entries = [(name if key == place[-1] else key, one) for key, one in node.items()]
            node.clear()
            node.update(entries)

    def splices(self, page: Page) -> Iterator[Splice]:
        """Yield what changes in the text."""
        for place, name in self.names.items():
            entry = page.node(place[:-1]).entry(place[-1])
            assert entry is not None
            key = flow_text({name: 0}).removeprefix("{").removesuffix(": 0}")
            yield page.over(entry.head, entry.key_end, key)


Edit = SetValues | Insert | Remove | Reorder | Rename


def edited(
    path: Path,
    text: str,
    edits: Iterable[Edit],
    read: Callable[[str, Path], YamlSource] = parse_yaml,
) -> str:
    """Return the text after the edits; raises `InputError` with the line for what is refused.

    The new text has the intended value, and no mistake that the old one did not have. `read` is
    `parse_yaml`, or one that remembers what it has read.
    """
    source = read(text, path)
    intended = copy.deepcopy(source.value)
    for edit in edits:
        _on_value(path, edit, intended)
        page = Page(path, text)
        text = page.spliced(edit.splices(page))
    _require(path, source, intended, text, read)
    return text


def with_edits_made(path: Path, source: YamlSource, edits: Iterable[Edit]) -> YamlSource:
    """Return what a file would hold after the edits, without its text; lines are the old ones."""
    value = copy.deepcopy(source.value)
    for edit in edits:
        _on_value(path, edit, value)
    return replace(source, value=value)


def changes(place: Location, old: Mapping[str, object], new: Mapping[str, object]) -> list[Edit]:
    """Return the edits that make a mapping at a place another one, inner mappings key by key."""
    removed: list[Location] = []
    values: dict[Location, object] = {}
    _compare(place, old, new, removed, values)
    return [
        *([Remove(tuple(removed))] if removed else []),
        *([SetValues(values)] if values else []),
    ]


def _compare(
    place: Location,
    old: Mapping[str, object],
    new: Mapping[str, object],
    removed: list[Location],
    values: dict[Location, object],
) -> None:
    """Collect what must be removed from a mapping, and what must be set."""
    if not new and old:
        values[place] = {}
        return
    removed += [(*place, key) for key in old if key not in new]
    for key, value in new.items():
        before = old.get(key)
        if isinstance(before, dict) and isinstance(value, dict):
            _compare((*place, key), before, value, removed, values)
        elif key not in old or not is_same(before, value):
            values[*place, key] = value


def set_values(path: Path, text: str, location: Sequence[str], values: Mapping[str, object]) -> str:
    """Return `text` with `values` set in the mapping at `location`; its other entries are kept.

    The parts of `location` that do not exist are made. Raises `InputError` as `edited` does.
    """
    places: dict[Location, object] = {(*location, key): one for key, one in values.items()}
    return edited(path, text, [SetValues(places)] if places else [])


def set_comment(path: Path, text: str, location: Location, mark: str, lines: Sequence[str]) -> str:
    """Return `text` with comment `lines` above the entry at `location`, which exists.

    Each line begins with `mark`. Lines above the entry that begin with it are replaced. If the
    entry does not begin its line, the comment is put at the end of the text.
    """
    page = Page(path, text)
    entry = page.node(location[:-1]).entry(location[-1])
    assert entry is not None
    start = page.line_start(entry.head)
    indent, newline = text[start : entry.head], page.newline
    if indent.strip():
        kept = [line for line in text.splitlines() if not line.startswith(f"# {mark}")]
        return newline.join([*kept, *(f"# {mark} {line}" for line in lines), ""])
    before = text[:start].splitlines(keepends=True)
    while before and before[-1].strip().startswith(f"# {mark}"):
        before.pop()
    comment = [f"{indent}# {mark} {line}{newline}" for line in lines]
    return "".join([*before, *comment]) + text[start:]


class Page:
    """A text with its tree, for one edit."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.text = path, text
        self.root = tree_of(path, text)
        self.newline = "\r\n" if "\r\n" in text else "\n"
        self._repeated = repeated(self.root)

    def node(self, place: Location) -> Node:
        """Return the node at a place that exists."""
        depth, node = self.reached(place)
        if depth < len(place):
            where = place_text(place[: depth + 1])
            raise InputError(f"there is no {where}", path=self.path, line=node.line)
        return node

    def reached(self, place: Location) -> tuple[int, Node]:
        """Return the deepest node on the way to a place, and how many parts of the way it is."""
        node = self.root
        for depth, part in enumerate(place):
            entry = node.entry(part)
            if entry is None:
                if isinstance(part, int) or node.kind != "mapping":
                    where = place_text(place[: depth + 1])
                    raise InputError(f"there is no {where}", path=self.path, line=node.line)
                return depth, node
            node = entry.node
            if node.kind == "alias" or node.anchor in self._repeated:
                raise InputError(
                    f"{place_text(place[: depth + 1])} is an alias, or repeated elsewhere by one, "
                    "and cannot be changed here alone; write it out first",
                    path=self.path,
                    line=node.line,
                )
        return len(place), node

    def spliced(self, splices: Iterable[Splice]) -> str:
        """Return the text with splices that do not overlap; at one place they keep their order."""
        parts, at = [], 0
        for splice in sorted(splices, key=lambda one: one.start):
            parts += [self.text[at : splice.start], splice.inserted]
            at = splice.start + len(splice.removed)
        return "".join([*parts, self.text[at:]])

    def over(self, start: int, end: int, inserted: str) -> Splice:
        """Return the splice that puts a text in place of a span."""
        return Splice(start, self.text[start:end], inserted)

    def line_start(self, at: int) -> int:
        """Return where the line of a character begins."""
        return self.text.rfind("\n", 0, at) + 1

    def line_end(self, at: int) -> int:
        """Return where the line behind that of a character begins, or the end of the text."""
        return self.text.find("\n", at) + 1 or len(self.text)

    def has_own_line(self, entry: YamlEntry) -> bool:
        """Return whether an entry begins its line."""
        return not self.text[self.line_start(entry.head) : entry.head].strip()

    def span(self, node: Node, index: int) -> tuple[int, int]:
        """Return the span of an entry: in lines with its comments above, without its last end."""
        entry = node.entries[index]
        if node.is_flow:
            return entry.head, entry.node.end
        if not self.has_own_line(entry):
            return entry.head, self._last_of(entry)
        start = self.line_start(entry.head)
        indent = entry.head - start
        while start:
            before = self.line_start(start - 1)
            line = self.text[before:start]
            if not line.startswith("#", indent) or line[:indent].strip():
                break
            start = before
        return start, self._last_of(entry)

    def removed(self, node: Node, gone: set[int]) -> Iterator[Splice]:
        """Yield the splices that remove entries."""
        entries = node.entries
        left = [index for index in range(len(entries)) if index not in gone]
        if not left:
            yield self.over(node.start, node.end, "[]" if node.kind == "list" else "{}")
            return
        if node.is_flow or not self.has_own_line(entries[0]):
            if left[0] > 0:
                yield self.over(entries[0].head, entries[left[0]].head, "")
            gone = {index for index in gone if index > left[0]}
        for index in sorted(gone):
            if node.is_flow:
                yield self.over(entries[index - 1].node.end, entries[index].node.end, "")
                continue
            start, end = self.span(node, index)
            yield self.over(start, self.line_end(end), "")

    def inserted(
        self,
        node: Node,
        items: Iterable[tuple[int, str | None, object]],
        *,
        at_end_of_file: bool = False,
    ) -> Iterator[Splice]:
        """Yield the splices that insert items or keys, each before the entry of its index."""
        grouped: dict[int, list[tuple[str | None, object]]] = {}
        for index, key, value in items:
            grouped.setdefault(min(index, len(node.entries)), []).append((key, value))
        for index, new in grouped.items():
            if node.is_flow:
                yield self._in_flow(node, index, new)
            else:
                yield self._in_lines(node, index, new, at_end_of_file=at_end_of_file)

    def _in_flow(self, node: Node, index: int, new: list[tuple[str | None, object]]) -> Splice:
        texts = [flow_text(one) if key is None else _pair(key, one) for key, one in new]
        if not node.entries:
            at = self.text.index("[" if node.kind == "list" else "{", node.start) + 1
            return self.over(at, at, ", ".join(texts))
        near = node.entries[min(index, len(node.entries) - 1)]
        own = len(node.entries) > 1 and self.has_own_line(near)
        indent = " " * (near.head - self.line_start(near.head))
        comma = f",{self.newline}{indent}" if own else ", "
        joined = comma.join(texts)
        if index < len(node.entries):
            return self.over(near.head, near.head, joined + comma)
        return self.over(near.node.end, near.node.end, comma + joined)

    def _in_lines(
        self,
        node: Node,
        index: int,
        new: list[tuple[str | None, object]],
        *,
        at_end_of_file: bool,
    ) -> Splice:
        head = node.entries[0].head
        indent = " " * (head - self.line_start(head))
        near = node.entries[min(index, len(node.entries) - 1)].node
        in_lines = near.kind == "mapping" and not near.is_flow
        newline = self.newline
        texts = [
            item_text(one, indent, newline, in_lines=in_lines)
            if key is None
            else entry_text(key, one, indent, newline)
            for key, one in new
        ]
        joined = f"{newline}{indent}".join(texts)
        if index < len(node.entries):
            entry = node.entries[index]
            if not self.has_own_line(entry):
                return self.over(entry.head, entry.head, f"{joined}{newline}{indent}")
            start, _ = self.span(node, index)
            return self.over(start, start, f"{indent}{joined}{newline}")
        is_page = at_end_of_file and not indent
        at = node.mark_end if is_page else self.line_end(self._last_of(node.entries[-1]))
        if self.text[:at].endswith("\n"):
            return self.over(at, at, f"{indent}{joined}{newline}")
        end = newline if is_page and at < len(self.text) else ""
        return self.over(at, at, f"{newline}{indent}{joined}{end}")

    def _last_of(self, entry: YamlEntry) -> int:
        """Return the end of the last line of an entry, with a comment, without the line end."""
        end = self.line_end(entry.node.end)
        return len(self.text[:end].rstrip("\r\n"))


def _pair(key: str, value: object) -> str:
    return flow_text({key: value})[1:-1]


def _value_of(value: object) -> object:
    return value.value if isinstance(value, WrittenValue) else copy.deepcopy(value)


def _at(root: Any, place: Location) -> Any:  # noqa: ANN401
    for part in place:
        root = root[part]
    return root


def _on_value(path: Path, edit: Edit, value: Any) -> None:  # noqa: ANN401
    try:
        edit.on_value(value)
    except InputError:
        raise
    except (KeyError, IndexError, TypeError, AttributeError, ValueError):
        raise InputError("there is no such place in this file", path=path) from None


def _require(
    path: Path,
    before: YamlSource,
    intended: object,
    text: str,
    read: Callable[[str, Path], YamlSource],
) -> None:
    """Refuse a text that is not the intended value."""
    by_hand = "this text is written in a way that cannot be changed here; edit its text"
    try:
        made = read(text, path)
    except InputError as error:
        raise InputError(f"{by_hand} ({error.reason})", path=path, line=error.line) from None
    if not is_same(made.value, intended):
        raise InputError(by_hand, path=path)
    known = {problem.reason for problem in before.problems}
    for problem in made.problems:
        if problem.reason not in known:
            raise InputError(problem.reason, path=path, line=made.line(problem.location))


def is_same(one: Any, other: Any) -> bool:  # noqa: ANN401
    """Return whether two values of YAML are the same: 1 is 1.0, and not true."""
    match one, other:
        case (dict(), dict()):
            return list(one) == list(other) and all(is_same(one[key], other[key]) for key in one)
        case (list(), list()):
            return len(one) == len(other) and all(map(is_same, one, other))
        case (bool(), _) | (_, bool()):
            return one is other
        case (int() | float(), int() | float()):
            return one == other or (one != one and other != other)  # noqa: PLR0124
        case _:
            return type(one) is type(other) and bool(one == other)


def _alike(one: str, other: str, most: int) -> int:
    """Return how many characters are equal from the start on, at most `most`."""
    low, high = 0, most
    while low < high:
        middle = (low + high + 1) // 2
        if one[low:middle] == other[low:middle]:
            low = middle
        else:
            high = middle - 1
    return low
