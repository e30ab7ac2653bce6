"""The one schema of whoever steers a show: operations and events.

An operation is a wish of a client, an event is what happened, and both are JSON objects whose key
`op` or `event` says which. `schema` returns their JSON Schema. Telemetry is binary
(`message.Telemetry`). Angles are joint degrees, times seconds of show time.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, get_args

import msgspec
from msgspec import Meta

from lss_motion.errors import InputError
from lss_motion.playing.remote import edit_messages as edit
from lss_motion.playing.remote import message as base
from lss_motion.playing.remote import stage_messages as stage
from lss_motion.playing.remote.message import LAYOUT

OPERATION_MAX_BYTES: Final = 4096
"""A longer operation is refused before it is parsed. Ours have less than 200."""
EDIT_MAX_BYTES: Final = 262_144
"""The same of who may edit: 5000 keys of a selection, or the text of a long show."""
PATH_MAX_CHARS: Final = 1000
JOINTS_MAX: Final = 100
TURN_MAX_DEG: Final = 36_000.0
"""A hundred turns, as in robot files."""
WALK_MAX: Final = 10_000.0
"""Of mm/s and deg/s, as the options of `walk`."""
NAME_PATTERN: Final = r"^[A-Za-z][A-Za-z0-9_-]*$(?!\n)"
"""Python's `$` would let a line end pass."""
RATE_LEAST: Final = 0.05
"""The lowest rate that can be asked for; `pause` is lower."""

LABEL_MAX_CHARS: Final = base.LABEL_MAX_CHARS
SONG_MAX_CHARS: Final = 255
"""As of FPP MultiSync."""
Name = base.Name
Message = base.Message
Operation = base.Operation
Event = base.Event
RoleName = Literal["view", "operate", "edit"]
FileKind = Literal["sequence", "gait", "playlist", "robot", "stage", "folder"]


class Go(Operation, frozen=True, kw_only=True, tag="go"):
    """Begin to move, where the player waits for that after its checks."""


class Pause(Operation, frozen=True, kw_only=True, tag="pause"):
    """Brake within the limits, on the path, and stand there."""


class Resume(Operation, frozen=True, kw_only=True, tag="resume"):
    """Go on at the rate that was asked for last."""


class Rate(Operation, frozen=True, kw_only=True, tag="rate"):
    """Play at this share of the speed of the plan; the change is a ramp."""

    ratio: Annotated[float, Meta(ge=RATE_LEAST, le=1.0)]


class TakeEdit(Operation, frozen=True, kw_only=True, tag="splice"):
    """Go on with the edited show `plan` while the show plays; refused with the reason if it cannot.

    From an instant on at which both plans meet, the moves are those of the edited show.
    """

    plan: Annotated[str, Meta(max_length=LABEL_MAX_CHARS)]


class Seek(Operation, frozen=True, kw_only=True, tag="seek"):
    """Brake, move to where the show is at `to` (a show time or a label), and go on from there.

    A paused show stands there until it is resumed.
    """

    to: (
        Annotated[float, Meta(ge=0.0)]
        | Annotated[str, Meta(min_length=1, max_length=LABEL_MAX_CHARS)]
    )


class Follow(Operation, frozen=True, kw_only=True, tag="follow"):
    """The leader is at `show_s` at `instant_ns`, and goes on at `rate`; at 0 it stands.

    The instant is one of the monotonic clock of the player's computer. One that is to come is a
    start at that instant. The show trims its clock, or rejoins its leader; without these
    operations for some time it goes on alone or holds, as it was started. Without an answer.
    """

    instant_ns: Annotated[int, Meta(ge=0)]
    show_s: Annotated[float, Meta(ge=-86400.0, le=86400.0)]
    rate: Annotated[float, Meta(ge=0.0, le=2.0)]
    source: Annotated[str, Meta(max_length=LABEL_MAX_CHARS)] = ""
    state: Annotated[str, Meta(max_length=LABEL_MAX_CHARS)] = ""
    """What the leader does, for a person."""
    song: Annotated[str, Meta(max_length=SONG_MAX_CHARS)] = ""
    """What the leader plays, where it says so."""


class Stop(Operation, frozen=True, kw_only=True, tag="stop"):
    """Brake within the limits, hold, give the settings back and end. Twice is the same as once."""


class Estop(Operation, frozen=True, kw_only=True, tag="estop"):
    """Send the safe bytes at once and end. The power of the servos stays on."""


class Beat(Operation, frozen=True, kw_only=True, tag="beat"):
    """The client is alive. The player watches this where it was started with `silent_s`."""


class Play(Operation, frozen=True, kw_only=True, tag="play"):
    """Start the show that the server has planned, from `from_s` on.

    With `plan`, only that plan: it may have changed since the client saw it.
    """

    from_s: Annotated[float, Meta(ge=0.0)] | None = None
    plan: Annotated[str, Meta(pattern="^[0-9a-f]{16}$")] | None = None


class Rearm(Operation, frozen=True, kw_only=True, tag="rearm"):
    """Allow motion again after a stop. A stop is kept until then, whoever asks to play."""


class Lease(Operation, frozen=True, kw_only=True, tag="lease"):
    """Take the right to operate, also from another client, or give it back."""

    want: Literal["take", "release"]


class Load(Operation, frozen=True, kw_only=True, tag="load"):
    """Open another file of the folder of the show."""

    path: Annotated[str, Meta(min_length=1, max_length=PATH_MAX_CHARS)]


class Pair(Operation, frozen=True, kw_only=True, tag="pair"):
    """Make a code with which one more client gets this role."""

    role: RoleName


class Connect(Operation, frozen=True, kw_only=True, tag="connect"):
    """Open the ports of the robot without a show, and check every servo; nothing moves."""


class Disconnect(Operation, frozen=True, kw_only=True, tag="disconnect"):
    """End what `connect` began: hold, give the settings back, close the ports."""


class Jog(Operation, frozen=True, kw_only=True, tag="jog"):
    """Turn a joint at this share of its jogging speed; repeat it every 100 ms, or it stops.

    0 stops it at once. The joint stays within its limits. With `to_deg` it turns there, whatever
    the sign of the speed, and not beyond.
    """

    joint: Name
    speed_ratio: Annotated[float, Meta(ge=-1.0, le=1.0)]
    to_deg: Annotated[float, Meta(ge=-TURN_MAX_DEG, le=TURN_MAX_DEG)] | None = None


class Puppeteer(Operation, frozen=True, kw_only=True, tag="puppeteer"):
    """Let the joints of a connected robot follow `target`, from where they are, until `disconnect`.

    Those that are limp stay so, but for `joints`, which get power where they are.
    """

    joints: Annotated[tuple[Name, ...], Meta(max_length=JOINTS_MAX)] = ()


class LeadJoints(Operation, frozen=True, kw_only=True, tag="target"):
    """Lead joints to these angles, within their limits; the newest of each joint counts.

    It is for a player that was started to follow targets. Repeat it: without one for a while, by
    default 200 ms, all joints brake and hold. Without an answer, unless it is refused.
    """

    deg: Annotated[
        dict[Name, Annotated[float, Meta(ge=-TURN_MAX_DEG, le=TURN_MAX_DEG)]],
        Meta(min_length=1, max_length=JOINTS_MAX),
    ]


class SteerWalk(Operation, frozen=True, kw_only=True, tag="walk.steer"):
    """Walk at this velocity of the body from the next steps on, each part within the largest one.

    It is for a player that was started to walk. Without an answer, unless it is refused.
    """

    forward_mm_s: Annotated[float, Meta(ge=-WALK_MAX, le=WALK_MAX)] = 0.0
    left_mm_s: Annotated[float, Meta(ge=-WALK_MAX, le=WALK_MAX)] = 0.0
    turn_deg_s: Annotated[float, Meta(ge=-WALK_MAX, le=WALK_MAX)] = 0.0


class PoseGo(Operation, frozen=True, kw_only=True, tag="pose.go"):
    """Move to a pose of the robot file, in `duration_s` or longer where a limit requires it."""

    pose: Name
    duration_s: Annotated[float, Meta(gt=0.0, le=60.0)] | None = None


class PoseSave(Operation, frozen=True, kw_only=True, tag="pose.save"):
    """Write where the joints are into the robot file: a new pose, or one that it has."""

    pose: Annotated[str, Meta(pattern=NAME_PATTERN, max_length=LABEL_MAX_CHARS)]
    is_new: bool


class Limp(Operation, frozen=True, kw_only=True, tag="limp"):
    """Take the power from these joints, or from all: they fall."""

    joints: Annotated[tuple[Name, ...], Meta(max_length=JOINTS_MAX)] = ()


class Hold(Operation, frozen=True, kw_only=True, tag="hold"):
    """Hold these joints, or all, where they are."""

    joints: Annotated[tuple[Name, ...], Meta(max_length=JOINTS_MAX)] = ()


class Scan(Operation, frozen=True, kw_only=True, tag="scan"):
    """Find the servos of each bus of the robot; nothing moves."""


MaintenanceTask = Literal["calibrate", "identify"]


class Maintain(Operation, frozen=True, kw_only=True, tag="maintenance"):
    """Calibrate or identify a joint of a connected robot; events `maintenance` lead through it."""

    what: MaintenanceTask
    joint: Name


class MaintenanceAnswer(Operation, frozen=True, kw_only=True, tag="maintenance.answer"):
    """Answer the question of the last event `maintenance`, with one of its answers."""

    answer: Annotated[str, Meta(min_length=1, max_length=LABEL_MAX_CHARS)]


ShowOperation = Go | Pause | Resume | Rate | Seek
"""What steers a running show."""
RobotOperation = Jog | PoseGo | PoseSave | Limp | Hold | Maintain | MaintenanceAnswer | Disconnect
"""What is asked of a robot without a show."""
AnyOperation = (
    Go
    | Pause
    | Resume
    | Rate
    | Seek
    | TakeEdit
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
    | Puppeteer
    | LeadJoints
    | SteerWalk
    | PoseGo
    | PoseSave
    | Limp
    | Hold
    | Scan
    | Maintain
    | MaintenanceAnswer
    | stage.Trigger
    | stage.FireCue
    | stage.Enable
    | stage.Arm
    | stage.StagePlay
    | stage.StageStop
    | stage.StageRest
    | stage.StageWake
    | stage.Change
    | stage.EndAdded
    | edit.AnyEdit
)


class MarkInfo(Message, frozen=True, kw_only=True):
    """A named keyframe of the show, and when the first pass reaches it."""

    label: str
    at_s: float


class Started(Event, frozen=True, kw_only=True, tag="started"):
    """The first event: what is played. `duration_s` is None for a show without end."""

    name: str
    robot: str
    is_simulated: bool
    duration_s: float | None
    plan: str
    """Hash of the program, as in the telemetry."""
    joints: tuple[str, ...]
    """The joints in the order of the telemetry."""
    marks: tuple[MarkInfo, ...]


class PhaseChanged(Event, frozen=True, kw_only=True, tag="phase"):
    """The player has entered a phase, by the names of `playing.player.events.Phase`."""

    phase: str


class ServosChecked(Event, frozen=True, kw_only=True, tag="checked"):
    """Every servo is there and may do what the program requires."""

    servos: int
    notes: tuple[str, ...]


class WarningRaised(Event, frozen=True, kw_only=True, tag="warned"):
    """Something that a person should know and that stops nothing."""

    text: str


class LabelPassed(Event, frozen=True, kw_only=True, tag="mark"):
    """The show has reached a named keyframe."""

    label: str
    at_s: float


class CueFired(Event, frozen=True, kw_only=True, tag="cue"):
    """The show has reached a sound, a light, a function or a line to say."""

    kind: Literal["sound", "run", "led", "say"]
    text: str
    at_s: float


class WaitChanged(Event, frozen=True, kw_only=True, tag="waited"):
    """The show waits for a sensor (`begun`), or goes on."""

    text: str
    state: Literal["begun", "met", "timeout"]


class FaultFound(Event, frozen=True, kw_only=True, tag="fault"):
    """A fault, and the step of `on_fault` that was taken about it."""

    joint: str
    cause: str
    kind: str
    step: str


class ShowStarted(Event, frozen=True, kw_only=True, tag="show_started"):
    """A show of a stage has begun at `from_s`, beside another one if it `is_added`."""

    name: str
    from_s: float
    is_added: bool


class ShowEnded(Event, frozen=True, kw_only=True, tag="show_ended"):
    """A show of a stage is over, or was left for another one at `reached_s`."""

    name: str
    outcome: Literal["finished", "left", "stopped", "fault"]
    is_added: bool
    reached_s: float
    lasted_s: float
    missed: int
    error_max_deg: float


class RateChanged(Event, frozen=True, kw_only=True, tag="rate"):
    """A client changed the rate, paused, or resumed."""

    ratio: float
    is_paused: bool


class Accepted(Event, frozen=True, kw_only=True, tag="accepted"):
    """The operation `id` of this client has been carried out, or has begun."""

    id: int
    op: str


class Refused(Event, frozen=True, kw_only=True, tag="refused"):
    """The operation `id` of this client has no effect; `text` says why, and what to do."""

    id: int
    text: str


class Lost(Event, frozen=True, kw_only=True, tag="lost"):
    """So many events found no room, since the client did not read."""

    count: int


class JointHealth(Message, frozen=True, kw_only=True):
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


class BusHealth(Message, frozen=True, kw_only=True):
    """How much of a line the last period used."""

    use_ratio: float
    replies_hz: float


class Health(Event, frozen=True, kw_only=True, tag="health"):
    """State of robot and lines, a few times a second. Dropped where the client does not read."""

    phase: str
    show_s: float | None
    rate: float
    is_paused: bool
    late_us: int
    missed: int
    joints: dict[str, JointHealth]
    buses: dict[str, BusHealth]


class Ended(Event, frozen=True, kw_only=True, tag="ended"):
    """The last event. `outcome` and `report` are those of `lss-play --report`."""

    outcome: str
    error: str | None
    """Why the run could not begin or go on."""
    report: dict[str, Any] | None
    exit_code: int | None = None
    """Of the error, by the codes of `lss-play`."""


class Welcome(Event, frozen=True, kw_only=True, tag="welcome"):
    """The first event of a server: what this client may do, and where a stop goes besides."""

    client: int
    role: RoleName
    stop_origin: str
    version: str
    file: str
    kind: FileKind
    title: str
    is_network_readable: bool
    """Whether others on the network can read along: the server listens there without TLS."""


class LeaseChanged(Event, frozen=True, kw_only=True, tag="lease"):
    """Which client operates. The others may look, and stop."""

    holder: int | None
    holder_name: str | None
    is_mine: bool


class Problem(Message, frozen=True, kw_only=True):
    """What is wrong in a file, and where."""

    path: str
    line: int | None
    text: str


class DocumentChanged(Event, frozen=True, kw_only=True, tag="document"):
    """State of the file: its revision, what is wrong in it, and the last plan that is good."""

    revision: int
    file: str
    kind: FileKind
    title: str
    is_planning: bool
    planning_s: float
    """How long the planner has worked on this revision; 0 when it has answered."""
    errors: tuple[Problem, ...]
    notes: tuple[str, ...]
    plan: str | None
    is_current: bool
    """Whether `plan` is that of this revision."""
    has_planner: bool
    """Whether the planner lives: it has ended while it worked on this revision otherwise."""
    summary: tuple[str, ...]
    robot: int
    """Changes when `robot.json` does."""
    editing: edit.Editing


class LiveJoint(Message, frozen=True, kw_only=True):
    """A joint of a robot that plays no show: where it is, and whether it is limp."""

    deg: float | None
    is_limp: bool


class RobotChanged(Event, frozen=True, kw_only=True, tag="robot"):
    """State of the robot without a show."""

    state: Literal["off", "connecting", "live", "playing"]
    port: str
    is_simulated: bool
    joints: dict[str, LiveJoint]
    text: str


class PlayerChanged(Event, frozen=True, kw_only=True, tag="player"):
    """State of the process that plays. `latch`: the stop that is kept until `rearm`."""

    state: Literal["idle", "starting", "ready", "playing", "paused", "stopping", "ended", "gone"]
    latch: Literal["stop", "estop"] | None
    plan: str | None
    show_s: float | None
    text: str


class Links(Event, frozen=True, kw_only=True, tag="links"):
    """How many clients the server has."""

    clients: int


class Heartbeat(Event, frozen=True, kw_only=True, tag="heartbeat"):
    """Once a second; a client that gets none has lost its server."""

    server_s: float


class PairingCode(Event, frozen=True, kw_only=True, tag="pairing"):
    """The answer to `pair`: a code of six digits, for one client, for so long."""

    code: str
    role: RoleName
    valid_s: float
    urls: tuple[str, ...]


class FoundServo(Message, frozen=True, kw_only=True):
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


class Scanned(Event, frozen=True, kw_only=True, tag="scan"):
    """What `scan` found, and what a person should mend."""

    servos: tuple[FoundServo, ...]
    problems: tuple[str, ...]


class Question(Message, frozen=True, kw_only=True):
    """What a person has to decide, and the answers that are possible."""

    text: str
    answers: tuple[str, ...]


class PlotSeries(Message, frozen=True, kw_only=True):
    """Points of one line of a plot."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


class Plot(Message, frozen=True, kw_only=True):
    """Lines over one axis."""

    title: str
    x_name: str
    y_name: str
    series: tuple[PlotSeries, ...]


class MaintenanceResult(Message, frozen=True, kw_only=True):
    """What was found, before it is written."""

    lines: tuple[str, ...]
    plots: tuple[Plot, ...] = ()


MaintenanceState = Literal["asking", "running", "done", "failed", "stopped"]


class MaintenanceChanged(Event, frozen=True, kw_only=True, tag="maintenance"):
    """What happens in a calibration or identification, and what a person has to do."""

    what: MaintenanceTask
    joint: str
    state: MaintenanceState
    step: str
    progress: float | None = None
    question: Question | None = None
    result: MaintenanceResult | None = None


AnyEvent = (
    Started
    | PhaseChanged
    | ServosChecked
    | WarningRaised
    | LabelPassed
    | CueFired
    | WaitChanged
    | FaultFound
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
    | PairingCode
    | Scanned
    | MaintenanceChanged
    | stage.StageState
    | stage.StageNote
    | edit.Tried
)

_OPERATIONS: Final[msgspec.json.Decoder[AnyOperation]] = msgspec.json.Decoder(AnyOperation)
_OPS: Final = tuple(str(one.__struct_config__.tag) for one in get_args(AnyOperation))
_EVENTS: Final[msgspec.json.Decoder[AnyEvent]] = msgspec.json.Decoder(AnyEvent)


def schema() -> dict[str, Any]:
    """Return the JSON Schema of operations and events, and the layout of the telemetry."""
    (operations, events), shared = base.json_schemas(AnyOperation, AnyEvent)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "remote control of a show",
        "$defs": {**shared, "Operation": operations, "Event": events},
        "anyOf": [{"$ref": "#/$defs/Operation"}, {"$ref": "#/$defs/Event"}],
        "x-telemetry": LAYOUT,
    }


def parse_operation(text: bytes | str, max_bytes: int = OPERATION_MAX_BYTES) -> AnyOperation:
    """Return the operation of a JSON text; raises `InputError` that says what is allowed."""
    if len(text) > max_bytes:
        raise InputError(f"an operation has at most {max_bytes} bytes")
    try:
        return _OPERATIONS.decode(text)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        why = base.reason(error)
        known = f"; there are {', '.join(_OPS)}" if why.startswith("op: Invalid value") else ""
        raise InputError(f"operation {why}{known}") from None


def parse_event(text: bytes | str) -> AnyEvent:
    """Return the event of a JSON text that this package wrote."""
    return _EVENTS.decode(text)
