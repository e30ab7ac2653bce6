"""The process that plays the sounds of a show, on one stream that is always open.

It is sent a `SoundOrder`, and sends a `SoundNews`. Nothing sounds after the show: when the pipe
ends, because the player has ended or was killed, all is faded out; when no order has come for
`LEASE_S`, because the player is held up, all is muted.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import asdict

from lss_motion.errors import InputError
from lss_motion.sound.device import NoDeviceError, OpenStream
from lss_motion.sound.mixer import FADE_S, Mixer, PrefetchedSound, Voice
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import serve, wait_for
from lss_motion.system.sound_messages import (
    ClearSounds,
    DeviceLost,
    DeviceOpened,
    Dropouts,
    EndSounds,
    Heard,
    NoDevice,
    PlaySound,
    SetLeads,
    SetLeg,
    SetOffset,
    SoundBegun,
    SoundFailed,
    SoundOrder,
    StillPlaying,
    WrongRate,
)
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from lss_motion.system.messages import MessagePipe

LOOK_S: Final = 0.05
LEASE_S: Final = 1.0
LEAD_S: Final = 0.5
"""What is heard of the bed is reported this often."""
STUCK_S: Final = 1.0
"""A device that has asked for nothing for so long is gone."""
PRIORITY: Final = 5
"""Real-time priority, below that of sound servers (JACK has 10, PipeWire 88)."""


class Sounding:
    """The sounds of one show on one device."""

    def __init__(self, stream: OpenStream, pipe: TypedPipe[SoundOrder]) -> None:
        self._stream = stream
        self._mixer = Mixer(stream.rate_hz)
        stream.mixer = self._mixer
        self._pipe = pipe
        self._is_ending = False
        self._is_lost = False
        self._sources: list[PrefetchedSound] = []
        self._alive_s = self._led_s = time.monotonic()

    def run(self) -> None:
        """Obey until the pipe ends or an order says so; then fade out."""
        serve(self._pipe, self._obey, self._turn)
        self._fade_out()
        self._pipe.send(Dropouts(self._stream.dropouts))

    def _turn(self) -> float | None:
        self._watch()
        return None if self._is_ending else LOOK_S

    def _obey(self, order: SoundOrder) -> None:
        self._alive_s = time.monotonic()
        match order:
            case SetLeg():
                with self._stream.lock:
                    self._mixer.set_leg(order.leg)
            case PlaySound():
                self._schedule(order)
            case SetOffset():
                with self._stream.lock:
                    self._mixer.set_offset(order.offset_s)
            case ClearSounds():
                with self._stream.lock:
                    self._mixer.clear()
            case SetLeads():
                self._mixer.leads = order.leads
            case EndSounds():
                self._is_ending = True
            case StillPlaying():
                pass

    def _schedule(self, order: PlaySound) -> None:
        """Open a sound and give it to the mixer."""
        try:
            source = PrefetchedSound(Path(order.path), self._stream.rate_hz)
        except InputError as error:
            self._pipe.send(SoundFailed(order.number, error.reason))
            return
        self._sources = [one for one in self._sources if not one.is_closed] + [source]
        values = asdict(order)
        del values["path"]
        with self._stream.lock:
            self._mixer.voices.append(Voice(source=source, **values))

    def _watch(self) -> None:
        """Report what has happened; mute while the player is held up."""
        now_s = time.monotonic()
        with self._stream.lock:
            self._mixer.is_muted = now_s - self._alive_s > LEASE_S
            begun, self._mixer.begun = self._mixer.begun, []
            lead = self._mixer.lead
        for voice in begun:
            self._pipe.send(SoundBegun(voice.number))
        for source in self._sources:
            if source.problem:
                self._pipe.send(SoundFailed(0, f"{source.path.name}: {source.problem}"))
                source.problem = ""
        clock = self._stream.clock
        if self._mixer.leads and clock.wrong_ratio is not None:
            self._mixer.leads = False
            self._pipe.send(WrongRate(round(clock.wrong_ratio, 4)))
        if lead is not None and self._mixer.leads and now_s - self._led_s >= LEAD_S:
            self._led_s = now_s
            heard_ns, show_s, rate = lead
            self._pipe.send(Heard(round(heard_ns), show_s, rate * clock.rate_ratio))
        quiet_s = (time.monotonic_ns() - self._stream.called_ns) / NS_PER_S
        if not self._is_lost and (quiet_s > STUCK_S or not self._stream.is_open):
            self._is_lost = True
            self._pipe.send(DeviceLost(f"sound device {self._stream.device.name!r} has stopped"))

    def _fade_out(self) -> None:
        with self._stream.lock:
            self._mixer.is_muted = True
        end_s = time.monotonic() + FADE_S + self._stream.latency_s + 0.2
        while not self._mixer.is_silent and not self._is_lost and time.monotonic() < end_s:
            wait_for((), 0.01)
        # What was rendered sounds later by the latency.
        wait_for((), 0.0 if self._is_lost else self._stream.latency_s)
        self._stream.close()


def _raise_priority() -> None:
    """Run before other programs where this is allowed, as sound servers do.

    Otherwise a thread of this process that waits for a processor keeps the device waiting.
    """
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def main(pipe: MessagePipe, device_name: str) -> int:
    """Open the device, then play until the pipe ends."""
    _raise_priority()
    typed: TypedPipe[SoundOrder] = TypedPipe(pipe, SoundOrder)
    try:
        stream = OpenStream(device_name)
    except NoDeviceError as error:
        typed.send(NoDevice(str(error)))
        return 0
    with stream:
        device = stream.device
        typed.send(DeviceOpened(device.name, device.driver, round(stream.latency_s, 4)))
        Sounding(stream, typed).run()
    return 0
