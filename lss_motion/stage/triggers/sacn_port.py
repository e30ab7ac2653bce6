"""The sACN port: joins the universes that cues name, and sends what crosses a threshold."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import sys
from typing import TYPE_CHECKING, Any, Final

from lss_motion.playing.remote import stage_messages as stage
from lss_motion.stage.triggers.sacn import PORT, Levels, SacnError, group_of, packet_of

if TYPE_CHECKING:
    from lss_motion.stage.triggers.sources import Gate, Sink


_IP_MULTICAST_ALL: Final = 49
"""Linux, ip(7): 0 keeps packets away of groups that other programs have joined."""


class SacnPort(asyncio.DatagramProtocol):
    """The UDP port of sACN on the network of one address of this computer.

    With an address of the loopback only packets to that address are received, and no group is
    joined.
    """

    def __init__(self, host: str, gate: Gate, sink: Sink, *, port: int = PORT) -> None:
        self.gate = gate
        self._host, self._port, self._sink = host, port, sink
        self._levels = Levels({})
        self._socket: socket.socket | None = None
        self._transport: asyncio.BaseTransport | None = None

    async def open(self) -> None:
        """Open the port; raises `OSError`."""
        own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if sys.platform.startswith("linux"):
                own.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            # Packets to a group reach only a socket that is bound to no address of its own.
            own.bind((self._host if self._is_loopback else "", self._port))
            own.setblocking(False)  # noqa: FBT003
            self._socket = own
            self._join(self._levels.universes)
        except OSError:
            own.close()
            raise
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, sock=own)

    def watch(self, levels: Levels) -> None:
        """Watch these slots from now on; raises `OSError` where a group cannot be joined."""
        before, after = set(self._levels.universes), set(levels.universes)
        self._levels = levels
        if self._socket is not None:
            self._leave(before - after)
            self._join(after - before)

    def close(self) -> None:
        """Close the port."""
        if self._transport is not None:
            self._transport.close()

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Take the levels of a packet."""
        now_s, host = asyncio.get_running_loop().time(), str(addr[0])
        if not self.gate.admits(host, now_s):
            return
        try:
            packet = packet_of(data)
        except SacnError as error:
            self.gate.complaints.add(f"{error} (from {host})", now_s)
            return
        if packet is None:
            return
        for address, level in self._levels.take(packet, now_s):
            operation = stage.Trigger(kind="sacn", address=address, value=level)
            self._sink(operation, f"sACN {address} from {host}")

    @property
    def _is_loopback(self) -> bool:
        return ipaddress.ip_address(self._host).is_loopback

    def _join(self, universes: tuple[int, ...] | set[int]) -> None:
        assert self._socket is not None
        for universe in () if self._is_loopback else universes:
            self._socket.setsockopt(
                socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, self._request(universe)
            )

    def _leave(self, universes: set[int]) -> None:
        assert self._socket is not None
        for universe in () if self._is_loopback else universes:
            with contextlib.suppress(OSError):
                self._socket.setsockopt(
                    socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, self._request(universe)
                )

    def _request(self, universe: int) -> bytes:
        return socket.inet_aton(group_of(universe)) + socket.inet_aton(self._host)
