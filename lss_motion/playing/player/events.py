"""What happened during a run, and what it was asked for, as values.

`Player.next_event` returns the oldest event first. Events and requests are lines of a log
(`playing.log`): their fields are of its format.
"""

from __future__ import annotations

import json
from collections.abc import Mapping  # noqa: TC003  (a log is decoded by these types)
from enum import StrEnum
from typing import Literal

from msgspec import Struct

from lss_motion.robot.on_fault import Cause, FaultStep  # noqa: TC001
from lss_motion.show.model import Cue  # noqa: TC001

WaitState = Literal["begun", "met", "timeout"]
ShowOutcome = Literal["finished", "left", "stopped", "fault"]


class Phase(StrEnum):
    """Phase of a run."""

    CONNECT = "connecting"
    READY = "ready"
    """Checked, and waiting for a person to start it."""
    PREPARE = "preparing"
    APPROACH = "approaching"
    SHOW = "playing"
    SEEK = "seeking"
    """Braking, to go on from another place of the show, or with another show."""
    STANDING = "standing"
    """No show is played: all joints hold, and are watched, until the next one."""
    RECOVER = "recovering"
    """Something is missing; the robot stands until it is back."""
    STOP = "stopping"
    RESTORE = "restoring"
    DONE = "done"


class _PlayerEvent(Struct, frozen=True, tag_field="type", tag=True):
    """In a log, the key `type` has the name of the class."""


class PhaseEntered(_PlayerEvent, frozen=True):
    """The player has entered a phase."""

    phase: Phase


class Warned(_PlayerEvent, frozen=True):
    """Something that a person should know and that stops nothing."""

    text: str


class Noted(_PlayerEvent, frozen=True):
    """Something that a person has asked for, as it is now."""

    text: str


class MarkPassed(_PlayerEvent, frozen=True):
    """The show has reached a keyframe."""

    label: str
    show_s: float


class Waited(_PlayerEvent, frozen=True):
    """The show has stopped at a wait (`begun`), or goes on since it was met or timed out."""

    text: str
    state: WaitState


class CueReached(_PlayerEvent, frozen=True):
    """The show has reached a cue that is not motion; its sound must sound at `show_s`."""

    cue: Cue
    show_s: float


class Faulted(_PlayerEvent, frozen=True):
    """A fault, and the `step` of `on_fault` that was taken about it.

    `cause` is a text with the fault and its remedy; `joint` is empty for a fault of a port.
    """

    joint: str
    cause: str
    kind: Cause
    step: FaultStep

    def __str__(self) -> str:
        return f"joint {self.joint!r} {self.cause}" if self.joint else self.cause


class CheckedServo(Struct, frozen=True, kw_only=True):
    """One servo before anything moves. Angles are joint degrees; None: it did not report it."""

    joint: str
    servo_id: int
    model: str | None
    firmware: int | None
    status: str | None
    position_deg: float
    start_deg: float
    voltage_v: float | None
    temperature_c: float | None
    speed_max_deg_s: float | None
    accel_max_deg_s2: float | None


class Checked(_PlayerEvent, frozen=True):
    """Every servo is present and may do what the program requires."""

    servos: tuple[CheckedServo, ...]
    notes: tuple[str, ...] = ()
    """What a person may want to mend."""


class ShowBegan(_PlayerEvent, frozen=True):
    """A show of a run with many has begun at `from_s`."""

    name: str
    from_s: float
    is_added: bool = False
    """Whether it is played beside another show, on joints of its own."""


class JointSummary(Struct, frozen=True, kw_only=True):
    """How one joint followed the plan, as measured by its servo; None: it did not report it."""

    error_rms_deg: float
    error_max_deg: float
    resent: int
    temperature_max_c: float | None
    voltage_min_v: float | None
    current_max_a: float | None


class ShowSummary(Struct, frozen=True, kw_only=True):
    """One show that was played: instants on the run clock, places in show time."""

    name: str
    outcome: ShowOutcome
    """`left`: another show took its place before its end."""
    is_added: bool
    """Whether it was played beside another show, on joints of its own."""
    from_s: float
    reached_s: float
    """Where a show that was left can go on: the `start_s` of `Player.change_to`."""
    began_ns: int
    ended_ns: int
    commands: int
    missed: int
    late_max_us: int
    joints: Mapping[str, JointSummary]


class ShowOver(_PlayerEvent, frozen=True):
    """A show of a run with many is over, or another one takes its place."""

    summary: ShowSummary


Event = (
    PhaseEntered
    | Warned
    | Noted
    | MarkPassed
    | CueReached
    | Waited
    | Faulted
    | Checked
    | ShowBegan
    | ShowOver
)


RequestName = Literal[
    "go", "rate", "follow", "seek", "run_from", "hold_before_start", "sound", "stop"
]


class PlayerRequest(Struct, frozen=True):
    """What the player was asked for: its call, and the arguments but for the instant."""

    name: RequestName
    values: tuple[float | str, ...] = ()

    @property
    def text(self) -> str:
        """Name and values, for a person."""
        return " ".join([self.name, *map(json.dumps, self.values)])


def note_nowhere(_request: PlayerRequest, _now_ns: int) -> None:
    """Take the place of what notes requests where no log is written."""
