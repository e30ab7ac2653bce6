"""Listening sockets, and uvicorn as both of our servers use it."""

from __future__ import annotations

import contextlib
import errno
import json
import socket
import sys
from typing import TYPE_CHECKING, Any, Final

import uvicorn
from msgspec import Struct
from starlette.requests import ClientDisconnect

from lss_motion.errors import InputError
from lss_motion.playing.remote.schema import EDIT_MAX_BYTES
from lss_motion.studio.entrance import Entrance, log_briefly

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterator

    from starlette.requests import Request

    from lss_motion.studio.entrance import Shares

LOOPBACK: Final = "127.0.0.1"
FRAME_MAX_BYTES: Final = 2 * EDIT_MAX_BYTES
"""The largest message of a client: an edit, with some room to refuse a larger one in words."""
BODY_MAX_BYTES: Final = 4096
"""The largest body of a request: a token has 43 characters, an operation less than 200."""
FRAMES_MAX: Final = 4
"""Messages of a client that wait; then its connection is not read. Chosen: 64 clients that send the
largest ones are 128 MB."""
_IP_FREEBIND: Final = 15
"""Linux, ip(7)."""
CLOSE_S: Final = 2
"""An answer that is not finished at the end is given up after this time."""


class Address(Struct, frozen=True):
    """Where a server listens, and what its clients call it."""

    host: str
    port: int
    is_tls: bool

    @property
    def name(self) -> str:
        """What stands in `Host`."""
        default = 443 if self.is_tls else 80
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == default else f"{host}:{self.port}"

    @property
    def origin(self) -> str:
        """What stands in `Origin`."""
        return f"{'https' if self.is_tls else 'http'}://{self.name}"

    @property
    def socket_origin(self) -> str:
        """The origin of its websocket."""
        return f"{'wss' if self.is_tls else 'ws'}://{self.name}"


def listen(host: str, port: int, *, is_early: bool = False) -> socket.socket:
    """Return a socket that listens; raises `InputError` that says what to do.

    With `is_early` the computer may get the address later, as from a network after it has started.
    """
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError):
        raise InputError(f"--listen {host}: no such address; {_has()}") from None
    own = socket.socket(family, socket.SOCK_STREAM)
    own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if is_early and sys.platform.startswith("linux"):
        own.setsockopt(socket.IPPROTO_IP, _IP_FREEBIND, 1)
    try:
        own.bind(place)
        own.listen(128)
    except OSError as error:
        own.close()
        raise InputError(f"--listen {host}:{port}: {_remedy(error)}") from None
    own.setblocking(False)  # noqa: FBT003
    return own


def _remedy(error: OSError) -> str:
    match error.errno:
        case errno.EADDRINUSE:
            return "another program listens there; give another port, or none"
        case errno.EACCES | errno.EPERM:
            return "ports below 1024 belong to the system; give one above"
        case errno.EADDRNOTAVAIL:
            return f"is no address of this computer; {_has()}"
        case _:
            return error.strerror or str(error)


def _has() -> str:
    return f"this computer has {', '.join(own_addresses())}"


def own_addresses() -> list[str]:
    """Return the addresses of this computer; that of its way to the network comes first."""
    found = []
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # Sends nothing: it only chooses a route.
        found.append(str(probe.getsockname()[0]))
    with contextlib.suppress(OSError):
        found += sorted(str(one[4][0]) for one in socket.getaddrinfo(socket.gethostname(), None))
    return list(dict.fromkeys([*found, LOOPBACK]))


class Server(uvicorn.Server):
    """A server that leaves signals to its program, and connections to its `Entrance`."""

    def __init__(self, config: uvicorn.Config, entrance: Entrance) -> None:
        super().__init__(config)
        self._entrance = entrance

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Change no signal handler."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve one socket."""
        await super().startup(sockets=[])
        assert sockets is not None
        (own,) = sockets
        config, state = self.config, self.server_state

        def make_protocol() -> asyncio.Protocol:
            make: Any = config.http_protocol_class
            made: asyncio.Protocol = make(
                config=config, server_state=state, app_state=self.lifespan.state
            )
            return made

        self._entrance.open(own, make_protocol, config.ssl)

    async def on_tick(self, counter: int) -> bool:
        """Look after the connections; return whether to end."""
        self._entrance.look()
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End what is served."""
        self._entrance.close()
        await super().shutdown(sockets)


def make_server(
    app: Any,  # noqa: ANN401  (an ASGI application)
    shares: Shares,
    *,
    certificate: str | None = None,
    key: str | None = None,
    has_sockets: bool = True,
) -> Server:
    """Return a server for one listening socket, with TLS if there is a certificate."""
    log_briefly()
    entrance = Entrance(app, shares)
    return Server(
        uvicorn.Config(
            entrance,
            ssl_certfile=certificate,
            ssl_keyfile=key,
            http="h11",
            ws="websockets-sansio" if has_sockets else "none",
            ws_max_size=FRAME_MAX_BYTES,
            ws_max_queue=FRAMES_MAX,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            timeout_graceful_shutdown=CLOSE_S,
        ),
        entrance,
    )


async def json_body(request: Request) -> dict[str, Any]:
    """Return the JSON object of a body; an empty one for whatever else it is, or is cut off."""
    body = b""
    with contextlib.suppress(ClientDisconnect):
        async for part in request.stream():
            body += part
            if len(body) > BODY_MAX_BYTES:
                return {}
    try:
        value = json.loads(body)
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}
