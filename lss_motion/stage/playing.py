"""What the runs of a stage keep: which shows play, and two taps as one."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lss_motion.playing.log import PortState
    from lss_motion.playing.player.events import Event, PlayerRequest, ShowBegan, ShowSummary
    from lss_motion.playing.runner import Tap
    from lss_motion.stage import orders


@dataclass(slots=True)
class Playing:
    """The shows of the player by the numbers of the director."""

    main: int | None = None
    has_begun: bool = False
    start_s: float | None = None
    leaving: deque[int] = field(default_factory=deque)
    """Shows that have begun and brake for another one; the player reports each when it is over."""
    added: dict[str, int] = field(default_factory=dict)
    begun: set[str] = field(default_factory=set)
    """Those of the added ones that have begun."""

    def leave(self, order: orders.Play | None) -> list[tuple[int, float | None]]:
        """Note what was ordered in place of all; return what is over at once: it had not begun."""
        waiting = self.added.keys() - self.begun
        over: list[tuple[int, float | None]] = [(self.added.pop(name), None) for name in waiting]
        if self.main is not None and self.has_begun:
            self.leaving.append(self.main)
        elif self.main is not None:
            over.append((self.main, self.start_s))
        self.main = None if order is None else order.number
        self.start_s = None if order is None else order.start_s
        self.has_begun = False
        return over

    def note_begun(self, event: ShowBegan) -> None:
        if event.is_added:
            self.begun.add(event.name)
        else:
            self.has_begun = True

    def note_over(self, summary: ShowSummary) -> int | None:
        """Return the number of a show that is over."""
        if summary.is_added:
            self.begun.discard(summary.name)
            return self.added.pop(summary.name, None)
        if self.leaving:
            return self.leaving.popleft()
        number, self.main, self.has_begun = self.main, None, False
        return number


class Both:
    """Two taps as one."""

    def __init__(self, one: Tap, other: Tap) -> None:
        self._taps = (one, other)

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:
        for tap in self._taps:
            tap.sent(bus, data, now_ns)

    def received(self, bus: str, data: bytes, now_ns: int) -> None:
        for tap in self._taps:
            tap.received(bus, data, now_ns)

    def turned(self, now_ns: int) -> None:
        for tap in self._taps:
            tap.turned(now_ns)

    def happened(self, event: Event, now_ns: int) -> None:
        for tap in self._taps:
            tap.happened(event, now_ns)

    def requested(self, request: PlayerRequest, now_ns: int) -> None:
        for tap in self._taps:
            tap.requested(request, now_ns)

    def noted(self, bus: str, state: PortState, now_ns: int, reason: str = "") -> None:
        for tap in self._taps:
            tap.noted(bus, state, now_ns, reason)
