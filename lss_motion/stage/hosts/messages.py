"""What conductor and figures send each other: values, and their JSON.

Every message holds a whole state, not a change of one: whichever of them arrives, in whatever order
and however often, the newest is enough. So nothing is acknowledged and nothing is sent again.

| key (below the name of the stage)  | message           | from, and how often                     |
|------------------------------------|-------------------|-----------------------------------------|
| `beat`                             | `Beat`            | conductor, 10 Hz, and on every change   |
| `stop`                             | `StopAll`         | conductor, repeated                     |
| `figure/NAME/status`               | `Status`          | figure, 5 Hz, and on every change       |
| `figure/NAME/ask`                  | `Ask`             | figure: a cue, GO or STOP for the stage |
| `figure/NAME/findings`             | `Findings`        | figure, when the conductor asks for it  |
| `examined/NAME`                    | `Examined`        | conductor, when `doctor` asks           |
| `figure/NAME/clock`                | `ClockQuestion`   | figure, 8 Hz                            |
| `clock/NAME`                       | `ClockAnswer`     | conductor                               |
| `plan/SHA256`                      | a plan, `Cast`, `Catalogue` | conductor, when it is queried |
| `figure/NAME/alive`                | liveliness token  | figure                                  |
| `conductor/alive`                  | liveliness token  | conductor                               |
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, Final, Literal, TypeVar

from pydantic import Field, ValidationError

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.message import Message, Operation

PROTOCOL: Final = 4
"""Conductor and figures must have the same."""
MESSAGE_MAX_BYTES: Final = 16 * 1024
"""A longer message is none of ours; the longest, a `Status` with its texts, has about 1 kB."""
CAST_MAX_BYTES: Final = 1 << 20
TEXT_MAX_CHARS: Final = 400
EPOCHS_AHEAD: Final = 100_000
"""An epoch that is further ahead of the known one is none: every start of a conductor counts one,
and this is one every five minutes for a year."""
NAME_PATTERN: Final = r"^[A-Za-z][A-Za-z0-9_-]{0,31}$"
"""Names of stages and figures stand in keys and certificates."""

Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
FigureName = Annotated[str, Field(pattern=NAME_PATTERN)]
Note = Annotated[str, Field(max_length=TEXT_MAX_CHARS)]
Instant = Annotated[int, Field(ge=-(1 << 62), le=1 << 62)]


def hash_of(content: bytes) -> str:
    """Return the hash by which content is stored, asked for and checked."""
    return hashlib.sha256(content).hexdigest()


class NetworkLeg(Message):
    """At the conductor's instant `instant_ns` the show is at `show_s`, and goes on at `rate`.

    `number` counts the legs of a run. Rate 0 stands.
    """

    number: Annotated[int, Field(ge=1)]
    instant_ns: Instant
    show_s: Annotated[float, Field(ge=-3600.0, le=1e7)]
    rate: Annotated[float, Field(ge=0.0, le=1.1)]

    def at_s(self, conductor_ns: int) -> float:
        """Return the show time at an instant of the conductor."""
        return self.show_s + self.rate * (conductor_ns - self.instant_ns) / 1_000_000_000


Wanted = Literal["nothing", "ready", "armed", "stopped"]
"""What the conductor wants of all figures: nothing; plan and clock ready; the robot at the start of
the show; brake, hold and end."""


class Beat(Message):
    """State of the conductor.

    `epoch` is higher than that of every conductor before it, `instance` differs between two
    processes, and `run` counts what was begun: a figure stops once for each run.
    """

    protocol: int = PROTOCOL
    conductor: FigureName
    epoch: Annotated[int, Field(ge=1)]
    instance: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    count: Annotated[int, Field(ge=0)]
    wanted: Wanted = "nothing"
    run: Annotated[int, Field(ge=0)] = 0
    cast: Hash | None = None
    catalogue: Hash | None = None
    """What may be wanted later: figures fetch and verify it before (`Catalogue`)."""
    leg: NetworkLeg | None = None
    start_s: Annotated[float, Field(ge=0.0, le=1e7)] = 0.0
    """Show time at which the robots stand while they are armed."""
    examines: Annotated[int, Field(ge=0)] = 0
    """Each figure without a player examines its computer and servos once for every number."""


class StopAll(Message):
    """Brake, hold and end, whatever plays of this run. Repeated, and as good as once."""

    conductor: FigureName
    epoch: Annotated[int, Field(ge=1)]
    instance: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    run: Annotated[int, Field(ge=0)]


class Part(Message):
    """What one figure plays: the hashes of its plan and of the robot that it was made for."""

    plan: Hash
    robot: Hash


class Cast(Message):
    """A show and what each figure plays in it."""

    show: Annotated[str, Field(min_length=1, max_length=64)]
    duration_s: Annotated[float, Field(ge=0.0)] | None
    parts: dict[FigureName, Part]


class Catalogue(Message):
    """The hashes of the casts that may be wanted, the likely ones first."""

    casts: Annotated[tuple[Hash, ...], Field(max_length=1000, strict=False)]


FigureState = Literal[
    "alone",
    "idle",
    "fetching",
    "verifying",
    "synchronising",
    "ready",
    "arming",
    "armed",
    "playing",
    "freewheeling",
    "holding",
    "stopping",
    "stopped",
    "ended",
    "out",
]
"""`alone`: no conductor. `holding`: the conductor was lost for longer than the freewheel.
`stopped`: its run is over before its end. `out`: it cannot play this cast, and says why."""


class Status(Message):
    """State of one figure."""

    protocol: int = PROTOCOL
    figure: FigureName
    instance: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    version: Annotated[str, Field(max_length=32)]
    state: FigureState
    epoch: Annotated[int, Field(ge=0)]
    """The highest epoch that it has followed."""
    follows: Annotated[str, Field(pattern=r"^([0-9a-f]{16})?$")] = ""
    """The `instance` of its conductor."""
    run: Annotated[int, Field(ge=0)]
    cast: Hash | None = None
    leg: Annotated[int, Field(ge=0)] = 0
    """The number of the leg that it follows."""
    robot: Hash
    offset_ns: int | None = None
    bound_ns: int | None = None
    round_trip_ns: int | None = None
    show_s: float | None = None
    off_s: float | None = None
    """How far its show is from the leg, while that runs."""
    stands: bool = False
    """Whether its robot stands at `show_s`."""
    hottest_c: float | None = None
    late_us: int | None = None
    """The worst lateness of a move in this show."""
    cause: Annotated[str, Field(max_length=32)] = ""
    """Kind of the fault that ended its player (`robot.on_fault.Cause`), or `error`; empty: none."""
    text: Note = ""
    """The last thing a person should know."""


class Examine(Operation):
    """Let all figures examine their computers and servos (`doctor --stage`)."""

    op: Literal["examine"] = "examine"


Asked = Annotated[m.Go | m.Stop | s.Cue | s.Trigger | Examine, Field(discriminator="op")]


class Ask(Message):
    """A figure's wish to the conductor."""

    operation: Asked
    number: Annotated[int, Field(ge=0)]
    """Counts the wishes of this figure's process: a repeated one is the same."""
    instance: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class Finding(Message):
    """One thing that a figure found about its computer or its servos."""

    level: Annotated[str, Field(max_length=16)]
    subject: Annotated[str, Field(max_length=64)]
    text: Note


class Findings(Message):
    """What a figure found."""

    figure: FigureName
    number: Annotated[int, Field(ge=0)]
    findings: Annotated[tuple[Finding, ...], Field(max_length=40, strict=False)]


class Examined(Message):
    """What was found about one figure, for `doctor --stage` while the conductor is served."""

    figure: FigureName
    asked: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    """The `instance` of the question."""
    rows: Annotated[tuple[Finding, ...], Field(max_length=60, strict=False)]


class ClockQuestion(Message):
    """The first half of an exchange (`clocks.Exchange`)."""

    asked_ns: Instant


class ClockAnswer(Message):
    """The second half."""

    asked_ns: Instant
    received_ns: Instant
    answered_ns: Instant
    instance: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
    """The conductor whose clock it is."""


M = TypeVar("M", bound=Message)


def parse(kind: type[M], content: bytes, max_bytes: int = MESSAGE_MAX_BYTES) -> M:
    """Return a message that arrived; raises `InputError` for anything else."""
    if len(content) > max_bytes:
        raise InputError(f"a message of {len(content)} bytes; at most {max_bytes} are read")
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"{kind.__name__} {place}: {first['msg']}") from None


def other_protocol(content: bytes) -> int | None:
    """Return the protocol of a `Beat` or `Status` of another version, which `parse` cannot read."""
    try:
        protocol = json.loads(content[:MESSAGE_MAX_BYTES])["protocol"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return protocol if isinstance(protocol, int) and protocol != PROTOCOL else None


def packed(message: Message) -> bytes:
    """Return the JSON of a message."""
    return message.model_dump_json(exclude_defaults=False).encode()
