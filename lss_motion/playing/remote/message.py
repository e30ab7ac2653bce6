"""What all messages of `schema` are made of, and their JSON."""

from __future__ import annotations

from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta, Struct

from lss_motion.system.messages import plain

LABEL_MAX_CHARS: Final = 64
Name = Annotated[str, Meta(min_length=1, max_length=LABEL_MAX_CHARS)]
_ENCODER: Final = msgspec.json.Encoder(enc_hook=plain)


class Message(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all messages: no unknown keys, no text for numbers, no NaN."""

    def to_json(self) -> bytes:
        """Return the message as JSON."""
        return _ENCODER.encode(self)


class Operation(Message, frozen=True, kw_only=True, tag_field="op"):
    """Base of all operations. `id` comes back in the event `accepted` or `refused`."""

    id: Annotated[int, Meta(ge=0)] = 0

    @property
    def op(self) -> str:
        """The key `op`, which tells operations apart."""
        return str(self.__struct_config__.tag)


class Event(Message, frozen=True, kw_only=True, tag_field="event"):
    """Base of all events."""

    @property
    def event(self) -> str:
        """The key `event`, which tells events apart."""
        return str(self.__struct_config__.tag)


def json_schemas(*unions: Any) -> tuple[list[dict[str, Any]], dict[str, Any]]:  # noqa: ANN401
    """Return the JSON Schema of each union of messages, and the definitions that they share."""
    found, shared = msgspec.json.schema_components(unions, ref_template="#/$defs/{name}")
    for entry in shared.values():
        for key in {"op", "event"} & entry.get("properties", {}).keys():
            tag = entry["properties"][key].get("enum", ())
            if len(tag) == 1:
                entry["properties"][key] = {"const": tag[0], "type": "string"}
    return [{"oneOf": one["anyOf"], "discriminator": one["discriminator"]} for one in found], shared


def reason(error: Exception) -> str:
    """Return what is wrong with a text that is no message: the key, if it is one, and why."""
    text, _, place = str(error).partition(" - at `$.")
    return f"{place.removesuffix('`')}: {text}" if place else text
