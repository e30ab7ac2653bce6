"""Reads what a file holds by the classes of its keys; finds every problem, in words for people."""

from __future__ import annotations

import math
import operator
import re
import types
from functools import cache
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Final,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from msgspec.structs import fields

from lss_motion.files.keys import Check, FileModel, KeyBounds, Plain
from lss_motion.files.texts import comma_text, known_names
from lss_motion.files.yaml_source import Mistake

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.files.source import Location
    from lss_motion.files.yaml_source import YamlSource

    Reader = Callable[[object, Location, list[Mistake]], Any]
    """Returns the value of what a file holds at a place, or adds the problems to the list."""

SHOWN_MAX_CHARS: Final = 60
"""How much of a wrong value an error repeats."""

Model = TypeVar("Model", bound=FileModel)


def validate(
    model: type[Model], source: YamlSource, *, blanks: Mapping[str, FileModel] | None = None
) -> tuple[Model | None, list[Mistake], frozenset[Location]]:
    """Return what could be made of `source`, every problem found, and what was left out for it.

    Left out are the smallest parts that hold a problem: a key at the top (`("loop",)`), or an
    entry one below (`("joints", "elbow")`). An item of a list keeps its place: the blank of that
    list stands there. The model is None when what is left is no whole file.
    """
    problems = list(source.problems)
    found: list[Mistake] = []
    made = _struct(model)(source.value, (), found)
    if not found:
        return made, problems, frozenset()
    if wrong := [problem for problem in found if problem.location == ("version",)]:
        return None, wrong, frozenset()  # The other problems may be what it does not know yet.
    left_out = frozenset(problem.location[:2] for problem in found)
    again: list[Mistake] = []
    rest = _struct(model)(_without(source.value, left_out, blanks or {}), (), again)
    return None if again else rest, problems + found, left_out


def _without(
    value: Mapping[str, object], left_out: frozenset[Location], blanks: Mapping[str, FileModel]
) -> dict[str, object]:
    rest: dict[str, object] = {}
    for key, part in value.items():
        match part:
            case _ if (key,) in left_out:
                continue
            case dict():
                rest[key] = {
                    name: entry for name, entry in part.items() if (key, name) not in left_out
                }
            case list() if key in blanks:
                rest[key] = [
                    blanks[key] if (key, index) in left_out else item
                    for index, item in enumerate(part)
                ]
            case _:
                rest[key] = part
    return rest


@cache
def _struct(model: type[FileModel]) -> Reader:
    """Return what reads keys and values as an instance of `model`."""
    hints = get_type_hints(model, include_extras=True)
    own = [field for field in fields(model) if field.name != "given"]
    readers = {
        key: _reader(hints[key], key, (model.said[key],) if key in model.said else ())
        for key in (field.name for field in own)
    }
    required = {field.name for field in own if field.required}

    def read(value: object, place: Location, problems: list[Mistake]) -> Any:  # noqa: ANN401
        if isinstance(value, model):
            return value
        if not isinstance(value, dict):
            keys = [key for key in readers if key in required] or list(readers)[:1]
            shown = ", ".join(f"{key}: …" for key in keys)
            problems.append(
                _problem(place, value, f"must hold keys and values, such as {{{shown}}}")
            )
            return None
        before, values = len(problems), {}
        for key, reader in readers.items():
            if key in value:
                values[key] = reader(value[key], (*place, key), problems)
            elif key in required:
                problems.append(Mistake((*place, key), f"{key!r} is missing"))
        for key in value:
            if key not in readers:
                reason = f"unknown key {key!r}; {known_names(key, readers)}"
                problems.append(Mistake((*place, key), reason))
        if len(problems) > before:
            return None
        return model(**values, given=frozenset(values))

    return read


def _reader(hint: Any, key: str, metas: tuple[Any, ...] = ()) -> Reader:  # noqa: ANN401
    """Return what reads a value of a type; `metas` stand round it, the nearest first."""
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        plain = next((part for part in inside if isinstance(part, Plain)), None)
        if plain is not None:
            return _checked(lambda value, *_: value, [lambda value: plain.run(value, key)])
        return _reader(inside[0], key, (*inside[1:], *metas))
    if origin in (Union, types.UnionType):
        return _union(inside, key, metas)
    if isinstance(hint, type) and issubclass(hint, FileModel):
        return _struct(hint)
    if origin is Literal:
        return _literal(inside)
    rules = [rule for part in metas for rule in _rules(part, metas)]
    if origin is list:
        return _checked(_list(_reader(inside[0], key), _largest(metas)), rules)
    if origin is dict:
        return _checked(_dict(*(_reader(part, key) for part in inside)), rules)
    return _checked(_SCALARS[hint], rules)


def _largest(metas: tuple[Any, ...]) -> float:
    found = (part.max_length for part in metas if isinstance(part, KeyBounds))
    return next((count for count in found if count is not None), math.inf)


def _checked(reader: Reader, rules: list[Callable[[Any], Any]]) -> Reader:
    """Return a reader whose value must pass the rules, too."""

    def read(value: object, place: Location, problems: list[Mistake]) -> Any:  # noqa: ANN401
        before = len(problems)
        found = reader(value, place, problems)
        if len(problems) > before:
            return None
        try:
            for rule in rules:
                found = rule(found)
        except ValueError as error:
            problems.append(_problem(place, value, str(error)))
        return found

    return read if rules else reader


def _scalar(kind: type | tuple[type, ...], rule: str) -> Reader:
    def read(value: object, place: Location, problems: list[Mistake]) -> object:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            hint = comma_text(value) if kind is int else ""
            problems.append(_problem(place, value, f"{rule}{hint}"))
        return value

    return read


def _float(value: object, place: Location, problems: list[Mistake]) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        problems.append(_problem(place, value, f"must be a number{comma_text(value)}"))
        return 0.0
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        problems.append(_problem(place, value, "must be a finite number"))
    return number


_SCALARS: Final[dict[Any, Reader]] = {
    float: _float,
    int: _scalar(int, "must be a whole number"),
    bool: _scalar(bool, "must be true or false"),
    str: _scalar(str, "must be text; put it in quotes if it is meant as text"),
}


def _literal(allowed: tuple[Any, ...]) -> Reader:
    words = [word for word in allowed if isinstance(word, str)]

    def read(value: object, place: Location, problems: list[Mistake]) -> object:
        if not any(value == one and type(value) is type(one) for one in allowed):
            rule = f"is not allowed; {known_names(str(value), words)}"
            problems.append(_problem(place, value, rule))
        return value

    return read


def _list(item: Reader, most: float) -> Reader:
    def read(value: object, place: Location, problems: list[Mistake]) -> list[Any]:
        if not isinstance(value, list):
            problems.append(_problem(place, value, "must be a list, such as [1, 2]"))
            return []
        if len(value) > most:  # One problem, not one an item.
            return value
        return [item(part, (*place, index), problems) for index, part in enumerate(value)]

    return read


def _dict(name: Reader, item: Reader) -> Reader:
    def read(value: object, place: Location, problems: list[Mistake]) -> dict[Any, Any]:
        if not isinstance(value, dict):
            rule = "must hold keys and values, such as {name: value}"
            problems.append(_problem(place, value, rule))
            return {}
        return {
            name(key, (*place, key), problems): item(part, (*place, key), problems)
            for key, part in value.items()
        }

    return read


def _union(kinds: tuple[Any, ...], key: str, metas: tuple[Any, ...]) -> Reader:
    """Return a reader that takes the kind to which a value belongs; the last one if to none."""
    may_be_none = type(None) in kinds
    readers = [
        (_python_type(one), _reader(one, key, metas)) for one in kinds if one is not type(None)
    ]

    def read(value: object, place: Location, problems: list[Mistake]) -> Any:  # noqa: ANN401
        if value is None and may_be_none:
            return None
        near = [reader for kind, reader in readers if isinstance(value, kind)]
        before = len(problems)
        for reader in near or [readers[0][1]]:
            del problems[before:]
            found = reader(value, place, problems)
            if len(problems) == before:
                return found
        return None

    return readers[0][1] if len(readers) == 1 and not may_be_none else read


def _python_type(hint: Any) -> type | tuple[type, ...]:  # noqa: ANN401
    """Return what a value of a type is in Python."""
    origin = get_origin(hint)
    if origin is Annotated:
        return _python_type(get_args(hint)[0])
    if origin is Literal:
        return tuple(type(one) for one in get_args(hint))
    if origin is dict or (isinstance(hint, type) and issubclass(hint, FileModel)):
        return dict
    kind: type = origin or hint
    return (int, float) if kind is float else kind


def _rules(part: object, metas: tuple[Any, ...]) -> list[Callable[[Any], Any]]:
    """Return the functions that check what one part of an `Annotated` says."""
    if isinstance(part, Check):
        return [part.run]
    if not isinstance(part, KeyBounds):
        return []
    bounds = [(name, getattr(part, name)) for name in _BOUNDS if getattr(part, name) is not None]
    rules = [_rule(*_BOUNDS[name], bound) for name, bound in bounds]
    if part.pattern is not None:
        rules.append(_rule(re.search, _written_as(metas), part.pattern))
    return rules


def _rule(
    holds: Callable[[Any, Any], Any], text: Callable[[Any, Any], str], bound: object
) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:  # noqa: ANN401
        if not holds(bound, value):
            raise ValueError(text(bound, value))
        return value

    return check


def _too_few(least: int, value: object) -> str:
    is_text = isinstance(value, str)
    return "must not be empty" if is_text else f"must have {least} or more entries"


def _too_many(most: int, value: object) -> str:
    return f"must have {most} or fewer {'characters' if isinstance(value, str) else 'entries'}"


def _written_as(metas: tuple[Any, ...]) -> Callable[[str, str], str]:
    given = [part.examples for part in metas if isinstance(part, KeyBounds) and part.examples]
    if given:
        return lambda *_: f"must be written as in {given[0][0]!r}"
    return lambda pattern, _: f"must match {pattern}"


_BOUNDS: Final[dict[str, tuple[Callable[[Any, Any], Any], Callable[[Any, Any], str]]]] = {
    "ge": (operator.le, lambda least, _: f"must be {least:g} or more"),
    "gt": (operator.lt, lambda least, _: f"must be more than {least:g}"),
    "le": (operator.ge, lambda most, _: f"must be {most:g} or less"),
    "min_length": (lambda least, value: len(value) >= least, _too_few),
    "max_length": (lambda most, value: len(value) <= most, _too_many),
}
"""Of each bound: whether it holds, given the bound and the value, and what is allowed, in words."""


def _problem(location: Location, value: object, rule: str) -> Mistake:
    place = ".".join(str(part) for part in location if isinstance(part, str))
    if location and isinstance(location[-1], int):
        place += f" item {location[-1] + 1}"
    return Mistake(location, f"{place} ({_shown(value)}): {rule}")


def _shown(value: object) -> str:
    match value:
        case None:
            return "no value"
        case bool():
            return str(value).lower()
        case dict():
            return "keys and values"
        case list():
            shown = "[" + ", ".join(_shown(item) for item in value[:9]) + "]"
        case _:
            shown = repr(value)
    return shown if len(shown) <= SHOWN_MAX_CHARS else shown[: SHOWN_MAX_CHARS - 3] + "..."
