"""A voice whose syllables are known: harmonics of a low tone under one bump for each syllable."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

PITCH_HZ = 120.0
SYLLABLE_S = 0.16


def spoken(
    peaks_s: Sequence[float], seconds: float, *, rate_hz: int = 22_050, loud: float = 0.5
) -> NDArray[np.float64]:
    """Return samples with a syllable at each of `peaks_s`, and silence between them."""
    times_s = np.arange(round(seconds * rate_hz)) / rate_hz
    tone = sum(np.sin(2.0 * np.pi * k * PITCH_HZ * times_s) / k for k in range(1, 20))
    shape = np.zeros(len(times_s))
    for peak_s in peaks_s:
        away = np.clip(2.0 * (times_s - peak_s) / SYLLABLE_S, -1.0, 1.0)
        shape = np.maximum(shape, np.cos(0.5 * np.pi * away) ** 2)
    return np.asarray(loud * shape * tone / 2.0)
