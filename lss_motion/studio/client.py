"""One client of the server: what waits for it, and how much it may send.

Events are kept in order, up to a bound; a client that does not take them is closed, and gets the
whole state when it comes again. Of telemetry and other values that replace each other only the
newest is kept. No client waits for another.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from lss_motion.studio.access import Role

EVENTS_MAX: Final = 2000
"""Chosen: a show has some hundred; two thousand of 500 bytes are 1 MB a client."""
OPERATIONS_HZ: Final = 100.0
"""A page that is dragged sends 60 a second."""
OPERATIONS_BURST: Final = 50.0
TELEMETRY: Final = "telemetry"


class Client:
    """One connection, from `welcome` to its end."""

    def __init__(self, number: int, role: Role, name: str, place: int = 0) -> None:
        self.number = number
        self.place = place
        """Which address of the server it came to."""
        self.role = role
        self.name = name
        """What other clients call it."""
        self.is_overrun = False
        """Whether more events waited than are kept."""
        self._events: deque[str] = deque()
        self._newest: dict[str, str | bytes] = {}
        self._ready = asyncio.Event()

    def send(self, text: str) -> None:
        """Keep an event until the client takes it."""
        if len(self._events) >= EVENTS_MAX:
            self.is_overrun = True
        else:
            self._events.append(text)
        self._ready.set()

    def offer(self, kind: str, content: str | bytes) -> None:
        """Keep a value in the place of the last one of this kind."""
        self._newest[kind] = content
        self._ready.set()

    async def next(self) -> str | bytes | None:
        """Wait for what is to be sent next, events first; None: the client is overrun."""
        while not (self._events or self._newest or self.is_overrun):
            self._ready.clear()
            await self._ready.wait()
        if self.is_overrun:
            return None
        if self._events:
            return self._events.popleft()
        return self._newest.pop(next(iter(self._newest)))


class Allowance:
    """How many operations a client may send: a burst, then a steady rate."""

    def __init__(self, now_s: float) -> None:
        self._left = OPERATIONS_BURST
        self._at_s = now_s

    def take(self, now_s: float) -> float:
        """Take one; return how long to wait before the next is read."""
        self._left = min(OPERATIONS_BURST, self._left + (now_s - self._at_s) * OPERATIONS_HZ) - 1.0
        self._at_s = now_s
        return max(0.0, -self._left / OPERATIONS_HZ)
