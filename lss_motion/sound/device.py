"""Sound devices of this computer, through PortAudio: which there are, and one open stream.

`OpenStream` plays what a `Mixer` renders. PortAudio calls it in a thread of its own, some
milliseconds before a block sounds, and states when it will sound. `DeviceClock` fits frame numbers
against these instants: the crystal of a device is 20 to 100 ppm off, and the statements jitter.

`main` is the process that plays the sounds of a show, on one stream that is always open. It is sent
a `SoundOrder`, and sends a `SoundNews`. Nothing sounds after the show: when the pipe ends, because
the player has ended or was killed, all is faded out; when no order has come for `LEASE_S`, because
the player is held up, all is muted.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict

from lss_motion.errors import InputError, install_command
from lss_motion.files.texts import known_names
from lss_motion.sound.files import STEREO
from lss_motion.sound.mixer import FADE_S, Mixer, PrefetchedSound, Voice
from lss_motion.system import sound_messages as s
from lss_motion.system.closing import Closing
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import serve, wait_for
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import ModuleType

    from lss_motion.system.messages import MessagePipe

LATENCY_S: Final = 0.03
"""Asked of the driver. Sounds are planned ahead, so that it makes none of them late; a shorter one
would make dropouts where the computer is busy. Chosen."""
LINUX_LIBRARY: Final = "on Linux also: sudo apt install libportaudio2"
TONE_HZ: Final = 440.0
TONE_S: Final = 0.6
TONE_RATIO: Final = 0.2


class NoDeviceError(Exception):
    """No sound can be played; the text says why and what to do."""


class SoundDevice(Struct, frozen=True, kw_only=True):
    """A device that can play, as its driver states it."""

    name: str
    driver: str
    channels: int
    rate_hz: int
    latency_s: float
    is_default: bool


@contextlib.contextmanager
def quiet_drivers() -> Iterator[None]:
    """Drop what drivers print on standard error: ALSA names each device that it tries in vain."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # Standard error may be closed.
            kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, 2)
            os.dup2(null, 2)
            os.close(null)
        yield


def sounddevice_module() -> ModuleType:
    """Return the library that plays; raises `NoDeviceError` without it."""
    try:
        with quiet_drivers():
            import sounddevice
    except ImportError as error:
        raise NoDeviceError(
            f"playing sound on time needs a library: {install_command('sound')}"
        ) from error
    except OSError as error:  # PortAudio itself is missing.
        raise NoDeviceError(f"the library PortAudio is missing; {LINUX_LIBRARY}") from error
    module: ModuleType = sounddevice
    return module


def devices(way: Literal["output", "input"] = "output") -> list[SoundDevice]:
    """Return the devices that can play, or record.

    Raises `NoDeviceError` if the library is missing.
    """
    library = sounddevice_module()
    with quiet_drivers():
        default = library.default.device[1 if way == "output" else 0]
        drivers, known = library.query_hostapis(), library.query_devices()
    return [
        SoundDevice(
            name=found["name"],
            driver=drivers[found["hostapi"]]["name"],
            channels=found[f"max_{way}_channels"],
            rate_hz=round(found["default_samplerate"]),
            latency_s=found[f"default_low_{way}_latency"],
            is_default=index == default,
        )
        for index, found in enumerate(known)
        if found[f"max_{way}_channels"] > 0
    ]


def chosen_device(name: str, way: Literal["output", "input"] = "output") -> SoundDevice:
    """Return the device of that name, or the default one; raises `NoDeviceError`."""
    found, what = devices(way), "sound device" if way == "output" else "sound input"
    if not found:
        raise NoDeviceError(f"this computer has no {what}; connect one, or start its server")
    if not name or name == "default":
        return next((device for device in found if device.is_default), found[0])
    fitting = [device for device in found if name.lower() in device.name.lower()]
    exact = [device for device in fitting if device.name.lower() == name.lower()]
    if not fitting:
        text = known_names(name, [device.name for device in found])
        raise NoDeviceError(f"{what} {name!r} is not there; {text}")
    return (exact or fitting)[0]


class OpenStream(Closing):
    """A device that plays what `mixer` renders, from `open` until `close`. A context manager."""

    def __init__(self, name: str = "") -> None:
        """Open the device of that name, or the default one; raises `NoDeviceError`."""
        library = sounddevice_module()
        self.device = chosen_device(name)
        self.lock = threading.Lock()
        """Held while a block is rendered; hold it to change the mixer."""
        self.mixer: Mixer | None = None
        self.called_ns = time.monotonic_ns()
        """When the device last asked for a block."""
        self.dropouts = 0
        self.latency_s = LATENCY_S
        """As the driver states it, once it is open."""
        self._frame = 0
        try:
            self._stream: Any = library.OutputStream(
                device=self.device.name,
                channels=min(STEREO, self.device.channels),
                dtype="float32",
                latency=LATENCY_S,
                callback=self._render,
            )
            self.rate_hz = round(self._stream.samplerate)
            self.clock = DeviceClock(self.rate_hz)
            self._stream.start()
        except (library.PortAudioError, ValueError) as error:
            raise NoDeviceError(
                f"sound device {self.device.name!r} cannot be opened: {_reason(error)}"
            ) from error
        self.latency_s = float(self._stream.latency)

    @property
    def is_open(self) -> bool:
        """Whether the device still asks for blocks."""
        return bool(self._stream.active)

    def close(self) -> None:
        with contextlib.suppress(Exception):  # A device that is gone raises whatever it likes.
            self._stream.abort()
            self._stream.close()

    def _render(self, out: Any, count: int, times: Any, status: Any) -> None:  # noqa: ANN401
        now_ns = time.monotonic_ns()
        self.called_ns = now_ns
        ahead_s = times.outputBufferDacTime - times.currentTime
        if not 0.0 < ahead_s < 10.0:  # Some drivers state nothing.
            ahead_s = self.latency_s
        if status.output_underflow:
            self.dropouts += 1
            self.clock.note_dropout()
        self.clock.take(self._frame, now_ns + round(ahead_s * NS_PER_S))
        mixer = self.mixer
        if mixer is None:
            out.fill(0.0)
        else:
            with self.lock:
                block = mixer.render(
                    self.clock.heard_ns(self._frame), self.clock.ns_per_frame, count
                )
            out[:] = block if out.shape[1] == STEREO else block.mean(axis=1, keepdims=True)
        self._frame += count


def _reason(error: Exception) -> str:
    return str(error.args[0] if error.args else error)


def play_tone(name: str = "") -> tuple[SoundDevice, float]:
    """Play a short tone; return the device and the latency that its driver states.

    Raises `NoDeviceError`.
    """
    library = sounddevice_module()
    device = chosen_device(name)
    rate_hz = device.rate_hz
    times_s = np.arange(round(TONE_S * rate_hz)) / rate_hz
    fade = np.minimum(1.0, np.minimum(times_s, TONE_S - times_s) / 0.05)
    tone = (TONE_RATIO * fade * np.sin(2.0 * np.pi * TONE_HZ * times_s)).astype(np.float32)
    channels = min(STEREO, device.channels)
    try:
        with (
            quiet_drivers(),
            library.OutputStream(
                device=device.name,
                samplerate=rate_hz,
                channels=channels,
                dtype="float32",
                latency=LATENCY_S,
            ) as stream,
        ):
            stream.write(np.repeat(tone[:, None], channels, axis=1))
            latency_s = float(stream.latency)
    except library.PortAudioError as error:
        raise NoDeviceError(f"{device.name!r} cannot be opened: {_reason(error)}") from error
    return device, latency_s


WINDOW_S: Final = 60.0
POINT_S: Final = 0.25
"""One point is kept for each span of this length: the median of its blocks."""
DAMPING_S2: Final = 20.0
"""At first the jitter must not be taken for a drift: the slope is damped, by a third after 5 s and
by 6 % after 10 s. Chosen for a jitter of 0.45 ms and a drift of 100 ppm."""
SLOPE_MAX_RATIO: Final = 300e-6
"""No crystal is further off."""
WRONG_LEAST_S: Final = 3.0
WRONG_RATIO: Final = 2e-3
"""A device further off than this over `WRONG_LEAST_S` has no clock to follow. Measured elsewhere:
a device at 0.91 of its rate."""
SKIP_S: Final = 0.005
SKIP_POINTS: Final = 2
"""So many points in a row that far from the fit: frames were skipped."""
SETTLED_S: Final = 1.0
"""What a driver states for its first blocks may be off by a block (measured: 21 ms of JACK); the
fit has left such statements after this time: three points, and the one that they are seen in."""


class DeviceClock:
    """Fits the instants at which frames sound. Frames count from 0 at the first block."""

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._points: deque[tuple[float, float]] = deque(maxlen=round(WINDOW_S / POINT_S))
        """Seconds by frames, and how much later than that they sound, in seconds."""
        self._recent: deque[tuple[float, float]] = deque(maxlen=round(WRONG_LEAST_S / POINT_S))
        self._span: list[tuple[float, float]] = []
        self._origin_ns: int | None = None
        self._offset_s = self._slope = 0.0
        self._middle_s = 0.0
        self._astray = 0
        self.skips = 0
        """How often the device has skipped frames."""
        self.wrong_ratio: float | None = None
        """Rate of a device that does not run at the one it states, relative to it."""

    def take(self, frame: int, heard_ns: int) -> None:
        """Note that the driver states `heard_ns` for the sound of `frame`."""
        if self._origin_ns is None:
            self._origin_ns = heard_ns
        by_frames_s = frame / self._rate_hz
        late_s = (heard_ns - self._origin_ns) / NS_PER_S - by_frames_s
        if not self._points and not self._span:
            self._offset_s, self._slope, self._middle_s = late_s, 0.0, by_frames_s
        self._span.append((by_frames_s, late_s))
        if by_frames_s - self._span[0][0] >= POINT_S:
            self._close_span()

    def note_dropout(self) -> None:
        """Note that the driver reports a dropout: one point off the fit is a skip now."""
        self._astray = SKIP_POINTS - 1
        self._span.clear()

    def heard_ns(self, frame: float) -> float:
        """Return when `frame` sounds."""
        assert self._origin_ns is not None, "no block yet"
        by_frames_s = frame / self._rate_hz
        late_s = self._offset_s + self._slope * (by_frames_s - self._middle_s)
        return self._origin_ns + (by_frames_s + late_s) * NS_PER_S

    @property
    def is_known(self) -> bool:
        return self._origin_ns is not None

    def is_settled(self, frame: float) -> bool:
        """Return whether the first statements of the driver count no more at `frame`."""
        return bool(self._points) and frame >= SETTLED_S * self._rate_hz

    @property
    def ns_per_frame(self) -> float:
        return NS_PER_S * (1.0 + self._slope) / self._rate_hz

    @property
    def rate_ratio(self) -> float:
        """Rate of the device relative to its nominal one, by the clock of this computer."""
        return 1.0 / (1.0 + self._slope)

    def _close_span(self) -> None:
        at_s, late_s = (float(value) for value in np.median(np.array(self._span), axis=0))
        self._span.clear()
        self._judge_rate(at_s, late_s)
        if self.wrong_ratio is not None:
            return
        predicted_s = self._offset_s + self._slope * (at_s - self._middle_s)
        is_astray = bool(self._points) and abs(late_s - predicted_s) > SKIP_S
        self._astray = self._astray + 1 if is_astray else 0
        if self._astray >= SKIP_POINTS:
            self._astray = 0
            self.skips += 1
            self._points.clear()
        elif is_astray:
            return
        self._points.append((at_s, late_s))
        self._fit()

    def _judge_rate(self, at_s: float, late_s: float) -> None:
        """Notice a device that is slow or fast all the time; skipped frames are single steps."""
        self._recent.append((at_s, late_s))
        if len(self._recent) == self._recent.maxlen:
            steps_s = np.diff(np.array(self._recent), axis=0)
            drift = float(np.median(steps_s[:, 1]) / np.median(steps_s[:, 0]))
            if abs(drift) <= WRONG_RATIO:
                self.wrong_ratio = None
                return
            self.wrong_ratio = 1.0 / (1.0 + drift)
            self._points.clear()
            self._slope, self._middle_s, self._offset_s = drift, at_s, late_s

    def _fit(self) -> None:
        points = np.array(self._points)
        times_s, lates_s = points[:, 0], points[:, 1]
        self._middle_s, self._offset_s = float(times_s.mean()), float(lates_s.mean())
        away_s = times_s - self._middle_s
        slope = float((away_s * lates_s).sum() / ((away_s * away_s).sum() + DAMPING_S2))
        self._slope = max(-SLOPE_MAX_RATIO, min(slope, SLOPE_MAX_RATIO))


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

    def __init__(self, stream: OpenStream, pipe: TypedPipe[s.SoundOrder]) -> None:
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
        self._pipe.send(s.Dropouts(self._stream.dropouts))

    def _turn(self) -> float | None:
        self._watch()
        return None if self._is_ending else LOOK_S

    def _obey(self, order: s.SoundOrder) -> None:
        self._alive_s = time.monotonic()
        match order:
            case s.SetLeg():
                with self._stream.lock:
                    self._mixer.set_leg(order.leg)
            case s.PlaySound():
                self._schedule(order)
            case s.SetOffset():
                with self._stream.lock:
                    self._mixer.set_offset(order.offset_s)
            case s.ClearSounds():
                with self._stream.lock:
                    self._mixer.clear()
            case s.SetLeads():
                self._mixer.leads = order.leads
            case s.EndSounds():
                self._is_ending = True
            case s.StillPlaying():
                pass

    def _schedule(self, order: s.PlaySound) -> None:
        """Open a sound and give it to the mixer."""
        try:
            source = PrefetchedSound(Path(order.path), self._stream.rate_hz)
        except InputError as error:
            self._pipe.send(s.SoundFailed(order.number, error.reason))
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
            self._pipe.send(s.SoundBegun(voice.number))
        for source in self._sources:
            if source.problem:
                self._pipe.send(s.SoundFailed(0, f"{source.path.name}: {source.problem}"))
                source.problem = ""
        clock = self._stream.clock
        if self._mixer.leads and clock.wrong_ratio is not None:
            self._mixer.leads = False
            self._pipe.send(s.WrongRate(round(clock.wrong_ratio, 4)))
        if lead is not None and self._mixer.leads and now_s - self._led_s >= LEAD_S:
            self._led_s = now_s
            heard_ns, show_s, rate = lead
            self._pipe.send(s.Heard(round(heard_ns), show_s, rate * clock.rate_ratio))
        quiet_s = (time.monotonic_ns() - self._stream.called_ns) / NS_PER_S
        if not self._is_lost and (quiet_s > STUCK_S or not self._stream.is_open):
            self._is_lost = True
            self._pipe.send(s.DeviceLost(f"sound device {self._stream.device.name!r} has stopped"))

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
    typed: TypedPipe[s.SoundOrder] = TypedPipe(pipe, s.SoundOrder)
    try:
        stream = OpenStream(device_name)
    except NoDeviceError as error:
        typed.send(s.NoDevice(str(error)))
        return 0
    with stream:
        device = stream.device
        typed.send(s.DeviceOpened(device.name, device.driver, round(stream.latency_s, 4)))
        Sounding(stream, typed).run()
    return 0
