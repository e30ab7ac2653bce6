"""Tempo and beats of music, as a proposal: a tracker may be half a beat off, or at half the tempo.

    found = beats_of(Part(path=path))
    found.at_s, found.bpm, found.off_beat_ratio

The strength of onsets (the rise of the level in many bands, low ones counted more) is compared
with itself to find the tempo of every passage; then the beats are the row of instants that are
strong and as far apart as that tempo says (dynamic programming). `off_beat_ratio` says how strong
the music is half way between them: near 1, a person must decide by ear.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.sound.files import SoundReader, grid_of, powers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.sound.files import SoundPart, SpectrumGrid

    FloatArray = NDArray[np.float64]

STEP_S: Final = 0.01
WINDOW_S: Final = 0.04
BANDS: Final = 24
LOW_HZ, HIGH_HZ = 40.0, 8000.0
BASS_HZ: Final = 150.0
BASS_WEIGHT: Final = 4.0
"""Bands below `BASS_HZ` count so much more: a bass drum is on the beat more often than a hi-hat."""
PIECE: Final = 1 << 14
"""Steps that are compared at once."""
TINY: Final = 1e-12
FLOOR_DB: Final = -60.0
"""A level below the loudest one of its file by this is no onset."""
BPM_MIN, BPM_MAX = 50.0, 220.0
BPM_USUAL: Final = 115.0
OCTAVES: Final = 0.9
"""Tempos around the usual one are likelier: a bell of this standard deviation, in octaves."""
PASSAGE_S: Final = 8.0
HOP_S: Final = 1.0
"""The tempo is found in passages so long and so far apart."""
CHANGE_COST: Final = 25.0
"""Cost of a change of tempo between two passages, per octave, in units of a perfect comparison."""
REGULAR: Final = 100.0
"""How much the distance of beats counts against their strength. After Ellis (2007)."""
EMPTY_RATIO: Final = 0.25
SAME_RATIO: Final = 0.85
"""Beats of which every second one is weaker than this are at twice the tempo; such with halves
stronger than this at half of it. Chosen on synthetic music: loud off-beats have 0.75."""
LATER_S: Final = 0.013
"""A rise is found so much too early, in windows of `WINDOW_S` (measured: 12 to 13 ms)."""
SECONDS_MIN: Final = 4.0
"""Shorter music has no tempo that could be found."""
STRENGTH_MIN: Final = 1e-3


class Beats(Struct, frozen=True, kw_only=True, eq=False):
    """The beats that were found, and how sure that is."""

    at_s: FloatArray
    bpm: float
    """The median tempo."""
    bpm_range: tuple[float, float]
    """The slowest and the fastest tempo of eight beats."""
    off_beat_ratio: float
    """Strength half way between beats, as a share of that on them."""
    step_s: float
    strength: FloatArray
    """Of onsets, from the beginning of the part on; its mean is 1 or less."""


def beats_of(part: SoundPart, bpm: float | None = None) -> Beats:
    """Return the beats of a part of a file; `bpm` is about the tempo, if it is known.

    Times count from the beginning of the file. Raises `InputError` if the file cannot be read, is
    too short, or has no onsets.
    """
    with SoundReader(part.path) as reader:
        grid = grid_of(part, reader.info, WINDOW_S, STEP_S)
        if grid.count * grid.step_s < SECONDS_MIN:
            raise InputError(
                f"is shorter than {SECONDS_MIN:g} s, too short for a tempo", path=part.path
            )
        strength = _strength(reader, part, grid)
    if not strength.max() > STRENGTH_MIN:
        raise InputError("has no onset, so there are no beats in it", path=part.path)
    strength /= strength.std()
    periods = _periods(strength, grid.step_s, bpm)
    places = _tracked(strength, periods)
    if bpm is None:
        places = _at_its_tempo(strength, places, grid.step_s)
    if len(places) < 3:
        raise InputError("has too few onsets for beats", path=part.path)
    at_s = grid.step_s * _refined(strength, places) + LATER_S
    spans_s = np.diff(at_s)
    means_s = np.convolve(
        spans_s, np.full(min(8, len(spans_s)), 1.0 / min(8, len(spans_s))), "valid"
    )
    return Beats(
        at_s=part.from_s + at_s,
        bpm=float(60.0 / np.median(spans_s)),
        bpm_range=(float(60.0 / means_s.max()), float(60.0 / means_s.min())),
        off_beat_ratio=_off_beat_ratio(strength, places),
        step_s=grid.step_s,
        strength=strength,
    )


def half_shifted(at_s: FloatArray) -> FloatArray:
    """Return the instants half way between beats."""
    middles_s: FloatArray = 0.5 * (at_s[1:] + at_s[:-1])
    return middles_s


def every(at_s: FloatArray, from_s: float, count: int) -> FloatArray:
    """Return each `count`-th beat, beginning with the one nearest to `from_s`."""
    first = int(np.abs(at_s - from_s).argmin()) if from_s else 0
    return at_s[first::count]


def _strength(reader: SoundReader, part: SoundPart, grid: SpectrumGrid) -> FloatArray:
    """Return how much the level rises at each step, over all bands."""
    from scipy.ndimage import uniform_filter1d

    edges_hz = np.geomspace(LOW_HZ, min(HIGH_HZ, 0.45 * grid.rate_hz), BANDS + 1)
    bins = np.searchsorted(grid.bins_hz, edges_hz)
    bins = np.unique(np.clip(bins, 1, len(grid.bins_hz) - 1))
    # Half precision is 0.03 dB here, and 24 bands of six hours are 100 MB in it.
    levels_db = np.concatenate(
        [
            (10.0 * np.log10(np.add.reduceat(power, bins, axis=1)[:, :-1] + TINY)).astype(
                np.float16
            )
            for power in powers(reader, part, grid)
        ]
    )
    floor_db = float(levels_db.max()) + FLOOR_DB
    weights = np.where(grid.bins_hz[bins[:-1]] < BASS_HZ, BASS_WEIGHT, 1.0)
    rise: FloatArray = np.zeros(grid.count)
    for first in range(1, grid.count - 1, PIECE):
        end = min(first + PIECE, grid.count - 1)
        shown_db = np.maximum(levels_db[first - 1 : end + 1].astype(np.float64), floor_db)
        rise_db = np.maximum(shown_db[2:] - shown_db[:-2], 0.0)
        rise[first:end] = rise_db @ (weights / weights.sum())
    # What rises all the time, such as noise, is no onset.
    usual = uniform_filter1d(rise, max(3, round(0.5 / grid.step_s)))
    return np.asarray(np.maximum(rise - usual, 0.0), dtype=np.float64)


def _periods(strength: FloatArray, step_s: float, bpm: float | None) -> FloatArray:
    """Return the distance of beats, in steps, at each step: the likeliest course of the tempo."""
    usual, octaves = (BPM_USUAL, OCTAVES) if bpm is None else (bpm, 0.15)
    tempos = np.geomspace(BPM_MIN, BPM_MAX, 160)
    periods = 60.0 / tempos / step_s
    liking = np.exp(-0.5 * (np.log2(tempos / usual) / octaves) ** 2)
    length, hop = round(PASSAGE_S / step_s), round(HOP_S / step_s)
    starts = range(0, max(1, len(strength) - length // 2), hop)
    scores = np.stack([_comparison(strength[s : s + length], periods) * liking for s in starts])
    apart = CHANGE_COST * np.abs(np.subtract.outer(np.log2(tempos), np.log2(tempos)))
    best, origins = scores[0], np.zeros(scores.shape, dtype=np.intp)
    for row in range(1, len(scores)):
        totals = best[None, :] - apart
        origins[row] = totals.argmax(axis=1)
        best = scores[row] + totals.max(axis=1)
    path = np.empty(len(scores), dtype=np.intp)
    path[-1] = best.argmax()
    for row in range(len(scores) - 1, 0, -1):
        path[row - 1] = origins[row, path[row]]
    middles = np.array(starts) + 0.5 * min(length, len(strength))
    return np.interp(np.arange(len(strength)), middles, periods[path])


def _comparison(passage: FloatArray, periods: FloatArray) -> FloatArray:
    """Return how well a passage agrees with itself one to four beats later, up to 1."""
    centred = passage - passage.mean()
    size = 2 * len(centred)
    spectrum = np.fft.rfft(centred, size)
    likeness = np.fft.irfft(spectrum * spectrum.conj(), size)[: len(centred)]
    if likeness[0] <= 0.0:
        return np.zeros(len(periods))
    likeness = likeness / likeness[0]
    lags = np.arange(len(likeness))
    parts = [np.interp(n * periods, lags, likeness, right=0.0) for n in (1, 2, 3, 4)]
    # The geometric mean: music that repeats after three beats only does not have a beat of 1.5.
    return np.asarray(np.prod(np.maximum(parts, 0.0), axis=0) ** (1.0 / len(parts)))


def _tracked(strength: FloatArray, periods: FloatArray) -> NDArray[np.intp]:
    """Return the steps of the best row of beats: strong, and a period apart."""
    total = strength.copy()
    origin = np.full(len(strength), -1, dtype=np.intp)
    reach = int(periods.max() * 2.0) + 1
    lags = np.arange(1, reach + 1)
    logs = np.log(lags)
    shortest, longest = np.round(0.5 * periods).astype(int), np.round(2.0 * periods).astype(int)
    log_periods = np.log(periods)
    for step in range(int(periods[0]), len(strength)):
        low, high = max(shortest[step], 1), min(longest[step], step)
        if high < low:
            continue
        before = total[step - high : step - low + 1][::-1]
        costs = before - REGULAR * (logs[low - 1 : high] - log_periods[step]) ** 2
        best = int(costs.argmax())
        if costs[best] > 0.0:
            total[step] += costs[best]
            origin[step] = step - low - best
    last = len(total) - max(int(periods[-1]), 1)
    step = last + int(total[last:].argmax())
    places = []
    while step >= 0:
        places.append(step)
        step = int(origin[step])
    return np.array(places[::-1], dtype=np.intp)


def _at_its_tempo(
    strength: FloatArray, places: NDArray[np.intp], step_s: float
) -> NDArray[np.intp]:
    """Return the beats, without every second one if those are empty, or with halves between them.

    Halves are added where they are as strong as the beats.
    """
    if len(places) < 4:
        return places
    near = _near(strength)
    sides = [float(near[places[side::2]].mean()) for side in (0, 1)]
    if min(sides) < EMPTY_RATIO * max(sides):
        return places[int(sides[1] > sides[0]) :: 2]
    spans_s = step_s * np.diff(places)
    if _off_beat_ratio(strength, places) > SAME_RATIO and 30.0 / np.median(spans_s) <= BPM_MAX:
        halves = np.round(half_shifted(places.astype(np.float64))).astype(np.intp)
        return np.sort(np.concatenate([places, halves]))
    return places


def _near(strength: FloatArray) -> FloatArray:
    """Return the largest strength within two steps."""
    from scipy.ndimage import maximum_filter1d

    return np.asarray(maximum_filter1d(strength, 5), dtype=np.float64)


def _refined(strength: FloatArray, places: NDArray[np.intp]) -> FloatArray:
    """Return the places of the peaks at beats between steps: the top of a parabola."""
    inner = np.clip(places, 1, len(strength) - 2)
    before, at, after = (strength[inner + offset] for offset in (-1, 0, 1))
    bend = before - 2.0 * at + after
    is_peak = (at >= before) & (at >= after) & (bend < 0.0)
    shift = np.where(is_peak, 0.5 * (before - after) / np.where(bend < 0.0, bend, -1.0), 0.0)
    return np.asarray(places + shift, dtype=np.float64)


def _off_beat_ratio(strength: FloatArray, places: NDArray[np.intp]) -> float:
    """Return the strength half way between beats, as a share of that on beats."""
    near = _near(strength)
    halves = np.round(half_shifted(places.astype(np.float64))).astype(np.intp)
    on_beats = float(near[places].mean())
    return float(near[halves].mean()) / on_beats if on_beats > 0.0 else 1.0
