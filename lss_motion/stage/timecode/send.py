"""The process that sends timecode, as a `SendSpec` says; it is sent a `SendOrder`.

It sends a `TimecodeNews` when it is open, or failed. Nothing is sent before the first leg, and
nothing after the end, or when the pipe ends because the player was killed.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import time
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
from msgspec import Struct

from lss_motion.stage.timecode import midi
from lss_motion.stage.timecode.ltc import levels
from lss_motion.stage.timecode.messages import (
    PIECES,
    Action,
    FppReading,
    artnet_packet,
    fpp_packet,
    locate,
    quarter_frame,
)
from lss_motion.stage.timecode.receive import SourceError, TimecodeFailed, TimecodeOpened
from lss_motion.stage.timecode.timecode import SendSpec, timecode_of
from lss_motion.system.clock_leg import ClockLeg  # noqa: TC001  (msgspec reads the type)
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import serve
from lss_motion.system.real_time import prompt_waits
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from lss_motion.system.messages import MessagePipe

WAIT_S: Final = 0.02
RAMP_WAIT_S: Final = 0.005
"""While the rate changes, the next instant is looked for this often."""
CATCH_UP_MAX: Final = 4
"""So many pulses that are late are sent after all; more are a jump."""
STANDING_S: Final = 1.0
"""What stands is repeated this often."""
FPP_HZ: Final = 2.0
LEVEL: Final = 0.5
"""Of full scale, -6 dB: inputs read from -40 dB up, and none must be overdriven."""
JUMP_FRAMES: Final = 0.5
"""A show clock that is further away from what was sounded has jumped."""
BEND_RATIO: Final = 0.02
"""What is nearer is made up by sounding faster or slower, by so much at most."""


class SendLeg(Struct, frozen=True, tag=True):
    """The show clock from now on; `show` names the show, if it is not empty."""

    leg: ClockLeg
    show: str = ""


class EndSending(Struct, frozen=True, tag=True):
    """The show is over."""


SendOrder = SendLeg | EndSending


class ShowNow:
    """The show clock as this process knows it."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        """Of the show, for receivers that are told one."""
        self._legs: tuple[ClockLeg, ...] = ()
        self.is_ended = False

    def take(self, order: SendOrder) -> None:
        if isinstance(order, EndSending):
            self.is_ended = True
            return
        self.name = order.show or self.name
        self._legs = (*self._legs[-1:], order.leg)

    def leg(self, at_ns: float) -> ClockLeg | None:
        """Return the leg at an instant; None: the show has not begun."""
        legs = self._legs  # A thread of the sound library calls, too.
        return next((leg for leg in reversed(legs) if leg.start_ns <= at_ns), None)


class Pulses:
    """Calls `emit(number)` at every pulse of the timecode, `pulses_hz` a second."""

    pulses_hz: float = 1.0
    text: str = ""

    def __init__(self, spec: SendSpec, show: ShowNow) -> None:
        self.spec = spec
        self.show = show
        self._last: int | None = None
        self._stood_ns = 0

    def turn(self, now_ns: int) -> float:
        """Send what is due; return how long to wait, in seconds."""
        leg = self.show.leg(now_ns)
        if leg is None:
            return WAIT_S
        at_s = leg.show_s(now_ns) + self.spec.offset_s
        number = math.floor(at_s * self.pulses_hz + 1e-6)
        if leg.rate(now_ns) == 0.0:
            if number != self._last or now_ns - self._stood_ns > STANDING_S * NS_PER_S:
                self._stood_ns = now_ns
                self.stand(number)
            self._last = number
            return WAIT_S
        if self._last is None or not 0 <= number - self._last <= CATCH_UP_MAX:
            self.jump(number)
            self._last = number - 1
        for one in range(self._last + 1, number + 1):
            self.emit(one)
        self._last = number
        rate = leg.rate(now_ns) * (1.0 + leg.trim_ratio)
        is_ramping = now_ns < leg.ramp_end_ns
        left_s = ((number + 1) / self.pulses_hz - at_s) / max(rate, 1e-3)
        return max(0.0, min(left_s, RAMP_WAIT_S if is_ramping else WAIT_S))

    def emit(self, number: int) -> None:
        """Send a pulse of a show that runs."""

    def stand(self, number: int) -> None:
        """Send where a show stands."""

    def jump(self, number: int) -> None:
        """Note that the next pulse does not follow the last one."""

    def end(self) -> None:
        """Send that the show is over, and close."""


class MtcSender(Pulses):
    """MIDI timecode: four messages a frame."""

    def __init__(self, spec: SendSpec, show: ShowNow) -> None:
        super().__init__(spec, show)
        self.pulses_hz = 4.0 * spec.rate.frames_per_s
        try:
            self._device, port = midi.open_port("MidiOut", spec.name)
        except midi.NoPortError as error:
            raise SourceError(str(error)) from error
        self._is_whole = False
        self.text = f"MIDI timecode to {port}"

    def emit(self, number: int) -> None:
        """Send a quarter frame; a label begins with piece 0, at an even frame."""
        piece = number % PIECES
        self._is_whole = self._is_whole or piece == 0
        if self._is_whole:
            frame = number // PIECES * 2
            self._send(quarter_frame(frame, piece, self.spec.rate))

    def stand(self, number: int) -> None:
        self._is_whole = False
        self._send(locate(timecode_of(number // 4, self.spec.rate), self.spec.rate))

    def jump(self, number: int) -> None:
        self.stand(number)

    def end(self) -> None:
        midi.close(self._device)

    def _send(self, message: bytes) -> None:
        with contextlib.suppress(Exception):  # A device that has vanished.
            self._device.send_message(list(message))


class PacketSender(Pulses):
    """Packets over UDP, one a frame, also of a show that stands."""

    what = ""

    def __init__(self, spec: SendSpec, show: ShowNow) -> None:
        super().__init__(spec, show)
        self.pulses_hz = spec.rate.frames_per_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        try:
            self._address = (socket.gethostbyname(spec.name), spec.port)
        except OSError as error:
            raise SourceError(f"{spec.name!r} is no address: {error.strerror}") from error
        self.text = f"{self.what} to {spec.name}, port {spec.port}"

    def stand(self, number: int) -> None:
        self.emit(number)

    def send(self, packet: bytes) -> None:
        with contextlib.suppress(OSError):  # A network that is down is up again some time.
            self._socket.sendto(packet, self._address)

    def end(self) -> None:
        self._socket.close()


class ArtNetSender(PacketSender):
    """Art-Net timecode."""

    what = "Art-Net timecode"

    def emit(self, number: int) -> None:
        self.send(artnet_packet(timecode_of(number, self.spec.rate), self.spec.rate))


class OscSender(PacketSender):
    """OSC: `/lss/timecode` with a text and seconds."""

    what = "OSC"

    def emit(self, number: int) -> None:
        rate = self.spec.rate
        text = _padded(str(timecode_of(number, rate)).encode())
        seconds = number / rate.frames_per_s - self.spec.offset_s
        self.send(_padded(b"/lss/timecode") + _padded(b",sf") + text + struct.pack(">f", seconds))


class FppSender(PacketSender):
    """FPP MultiSync: start, sync twice a second, stop. Its file has the name of the show."""

    what = "FPP MultiSync"

    def __init__(self, spec: SendSpec, show: ShowNow) -> None:
        super().__init__(spec, show)
        self.pulses_hz, self._is_started = FPP_HZ, False

    def emit(self, number: int) -> None:
        if number < 0:
            return
        if not self._is_started:
            self._is_started = True
            self._send_action("open", number)
            self._send_action("start", number)
        self._send_action("sync", number)

    def stand(self, number: int) -> None:
        if self._is_started:
            self._is_started = False
            self._send_action("stop", number)

    def end(self) -> None:
        self.stand(self._last or 0)
        super().end()

    def _send_action(self, action: Action, number: int) -> None:
        seconds = number / FPP_HZ
        frame = round(seconds * self.spec.rate.frames_per_s)
        name = f"{self.show.name or 'show'}.fseq"
        self.send(fpp_packet(FppReading(action, "sequence", frame, seconds, name)))


class LtcSender:
    """LTC on a sound device, by the clock of the show: the device's own may differ."""

    def __init__(self, spec: SendSpec, show: ShowNow) -> None:
        from lss_motion.sound.device import (
            DeviceClock,
            NoDeviceError,
            chosen_device,
            sounddevice_module,
        )

        self._spec, self._show, self._frame = spec, show, 0
        self._at = 0.0
        """Where the last block ended, in frames from midnight."""
        try:
            library = sounddevice_module()
            device = chosen_device(spec.name)
            self._stream: Any = library.OutputStream(
                device=device.name,
                channels=1,
                dtype="float32",
                latency="low",
                callback=self._render,
            )
            self._clock = DeviceClock(round(self._stream.samplerate))
            self._stream.start()
        except NoDeviceError as error:
            raise SourceError(str(error)) from error
        except Exception as error:  # PortAudio and its drivers have errors of their own.
            raise SourceError(f"sound device {spec.name or 'default'!r}: {error}") from error
        self.text = f"LTC on {device.name}, {spec.rate.name} frames a second"

    def _render(self, out: Any, count: int, times: Any, status: Any) -> None:  # noqa: ANN401, ARG002
        now_ns = time.monotonic_ns()
        ahead_s = times.outputBufferDacTime - times.currentTime
        if not 0.0 < ahead_s < 10.0:  # Some drivers state nothing.
            ahead_s = float(self._stream.latency)
        self._clock.take(self._frame, now_ns + round(ahead_s * NS_PER_S))
        first_ns = self._clock.heard_ns(self._frame)
        last_ns = first_ns + count * self._clock.ns_per_frame
        self._frame += count
        leg = self._show.leg(first_ns)
        if leg is None or self._show.is_ended or not self._clock.is_settled(self._frame):
            out.fill(0.0)
            return
        rate = self._spec.rate
        start, end = (
            (leg.show_s(at_ns) + self._spec.offset_s) * rate.frames_per_s
            for at_ns in (first_ns, last_ns)
        )
        if abs(start - self._at) > JUMP_FRAMES:
            self._at = start
        # What was sounded is continued: the time of a block is not known as well as a bit is short.
        way = (end - start) * (1.0 + min(max(start - self._at, -BEND_RATIO), BEND_RATIO))
        out[:, 0] = LEVEL * levels(np.linspace(self._at, self._at + way, count + 1), rate)
        self._at += way

    def turn(self, now_ns: int) -> float:  # noqa: ARG002  (the library calls)
        """Return how long to wait, in seconds."""
        return WAIT_S

    def end(self) -> None:
        with contextlib.suppress(Exception):
            self._stream.abort()
            self._stream.close()


SENDERS: Final[dict[str, Any]] = {
    "mtc": MtcSender,
    "artnet": ArtNetSender,
    "osc": OscSender,
    "fpp": FppSender,
    "ltc": LtcSender,
}


def _padded(data: bytes) -> bytes:
    """Return a text of OSC: with a NUL, and to four bytes."""
    return data + b"\0" * (4 - len(data) % 4)


def main(pipe: MessagePipe, words: str) -> int:
    """Send until the pipe ends, or the show is over."""
    spec = msgspec.json.decode(words, type=SendSpec)
    show = ShowNow(spec.show)
    typed: TypedPipe[SendOrder] = TypedPipe(pipe, SendOrder)
    try:
        sender = SENDERS[spec.kind](spec, show)
    except SourceError as failed:
        typed.send(TimecodeFailed(str(failed)))
        return 0
    typed.send(TimecodeOpened(sender.text))

    def turn() -> float | None:
        return None if show.is_ended else sender.turn(time.monotonic_ns())

    with prompt_waits():
        serve(typed, show.take, turn)
    sender.end()
    return 0
