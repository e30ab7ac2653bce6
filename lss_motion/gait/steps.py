"""Where a foot stands and when it steps: one leg of a walk, over the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.gait.curves import blend, lift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.gait.travel import Travel

    FloatArray = NDArray[np.float64]

HOME_MM: Final = 1e-6
"""A foot this near to where it stands at the end needs no more step: rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """One foot: it stands at `places_mm[k]` until step k, which takes it to `places_mm[k + 1]`.

    Standing feet do not move at all. A stepping foot leaves and meets the ground without speed
    over the ground, so that it matches the ground's speed under the body.
    """

    lifts_s: FloatArray
    lands_s: FloatArray
    places_mm: FloatArray
    height_mm: float

    def at(self, times_s: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the foot, (n, 3) mm, and whether it stands."""
        done = np.searchsorted(self.lands_s, times_s, side="right")
        begun = np.searchsorted(self.lifts_s, times_s, side="left")
        is_up = begun > done
        step = np.minimum(done, max(len(self.lifts_s) - 1, 0))
        foot = np.zeros((len(times_s), 3))
        foot[:, :2] = self.places_mm[done]
        if is_up.any():
            lifts_s = self.lifts_s[step]
            share = ((times_s - lifts_s) / (self.lands_s[step] - lifts_s))[:, None]
            stride = self.places_mm[np.minimum(step + 1, len(self.places_mm) - 1)] - foot[:, :2]
            foot[:, :2] += np.where(is_up[:, None], blend(share) * stride, 0.0)
            foot[:, 2] = np.where(is_up, self.height_mm * lift(share[:, 0]), 0.0)
        return foot, ~is_up


def steps(
    neutral_mm: FloatArray,
    travel: Travel,
    *,
    lift_ratio: float,
    duty_ratio: float,
    cycle_s: float,
    height_mm: float,
) -> Steps:
    """Return the steps of a foot that stands `neutral_mm` from the body, (2,), at rest.

    Every step leads to where the foot is neutral in the middle of the stance that follows, so
    that it reaches as far ahead as behind. It steps until it is neutral under the body at rest.
    """
    # A foot that lifts after the body has come to rest steps home.
    count = int(np.ceil(travel.duration_s / cycle_s - lift_ratio - 1e-9)) + 1
    lifts_s = cycle_s * (lift_ratio + np.arange(count))
    lands_s = lifts_s + cycle_s * (1.0 - duty_ratio)
    places_mm = below(
        neutral_mm, travel.at(np.concatenate([[0.0], lands_s + 0.5 * duty_ratio * cycle_s]))
    )
    stride_mm = np.hypot(*np.diff(places_mm, axis=0).T)
    late = lifts_s >= travel.duration_s - 1e-9 * cycle_s
    is_kept = ~(late & (stride_mm <= HOME_MM))
    return Steps(
        lifts_s=lifts_s[is_kept],
        lands_s=lands_s[is_kept],
        places_mm=places_mm[np.concatenate([[True], is_kept])],
        height_mm=height_mm,
    )


def below(neutral_mm: FloatArray, places: FloatArray) -> FloatArray:
    """Return where a foot is neutral, (n, 2), under a body at `places`, (n, 3)."""
    cosine, sine = np.cos(places[:, 2]), np.sin(places[:, 2])
    x = cosine * neutral_mm[0] - sine * neutral_mm[1]
    y = sine * neutral_mm[0] + cosine * neutral_mm[1]
    return np.asarray(places[:, :2] + np.stack([x, y], axis=1))
