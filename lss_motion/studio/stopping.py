"""The server's end of the process that only stops."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from lss_motion.studio.stop import Latch, NewPlayer, Rearm
from lss_motion.system.process import ChildProcess

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Sequence

    from lss_motion.studio.stop import StopKind, StopSettings

RESTART_S: Final = 1.0
"""A stop process that ends is started again after this time."""


class StopProcess:
    """Starts the stop process, gives it a link to each player, and learns of its stops."""

    def __init__(
        self,
        settings: StopSettings,
        listening: Sequence[socket.socket],
    ) -> None:
        """Start the process on these listening sockets, which stay open here for a restart."""
        self._settings = settings
        self._listening = list(listening)
        self.on_latch: Callable[[StopKind], None] = lambda _: None
        """Called for a stop that the process has carried out."""
        self._ends: list[socket.socket] = []
        """The server's ends of the stop links of players, for a process that is started again."""
        self._latch: StopKind | None = None
        self._is_closed = False
        self._start()

    @property
    def pid(self) -> int:
        return self._child.pid

    def add_player(self, end: socket.socket) -> None:
        """Give the process the end of a link to a player, before that player starts."""
        self._ends.append(end)
        self._child.send_fileno(NewPlayer(), end.fileno())

    def drop_player(self, end: socket.socket) -> None:
        """Forget the link of a player that has ended."""
        self._ends.remove(end)
        end.close()

    def latch(self, kind: StopKind) -> None:
        """Let the process keep a stop that came another way."""
        self._latch = kind
        self._child.send(Latch(kind))

    def rearm(self) -> None:
        """Let players start again."""
        self._latch = None
        self._child.send(Rearm())

    def close(self) -> None:
        """Leave the process to itself: it ends when the last player has."""
        self._is_closed = True
        self._drop_control()
        for own in (*self._listening, *self._ends):
            own.close()
        self._ends.clear()

    def _start(self) -> None:
        filenos = [one.fileno() for one in self._listening]
        self._child: ChildProcess[Latch] = ChildProcess(
            "lss_motion.studio.stop", *map(str, filenos), receives=Latch, inherits=filenos
        )
        asyncio.get_running_loop().add_reader(self._child.fileno(), self._read)
        self._child.send(self._settings)
        for end in self._ends:
            self._child.send_fileno(NewPlayer(), end.fileno())
        if self._latch is not None:
            self._child.send(Latch(self._latch))

    def _read(self) -> None:
        for latch in self._child.receive():
            self._latch = latch.kind
            self.on_latch(latch.kind)
        if self._child.has_ended:
            self._drop_control()
            if not self._is_closed:
                asyncio.get_running_loop().call_later(RESTART_S, self._restart)

    def _restart(self) -> None:
        self._child.exit_code()
        if not self._is_closed:
            self._start()

    def _drop_control(self) -> None:
        asyncio.get_running_loop().remove_reader(self._child.fileno())
        self._child.pipe.close()
