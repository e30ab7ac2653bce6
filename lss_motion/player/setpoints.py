"""What the filter of a servo in EM0 makes of its targets, at whatever instants it may step.

The filter steps every `Response.filter_s`, and nobody knows when: a target that comes a little
late is one step late for some of the possible instants and on time for the others. So the course
is kept for several of them, and a target may be said only if it keeps the limits for all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.program.filtered import SETTLED_DEG

if TYPE_CHECKING:
    from lss_motion.program.course import ServoLimits
    from lss_motion.robot.model import Joint

PHASES: Final = 16
"""Instants of the steps that are looked at, evenly spread over one period: 1.25 ms apart, about
what one command takes on an ordinary line."""
ROOM_RATIO: Final = 1.0
"""A fitted course winds within its tolerance: a step may differ from the last one by so many
tolerances, besides what the acceleration limit allows. Of 52 streamed joints of random shows, the
worst needs 0.94."""
CLOSING_RATIO: Final = 0.5
"""What closes up on the plan takes this share of the acceleration; the rest is for the plan."""
CLOSING_GAIN: Final = 0.5
"""And in one step no more than this share of what is missing."""


@dataclass(slots=True)
class _Phase:
    """The filter, if its steps are made at one of the possible instants."""

    step: int
    """The number of the next step."""
    value_deg: float
    last_deg: float = 0.0
    """How far the last step went."""
    felt_deg: float = 0.0
    """By how much steps differ from the last ones, as the horn feels it, which lags behind."""

    def go_on(self, until: int, target_deg: float, count: int, felt_ratio: float) -> None:
        """Make all steps before `until`. The horn feels `felt_ratio` of a change at once."""
        while self.step < until:
            if self.value_deg == target_deg and self.last_deg == 0.0:
                self.step, self.felt_deg = until, 0.0
                return
            self.step += 1
            value_deg = self.value_deg + (target_deg - self.value_deg) / count
            if abs(value_deg - target_deg) < SETTLED_DEG:
                value_deg = target_deg
            step_deg = value_deg - self.value_deg
            self.felt_deg += felt_ratio * (step_deg - self.last_deg - self.felt_deg)
            self.value_deg, self.last_deg = value_deg, step_deg


class Setpoints:
    """The filter of one servo, target by target. Instants must not go back."""

    def __init__(self, position_deg: float, *, count: int, limits: ServoLimits) -> None:
        self._limits = limits
        self._count = count
        self._period_s = limits.response.filter_s
        self._target_deg = position_deg
        response = limits.response
        self._felt_ratio = -math.expm1(-self._period_s / response.lag_s) if response.lag_s else 1.0
        self._phases = [_Phase(0, position_deg) for _ in range(PHASES)]

    def allowed(self, heard_s: float) -> tuple[float, float]:
        """Return the least and largest target that keep the limits if heard at `heard_s`.

        Where the possible instants disagree, it is half-way between them.
        """
        self._go_on(heard_s)
        spans = [self._span(phase) for phase in self._phases]
        low_deg, high_deg = max(low for low, _ in spans), min(high for _, high in spans)
        if low_deg > high_deg:
            low_deg = high_deg = 0.5 * (low_deg + high_deg)
        return low_deg, high_deg

    def told(self, heard_s: float, target_deg: float) -> None:
        """Note that the servo hears `D target` at `heard_s`."""
        self._go_on(heard_s)
        self._target_deg = target_deg

    def _go_on(self, heard_s: float) -> None:
        for index, phase in enumerate(self._phases):
            until = math.ceil(heard_s / self._period_s - index / PHASES)
            phase.go_on(until, self._target_deg, self._count, self._felt_ratio)

    def _span(self, phase: _Phase) -> tuple[float, float]:
        """Return between which targets the next step keeps speed, acceleration, and range."""
        limits, value_deg, last_deg = self._limits, phase.value_deg, phase.last_deg
        more_deg = _step_gain_deg(limits) + ROOM_RATIO * limits.tolerance_deg
        most_deg = limits.speed_max_deg_s * self._period_s
        down_deg = self._brakable_deg(value_deg - limits.position_min_deg, most_deg, more_deg)
        up_deg = self._brakable_deg(limits.position_max_deg - value_deg, most_deg, more_deg)
        felt_deg = (1.0 - self._felt_ratio) * phase.felt_deg
        slowest_deg = last_deg + (-more_deg - felt_deg) / self._felt_ratio
        fastest_deg = last_deg + (more_deg - felt_deg) / self._felt_ratio
        low_deg = min(max(slowest_deg, -down_deg), fastest_deg)
        high_deg = max(min(fastest_deg, up_deg), slowest_deg)
        return value_deg + self._count * low_deg, value_deg + self._count * high_deg

    def _brakable_deg(self, room_deg: float, most_deg: float, less_deg: float) -> float:
        """Return the longest step, up to `most_deg`, from which targets in the range can brake.

        Every step may be shorter than the last one by `less_deg`; the target of each, which is
        `count` times as far away as the step goes, lies no further than the end of the range.
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
    """Return the filter of a joint whose servo stands at `position_deg`; None if it has none."""
    if joint.drive != "streamed":
        return None
    return Setpoints(position_deg, count=joint.filter_count, limits=limits)


def closing_deg(off_deg: float, limits: ServoLimits) -> float:
    """Return by how much the next step goes further than the plan, to close up on it.

    No further than it can brake from before it is there.
    """
    less_deg = CLOSING_RATIO * _step_gain_deg(limits)
    most_deg = less_deg * (math.sqrt(0.25 + 2.0 * abs(off_deg) / less_deg) - 0.5)
    return math.copysign(min(most_deg, CLOSING_GAIN * abs(off_deg)), off_deg)


def _step_gain_deg(limits: ServoLimits) -> float:
    """Return by how much the acceleration limit lets a step differ from the last one."""
    return limits.ramp_deg_s2 * limits.response.filter_s * limits.response.filter_s
