"""Reads YAML text into plain values with their lines. It is the same for every kind of file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.source import Location, read_text
from lss_motion.files.texts import comma_text, counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


NODES_MAX: Final = 1_000_000
"""10,000 keyframes of 40 joints are 850,000 keys and values; aliases count as what they repeat."""

DEPTH_MAX: Final = 16
"""Our files, and goals of ROS, are 5 deep. Thousands of brackets would overflow the stack."""

NUMBER_MAX_CHARS: Final = 40
"""A longer number is not a measurement; Python refuses thousands of digits with its own error."""

PROBLEMS_MAX: Final = 50
"""Problems that are listed; the rest is counted."""


class Mistake(Struct, frozen=True):
    """A mistake at one place of a file."""

    location: Location
    reason: str


@dataclass(slots=True)
class _Lines:
    """The line of every key and item of one mapping or list, and the same for what is inside."""

    own: int
    of: dict[str | int, int] = field(default_factory=dict)
    inside: dict[str | int, _Lines] = field(default_factory=dict)


class YamlSource(Struct, frozen=True):
    """The content of one file: `value` is made of dict, list, str, int, float, bool and None.

    `problems` holds the mistakes that YAML accepts silently: a key given twice, and a key or an
    item without a value (its value is None).
    """

    path: Path
    value: dict[str, object]
    problems: tuple[Mistake, ...]
    _lines: _Lines
    has_lines: bool = True
    """False for what was no file: its problems name places instead."""

    def line(self, location: Location) -> int:
        """Return the line, from 1, of `location`, or of the nearest existing place above it."""
        lines, line = self._lines, self._lines.own
        for part in location:
            line = lines.of.get(part, line)
            inside = lines.inside.get(part)
            if inside is None:
                break
            lines = inside
        return line

    def error(self, problems: list[Mistake]) -> InputError:
        """Return one error with all `problems` (at least one), in the order of the lines."""
        first_of_each: dict[Location, Mistake] = {}
        for problem in problems:
            first_of_each.setdefault(problem.location, problem)
        placed = sorted(
            ((self.line(problem.location), problem) for problem in first_of_each.values()),
            key=lambda found: found[0],
        )
        errors = [self._error(problem, line) for line, problem in placed]
        if len(errors) > PROBLEMS_MAX:
            rest = InputError(
                f"and {counted(len(errors) - PROBLEMS_MAX, 'more problem')}", path=self.path
            )
            errors = [*errors[:PROBLEMS_MAX], rest]
        top = errors[0]
        return InputError(top.reason, path=top.path, line=top.line, more=errors[1:])

    def _error(self, problem: Mistake, line: int) -> InputError:
        if self.has_lines:
            return InputError(problem.reason, path=self.path, line=line)
        place = place_text(problem.location)
        return InputError(f"{place}: {problem.reason}" if place else problem.reason)


def read_yaml(path: Path) -> YamlSource:
    """Return the one mapping that the file holds, or raise `InputError` with the line.

    Scalars follow YAML 1.2 (`yes` and `1:30` are text, `1e3` and `010` are numbers). Anchors and
    aliases work; tags, merge keys, several documents and keys that are no text do not.
    """
    text = read_text(path)
    edited = None if (values := _edited.get()) is None else values.get(path.resolve())
    return parse_yaml(text, path) if edited is None else replace(edited, path=path)


_edited: ContextVar[Mapping[Path, YamlSource] | None] = ContextVar("edited values", default=None)


@contextmanager
def with_values(sources: Mapping[Path, YamlSource]) -> Iterator[None]:
    """Let files, by their full paths, hold other values inside of this block, in this thread."""
    token = _edited.set(sources)
    try:
        yield
    finally:
        _edited.reset(token)


VALUE_PATH: Final = Path("dict")
"""Stands for the file of what was given as values; files that it names are relative to the current
folder."""


def source_of(value: Mapping[str, object]) -> YamlSource:
    """Return what `read_yaml` would return for a file with these values.

    Raises `InputError` for a value that no file could hold. There are no lines, so problems name
    the place of a value, such as `keyframes.2.deg.elbow`.
    """
    text = json.dumps(_plain(value, ()), indent=0)  # JSON is YAML, with every text quoted.
    return replace(parse_yaml(text, VALUE_PATH), has_lines=False)


def _plain(value: object, place: Location) -> object:
    """Return `value` made of what JSON has; numbers of numpy become those of Python."""
    match value:
        case Mapping():
            for key in value:
                if not isinstance(key, str):
                    raise InputError(f"{place_text((*place, repr(key)))}: a key must be a text")
            return {key: _plain(one, (*place, key)) for key, one in value.items()}
        case list() | tuple():
            return [_plain(one, (*place, index)) for index, one in enumerate(value)]
        case Path():
            return str(value)
        case None | bool() | int() | float() | str():
            return value
    if callable(item := getattr(value, "item", None)):
        return _plain(item(), place)
    raise InputError(
        f"{place_text(place)}: {type(value).__name__!r} is no type of a file; numbers, texts, "
        f"lists and dicts are"
    )


def place_text(location: Location) -> str:
    """Return the place of a value, as a text."""
    return ".".join(map(str, location))


def parse_yaml(text: str, path: Path) -> YamlSource:
    """Return what `read_yaml` does, of a text; `path` is where it comes from."""
    import yaml

    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    builder = _Builder(path, yaml.parse(text, Loader=loader))
    try:
        value, lines = builder.document()
    except yaml.YAMLError as error:
        raise _syntax_error(error, path, text) from error
    if value is None and lines is None:
        raise InputError("is empty", path=path)
    if not isinstance(value, dict) or lines is None:
        raise InputError("must hold keys and values, such as `name: value`", path=path, line=1)
    return YamlSource(path, value, tuple(builder.problems), lines)


def _syntax_error(error: Exception, path: Path, text: str) -> InputError:
    mark, reason = getattr(error, "problem_mark", None), syntax_reason(error)
    if mark is None:  # A character that YAML does not allow anywhere: only its position is known.
        position = getattr(error, "position", None)
        line = None if position is None else text.count("\n", 0, position) + 1
        return InputError(reason, path=path, line=line)
    lines = text.split("\n")
    line = min(mark.line + 1, len(lines))
    hint = ""
    if "\t" in lines[line - 1][: mark.column + 1]:
        hint = "; indent with spaces, not with tabs"
    return InputError(f"{reason}{hint}", path=path, line=line)


def syntax_reason(error: Exception) -> str:
    """Return what the YAML parser refused, in one line.

    Some parsers have a bound of depth of their own, far above ours, and read ahead up to it.
    """
    reason = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    if "nesting depth" in reason:
        return f"nested more than {DEPTH_MAX} deep"
    return f"not YAML: {reason}"


@dataclass(slots=True)
class _BuiltNode:
    """A finished value, its lines (of a mapping or list), and how many nodes it stands for."""

    value: object
    lines: _Lines | None
    weight: int


class _Builder:
    """Makes values from YAML events; a loop over an explicit depth, so that no input overflows."""

    def __init__(self, path: Path, events: Iterator[Any]) -> None:
        self.problems: list[Mistake] = []
        self._path = path
        self._events = events
        self._anchors: dict[str, _BuiltNode | None] = {}
        self._nodes_count = 0

    def document(self) -> tuple[object, _Lines | None]:
        root: _BuiltNode | None = None
        for event in self._events:
            match type(event).__name__:
                case "DocumentStartEvent" if root is not None:
                    raise self._error(event, "a second document starts here; one is allowed")
                case "ScalarEvent" | "AliasEvent" | "MappingStartEvent" | "SequenceStartEvent":
                    root = self._node(event, ())
                case _:
                    pass
        return (None, None) if root is None else (root.value, root.lines)

    def _node(self, event: Any, location: Location) -> _BuiltNode:  # noqa: ANN401  yaml seam
        kind = type(event).__name__
        if kind == "AliasEvent":
            node = self._repeated(event)
            self._count(event, node.weight)
            return node
        self._count(event, 1)
        if event.tag is not None:
            raise self._error(event, f"tag {event.tag!r} is not accepted; remove it")
        if len(location) > DEPTH_MAX:
            raise self._error(event, f"nested more than {DEPTH_MAX} deep")
        if event.anchor is not None:
            self._anchors[event.anchor] = None  # Open: an alias inside would never end.
        match kind:
            case "ScalarEvent":
                node = _BuiltNode(_scalar(event), None, 1)
            case "MappingStartEvent":
                node = self._mapping(event, location)
            case _:
                node = self._list(event, location)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _mapping(self, start: Any, location: Location) -> _BuiltNode:  # noqa: ANN401  yaml seam
        value: dict[str, object] = {}
        lines = _Lines(start.start_mark.line + 1)
        weight = 1
        while type(event := next(self._events)).__name__ != "MappingEndEvent":
            key = self._key(event)
            node = self._node(next(self._events), (*location, key))
            weight += 1 + node.weight
            before = next(reversed(value.values()), None)
            self._place((*location, key), event.start_mark.line + 1, node, lines, before)
            value.pop(key, None)
            value[key] = node.value
        return _BuiltNode(value, lines, weight)

    def _list(self, start: Any, location: Location) -> _BuiltNode:  # noqa: ANN401  yaml seam
        value: list[object] = []
        lines = _Lines(start.start_mark.line + 1)
        weight = 1
        while type(event := next(self._events)).__name__ != "SequenceEndEvent":
            node = self._node(event, (*location, len(value)))
            weight += node.weight
            self._place((*location, len(value)), event.start_mark.line + 1, node, lines)
            value.append(node.value)
        return _BuiltNode(value, lines, weight)

    def _place(
        self, location: Location, line: int, node: _BuiltNode, lines: _Lines, before: object = None
    ) -> None:
        """Note where a key or an item is, and what is wrong with it.

        `before` is the value before it: in `{at_s: 0,5}` the comma ends the value of `at_s`.
        """
        part = location[-1]
        if part in lines.of:
            self._problem(location, f"{part!r} is given twice, first in line {lines.of[part]}")
        elif node.value is None:
            comma = comma_text(f"{before},{part}") if type(before) is int else ""
            self._problem(location, f"{_name(part)} has no value; give one or remove it{comma}")
        lines.of[part] = line
        if node.lines is not None:
            lines.inside[part] = node.lines

    def _problem(self, location: Location, reason: str) -> None:
        self.problems.append(Mistake(location, reason))

    def _key(self, event: Any) -> str:  # noqa: ANN401  yaml seam
        if type(event).__name__ != "ScalarEvent" or event.tag is not None:
            raise self._error(event, "a key must be plain text")
        if event.value == "<<":
            raise self._error(event, "merge keys (`<<`) are not supported; repeat the keys")
        self._count(event, 1)
        return str(event.value)

    def _repeated(self, event: Any) -> _BuiltNode:  # noqa: ANN401  yaml seam
        if event.anchor not in self._anchors:
            raise self._error(
                event, f"alias *{event.anchor} has no anchor &{event.anchor} above it"
            )
        node = self._anchors[event.anchor]
        if node is None:
            raise self._error(event, f"alias *{event.anchor} stands inside its own anchor")
        return node

    def _count(self, event: Any, weight: int) -> None:  # noqa: ANN401  yaml seam
        self._nodes_count += weight
        if self._nodes_count > NODES_MAX:
            raise self._error(event, f"more than {NODES_MAX:,} keys and values")

    def _error(self, event: Any, reason: str) -> InputError:  # noqa: ANN401  yaml seam
        return InputError(reason, path=self._path, line=event.start_mark.line + 1)


def _name(part: str | int) -> str:
    return f"item {part + 1}" if isinstance(part, int) else repr(part)


_WORDS: Final[dict[str, object]] = {
    **dict.fromkeys(["", "~", "null", "Null", "NULL"]),
    **dict.fromkeys(["true", "True", "TRUE"], True),
    **dict.fromkeys(["false", "False", "FALSE"], False),
    **dict.fromkeys([".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"], float("inf")),
    **dict.fromkeys(["-.inf", "-.Inf", "-.INF"], float("-inf")),
    **dict.fromkeys([".nan", ".NaN", ".NAN"], float("nan")),
}
"""The words of the YAML 1.2 core schema (section 10.3.2) that are no text."""

_NUMBERS: Final[tuple[tuple[re.Pattern[str], Callable[[str], object]], ...]] = (
    (re.compile(r"[-+]?[0-9]+"), int),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), float),
)
"""Decimal numbers of the same schema. Octal and hexadecimal ones stay text: no angle is one."""


def _scalar(event: Any) -> object:  # noqa: ANN401  yaml seam
    text = str(event.value)
    if event.style in {"'", '"', "|", ">"}:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if len(text) <= NUMBER_MAX_CHARS:
        for pattern, number in _NUMBERS:
            if pattern.fullmatch(text):
                return number(text)
    return text
