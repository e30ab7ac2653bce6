"""Time as a seam: the run asks a clock, and a test, or virtual time, swaps it."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Nanoseconds that never go back. What its zero is does not matter."""

    def now_ns(self) -> int: ...


class MonotonicClock:
    """The computer's clock that no one can set."""

    def now_ns(self) -> int:
        return time.monotonic_ns()


class VirtualClock:
    """Time that passes only when told to, so that an hour of show plays in seconds."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def advance_to(self, instant_ns: int) -> None:
        assert instant_ns >= self._now_ns, "time cannot go backwards"
        self._now_ns = instant_ns
