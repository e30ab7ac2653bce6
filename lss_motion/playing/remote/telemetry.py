"""Telemetry: where every joint is, as one binary message that is sent 30 times a second and more.

Pages and other clients read the bytes as `LAYOUT` says; it is part of `lss-motion schema remote`.
"""

from __future__ import annotations

import hashlib
import math
import struct
from typing import TYPE_CHECKING, Final, Self

from msgspec import Struct

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.planning.program.model import Program

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
