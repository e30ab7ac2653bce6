"""Timecode as bytes: MIDI, Art-Net (a packet a frame), FPP MultiSync (a few packets a second).

F1 0000–7FFF    quarter frame: piece 0–7 in the upper, a digit in the lower half of its byte.
                Eight pieces, a quarter of a frame apart, hold one label: that of the frame in
                which piece 0 was sent. So a label takes two frames. Backward: piece 7 first.
F0 7F id 01 01 hh mm ss ff F7    locate: stands at this label. Bits 5 and 6 of hh are the rate.

Art-Net, port 6454     `Art-Net`, NUL, 0x9700 (low byte first), version 14 (high byte first), 0,
                       stream, frames, seconds, minutes, hours, rate 0–3
FPP, port 32320        `FPPD`, type (1: sync), length of the rest; action, kind, frame, seconds,
                       name, NUL; numbers low byte first
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from lss_motion.stage.timecode.timecode import CODED, FrameRate, Timecode, timecode_of

if TYPE_CHECKING:
    from lss_motion.stage.timecode.timecode import FrameRate

PIECES: Final = 8
QUARTER_FRAME: Final = 0xF1
_LOCATE: Final = (0x01, 0x01)
LOCATE_BYTES: Final = 10


class MtcReading(NamedTuple):
    """A label that was read. It was that of the tape at `instant_ns`, `past_frames` after it began.

    `direction`: 1 forward, -1 backward, 0 stands (a locate).
    """

    instant_ns: int
    timecode: Timecode
    rate: FrameRate
    direction: int
    past_frames: float = 0.0


class MtcDecoder:
    """Assembles labels from MIDI messages. No message raises; other ones are ignored."""

    def __init__(self) -> None:
        self._pieces: list[tuple[int, int, int]] = []
        """Piece, digit and instant of the last quarter frames, all in one direction."""
        self._direction = 0

    def take(self, message: bytes, instant_ns: int) -> list[MtcReading]:
        """Return what is known with this message: an instant for each piece of a whole label."""
        if len(message) == 2 and message[0] == QUARTER_FRAME and message[1] < 0x80:
            return self._take_piece(message[1] >> 4, message[1] & 15, instant_ns)
        if len(message) == LOCATE_BYTES and message[0] == 0xF0 and message[-1] == 0xF7:
            return self._take_locate(message, instant_ns)
        return []

    def _take_locate(self, message: bytes, instant_ns: int) -> list[MtcReading]:
        if message[1] != 0x7F or tuple(message[3:5]) != _LOCATE:
            return []
        rate = CODED[message[5] >> 5 & 3]
        timecode = Timecode(message[5] & 31, *message[6:9])
        self._pieces.clear()
        return [MtcReading(instant_ns, timecode, rate, 0)] if timecode.is_valid(rate) else []

    def _take_piece(self, piece: int, digit: int, instant_ns: int) -> list[MtcReading]:
        if self._pieces:
            step = piece - self._pieces[-1][0]
            direction = {1: 1, 1 - PIECES: 1, -1: -1, PIECES - 1: -1}.get(step, 0)
            if direction == 0 or (self._direction and direction != self._direction):
                self._pieces.clear()
            self._direction = direction
        first = 0 if self._direction >= 0 else PIECES - 1
        if piece == first or (not self._pieces and piece == PIECES - 1):
            self._pieces.clear()
        self._pieces.append((piece, digit, instant_ns))
        if len(self._pieces) < PIECES:
            return []
        return self._readings()

    def _readings(self) -> list[MtcReading]:
        digits = {piece: digit for piece, digit, _ in self._pieces}
        if len(digits) < PIECES:
            return []
        frames, seconds, minutes, hours = (digits[n] | digits[n + 1] << 4 for n in (0, 2, 4, 6))
        rate = CODED[hours >> 5 & 3]
        timecode = Timecode(hours & 31, minutes & 63, seconds & 63, frames & 31)
        if not timecode.is_valid(rate):
            return []
        sense = self._direction
        return [
            MtcReading(instant_ns, timecode, rate, sense, piece / 4.0)
            for piece, _, instant_ns in self._pieces
        ]


def quarter_frame(frame: int, piece: int, rate: FrameRate) -> bytes:
    """Return the message of a piece of the label of `frame`; `rate` is one of `CODED`."""
    code = CODED.index(rate)
    hours, minutes, seconds, frames = timecode_of(frame, rate)
    value = (frames, seconds, minutes, hours | code << 5)[piece // 2]
    digit = value >> 4 if piece % 2 else value & 15
    return bytes((QUARTER_FRAME, piece << 4 | digit))


def locate(timecode: Timecode, rate: FrameRate) -> bytes:
    """Return the message that the tape stands at `timecode`."""
    hours, *rest = timecode
    return bytes((0xF0, 0x7F, 0x7F, *_LOCATE, hours | CODED.index(rate) << 5, *rest, 0xF7))


_ARTNET_HEAD: Final = struct.Struct("<8sH")
_ARTNET_ID: Final = b"Art-Net\0"
_TIMECODE: Final = 0x9700
_VERSION: Final = 14
ARTNET_BYTES: Final = 19


class ArtNetReading(NamedTuple):
    """What a packet holds. A sender may have several streams, told apart by their number."""

    timecode: Timecode
    rate: FrameRate
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


def artnet_packet(timecode: Timecode, rate: FrameRate, stream: int = 0) -> bytes:
    """Return the packet of a frame; `rate` is one of `CODED`."""
    hours, minutes, seconds, frames = timecode
    head = _ARTNET_HEAD.pack(_ARTNET_ID, _TIMECODE) + bytes((0, _VERSION, 0, stream))
    return head + bytes((frames, seconds, minutes, hours, CODED.index(rate)))


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
