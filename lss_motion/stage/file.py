"""The keys of a stage file: names, units, and bounds of each key alone.

`stage.load` checks what several keys mean together; a class of keys that it hands on as it is, is
also the value: `Sync`, `Budget`, `Retry`, `Alerts`, `Network`. The descriptions are the
reference of the file format.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from lss_motion.files.keys import (
    FILE_VERSION,
    VERSION,
    Check,
    Field,
    FileModel,
    Name,
    Text,
    Version,
    check_text,
)
from lss_motion.robot.on_fault import RESUMABLE, Cause
from lss_motion.show.file import FileName, Reading

StartMode = Literal["only_if_idle", "add", "interrupt", "terminate", "restart", "queue"]
Choice = Literal["in_turn", "random"]
Deed = Literal["stop", "rest", "wake"]

CUES_MAX: Final = 1000
"""Chosen: more than an operator can tell apart."""

SHOWS_MAX: Final = 500
"""Chosen: all of them are planned and kept in memory while the stage runs."""

SPAN_MAX_S: Final = 7 * 86_400.0
"""A week. A longer pause is a typing error."""

RETRIES_MAX: Final = 20
"""Chosen: more attempts after a fault are a loop of falls."""

ATTEMPTS: Final = dict.fromkeys(RESUMABLE, 3) | dict.fromkeys(
    (Cause.ASTRAY, Cause.STUCK, Cause.LOW_VOLTAGE), 1
)
"""Attempts after a fault, by kind; of others none. Chosen: what comes back by itself is tried three
times. A joint that went astray may have been held by a visitor, once."""

SpanS = Annotated[float, Field(ge=0.0, le=SPAN_MAX_S)]
Line = Annotated[str, Field(min_length=1, max_length=256), Check(check_text)]
Address = Annotated[
    str, Field(min_length=1, max_length=256, pattern=r"^/[^\s#*,?\[\]{}]*$"), Check(str)
]
Fps = Annotated[float, Field(ge=23.9, le=60.0)]
Timecode = Annotated[str, Field(pattern=r"^\d{2}:\d{2}:\d{2}[:;]\d{2}$")]
ClockSpan = Annotated[str, Field(pattern=r"^\d{2}:\d{2}-\d{2}:\d{2}$")]
HostPort = Annotated[str, Field(pattern=r"^(\[[0-9A-Fa-f:.]+\]|[^\s:\[\]]+):\d{1,5}$")]
Midi = Annotated[int, Field(ge=0, le=127)]


class OnEntry(FileModel, title="trigger"):
    """What fires a cue: one of these kinds, with the keys that belong to it."""

    sensor: Name | None = Field(
        default=None,
        description="Sensor of the robot file. Fires when two readings in a row meet the "
        "condition, and again only after two that do not.",
    )
    below_mm: Reading | None = Field(default=None, description="Of a sensor.")
    above_mm: Reading | None = Field(default=None, description="Of a sensor.")
    below_raw: Reading | None = Field(default=None, description="Of a sensor of kind raw.")
    above_raw: Reading | None = Field(default=None, description="Of a sensor of kind raw.")
    key: Annotated[str, Field(min_length=1, max_length=1), Check(check_text)] | None = Field(
        default=None, description="A key of the terminal in which the stage runs."
    )
    osc: Address | None = Field(
        default=None,
        description="An OSC address. A message whose first argument is 0 or false does not fire.",
        examples=["/lss/go"],
    )
    http: Name | None = Field(default=None, description="POST to /trigger/NAME.")
    mqtt: Line | None = Field(default=None, description="A message of this MQTT topic.")
    note: Midi | None = Field(default=None, description="A MIDI note that is played.")
    program: Midi | None = Field(default=None, description="A MIDI program change.")
    channel: int | None = Field(
        default=None, ge=1, le=16, description="Of note and program. Default: any."
    )
    sacn: int | None = Field(
        default=None, ge=1, le=63_999, description="A universe of sACN; needs slot."
    )
    slot: int | None = Field(default=None, ge=1, le=512, description="Of sacn: from 1 to 512.")
    above: float | None = Field(
        default=None,
        description="Of osc, mqtt and sacn: fires when the value rises above this. Default of "
        "sacn: 127.",
    )
    gpio: int | None = Field(
        default=None,
        ge=0,
        le=63,
        description="An input of a Raspberry Pi, with its pull-up: fires when it is pulled down.",
    )
    time: Line | None = Field(
        default=None,
        description="Time of day, as in a crontab: minute, hour, day, month, weekday.",
        examples=["*/10 18-23 * * fri,sat"],
    )
    timecode: Timecode | None = Field(
        default=None,
        description="Position of the timecode under sync.",
        examples=["01:02:03:10"],
    )
    song: Line | None = Field(
        default=None,
        description="Of timecode from fpp: only while this sequence or media is played. Its name, "
        "with or without folder and ending.",
        examples=["one.fseq"],
    )
    end_of: Name | None = Field(default=None, description="A show has been played to its end.")
    start: bool | None = Field(default=None, description="The stage has begun: only true.")
    go: bool | None = Field(
        default=None,
        description="GO of the operator, if this cue is the next one of those with go: only true.",
    )


class CueEntry(FileModel, title="cue"):
    """What is played or done on a trigger. Any cue can also be fired by its name."""

    cue: Name = Field(description="Its name, for the operator and the log.")
    on: OnEntry = Field(description="What fires it.", examples=[{"osc": "/lss/go"}])
    play: Name | Annotated[list[Name], Field(min_length=1, max_length=SHOWS_MAX)] | None = Field(
        default=None, description="A show, or several of which one is played each time."
    )
    choose: Choice = Field(
        default="in_turn",
        description="Of several shows. random: each once, in a random order, then again.",
    )
    do: Deed | None = Field(
        default=None,
        description="In place of play. stop: end all shows, back to the idle show. rest: to the "
        "rest, until wake. wake: end a rest, also after faults.",
    )
    start: StartMode = Field(
        default="only_if_idle",
        description="What happens if a show plays. only_if_idle: nothing. add: it plays beside it "
        "on joints that are free. interrupt: the show is left, and resumed afterwards. terminate: "
        "all shows are ended. restart: the same show begins again. queue: it plays afterwards.",
    )
    priority: int = Field(
        default=0,
        ge=-100,
        le=100,
        description="A show is not ended by a cue of a lower priority; of a queue, the highest "
        "is next.",
    )
    cooldown_s: SpanS = Field(
        default=0.0, description="It does not fire again for so long after its show has ended."
    )
    follow: bool = Field(
        default=True,
        description="Of timecode: the show stays in step with it. It is joined some seconds in, "
        "where the robot has got to, unless the timecode comes to its beginning while no other cue "
        "plays: then the robot waits there. A jump is rejoined; a jump out of the show ends it. "
        "false: it plays from its beginning, by its own clock.",
    )
    ready: bool = Field(
        default=False,
        description="Of timecode, of one cue: in place of the idle show, the robot waits at the "
        "beginning of this show while no timecode comes.",
    )
    enabled: bool = Field(default=True, description="Whether it can fire from the start.")
    enable: list[Name] = Field(default=[], description="Cues that can fire from then on.")
    disable: list[Name] = Field(default=[], description="Cues that cannot fire from then on.")


class TimecodeInput(FileModel, title="timecode"):
    """The timecode that this stage follows."""

    source: Literal["ltc", "mtc", "artnet", "fpp"] = Field(
        description="ltc: an audio input. mtc: a MIDI input. artnet, fpp: the network."
    )
    input: Line = Field(
        default="default",
        description="Audio device, MIDI port, or of artnet and fpp the addresses of the senders "
        "with commas between. Default: the first device; senders on this computer only.",
    )
    rate_fps: Fps | None = Field(
        default=None,
        description="Frames a second: 24, 25, 29.97, 30. Default: as the source says or measured; "
        "25 for the timecodes of this file.",
    )
    freewheel_s: float = Field(
        default=2.0, ge=0.0, le=600.0, description="The show goes on for so long without timecode."
    )
    lost: Literal["go_on", "hold"] = Field(
        default="go_on", description="What follows when freewheel_s is over."
    )
    offset_s: float = Field(
        default=0.0,
        ge=-86_400.0,
        le=86_400.0,
        description="Subtracted from the timecode: the timecode at which the cues begin to count, "
        "as --offset-s of lss-play.",
    )


class SendOutput(FileModel, title="send"):
    """Where the show clock is sent, for lights and sound."""

    kind: Literal["mtc", "ltc", "artnet", "fpp", "osc"] = Field(description="What is sent.")
    output: Line = Field(
        default="default",
        description="Audio device, MIDI port, address (artnet, fpp) or host:port (osc).",
    )
    rate_fps: Fps = Field(default=25.0, description="Frames a second.")
    offset_s: float = Field(
        default=0.0,
        ge=-86_400.0,
        le=86_400.0,
        description="The timecode at which a show begins: added to the show time.",
    )


class Sync(FileModel, title="sync"):
    """What leads the shows, and what they lead."""

    timecode: TimecodeInput | None = Field(default=None, description="Timecode to follow.")
    send: list[SendOutput] = Field(
        default=[], description="What the clock of shows that cues play is sent to."
    )


class ListenEntry(FileModel, title="listen"):
    """Where triggers and operators come from. Without it, only this computer's sensors and keys."""

    http: HostPort | None = Field(
        default=None,
        description="Operator's page, HTTP and metrics; always with a token.",
        examples=["127.0.0.1:8440"],
    )
    osc: HostPort | None = Field(
        default=None, description="OSC over UDP.", examples=["127.0.0.1:9000"]
    )
    feedback: list[HostPort] = Field(
        default=[], description="Where the state is sent by OSC, besides those that subscribe."
    )
    midi: Line | None = Field(default=None, description="MIDI port, by a part of its name.")
    sacn: Line | None = Field(
        default=None, description="Address of the network card on which sACN is received."
    )
    mqtt: Line | None = Field(
        default=None,
        description="MQTT broker: mqtt://USER@HOST:PORT.",
        examples=["mqtt://hub:1883"],
    )
    allow: list[Line] = Field(
        default=["127.0.0.0/8", "::1/128"],
        description="Addresses and networks from which OSC and sACN are accepted; they have no "
        "passwords.",
    )


class Budget(FileModel, title="budget"):
    """Above `slow` the shows are slower, above `rest` the figure rests until it is below `slow`."""

    slow: float = Field(ge=0.0, le=1000.0, description="Shows play at slow_ratio above this.")
    rest: float = Field(ge=0.0, le=1000.0, description="The figure goes to its rest above this.")


class DutyEntry(FileModel, title="duty"):
    """When the figure rests."""

    work_s: SpanS | None = Field(
        default=None,
        description="Rest after so many seconds of motion; a show that plays ends first.",
    )
    rest_s: SpanS = Field(default=300.0, description="How long such a rest takes.")
    rest: Name | None = Field(
        default=None,
        description="Show that takes the figure to its rest pose. Default: it stops and holds.",
    )
    limp: bool = Field(
        default=False, description="The servos have no power in the rest pose; only with rest."
    )
    temperature_c: Budget | None = Field(
        default=None,
        description="Budget of the hottest servo.",
        examples=[{"slow": 55, "rest": 65}],
    )
    current_a: Budget | None = Field(
        default=None, description="Budget of the current of all servos, as a mean of a minute."
    )
    slow_ratio: float = Field(default=0.5, gt=0.0, le=1.0, description="See the budgets.")
    quiet: list[ClockSpan] = Field(
        default=[],
        description="Quiet hours: the figure rests.",
        examples=[["23:00-08:00"]],
    )


class Retry(FileModel, title="on_fault of a stage"):
    """How often the stage begins again after a fault that has ended a show."""

    attempts: dict[Name, Annotated[int, Field(ge=0, le=RETRIES_MAX)]] = Field(
        default={},
        description="By kind of fault, as under on_fault of a robot; 0: none. Default: 3 for "
        "lost_port, silent, restarted, stalled; 1 for astray, stuck, low_voltage; 0 for the "
        "others.",
        examples=[{"silent": 5, "blocked": 1}],
    )
    total: int = Field(
        default=5, ge=0, le=RETRIES_MAX, description="At most so many of all kinds within within_s."
    )
    within_s: SpanS = Field(default=3600.0, description="Attempts that are older do not count.")
    wait_s: SpanS = Field(
        default=10.0, description="Before the first attempt; twice as long before each further one."
    )
    others: Literal["go_on", "slow", "hold"] = Field(
        default="hold",
        description="What the other figures do without one; with go_on shows also start "
        "without it.",
    )

    def allowed(self, cause: Cause) -> int:
        """Return how often it is tried again after faults of a kind."""
        return self.attempts.get(cause, ATTEMPTS.get(cause, 0))


class Alerts(FileModel, title="alerts"):
    """Where faults are reported."""

    webhook: Line | None = Field(
        default=None, description="URL that gets a JSON object by POST.", examples=["https://…"]
    )
    mqtt: Line | None = Field(default=None, description="Topic at the broker under listen.")


class LogEntry(FileModel, title="log"):
    """What is kept of each night."""

    folder: FileName = Field(default="log", description="Folder, relative to this file.")
    max_mb: float = Field(
        default=100.0, ge=1.0, le=1e6, description="Older files are deleted beyond this."
    )
    ring_s: float = Field(
        default=120.0,
        ge=0.0,
        le=3600.0,
        description="So many seconds of bytes are kept when a fault happens.",
    )


class FigureEntry(FileModel, title="figure"):
    """One of several figures, each with its own computer or process."""

    robot: FileName = Field(description="Robot file, relative to this file.")
    address: HostPort | None = Field(
        default=None,
        description="Where its computer listens; needed for the conductor. Default of a stage on "
        "one computer: 127.0.0.1:7447.",
        examples=["192.168.1.20:7447"],
    )
    listen: ListenEntry | None = Field(default=None, description="Triggers at this figure.")


class Network(FileModel, title="network"):
    """How the computers of several figures find and trust each other."""

    keys: FileName | None = Field(
        default=None, description="Folder of keys, made by `lss-motion stage-keys`."
    )
    scouting: Line | None = Field(
        default=None, description="Network interface on which others are searched for."
    )
    freewheel_s: float = Field(
        default=2.0,
        ge=0.0,
        le=600.0,
        description="A figure goes on for so long without its conductor, then it brakes and holds.",
    )


class StageFile(FileModel, title="stage file"):
    """What a figure plays all evening: shows, and the cues that start them."""

    stage: Text = Field(description="Name of the stage.")
    version: Version = Field(default=FILE_VERSION, description=VERSION)
    robot: FileName | None = Field(
        default=None, description="Robot file, relative to this file.", examples=["robots/owl.yaml"]
    )
    shows: Annotated[
        dict[Name, FileName | Annotated[dict[Name, FileName], Field(min_length=1)]],
        Field(min_length=1, max_length=SHOWS_MAX),
    ] = Field(
        description="Sequence, gait or program files by name, relative to this file. With figures, "
        "one for each.",
        examples=[{"hello": "shows/hello.yaml"}],
    )
    idle: Name | None = Field(
        default=None, description="Show that is repeated while no other one plays."
    )
    cues: Annotated[list[CueEntry], Field(max_length=CUES_MAX)] = Field(
        default=[],
        description="What starts them. Of cues that fire at once, the first comes first.",
    )
    sync: Sync = Field(default_factory=Sync, description="Timecode, in and out.")
    listen: ListenEntry = Field(
        default_factory=ListenEntry, description="Where triggers and operators come from."
    )
    duty: DutyEntry = Field(default_factory=DutyEntry, description="When the figure rests.")
    on_fault: Retry = Field(
        default_factory=Retry, description="What follows a fault that has ended a show."
    )
    alerts: Alerts = Field(default_factory=Alerts, description="Where faults are reported.")
    log: LogEntry = Field(default_factory=LogEntry, description="What is kept of each night.")
    time_zone: Line | None = Field(
        default=None,
        description="Of times of day. Default: that of the computer.",
        examples=["Europe/Berlin"],
    )
    figures: dict[Name, FigureEntry] = Field(
        default={}, description="Several figures in place of robot, one show for all of them."
    )
    network: Network = Field(
        default_factory=Network, description="How the computers of figures find each other."
    )
    conductor: Name | None = Field(
        default=None, description="The figure whose computer leads. Default: the first one."
    )
