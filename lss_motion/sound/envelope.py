"""How loud a sound is over time, and the turning points of that: syllables, swells, sides.

    curve = loudness(Part(path=path))                    one level every 5 ms, not late
    open_ratio = openings(curve, MouthStyle())           0 closed, 1 fully open
    keys = syllable_keys(open_ratio, curve.step_s, …)    where the mouth turns

All of it is zero-phase: a syllable of the result is where it is in the sound. Nothing here knows a
joint; a ratio from 0 to 1 becomes an angle elsewhere. `waveform` is a sound as it is
drawn: columns of its least and largest sample, and its loudness over them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.show.splines import runs
from lss_motion.sound.files import SoundReader, grid_of, powers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.sound.files import SoundPart

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]
    from typing import Any

    from numpy.typing import NDArray


STEP_S: Final = 0.005
WINDOW_S: Final = 0.02
"""Two periods of a low voice, so that the level does not follow the pulses of the glottis."""
SYLLABLE_S: Final = 0.02
"""Standard deviation of the bell that smooths the level: 7 syllables a second remain. Measured on
speech of espeak: wider ones (30 ms) join syllables, narrower ones find pulses inside of one."""
APART_S: Final = 0.08
"""Two syllables are at least so far apart."""
PROMINENCE: Final = 0.1
"""A syllable stands out of its neighbourhood by this share of a full opening."""
CLOSED: Final = 0.02
"""A smaller opening is a closed mouth."""
CLOSED_MIN_S: Final = 0.04
"""A mouth that is closed for less only passes through: one key instead of two."""
FULL_PERCENT: Final = 95.0
"""The level that opens the mouth fully is exceeded this seldom, so that one shout or click does not
make all the rest small."""
AUDIBLE_RATIO: Final = 0.01
"""Of the loudest level; what is below (-40 dB) is no part of the voice."""
PAUSE_RATIO: Final = 0.1
"""Of the loudest level; softer sound (-20 dB) comes from no side."""
SILENT: Final = 1e-5
"""A file that is never louder than -100 dB is silent."""


class MouthStyle(Struct, frozen=True, kw_only=True):
    """How a level becomes an opening."""

    band_hz: tuple[float, float] = (150.0, 5000.0)
    """Only sound between these frequencies counts. Chosen: without hum, rumble and hiss."""
    threshold_db: float = -30.0
    """What is so much softer than loud speech leaves the mouth closed."""
    attack_s: float = 0.05
    """A full opening takes at least so long; it begins earlier rather than being late."""
    release_s: float = 0.1
    """A full closing takes at least so long."""
    gain_db: float = 0.0
    """Opens more: loud syllables are all full then, and soft ones are seen."""
    opening_min: float = 0.15
    """Each syllable opens at least so far."""


class Loudness(Struct, frozen=True, kw_only=True, eq=False):
    """The level of a sound, every `step_s` from its beginning on."""

    step_s: float
    level: FloatArray

    @property
    def times_s(self) -> FloatArray:
        """The instants of the levels."""
        return np.asarray(self.step_s * np.arange(len(self.level)), dtype=np.float64)

    @property
    def full(self) -> float:
        """The level of loud passages."""
        audible = self.level[self.level >= AUDIBLE_RATIO * self.level.max()]
        return float(np.percentile(audible, FULL_PERCENT))


class TurningPoint(Struct, frozen=True, kw_only=True):
    """A place where a curve turns, or rests for `hold_s`."""

    at_s: float
    ratio: float
    hold_s: float = 0.0
    is_peak: bool = False


def loudness(
    part: SoundPart, band_hz: tuple[float, float], smooth_s: float = SYLLABLE_S
) -> Loudness:
    """Return the level of a part of a file in a band, smoothed by a bell of `smooth_s`.

    Raises `InputError` if the file cannot be read, or is silent there.
    """
    curve = _level(part, band_hz, smooth_s)
    if not curve.level.max() > SILENT:
        raise InputError(
            f"is silent between {band_hz[0]:g} and {band_hz[1]:g} Hz; name another channel or band",
            path=part.path,
        )
    return curve


def sides(
    part: SoundPart, band_hz: tuple[float, float], smooth_s: float
) -> tuple[float, FloatArray]:
    """Return the step in s, and from which side the sound comes: 0 left, 0.5 middle, 1 right.

    In pauses that is the middle. Raises `InputError` if the file is mono or silent.
    """
    left, right = (
        _level(replace(part, channel=side), band_hz, smooth_s) for side in ("left", "right")
    )
    total = left.level + right.level
    if not total.max() > SILENT:
        raise InputError("is silent", path=part.path)
    floor = PAUSE_RATIO * float(total.max())
    return left.step_s, 0.5 + 0.5 * (right.level - left.level) / np.maximum(total, floor)


def _level(part: SoundPart, band_hz: tuple[float, float], smooth_s: float) -> Loudness:
    from scipy.ndimage import gaussian_filter1d

    with SoundReader(part.path) as reader:
        grid = grid_of(part, reader.info, WINDOW_S, STEP_S)
        is_in_band = (grid.bins_hz >= band_hz[0]) & (grid.bins_hz <= band_hz[1])
        found = [power[:, is_in_band].sum(axis=1) for power in powers(reader, part, grid)]
    level = np.sqrt(np.concatenate(found))
    return Loudness(step_s=grid.step_s, level=gaussian_filter1d(level, smooth_s / grid.step_s))


def openings(curve: Loudness, style: MouthStyle) -> FloatArray:
    """Return how far the mouth is open, from 0 to 1, at each time of `curve`."""
    relative = curve.level / curve.full
    ratio = np.clip(relative * 10.0 ** (style.gain_db / 20.0), 0.0, 1.0)
    ratio[relative < 10.0 ** (style.threshold_db / 20.0)] = 0.0
    return above(ratio, curve.step_s, 1.0 / style.attack_s, 1.0 / style.release_s)


def above(values: FloatArray, step_s: float, rise_per_s: float, fall_per_s: float) -> FloatArray:
    """Return the least curve above `values` that rises and falls no faster than stated.

    Its peaks are those of `values`, at the same instants.
    """
    fall = step_s * fall_per_s * np.arange(len(values))
    after = np.maximum.accumulate(values + fall) - fall
    rise = step_s * rise_per_s * np.arange(len(values))
    before: FloatArray = (np.maximum.accumulate(after[::-1] + rise) - rise)[::-1]
    return before


def slowed(values: FloatArray, step_s: float, per_s: float) -> FloatArray:
    """Return the closest curve that never changes faster than `per_s`.

    Closest in the sense of the largest deviation: it is the middle between the least curve above
    and the largest below that keep the limit (which itself keeps it).
    """
    high = above(values, step_s, per_s, per_s)
    low = -above(-values, step_s, per_s, per_s)
    middle: FloatArray = 0.5 * (high + low)
    return middle


def syllable_keys(ratio: FloatArray, step_s: float, opening_min: float) -> list[TurningPoint]:
    """Return where a mouth turns: its largest openings, and between them valleys or rests.

    It begins and ends closed, and lasts as long as the curve.
    """
    from scipy.signal import find_peaks

    padded = np.concatenate([[0.0], ratio, [0.0]])
    peaks, _ = find_peaks(padded, prominence=PROMINENCE, distance=max(1.0, APART_S / step_s))
    peaks = np.unique(np.clip(peaks - 1, 1, len(ratio) - 2))
    found: list[TurningPoint] = []
    bounds = [-1, *peaks.tolist(), len(ratio)]
    for before, after in pairwise(bounds):
        if before >= 0:
            opening = max(float(ratio[before]), opening_min)
            found.append(TurningPoint(at_s=before * step_s, ratio=opening, is_peak=True))
        found += _valley(ratio, step_s, before, after)
    return found


def _valley(ratio: FloatArray, step_s: float, before: int, after: int) -> list[TurningPoint]:
    """Return the rest or the valley between two peaks; -1 and the length are the ends."""
    first, end = max(before, 0), min(after, len(ratio) - 1)
    part = ratio[first : end + 1]
    is_end = before < 0 or after >= len(ratio)
    closed = [
        ((first + a) * step_s, (first + b - 1) * step_s)
        for a, b in runs(part <= CLOSED)
        if is_end or (b - 1 - a) * step_s >= CLOSED_MIN_S
    ]
    if before < 0:  # The rest from the beginning on, if the sound begins softly.
        rests = closed[:1] if closed and closed[0][0] == 0.0 else [(0.0, 0.0)]
    elif after >= len(ratio):
        last_s = end * step_s
        rests = closed[-1:] if closed and closed[-1][1] == last_s else [(last_s, last_s)]
    else:
        rests = [(closed[0][0], closed[-1][1])] if closed else []
    if rests:
        return [TurningPoint(at_s=a, ratio=0.0, hold_s=b - a) for a, b in rests]
    lowest = int(np.argmin(part))
    return [TurningPoint(at_s=(first + lowest) * step_s, ratio=float(part[lowest]))]


def swell_keys(values: FloatArray, step_s: float, prominence: float) -> list[TurningPoint]:
    """Return the first value, the last one, and where a curve turns in between."""
    from scipy.signal import find_peaks

    highs, _ = find_peaks(values, prominence=prominence)
    bounds = [0, *highs.tolist(), len(values) - 1]
    chosen = set(bounds)
    for before, after in pairwise(bounds):
        lowest = before + int(np.argmin(values[before : after + 1]))
        if min(values[before], values[after]) - values[lowest] >= prominence:
            chosen.add(lowest)
    places = _alternating(values, sorted(chosen))
    return [TurningPoint(at_s=place * step_s, ratio=float(values[place])) for place in places]


def _alternating(values: FloatArray, places: list[int]) -> list[int]:
    """Return the places without those at which the curve does not turn; both ends stay."""
    kept = places[:1]
    for place, after in zip(places[1:], [*places[2:], None], strict=True):
        if (
            after is not None
            and (values[place] - values[kept[-1]]) * (values[after] - values[place]) >= 0.0
        ):
            continue
        kept.append(place)
    return kept


COLUMNS: Final = 1200
BLOCK: Final = 1 << 16
WAVE, LEVEL, BEAT = "#b8c4d0", "#5b3f8c", "#c98a1b"
"""Colours: samples, loudness, beats."""
NUMBER_IN: Final = 0.055
"""Width of a digit of the numbers of beats (measured: 0.053)."""


class Waveform(Struct, frozen=True, kw_only=True, eq=False):
    """Columns of a sound; `level` is its loudness from 0 to 1 at `level_at_s`."""

    at_s: FloatArray
    low: FloatArray
    high: FloatArray
    level_at_s: FloatArray
    level: FloatArray


def waveform(part: SoundPart, columns: int = COLUMNS) -> Waveform:
    """Return a part of a file as columns; raises `InputError` if it cannot be read."""
    with SoundReader(part.path) as reader:
        first, end = part.frames(reader.info)
        rate_hz = reader.info.rate_hz
        edges = np.unique(np.linspace(first, end, min(columns, end - first) + 1).astype(np.int64))
        low, high = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
        at = first
        while at < end:
            samples = part.selected(reader.read_channels(at, min(BLOCK, end - at)))
            if not len(samples):
                break
            places = np.searchsorted(edges, np.arange(at, at + len(samples)), side="right") - 1
            np.minimum.at(low, places, samples)
            np.maximum.at(high, places, samples)
            at += len(samples)
    try:
        curve = loudness(part, MouthStyle().band_hz)
    except InputError:  # Silent: it is drawn as such.
        times_s, level = np.zeros(0), np.zeros(0)
    else:
        times_s, level = part.from_s + curve.times_s, np.minimum(curve.level / curve.full, 1.0)
    return Waveform(
        at_s=0.5 * (edges[1:] + edges[:-1]) / rate_hz,
        low=low,
        high=high,
        level_at_s=times_s,
        level=level,
    )


def draw_waveform(axis: Any, wave: Waveform, at_s: float = 0.0, ratio: float = 1.0) -> None:  # noqa: ANN401
    """Draw a sound that begins at `at_s` and is played `ratio` times as fast as it is."""
    axis.fill_between(at_s + wave.at_s / ratio, wave.low, wave.high, color=WAVE, linewidth=0)
    if len(wave.level):
        peak = max(float(np.abs(wave.low).max()), float(wave.high.max()), 1e-6)
        step = max(1, len(wave.level) // (4 * COLUMNS))
        times_s = at_s + wave.level_at_s[::step] / ratio
        axis.plot(times_s, peak * wave.level[::step], color=LEVEL, linewidth=0.9)


def draw_beats(
    axis: Any,  # noqa: ANN401
    beats_s: FloatArray,
    span_s: tuple[float, float],
    width_in: float,
) -> None:
    """Draw the beats between two times as lines, with the numbers of as many as can be read.

    `width_in` is the width of the axes: it says for how many numbers there is room.
    """
    from_s, to_s = span_s
    axis.vlines(beats_s, 0.0, 1.0, transform=axis.get_xaxis_transform(), color=BEAT, linewidth=0.7)
    first, end = np.searchsorted(beats_s, [from_s, to_s]).tolist()
    room_s = NUMBER_IN * (len(str(end)) + 1) * (to_s - from_s) / width_in
    apart = 1
    while apart < end - first and np.diff(beats_s[first:end:apart]).min(initial=np.inf) < room_s:
        apart *= 2
    for number in range(1, len(beats_s) + 1, apart):
        if not first < number <= end:
            continue
        axis.annotate(
            str(number),
            (beats_s[number - 1], 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 1),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=6,
            color=BEAT,
        )
