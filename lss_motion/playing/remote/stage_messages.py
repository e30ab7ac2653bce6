"""Messages of a stage, which plays many shows on cues: part of `schema`."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from lss_motion.playing.remote.message import Event, Message, Name, Operation

SignalKind = Literal["key", "osc", "http", "mqtt", "note", "program", "sacn", "gpio"]
"""Where a trigger comes from: the kinds of `stage.model.TriggerKind` that a server receives."""
Source = Annotated[str, Meta(max_length=200)]
"""The sender, for people and the log."""


class Trigger(Operation, frozen=True, kw_only=True, tag="trigger"):
    """A message from outside that may fire a cue, as `stage.model.Signal`."""

    kind: SignalKind
    address: Annotated[str, Meta(min_length=1, max_length=256)]
    """OSC address, HTTP name, MQTT topic, note or program, `universe/slot`, pin or key."""
    value: float | None = None
    channel: Annotated[int, Meta(ge=1, le=16)] | None = None
    """Of MIDI."""
    source: Source = ""


class FireCue(Operation, frozen=True, kw_only=True, tag="cue"):
    """Fire a cue by its name, whatever it waits for."""

    label: Name
    source: Source = ""


class Enable(Operation, frozen=True, kw_only=True, tag="enable"):
    """Let a cue fire on its trigger, or not."""

    cue: Name
    is_enabled: bool
    source: Source = ""


class Arm(Operation, frozen=True, kw_only=True, tag="arm"):
    """Make a cue the next one that `go` fires."""

    cue: Name


class StagePlay(Operation, frozen=True, kw_only=True, tag="stage.play"):
    """Play a show, in place of all that play."""

    show: Name


class StageStop(Operation, frozen=True, kw_only=True, tag="stage.stop"):
    """End all shows; the stage goes on with its idle show."""


class StageRest(Operation, frozen=True, kw_only=True, tag="stage.rest"):
    """End all shows and rest, until `stage.wake`."""


class StageWake(Operation, frozen=True, kw_only=True, tag="stage.wake"):
    """End a rest, also one after faults."""


class Change(Operation, frozen=True, kw_only=True, tag="change"):
    """Play another show of a run of several: in place of the present one, or beside it.

    Without `show`, what plays brakes and all joints hold. A show beside another one is played on
    joints that the other does not move.
    """

    show: Name | None = None
    start_s: Annotated[float, Meta(ge=0.0)] | None = None
    how: Literal["replace", "add"] = "replace"


class EndAdded(Operation, frozen=True, kw_only=True, tag="end_added"):
    """End a show that is played beside another one."""

    show: Name


StageOperation = Trigger | FireCue | Enable | Arm | StagePlay | StageStop | StageRest | StageWake
"""What is asked of a running stage, besides `schema.ShowOperation`."""


class CueInfo(Message, frozen=True, kw_only=True):
    """One cue of a stage, as it is now."""

    name: str
    on: str
    when: str
    """When it fires next, in words: a time of day, or what must happen."""
    plays: str
    is_enabled: bool
    fired: int
    """How often, since the stage has begun."""
    last_fired_s: float | None
    """How long ago."""
    refused: str
    """Why it was refused since; empty if it was not."""


class TimecodeState(Message, frozen=True, kw_only=True):
    """The timecode of a stage, and the show that follows it."""

    state: Literal[
        "searching", "locked", "freewheeling", "lost", "standing", "reverse", "off_speed"
    ]
    source: str
    at: str
    """Where it is, `hh:mm:ss`; empty before it has come."""
    rate: float | None
    show: str | None
    """What the show does, as `playing.player.following.Step`; None: no show follows."""
    off_ms: float | None
    """How far the timecode is ahead of the show, while that is in step."""


class HostInfo(Message, frozen=True, kw_only=True):
    """One computer of a stage with figures, as the conductor knows it."""

    name: str
    is_conductor: bool
    is_good: bool = False
    state: str
    """As `stage.hosts.messages.FigureState`, or `lost`, or `not connected`."""
    text: str
    """Its last word, or why it does not take part."""
    version: str = ""
    offset_ms: float | None = None
    """By how much the clock of the conductor is ahead of its own."""
    bound_ms: float | None = None
    """How well that is known."""
    round_trip_ms: float | None = None
    show_s: float | None = None
    off_ms: float | None = None
    """How far its show is from where all should be."""
    hottest_c: float | None = None
    late_ms: float | None = None
    """The worst lateness of a move."""
    heard_s: float | None = None
    """Since its last message."""


class StageState(Event, frozen=True, kw_only=True, tag="stage"):
    """The whole state of a stage; only the newest one counts."""

    state: Literal["waits_for_port", "connecting", "rests", "idle", "plays", "given_up"]
    show: str | None
    show_plan: str | None
    """Hash of its program, as in the telemetry."""
    cause: str
    """The cue for which it plays, or `idle`."""
    added: tuple[str, ...]
    queue: tuple[str, ...]
    left: tuple[str, ...]
    """Interrupted shows that will be resumed."""
    next_go: str | None
    reasons: tuple[str, ...]
    """Why the figure rests, and until when."""
    timecode: TimecodeState | None = None
    """None: the stage has none."""
    cues: tuple[CueInfo, ...]
    hosts: tuple[HostInfo, ...] = ()
    """The computers of a stage with figures."""


class StageNote(Event, frozen=True, kw_only=True, tag="stage_note"):
    """What a stage has done or refused, as a line of its log."""

    kind: str
    text: str
    cue: str | None = None
    show: str | None = None
    count: int = 1
    """How often, of equal refusals."""
