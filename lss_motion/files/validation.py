"""Checks file models with pydantic, and describes them as JSON Schema.

How file models are checked and described: pydantic's findings in words for people.

JSON Schemas of the file models: what editors complete and check with.

Apart from `validation`, because a file without a fault needs none of this.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar
from unicodedata import category

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

from lss_motion.files.source import known_names
from lss_motion.files.yaml_source import Location, Problem

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic_core import ErrorDetails
    from pydantic_core.core_schema import DictSchema, NullableSchema

    from lss_motion.files.yaml_source import YamlSource


TEXT_MAX_CHARS: Final = 64
"""What still fits a column of a table on screen."""

SHOWN_MAX_CHARS: Final = 60
"""How much of a wrong value an error repeats."""

NAME_PATTERN: Final = r"^[^\s,#\"']+$"
"""Names stand in CSV headers and in the text form of programs, which blanks and commas divide."""

_UNPRINTABLE: Final = frozenset({"Cc", "Cn", "Cs", "Zl", "Zp"})
"""Unicode categories that a terminal or a YAML writer cannot show: controls, halves, separators."""


class FileModel(BaseModel):
    """Base of all file models: no unknown keys, no text for numbers, no NaN."""

    model_config = ConfigDict(
        strict=True,
        extra="forbid",
        allow_inf_nan=False,
        frozen=True,
        field_title_generator=lambda key, _: key,
    )


def check_text(text: str) -> str:
    """Return `text`; raise ValueError if a terminal could not show it."""
    bad = next((char for char in text if category(char) in _UNPRINTABLE), None)
    if bad is not None:
        raise ValueError(f"holds the character U+{ord(bad):04X}, which cannot be shown")
    return text


def _check_name(name: str) -> str:
    if not re.search(NAME_PATTERN, name):
        raise ValueError("a name has no blanks, commas, quotes or #")
    return check_text(name)


Text = Annotated[str, Field(min_length=1, max_length=TEXT_MAX_CHARS), AfterValidator(check_text)]
Name = Annotated[
    str,
    Field(min_length=1, max_length=TEXT_MAX_CHARS, json_schema_extra={"pattern": NAME_PATTERN}),
    AfterValidator(_check_name),
]

Model = TypeVar("Model", bound=FileModel)


def validate(
    model: type[Model], source: YamlSource, *, blanks: Mapping[str, FileModel] | None = None
) -> tuple[Model | None, list[Problem], frozenset[Location]]:
    """Return what could be made of `source`, every problem found, and what was left out for it.

    Left out are the smallest parts that hold a problem: a key at the top (`("loop",)`), or an
    entry one below (`("joints", "elbow")`). An item of a list keeps its place: the blank of that
    list stands there. The model is None when what is left is no whole file.
    """
    problems = list(source.problems)
    try:
        return model.model_validate(source.value), problems, frozenset()
    except ValidationError as error:
        found = error.errors(include_url=False)

    schema = json_schema(model)
    problems += [_problem(details, schema) for details in found]
    left_out = frozenset(_location(details)[:2] for details in found)
    try:
        rest = model.model_validate(_without(source.value, left_out, blanks or {}))
    except ValidationError:
        return None, problems, left_out
    return rest, problems, left_out


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


def _location(details: ErrorDetails) -> Location:
    return tuple(part for part in details["loc"] if part != "[key]")


def _problem(details: ErrorDetails, schema: Mapping[str, Any]) -> Problem:
    location = _location(details)
    if details["type"] == "extra_forbidden":
        key = str(location[-1])
        allowed = _schema_at(schema, location[:-1]).get("properties", {})
        return Problem(location, f"unknown key {key!r}; {known_names(key, allowed)}")
    if details["type"] == "missing":
        return Problem(location, f"{location[-1]!r} is missing")
    place = ".".join(str(part) for part in location if isinstance(part, str))
    if location and isinstance(location[-1], int):
        place += f" item {location[-1] + 1}"
    rule = _rule(details, _schema_at(schema, location))
    return Problem(location, f"{place} ({_shown(details['input'])}): {rule}")


def _schema_at(schema: Mapping[str, Any], location: Location) -> Mapping[str, Any]:
    """Return the part of the JSON Schema that describes what is at `location`."""
    here: Mapping[str, Any] = schema
    for part in location:
        if isinstance(part, int):
            here = here.get("items", {})
        else:
            here = here.get("properties", {}).get(part) or here.get("additionalProperties") or {}
        if "$ref" in here:
            here = schema["$defs"][here["$ref"].rpartition("/")[2]]
    return here


def _rule(details: ErrorDetails, part: Mapping[str, Any]) -> str:
    """Return what is allowed, in words; `part` of the JSON Schema describes what is wrong."""
    context = details.get("ctx", {})
    match details["type"]:
        case "literal_error":
            words = re.findall(r"'([^']*)'", context["expected"])
            return f"is not allowed; {known_names(str(details['input']), words)}"
        case "string_pattern_mismatch" if "examples" in part:
            return f"must be written as in {part['examples'][0]!r}"
        case "model_type":
            keys = part.get("required") or list(part.get("properties", {}))[:1]
            return f"must hold keys and values, such as {{{', '.join(f'{k}: …' for k in keys)}}}"
    rule = _RULES.get(details["type"])
    return details["msg"] if rule is None else rule.format_map(context)


_RULES: Final = {
    "value_error": "{error}",
    "greater_than_equal": "must be {ge:g} or more",
    "greater_than": "must be more than {gt:g}",
    "less_than_equal": "must be {le:g} or less",
    "too_short": "must have {min_length} or more entries",
    "too_long": "must have {max_length} or fewer entries",
    "string_too_short": "must not be empty",
    "string_too_long": "must have {max_length} or fewer characters",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "string_type": "must be text; put it in quotes if it is meant as text",
    "bool_type": "must be true or false",
    "list_type": "must be a list, such as [1, 2]",
    "dict_type": "must hold keys and values, such as {{name: value}}",
}
"""What is allowed, by pydantic's name of the error; its own words are for programmers."""


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


def json_schema(model: type[FileModel]) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) that editors complete and check with."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **model.model_json_schema(schema_generator=_FileSchema),
    }


class _FileSchema(GenerateJsonSchema):
    """A key may be left out, but never be null; a name that breaks the rules is no free entry."""

    def nullable_schema(self, schema: NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def dict_schema(self, schema: DictSchema) -> JsonSchemaValue:
        made = super().dict_schema(schema)
        for pattern, entry in made.pop("patternProperties", {}).items():
            made["additionalProperties"] = entry
            made["propertyNames"] = {**made.get("propertyNames", {}), "pattern": pattern}
        return made

    def default_schema(self, schema: Any) -> JsonSchemaValue:  # noqa: ANN401  pydantic seam
        made = super().default_schema(schema)
        if "default" in made and made["default"] is None:
            del made["default"]
        return made
