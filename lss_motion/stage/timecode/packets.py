"""Timecode in UDP packets: Art-Net, a packet a frame, and FPP MultiSync, a few a second.

Art-Net, port 6454     `Art-Net`, NUL, 0x9700 (low byte first), version 14 (high byte first), 0,
                       stream, frames, seconds, minutes, hours, rate 0–3
FPP, port 32320        `FPPD`, type (1: sync), length of the rest; action, kind, frame, seconds,
                       name, NUL; numbers low byte first
"""

from __future__ import annotations

import math
import struct
from typing import Final, Literal, NamedTuple

from lss_motion.stage.timecode.timecode import CODED, Rate, Timecode

ARTNET_PORT: Final = 6454
_ARTNET_HEAD: Final = struct.Struct("<8sH")
_ARTNET_ID: Final = b"Art-Net\0"
_TIMECODE: Final = 0x9700
_VERSION: Final = 14
ARTNET_BYTES: Final = 19


class ArtNetReading(NamedTuple):
    """What a packet holds. A sender may have several streams, told apart by their number."""

    timecode: Timecode
    rate: Rate
    stream: int


def read_artnet(packet: bytes) -> ArtNetReading | None:
    """Return the timecode of a packet; None: it is another one. No byte raises."""
    if len(packet) < ARTNET_BYTES or _ARTNET_HEAD.unpack_from(packet) != (_ARTNET_ID, _TIMECODE):
        return None
    version = packet[10] << 8 | packet[11]
    stream, frames, seconds, minutes, hours, code = packet[13:19]
    if version < _VERSION or code >= len(CODED):
        return None
    timecode, rate = Timecode(hours, minutes, seconds, frames), CODED[code]
    return ArtNetReading(timecode, rate, stream) if timecode.is_valid(rate) else None


def artnet_packet(timecode: Timecode, rate: Rate, stream: int = 0) -> bytes:
    """Return the packet of a frame; `rate` is one of `CODED`."""
    hours, minutes, seconds, frames = timecode
    head = _ARTNET_HEAD.pack(_ARTNET_ID, _TIMECODE) + bytes((0, _VERSION, 0, stream))
    return head + bytes((frames, seconds, minutes, hours, CODED.index(rate)))


FPP_PORT: Final = 32320
FPP_GROUP: Final = "239.70.80.80"
_FPP_HEAD: Final = struct.Struct("<4sBH")
_SYNC: Final = struct.Struct("<BBIf")
_MAGIC: Final = b"FPPD"
_SYNC_TYPE: Final = 1
ACTIONS: Final = ("start", "stop", "sync", "open")
KINDS: Final = ("sequence", "media")
NAME_MAX_BYTES: Final = 255
DAY_S: Final = 86400.0

Action = Literal["start", "stop", "sync", "open"]


class FppReading(NamedTuple):
    """What a packet holds: what the leader does with a file, and where it is in it."""

    action: Action
    kind: str
    frame: int
    seconds: float
    name: str


def read_fpp(packet: bytes) -> FppReading | None:
    """Return the sync message of a packet; None: it is another one. No byte raises."""
    if len(packet) < _FPP_HEAD.size + _SYNC.size or packet[:4] != _MAGIC or packet[4] != _SYNC_TYPE:
        return None
    _, _, length = _FPP_HEAD.unpack_from(packet)
    body = packet[_FPP_HEAD.size : _FPP_HEAD.size + length]
    if len(body) != length or length < _SYNC.size:
        return None
    action, kind, frame, seconds = _SYNC.unpack_from(body)
    name, end, _ = body[_SYNC.size :].partition(b"\0")
    if action >= len(ACTIONS) or kind >= len(KINDS) or not end or len(name) > NAME_MAX_BYTES:
        return None
    if not math.isfinite(seconds) or not 0.0 <= seconds <= DAY_S:
        return None
    return FppReading(ACTIONS[action], KINDS[kind], frame, seconds, name.decode("utf-8", "replace"))


def fpp_packet(reading: FppReading) -> bytes:
    """Return the packet of a sync message."""
    name = reading.name.encode()[:NAME_MAX_BYTES] + b"\0"
    action, kind = ACTIONS.index(reading.action), KINDS.index(reading.kind)
    body = _SYNC.pack(action, kind, reading.frame, reading.seconds) + name
    return _FPP_HEAD.pack(_MAGIC, _SYNC_TYPE, len(body)) + body
