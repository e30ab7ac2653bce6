"""The process that reads timecode, as a `FollowSpec` says; it sends a `TimecodeNews`.

It ends when its pipe does. Sound and MIDI come in threads of their libraries, which the
player must not have: here they only put what came into a queue, with its instant.
"""

from __future__ import annotations

import contextlib
import ipaddress
import queue
import socket
import struct
import time
from typing import TYPE_CHECKING, Any, Final, Protocol

import msgspec
from msgspec import Struct

from lss_motion.stage.timecode import chase, midi, packets
from lss_motion.stage.timecode.chase import Chase, Style
from lss_motion.stage.timecode.options import FollowSpec
from lss_motion.stage.timecode.readers import ArtNetReader, FppReader, LtcReader, MtcReader
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import wait_for
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.stage.timecode.chase import Observation
    from lss_motion.system.messages import MessagePipe

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
BLOCK_S: Final = 0.01


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


TimecodeNews = TimecodeOpened | TimecodeFailed | TimecodeText | TimecodeLeg


class SourceError(Exception):
    """The source cannot be opened; the text says why and what to do."""


class Source(Protocol):
    """One way of transport, open."""

    text: str

    def wait(self, chased: Chase) -> Iterator[tuple[Observation, str]]:
        """Yield what has come, after waiting for `TURN_S` at most; tell `chased` of troubles."""
        ...

    def close(self) -> None: ...


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

    def wait(self, chased: Chase) -> Iterator[tuple[Observation, str]]:  # noqa: ARG002
        try:
            blocks = [self._blocks.get(timeout=TURN_S)]
        except queue.Empty:
            if time.monotonic() - self._received_s > LOOK_S and not self._stream.active:
                raise SourceError("the sound input is gone") from None
            return
        with contextlib.suppress(queue.Empty):
            while True:
                blocks.append(self._blocks.get_nowait())
        self._received_s = time.monotonic()
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

    def wait(self, chased: Chase) -> Iterator[tuple[Observation, str]]:
        self._watch(chased)
        try:
            messages = [self._messages.get(timeout=TURN_S)]
        except queue.Empty:
            return
        with contextlib.suppress(queue.Empty):
            while True:
                messages.append(self._messages.get_nowait())
        for message, instant_ns in messages:
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
        self._reader = FppReader(spec.start) if is_fpp else ArtNetReader(spec.rate, say, spec.start)
        self._allowed = [ipaddress.IPv4Network(text, strict=False) for text in spec.allowed]
        self._known: dict[str, bool] = {}
        port = packets.FPP_PORT if is_fpp else packets.ARTNET_PORT
        host = "127.0.0.1" if spec.is_loopback else "0.0.0.0"  # noqa: S104  (asked for by name)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((host, port))
            if is_fpp and not spec.is_loopback:
                member = struct.pack("4s4s", socket.inet_aton(packets.FPP_GROUP), b"\0\0\0\0")
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

    def wait(self, chased: Chase) -> Iterator[tuple[Observation, str]]:
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
            )
        )
