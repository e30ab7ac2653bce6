"""What happened during a run, as values, oldest first from `next_event()`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from lss_motion.robot.on_fault import Cause, FaultStep
    from lss_motion.sequence.model import Cue


WaitState = Literal["begun", "met", "timeout"]


class Phase(StrEnum):
    """What the player is doing."""

    CONNECT = "connecting"
    READY = "ready"
    """Checked, and waiting for a person to say go."""
    PREPARE = "preparing"
    APPROACH = "approaching"
    SHOW = "playing"
    RECOVER = "recovering"
    """Something is gone; the robot stands until it is back."""
    STOP = "stopping"
    RESTORE = "restoring"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class PhaseEntered:
    """The player has begun a phase."""

    phase: Phase


@dataclass(frozen=True, slots=True)
class Warned:
    """Something that a person should know and that stops nothing."""

    text: str


@dataclass(frozen=True, slots=True)
class MarkPassed:
    """The show has reached a keyframe."""

    label: str
    show_s: float


@dataclass(frozen=True, slots=True)
class Waited:
    """The show stands still until a sensor says so; or that has happened, or took too long."""

    text: str
    state: WaitState


@dataclass(frozen=True, slots=True)
class CueReached:
    """The show has come to something that is not motion; a sound is to be heard at `show_s`."""

    cue: Cue
    show_s: float


@dataclass(frozen=True, slots=True)
class Faulted:
    """Something went wrong, and `step` of its ladder has been taken.

    `cause` says in words what, and what to do about it; `joint` is empty where it is a port.
    """

    joint: str
    cause: str
    kind: Cause
    step: FaultStep

    def __str__(self) -> str:
        return f"joint {self.joint!r} {self.cause}" if self.joint else self.cause


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """One servo before anything moves. Angles are joint degrees; None: it did not say."""

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


@dataclass(frozen=True, slots=True)
class Checked:
    """Every servo is there and may do what is asked of it."""

    servos: tuple[Found, ...]


Event = PhaseEntered | Warned | MarkPassed | CueReached | Waited | Faulted | Checked
