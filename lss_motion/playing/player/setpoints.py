"""The filter of a servo in EM0, whose steps come at unknown instants.

`Setpoints` models it for several of the possible instants, and gives the targets that keep the
limits for all of them. `closing_deg` is how fast a joint that is off its plan closes in on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.planning.program.streamed import SETTLED_DEG

if TYPE_CHECKING:
    from lss_motion.planning.program.reference_grid import ServoLimits
    from lss_motion.robot.model import Joint

STEP_OFFSETS: Final = 32
"""Step instants that are modelled, evenly spread over one period: 0.6 ms apart. Targets on full
lines have such jitter; between instants 1.25 ms apart a joint went 6 % too fast (measured)."""
ROOM_RATIO: Final = 1.0
"""A fitted course oscillates within its tolerance. So a step may differ from the last one by this
many tolerances more than the acceleration limit allows. Of 52 streamed joints of random shows, the
worst needs 0.94."""
CLOSING_RATIO: Final = 0.5
"""Share of the acceleration that closing in on the plan may use; the plan needs the rest."""
CLOSING_GAIN: Final = 0.5
"""One step closes no more than this share of the distance to the plan."""


@dataclass(slots=True)
class _StepOffset:
    """The filter of a servo if it steps at one of the possible instants."""

    step: int
    """The number of the next step."""
    value_deg: float
    last_deg: float = 0.0
    """Length of the last step."""
    lagged_deg: float = 0.0
    """Difference between successive steps, low-pass filtered as the horn lags."""

    def step_until(self, until: int, target_deg: float, count: int, lag_ratio: float) -> None:
        """Make all steps before `until`. `lag_ratio` of a change reaches the horn at once."""
        while self.step < until:
            if self.value_deg == target_deg and self.last_deg == 0.0:
                self.step, self.lagged_deg = until, 0.0
                return
            self.step += 1
            value_deg = self.value_deg + (target_deg - self.value_deg) / count
            if abs(value_deg - target_deg) < SETTLED_DEG:
                value_deg = target_deg
            step_deg = value_deg - self.value_deg
            self.lagged_deg += lag_ratio * (step_deg - self.last_deg - self.lagged_deg)
            self.value_deg, self.last_deg = value_deg, step_deg


class Setpoints:
    """Model of the filter of one servo in EM0. Instants must not decrease.

    The filter steps every `Response.filter_s`, at unknown instants. A target that arrives a little
    late is one step late for some of the possible instants and on time for the others. So the
    filter is modelled for several of them, and a target is allowed if it keeps the limits for all.
    """

    def __init__(self, position_deg: float, *, count: int, limits: ServoLimits) -> None:
        self._limits = limits
        self._count = count
        self._period_s = limits.response.filter_s
        self._target_deg = position_deg
        response = limits.response
        self._lag_ratio = -math.expm1(-self._period_s / response.lag_s) if response.lag_s else 1.0
        self._offsets = [_StepOffset(0, position_deg) for _ in range(STEP_OFFSETS)]

    def allowed(self, arrival_s: float) -> tuple[float, float]:
        """Return the least and largest target that keep the limits if it arrives at `arrival_s`.

        Where no target keeps them for all possible instants, both are the middle of the gap.
        """
        self._advance(arrival_s)
        room_deg = ROOM_RATIO * self._limits.tolerance_deg
        spans = [self._span(offset, room_deg) for offset in self._offsets]
        low_deg, high_deg = max(low for low, _ in spans), min(high for _, high in spans)
        if low_deg > high_deg:
            low_deg = high_deg = 0.5 * (low_deg + high_deg)
        return low_deg, high_deg

    def commanded(self, arrival_s: float, target_deg: float) -> None:
        """Note that the servo receives `D target` at `received_s`."""
        self._advance(arrival_s)
        self._target_deg = target_deg

    def _advance(self, arrival_s: float) -> None:
        for index, offset in enumerate(self._offsets):
            until = math.ceil(arrival_s / self._period_s - index / STEP_OFFSETS)
            offset.step_until(until, self._target_deg, self._count, self._lag_ratio)

    def _span(self, offset: _StepOffset, room_deg: float) -> tuple[float, float]:
        """Return the targets between which the next step keeps speed, acceleration, and range."""
        limits, value_deg, last_deg = self._limits, offset.value_deg, offset.last_deg
        more_deg = step_gain_deg(limits) + room_deg
        most_deg = limits.speed_max_deg_s * self._period_s
        down_deg = self._brakable_deg(value_deg - limits.position_min_deg, most_deg, more_deg)
        up_deg = self._brakable_deg(limits.position_max_deg - value_deg, most_deg, more_deg)
        lagged_deg = (1.0 - self._lag_ratio) * offset.lagged_deg
        slowest_deg = last_deg + (-more_deg - lagged_deg) / self._lag_ratio
        fastest_deg = last_deg + (more_deg - lagged_deg) / self._lag_ratio
        low_deg = min(max(slowest_deg, -down_deg), fastest_deg)
        high_deg = max(min(fastest_deg, up_deg), slowest_deg)
        return value_deg + self._count * low_deg, value_deg + self._count * high_deg

    def _brakable_deg(self, room_deg: float, most_deg: float, less_deg: float) -> float:
        """Return the longest step, up to `most_deg`, after which the filter can brake in range.

        Every step may be shorter than the last one by `less_deg`. Its target is `count` times as
        far away as the step is long, and must not lie beyond the end of the range.
        """
        count, least_deg, steps = self._count, most_deg, 0
        if room_deg >= most_deg * (count + most_deg / less_deg):
            return most_deg
        while steps * less_deg < least_deg:
            braked_deg = less_deg * steps * (count + 0.5 * (steps - 1))
            least_deg = min(least_deg, (max(room_deg, 0.0) + braked_deg) / (count + steps))
            steps += 1
        return least_deg


def make_setpoints(joint: Joint, position_deg: float, limits: ServoLimits) -> Setpoints | None:
    """Return the filter model of a servo that stands at `position_deg`; None for other drives."""
    if joint.drive != "streamed":
        return None
    return Setpoints(position_deg, count=joint.filter_count, limits=limits)


def closing_deg(off_deg: float, limits: ServoLimits) -> float:
    """Return by how much the next step is longer than that of the plan, to close in on the plan.

    It is never so long that the joint could not brake before it reaches the plan.
    """
    less_deg = CLOSING_RATIO * step_gain_deg(limits)
    most_deg = less_deg * (math.sqrt(0.25 + 2.0 * abs(off_deg) / less_deg) - 0.5)
    return math.copysign(min(most_deg, CLOSING_GAIN * abs(off_deg)), off_deg)


def step_gain_deg(limits: ServoLimits) -> float:
    """Return the difference between successive steps that the acceleration limit allows."""
    return limits.ramp_deg_s2 * limits.response.filter_s * limits.response.filter_s
