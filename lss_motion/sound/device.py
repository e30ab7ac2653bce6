"""Sound devices of this computer, through PortAudio: which there are, and one open stream.

`OpenStream` plays what a `Mixer` renders. PortAudio calls it in a thread of its own, some
milliseconds before a block sounds, and states when it will sound. `DeviceClock` fits frame numbers
against these instants: the crystal of a device is 20 to 100 ppm off, and the statements jitter.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from msgspec import Struct

from lss_motion.errors import install_command
from lss_motion.files.texts import known_names
from lss_motion.sound.files import STEREO
from lss_motion.system.closing import Closing
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import ModuleType

    from lss_motion.sound.mixer import Mixer

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
