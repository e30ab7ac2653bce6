"""The one schema of whoever steers a show: operations and events.

An operation is a wish of a client, an event is what happened, and both are JSON objects whose key
`op` or `event` says which. `schema` returns their JSON Schema. Telemetry is binary
(`telemetry`). Angles are joint degrees, times seconds of show time.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import Field, TypeAdapter, ValidationError

from lss_motion.errors import InputError
from lss_motion.playing.remote import message as base
from lss_motion.playing.remote import stage_messages as stage
from lss_motion.playing.remote.telemetry import LAYOUT

OPERATION_MAX_BYTES: Final = 4096
"""A longer operation is refused before it is parsed. Ours have less than 200."""
PATH_MAX_CHARS: Final = 1000
JOINTS_MAX: Final = 100
RATE_LEAST: Final = 0.05
"""The lowest rate that can be asked for; `pause` is lower."""

LABEL_MAX_CHARS: Final = base.LABEL_MAX_CHARS
Name = base.Name
Message = base.Message
Operation = base.Operation
RoleName = Literal["view", "operate", "edit"]
FileKind = Literal["sequence", "gait", "playlist", "robot", "stage"]


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


class Follow(Operation):
    """The leader is at `show_s` at `instant_ns`, and goes on at `rate`; at 0 it stands.

    The instant is one of the monotonic clock of the player's computer. One that is to come is a
    start at that instant. The show trims its clock, or rejoins its leader; without these
    operations for some time it goes on alone or holds, as it was started. Without an answer.
    """

    op: Literal["follow"] = "follow"
    instant_ns: Annotated[int, Field(ge=0)]
    show_s: Annotated[float, Field(ge=-86400.0, le=86400.0)]
    rate: Annotated[float, Field(ge=0.0, le=2.0)]
    source: Annotated[str, Field(max_length=LABEL_MAX_CHARS)] = ""
    state: Annotated[str, Field(max_length=LABEL_MAX_CHARS)] = ""
    """What the leader does, for a person."""


class Stop(Operation):
    """Brake within the limits, hold, give the settings back and end. Twice is the same as once."""

    op: Literal["stop"] = "stop"


class Estop(Operation):
    """Send the safe bytes at once and end. The power of the servos stays on."""

    op: Literal["estop"] = "estop"


class Beat(Operation):
    """The client is alive. The player watches this where it was started with `silent_s`."""

    op: Literal["beat"] = "beat"


class Play(Operation):
    """Start the show that the server has planned, from `from_s` on.

    With `plan`, only that plan: it may have changed since the client saw it.
    """

    op: Literal["play"] = "play"
    from_s: Annotated[float, Field(ge=0.0)] | None = None
    plan: Annotated[str, Field(pattern="^[0-9a-f]{16}$")] | None = None


class Rearm(Operation):
    """Allow motion again after a stop. A stop is kept until then, whoever asks to play."""

    op: Literal["rearm"] = "rearm"


class Lease(Operation):
    """Take the right to operate, also from another client, or give it back."""

    op: Literal["lease"] = "lease"
    want: Literal["take", "release"]


class Load(Operation):
    """Open another file of the folder of the show."""

    op: Literal["load"] = "load"
    path: Annotated[str, Field(min_length=1, max_length=PATH_MAX_CHARS)]


class Pair(Operation):
    """Make a code with which one more client gets this role."""

    op: Literal["pair"] = "pair"
    role: RoleName


class Connect(Operation):
    """Open the ports of the robot without a show, and check every servo; nothing moves."""

    op: Literal["connect"] = "connect"


class Disconnect(Operation):
    """End what `connect` began: hold, give the settings back, close the ports."""

    op: Literal["disconnect"] = "disconnect"


class Jog(Operation):
    """Turn a joint at this share of its jogging speed; repeat it every 100 ms, or it stops.

    0 stops it at once. The joint stays within its limits.
    """

    op: Literal["jog"] = "jog"
    joint: Name
    speed_ratio: Annotated[float, Field(ge=-1.0, le=1.0)]


class PoseGo(Operation):
    """Move to a pose of the robot file, in `duration_s` or longer where a limit requires it."""

    op: Literal["pose.go"] = "pose.go"
    pose: Name
    duration_s: Annotated[float, Field(gt=0.0, le=60.0)] | None = None


class PoseSave(Operation):
    """Write where the joints are into the robot file: a new pose, or one that it has."""

    op: Literal["pose.save"] = "pose.save"
    pose: Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_-]*$", max_length=LABEL_MAX_CHARS)]
    is_new: bool


class Limp(Operation):
    """Take the power from these joints, or from all: they fall."""

    op: Literal["limp"] = "limp"
    joints: Annotated[tuple[Name, ...], Field(max_length=JOINTS_MAX, strict=False)] = ()


class Hold(Operation):
    """Hold these joints, or all, where they are."""

    op: Literal["hold"] = "hold"
    joints: Annotated[tuple[Name, ...], Field(max_length=JOINTS_MAX, strict=False)] = ()


class Scan(Operation):
    """Find the servos of each bus of the robot; nothing moves."""

    op: Literal["scan"] = "scan"


MaintenanceTask = Literal["calibrate", "identify"]


class Maintain(Operation):
    """Calibrate or identify a joint of a connected robot; events `maintenance` lead through it."""

    op: Literal["maintenance"] = "maintenance"
    what: MaintenanceTask
    joint: Name


class MaintenanceAnswer(Operation):
    """Answer the question of the last event `maintenance`, with one of its answers."""

    op: Literal["maintenance.answer"] = "maintenance.answer"
    answer: Annotated[str, Field(min_length=1, max_length=LABEL_MAX_CHARS)]


ShowOperation = Go | Pause | Resume | Rate | Seek
"""What steers a running show."""
RobotOperation = Jog | PoseGo | PoseSave | Limp | Hold | Maintain | MaintenanceAnswer | Disconnect
"""What is asked of a robot without a show."""
AnyOperation = Annotated[
    Go
    | Pause
    | Resume
    | Rate
    | Seek
    | Follow
    | Stop
    | Estop
    | Beat
    | Play
    | Rearm
    | Lease
    | Load
    | Pair
    | Connect
    | Disconnect
    | Jog
    | PoseGo
    | PoseSave
    | Limp
    | Hold
    | Scan
    | Maintain
    | MaintenanceAnswer
    | stage.Trigger
    | stage.Cue
    | stage.Enable
    | stage.Arm
    | stage.StagePlay
    | stage.StageStop
    | stage.StageRest
    | stage.StageWake
    | stage.Change
    | stage.EndAdded,
    Field(discriminator="op"),
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
    """The player has entered a phase, by the names of `playing.player.events.Phase`."""

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


class ShowStarted(Message):
    """A show of a stage has begun at `from_s`, beside another one if it `is_added`."""

    event: Literal["show_started"] = "show_started"
    name: str
    from_s: float
    is_added: bool


class ShowEnded(Message):
    """A show of a stage is over, or was left for another one at `reached_s`."""

    event: Literal["show_ended"] = "show_ended"
    name: str
    outcome: Literal["finished", "left", "stopped", "fault"]
    is_added: bool
    reached_s: float
    lasted_s: float
    missed: int
    error_max_deg: float


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
    exit_code: int | None = None
    """Of the error, by the codes of `lss-play`."""


class Welcome(Message):
    """The first event of a server: what this client may do, and where a stop goes besides."""

    event: Literal["welcome"] = "welcome"
    client: int
    role: RoleName
    stop_origin: str
    version: str
    file: str
    kind: FileKind
    title: str
    is_network_readable: bool
    """Whether others on the network can read along: the server listens there without TLS."""


class LeaseChanged(Message):
    """Which client operates. The others may look, and stop."""

    event: Literal["lease"] = "lease"
    holder: int | None
    holder_name: str | None
    is_mine: bool


class Problem(Message):
    """What is wrong in a file, and where."""

    path: str
    line: int | None
    text: str


class DocumentChanged(Message):
    """State of the file: its revision, what is wrong in it, and the last plan that is good."""

    event: Literal["document"] = "document"
    revision: int
    file: str
    kind: FileKind
    title: str
    is_planning: bool
    errors: tuple[Problem, ...]
    notes: tuple[str, ...]
    plan: str | None
    is_current: bool
    """Whether `plan` is that of this revision."""
    summary: tuple[str, ...]
    robot: int
    """Changes when `robot.json` does."""


class LiveJoint(Message):
    """A joint of a robot that plays no show: where it is, and whether it is limp."""

    deg: float | None
    is_limp: bool


class RobotChanged(Message):
    """State of the robot without a show."""

    event: Literal["robot"] = "robot"
    state: Literal["off", "connecting", "live", "playing"]
    port: str
    is_simulated: bool
    joints: dict[str, LiveJoint]
    text: str


class PlayerChanged(Message):
    """State of the process that plays. `is_latched`: stopped, until `rearm`."""

    event: Literal["player"] = "player"
    state: Literal["idle", "starting", "ready", "playing", "paused", "stopping", "ended", "gone"]
    is_latched: bool
    plan: str | None
    show_s: float | None
    text: str


class Links(Message):
    """How many clients the server has."""

    event: Literal["links"] = "links"
    clients: int


class Heartbeat(Message):
    """Once a second; a client that gets none has lost its server."""

    event: Literal["heartbeat"] = "heartbeat"
    server_s: float


class Pairing(Message):
    """The answer to `pair`: a code of six digits, for one client, for so long."""

    event: Literal["pairing"] = "pairing"
    code: str
    role: RoleName
    valid_s: float
    urls: tuple[str, ...]


class FoundServo(Message):
    """A servo that `scan` found, and what the robot file calls it."""

    bus: str
    id: int
    model: str
    joint: str | None
    firmware: int | None
    voltage_v: float | None
    temperature_c: float | None
    status: str | None
    is_shared: bool
    """Whether several servos answer to this id."""


class Scanned(Message):
    """What `scan` found, and what a person should mend."""

    event: Literal["scan"] = "scan"
    servos: tuple[FoundServo, ...]
    problems: tuple[str, ...]


class Question(Message):
    """What a person has to decide, and the answers that are possible."""

    text: str
    answers: tuple[str, ...]


class PlotSeries(Message):
    """Points of one line of a plot."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


class Plot(Message):
    """Lines over one axis."""

    title: str
    x_name: str
    y_name: str
    series: tuple[PlotSeries, ...]


class MaintenanceResult(Message):
    """What was found, before it is written."""

    lines: tuple[str, ...]
    plots: tuple[Plot, ...] = ()


MaintenanceState = Literal["asking", "running", "done", "failed", "stopped"]


class MaintenanceChanged(Message):
    """What happens in a calibration or identification, and what a person has to do."""

    event: Literal["maintenance"] = "maintenance"
    what: MaintenanceTask
    joint: str
    state: MaintenanceState
    step: str
    progress: float | None = None
    question: Question | None = None
    result: MaintenanceResult | None = None


AnyEvent = Annotated[
    Started
    | PhaseChanged
    | Checked
    | Warned
    | MarkPassed
    | CueReached
    | Waited
    | Faulted
    | ShowStarted
    | ShowEnded
    | RateChanged
    | Accepted
    | Refused
    | Lost
    | Health
    | Ended
    | Welcome
    | LeaseChanged
    | DocumentChanged
    | RobotChanged
    | PlayerChanged
    | Links
    | Heartbeat
    | Pairing
    | Scanned
    | MaintenanceChanged
    | stage.StageState
    | stage.StageNote,
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
        "x-telemetry": LAYOUT,
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
