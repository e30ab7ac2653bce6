"""The server's end of the process that only stops."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict

from lss_motion.studio.planning import start_module

if TYPE_CHECKING:
    import subprocess
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
        self._inbox = b""
        self._is_closed = False
        self._start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def add_player(self, end: socket.socket) -> None:
        """Give the process the end of a link to a player, before that player starts."""
        self._ends.append(end)
        self._send({"player": True}, [end])

    def drop_player(self, end: socket.socket) -> None:
        """Forget the link of a player that has ended."""
        self._ends.remove(end)
        end.close()

    def latch(self, kind: StopKind) -> None:
        """Let the process keep a stop that came another way."""
        self._latch = kind
        self._send({"latch": kind})

    def rearm(self) -> None:
        """Let players start again."""
        self._latch = None
        self._send({"rearm": True})

    def close(self) -> None:
        """Leave the process to itself: it ends when the last player has."""
        self._is_closed = True
        self._drop_control()
        for own in (*self._listening, *self._ends):
            own.close()
        self._ends.clear()

    @property
    def process(self) -> subprocess.Popen[bytes]:
        return self._process

    def _start(self) -> None:
        self._control, other = socket.socketpair()
        self._control.setblocking(False)  # noqa: FBT003
        with other:
            filenos = [one.fileno() for one in (other, *self._listening)]
            self._process = start_module("lss_motion.studio.stop", filenos)
        asyncio.get_running_loop().add_reader(self._control.fileno(), self._read)
        self._send(asdict(self._settings))
        for end in self._ends:
            self._send({"player": True}, [end])
        if self._latch is not None:
            self._send({"latch": self._latch})

    def _send(self, order: dict[str, object], ends: Sequence[socket.socket] = ()) -> None:
        data = json.dumps(order).encode() + b"\n"
        with contextlib.suppress(OSError):  # Gone, or it stands still: stops go through the server.
            socket.send_fds(self._control, [data], [end.fileno() for end in ends])

    def _read(self) -> None:
        try:
            data = self._control.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop_control()
            if not self._is_closed:
                asyncio.get_running_loop().call_later(RESTART_S, self._restart)
            return
        *lines, self._inbox = (self._inbox + data).split(b"\n")
        for line in lines:
            self._latch = json.loads(line)["latch"]
            assert self._latch is not None
            self.on_latch(self._latch)

    def _restart(self) -> None:
        self._process.poll()
        if not self._is_closed:
            self._inbox = b""
            self._start()

    def _drop_control(self) -> None:
        asyncio.get_running_loop().remove_reader(self._control.fileno())
        self._control.close()
