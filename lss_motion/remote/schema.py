"""The one schema of whoever steers a show: operations, events and telemetry.

An operation is a wish of a client, an event is what happened, and both are JSON objects whose key
`op` or `event` says which. `schema` returns their JSON Schema. Telemetry is binary, since it is
sent 30 times a second and more (`Telemetry`). Angles are joint degrees, times seconds of show time.
"""

from __future__ import annotations

import hashlib
import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.program.model import Program

OPERATION_MAX_BYTES: Final = 4096
"""A longer operation is refused before it is parsed. Ours have less than 200."""
LABEL_MAX_CHARS: Final = 64
RATE_LEAST: Final = 0.05
"""The lowest rate that can be asked for; `pause` is lower."""


class Message(BaseModel):
    """Base of all messages: no unknown keys, no text for numbers, no NaN."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class Operation(Message):
    """Base of all operations. `id` comes back in the event `accepted` or `refused`."""

    id: Annotated[int, Field(ge=0)] = 0


class Go(Operation):
    """Begin to move, where the player waits for that after its checks."""

    op: Literal["go"] = "go"


class Pause(Operation):
    """Brake within the limits, on the path, and stand there."""

    op: Literal["pause"] = "pause"


class Resume(Operation):
    """Go on at the rate that was asked for last."""

    op: Literal["resume"] = "resume"


class Rate(Operation):
    """Play at this share of the speed of the plan; the change is a ramp."""

    op: Literal["rate"] = "rate"
    ratio: Annotated[float, Field(ge=RATE_LEAST, le=1.0)]


class Seek(Operation):
    """Brake, move to where the show is at `to` (a show time or a label), and go on from there.

    A paused show stands there until it is resumed.
    """

    op: Literal["seek"] = "seek"
    to: (
        Annotated[float, Field(ge=0.0)]
        | Annotated[str, Field(min_length=1, max_length=LABEL_MAX_CHARS)]
    )


class Stop(Operation):
    """Brake within the limits, hold, give the settings back and end. Twice is the same as once."""

    op: Literal["stop"] = "stop"


class Estop(Operation):
    """Send the safe bytes at once and end. The power of the servos stays on."""

    op: Literal["estop"] = "estop"


class Beat(Operation):
    """The client is alive. The player watches this where it was started with `silent_s`."""

    op: Literal["beat"] = "beat"


AnyOperation = Annotated[
    Go | Pause | Resume | Rate | Seek | Stop | Estop | Beat, Field(discriminator="op")
]


class MarkInfo(Message):
    """A named keyframe of the show, and when the first pass reaches it."""

    label: str
    at_s: float


class Started(Message):
    """The first event: what is played. `duration_s` is None for a show without end."""

    event: Literal["started"] = "started"
    name: str
    robot: str
    is_simulated: bool
    duration_s: float | None
    plan: str
    """Hash of the program, as in the telemetry."""
    joints: tuple[str, ...]
    """The joints in the order of the telemetry."""
    marks: tuple[MarkInfo, ...]


class PhaseChanged(Message):
    """The player has entered a phase, by the names of `player.events.Phase`."""

    event: Literal["phase"] = "phase"
    phase: str


class Checked(Message):
    """Every servo is there and may do what the program requires."""

    event: Literal["checked"] = "checked"
    servos: int
    notes: tuple[str, ...]


class Warned(Message):
    """Something that a person should know and that stops nothing."""

    event: Literal["warned"] = "warned"
    text: str


class MarkPassed(Message):
    """The show has reached a named keyframe."""

    event: Literal["mark"] = "mark"
    label: str
    at_s: float


class CueReached(Message):
    """The show has reached a sound, a light, a function or a line to say."""

    event: Literal["cue"] = "cue"
    kind: Literal["sound", "run", "led", "say"]
    text: str
    at_s: float


class Waited(Message):
    """The show waits for a sensor (`begun`), or goes on."""

    event: Literal["waited"] = "waited"
    text: str
    state: Literal["begun", "met", "timeout"]


class Faulted(Message):
    """A fault, and the step of `on_fault` that was taken about it."""

    event: Literal["fault"] = "fault"
    joint: str
    cause: str
    kind: str
    step: str


class RateChanged(Message):
    """A client changed the rate, paused, or resumed."""

    event: Literal["rate"] = "rate"
    ratio: float
    is_paused: bool


class Accepted(Message):
    """The operation `id` of this client has been carried out, or has begun."""

    event: Literal["accepted"] = "accepted"
    id: int
    op: str


class Refused(Message):
    """The operation `id` of this client has no effect; `text` says why, and what to do."""

    event: Literal["refused"] = "refused"
    id: int
    text: str


class Lost(Message):
    """So many events found no room, since the client did not read."""

    event: Literal["lost"] = "lost"
    count: int


class JointHealth(Message):
    """What one servo reported last, besides its angle. None: not reported."""

    status: str | None
    temperature_c: float | None
    voltage_v: float | None
    current_a: float | None
    error_deg: float | None
    """Planned minus measured angle of the last reading."""
    correction_deg: float
    """What is added to the targets against the load."""
    allowed_deg: float
    """A joint further from its plan than this is a fault."""


class BusHealth(Message):
    """How much of a line the last period used."""

    use_ratio: float
    replies_hz: float


class Health(Message):
    """State of robot and lines, a few times a second. Dropped where the client does not read."""

    event: Literal["health"] = "health"
    phase: str
    show_s: float | None
    rate: float
    is_paused: bool
    late_us: int
    missed: int
    joints: dict[str, JointHealth]
    buses: dict[str, BusHealth]


class Ended(Message):
    """The last event. `outcome` and `report` are those of `lss-play --report`."""

    event: Literal["ended"] = "ended"
    outcome: str
    error: str | None
    """Why the run could not begin or go on."""
    report: dict[str, Any] | None


AnyEvent = Annotated[
    Started
    | PhaseChanged
    | Checked
    | Warned
    | MarkPassed
    | CueReached
    | Waited
    | Faulted
    | RateChanged
    | Accepted
    | Refused
    | Lost
    | Health
    | Ended,
    Field(discriminator="event"),
]

_OPERATIONS: Final[TypeAdapter[AnyOperation]] = TypeAdapter(AnyOperation)
_EVENTS: Final[TypeAdapter[AnyEvent]] = TypeAdapter(AnyEvent)


def schema() -> dict[str, Any]:
    """Return the JSON Schema of operations and events, and the layout of the telemetry."""
    operations = _OPERATIONS.json_schema(ref_template="#/$defs/{model}")
    events = _EVENTS.json_schema(ref_template="#/$defs/{model}", mode="serialization")
    shared = {**operations.pop("$defs"), **events.pop("$defs")}
    for entry in shared.values():  # The key that tells messages apart has a default in Python.
        entry["required"] = [
            *(key for key in ("op", "event") if key in entry["properties"]),
            *(key for key in entry.get("required", []) if key not in ("op", "event")),
        ]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "remote control of a show",
        "$defs": {**shared, "Operation": operations, "Event": events},
        "anyOf": [{"$ref": "#/$defs/Operation"}, {"$ref": "#/$defs/Event"}],
        "x-telemetry": {
            "version": TELEMETRY_VERSION,
            "byte order": "little-endian",
            "header": "u8 version, u8 zero, u16 joints, 8 bytes plan, f64 show_s, f32 rate",
            "joint": "f32 planned_deg, f32 predicted_deg, f32 read_deg (NaN: not read)",
        },
    }


def parse_operation(text: bytes | str) -> AnyOperation:
    """Return the operation of a JSON text; raises `InputError` that says what is allowed."""
    if len(text) > OPERATION_MAX_BYTES:
        raise InputError(f"an operation has at most {OPERATION_MAX_BYTES} bytes")
    try:
        return _OPERATIONS.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"][1:])
        raise InputError(f"operation{f' {place}' if place else ''}: {first['msg']}") from None


def parse_event(text: bytes | str) -> AnyEvent:
    """Return the event of a JSON text that this package wrote."""
    return _EVENTS.validate_json(text)


TELEMETRY_VERSION: Final = 1
PLAN_BYTES: Final = 8
_HEADER: Final = struct.Struct(f"<BBH{PLAN_BYTES}sdf")
_JOINT: Final = struct.Struct("<fff")


@dataclass(frozen=True, slots=True)
class Telemetry:
    """Where every joint is at one instant: planned, predicted and read angle in joint degrees.

    A joint that was not read yet has NaN. The bytes: `schema`.
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
