"""Synthetic music whose beats are known: drums and chords, with off-beats, swing and changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

RATE_HZ = 22_050
BEFORE_S = 0.7
"""Silence before the first beat."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Style:
    """`swing` is where the off-beat is, 0.5 straight; `off_gain` how loud the hi-hat on it is."""

    name: str
    bpm: float
    to_bpm: float | None = None
    swing: float = 0.5
    off_gain: float = 0.0
    has_kick: bool = True
    has_chords: bool = False


def beats_s(style: Style, seconds: float) -> FloatArray:
    """Return the instants of the beats; the tempo changes half way, if it does."""
    times_s, at_s = [], BEFORE_S
    while at_s < seconds - 0.3:
        times_s.append(at_s)
        is_late = style.to_bpm is not None and at_s > 0.5 * seconds
        at_s += 60.0 / (style.to_bpm if is_late and style.to_bpm else style.bpm)
    return np.array(times_s)


def music(style: Style, seconds: float, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return samples at `RATE_HZ`, and the instants of the beats in s."""
    rng = np.random.default_rng(seed)
    samples = rng.normal(0.0, 0.002, round(seconds * RATE_HZ))
    times_s = beats_s(style, seconds)
    spans_s = np.append(np.diff(times_s), 60.0 / style.bpm)
    for number, (at_s, span_s) in enumerate(zip(times_s, spans_s, strict=True)):
        if style.has_kick:
            _add(samples, at_s, 0.8 * _tone(55.0, 0.12))
        if number % 2:
            _add(samples, at_s, 0.4 * _noise(rng, 0.1))
        _add(samples, at_s, 0.12 * _noise(rng, 0.03))
        if style.off_gain:
            _add(samples, at_s + style.swing * span_s, style.off_gain * _noise(rng, 0.05))
        if style.has_chords and number % 4 == 0:
            notes = sum(_tone(hz, 3.0 * span_s, 1.0) for hz in (220.0, 277.2, 329.6))
            _add(samples, at_s, 0.08 * np.asarray(notes))
    return samples, times_s


def _tone(hz: float, seconds: float, fall: float = 5.0) -> FloatArray:
    times_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return np.asarray(np.sin(2.0 * np.pi * hz * times_s) * np.exp(-fall * times_s / seconds))


def _noise(rng: np.random.Generator, seconds: float) -> FloatArray:
    times_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return np.asarray(
        np.diff(rng.normal(0.0, 1.0, len(times_s) + 1)) * np.exp(-5.0 * times_s / seconds)
    )


def _add(samples: FloatArray, at_s: float, sound: FloatArray) -> None:
    first = round(at_s * RATE_HZ)
    room = samples[first : first + len(sound)]
    room += sound[: len(room)]


def verdict(
    found_s: FloatArray, true_s: FloatArray, near_s: float = 0.07
) -> tuple[str, float, float]:
    """Return what a row of beats is, its F-measure against that, and its median error in s.

    It is right, half off (half a beat), at double or half the tempo, or wrong.
    """
    halves_s = 0.5 * (true_s[1:] + true_s[:-1])
    candidates = {
        "right": true_s,
        "half off": halves_s,
        "double": np.sort(np.concatenate([true_s, halves_s])),
        "half": true_s[::2],
        "half, other": true_s[1::2],
    }
    best = ("wrong", 0.0, np.inf)
    for name, wanted_s in candidates.items():
        away_s = found_s[np.abs(found_s[None, :] - wanted_s[:, None]).argmin(axis=1)] - wanted_s
        hits = np.abs(away_s) <= near_s
        share = 2.0 * hits.sum() / (len(found_s) + len(wanted_s))
        if share > best[1]:
            best = (name, float(share), float(np.median(away_s[hits])) if hits.any() else np.inf)
    return best if best[1] >= 0.8 else ("wrong", best[1], best[2])


STYLES = tuple(
    style
    for bpm in (60, 75, 90, 105, 120, 135, 150, 165, 180)
    for style in (
        Style(name="straight", bpm=bpm),
        Style(name="off-beats", bpm=bpm, off_gain=0.4),
        Style(name="loud off-beats", bpm=bpm, off_gain=0.8, has_chords=True),
        Style(name="swing", bpm=bpm, off_gain=0.4, swing=0.66),
        Style(name="off-beats, no kick", bpm=bpm, off_gain=0.8, has_kick=False),
        Style(name="tempo change", bpm=bpm, to_bpm=1.15 * bpm, off_gain=0.3),
    )
)
