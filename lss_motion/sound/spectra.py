"""Short-time power spectra of a sound file, read piece by piece: what all analysis begins with.

A frame of the result stands for the middle of its window, so nothing that is computed from frames
is late. Memory is that of one piece, however long the file is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.sound.files import STEREO, as_stereo

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.sound.files import SoundInfo, SoundReader

    FloatArray = NDArray[np.float64]

Channel = int | Literal["mix", "left", "right"]
"""A channel from 1 on; `mix` is the mean of all."""

PIECE_SAMPLES: Final = 1 << 17
"""Windows that are transformed at once have so many samples together: some MB. Chosen."""


class Part(Struct, frozen=True, kw_only=True):
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


class Grid(Struct, frozen=True, kw_only=True):
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


def grid_of(part: Part, info: SoundInfo, window_s: float, hop_s: float) -> Grid:
    """Return the windows of a part; the first and the last one are centred on its ends."""
    first, end = part.frames(info)
    hop = max(1, round(hop_s * info.rate_hz))
    window = max(8, 2 * round(window_s * info.rate_hz / 2))
    return Grid(rate_hz=info.rate_hz, window=window, hop=hop, count=1 + -(-(end - first) // hop))


def powers(reader: SoundReader, part: Part, grid: Grid) -> Iterator[FloatArray]:
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
