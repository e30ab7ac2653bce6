"""The classes of keys: what a file may hold, as fields with types, bounds and descriptions.

`files.validation` reads a file by them, `json_schema` describes them for editors.
"""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Callable  # noqa: TC003  (read when a file is checked)
from typing import (
    Annotated,
    Any,
    ClassVar,
    Final,
    Literal,
    Self,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)
from unicodedata import category

import msgspec
from msgspec import NODEFAULT, UNSET, Struct, StructMeta
from msgspec.structs import fields, replace

TEXT_MAX_CHARS: Final = 64
"""What still fits a column of a table on screen."""

NAME_PATTERN: Final = r"^[^\s,#\"']+$"
"""Names stand in CSV headers and in the text form of programs, which blanks and commas divide."""

_UNPRINTABLE: Final = frozenset({"Cc", "Cn", "Cs", "Zl", "Zp"})
"""Unicode categories that a terminal or a YAML writer cannot show: controls, halves, separators."""


class KeyBounds(Struct, frozen=True, eq=False, kw_only=True):
    """What a type or a key says of its values: bounds, and the words of the reference."""

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    min_length: int | None = None
    max_length: int | None = None
    pattern: str | None = None
    description: str | None = None
    examples: list[Any] | None = None
    json_schema_extra: dict[str, Any] | None = None
    default: Any = UNSET
    default_factory: Any = UNSET


def Field(**said: Any) -> Any:  # noqa: ANN401, N802  (the default of a key of any type)
    """Return what a type or a key says of its values, as `KeyBounds` names it."""
    return KeyBounds(**said)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(Field,))
class KeysMeta(StructMeta):
    """Makes the class of keys: what `Field` says stays beside it, and gives the defaults."""

    title: str
    said: dict[str, KeyBounds]

    def __new__(
        cls, name: str, bases: tuple[type, ...], names: dict[str, Any], title: str = ""
    ) -> KeysMeta:
        said = {key: value for key, value in names.items() if isinstance(value, KeyBounds)}
        for key, value in said.items():
            if value.default_factory is not UNSET:
                names[key] = msgspec.field(default_factory=value.default_factory)
            elif isinstance(value.default, list) and value.default:
                names[key] = msgspec.field(default_factory=value.default.copy)
            elif value.default is not UNSET:
                names[key] = value.default
            else:
                del names[key]
        made = super().__new__(cls, name, bases, names, frozen=True, kw_only=True)
        made.title = title or name
        inherited = (getattr(base, "said", {}) for base in bases)
        made.said = {key: one for part in (*inherited, said) for key, one in part.items()}
        return made


class FileModel(Struct, metaclass=KeysMeta):  # noqa: PLW1641  (a list has no hash)
    """Base of all classes of keys: no unknown keys, no text for numbers, no NaN.

    `given` are the keys that the file has; all others have their defaults.
    """

    title: ClassVar[str]
    said: ClassVar[dict[str, KeyBounds]]
    more_schema: ClassVar[dict[str, Any]] = {}
    given: frozenset[str] = frozenset()

    def __eq__(self, other: object) -> bool:
        """Return whether the values are equal, however the file gives them."""
        return isinstance(other, FileModel) and (
            type(self) is type(other) and self.known() == other.known()
        )

    def known(self) -> dict[str, Any]:
        """Return the values by key, without those that are None."""
        values = {key: getattr(self, key) for key in self.__struct_fields__ if key != "given"}
        return {key: value for key, value in values.items() if value is not None}

    def changed(self, **values: object) -> Self:
        """Return this with other values, as if the file had them."""
        return replace(self, given=self.given | values.keys(), **values)


class Check(Struct, frozen=True, eq=False):
    """Part of a type: a function that returns the value, or raises `ValueError` with the rule."""

    run: Callable[[Any], Any]


class Plain(Struct, frozen=True, eq=False):
    """Part of a type: all of its check, given value and key, and its JSON Schema."""

    run: Callable[[Any, str], Any]
    schema: dict[str, Any]


def check_text(text: str) -> str:
    """Return `text`; raise ValueError if a terminal could not show it."""
    if text.isascii() and text.isprintable():
        return text
    bad = next((char for char in text if category(char) in _UNPRINTABLE), None)
    if bad is not None:
        raise ValueError(f"holds the character U+{ord(bad):04X}, which cannot be shown")
    return text


def _check_name(name: str) -> str:
    if not re.search(NAME_PATTERN, name):
        raise ValueError("a name has no blanks, commas, quotes or #")
    return check_text(name)


FILE_VERSION: Final = 1
"""Of all files that people write. It grows when a file changes its meaning for an older program,
not with a new key: a key that is not known is refused by its name."""


def _check_version(version: int) -> int:
    if version > FILE_VERSION:
        raise ValueError(
            f"is newer than this program, which reads version {FILE_VERSION}; install a newer "
            "lss-motion"
        )
    return version


Version = Annotated[int, Field(ge=1), Check(_check_version)]
VERSION: Final = "Version of the form of this file. One that is newer than the program is refused."

Text = Annotated[str, Field(min_length=1, max_length=TEXT_MAX_CHARS), Check(check_text)]
Name = Annotated[
    str,
    Field(min_length=1, max_length=TEXT_MAX_CHARS, json_schema_extra={"pattern": NAME_PATTERN}),
    Check(_check_name),
]


def json_schema(model: type[FileModel]) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) that editors complete and check with.

    A key may be left out, but never be null.
    """
    parts: dict[str, Any] = {}
    top = _model_schema(model, parts)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$defs": dict(sorted(parts.items())),
        **top,
    }


def _model_schema(model: type[FileModel], parts: dict[str, Any]) -> dict[str, Any]:
    hints = get_type_hints(model, include_extras=True)
    own = [field for field in fields(model) if field.name != "given"]
    properties = {}
    for field in own:
        described = _type_schema(hints[field.name], parts)
        if field.name in model.said:
            described |= _meta_schema(model.said[field.name], str(described.get("type")))
        if "$ref" not in described:
            described["title"] = field.name
        default = field.default
        if default is NODEFAULT and field.default_factory is not NODEFAULT:
            default = field.default_factory()
        if isinstance(default, bool | int | float | str | list) or default == {}:
            described["default"] = default
        properties[field.name] = dict(sorted(described.items()))
    made = {
        "additionalProperties": False,
        "description": inspect.cleandoc(model.__doc__ or ""),
        "properties": properties,
        "required": [field.name for field in own if field.required],
        "title": model.title,
        "type": "object",
        **model.more_schema,
    }
    return dict(sorted((key, value) for key, value in made.items() if value != []))


_JSON_TYPES: Final = {float: "number", int: "integer", bool: "boolean", str: "string"}
_LENGTHS: Final = {"string": "Length", "array": "Items", "object": "Properties"}


def _type_schema(hint: Any, parts: dict[str, Any]) -> dict[str, Any]:  # noqa: ANN401
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        plain = next((part for part in inside if isinstance(part, Plain)), None)
        made = dict(plain.schema) if plain else _type_schema(inside[0], parts)
        for part in inside[1:]:
            if isinstance(part, KeyBounds):
                made |= _meta_schema(part, str(made.get("type")))
        return made
    if origin in (Union, types.UnionType):
        kinds = [_type_schema(one, parts) for one in inside if one is not type(None)]
        return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    if origin is Literal:
        kind = _JSON_TYPES[type(inside[0])]
        return {"type": kind, **({"const": inside[0]} if len(inside) == 1 else {"enum": [*inside]})}
    if origin is list:
        return {"type": "array", "items": _type_schema(inside[0], parts)}
    if origin is dict:
        names = _type_schema(inside[0], parts)
        del names["type"]
        made = {"type": "object", "additionalProperties": _type_schema(inside[1], parts)}
        return made | ({"propertyNames": names} if names else {})
    if issubclass(hint, FileModel):
        if hint.__name__ not in parts:
            parts[hint.__name__] = {}  # It may hold itself.
            parts[hint.__name__] = _model_schema(hint, parts)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    return {"type": _JSON_TYPES[hint]}


def _meta_schema(part: KeyBounds, kind: str) -> dict[str, Any]:
    length = _LENGTHS.get(kind, "")
    made = {
        "minimum": part.ge,
        "exclusiveMinimum": part.gt,
        "maximum": part.le,
        f"min{length}": part.min_length,
        f"max{length}": part.max_length,
        "pattern": part.pattern,
        "description": part.description,
        "examples": part.examples,
        **(part.json_schema_extra or {}),
    }
    return {key: value for key, value in made.items() if value is not None}
