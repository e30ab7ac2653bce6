"""Open Sound Control as values: bytes to messages, messages to operations, values to bytes.

Bundles are split here: the parser of python-osc 1.10 never returns from one with an element of a
negative length, and ends with `RecursionError` in one that is nested deeply. Messages are its own.
"""

from __future__ import annotations

import json
import math
import struct
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m

if TYPE_CHECKING:
    from collections.abc import Iterable
    from collections.abc import Set as AbstractSet

    from lss_motion.stage.triggers.sources import Crossings

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

SIMPLE: Final = {
    "/lss/go": "go",
    "/lss/stop": "stop",
    "/lss/estop": "estop",
    "/lss/pause": "pause",
    "/lss/resume": "resume",
    "/lss/idle": "stage.stop",
    "/lss/rest": "stage.rest",
    "/lss/wake": "stage.wake",
}
"""Addresses of operations without an argument. No `rearm`: after a stop a person with a password
allows motion again."""


NAMED: Final = {"cue": ("cue", "label"), "arm": ("arm", "cue"), "show": ("stage.play", "show")}
"""Operations with a name: `/lss/cue/NAME`, or `/lss/cue NAME`."""


class OscError(ValueError):
    """A packet that is no OSC, or asks for what is not possible."""


class Message(Struct, frozen=True):
    """An address with its arguments. `at_s`: when it is to be carried out, Unix time; None: now."""

    address: str
    arguments: tuple[Any, ...] = ()
    at_s: float | None = None


def messages_of(data: bytes) -> list[Message]:
    """Return the messages of a packet, in its order; raises `OscError`."""
    if len(data) > PACKET_MAX_BYTES:
        raise OscError(f"a packet with more than {PACKET_MAX_BYTES} bytes is ignored")
    found: list[Message] = []
    _read(data, None, DEPTH_MAX, found)
    return found


def _read(data: bytes, at_s: float | None, depth: int, found: list[Message]) -> None:
    if not data.startswith(_HEAD):
        if len(found) >= MESSAGES_MAX:
            raise OscError(f"a packet with more than {MESSAGES_MAX} messages is ignored")
        found.append(_message(data, at_s))
        return
    if depth == 0 or len(data) < len(_HEAD) + 8:
        raise OscError("a bundle that is nested deeply, or cut, is ignored")
    at_s = _time(struct.unpack_from(">Q", data, len(_HEAD))[0])
    place = len(_HEAD) + 8
    while place < len(data):
        if place + 4 > len(data):
            raise OscError("a bundle that is cut is ignored")
        (size,) = struct.unpack_from(">i", data, place)
        place += 4
        if not 0 < size <= len(data) - place or size % 4:
            raise OscError("a bundle with a wrong length is ignored")
        _read(data[place : place + size], at_s, depth - 1, found)
        place += size


def _time(tag: int) -> float | None:
    """Return the Unix time of a time tag; None: at once."""
    return None if tag == IMMEDIATELY else tag / 2**32 - NTP_TO_UNIX_S


def _message(data: bytes, at_s: float | None) -> Message:
    from pythonosc.osc_message import OscMessage, ParseError

    if not data.startswith(b"/") or b"\0" not in data:
        raise OscError("a packet that is no OSC message is ignored")
    end = data.index(b"\0")
    tags = data[end + 4 - end % 4 :].partition(b"\0")[0]
    if tags and (tags[:1] != b"," or not _TAGS.issuperset(tags[1:])):
        raise OscError("an OSC message with arguments of unknown types is ignored")
    try:
        read = OscMessage(data)
        return Message(read.address, tuple(read.params), at_s)
    except (ParseError, ValueError, IndexError, OverflowError, struct.error):
        raise OscError("an OSC message that is cut is ignored") from None


def delay_s(message: Message, wall_s: float) -> float:
    """Return how long from now a message is to be carried out; raises `OscError` if too long.

    `wall_s` is the Unix time now. It is used only here: a clock that is set later changes nothing.
    """
    if message.at_s is None:
        return 0.0
    ahead_s = message.at_s - wall_s
    if ahead_s > AHEAD_MAX_S:
        raise OscError(
            f"a message for {ahead_s:.0f} s later is ignored (at most {AHEAD_MAX_S:.0f} s): set "
            "the clocks of both computers, as by NTP"
        )
    return max(0.0, ahead_s)


def is_release(message: Message) -> bool:
    """Return whether this is a button that is released: its first argument is 0 or false."""
    first = message.arguments[0] if message.arguments else None
    return isinstance(first, bool | int | float) and not first


def operation_of(
    message: Message, cues: AbstractSet[str], levels: Crossings | None = None
) -> m.AnyOperation | None:
    """Return what a message asks for; None for a button that is released.

    `cues` are the addresses that trigger a cue of the stage; they come before our own. Of those in
    `levels` only values that cross a threshold count. Raises `OscError` for what is not possible.
    """
    if message.address in cues:
        return _trigger(message, levels)
    fields = _own(message)
    if fields is None:
        raise OscError(f"{shown(message.address)} triggers no cue, and is none of ours")
    is_button = fields["op"] not in ("rate", "seek", "enable")
    return None if is_button and is_release(message) else _operation(fields)


def _trigger(message: Message, levels: Crossings | None) -> m.AnyOperation | None:
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


def _own(message: Message) -> dict[str, Any] | None:
    """Return the operation of one of our addresses; None: it is none of ours."""
    address, first = message.address, next(iter(message.arguments), None)
    if address in SIMPLE:
        return {"op": SIMPLE[address]}
    own, _, name = address.removeprefix("/lss/").partition("/")
    if not address.startswith("/lss/"):
        return None
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
    try:
        return m.parse_operation(json.dumps(fields))
    except (InputError, ValueError) as error:
        raise OscError(str(error)) from None


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
