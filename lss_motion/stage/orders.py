"""What the director orders, and what it notes; `Director.next_order` returns the oldest first.

What it has ordered, and what waits, are `OrderedShow` and `WaitingShow`.

Orders are obeyed by whoever has the player (`stage.running`). Notes go to the log and to operators.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

from msgspec import Struct

if TYPE_CHECKING:
    from lss_motion.stage.model import StageCue

How = Literal["change", "add"]
Outcome = Literal["finished", "left", "fault"]
"""How a show ended: by itself, for another show, or by a fault."""


class PlayOrder(Struct, frozen=True, kw_only=True):
    """Play a show: in place of all that play (`change`), or beside them (`add`)."""

    number: int
    """Unique; `Director.ended` and `Director.refused` name it."""
    show: str
    how: How = "change"
    start_s: float | None = None
    """Show time from which it is played; None: from its beginning."""
    follows_s: float | None = None
    """Position of the timecode at show time 0, if the show follows it."""
    waits: bool = False
    """It stands at its beginning until the timecode comes there."""


class StopOrder(Struct, frozen=True):
    """Brake within the limits and hold: no show plays."""


class RelaxOrder(Struct, frozen=True):
    """Take the power from the servos in the rest pose, until the next show."""


class ConnectOrder(Struct, frozen=True):
    """Begin a new run: check the servos again, set them up. `Director.connected` answers."""


class Note(Struct, frozen=True):
    """What has happened and why, for the log and for operators."""

    text: str
    kind: str
    """With fields: `fired` (cue, what), `refused` (cue, reason), `not_played` (cue, show, reason),
    `started` (show, cause), `ended` (show, outcome), `rest` (reasons), `alert` (alert), `note`.
    """
    fields: dict[str, Any]


Order: TypeAlias = PlayOrder | StopOrder | RelaxOrder | ConnectOrder


def not_played(cue: StageCue, show: str, reason: str) -> Note:
    """Return the note of a cue that has fired, but whose show is not played."""
    text = f"cue {cue.name} refused: {reason} (show {show})"
    return Note(text, "not_played", {"cue": cue.name, "show": show, "reason": reason})


LEAST_PRIORITY: Final = -101
"""Below that of any cue: of the idle show."""


class ShowInfo(Struct, frozen=True, kw_only=True):
    """What the director knows of a show."""

    joints: frozenset[str]
    duration_s: float
    """Infinite for a show that loops forever."""


@dataclass(slots=True, kw_only=True)
class OrderedShow:
    """A show that was ordered."""

    number: int
    show: str
    cue: StageCue | None
    """None: the idle show, or the way to the rest."""
    since_ns: int
    is_rest: bool = False
    resumes: bool = False
    """It is resumed when what interrupted it is over."""
    is_ready: bool = False
    """It stands at its beginning, and waits for the timecode."""

    @property
    def priority(self) -> int:
        return LEAST_PRIORITY if self.cue is None else self.cue.priority


@dataclass(slots=True)
class WaitingShow:
    """A show that waits: queued, or interrupted at a show time."""

    show: str
    cue: StageCue
    show_s: float | None = None
