"""What conductor and figures send each other: values, and their JSON.

Every message holds a whole state, not a change of one: whichever of them arrives, in whatever order
and however often, the newest is enough. So nothing is acknowledged and nothing is sent again.

| key (below the name of the stage)  | message           | from, and how often                     |
|------------------------------------|-------------------|-----------------------------------------|
| `beat`                             | `ConductorBeat`   | conductor, 10 Hz, and on every change   |
| `stop`                             | `StopAll`         | conductor, repeated                     |
| `figure/NAME/status`               | `FigureStatus`    | figure, 5 Hz, and on every change       |
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

import msgspec
from msgspec import Meta

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.message import Message, Operation, reason

PROTOCOL: Final = 4
"""Conductor and figures must have the same."""
MESSAGE_MAX_BYTES: Final = 16 * 1024
"""A longer message is none of ours; the longest, a `FigureStatus` with texts, has about 1 kB."""
CAST_MAX_BYTES: Final = 1 << 20
TEXT_MAX_CHARS: Final = 400
EPOCHS_AHEAD: Final = 100_000
"""An epoch that is further ahead of the known one is none: every start of a conductor counts one,
and this is one every five minutes for a year."""
NAME_PATTERN: Final = r"^[A-Za-z][A-Za-z0-9_-]{0,31}$(?!\n)"
"""Names of stages and figures stand in keys and certificates."""

Hash = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$(?!\n)")]
Instance = Annotated[str, Meta(pattern=r"^[0-9a-f]{16}$(?!\n)")]
"""Of a process, made at its start. Python's `$` would let a line end pass."""
FigureName = Annotated[str, Meta(pattern=NAME_PATTERN)]
Note = Annotated[str, Meta(max_length=TEXT_MAX_CHARS)]
Instant = Annotated[int, Meta(ge=-(1 << 62), le=1 << 62)]


def hash_of(content: bytes) -> str:
    """Return the hash by which content is stored, asked for and checked."""
    return hashlib.sha256(content).hexdigest()


class NetworkLeg(Message, frozen=True, kw_only=True):
    """At the conductor's instant `instant_ns` the show is at `show_s`, and goes on at `rate`.

    `number` counts the legs of a run. Rate 0 stands.
    """

    number: Annotated[int, Meta(ge=1)]
    instant_ns: Instant
    show_s: Annotated[float, Meta(ge=-3600.0, le=1e7)]
    rate: Annotated[float, Meta(ge=0.0, le=1.1)]

    def at_s(self, conductor_ns: int) -> float:
        """Return the show time at an instant of the conductor."""
        return self.show_s + self.rate * (conductor_ns - self.instant_ns) / 1_000_000_000


Wanted = Literal["nothing", "ready", "armed", "stopped"]
"""What the conductor wants of all figures: nothing; plan and clock ready; the robot at the start of
the show; brake, hold and end."""


class ConductorBeat(Message, frozen=True, kw_only=True):
    """State of the conductor.

    `epoch` is higher than that of every conductor before it, `instance` differs between two
    processes, and `run` counts what was begun: a figure stops once for each run.
    """

    protocol: int = PROTOCOL
    conductor: FigureName
    epoch: Annotated[int, Meta(ge=1)]
    instance: Instance
    count: Annotated[int, Meta(ge=0)]
    wanted: Wanted = "nothing"
    run: Annotated[int, Meta(ge=0)] = 0
    cast: Hash | None = None
    catalogue: Hash | None = None
    """What may be wanted later: figures fetch and verify it before (`Catalogue`)."""
    leg: NetworkLeg | None = None
    start_s: Annotated[float, Meta(ge=0.0, le=1e7)] = 0.0
    """Show time at which the robots stand while they are armed."""
    examines: Annotated[int, Meta(ge=0)] = 0
    """Each figure without a player examines its computer and servos once for every number."""


class StopAll(Message, frozen=True, kw_only=True):
    """Brake, hold and end, whatever plays of this run. Repeated, and as good as once."""

    conductor: FigureName
    epoch: Annotated[int, Meta(ge=1)]
    instance: Instance
    run: Annotated[int, Meta(ge=0)]


class Part(Message, frozen=True, kw_only=True):
    """What one figure plays: the hashes of its plan and of the robot that it was made for."""

    plan: Hash
    robot: Hash


class Cast(Message, frozen=True, kw_only=True):
    """A show and what each figure plays in it."""

    show: Annotated[str, Meta(min_length=1, max_length=64)]
    duration_s: Annotated[float, Meta(ge=0.0)] | None
    parts: dict[FigureName, Part]


class Catalogue(Message, frozen=True, kw_only=True):
    """The hashes of the casts that may be wanted, the likely ones first."""

    casts: Annotated[tuple[Hash, ...], Meta(max_length=1000)]


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


class FigureStatus(Message, frozen=True, kw_only=True):
    """State of one figure."""

    protocol: int = PROTOCOL
    figure: FigureName
    instance: Instance
    version: Annotated[str, Meta(max_length=32)]
    state: FigureState
    epoch: Annotated[int, Meta(ge=0)]
    """The highest epoch that it has followed."""
    follows: Annotated[str, Meta(pattern=r"^([0-9a-f]{16})?$(?!\n)")] = ""
    """The `instance` of its conductor."""
    run: Annotated[int, Meta(ge=0)]
    cast: Hash | None = None
    leg: Annotated[int, Meta(ge=0)] = 0
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
    cause: Annotated[str, Meta(max_length=32)] = ""
    """Kind of the fault that ended its player (`robot.on_fault.Cause`), or `error`; empty: none."""
    text: Note = ""
    """The last thing a person should know."""


class Examine(Operation, frozen=True, kw_only=True, tag="examine"):
    """Let all figures examine their computers and servos (`doctor --stage`)."""


Asked = m.Go | m.Stop | s.FireCue | s.Trigger | Examine


class Ask(Message, frozen=True, kw_only=True):
    """A figure's wish to the conductor."""

    operation: Asked
    number: Annotated[int, Meta(ge=0)]
    """Counts the wishes of this figure's process: a repeated one is the same."""
    instance: Instance


class FigureFinding(Message, frozen=True, kw_only=True):
    """One thing that a figure found about its computer or its servos."""

    level: Annotated[str, Meta(max_length=16)]
    subject: Annotated[str, Meta(max_length=64)]
    text: Note


class Findings(Message, frozen=True, kw_only=True):
    """What a figure found."""

    figure: FigureName
    number: Annotated[int, Meta(ge=0)]
    findings: Annotated[tuple[FigureFinding, ...], Meta(max_length=40)]


class Examined(Message, frozen=True, kw_only=True):
    """What was found about one figure, for `doctor --stage` while the conductor is served."""

    figure: FigureName
    asked: Instance
    """The `instance` of the question."""
    rows: Annotated[tuple[FigureFinding, ...], Meta(max_length=60)]


class ClockQuestion(Message, frozen=True, kw_only=True):
    """The first half of an exchange (`clocks.Exchange`)."""

    asked_ns: Instant


class ClockAnswer(Message, frozen=True, kw_only=True):
    """The second half."""

    asked_ns: Instant
    received_ns: Instant
    answered_ns: Instant
    instance: Instance
    """The conductor whose clock it is."""


M = TypeVar("M", bound=Message)


def parse(kind: type[M], content: bytes, max_bytes: int = MESSAGE_MAX_BYTES) -> M:
    """Return a message that arrived; raises `InputError` for anything else."""
    if len(content) > max_bytes:
        raise InputError(f"a message of {len(content)} bytes; at most {max_bytes} are read")
    try:
        return msgspec.json.decode(content, type=kind)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise InputError(f"{kind.__name__} {reason(error)}") from None


def other_protocol(content: bytes) -> int | None:
    """Return the protocol of a beat or status of another version, which `parse` cannot read."""
    try:
        protocol = json.loads(content[:MESSAGE_MAX_BYTES])["protocol"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return protocol if isinstance(protocol, int) and protocol != PROTOCOL else None


def packed(message: Message) -> bytes:
    """Return the JSON of a message."""
    return message.to_json()
