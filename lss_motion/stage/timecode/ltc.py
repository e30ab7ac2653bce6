"""Linear timecode: a frame as 80 bits, as sound (biphase mark), and back; only numpy.

    bits     0–63 label in BCD, lowest bit first, with 32 user bits between; bit 10 drop-frame
             64–79 the sync word 0011111111111101
    sound    the level changes at the start of every bit, and in the middle of a 1

One bit (27, at 25 frames a second 59) makes the number of changes of a frame even. So every frame
begins with the same level, and the level is a function of the position alone (`levels`).

The rate is not coded. A frame is complete at its end, and that is where its label is known: at the
start of the next frame.
"""

from __future__ import annotations

import math
from collections import deque
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from lss_motion.stage.timecode.timecode import Timecode, timecode_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from lss_motion.stage.timecode.timecode import FrameRate

    FloatArray = NDArray[np.float64]

BITS: Final = 80
SYNC_WORD: Final = 0xBFFC
"""Bits 64 to 79, the first one lowest: 0011111111111101."""
_FIELDS: Final = ((56, 2, 48, 4), (40, 3, 32, 4), (24, 3, 16, 4), (8, 2, 0, 4))
"""Tens and units of hours, minutes, seconds and frames: first bit and number of bits."""
_DROP_BIT: Final = 10
_PARITY_BIT: Final = {24: 27, 25: 59, 30: 27}


def frame_bits(timecode: Timecode, rate: FrameRate) -> int:
    """Return the 80 bits of a frame, the first one lowest."""
    bits = SYNC_WORD << 64
    for value, (tens_at, _, units_at, _) in zip(timecode, _FIELDS, strict=True):
        tens, units = divmod(value, 10)
        bits |= (tens << tens_at) | (units << units_at)
    if rate.is_drop:
        bits |= 1 << _DROP_BIT
    if bits.bit_count() % 2:  # 80 changes at the starts, and one in each 1.
        bits |= 1 << _PARITY_BIT[rate.labels]
    return bits


def read_bits(bits: int) -> tuple[Timecode, bool] | None:
    """Return the label of a frame and whether it is drop-frame; None: these are no label."""
    values = []
    for tens_at, tens_bits, units_at, units_bits in _FIELDS:
        tens = (bits >> tens_at) & ((1 << tens_bits) - 1)
        units = (bits >> units_at) & ((1 << units_bits) - 1)
        if units > 9:
            return None
        values.append(10 * tens + units)
    hours, minutes, seconds, frames = values
    if hours > 23 or minutes > 59 or seconds > 59 or frames > 29:
        return None
    return Timecode(hours, minutes, seconds, frames), bool(bits >> _DROP_BIT & 1)


# ---- making it


@lru_cache(maxsize=256)
def _sums(frame: int, rate: FrameRate) -> FloatArray:
    """Return the integral of the level over a frame at its 161 half bits, in half bits."""
    bits, level, levels = frame_bits(timecode_of(frame, rate), rate), -1.0, []
    for number in range(BITS):
        level = -level
        levels.append(level)
        if bits >> number & 1:
            level = -level
        levels.append(level)
    return np.concatenate([[0.0], np.cumsum(levels)])


def levels(positions: FloatArray, rate: FrameRate) -> FloatArray:
    """Return the sound between successive positions, in frames from midnight: -1 to 1.

    One value less than positions, which may also stand or run backward. Each value is the mean
    level over its span, so that edges are where they belong between two samples.
    """
    first = math.floor(float(positions.min()))
    count = math.floor(float(positions.max())) - first + 1
    parts, base = [np.zeros(1)], 0.0
    for frame in range(first, first + count):
        sums = _sums(frame % rate.frames_per_day, rate)
        parts.append(base + sums[1:])
        base += float(sums[-1])
    table = np.concatenate(parts)
    halves = (positions - first) * (2 * BITS)
    integral = np.interp(halves, np.arange(len(table)), table)
    spans = np.diff(halves)
    is_still = np.abs(spans) < 1e-9
    means = np.diff(integral) / np.where(is_still, 1.0, spans)
    # A signal that stands is silence to whoever listens, whatever its level.
    result: FloatArray = np.where(is_still, 0.0, means)
    return result


def sound_of(timecode: Timecode, rate: FrameRate, frames: int, rate_hz: int) -> FloatArray:
    """Return the sound of so many frames from `timecode` on."""
    count = math.floor(frames * rate_hz / rate.frames_per_s)
    start = timecode.frame(rate)
    return levels(start + np.arange(count + 1) * rate.frames_per_s / rate_hz, rate)


# ---- reading it


class LtcFrame(NamedTuple):
    """One frame that was read.

    At sample `at` (counted from the first one, with a fraction) the tape passed the end of the
    frame, or, if it runs backward, its beginning.
    """

    at: float
    timecode: Timecode
    is_drop: bool
    is_reverse: bool
    frame_samples: float
    """How long its 80 bits took."""


CHUNK_S: Final = 0.01
"""Samples are looked at in pieces of this length: twenty bits, which have both levels."""
HYSTERESIS: Final = 0.35
"""The level has changed when it passes this share of its height on the other side. Chosen: noise
up to a third of the signal makes no change, and rounded edges still do."""
SILENCE: Final = 1e-3
"""A signal that is smaller, -60 dB, is none."""
LONG_RATIO: Final = 0.75
"""A span between two changes that is longer than this share of a bit is a 0."""
TOO_LONG_RATIO: Final = 1.6
BIT_HZ: Final = (950.0, 4900.0)
"""Bits a second: 24 frames at half speed to 30 frames at double speed."""
FIRST_BIT_HZ: Final = 2160.0
"""Before anything is known: spans at 24 to 30 frames a second are told apart with this."""
SHORTEST_RATIO: Final = 0.2
ADAPT: Final = 0.06
"""How quickly the length of a bit follows that of the last ones."""
UNREAD_S: Final = 0.15
HALVES_QUANTILE: Final = 0.13
_MASK: Final = (1 << BITS) - 1
_TOP: Final = 1 << (BITS - 1)


class LtcDecoder:
    """Reads frames from blocks of sound of any size, forward and backward.

    Level, polarity and a constant offset of the sound do not matter. No sample raises.
    """

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._chunk = max(32, round(CHUNK_S * rate_hz))
        self._rest: list[NDArray[np.float32]] = []
        self._rest_count = 0
        self._taken = 0
        """Samples of finished chunks."""
        self._height = 0.0
        self._is_high = False
        self._before = 0.0
        """The last sample of the chunk before."""
        self._bit_range = (rate_hz / BIT_HZ[1], rate_hz / BIT_HZ[0])
        self._bit = rate_hz / FIRST_BIT_HZ
        self._flip = 0.0
        self._half: float | None = None
        """Length of the first half of a 1 whose second half is awaited."""
        self._forward = self._backward = 0
        self._spans: deque[float] = deque(maxlen=2 * BITS)
        self._read_at = 0.0
        """Where the last frame was read."""
        self._starts: deque[float] = deque(maxlen=BITS)
        """Where the last bits began."""
        self.level = 0.0
        """Half of the distance between the two levels, full scale 1."""

    def take(self, block: NDArray[np.float32]) -> list[LtcFrame]:
        """Return the frames that are complete with these samples."""
        self._rest.append(np.asarray(block, dtype=np.float32).reshape(-1))
        self._rest_count += len(self._rest[-1])
        if self._rest_count < self._chunk:
            return []
        samples = np.concatenate(self._rest)
        whole = len(samples) - len(samples) % self._chunk
        self._rest, self._rest_count = [samples[whole:]], len(samples) - whole
        found: list[LtcFrame] = []
        for start in range(0, whole, self._chunk):
            for flip in self._flips(samples[start : start + self._chunk].astype(np.float64)):
                found += self._span(flip)
            self._taken += self._chunk
            self._look_anew()
        return found

    def _flips(self, chunk: FloatArray) -> list[float]:
        """Return where the level changes, in samples."""
        chunk = np.nan_to_num(chunk, posinf=1.0, neginf=-1.0)
        low, high = np.quantile(chunk, (0.1, 0.9))
        height = 0.5 * float(high - low)
        self._height = height if height > self._height else 0.5 * (self._height + height)
        self.level = self._height
        if height < SILENCE:
            self._before, self._half = float(chunk[-1]), None
            return []
        centred = chunk - 0.5 * (low + high)
        threshold = HYSTERESIS * min(self._height, 2.0 * height)
        sides = np.where(centred > threshold, 1, np.where(centred < -threshold, -1, 0))
        known = np.flatnonzero(sides)
        if not len(known):
            self._before = float(centred[-1])
            return []
        held = sides[known]
        before = np.concatenate([[1 if self._is_high else -1], held[:-1]])
        changed = held != before
        places, heads = known[changed], held[changed]
        self._is_high = bool(held[-1] > 0)
        # Where it passed the threshold, between two samples: symmetric for rising and falling.
        here = centred[places]
        earlier = np.where(places > 0, centred[places - 1], self._before)
        step = here - earlier
        share = np.where(np.abs(step) > 1e-12, (here - heads * threshold) / step, 0.0)
        self._before = float(centred[-1])
        result: list[float] = (self._taken + places - np.clip(share, 0.0, 1.0)).tolist()
        return result

    def _span(self, flip: float) -> Iterator[LtcFrame]:
        """Take the span that ends with a change at `flip`."""
        span, began = flip - self._flip, self._flip
        self._flip = flip
        self._spans.append(span)
        half, self._half = self._half, None
        if span > TOO_LONG_RATIO * self._bit or span < SHORTEST_RATIO * self._bit:
            self._forget()
        elif span > LONG_RATIO * self._bit:
            if half is not None:  # Halves of two bits were taken for one bit.
                self._forget()
            self._learn(span)
            yield from self._take_bit(0, began, flip)
        elif half is None:
            self._half = span
        else:
            self._learn(half + span)
            yield from self._take_bit(1, flip - half - span, flip)

    def _learn(self, span: float) -> None:
        self._set_bit(self._bit + ADAPT * (span - self._bit))

    def _set_bit(self, samples: float) -> None:
        self._bit = min(max(samples, self._bit_range[0]), self._bit_range[1])

    def _forget(self) -> None:
        """Forget the bits so far."""
        self._forward = self._backward = 0
        self._starts.clear()

    def _look_anew(self) -> None:
        """Take the length of a bit from the spans of late, if nothing can be read with this one.

        At least a quarter of the spans of a frame are halves: the sync word alone has 24.
        """
        if self._taken - self._read_at > UNREAD_S * self._rate_hz and len(self._spans) > BITS:
            self._set_bit(2.0 * float(np.quantile(self._spans, HALVES_QUANTILE)))

    def _take_bit(self, bit: int, began: float, ended: float) -> Iterator[LtcFrame]:
        self._starts.append(began)
        self._forward = self._forward >> 1 | (_TOP if bit else 0)
        self._backward = (self._backward << 1 | bit) & _MASK
        if len(self._starts) < BITS:
            return
        if self._forward >> 64 == SYNC_WORD:
            yield from self._frame(self._forward, ended, is_reverse=False)
        elif self._backward >> 64 == SYNC_WORD:
            yield from self._frame(self._backward, ended, is_reverse=True)

    def _frame(self, bits: int, ended: float, *, is_reverse: bool) -> Iterator[LtcFrame]:
        label = read_bits(bits)
        if label is not None:
            self._read_at = ended
            yield LtcFrame(ended, *label, is_reverse, ended - self._starts[0])
