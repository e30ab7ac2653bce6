"""What a device must play at each instant: the sounds of a show, in time with its clock.

`Mixer.render` is told when the frames of a block will sound and returns them. It has no device,
clock or thread, so that tests render an hour in seconds.

A sound is placed exactly at its show time, when it begins and whenever it is unmuted. From there
it plays at the rate of the device while the device leads (the show follows it), else at that of the
show clock, resampled. It is muted while the rate of the show is further than `RATE_BAND` from 1,
and placed again after that. Every change takes `FADE_S`, so that there are no clicks.

`PrefetchedSound` is a sound file at the rate of the device, read ahead by a thread of its own:
`frames_at` never waits; what is not read yet is silent, and counted. `resampled` converts between
rates with a windowed sinc.
"""

from __future__ import annotations

import contextlib
import math
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.sound.files import STEREO, SoundReader
from lss_motion.system.clock_leg import RATE_BAND
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.system.clock_leg import ClockLeg


FADE_S: Final = 0.05
MISPLACED_S: Final = 0.02
"""A sound this far from its place is faded out and placed again. Chosen: what is less is
corrected by the rate, and cannot be seen."""
SKIPPED_S: Final = 0.002
"""The same, when the device has just skipped frames. The show would need 7 s to follow that."""
CLOSING_S: Final = 2.0
"""A sound that does not lead makes up its error over this time,"""
CLOSING_RATIO: Final = 0.005
"""but with no more than this change of its rate, which cannot be heard."""


@dataclass(slots=True, kw_only=True, eq=False)
class Voice:
    """One sound of the show: from `at_s` on, until its end or until `until_s`.

    `speed_ratio`: seconds of the sound per second of the show. `duck_ratio`: what is left of the
    beds while this sounds.
    """

    number: int
    source: PrefetchedSound
    at_s: float
    gain_ratio: float = 1.0
    is_bed: bool = False
    is_looped: bool = False
    duck_ratio: float = 1.0
    speed_ratio: float = 1.0
    until_s: float = float("inf")
    frame: float | None = None
    """Frame of the source that is next; None: it has no place."""
    has_begun: bool = False
    fade: float = 1.0
    """Its own fade, after it was placed while others sounded."""
    is_leaving: bool = False
    """It is faded out, to be placed again."""
    is_dismissed: bool = False
    """It is not placed again."""

    def is_over(self, show_s: float, rate_hz: int) -> bool:
        """Return whether nothing of it sounds from `show_s` on."""
        if show_s >= self.until_s or (self.is_dismissed and self.frame is None):
            return True
        end_s = self.at_s + self.source.frames / (rate_hz * self.speed_ratio)
        return not self.is_looped and show_s > end_s + MISPLACED_S


class Mixer:
    """Mixes the voices of one show for a device of `rate_hz`."""

    def __init__(self, rate_hz: int) -> None:
        self.rate_hz = rate_hz
        self.voices: list[Voice] = []
        self.legs: list[ClockLeg] = []
        self.offset_s = 0.0
        """Sounds sound this much later than the show clock says."""
        self.leads = True
        """Sounds play at the rate of the device; the show clock follows."""
        self.is_muted = False
        self.is_silent = True
        """Whether the last block was silence: all fades have ended."""
        self.begun: list[Voice] = []
        """Voices that have begun and were not taken from here yet."""
        self.lead: tuple[float, float, float] | None = None
        """Of the bed in the last block: the instant in ns, the show time, the rate."""
        self._gate = 0.0
        self._duck = 1.0
        self._next_ns: float | None = None
        """When the block after the last one sounds, unless the device skips frames."""

    def set_leg(self, leg: ClockLeg) -> None:
        """Follow the show clock from now on."""
        self.legs = [*self.legs[-1:], leg]

    def set_offset(self, offset_s: float) -> None:
        """Sound later by `offset_s`; what sounds is faded out and placed again."""
        if offset_s != self.offset_s:
            self.offset_s = offset_s
            for voice in self.voices:
                voice.is_leaving = voice.frame is not None

    def clear(self) -> None:
        """Fade out all voices and forget them."""
        for voice in self.voices:
            voice.is_dismissed = voice.is_leaving = True

    def render(self, heard_ns: float, ns_per_frame: float, count: int) -> NDArray[np.float32]:
        """Return the next `count` frames, of which the first one sounds at `heard_ns`."""
        block = np.zeros((count, STEREO), dtype=np.float32)
        at_ns = heard_ns - self.offset_s * NS_PER_S
        skipped_ns = 0.0 if self._next_ns is None else abs(heard_ns - self._next_ns)
        self._next_ns = heard_ns + count * ns_per_frame
        leg = self._leg_at(at_ns)
        self.lead = None
        if skipped_ns > SKIPPED_S * NS_PER_S and leg is not None:
            self._take_up(leg, at_ns)
        if leg is None:
            self.is_silent = True
            return block
        rate = leg.rate(at_ns)
        is_open = not self.is_muted and abs(rate - 1.0) <= RATE_BAND
        gates = self._fade(self._gate, is_open=is_open, count=count)
        if self._gate == 0.0 and not is_open:
            for voice in self.voices:
                voice.frame, voice.is_leaving, voice.fade = None, False, 1.0
            self.is_silent = True
        else:
            others_are_heard = self._gate > 0.0
            self._mix(block, leg, at_ns, ns_per_frame, is_fading_in=others_are_heard)
            block *= gates[:, None]
            self.is_silent = False
        self._gate = float(gates[-1])
        show_s = leg.show_s(at_ns)
        self._drop(show_s)
        return np.clip(block, -1.0, 1.0, out=block)

    def _leg_at(self, at_ns: float) -> ClockLeg | None:
        """Return the newest leg that has begun; before the first one there is only silence."""
        begun = [leg for leg in self.legs if leg.start_ns <= at_ns]
        if begun:
            return begun[-1]
        # A show that is about to begin: its first block may hold the first frame.
        return self.legs[-1] if self.legs else None

    def _take_up(self, leg: ClockLeg, at_ns: float) -> None:
        """Have what sounds placed again, after the device has skipped frames."""
        show_s = leg.show_s(at_ns)
        for voice in self.voices:
            if voice.frame is not None:
                is_s = voice.frame / (self.rate_hz * voice.speed_ratio)
                voice.is_leaving |= abs(show_s - voice.at_s - is_s) > SKIPPED_S

    def _drop(self, show_s: float) -> None:
        gone = [voice for voice in self.voices if voice.is_over(show_s, self.rate_hz)]
        for voice in gone:
            self.voices.remove(voice)
            voice.source.close()

    def _mix(
        self,
        block: NDArray[np.float32],
        leg: ClockLeg,
        at_ns: float,
        ns_per_frame: float,
        *,
        is_fading_in: bool,
    ) -> None:
        count = len(block)
        duck = 1.0
        beds = np.zeros_like(block)
        for voice in list(self.voices):
            part = self._part(voice, leg, at_ns, ns_per_frame, count, is_fading_in=is_fading_in)
            if part is None:
                continue
            target = beds if voice.is_bed else block
            target += part
            duck = min(duck, voice.duck_ratio)
        step = count / (FADE_S * self.rate_hz)
        ducked = min(max(duck, self._duck - step), self._duck + step)
        beds *= np.linspace(self._duck, ducked, count, dtype=np.float32)[:, None]
        self._duck = ducked
        block += beds

    def _part(
        self,
        voice: Voice,
        leg: ClockLeg,
        at_ns: float,
        ns_per_frame: float,
        count: int,
        *,
        is_fading_in: bool,
    ) -> NDArray[np.float32] | None:
        """Return the block of one voice; None if it does not sound in it."""
        show_s, rate = leg.show_s(at_ns), leg.rate(at_ns)
        place = (show_s - voice.at_s) * voice.speed_ratio * self.rate_hz
        step, lead_in = voice.speed_ratio * rate, 0
        if not self.leads:
            step *= (1.0 + leg.trim_ratio) * ns_per_frame * self.rate_hz / NS_PER_S
        if voice.frame is None:
            lead_in = round(-place / step) if place < 0.0 < step else 0
            is_due = lead_in < count and place + step * count > 0.0
            if not self._is_placed(voice, place, is_due=is_due, is_fading_in=is_fading_in):
                return None
        assert voice.frame is not None
        off_s = (place + step * lead_in - voice.frame) / (self.rate_hz * voice.speed_ratio)
        if abs(off_s) > MISPLACED_S:
            voice.is_leaving = True
        elif not self.leads:
            step *= 1.0 + max(-CLOSING_RATIO, min(off_s / CLOSING_S, CLOSING_RATIO))
        part = np.zeros((count, STEREO), dtype=np.float32)
        part[lead_in:] = self._frames(voice, step, count - lead_in)
        part *= self._gains(voice, show_s, rate, count)[:, None]
        if voice.is_bed and not voice.is_leaving and self._gate == 1.0:
            heard_s = voice.at_s + voice.frame / (voice.speed_ratio * self.rate_hz)
            self.lead = (at_ns + lead_in * ns_per_frame, heard_s, rate)
        voice.frame += step * (count - lead_in)
        if not voice.has_begun:
            voice.has_begun = True
            self.begun.append(voice)
        if voice.is_leaving and voice.fade == 0.0:
            voice.frame, voice.is_leaving = None, False
        return part

    def _is_placed(self, voice: Voice, place: float, *, is_due: bool, is_fading_in: bool) -> bool:
        """Put a voice that is due where it must be; False while that is not read yet."""
        if voice.is_dismissed:
            return False
        source = voice.source
        source.want(max(place, 0.0), wraps=voice.is_looped)
        wrapped = place % source.frames if voice.is_looped else max(place, 0.0)
        if not is_due or not source.is_ready(wrapped, round(0.1 * self.rate_hz)):
            return False
        is_middle = place > MISPLACED_S * self.rate_hz
        # Whole frames are copied as they are; a frame is 20 us.
        voice.frame = float(round(max(place, 0.0)))
        voice.fade = 0.0 if is_middle and (is_fading_in or voice.fade == 0.0) else 1.0
        return True

    def _frames(self, voice: Voice, step: float, count: int) -> NDArray[np.float32]:
        assert voice.frame is not None
        voice.source.want(
            voice.frame % voice.source.frames if voice.is_looped else voice.frame,
            wraps=voice.is_looped,
        )
        frames_at = voice.source.looped_at if voice.is_looped else voice.source.frames_at
        if step == 1.0 and voice.frame.is_integer():
            return frames_at(int(voice.frame), count)
        return resampled(frames_at, voice.frame, step, count)

    def _gains(self, voice: Voice, show_s: float, rate: float, count: int) -> NDArray[np.float32]:
        gains = np.full(count, voice.gain_ratio, dtype=np.float32)
        if voice.is_leaving or voice.fade < 1.0:
            fades = self._fade(voice.fade, is_open=not voice.is_leaving, count=count)
            gains *= fades
            voice.fade = float(fades[-1])
        left_s = voice.until_s - show_s
        if left_s < FADE_S + count * rate / self.rate_hz:
            lefts_s = left_s - rate * np.arange(count, dtype=np.float32) / self.rate_hz
            gains *= np.clip(lefts_s / FADE_S, 0.0, 1.0)
        return gains

    def _fade(self, fade: float, *, is_open: bool, count: int) -> NDArray[np.float32]:
        """Return the course of a fade that goes on from `fade`, up if `is_open`, else down."""
        if fade == float(is_open):
            return np.full(count, fade, dtype=np.float32)
        steps = np.arange(1, count + 1, dtype=np.float32) / np.float32(FADE_S * self.rate_hz)
        fades: NDArray[np.float32] = np.clip(fade + (steps if is_open else -steps), 0.0, 1.0)
        return fades.astype(np.float32)


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


class PrefetchedSound:
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
