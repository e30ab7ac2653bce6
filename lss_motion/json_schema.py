"""JSON Schemas of the file models: what editors complete and check with.

Apart from `validation`, because a file without a fault needs none of this.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue

if TYPE_CHECKING:
    from pydantic_core.core_schema import DictSchema, NullableSchema

    from lss_motion.validation import FileModel


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
