"""Describes classes of keys as JSON Schema: what editors complete and check with."""

from __future__ import annotations

import inspect
import types
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from msgspec import NODEFAULT
from msgspec.structs import fields

from lss_motion.files.keys import FileModel, KeyBounds, Plain


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
