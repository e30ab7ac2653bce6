"""What a conductor knows of its figures: their last states, and why one does not take part."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.stage.hosts.clocks import REFUSE_NS, WARN_NS
from lss_motion.stage.hosts.messages import PROTOCOL
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from lss_motion.stage.hosts.messages import FigureStatus

LOST_NS: Final = NS_PER_S
"""Without a message for so long, a figure, or its conductor, is lost."""
NOTE_AGAIN_NS: Final = NS_PER_S
"""A figure that comes and goes is named no more often. What it does is not delayed by that."""
TWICE_AGAIN_NS: Final = 60 * NS_PER_S
"""A figure that two processes serve is named no more often: they answer in turn, 10 a second."""
PROCESSES_MAX: Final = 8
"""Processes of one figure that are told apart; those of earlier restarts are forgotten."""
TWICE: Final = "two processes serve it: end one of them (`lss-motion serve … --figure`)"
PLAYABLE: Final = frozenset({"armed", "playing"})
ACTIVE: Final = frozenset({"arming", "armed", "playing", "freewheeling", "holding", "stopping"})
"""States of a figure with a player."""


@dataclass
class RemoteFigure:
    """What the conductor knows of one figure."""

    name: str
    status: FigureStatus | None = None
    heard_ns: int | None = None
    other_protocol: int | None = None
    """That of its last state, if it is not ours."""
    is_alive: bool = False
    """Whether its token is there (`peer`)."""
    problem: str = ""
    """Why it does not take part; empty: it does."""
    problem_ns: int | None = None
    """Since when there is one."""
    apart_ns: int | None = None
    """Since when it says that it follows another conductor."""
    notes: list[str] = field(default_factory=list)
    """What a person should know; the conductor takes it."""
    noted: str = ""
    """The last problem that a person was told, without its numbers."""
    noted_ns: int = -NOTE_AGAIN_NS
    last_words: dict[str, str] = field(default_factory=dict)
    """The last text of each process that has served it, the oldest process first."""
    is_twice_ns: int | None = None
    """When it was last seen that two processes serve it."""
    told_twice_ns: int | None = None

    def is_twice(self, now_ns: int) -> bool:
        """Return whether two processes serve it, and answer in turn."""
        return self.is_twice_ns is not None and now_ns - self.is_twice_ns <= LOST_NS

    def is_lost(self, now_ns: int) -> bool:
        """Return whether nothing has arrived from it for `LOST_NS`."""
        return self.heard_ns is None or now_ns - self.heard_ns > LOST_NS

    def is_active(self, now_ns: int) -> bool:
        """Return whether it has a player, as far as is known."""
        return self.status is not None and not self.is_lost(now_ns) and self.status.state in ACTIVE

    def is_of(self, epoch: int, run: int) -> bool:
        """Return whether its last state is about this run."""
        return self.status is not None and (self.status.epoch, self.status.run) == (epoch, run)

    # ---- what arrives

    def take_status(self, status: FigureStatus, now_ns: int) -> None:
        """Take its state, and note what a person should know of it."""
        if self.status is not None and self.status.instance != status.instance:
            self._meet_process(status.instance, now_ns)
        if status.text and self.last_words.get(status.instance) != status.text:
            self.notes.append(f"figure {self.name}: {status.text}")
        self.last_words[status.instance] = status.text
        while len(self.last_words) > PROCESSES_MAX:
            del self.last_words[next(iter(self.last_words))]
        self.status, self.heard_ns, self.other_protocol = status, now_ns, None

    def _meet_process(self, instance: str, now_ns: int) -> None:
        """Note that another process serves it. One that was there before: two do at once."""
        if instance not in self.last_words:
            self.notes.append(f"figure {self.name} has started again")
            return
        self.is_twice_ns = now_ns
        if self.told_twice_ns is None or now_ns - self.told_twice_ns >= TWICE_AGAIN_NS:
            self.told_twice_ns = now_ns
            self.notes.append(f"figure {self.name}: {TWICE}")

    def take_alive(self, *, is_alive: bool) -> None:
        """Note that its token has come, or gone: its process or its line is lost."""
        if self.is_alive != is_alive:
            self.is_alive = is_alive
            if not is_alive:
                self.heard_ns = None

    # ---- whether it takes part

    def note_problem(self, problem: str, now_ns: int) -> None:
        """Keep why it does not take part, and tell a person, unless that was told a moment ago."""
        kind = re.sub(r"\d+", "", problem)
        if kind != self.noted and now_ns - self.noted_ns >= NOTE_AGAIN_NS:
            again = f": {problem}" if problem else " takes part again"
            self.notes.append(f"figure {self.name}{again}")
            self.noted, self.noted_ns = kind, now_ns
        if bool(problem) != bool(self.problem):
            self.problem_ns = now_ns if problem else None
        self.problem = problem

    def problem_of(self, now_ns: int, *, has_begun: bool, is_over: bool) -> str:
        """Return why it does not take part; empty: it does, or will.

        `has_begun`: the show runs, so its clock was good enough. `is_over`: the run is under way
        that its state is about, so it must not have ended.
        """
        status = self.status
        if self.other_protocol is not None and not self.is_lost(now_ns):
            other = self.other_protocol
            return f"it has protocol {other}, the conductor {PROTOCOL}: install the same version"
        if status is None:
            return "it has not connected: is it on, are address and keys right?"
        if self.is_lost(now_ns):
            return "lost: nothing arrives from it"
        if status.state == "out":
            return f"out: {status.text}"
        if status.bound_ns is not None and status.bound_ns > REFUSE_NS and not has_begun:
            return (
                f"its clock is known to {status.bound_ns / NS_PER_MS:.0f} ms only, allowed are "
                f"{REFUSE_NS / NS_PER_MS:.0f}: the network is too slow or too busy"
            )
        if is_over and status.state in ("stopped", "holding"):
            return f"it does not play: {status.text or status.state}"
        return ""

    def warning(self) -> str:
        """Return what is no reason to refuse a start, but should be known; empty: nothing."""
        bound_ns = None if self.status is None else self.status.bound_ns
        if bound_ns is None or bound_ns <= WARN_NS:
            return ""
        return f"{self.name}: its clock is known to {bound_ns / NS_PER_MS:.1f} ms only"
