"""Open Sound Control: bytes to messages, messages to operations, values to bytes, and the UDP port.

`/lss/state` is answered to its sender. `/lss/subscribe [PORT] [HZ]` lets the sender get
`/lss/joint/NAME`, `/lss/state` and `/lss/event` for a minute; it repeats that while it wants more.
Nothing is ever sent to another address than that of the sender, or those of the stage file.

Bundles are split here: the parser of python-osc 1.10 never returns from one with an element of a
negative length, and ends with `RecursionError` in one that is nested deeply. Messages are its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import struct
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final, cast

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.stage.triggers.sources import DEEDS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from collections.abc import Set as AbstractSet

    from lss_motion.stage.triggers.sources import Crossings, Gate, Sink

PACKET_MAX_BYTES: Final = 1500
"""A packet of one Ethernet frame. Ours have less than 100 bytes."""
DEPTH_MAX: Final = 4
"""Bundles in bundles. Chosen: senders nest none at all."""
MESSAGES_MAX: Final = 64
"""Messages of one packet."""
IMMEDIATELY: Final = 1
"""The time tag of what is to be done at once (OSC 1.0)."""
NTP_TO_UNIX_S: Final = 2_208_988_800
"""From 1900, where time tags begin, to 1970."""
AHEAD_MAX_S: Final = 600.0
"""A message for a later time is refused: the clocks of the computers are not in step."""
_HEAD: Final = b"#bundle\0"
_TAGS: Final = frozenset(b"ifsbhdtTFNIrm[]")
"""Types of arguments that python-osc knows; of others it would write to the log of the program."""

NAMED: Final = {"cue": ("cue", "label"), "arm": ("arm", "cue"), "show": ("stage.play", "show")}
"""Operations with a name: `/lss/cue/NAME`, or `/lss/cue NAME`."""


class OscMessage(Struct, frozen=True):
    """An address with its arguments. `at_s`: when it is to be carried out, Unix time; None: now."""

    address: str
    arguments: tuple[Any, ...] = ()
    at_s: float | None = None


def messages_of(data: bytes) -> list[OscMessage]:
    """Return the messages of a packet, in its order; raises `InputError`."""
    if len(data) > PACKET_MAX_BYTES:
        raise InputError(f"a packet with more than {PACKET_MAX_BYTES} bytes is ignored")
    found: list[OscMessage] = []
    _read(data, None, DEPTH_MAX, found)
    return found


def _read(data: bytes, at_s: float | None, depth: int, found: list[OscMessage]) -> None:
    if not data.startswith(_HEAD):
        if len(found) >= MESSAGES_MAX:
            raise InputError(f"a packet with more than {MESSAGES_MAX} messages is ignored")
        found.append(_message(data, at_s))
        return
    if depth == 0 or len(data) < len(_HEAD) + 8:
        raise InputError("a bundle that is nested deeply, or cut, is ignored")
    at_s = _time(struct.unpack_from(">Q", data, len(_HEAD))[0])
    place = len(_HEAD) + 8
    while place < len(data):
        if place + 4 > len(data):
            raise InputError("a bundle that is cut is ignored")
        (size,) = struct.unpack_from(">i", data, place)
        place += 4
        if not 0 < size <= len(data) - place or size % 4:
            raise InputError("a bundle with a wrong length is ignored")
        _read(data[place : place + size], at_s, depth - 1, found)
        place += size


def _time(tag: int) -> float | None:
    """Return the Unix time of a time tag; None: at once."""
    return None if tag == IMMEDIATELY else tag / 2**32 - NTP_TO_UNIX_S


def _message(data: bytes, at_s: float | None) -> OscMessage:
    from pythonosc import osc_message

    if not data.startswith(b"/") or b"\0" not in data:
        raise InputError("a packet that is no OSC message is ignored")
    end = data.index(b"\0")
    tags = data[end + 4 - end % 4 :].partition(b"\0")[0]
    if tags and (tags[:1] != b"," or not _TAGS.issuperset(tags[1:])):
        raise InputError("an OSC message with arguments of unknown types is ignored")
    try:
        read = osc_message.OscMessage(data)
        return OscMessage(read.address, tuple(read.params), at_s)
    except (osc_message.ParseError, ValueError, IndexError, OverflowError, struct.error):
        raise InputError("an OSC message that is cut is ignored") from None


def delay_s(message: OscMessage, wall_s: float) -> float:
    """Return how long from now a message is to be carried out; raises `InputError` if too long.

    `wall_s` is the Unix time now. It is used only here: a clock that is set later changes nothing.
    """
    if message.at_s is None:
        return 0.0
    ahead_s = message.at_s - wall_s
    if ahead_s > AHEAD_MAX_S:
        raise InputError(
            f"a message for {ahead_s:.0f} s later is ignored (at most {AHEAD_MAX_S:.0f} s): set "
            "the clocks of both computers, as by NTP"
        )
    return max(0.0, ahead_s)


def is_release(message: OscMessage) -> bool:
    """Return whether this is a button that is released: its first argument is 0 or false."""
    first = message.arguments[0] if message.arguments else None
    return isinstance(first, bool | int | float) and not first


def operation_of(
    message: OscMessage, cues: AbstractSet[str], levels: Crossings | None = None
) -> m.AnyOperation | None:
    """Return what a message asks for; None for a button that is released.

    `cues` are the addresses that trigger a cue of the stage; they come before our own. Of those in
    `levels` only values that cross a threshold count. Raises `InputError` for what is not possible.
    """
    if message.address in cues:
        return _trigger(message, levels)
    fields = _own(message)
    if fields is None:
        raise InputError(f"{shown(message.address)} triggers no cue, and is none of ours")
    is_button = fields["op"] not in ("rate", "seek", "enable")
    return None if is_button and is_release(message) else _operation(fields)


def _trigger(message: OscMessage, levels: Crossings | None) -> m.AnyOperation | None:
    """Return the trigger of a message; None if it is a release, or crosses no threshold."""
    address, first = message.address, next(iter(message.arguments), None)
    is_number = isinstance(first, int | float) and math.isfinite(first)
    value = float(first) if first is not None and is_number else None
    if levels is not None and address in levels and value is not None:
        is_wanted = levels.take(address, value)
    else:
        is_wanted = not is_release(message)
    fields = {"op": "trigger", "kind": "osc", "address": address, "value": value}
    return _operation(fields) if is_wanted else None


def _own(message: OscMessage) -> dict[str, Any] | None:
    """Return the operation of one of our addresses; None: it is none of ours."""
    address, first = message.address, next(iter(message.arguments), None)
    own, _, name = address.removeprefix("/lss/").partition("/")
    if not address.startswith("/lss/"):
        return None
    if own in DEEDS and not name:
        return {"op": DEEDS[own]}
    if own in NAMED and (name or isinstance(first, str)):
        op, key = NAMED[own]
        return {"op": op, key: name or first}
    if own == "enable" and name:
        return {"op": "enable", "cue": name, "is_enabled": not is_release(message)}
    if own == "rate" and not name and isinstance(first, int | float):
        return {"op": "rate", "ratio": float(first)}
    if own == "seek" and not name and isinstance(first, int | float | str):
        return {"op": "seek", "to": first if isinstance(first, str) else float(first)}
    return None


def _operation(fields: dict[str, Any]) -> m.AnyOperation:
    return m.parse_operation(json.dumps(fields))


def shown(text: str) -> str:
    """Return text from outside as it can be printed: short, and with no control characters."""
    clean = "".join(char if char.isprintable() else "?" for char in text[:80])
    return clean + ("…" if len(text) > 80 else "")


def packet_of(address: str, arguments: Iterable[float | str | int]) -> bytes:
    """Return the bytes of one message; numbers become 32-bit floats, whole ones integers."""
    from pythonosc.osc_message_builder import OscMessageBuilder

    builder = OscMessageBuilder(address=address)
    for value in arguments:
        builder.add_arg(value)
    return builder.build().dgram


def bundle_of(packets: Iterable[bytes], size_max: int = PACKET_MAX_BYTES) -> list[bytes]:
    """Return as few bundles as hold these messages, each to be carried out at once."""
    head = _HEAD + struct.pack(">Q", IMMEDIATELY)
    found, size = [bytearray(head)], len(head)
    for packet in packets:
        if size > len(head) and size + 4 + len(packet) > size_max:
            found.append(bytearray(head))
            size = len(head)
        found[-1] += struct.pack(">i", len(packet)) + packet
        size += 4 + len(packet)
    return [bytes(one) for one in found if len(one) > len(head)]


SUBSCRIBED_S: Final = 60.0
SUBSCRIBERS_MAX: Final = 8
"""Chosen: a desk, a tablet, and some to spare; each gets every angle some times a second."""
RATE_HZ: Final = 10.0
RATE_MAX_HZ: Final = 40.0
"""As often as the player reports angles."""
PENDING_MAX: Final = 256
"""Messages that wait for their time."""
PORT_MAX: Final = 65535

Place = tuple[str, int]


@dataclass(slots=True)
class _Subscriber:
    until_s: float | None
    """None: for ever, as the stage file has it."""
    period_s: float
    next_s: float = 0.0


class Subscribers:
    """Who gets feedback, how often, and until when. Knows no clock and no socket."""

    def __init__(self, always: Iterable[Place] = ()) -> None:
        self._all = {place: _Subscriber(None, 1.0 / RATE_HZ) for place in always}

    def add(self, place: Place, rate_hz: float, now_s: float) -> bool:
        """Add or renew one; return False if there are too many."""
        self._drop(now_s)
        if place not in self._all and len(self._all) >= SUBSCRIBERS_MAX:
            return False
        old = self._all.get(place)
        is_kept = old is not None and old.until_s is None
        until_s = None if is_kept else now_s + SUBSCRIBED_S
        self._all[place] = _Subscriber(until_s, 1.0 / min(max(rate_hz, 0.1), RATE_MAX_HZ))
        return True

    def remove(self, place: Place) -> None:
        """Remove one, if it is not of the stage file."""
        if (own := self._all.get(place)) is not None and own.until_s is not None:
            del self._all[place]

    def all(self, now_s: float) -> list[Place]:
        """Return everyone."""
        self._drop(now_s)
        return list(self._all)

    def due(self, now_s: float) -> list[Place]:
        """Return whose next angles are due, and note that they get them."""
        self._drop(now_s)
        found = [place for place, one in self._all.items() if now_s >= one.next_s]
        for place in found:
            one = self._all[place]
            one.next_s = max(one.next_s + one.period_s, now_s + one.period_s / 2)
        return found

    def _drop(self, now_s: float) -> None:
        for place, one in list(self._all.items()):
            if one.until_s is not None and now_s > one.until_s:
                del self._all[place]


class OscPort(asyncio.DatagramProtocol):
    """One UDP port. `sink` takes operations; `state` returns what `/lss/state` answers."""

    def __init__(
        self,
        gate: Gate,
        sink: Sink,
        *,
        cues: AbstractSet[str] = frozenset(),
        levels: Crossings | None = None,
        state: Callable[[], Mapping[str, float | str]] = dict,
        always: Iterable[Place] = (),
    ) -> None:
        self.gate = gate
        self.cues, self.levels = cues, levels
        """What the stage file has now: addresses of cues, and thresholds of some."""
        self._sink, self._state = sink, state
        self._subscribers = Subscribers(always)
        self._transport: asyncio.DatagramTransport | None = None
        self._pending: set[asyncio.TimerHandle] = set()

    async def open(self, place: Place) -> None:
        """Open the port; raises `OSError`."""
        loop = asyncio.get_running_loop()
        await loop.create_datagram_endpoint(lambda: self, local_addr=place)

    @property
    def place(self) -> Place:
        """Address and port where it listens."""
        assert self._transport is not None
        host, port = self._transport.get_extra_info("sockname")[:2]
        return str(host), int(port)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the socket."""
        self._transport = cast("asyncio.DatagramTransport", transport)

    def error_received(self, exc: Exception) -> None:
        """Ignore what the system tells of a receiver that is not there."""

    def close(self) -> None:
        """Close the port, and forget what waits for its time."""
        for timer in self._pending:
            timer.cancel()
        self._pending.clear()
        if self._transport is not None:
            self._transport.close()

    # ---- receiving

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Carry out what a packet asks for, now or at its time."""
        now_s, place = self._now_s(), (str(addr[0]), int(addr[1]))
        if not self.gate.admits(place[0], now_s):
            return
        for message in self.gate.tried(lambda: messages_of(data), place[0], now_s) or ():
            self._take(message, place, now_s)

    def _take(self, message: OscMessage, place: Place, now_s: float) -> None:
        wall_s = datetime.now(UTC).timestamp()
        wait_s = self.gate.tried(lambda: delay_s(message, wall_s), place[0], now_s)
        if wait_s is None:
            return
        if not wait_s:
            self._obey(message, place)
            return
        if len(self._pending) >= PENDING_MAX:
            text = f"more than {PENDING_MAX} messages for later are ignored (from {place[0]})"
            self.gate.complaints.add(text, now_s)
            return

        def obey() -> None:
            self._pending.discard(timer)
            self._obey(message, place)

        timer = asyncio.get_running_loop().call_later(wait_s, obey)
        self._pending.add(timer)

    def _obey(self, message: OscMessage, place: Place) -> None:
        if message.address not in self.cues and self._is_query(message, place):
            return
        operation = self.gate.tried(
            lambda: operation_of(message, self.cues, self.levels), place[0], self._now_s()
        )
        if operation is not None:
            self._sink(operation, f"OSC {shown(message.address)} from {place[0]}")

    def _is_query(self, message: OscMessage, place: Place) -> bool:
        """Answer a message that only asks; return whether it was one."""
        numbers = [one for one in message.arguments if isinstance(one, int | float)]
        port = int(numbers[0]) if numbers and 0 < numbers[0] <= PORT_MAX else place[1]
        to = (place[0], port)
        match message.address:
            case "/lss/state":
                self.send_state([to])
            case "/lss/subscribe":
                rate_hz = float(numbers[1]) if len(numbers) > 1 else RATE_HZ
                if self._subscribers.add(to, rate_hz, self._now_s()):
                    self.send_state([to])
                else:
                    text = f"more than {SUBSCRIBERS_MAX} subscribers: {to[0]} gets nothing"
                    self.gate.complaints.add(text, self._now_s())
            case "/lss/unsubscribe":
                self._subscribers.remove(to)
            case _:
                return False
        return True

    # ---- sending

    def send_state(self, places: Iterable[Place] | None = None) -> None:
        """Send the state to these, or to all who subscribe."""
        packets = [packet_of(f"/lss/{name}", [value]) for name, value in self._state().items()]
        self._send(packets, self._subscribers.all(self._now_s()) if places is None else places)

    def send_event(self, kind: str, text: str) -> None:
        """Send what happened to all who subscribe."""
        packet = packet_of("/lss/event", [kind, text])
        self._send([packet], self._subscribers.all(self._now_s()))

    def send_joints(self, deg: Mapping[str, float]) -> None:
        """Send the angles to those whose next ones are due."""
        if places := self._subscribers.due(self._now_s()):
            packets = [packet_of(f"/lss/joint/{name}", [at]) for name, at in deg.items()]
            self._send(packets, places)

    def _send(self, packets: list[bytes], places: Iterable[Place]) -> None:
        """Send messages; one alone without a bundle, which simple receivers do not read."""
        assert self._transport is not None
        whole = packets if len(packets) == 1 else bundle_of(packets)
        for place in places:
            for packet in whole:
                with contextlib.suppress(OSError):  # No route to it now.
                    self._transport.sendto(packet, place)

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()
