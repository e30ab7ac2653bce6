"""sACN (ANSI E1.31): packets to levels, levels to crossings of the thresholds of cues; the port.

A level is a cue like a button, and never scales a joint. Read here, not by the library `sacn` 1.11:
that one fills a packet that is cut with levels of 0, fails where a desk has a name that is no
UTF-8, and receives in a thread of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import struct
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.remote import stage_messages as stage
from lss_motion.stage.triggers.sources import Crossings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.stage.triggers.sources import Gate, Sink

PORT: Final = 5568
PACKET_MAX_BYTES: Final = 1144
"""The longest of the standard: universe discovery."""
LOST_S: Final = 2.5
"""A source that sends nothing for so long is lost (E1.31 6.7.1)."""
SEQUENCE_BACK: Final = 20
"""A sequence number less than so many behind is of a packet that was overtaken (E1.31 6.7.2)."""
SOURCES_MAX: Final = 8
"""Sources of one universe that are told apart."""
HYSTERESIS: Final = 8.0
"""Counts below a threshold at which it can be crossed again. Chosen: a fader in the hand trembles
by one or two."""
RATE_HZ: Final = 2000.0
"""Packets of one sender that are looked at: 45 universes at the 44 a second of DMX."""
SLOTS: Final = 512
_HEAD: Final = struct.pack(">HH12s", 0x10, 0, b"ASC-E1.17\0\0\0")
_LAYOUT: Final = struct.Struct(">16sHI16sHI64sBHBBHHBBHHH")
_ROOT_DATA: Final = 4
_FRAME_DATA: Final = 2
_SET_PROPERTY: Final = (2, 0xA1, 0, 1)
_PREVIEW: Final = 0x80
_TERMINATED: Final = 0x40


class Packet(Struct, frozen=True):
    """The levels of one universe from one source."""

    source: bytes
    """Identity of the sender (CID)."""
    universe: int
    priority: int
    sequence: int
    is_terminated: bool
    levels: bytes


def packet_of(data: bytes) -> Packet | None:
    """Return the levels of a packet; None: it carries none. Raises `InputError` for other data."""
    if len(data) > PACKET_MAX_BYTES or not data.startswith(_HEAD):
        raise InputError("a packet that is no sACN is ignored")
    if len(data) < _LAYOUT.size:
        raise InputError("an sACN packet that is cut is ignored")
    found = _LAYOUT.unpack_from(data)
    _, _, root, source, _, frame, _, priority, _, sequence, options, universe, *rest = found
    if root != _ROOT_DATA or frame != _FRAME_DATA or options & _PREVIEW:
        return None  # Discovery, synchronisation, or a picture of what is not on stage.
    _, *property_, count = rest
    if tuple(property_) != _SET_PROPERTY or not 1 <= count <= SLOTS + 1:
        raise InputError("an sACN packet of another kind is ignored")
    values = data[_LAYOUT.size : _LAYOUT.size + count]
    if len(values) < count or not 1 <= universe <= 63999 or priority > 200:
        raise InputError("an sACN packet that is cut is ignored")
    if values[0] != 0:
        return None  # Another start code: these are no levels.
    is_terminated = bool(options & _TERMINATED)
    return Packet(source, universe, priority, sequence, is_terminated, values[1:])


def group_of(universe: int) -> str:
    """Return the multicast address of a universe."""
    return f"239.255.{universe >> 8}.{universe & 0xFF}"


def address_of(universe: int, slot: int) -> str:
    """Return the address of a slot, as triggers have it."""
    return f"{universe}/{slot}"


@dataclass(slots=True)
class _SacnSource:
    priority: int
    sequence: int
    heard_s: float
    levels: bytes


class Levels:
    """Levels of the slots that cues wait for. Knows no clock and no socket.

    Of several sources those with the highest priority count; of these the highest level.
    """

    def __init__(self, thresholds: Mapping[str, Iterable[float]]) -> None:
        own = {address: tuple(values) for address, values in thresholds.items()}
        self._crossings = Crossings(own, hysteresis=HYSTERESIS, is_state=True)
        self._slots: dict[int, list[int]] = {}
        for address in own:
            universe, slot = map(int, address.split("/"))
            self._slots.setdefault(universe, []).append(slot)
        self._sources: dict[int, dict[bytes, _SacnSource]] = {one: {} for one in self._slots}

    @property
    def universes(self) -> tuple[int, ...]:
        return tuple(self._slots)

    def take(self, packet: Packet, now_s: float) -> list[tuple[str, float]]:
        """Return the addresses whose level crosses a threshold, with the level."""
        sources = self._sources.get(packet.universe)
        if sources is None:
            return []
        self._drop_silent(packet.universe, now_s)
        known = sources.get(packet.source)
        if known is not None and -SEQUENCE_BACK < _behind(packet.sequence, known.sequence) <= 0:
            return []
        if packet.is_terminated:
            sources.pop(packet.source, None)
        elif known is None and len(sources) >= SOURCES_MAX:
            return []
        else:
            sources[packet.source] = _SacnSource(
                packet.priority, packet.sequence, now_s, packet.levels
            )
        return self._changes(packet.universe)

    def _changes(self, universe: int) -> list[tuple[str, float]]:
        sources = self._sources[universe].values()
        top = max((one.priority for one in sources), default=0)
        best = [one.levels for one in sources if one.priority == top]
        found = []
        for slot in self._slots[universe]:
            address = address_of(universe, slot)
            if not best:
                self._crossings.forget(address)
                continue
            level = float(max(own[slot - 1] if slot <= len(own) else 0 for own in best))
            if self._crossings.take(address, level):
                found.append((address, level))
        return found

    def _drop_silent(self, universe: int, now_s: float) -> None:
        """Forget sources that were silent for too long; without one the next level is a first."""
        sources = self._sources[universe]
        for name, one in list(sources.items()):
            if now_s - one.heard_s > LOST_S:
                del sources[name]
        if not sources:
            for slot in self._slots[universe]:
                self._crossings.forget(address_of(universe, slot))


def _behind(new: int, old: int) -> int:
    """Return by how much a sequence number is ahead of another, from −128 to 127."""
    return (new - old + 128) % 256 - 128


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
        packet = self.gate.tried(lambda: packet_of(data), host, now_s)
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
