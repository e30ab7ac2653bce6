"""One running studio: what it is made of, and what the routes ask of it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field

from lss_motion import __version__
from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.studio.access import (
    CODE_VALID_S,
    ROLE_NAMES,
    Denied,
    Door,
    Pairing,
    Role,
    new_token,
)
from lss_motion.studio.desk import Desk, DeskOptions
from lss_motion.studio.document import Document
from lss_motion.studio.hub import Hub
from lss_motion.studio.planner import Request
from lss_motion.studio.planning import Planner
from lss_motion.studio.stop import StopSettings
from lss_motion.studio.stopping import StopProcess
from lss_motion.studio.uploads import Uploads
from lss_motion.studio.web import LOOPBACK, Address, own_addresses

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from socket import socket

    from starlette.requests import HTTPConnection

    from lss_motion.studio.access import RoleName
    from lss_motion.studio.client import Client
    from lss_motion.studio.planner import PlannerReply


class StudioOptions(Struct, frozen=True, kw_only=True):
    """What `lss-motion studio` was given."""

    path: Path
    robot_path: Path | None = None
    backup: Path | None = None
    port: str | None = None
    listen_host: str | None = None
    """A further address of this computer, for clients on the network."""
    listen_port: int = 0
    certificate: str | None = None
    key: str | None = None
    token: str | None = None
    """The secret of this server; None: a new one."""
    views: Path | None = None
    """Folder for the views of the shows of a stage."""
    figure: str | None = None
    """Of a stage with several: that of this computer, which conducts."""
    is_early: bool = False
    """Listen on an address that this computer does not have yet."""
    desk: DeskOptions = field(default_factory=DeskOptions)


class Studio:
    """One running studio; made inside of a running loop."""

    def __init__(self, options: StudioOptions, sockets: Sequence[StudioAddress]) -> None:
        self.addresses = [one.address for one in sockets]
        self.stop_addresses = [one.stop_address for one in sockets]
        port = self.addresses[0].port
        origins = frozenset(address.origin for address in self.addresses)
        hosts = frozenset(address.name for address in self.addresses)
        token = options.token or new_token()
        self.door = Door(hosts, origins, token, f"lss_studio_{port}")
        self.pairing = Pairing()
        self.hub = Hub(self._welcome)
        settings = StopSettings(
            hosts=[address.name for address in self.stop_addresses],
            origins=sorted(origins),
            token=self.door.token,
            cookie_name=self.door.cookie_name,
            certificate=options.certificate,
            key=options.key,
        )
        self.stops = StopProcess(settings, [one.stop_socket for one in sockets])
        self.desk = Desk(self.hub, self.stops, options.desk)
        self.hub.desk = self.desk
        self.planner = Planner(self._planned, self.desk.note_trial, self.desk.note_splice)
        self.desk.splice = self.planner.splice
        self.document = self.desk.document = Document(
            Request(
                number=0,
                path=options.path,
                robot_path=options.robot_path,
                backup=options.backup,
                port=options.port,
                views=options.views,
                figure=options.figure,
            ),
            self.planner.ask,
            self._document_changed,
            self.planner.try_edit,
        )
        self.desk.pair = self._pair
        self.uploads = Uploads(lambda: self.document, options.backup)

    @property
    def url(self) -> str:
        """The address that a person opens at this computer."""
        return f"{self.addresses[0].origin}/#token={self.door.token}"

    @property
    def is_network_readable(self) -> bool:
        """Whether others on the network can read along."""
        return any(one.host != LOOPBACK and not one.is_tls for one in self.addresses)

    def now_s(self) -> float:
        """Return the time of the server's clock."""
        return time.monotonic()

    def admit(self, given: dict[str, Any]) -> Role | Denied:
        """Return the role for a token or a code."""
        token, code = given.get("token"), given.get("code")
        if isinstance(code, str) and code.isascii():
            return self.pairing.give(code, self.now_s())
        if isinstance(token, str) and token.isascii() and self.door.is_token(token):
            return Role.EDIT
        return Denied(401, "this token is not ours; open the address that the server printed")

    def name_of(self, connection: HTTPConnection, role: Role) -> str:
        """Return what other clients call this one."""
        host = "" if connection.client is None else connection.client.host
        where = "the computer of the robot" if host == LOOPBACK else host or "a client"
        return f"{where} ({role.word})"

    def safety_headers(self, scope: Any) -> list[tuple[bytes, bytes]]:  # noqa: ANN401  (ASGI)
        """Return the headers of every answer: only our own program, only our own addresses."""
        place = self.place_of(dict(scope["headers"]).get(b"host", b"").decode("latin-1"))
        own, stop = self.addresses[place], self.stop_addresses[place]
        policy = (
            f"default-src 'self'; connect-src 'self' {own.socket_origin} {stop.origin}; "
            "img-src 'self' data: blob:; object-src 'none'; base-uri 'none'; form-action 'none'; "
            "frame-ancestors 'none'"
        )
        headers = {
            "content-security-policy": policy,
            "x-content-type-options": "nosniff",
            "referrer-policy": "no-referrer",
            "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
        }
        return [(name.encode(), value.encode()) for name, value in headers.items()]

    def place_of(self, host: str) -> int:
        """Return which of the addresses a request named."""
        return next((i for i, one in enumerate(self.addresses) if one.name == host), 0)

    def make_code(self, role: RoleName) -> str:
        """Return a new pairing code; the one before is void."""
        return self.pairing.open(Role(ROLE_NAMES.index(role)), self.now_s())

    def tick(self) -> None:
        """Tell the clients that the server is alive."""
        self.hub.beat(self.now_s())

    def close(self) -> None:
        """End the planner, and leave the stop process to itself."""
        self.document.close()
        self.planner.close()
        self.uploads.close()
        self.stops.close()

    def _pair(self, role: RoleName) -> m.PairingCode:
        urls = tuple(f"{one.origin}/" for one in self.addresses if one.host != LOOPBACK)
        if not urls:
            own = next((one for one in own_addresses() if one != LOOPBACK), "ADDRESS")
            how = (
                f"write listen: {{http: '{own}:8000'}} into the stage file and start it again"
                if self.document.runs_stage
                else f"end it (Ctrl-C), then: lss-motion studio {self.document.path.name} "
                f"--listen {own}"
            )
            raise InputError(
                f"a tablet cannot come here yet, since this computer alone is listened to; {how}"
            )
        code = self.make_code(role)
        return m.PairingCode(code=code, role=role, valid_s=CODE_VALID_S, urls=urls)

    def _planned(self, reply: PlannerReply) -> None:
        self.document.take(reply)

    def _document_changed(self) -> None:
        if self.desk.document is not None:  # Not while it is made.
            self.desk.document_changed()

    def _welcome(self, client: Client) -> m.Welcome:
        newest = self.document.newest
        return m.Welcome(
            client=client.number,
            role=client.role.word,
            stop_origin=self._stop_origin(client),
            version=__version__,
            file=self.document.path.name,
            kind=newest.kind,
            title=newest.title,
            is_network_readable=self.is_network_readable,
        )

    def _stop_origin(self, client: Client) -> str:
        return self.stop_addresses[client.place].origin


class StudioAddress(Struct, frozen=True):
    """One address: the socket of the pages, and that of the stop process."""

    address: Address
    own_socket: socket
    stop_address: Address
    stop_socket: socket
