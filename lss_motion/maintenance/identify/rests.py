"""What the rests alone say: how far the load pulls the horn at each angle, and the play."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.recording import Recording, Trial

    Array = NDArray[np.float64]

PLAY_LEAST_DEG: Final = 0.1
"""Less play than a wire unit is none."""
PLAY_SIGMAS: Final = 4.0
FALL_RATIO: Final = 0.5
"""Gears that fall to their other side must explain this much of what is left without them."""


class Measured(NamedTuple):
    """A number and its standard error."""

    value: float
    error: float


@dataclass(frozen=True, slots=True)
class Rests:
    """Servo degrees. `droop_deg` are coefficients over (angle - middle) / half room.

    Play shows in one of two ways: without a load, by the way from which a rest was reached; under
    a load that changes sides (`is_falling`), where it does, since the gears then fall to the other
    end of their play. A load that does not hides it.
    """

    droop_deg: tuple[float, float, float]
    play: Measured
    is_falling: bool = False


def read_rests(recording: Recording, trials: Sequence[Trial]) -> Rests:
    """Return what the rests at the end of the trials say."""
    window = recording.window
    targets = np.array([trial.orders[-1].target_deg for trial in trials])
    missing = targets - np.array([trial.rest_deg() for trial in trials])
    away = (targets - 0.5 * (window.low_deg + window.high_deg)) / (0.5 * window.room_deg)
    load = np.stack([np.ones_like(away), away, away**2], axis=1)
    ways = np.array([trial.last_way() for trial in trials])
    turned = _Line(np.column_stack([load, 0.5 * ways]), missing)
    if turned.is_real(turned.step):
        return Rests(turned.droop, turned.step)
    plain = _Line(load, missing)
    heights = np.unique(np.round(away, 3))
    falls = [
        _Line(np.column_stack([load, 0.5 * np.sign(away - height)]), missing)
        for height in 0.5 * (heights[1:] + heights[:-1])
    ]
    best = min(falls, key=lambda line: line.rms_deg, default=plain)
    level, slope, _ = best.droop
    falling = best.step._replace(value=math.copysign(best.step.value, best.step.value * slope))
    changes = abs(slope) > abs(level) and best.rms_deg < FALL_RATIO * plain.rms_deg
    if changes and best.is_real(falling):
        return Rests(best.droop, falling, is_falling=True)
    return Rests(plain.droop, Measured(0.0, turned.step.error))


class _Line:
    """Least squares of the load's parabola and, in the fourth column, of a step."""

    def __init__(self, columns: Array, missing: Array) -> None:
        found = np.linalg.lstsq(columns, missing, rcond=None)[0]
        left = missing - columns @ found
        spare = max(1, len(missing) - columns.shape[1])
        self.rms_deg = math.sqrt(float(left @ left) / spare)
        self.droop = (float(found[0]), float(found[1]), float(found[2]))
        self.step = Measured(0.0, math.inf)
        if len(found) > 3:
            spread = np.linalg.pinv(columns.T @ columns)[3, 3]
            self.step = Measured(float(found[3]), self.rms_deg * math.sqrt(max(0.0, spread)))

    @staticmethod
    def is_real(step: Measured) -> bool:
        return step.value > max(PLAY_LEAST_DEG, PLAY_SIGMAS * step.error)
