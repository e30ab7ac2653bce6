"""A port that is opened again when it was lost, as long as somebody still wants it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.runtime.clock import Clock
    from lss_motion.runtime.port import Port

REOPEN_NS: Final = 100 * NS_PER_MS
"""How often a lost port is looked for. Chosen: nobody notices a tenth of a second, and to look for
a device that is not there takes microseconds."""


class ReopeningPort:
    """A port that takes what is written while it is lost, and drops it.

    `waits` is asked when the port is lost, and while it is: False ends it with `BusError`. `lost`
    is told the reason and the instant, `found` that it is open again.
    """

    def __init__(
        self,
        port: Port,
        reopen: Callable[[], Port],
        clock: Clock,
        *,
        waits: Callable[[], bool],
        lost: Callable[[str, int], None],
        found: Callable[[], None],
    ) -> None:
        self.url = port.url
        self._port: Port | None = port
        self._reopen = reopen
        self._clock = clock
        self._waits = waits
        self._lost = lost
        self._found = found
        self._next_ns = 0

    def write(self, data: bytes) -> None:
        if self._port is None:
            return
        try:
            self._port.write(data)
        except BusError as error:
            self._lose(error)

    def read(self) -> bytes:
        if self._port is None:
            self._look()
            return b""
        try:
            return self._port.read()
        except BusError as error:
            self._lose(error)
            return b""

    def fileno(self) -> int | None:
        return None if self._port is None else self._port.fileno()

    def next_arrival_ns(self) -> int | None:
        return self._next_ns if self._port is None else self._port.next_arrival_ns()

    def close(self) -> None:
        if self._port is not None:
            self._port.close()

    def _lose(self, error: BusError) -> None:
        if not self._waits():
            raise error
        assert self._port is not None
        self._port.close()
        self._port = None
        now_ns = self._clock.now_ns()
        self._next_ns = now_ns + REOPEN_NS
        self._lost(error.reason, now_ns)

    def _look(self) -> None:
        now_ns = self._clock.now_ns()
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + REOPEN_NS
        try:
            self._port = self._reopen()
        except BusError:
            return
        self._found()
