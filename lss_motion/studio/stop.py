"""The process that only stops. Its words are the file numbers of the latch, and of its ports.

It has its own ports, knows the token, and has a link of its own to each player. So a stop arrives
where the server hangs, stands still or was killed. It lives until the server and the last player
have ended. It owns the latch: no other process writes that. A stop is kept until the server sends
`RearmPlayers`, and a player that starts meanwhile is stopped at once.

The server sends a `StopOrder`, first the settings; it gets `Latched` whenever that was written.
"""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from lss_motion.playing.remote.schema import Estop, Stop
from lss_motion.studio.access import Denied, Door, Purpose, asked_of, decide
from lss_motion.studio.entrance import STOP_SHARES, admit
from lss_motion.studio.latch import Latch, StopKind
from lss_motion.system.messages import Kind, MessagePipe, PipeClosedError, TypedPipe

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable


class StopSettings(Struct, frozen=True, tag=True):
    """What the process needs to know of the server."""

    hosts: list[str]
    origins: list[str]
    token: str
    cookie_name: str
    certificate: str | None = None
    key: str | None = None

    @property
    def door(self) -> Door:
        """What requests are compared with."""
        return Door(frozenset(self.hosts), frozenset(self.origins), self.token, self.cookie_name)


class NewPlayer(Struct, frozen=True, tag=True):
    """A player starts; the end of its link for stops comes with this."""


class StopPlayers(Struct, frozen=True, tag=True):
    """Stop every player, and keep that."""

    kind: StopKind


class RearmPlayers(Struct, frozen=True, tag=True):
    """Players may start again."""


class Latched(Struct, frozen=True, tag=True):
    """The latch was written: this is kept."""

    kind: StopKind | None


StopOrder = StopSettings | NewPlayer | StopPlayers | RearmPlayers


class Stopper:
    """The players' links, and the stop that is kept until it is armed again."""

    def __init__(self, control: MessagePipe, latch: Latch, on_end: Callable[[], None]) -> None:
        self.latch = latch
        self.settings: StopSettings | None = None
        self.has_settings = asyncio.Event()
        control.set_blocking(is_blocking=False)
        control.receives_filenos = True
        self._control: TypedPipe[StopOrder] = TypedPipe(control, StopOrder)
        self._links: list[MessagePipe] = []
        self._on_end = on_end
        asyncio.get_running_loop().add_reader(control.fileno(), self._read)

    def stop(self, kind: StopKind) -> None:
        """Stop every player, and those that start before `rearm`; tell the server."""
        self.latch.keep(kind)
        for link in self._links:
            _send(link, kind)
        self._control.send(Latched(self.latch.kind))

    def _read(self) -> None:
        """Take what the server sent; it may have ended."""
        for order in self._control.receive():
            self._obey(order)
        if self._control.has_ended:
            asyncio.get_running_loop().remove_reader(self._control.fileno())
            self._control.close()
            self._end_if_alone()

    def _obey(self, order: StopOrder) -> None:
        match order:
            case StopSettings():
                self.settings = order
                self.has_settings.set()
            case NewPlayer():
                filenos = self._control.pipe.filenos
                if filenos:
                    self._take(socket.socket(fileno=filenos.popleft()))
            case StopPlayers():
                self.stop(order.kind)
            case RearmPlayers():
                self.latch.clear()
                self._control.send(Latched(None))

    def _take(self, end: socket.socket) -> None:
        end.setblocking(False)  # noqa: FBT003
        link = MessagePipe(end)
        link.receives_filenos = True
        self._links.append(link)
        asyncio.get_running_loop().add_reader(link.fileno(), self._watch, link)
        if (kind := self.latch.kind) is not None:
            _send(link, kind)

    def _watch(self, link: MessagePipe) -> None:
        """Take the links of players that a player has started; drop that of one that has ended."""
        try:
            link.receive()
            while link.filenos:
                self._take(socket.socket(fileno=link.filenos.popleft()))
        except PipeClosedError:
            asyncio.get_running_loop().remove_reader(link.fileno())
            link.close()
            self._links.remove(link)
            self._end_if_alone()

    def _end_if_alone(self) -> None:
        if self._control.has_ended and not self._links:
            self._on_end()


def _send(link: MessagePipe, kind: StopKind) -> None:
    operation = Estop() if kind == "estop" else Stop()
    link.send(Kind.OPERATION, operation.to_json())


class StopPages:
    """The two addresses of the process, as an ASGI application: no body is read."""

    def __init__(self, stopper: Stopper, door: Door) -> None:
        self._stopper, self._door = stopper, door

    async def __call__(
        self,
        scope: dict[str, Any],
        receive: Callable[[], Awaitable[dict[str, Any]]],  # noqa: ARG002  (ASGI)
        send: Callable[[dict[str, Any]], Awaitable[None]],
    ) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        status, text = self._answer(scope)
        headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": text.encode()})

    def _answer(self, scope: dict[str, Any]) -> tuple[int, str]:
        headers = {
            name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]
        }
        if scope["path"] not in ("/stop", "/estop"):
            return 404, "only /stop and /estop are here"
        if scope["method"] != "POST":
            return 405, "a stop is a POST"
        found = decide(asked_of(Purpose.STOP, headers, self._door), self._door)
        if isinstance(found, Denied):
            return found.status, found.text
        admit(scope, found)
        self._stopper.stop("estop" if scope["path"] == "/estop" else "stop")
        return 204, ""


async def serve(control: MessagePipe, latch: Latch, listening: list[socket.socket]) -> None:
    """Serve until the server and the last player have ended."""
    from lss_motion.studio.web import LOOPBACK, Server, make_server

    servers: list[Server] = []

    def end() -> None:
        for server in servers:
            server.should_exit = True

    stopper = Stopper(control, latch, end)
    await stopper.has_settings.wait()
    settings = stopper.settings
    assert settings is not None
    for own in listening:
        is_plain = own.getsockname()[0] == LOOPBACK
        server = make_server(
            StopPages(stopper, settings.door),
            STOP_SHARES,
            certificate=None if is_plain else settings.certificate,
            key=None if is_plain else settings.key,
            has_sockets=False,
        )
        servers.append(server)
    await asyncio.gather(
        *(server.serve([own]) for server, own in zip(servers, listening, strict=True))
    )


def main(control: MessagePipe, memory: str, *words: str) -> int:
    """Serve until the server and the last player have ended; return an exit code.

    The server ends it, and it outlives the server: signals do nothing (`reactor.begin`).
    """
    listening = [socket.socket(fileno=int(word)) for word in words]
    asyncio.run(serve(control, Latch(int(memory)), listening))
    return 0
