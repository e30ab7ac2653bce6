"""The server's end of the process that only stops, and that owns the latch."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from lss_motion.studio.latch import Latch, latch_file
from lss_motion.studio.stop import Latched, NewPlayer, RearmPlayers, StopPlayers
from lss_motion.system.process import ChildProcess

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Sequence

    from lss_motion.studio.latch import StopKind
    from lss_motion.studio.stop import StopSettings

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
        self.on_latch: Callable[[], None] = lambda: None
        """Called when the process has written the latch."""
        self._memory = latch_file()
        self._latch = Latch(self._memory.fileno())
        self._wish: StopPlayers | RearmPlayers | None = None
        """What was asked of the process, until it has done that."""
        self._ends: list[socket.socket] = []
        """The server's ends of the stop links of players, for a process that is started again."""
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

    @property
    def latch(self) -> StopKind | None:
        """The stop that is kept. What was asked for counts from then on."""
        match self._wish:
            case StopPlayers(kind):
                return kind
            case RearmPlayers():
                return None
        return self._latch.kind

    def stop(self, kind: StopKind) -> None:
        """Let the process stop every player, and keep that."""
        self._ask(StopPlayers("estop" if self.latch == "estop" else kind))

    def rearm(self) -> None:
        """Let players start again."""
        self._ask(RearmPlayers())

    def _ask(self, wish: StopPlayers | RearmPlayers) -> None:
        self._wish = wish
        self._child.send(wish)

    def close(self) -> None:
        """Leave the process to itself: it ends when the last player has."""
        self._is_closed = True
        self._drop_control()
        self._memory.close()
        for own in (*self._listening, *self._ends):
            own.close()
        self._ends.clear()

    def _start(self) -> None:
        filenos = [self._memory.fileno(), *(one.fileno() for one in self._listening)]
        self._child: ChildProcess[Latched] = ChildProcess(
            "lss_motion.studio.stop", *map(str, filenos), receives=Latched, inherits=filenos
        )
        asyncio.get_running_loop().add_reader(self._child.fileno(), self._read)
        self._child.send(self._settings)
        for end in self._ends:
            self._child.send_fileno(NewPlayer(), end.fileno())
        if self._wish is not None:
            self._child.send(self._wish)

    def _read(self) -> None:
        for latched in self._child.receive():
            is_done = (latched.kind is None) == isinstance(self._wish, RearmPlayers)
            self._wish = None if is_done else self._wish
            self.on_latch()
        if self._child.has_ended:
            self._drop_control()
            if not self._is_closed:
                asyncio.get_running_loop().call_later(RESTART_S, self._restart)

    def _restart(self) -> None:
        self._child.exit_code()
        if not self._is_closed:
            self._start()

    def _drop_control(self) -> None:
        if self._child.pipe.is_closed:
            return  # It has ended, and is not started again yet.
        asyncio.get_running_loop().remove_reader(self._child.fileno())
        self._child.pipe.close()
