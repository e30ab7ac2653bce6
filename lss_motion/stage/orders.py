"""What the director orders, and what it notes; `Director.next_order` returns the oldest first.

What it has ordered, and what waits, are `OrderedShow` and `WaitingShow`.

Orders are obeyed by whoever has the player (`stage.running`). Notes go to the log and to operators:
`text` says in a line what happened and why.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

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


class Alert(Struct, frozen=True):
    """Send a message to the owner."""

    kind: str
    text: str


# ---- notes


class CueFired(Struct, frozen=True, kw_only=True):
    """A cue has fired; `what` happens now or, queued, later."""

    cue: str
    signal: str
    what: str

    @property
    def text(self) -> str:
        return f"cue {self.cue}: {self.what} ({self.signal})"


class CueRefused(Struct, frozen=True, kw_only=True):
    """A cue was triggered and has not fired."""

    cue: str
    signal: str
    reason: str

    @property
    def text(self) -> str:
        return f"cue {self.cue} refused: {self.reason} ({self.signal})"


class ShowRefused(Struct, frozen=True, kw_only=True):
    """A cue has fired, but the player cannot play its show now."""

    cue: str
    show: str
    reason: str

    @property
    def text(self) -> str:
        return f"cue {self.cue} refused: {self.reason} (show {self.show})"


class ShowStartNote(Struct, frozen=True, kw_only=True):
    """A show was ordered: for a cue, as the idle show, or as the way to the rest."""

    number: int
    show: str
    cause: str

    @property
    def text(self) -> str:
        return f"show {self.show} for {self.cause}"


class ShowEndNote(Struct, frozen=True, kw_only=True):
    """A show is over."""

    number: int
    show: str
    outcome: Outcome
    played_s: float

    @property
    def text(self) -> str:
        return f"show {self.show} {self.outcome} after {self.played_s:.1f} s"


class RestChanged(Struct, frozen=True):
    """The figure rests for other reasons than before; without reasons it works."""

    reasons: tuple[str, ...]

    @property
    def text(self) -> str:
        return f"rests: {', '.join(self.reasons)}" if self.reasons else "works"


class Remark(Struct, frozen=True):
    """Something else that explains what happens later."""

    text: str


Note: TypeAlias = (
    CueFired | CueRefused | ShowRefused | ShowStartNote | ShowEndNote | RestChanged | Remark
)
Order: TypeAlias = PlayOrder | StopOrder | RelaxOrder | ConnectOrder | Alert


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
