"""The process that reads timecode, as a `FollowSpec` says; it sends a `TimecodeNews`.

It ends when its pipe does. Sound and MIDI come in threads of their libraries, which the
player must not have: here they only put what came into a queue, with its instant.

Each reader turns bytes or sound into observations for the chase: seconds from the start of the
show. It chooses the frame rate, unless it is given: that of the label, or of LTC the measured one,
where the rate is not coded.
"""

from __future__ import annotations

import contextlib
import ipaddress
import queue
import socket
import struct
import time
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

import msgspec
from msgspec import Struct

from lss_motion.stage.timecode import chase, midi
from lss_motion.stage.timecode.chase import FPP, Chase, Style, TimecodeObservation
from lss_motion.stage.timecode.ltc import LtcDecoder
from lss_motion.stage.timecode.messages import FPP_GROUP, MtcDecoder, read_artnet, read_fpp
from lss_motion.stage.timecode.timecode import (
    ARTNET_PORT,
    FPP_PORT,
    FPS_24,
    FPS_25,
    FPS_29_97,
    FPS_29_97_DROP,
    FPS_30,
    FollowSpec,
    TimecodeStart,
    is_song,
)
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import wait_for
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from lss_motion.stage.timecode.ltc import LtcFrame
    from lss_motion.stage.timecode.timecode import FrameRate
    from lss_motion.system.messages import MessagePipe

    Say = Callable[[str], None]

T = TypeVar("T")

TURN_S: Final = 0.02
STYLES: Final[dict[str, Style]] = {
    "ltc": chase.LTC,
    "mtc": chase.MTC,
    "artnet": chase.ART_NET,
    "fpp": chase.FPP,
}
PACKET_BYTES: Final = 2048
PACKETS_A_TURN: Final = 500
"""So many packets are read at a time: a flood of them must not keep the legs from leaving."""
LOOK_S: Final = 1.0
"""A device that has vanished is looked for this often."""
QUEUE_MAX: Final = 2000


class TimecodeOpened(Struct, frozen=True, tag=True):
    """The source, or the receiver, is open; the text says which, for a person."""

    text: str


class TimecodeFailed(Struct, frozen=True, tag=True):
    """It cannot be opened, or goes on no more; the process ends."""

    text: str


class TimecodeText(Struct, frozen=True, tag=True):
    """What a person should know."""

    text: str


class TimecodeLeg(Struct, frozen=True, tag=True):
    """Where the leader is: the fields of `playing.remote.schema.Follow`."""

    instant_ns: int
    show_s: float
    rate: float
    source: str
    state: str
    song: str


TimecodeNews = TimecodeOpened | TimecodeFailed | TimecodeText | TimecodeLeg


class SourceError(Exception):
    """The source cannot be opened; the text says why and what to do."""


class Source(Protocol):
    """One way of transport, open."""

    text: str

    def wait(self, chased: Chase) -> Iterator[tuple[TimecodeObservation, str]]:
        """Yield what has come, after waiting for `TURN_S` at most; tell `chased` of troubles."""
        ...

    def close(self) -> None: ...


def _arrived(items: queue.Queue[T]) -> list[T]:
    """Return what has come, after waiting for `TURN_S` at most."""
    found: list[T] = []
    with contextlib.suppress(queue.Empty):
        found.append(items.get(timeout=TURN_S))
        while True:
            found.append(items.get_nowait())
    return found


class SoundSource:
    """LTC from a sound input."""

    def __init__(self, spec: FollowSpec, say: Any) -> None:  # noqa: ANN401
        from lss_motion.sound.device import (
            DeviceClock,
            NoDeviceError,
            chosen_device,
            sounddevice_module,
        )

        self._blocks: queue.Queue[tuple[int, int, Any]] = queue.Queue(QUEUE_MAX)
        self._say = say
        self._frame = 0
        self._received_s = time.monotonic()
        try:
            library = sounddevice_module()
            device = chosen_device(spec.name, "input")
            self._stream: Any = library.InputStream(
                device=device.name,
                channels=1,
                dtype="float32",
                latency="low",
                callback=self._take_block,
            )
            rate_hz = round(self._stream.samplerate)
            self._clock = DeviceClock(rate_hz)
            self._reader = LtcReader(rate_hz, spec.rate, say, spec.start)
            self._stream.start()
        except NoDeviceError as error:
            raise SourceError(str(error)) from error
        except Exception as error:  # PortAudio and its drivers have errors of their own.
            raise SourceError(f"sound input {spec.name or 'default'!r}: {error}") from error
        self.text = f"LTC from {device.name}, {rate_hz} Hz"

    def _take_block(self, block: Any, count: int, times: Any, status: Any) -> None:  # noqa: ANN401, ARG002
        now_ns = time.monotonic_ns()
        before_s = times.currentTime - times.inputBufferAdcTime
        if not 0.0 <= before_s < 1.0:  # Some drivers state nothing.
            before_s = count / self._stream.samplerate
        with contextlib.suppress(queue.Full):
            at_ns = now_ns - round(before_s * NS_PER_S)
            self._blocks.put_nowait((self._frame, at_ns, block[:, 0].copy()))
        self._frame += count

    def wait(self, chased: Chase) -> Iterator[tuple[TimecodeObservation, str]]:  # noqa: ARG002
        blocks = _arrived(self._blocks)
        if blocks:
            self._received_s = time.monotonic()
        elif time.monotonic() - self._received_s > LOOK_S and not self._stream.active:
            raise SourceError("the sound input is gone")
        for frame, at_ns, block in blocks:
            self._clock.take(frame, at_ns)
            for observation in self._reader.take(block, self._clock.heard_ns):
                yield observation, "LTC"

    def close(self) -> None:
        with contextlib.suppress(Exception):
            self._stream.abort()
            self._stream.close()


class MidiSource:
    """MIDI timecode from a MIDI input."""

    def __init__(self, spec: FollowSpec, say: Any) -> None:  # noqa: ANN401
        self._messages: queue.Queue[tuple[bytes, int]] = queue.Queue(QUEUE_MAX)
        self._reader = MtcReader(spec.rate, say, spec.start)
        self._name = spec.name
        self._device: Any = None
        try:
            self._open()
        except midi.NoPortError as error:
            raise SourceError(str(error)) from error
        self.text = f"MIDI timecode from {self._port}"
        self._looked_s = time.monotonic()

    def _open(self) -> None:
        self._device, self._port = midi.open_port("MidiIn", self._name)
        self._device.ignore_types(sysex=False, timing=False, active_sense=True)
        self._device.set_callback(self._take_message)

    def _take_message(self, message: tuple[list[int], float], _data: object = None) -> None:
        with contextlib.suppress(queue.Full, ValueError):
            self._messages.put_nowait((bytes(message[0]), time.monotonic_ns()))

    def wait(self, chased: Chase) -> Iterator[tuple[TimecodeObservation, str]]:
        self._watch(chased)
        for message, instant_ns in _arrived(self._messages):
            for observation in self._reader.take(message, instant_ns):
                yield observation, self._port

    def _watch(self, chased: Chase) -> None:
        """Notice a device that has vanished, and open it again when it is back."""
        if time.monotonic() - self._looked_s < LOOK_S:
            return
        self._looked_s = time.monotonic()
        if self._device is not None:
            if not midi.is_there(self._device, self._port):
                chased.add_text(f"MIDI input {self._port!r} is gone; it is waited for")
                midi.close(self._device)
                self._device = None
            return
        with contextlib.suppress(midi.NoPortError):
            self._open()
            chased.add_text(f"MIDI input {self._port!r} is back")

    def close(self) -> None:
        if self._device is not None:
            midi.close(self._device)


class PacketSource:
    """Art-Net timecode or FPP MultiSync from a UDP socket, of senders that are allowed."""

    def __init__(self, spec: FollowSpec, say: Any) -> None:  # noqa: ANN401
        is_fpp = spec.kind == "fpp"
        self._reader: ArtNetReader | FppReader
        self._reader = (
            FppReader(spec.start, spec.song) if is_fpp else ArtNetReader(spec.rate, say, spec.start)
        )
        self._allowed = [ipaddress.IPv4Network(text, strict=False) for text in spec.allowed]
        self._known: dict[str, bool] = {}
        port = FPP_PORT if is_fpp else ARTNET_PORT
        host = "127.0.0.1" if spec.is_loopback else "0.0.0.0"  # noqa: S104  (asked for by name)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((host, port))
            if is_fpp and not spec.is_loopback:
                member = struct.pack("4s4s", socket.inet_aton(FPP_GROUP), b"\0\0\0\0")
                with contextlib.suppress(OSError):  # No network with multicast: unicast is left.
                    self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError as error:
            self._socket.close()
            raise SourceError(
                f"port {port} of {host} cannot be opened: {error.strerror}"
            ) from error
        self._socket.setblocking(False)  # noqa: FBT003
        what = "FPP MultiSync" if is_fpp else "Art-Net timecode"
        self.text = f"{what} from {', '.join(spec.allowed)}, port {port}"

    def wait(self, chased: Chase) -> Iterator[tuple[TimecodeObservation, str]]:
        if not wait_for([self._socket.fileno()], TURN_S):
            return
        for _ in range(PACKETS_A_TURN):
            try:
                packet, (address, _) = self._socket.recvfrom(PACKET_BYTES)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                continue
            instant_ns = time.monotonic_ns()
            if self._is_allowed(address, chased):
                yield from self._reader.take(packet, address, instant_ns)

    def _is_allowed(self, address: str, chased: Chase) -> bool:
        known = self._known.get(address)
        if known is None:
            if len(self._known) > QUEUE_MAX:  # Addresses are easily forged.
                self._known.clear()
            host = ipaddress.IPv4Address(address)
            known = self._known[address] = any(host in network for network in self._allowed)
            if not known:
                chased.say(f"packets from {address} are ignored: it is not in the list of senders")
        return known

    def close(self) -> None:
        self._socket.close()


SOURCES: Final[dict[str, Any]] = {
    "ltc": SoundSource,
    "mtc": MidiSource,
    "artnet": PacketSource,
    "fpp": PacketSource,
}


def main(pipe: MessagePipe, words: str) -> int:
    """Read until the pipe ends."""
    spec = msgspec.json.decode(words, type=FollowSpec)
    typed: TypedPipe[None] = TypedPipe(pipe)
    chased = Chase(STYLES[spec.kind], freewheel_s=spec.freewheel_s)
    try:
        source: Source = SOURCES[spec.kind](spec, chased.say)
    except SourceError as failed:
        typed.send(TimecodeFailed(str(failed)))
        return 0
    typed.send(TimecodeOpened(source.text))
    try:
        while not typed.has_ended:
            for observation, name in source.wait(chased):
                chased.take(observation, name)
            chased.advance(time.monotonic_ns())
            _send(chased, typed)
            if wait_for([typed.fileno()], 0.0):
                typed.receive()
    except SourceError as failed:
        typed.send(TimecodeFailed(str(failed)))
    finally:
        source.close()
    return 0


def _send(chased: Chase, typed: TypedPipe[None]) -> None:
    """Send the legs and texts that the chase has made."""
    legs = chased.take_legs()
    for text in chased.take_texts():
        typed.send(TimecodeText(text))
    for leg in legs:
        typed.send(
            TimecodeLeg(
                instant_ns=leg.instant_ns,
                show_s=round(leg.show_s, 7),
                rate=round(leg.rate, 8),
                source=chased.source or "timecode",
                state=chased.state.value,
                song=chased.song,
            )
        )


NEAR_RATIO: Final = 0.08
"""A measured rate that is nearer to one of the known ones is taken for it. 24 and 25 are 4 % apart,
so the nearest counts; beyond, the tape is wound."""
FROM_MIDNIGHT: Final = TimecodeStart()
PLAYERS_MAX: Final = 256
SETTLED: Final = 4
"""So many frames in a row must be of another rate before the rate is changed."""


def of_label(coded: FrameRate, wanted: FrameRate | None, say: Say, way: str) -> FrameRate | None:
    """Return the rate by which a label is read; None: it is not that of the timecode wanted."""
    if wanted is None or wanted == coded:
        return coded
    if wanted.labels != coded.labels:
        say(
            f"{way} comes with {coded.labels} frames a second, but {wanted.name} are asked for: "
            f"it is not followed. Change one of them"
        )
        return None
    if wanted.is_drop != coded.is_drop:
        has = "drop-frame" if coded.is_drop else "no drop-frame"
        say(f"{way} has {has}, other than the {wanted.name} asked for: read as it is")
        return FPS_29_97_DROP if coded.is_drop else (FPS_29_97 if wanted.is_drop else wanted)
    return wanted


class LtcReader:
    """Observations from sound. `instant_ns` of a sample is given with each block."""

    def __init__(
        self, rate_hz: int, wanted: FrameRate | None, say: Say, start: TimecodeStart = FROM_MIDNIGHT
    ) -> None:
        self.decoder = LtcDecoder(rate_hz)
        self.frames = 0
        self._rate_hz, self._wanted, self._say = rate_hz, wanted, say
        self._start = start
        self._rate: FrameRate | None = None
        self._other = 0

    def take(
        self, block: NDArray[np.float32], instant_of: Callable[[float], float]
    ) -> Iterator[TimecodeObservation]:
        """Yield what is known with these samples; `instant_of` turns samples into ns."""
        for frame in self.decoder.take(block):
            self.frames += 1
            rate = self._rate_of(frame)
            if rate is None or not frame.timecode.is_valid(rate):
                continue
            number = frame.timecode.frame(rate) + (0 if frame.is_reverse else 1)
            direction = -1 if frame.is_reverse else 1
            instant_ns = round(instant_of(frame.at))
            yield TimecodeObservation(instant_ns, self._start.show_s(number, rate), direction)

    def _rate_of(self, frame: LtcFrame) -> FrameRate | None:
        measured = self._rate_hz / frame.frame_samples
        near = min((FPS_24, FPS_25, FPS_30), key=lambda r: abs(r.frames_per_s - measured))
        if abs(measured / near.frames_per_s - 1.0) > NEAR_RATIO:
            return self._rate  # It is wound, or two frames in one: judged by the chase.
        if frame.is_drop and near.labels == FPS_30.labels:
            near = FPS_29_97_DROP
        if self._rate is None or near.labels != self._rate.labels:
            self._other += 1
            if self._rate is not None and self._other < SETTLED:
                return self._rate
        self._other = 0
        self._rate = near
        return of_label(near, self._wanted, self._say, "LTC")


class MtcReader:
    """Observations from MIDI messages."""

    def __init__(
        self, wanted: FrameRate | None, say: Say, start: TimecodeStart = FROM_MIDNIGHT
    ) -> None:
        self._decoder = MtcDecoder()
        self._wanted, self._say, self._start = wanted, say, start

    def take(self, message: bytes, instant_ns: int) -> Iterator[TimecodeObservation]:
        """Yield what is known with this message."""
        for reading in self._decoder.take(message, instant_ns):
            rate = of_label(reading.rate, self._wanted, self._say, "MIDI timecode")
            if rate is None or not reading.timecode.is_valid(rate):
                continue
            frames = reading.timecode.frame(rate) + reading.past_frames
            position_s = self._start.show_s(frames, rate)
            yield TimecodeObservation(reading.instant_ns, position_s, reading.direction)


class ArtNetReader:
    """Observations from UDP packets, each with the name of its source."""

    def __init__(
        self, wanted: FrameRate | None, say: Say, start: TimecodeStart = FROM_MIDNIGHT
    ) -> None:
        self._wanted, self._say, self._start = wanted, say, start

    def take(
        self, packet: bytes, address: str, instant_ns: int
    ) -> Iterator[tuple[TimecodeObservation, str]]:
        """Yield what is known with this packet."""
        reading = read_artnet(packet)
        if reading is None:
            return
        rate = of_label(reading.rate, self._wanted, self._say, "Art-Net timecode")
        if rate is None or not reading.timecode.is_valid(rate):
            return
        source = f"{address} stream {reading.stream}" if reading.stream else address
        position_s = self._start.show_s(reading.timecode.frame(rate), rate)
        yield TimecodeObservation(instant_ns, position_s), source


class FppReader:
    """Observations from UDP packets of Falcon Players, each with the address of its player.

    What a player plays does not tell it apart from another. Its sequence counts while one plays,
    or else its media.
    """

    def __init__(self, start: TimecodeStart = FROM_MIDNIGHT, song: str = "") -> None:
        self._start, self._song = start, song
        self._items: dict[str, tuple[str, str, int]] = {}
        """What each player plays: kind, name, and when it was heard of last."""

    def take(
        self, packet: bytes, address: str, instant_ns: int
    ) -> Iterator[tuple[TimecodeObservation, str]]:
        """Yield what is known with this packet."""
        reading = read_fpp(packet)
        if reading is None or reading.action == "open":
            return
        if self._song and not is_song(self._song, reading.name):
            return
        is_stop = reading.action == "stop"
        kind, name, heard_ns = self._items.get(address, ("", "", 0))
        if kind and instant_ns - heard_ns <= ns_from_s(FPP.gap_s):
            is_beside = kind == "sequence" and reading.kind != kind
            if is_beside or (is_stop and (kind, name) != (reading.kind, reading.name)):
                return
        if is_stop:
            self._items.pop(address, None)
        else:
            if len(self._items) >= PLAYERS_MAX:  # Addresses are easily forged.
                self._items.clear()
            self._items[address] = (reading.kind, reading.name, instant_ns)
        position_s = self._start.show_s(reading.seconds * FPS_25.frames_per_s, FPS_25)
        direction = 0 if is_stop else 1
        yield TimecodeObservation(instant_ns, position_s, direction, reading.name), address
