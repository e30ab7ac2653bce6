"""Sound files as frames at the rate of the device, read ahead by a thread of their own.

`Source.frames_at` never waits: what is not read yet is silent, and counted. `resampled` converts
between rates with a windowed sinc.
"""

from __future__ import annotations

import contextlib
import math
import threading
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.sound.files import STEREO, SoundReader

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

TAPS: Final = 32
"""Length of the sinc, in frames of the lower of two rates."""
PHASES: Final = 1024
"""The sinc is tabled at this many places between two frames: noise at -66 dB (measured)."""
CUTOFF: Final = 0.94
"""Of half of the lower rate. Chosen: what is above is lost, what folds back is below -60 dB."""
CHUNK_S: Final = 0.5
AHEAD_CHUNKS: Final = 10
BEHIND_CHUNKS: Final = 6
"""A pause goes on a little before the place where it began."""


@lru_cache(maxsize=8)
def _kernel(taps: int, cutoff: float) -> NDArray[np.float32]:
    """Return the weights (phases + 1, taps) of a windowed sinc."""
    shares = np.arange(PHASES + 1)[:, None] / PHASES
    away = np.arange(taps)[None, :] - (taps // 2 - 1) - shares
    window = np.cos(np.pi * away / (taps + 2)) ** 2
    weights = np.sinc(cutoff * away) * window
    kernel: NDArray[np.float32] = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    return kernel


def taps_for(step: float) -> int:
    """Return how many frames of the source one frame takes at `step` source frames each."""
    return TAPS * math.ceil(max(step, 1.0))


def resampled(
    frames_at: Callable[[int, int], NDArray[np.float32]],
    from_frame: float,
    step: float,
    count: int,
) -> NDArray[np.float32]:
    """Return `count` frames, each `step` frames of the source further on.

    `frames_at(first, count)` returns that many frames of the source, also outside of it.
    """
    taps = taps_for(step)
    places = from_frame + step * np.arange(count)
    whole = np.floor(places).astype(np.int64)
    phases = np.rint((places - whole) * PHASES).astype(np.int64)
    first = int(whole[0]) - (taps // 2 - 1)
    source = frames_at(first, int(whole[-1]) - int(whole[0]) + taps)
    weights = _kernel(taps, CUTOFF / max(step, 1.0))[phases]
    windows = np.lib.stride_tricks.sliding_window_view(source, taps, axis=0)
    found: NDArray[np.float32] = np.einsum("nct,nt->nc", windows[whole - whole[0]], weights)
    return found


class Source:
    """One sound file at `rate_hz`, as stereo. Open it, then `want` what is needed next."""

    def __init__(self, path: Path, rate_hz: int) -> None:
        """Open the file; raises `InputError` if it cannot be read."""
        self._reader = SoundReader(path)
        self.path = path
        self.missing_frames = 0
        """Frames that were not read in time."""
        self.problem = ""
        """Why the rest of the file could not be read."""
        info = self._reader.info
        self._step = info.rate_hz / rate_hz
        self.frames = max(1, round(info.frames / self._step))
        self._chunk_frames = round(CHUNK_S * rate_hz)
        self._last_chunk = (self.frames - 1) // self._chunk_frames
        self._chunks: dict[int, NDArray[np.float32]] = {}
        self._wanted, self._wraps = range(0), False
        self.is_closed = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._read_ahead, daemon=True)
        self._thread.start()

    def want(self, frame: float, *, wraps: bool = False) -> None:
        """Read what follows `frame`; with `wraps` also the beginning, if the end is near."""
        chunk = int(frame // self._chunk_frames)
        wanted = range(max(chunk - BEHIND_CHUNKS, 0), chunk + AHEAD_CHUNKS)
        self._wraps = wraps
        if wanted != self._wanted:
            self._wanted = wanted
            self._wake.set()

    def is_ready(self, frame: float, span_frames: int) -> bool:
        """Return whether `span_frames` from `frame` on are in memory, or the file failed."""
        first = max(int(frame), 0) // self._chunk_frames
        last = min((int(frame) + span_frames) // self._chunk_frames, self._last_chunk)
        is_there = all(chunk in self._chunks for chunk in range(first, last + 1))
        return bool(self.problem) or is_there

    def frames_at(self, first: int, count: int) -> NDArray[np.float32]:
        """Return frames from memory; silence before the file, behind it, and where none are."""
        found = np.zeros((count, STEREO), dtype=np.float32)
        at, end = max(first, 0), min(first + count, self.frames)
        while at < end:
            index, offset = divmod(at, self._chunk_frames)
            size = min(self._chunk_frames - offset, end - at)
            chunk = self._chunks.get(index)
            if chunk is None:
                self.missing_frames += size
            else:
                piece = chunk[offset : offset + size]
                found[at - first : at - first + len(piece)] = piece
            at += size
        return found

    def looped_at(self, first: int, count: int) -> NDArray[np.float32]:
        """Return frames of the file repeated without end."""
        pieces = []
        while count > 0:
            offset = first % self.frames
            size = min(self.frames - offset, count)
            pieces.append(self.frames_at(offset, size))
            first, count = first + size, count - size
        return np.concatenate(pieces)

    def close(self) -> None:
        self.is_closed = True
        self._wake.set()

    def _read_ahead(self) -> None:
        with contextlib.closing(self._reader):
            while not self.is_closed:
                index = self._next_chunk()
                if index is None:
                    self._wake.wait(1.0)
                    self._wake.clear()
                    continue
                try:
                    self._chunks[index] = self._chunk(index)
                except InputError as error:
                    self.problem = error.reason
                    return

    def _next_chunk(self) -> int | None:
        wanted = [chunk % (self._last_chunk + 1) if self._wraps else chunk
                  for chunk in self._wanted]  # fmt: skip
        for index in wanted[: AHEAD_CHUNKS + BEHIND_CHUNKS]:
            if index <= self._last_chunk and index not in self._chunks:
                return index
        if self._last_chunk >= AHEAD_CHUNKS + BEHIND_CHUNKS:
            for index in [chunk for chunk in self._chunks if chunk not in wanted]:
                del self._chunks[index]
        return None

    def _chunk(self, index: int) -> NDArray[np.float32]:
        first = index * self._chunk_frames
        count = min(self._chunk_frames, self.frames - first)
        if self._step == 1.0:
            return self._reader.read_at(first, count)
        return resampled(self._file_frames, first * self._step, self._step, count)

    def _file_frames(self, first: int, count: int) -> NDArray[np.float32]:
        """Return frames of the file at its own rate, silent outside of it."""
        found = np.zeros((count, STEREO), dtype=np.float32)
        at = max(first, 0)
        piece = self._reader.read_at(at, max(first + count - at, 0))
        found[at - first : at - first + len(piece)] = piece
        return found
