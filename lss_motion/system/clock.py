"""The clock of a run: the computer's own, or virtual time.

The run loop reads the time and waits through its clock only. The same loop therefore plays a show
in real time, and an hour of it in virtual time within seconds.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.system.reactor import wait_for
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Collection

WAIT_MAX_NS: Final = NS_PER_S // 20
"""The longest wait in real time, so that the loop serves keys and the display often enough."""


class Clock(Protocol):
    """Nanoseconds that never decrease, and the way to let them pass. Their zero is arbitrary."""

    @property
    def is_virtual(self) -> bool:
        """Whether time passes in `wait_until` only."""

    def now_ns(self) -> int:
        """Return the time."""

    def wait_until(self, instant_ns: int, filenos: Collection[int] = ()) -> None:
        """Let time pass until `instant_ns`, but return when data arrives on one of `filenos`.

        May return earlier for no reason: the caller checks what is due and waits again. Returns
        at once if `instant_ns` is past.
        """


class MonotonicClock:
    """The computer's monotonic clock, which no program can set."""

    is_virtual: Final = False

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def wait_until(self, instant_ns: int, filenos: Collection[int] = ()) -> None:
        """Wait, for `WAIT_MAX_NS` at most."""
        now_ns = self.now_ns()
        left_s = max(0.0, s_from_ns(min(instant_ns, now_ns + WAIT_MAX_NS) - now_ns))
        wait_for(filenos, left_s)


class VirtualClock:
    """Time that `advance_to` and `wait_until` set. Nothing waits."""

    is_virtual: Final = True

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, instant_ns: int, filenos: Collection[int] = ()) -> None:  # noqa: ARG002
        """Continue at `instant_ns`. Virtual ports have no file: no data arrives in between."""
        if instant_ns > self._now_ns:
            self.advance_to(instant_ns)

    def advance_to(self, instant_ns: int) -> None:
        assert instant_ns >= self._now_ns, "time cannot go backwards"
        self._now_ns = instant_ns
