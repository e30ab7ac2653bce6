"""What all messages of `schema` are made of, and their JSON; telemetry, which is binary.

`Telemetry` is where every joint is, sent 30 times a second and more. Pages and other clients read
the bytes as `LAYOUT` says; it is part of `lss-motion schema remote`.
"""

from __future__ import annotations

import hashlib
import math
import struct
from typing import TYPE_CHECKING, Annotated, Any, Final, Self

import msgspec
from msgspec import Meta, Struct

from lss_motion.errors import InputError
from lss_motion.system.messages import plain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.planning.program.model import Program

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


TELEMETRY_VERSION: Final = 1
PLAN_BYTES: Final = 8
_HEADER: Final = struct.Struct(f"<BBH{PLAN_BYTES}sdf")
_JOINT: Final = struct.Struct("<fff")
LAYOUT: Final[Mapping[str, int | str]] = {
    "version": TELEMETRY_VERSION,
    "byte order": "little-endian",
    "header": "u8 version, u8 zero, u16 joints, 8 bytes plan, f64 show_s, f32 rate",
    "joint": "f32 planned_deg, f32 predicted_deg, f32 read_deg (NaN: not read)",
}


class Telemetry(Struct, frozen=True):
    """Where every joint is at one instant: planned, predicted and read angle in joint degrees.

    A joint that was not read yet has NaN. The bytes: `LAYOUT`.
    """

    plan: bytes
    show_s: float
    rate: float
    angles_deg: Sequence[tuple[float, float, float]]

    def to_bytes(self) -> bytes:
        """Return the message as bytes."""
        head = _HEADER.pack(
            TELEMETRY_VERSION, 0, len(self.angles_deg), self.plan, self.show_s, self.rate
        )
        return head + b"".join(_JOINT.pack(*angles) for angles in self.angles_deg)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Return the message that `to_bytes` wrote; raises `InputError` for another version."""
        version, _, joints, plan, show_s, rate = _HEADER.unpack_from(data)
        if version != TELEMETRY_VERSION:
            raise InputError(f"telemetry has version {version}, not {TELEMETRY_VERSION}")
        angles = list(_JOINT.iter_unpack(data[_HEADER.size : _HEADER.size + joints * _JOINT.size]))
        return cls(plan, show_s, rate, angles)


def plan_hash(program: Program) -> bytes:
    """Return a short hash of what a program sends, by which telemetry names its plan."""
    digest = hashlib.blake2b(digest_size=PLAN_BYTES)
    digest.update(f"{program.name} {program.robot} {sorted(program.start_deg.items())}".encode())
    digest.update(f"{program.repeat} {program.duration_s}".encode())
    for move in program.moves:
        digest.update(repr(tuple(move)).encode())
    return digest.digest()


def duration_of(program: Program) -> float | None:
    """Return the duration of a show; None if it has no end."""
    return None if math.isinf(program.duration_s) else program.duration_s
