"""A sound as it is drawn: columns of its least and largest sample, and its loudness over them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.sound.envelope import MouthStyle, loudness
from lss_motion.sound.files import SoundReader

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from lss_motion.sound.spectra import Part

    FloatArray = NDArray[np.float64]

COLUMNS: Final = 1200
BLOCK: Final = 1 << 16
WAVE, LEVEL, BEAT = "#b8c4d0", "#5b3f8c", "#c98a1b"
"""Colours: samples, loudness, beats."""
NUMBERS_MAX: Final = 40
"""Beats that are numbered; of more, only some are."""


class Waveform(Struct, frozen=True, kw_only=True, eq=False):
    """Columns of a sound; `level` is its loudness from 0 to 1 at `level_at_s`."""

    at_s: FloatArray
    low: FloatArray
    high: FloatArray
    level_at_s: FloatArray
    level: FloatArray


def waveform(part: Part, columns: int = COLUMNS) -> Waveform:
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


def draw_beats(axis: Any, beats_s: FloatArray, from_s: float, to_s: float) -> None:  # noqa: ANN401
    """Draw the beats between two times as lines, with the numbers of as many as can be read."""
    axis.vlines(beats_s, 0.0, 1.0, transform=axis.get_xaxis_transform(), color=BEAT, linewidth=0.7)
    first, end = np.searchsorted(beats_s, [from_s, to_s]).tolist()
    apart = 1
    while (end - first) / apart > NUMBERS_MAX:
        apart *= 2
    for number in range(1, len(beats_s) + 1, apart):
        if not first < number <= end:
            continue
        axis.annotate(
            str(number),
            (beats_s[number - 1], 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(1, -7),
            textcoords="offset points",
            fontsize=6,
            color=BEAT,
        )
