"""The process that plays the sounds of a show, on one stream that is always open.

It reads one JSON object a line from standard input:

    {"leg": [start_ns, start_s, from_rate, to_rate, ramp_ns, trim_ratio]}   the show clock
    {"sound": {"number": 3, "path": "…", "at_s": 2.0, …}}   see `Sounding._schedule`
    {"offset_s": 0.02}                                      all sounds later by so much
    {"clear": 1}                                            forget all sounds
    {"leads": false}                                        another clock leads the show
    {"alive": 1}                                            the show still runs
    {"end": 1}                                              fade out, and end

and reports on standard output:

    {"device": "…", "driver": "…", "rate_hz": 48000, "latency_s": 0.02}     ready
    {"no_device": text}                                     nothing can be played
    {"begun": 3}, {"failed": 3, "text": "…"}                of a sound
    {"lead": [instant_ns, show_s, rate]}                    what is heard of the bed
    {"wrong_ratio": 0.91}                                   this device has no clock to follow
    {"lost": text}                                          the device is gone
    {"dropouts": 2, "missing_s": 0.1}                       at the end

Nothing sounds after the show: when standard input ends, because the player has ended or was killed,
all is faded out; when no line has come for `LEASE_S`, because the player is held up, all is muted.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import sys
import time
from pathlib import Path
from typing import Any, Final

from lss_motion.errors import InputError
from lss_motion.sound.device import NoDeviceError, OpenStream
from lss_motion.sound.mixer import FADE_S, Mixer, Voice
from lss_motion.sound.sources import Source
from lss_motion.system.clock_leg import ClockLeg
from lss_motion.units import NS_PER_S

LOOK_S: Final = 0.05
LEASE_S: Final = 1.0
LEAD_S: Final = 0.5
"""What is heard of the bed is reported this often."""
STUCK_S: Final = 1.0
"""A device that has asked for nothing for so long is gone."""
READ_BYTES: Final = 65536
PRIORITY: Final = 5
"""Real-time priority, below that of sound servers (JACK has 10, PipeWire 88)."""


class Sounding:
    """The sounds of one show on one device."""

    def __init__(self, stream: OpenStream, reports_fd: int) -> None:
        self._stream = stream
        self._mixer = Mixer(stream.rate_hz)
        stream.mixer = self._mixer
        self._reports_fd = reports_fd
        self._is_ending = False
        self._is_lost = False
        self._sources: list[Source] = []
        self._alive_s = self._led_s = time.monotonic()

    def report(self, **values: object) -> None:
        try:
            os.write(self._reports_fd, json.dumps(values).encode() + b"\n")
        except OSError:
            self._is_ending = True

    def run(self, commands_fd: int) -> None:
        """Obey until the input ends or says so; then fade out."""
        rest = b""
        while not self._is_ending:
            if select.select([commands_fd], [], [], LOOK_S)[0]:
                data = os.read(commands_fd, READ_BYTES)
                if not data:
                    break
                *lines, rest = (rest + data).split(b"\n")
                self._alive_s = time.monotonic()
                for line in lines:
                    self._obey(json.loads(line))
            self._watch()
        self._fade_out()
        missing = sum(source.missing_frames for source in self._sources)
        self.report(
            dropouts=self._stream.dropouts, missing_s=round(missing / self._stream.rate_hz, 3)
        )

    def _obey(self, command: dict[str, Any]) -> None:
        match command:
            case {"leg": values}:
                with self._stream.lock:
                    self._mixer.set_leg(ClockLeg(*values))
            case {"sound": values}:
                self._schedule(**values)
            case {"offset_s": offset_s}:
                with self._stream.lock:
                    self._mixer.set_offset(offset_s)
            case {"clear": _}:
                with self._stream.lock:
                    self._mixer.clear()
            case {"leads": leads}:
                self._mixer.leads = leads
            case {"end": _}:
                self._is_ending = True
            case _:
                pass

    def _schedule(self, *, number: int, path: str, **values: Any) -> None:  # noqa: ANN401
        """Open a sound and give it to the mixer; the values are those of `Voice`."""
        try:
            source = Source(Path(path), self._stream.rate_hz)
        except InputError as error:
            self.report(failed=number, text=error.reason)
            return
        self._sources = [one for one in self._sources if not one.is_closed] + [source]
        with self._stream.lock:
            self._mixer.voices.append(Voice(number=number, source=source, **values))

    def _watch(self) -> None:
        """Report what has happened; mute while the player is held up."""
        now_s = time.monotonic()
        with self._stream.lock:
            self._mixer.is_muted = now_s - self._alive_s > LEASE_S
            begun, self._mixer.begun = self._mixer.begun, []
            lead = self._mixer.lead
        for voice in begun:
            self.report(begun=voice.number)
        for source in self._sources:
            if source.problem:
                self.report(failed=0, text=f"{source.path.name}: {source.problem}")
                source.problem = ""
        clock = self._stream.clock
        if self._mixer.leads and clock.wrong_ratio is not None:
            self._mixer.leads = False
            self.report(wrong_ratio=round(clock.wrong_ratio, 4))
        if lead is not None and self._mixer.leads and now_s - self._led_s >= LEAD_S:
            self._led_s = now_s
            heard_ns, show_s, rate = lead
            self.report(lead=[round(heard_ns), show_s, rate * clock.rate_ratio])
        quiet_s = (time.monotonic_ns() - self._stream.called_ns) / NS_PER_S
        if not self._is_lost and (quiet_s > STUCK_S or not self._stream.is_open):
            self._is_lost = True
            self.report(lost=f"sound device {self._stream.device.name!r} has stopped")

    def _fade_out(self) -> None:
        with self._stream.lock:
            self._mixer.is_muted = True
        end_s = time.monotonic() + FADE_S + self._stream.latency_s + 0.2
        while not self._mixer.is_silent and not self._is_lost and time.monotonic() < end_s:
            select.select([], [], [], 0.01)
        # What was rendered sounds later by the latency.
        select.select([], [], [], 0.0 if self._is_lost else self._stream.latency_s)
        self._stream.close()


def _raise_priority() -> None:
    """Run before other programs where this is allowed, as sound servers do.

    Otherwise a thread of this process that waits for a processor keeps the device waiting.
    """
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def main(device_name: str) -> None:
    """Open the device, then play until standard input ends."""
    _raise_priority()
    reports_fd = os.dup(1)
    os.dup2(2, 1)  # What libraries print must not be taken for a report.
    try:
        stream = OpenStream(device_name)
    except NoDeviceError as error:
        os.write(reports_fd, json.dumps({"no_device": str(error)}).encode() + b"\n")
        return
    with stream:
        sounding = Sounding(stream, reports_fd)
        device = stream.device
        sounding.report(
            device=device.name,
            driver=device.driver,
            rate_hz=stream.rate_hz,
            latency_s=round(stream.latency_s, 4),
        )
        sounding.run(0)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
