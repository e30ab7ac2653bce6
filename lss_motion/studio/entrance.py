"""Who may be connected to a server: strangers are few and in a hurry, roles have shares.

A connection is a stranger's until a request proves a role. No stranger takes what an operator
needs: there are few of them, the one that waits longest makes room for the next, and each is
dropped after a second without a request. A client that does not read what it is sent is dropped.
Where the process has no file number left, strangers go first.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from lss_motion.files.texts import escaped
from lss_motion.studio.access import Role

if TYPE_CHECKING:
    import socket
    import ssl
    from collections.abc import Awaitable, Callable, MutableMapping

    Scope = MutableMapping[str, Any]

Shares = dict[Role | None, int]
"""Connections at once by role; None: strangers."""
PAGES_SHARES: Final[Shares] = {None: 32, Role.VIEW: 96, Role.OPERATE: 96, Role.EDIT: 96}
"""Connections at once, to one address of the server. Chosen: a browser opens six; with two
addresses all of them are less than the 1,024 file numbers that a process usually has."""
STOP_SHARES: Final[Shares] = {None: 16, Role.VIEW: 64, Role.OPERATE: 64, Role.EDIT: 64}
STRANGER_S: Final = 1.0
"""A stranger that has sent no whole request, or the next one, for so long is dropped. Chosen: a
slow network takes a third of it for the handshake of TLS."""
ANSWER_S: Final = 10.0
"""The longest time that a stranger may take for one request: a page on a slow network."""
UNREAD_MAX_BYTES: Final = 1 << 20
"""A websocket on which more waits is dropped. Chosen: what `client.EVENTS_MAX` events need."""
STALLED_S: Final = 10.0
"""A connection of which nothing left for so long is dropped."""
ACCEPTS_MAX: Final = 64
"""Connections that are taken in one turn of the loop: a stop that arrived is not delayed."""
AGAIN_S: Final = 0.2
"""After so long it is tried again where the system had no file number."""


@dataclass(slots=True)
class _OpenConnection:
    """One connection."""

    task: asyncio.Task[None] | None = None
    """While TLS is agreed on."""
    transport: asyncio.Transport | None = None
    role: Role | None = None
    """None: it is a stranger's."""
    until_s: float = math.inf
    """When a stranger is dropped."""
    since_s: float = 0.0
    is_answered: bool = False
    """Whether it has a request that is being answered."""
    is_socket: bool = False
    unread_bytes: int = 0
    unread_s: float = 0.0
    """How much waited when last something left, and when that was."""

    @property
    def is_gone(self) -> bool:
        is_connecting = self.task is not None and not self.task.done()
        return not is_connecting and (self.transport is None or self.transport.is_closing())

    def drop(self) -> None:
        """Close it at once; what waits is lost."""
        if self.task is not None:
            self.task.cancel()
        if self.transport is not None:
            self.transport.abort()


class Entrance:
    """Accepts the connections of one listening socket, and is the application before its own."""

    def __init__(self, app: Any, shares: Shares) -> None:  # noqa: ANN401  (ASGI)
        self._app, self._shares = app, shares
        self._places: list[_OpenConnection] = []
        self._make_protocol: Callable[[], asyncio.Protocol] = asyncio.Protocol
        self._tls: ssl.SSLContext | None = None
        self._listening: socket.socket | None = None
        self._again: asyncio.TimerHandle | None = None

    # ---- the socket

    def open(
        self,
        listening: socket.socket,
        make_protocol: Callable[[], asyncio.Protocol],
        tls: ssl.SSLContext | None,
    ) -> None:
        """Accept what comes to `listening` from now on."""
        self._listening, self._make_protocol, self._tls = listening, make_protocol, tls
        asyncio.get_running_loop().add_reader(listening, self._accept)

    def close(self) -> None:
        """Accept nothing more; strangers are dropped."""
        if self._listening is not None:
            asyncio.get_running_loop().remove_reader(self._listening)
        if self._again is not None:
            self._again.cancel()
        self._listening = None
        for place in self._places:
            if place.role is None and not place.is_answered:
                place.drop()

    def _accept(self) -> None:
        assert self._listening is not None
        for _ in range(ACCEPTS_MAX):
            try:
                connection, _ = self._listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError:  # No file number, or no memory: whoever is known keeps what it has.
                self._rest(self._listening)
                return
            self._take(connection)

    def _rest(self, listening: socket.socket) -> None:
        """Drop all strangers, and accept again a little later."""
        loop = asyncio.get_running_loop()
        for place in self._places:
            if place.role is None:
                place.drop()
        loop.remove_reader(listening)
        self._again = loop.call_later(AGAIN_S, lambda: loop.add_reader(listening, self._accept))

    def _take(self, connection: socket.socket) -> None:
        connection.setblocking(False)  # noqa: FBT003
        now_s = time.monotonic()
        place = _OpenConnection(since_s=now_s, until_s=now_s + STRANGER_S)
        self._places.append(place)
        self._make_room(None)
        place.task = asyncio.get_running_loop().create_task(self._connect(place, connection))
        place.task.add_done_callback(
            lambda _: None if place.transport is not None else connection.close()
        )

    async def _connect(self, place: _OpenConnection, connection: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        limit_s = None if self._tls is None else STRANGER_S
        with contextlib.suppress(OSError):
            place.transport, _ = await loop.connect_accepted_socket(
                self._make_protocol,
                connection,
                ssl=self._tls,
                ssl_handshake_timeout=limit_s,
                ssl_shutdown_timeout=limit_s,
            )

    # ---- connections

    def _make_room(self, role: Role | None) -> None:
        """Drop the connection with a role that has waited longest, if there are too many."""
        self._places = [place for place in self._places if not place.is_gone or place.task is None]
        own = [place for place in self._places if place.role is role]
        if len(own) > self._shares[role]:
            min(own, key=lambda place: (place.is_answered, place.is_socket, place.since_s)).drop()

    def look(self) -> None:
        """Drop connections that are late, or not read; called ten times a second."""
        now_s = time.monotonic()
        self._places = [place for place in self._places if not place.is_gone]
        for place in self._places:
            if now_s > place.until_s or self._is_stalled(place, now_s):
                place.drop()

    def _is_stalled(self, place: _OpenConnection, now_s: float) -> bool:
        """Return whether nothing leaves of what waits, or a websocket has too much."""
        if place.transport is None:
            return False
        unread_bytes = place.transport.get_write_buffer_size()
        if not unread_bytes or unread_bytes < place.unread_bytes:
            place.unread_s = now_s
        place.unread_bytes = unread_bytes
        if place.is_socket and unread_bytes > UNREAD_MAX_BYTES:
            return True
        return bool(unread_bytes) and now_s - place.unread_s > STALLED_S

    async def __call__(
        self,
        scope: Scope,
        receive: Callable[[], Awaitable[dict[str, Any]]],
        send: Callable[[dict[str, Any]], Awaitable[None]],
    ) -> None:
        """Pass a request on; `admit` notes the role that it proves."""
        place = self._place_of(scope)
        if place is None:
            await self._app(scope, receive, send)
            return
        scope["admit"] = lambda role: self._admit(place, role)
        place.is_socket = scope["type"] == "websocket"
        place.is_answered, place.until_s = True, _until_s(place, ANSWER_S)
        try:
            await self._app(scope, receive, send)
        finally:
            place.is_answered, place.until_s = False, _until_s(place, STRANGER_S)
            place.since_s = time.monotonic()

    def _place_of(self, scope: Scope) -> _OpenConnection | None:
        wanted = scope.get("client")
        for place in self._places:
            if place.transport is not None:
                peer = place.transport.get_extra_info("peername") or ("", 0)
                if wanted is not None and (str(peer[0]), int(peer[1])) == tuple(wanted):
                    return place
        return None

    def _admit(self, place: _OpenConnection, role: Role) -> None:
        """Note that a connection has proved a role."""
        if place.role is not role:
            place.role, place.until_s = role, math.inf
            self._make_room(role)


def admit(scope: Scope, role: Role) -> None:
    """Note that a request has proved a role, where it came through an `Entrance`."""
    if (note := scope.get("admit")) is not None:
        note(role)


def _until_s(place: _OpenConnection, left_s: float) -> float:
    return time.monotonic() + left_s if place.role is None else math.inf


# ---- what is logged about connections

EACH_S: Final = 60.0
CAUSES_MAX: Final = 100


class _OnceInAWhile(logging.Filter):
    """Lets one line of each cause pass in `EACH_S`: who floods does not fill a disk."""

    def __init__(self) -> None:
        super().__init__()
        self._last_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        now_s, cause = time.monotonic(), f"{record.name} {record.msg}"[:80]
        if len(self._last_s) >= CAUSES_MAX and cause not in self._last_s:
            cause = ""
        if now_s - self._last_s.get(cause, -math.inf) < EACH_S:
            return False
        self._last_s[cause] = now_s
        return True


class _OneLine(logging.Formatter):
    """One line without a traceback; nothing that came from a network steers a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        error = record.exc_info[1] if record.exc_info else None
        why = "" if error is None else f": {type(error).__name__}: {error}"
        first = f"{record.getMessage()}{why}".partition("\n")[0]
        return f"network: {escaped(first)}"


def log_briefly() -> None:
    """Let what the libraries of a server say about connections be one line, once in a while."""
    handler = logging.StreamHandler()
    handler.addFilter(_OnceInAWhile())
    handler.setFormatter(_OneLine())
    for name in ("uvicorn.error", "asyncio"):
        logger = logging.getLogger(name)
        logger.handlers, logger.propagate = [handler], False
