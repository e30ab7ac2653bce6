"""Sound files as samples: WAV, FLAC, OGG, MP3 and what else libsndfile reads.

    info = sound_info(path)                      rate, channels, duration; reads the head only
    with SoundReader(path) as reader:            pieces of a file of any length, as stereo
        piece = reader.read_at(frame, count)

Every position is exact to the frame. libsndfile 1.2 is not, after a seek in an MP3 or OGG file: it
is off by up to 3000 frames (measured). Such a file is decoded from its beginning instead, a few
hundred times faster than it sounds, or more.

`powers` are short-time spectra, read piece by piece: what all analysis begins with. A frame of the
result stands for the middle of its window, so nothing that is computed from frames is late.
Memory is that of one piece, however long the file is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError, install_command
from lss_motion.system.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import ModuleType

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

FORMATS: Final = "WAV, FLAC, OGG or MP3"
STEREO: Final = 2
SKIP_FRAMES: Final = 1 << 16
"""So many frames at a time are decoded and dropped on the way to a position."""
SEEKABLE: Final = frozenset({"WAV", "WAVEX", "FLAC", "AIFF", "AU", "CAF", "W64", "RF64"})
"""Formats in which a seek is exact."""


class SoundInfo(Struct, frozen=True, kw_only=True):
    """What the head of a sound file states."""

    path: Path
    rate_hz: int
    channels: int
    frames: int
    format: str

    @property
    def duration_s(self) -> float:
        return self.frames / self.rate_hz


def soundfile_module() -> ModuleType:
    """Return the library that reads sound files; raises `InputError` without the extra."""
    try:
        import soundfile
    except (ImportError, OSError) as error:  # OSError: libsndfile itself is missing.
        raise InputError(f"sound files need a library: {install_command('sound')}") from error
    module: ModuleType = soundfile
    return module


def has_soundfile() -> bool:
    """Return whether sound files can be read."""
    try:
        soundfile_module()
    except InputError:
        return False
    return True


def is_sound(path: Path) -> bool:
    """Return whether a file begins as sound files do; without the extra, too.

    What is no regular file is none: a pipe might never deliver a byte.
    """
    if not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            head = stream.read(12)
    except OSError:
        return False  # Whoever reads it reports that.
    riff = head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE"
    aiff = head[:4] == b"FORM" and head[8:11] == b"AIF"
    mpeg = head[:1] == b"\xff" and head[1:2] in (b"\xfb", b"\xfa", b"\xf3", b"\xf2")
    return riff or aiff or mpeg or head.startswith((b"fLaC", b"OggS", b"ID3"))


def sound_info(path: Path) -> SoundInfo:
    """Return what the head of a file states; raises `InputError` if it is no sound, or empty."""
    with SoundReader(path) as reader:
        return reader.info


class SoundReader(Closing):
    """An open sound file. A context manager; not for two threads at once."""

    def __init__(self, path: Path) -> None:
        """Open the file; raises `InputError` if it is no sound, or empty."""
        self._path = path
        self._library = soundfile_module()
        self._file = self._opened()
        self._at = 0
        file = self._file
        self.info = SoundInfo(
            path=path,
            rate_hz=file.samplerate,
            channels=file.channels,
            frames=file.frames,
            format=file.format,
        )
        if not file.frames:
            file.close()
            raise InputError("holds no sound: it has 0 samples", path=path)

    def read_at(self, frame: int, count: int) -> NDArray[np.float32]:
        """Return up to `count` stereo frames (frames, 2) from `frame` on; fewer at the end."""
        return as_stereo(self.read_channels(frame, count))

    def read_channels(self, frame: int, count: int) -> NDArray[np.float32]:
        """Return up to `count` frames from `frame` on with all channels of the file.

        Raises `InputError` if the file is damaged there, or gone.
        """
        try:
            self._move_to(min(max(frame, 0), self.info.frames))
            found = self._file.read(count, dtype="float32", always_2d=True)
        except (self._library.LibsndfileError, OSError) as error:
            raise InputError(f"cannot be read from {frame} on: {error}", path=self._path) from error
        self._at += len(found)
        # A file of floats may hold anything.
        samples: NDArray[np.float32] = np.nan_to_num(found, nan=0.0, posinf=1.0, neginf=-1.0)
        return samples

    def close(self) -> None:
        self._file.close()

    def _opened(self) -> Any:  # noqa: ANN401  (the library has no types)
        path = self._path
        try:
            if not path.is_file():
                path.stat()
                raise InputError("is no file; name a sound file", path=path)
            if not path.stat().st_size:
                raise InputError("is empty; a sound file is needed", path=path)
            file = self._library.SoundFile(str(path))
        except FileNotFoundError:
            raise InputError("sound file not found; check the name", path=path) from None
        except self._library.LibsndfileError as error:
            reason = f"is not a sound that can be read; {FORMATS} can ({error.error_string})"
            raise InputError(reason, path=path) from error
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", path=path) from error
        if file.format not in SEEKABLE:
            # The library seeks after every read otherwise.
            file.seekable = lambda: False
        return file

    def _move_to(self, frame: int) -> None:
        if frame == self._at:
            return
        if self.info.format in SEEKABLE:
            self._file.seek(frame)
        else:
            if frame < self._at:
                self._file.close()
                self._file, self._at = self._opened(), 0
            while self._at < frame:
                wanted = min(SKIP_FRAMES, frame - self._at)
                count = len(self._file.read(wanted, dtype="float32", always_2d=True))
                if not count:
                    break
                self._at += count
        self._at = frame


def as_stereo(samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return two channels: mono on both, of more the odd ones left and the even ones right."""
    channels = samples.shape[1]
    if channels == STEREO:
        return samples
    if channels == 1:
        return np.repeat(samples, STEREO, axis=1)
    sides = [samples[:, side::STEREO].mean(axis=1) for side in range(STEREO)]
    return np.stack(sides, axis=1).astype(np.float32)


Channel = int | Literal["mix", "left", "right"]
"""A channel from 1 on; `mix` is the mean of all."""

PIECE_SAMPLES: Final = 1 << 17
"""Windows that are transformed at once have so many samples together: some MB. Chosen."""


class SoundPart(Struct, frozen=True, kw_only=True):
    """Which samples of a file are analysed: a channel, from `from_s` to `to_s` (None: the end)."""

    path: Path
    channel: Channel = "mix"
    from_s: float = 0.0
    to_s: float | None = None

    def frames(self, info: SoundInfo) -> tuple[int, int]:
        """Return the first frame and the end; raises `InputError` if there is nothing between."""
        end = info.frames if self.to_s is None else round(self.to_s * info.rate_hz)
        first, end = round(self.from_s * info.rate_hz), min(end, info.frames)
        if first >= end:
            to_text = "its end" if self.to_s is None else f"{self.to_s:g} s"
            raise InputError(
                f"has no sound from {self.from_s:g} s to {to_text}: it is {info.duration_s:.3f} s "
                "long",
                path=self.path,
            )
        return first, end

    def selected(self, samples: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the samples of the channel; raises `InputError` if the file does not have it."""
        count = samples.shape[1]
        match self.channel:
            case "mix":
                mixed: NDArray[np.float32] = samples.mean(axis=1)
                return mixed
            case "left" | "right":
                if count < STEREO:
                    raise InputError(
                        f"has one channel, so there is no {self.channel} one; leave out --channel",
                        path=self.path,
                    )
                return as_stereo(samples)[:, int(self.channel == "right")]
            case number:
                if not 1 <= number <= count:
                    raise InputError(
                        f"has no channel {number}; it has {count}, counted from 1", path=self.path
                    )
                return samples[:, number - 1]


class SpectrumGrid(Struct, frozen=True, kw_only=True):
    """Where the windows of a file are: one every `hop` samples, each `window` samples long."""

    rate_hz: int
    window: int
    hop: int
    count: int

    @property
    def step_s(self) -> float:
        return self.hop / self.rate_hz

    @property
    def bins_hz(self) -> FloatArray:
        """Frequencies of the bins of a spectrum."""
        return np.asarray(np.fft.rfftfreq(self.window, 1.0 / self.rate_hz), dtype=np.float64)


def grid_of(part: SoundPart, info: SoundInfo, window_s: float, hop_s: float) -> SpectrumGrid:
    """Return the windows of a part; the first and the last one are centred on its ends."""
    first, end = part.frames(info)
    hop = max(1, round(hop_s * info.rate_hz))
    window = max(8, 2 * round(window_s * info.rate_hz / 2))
    return SpectrumGrid(
        rate_hz=info.rate_hz, window=window, hop=hop, count=1 + -(-(end - first) // hop)
    )


def powers(reader: SoundReader, part: SoundPart, grid: SpectrumGrid) -> Iterator[FloatArray]:
    """Yield spectra (windows, bins) of the mean square of the samples, some windows at a time.

    The sum over the bins is the mean square under a Hann window.
    """
    first, end = part.frames(reader.info)
    weights = np.hanning(grid.window + 1)[:-1]
    scale = np.full(grid.window // 2 + 1, 2.0) / (grid.window * np.sum(weights**2))
    scale[[0, -1]] /= 2.0
    half = grid.window // 2
    held = np.zeros(half, dtype=np.float32)  # Silence before the part.
    at, done = first, 0
    while done < grid.count:
        windows = min(max(1, PIECE_SAMPLES // grid.window), grid.count - done)
        needed = (windows - 1) * grid.hop + grid.window
        while len(held) < needed:
            wanted = min(end - at, needed - len(held))
            found = part.selected(reader.read_channels(at, wanted)) if wanted > 0 else held[:0]
            if not len(found):  # The end, or a file that is shorter than its head states.
                held = np.concatenate([held, np.zeros(needed - len(held), dtype=np.float32)])
                break
            at += len(found)
            held = np.concatenate([held, found])
        views = np.lib.stride_tricks.sliding_window_view(held[:needed], grid.window)[:: grid.hop]
        spectra = np.fft.rfft(views * weights, axis=1)
        yield (spectra.real**2 + spectra.imag**2) * scale
        held = held[windows * grid.hop :]
        done += windows
