"""What happened during a run, as values, oldest first from `next_event()`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lss_motion.sequence.model import Cue


class Phase(StrEnum):
    """What the player is doing."""

    CONNECT = "connecting"
    PREPARE = "preparing"
    APPROACH = "approaching"
    SHOW = "playing"
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
class CueReached:
    """The show has come to something that is not motion; a sound is to be heard at `show_s`."""

    cue: Cue
    show_s: float


@dataclass(frozen=True, slots=True)
class Faulted:
    """The robot did not do what it should; the show ends with this."""

    joint: str
    cause: str


Event = PhaseEntered | Warned | MarkPassed | CueReached | Faulted
