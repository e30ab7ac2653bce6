"""The values of a stage: shows, cues, triggers, and the rules of an evening.

They are immutable, and every value that an author wrote keeps its line. `stage.load` makes them
from files. `Signal` is what arrives from outside and may fire a cue.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Literal

from msgspec import Struct, field

from lss_motion.stage.file import Alerts, Budget, Choice, Deed, Network, Retry, StartMode, Sync

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import time, tzinfo
    from pathlib import Path

    from lss_motion.robot.model import Robot

Side = Literal["below", "above"]


class TriggerKind(StrEnum):
    """TriggerKind of a trigger, and of the signal that fires it."""

    SENSOR = "sensor"
    KEY = "key"
    OSC = "osc"
    HTTP = "http"
    MQTT = "mqtt"
    NOTE = "note"
    PROGRAM = "program"
    SACN = "sacn"
    GPIO = "gpio"
    TIME = "time"
    TIMECODE = "timecode"
    END_OF = "end_of"
    START = "start"
    GO = "go"
    CUE = "cue"
    """An operator, or another program, fires a cue by its name; no cue waits for it."""


class CueTrigger(Struct, frozen=True, kw_only=True):
    """What fires a cue.

    `address` names the source: sensor, key, OSC address, HTTP name, MQTT topic, MIDI number, GPIO
    pin, `universe/slot`, cron expression, timecode, or show.
    """

    kind: TriggerKind
    address: str = ""
    side: Side | None = None
    """Which values fire: those below or above `threshold`. None: every signal that is not zero."""
    threshold: float = 0.0
    channel: int | None = None
    """Of MIDI; None: any."""
    at_s: float = 0.0
    """Of a timecode: seconds from 00:00:00:00."""
    song: str = ""
    """Of a timecode: only while this is played; empty: always."""

    def is_met(self, value: float) -> bool:
        """Return whether a value is on the side that fires."""
        return value < self.threshold if self.side == "below" else value > self.threshold

    @property
    def words(self) -> str:
        """When it fires, as an operator says it."""
        match self.kind:
            case TriggerKind.SENSOR:
                side = "nearer" if self.side == "below" else "farther"
                return f"when {self.address} sees something {side} than {self.threshold:g} mm"
            case TriggerKind.KEY:
                return f"key {self.address}"
            case TriggerKind.GO:
                return "on GO"
            case TriggerKind.START:
                return "when the stage begins"
            case TriggerKind.END_OF:
                return f"after {self.address}"
            case TriggerKind.CUE:
                return "by hand"
            case _:
                return self.text

    @property
    def text(self) -> str:
        """The trigger in a few words, for people."""
        side = "" if self.side is None else f" {self.side} {self.threshold:g}"
        channel = "" if self.channel is None else f" (channel {self.channel})"
        song = f" of {self.song}" if self.song else ""
        return f"{self.kind} {self.address}{side}{channel}{song}".strip()


class Signal(Struct, frozen=True, kw_only=True):
    """What arrived from outside, or happened: one reading, message, key or instant."""

    kind: TriggerKind
    address: str = ""
    value: float | None = None
    channel: int | None = None
    source: str = ""
    """Who sent it, for the log."""

    @property
    def text(self) -> str:
        value = "" if self.value is None else f" {self.value:g}"
        source = f" from {self.source}" if self.source else ""
        return f"{self.kind} {self.address}".strip() + value + source


class StageCue(Struct, frozen=True, kw_only=True):
    """What is played or done on a trigger."""

    name: str
    on: CueTrigger
    shows: tuple[str, ...] = ()
    choice: Choice = "in_turn"
    deed: Deed | None = None
    start: StartMode = "only_if_idle"
    priority: int = 0
    cooldown_s: float = 0.0
    follows: bool = True
    is_ready: bool = False
    """The figure waits at the start of its show while no timecode comes."""
    is_enabled: bool = True
    enables: tuple[str, ...] = ()
    disables: tuple[str, ...] = ()
    line: int | None = None

    @property
    def can_wait(self) -> bool:
        """Whether its show can wait at its beginning for the timecode."""
        return self.follows and len(self.shows) == 1 and self.start != "add"


class StageShow(Struct, frozen=True, kw_only=True):
    """One show; `paths` has its file, by figure. The only figure of a simple stage is ``."""

    name: str
    paths: Mapping[str, Path]
    line: int | None = None

    @property
    def path(self) -> Path:
        """The file of a stage with one robot."""
        return next(iter(self.paths.values()))


class Listen(Struct, frozen=True, kw_only=True):
    """Where triggers and operators come from; None: not at all. Ports are `(host, port)`."""

    http: tuple[str, int] | None = None
    osc: tuple[str, int] | None = None
    feedback: tuple[tuple[str, int], ...] = ()
    midi: str | None = None
    sacn: str | None = None
    mqtt: str | None = None
    allow: tuple[str, ...] = ("127.0.0.0/8", "::1/128")
    """Networks from which protocols without passwords are accepted."""
    line: int | None = None


class DutyRule(Struct, frozen=True, kw_only=True):
    """When the figure rests."""

    work_s: float | None = None
    rest_s: float = 300.0
    rest: str | None = None
    """Show that takes the figure to its rest pose."""
    is_limp: bool = False
    temperature_c: Budget | None = None
    current_a: Budget | None = None
    slow_ratio: float = 0.5
    quiet: tuple[tuple[time, time], ...] = ()
    """Local times of day; the second one may be the smaller one: through midnight."""


class LogRule(Struct, frozen=True, kw_only=True):
    """What is kept of each night, and where."""

    folder: Path
    max_bytes: int = 100_000_000
    ring_s: float = 120.0


class StageFigure(Struct, frozen=True, kw_only=True):
    """One of several figures."""

    name: str
    robot_path: Path
    address: tuple[str, int] | None = None
    listen: Listen | None = None
    line: int | None = None


class Stage(Struct, frozen=True, kw_only=True):
    """What a figure, or several, play all evening."""

    name: str
    path: Path
    robot_path: Path | None
    """None: the stage has `figures`."""
    robot: Robot | None = None
    shows: Mapping[str, StageShow]
    idle: str | None = None
    cues: tuple[StageCue, ...] = ()
    sync: Sync = Sync()
    listen: Listen = Listen()
    duty: DutyRule = DutyRule()
    retry: Retry = Retry()
    alerts: Alerts = Alerts()
    log: LogRule
    zone: tzinfo | None = None
    """Of times of day; None: that of the computer."""
    figures: Mapping[str, StageFigure] = field(default_factory=dict)
    network: Network = Network()
    conductor: str | None = None
    """The figure whose computer leads; None without figures."""

    @property
    def keys(self) -> Path | None:
        """The folder of keys of the network; `stage-keys` makes it."""
        return None if self.network.keys is None else self.path.parent / self.network.keys

    def cue(self, name: str) -> StageCue | None:
        """Return the cue of that name; None: there is none."""
        return next((cue for cue in self.cues if cue.name == name), None)

    def addresses(self, kind: TriggerKind) -> tuple[str, ...]:
        """Return what cues of one kind wait for, such as sensors or times of day; each once."""
        return tuple(dict.fromkeys(cue.on.address for cue in self.cues if cue.on.kind is kind))
