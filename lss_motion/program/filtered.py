"""How a servo in EM0 is assumed to move on bare `D`s: the streamed response model.

Every `Response.filter_s` the servo's own target makes one step: `x += (target - x) / count`, with
`count` the FPC of the session. A command is taken up at the next control loop (`loop_s`), and
counts from the first step after that. In between, x stands still; what the horn can follow of
this staircase is its mean over one period, a polyline, and that is what is predicted here. The
horn follows it `Response.lag_s` later. Sources: `robot.model.Response`, FACTS.md M6.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from lss_motion.program.response import Piece

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.robot.model import Response

SETTLED_DEG: Final = 0.05
"""Nearer than this the filter is on its target: half of what the wire can say (assumed)."""
ROUNDING: Final = 1e-6
"""Of a step or a loop: instants this much before one still count for it."""


class FilterProfile:
    """The filter of one servo, command by command. Instants passed to `retarget` must not go back.

    `step_s` is one of the instants at which the filter steps.
    """

    def __init__(
        self, position_deg: float, *, count: int, response: Response, step_s: float
    ) -> None:
        self.period_s = response.filter_s
        self.count = count
        self.keep_ratio = 1.0 - 1.0 / count
        self._loop_s = response.loop_s
        self._step_s = step_s
        self._target_deg = position_deg
        self._steps: list[int] = []
        self._values: list[float] = []
        self._first_deg = position_deg

    # ---- steps

    def acts_on(self, heard_s: float) -> int:
        """Return the first step for which a command heard at `heard_s` counts."""
        loops = math.ceil((heard_s - self._step_s) / self._loop_s - ROUNDING)
        return math.floor(loops * self._loop_s / self.period_s + ROUNDING) + 1

    def hear_s(self, step: int) -> float:
        """Return when a command for `step` is best heard: in the middle of all that count."""
        return self.step_s(step) - self._loop_s - 0.5 * self.period_s

    def step_s(self, step: int) -> float:
        return self._step_s + step * self.period_s

    def value(self, step: int) -> float:
        """Return x after `step`, with what has been heard so far."""
        if not self._steps:
            return self._first_deg
        self._extend(step)
        if step >= self._steps[-1]:
            return self._values[-1]
        at = bisect_right(self._steps, step) - 1
        return self._values[at] if at >= 0 else self._first_deg

    # ---- commands

    def retarget(self, heard_s: float, target_deg: float, _duration_s: float | None) -> None:
        """Take up `D target` at `heard_s`; the filter goes on from where it is. T does nothing."""
        step = self.acts_on(heard_s)
        before_deg = self.value(step - 1)
        while self._steps and self._steps[-1] >= step - 1:
            self._steps.pop()
            self._values.pop()
        self._steps.append(step - 1)
        self._values.append(before_deg)
        self._target_deg = target_deg

    def _extend(self, step: int) -> None:
        """Make the steps up to `step`, or until the filter is on its target."""
        value, last = self._values[-1], self._steps[-1]
        while last < step and value != self._target_deg:
            value = self._target_deg + self.keep_ratio * (value - self._target_deg)
            if abs(value - self._target_deg) < SETTLED_DEG:
                value = self._target_deg
            last += 1
            self._steps.append(last)
            self._values.append(value)

    # ---- the polyline

    def at(self, time_s: float) -> tuple[float, float]:
        """Return mean position and speed at `time_s`."""
        place = (time_s - self._step_s) / self.period_s - 0.5
        if not self._steps or not math.isfinite(place):
            return (self._values[-1] if self._values else self._first_deg), 0.0
        step = math.floor(place)
        low, high = self.value(step), self.value(step + 1)
        return low + (place - step) * (high - low), (high - low) / self.period_s

    def forget_before(self, time_s: float) -> None:
        """Drop history that ends before `time_s`, so that memory stays bounded."""
        step = math.floor((time_s - self._step_s) / self.period_s - 0.5)
        kept = bisect_right(self._steps, step) - 1
        if kept > 0:
            self._first_deg = self._values[kept]
            del self._steps[:kept], self._values[:kept]

    def pieces(self) -> Iterator[Piece]:
        """Yield the polyline; its first piece has no beginning, its last one no end."""
        yield Piece(-math.inf, self._first_deg, 0.0, 0.0)
        if not self._steps:
            return
        self._extend(self._steps[-1] + 10_000)
        knots = list(zip(self._steps, self._values, strict=True))
        for (step, value), (after, reached) in pairwise(knots):
            start_s = self.step_s(step) + 0.5 * self.period_s
            speed_deg_s = (reached - value) / ((after - step) * self.period_s)
            yield Piece(start_s, value, speed_deg_s, 0.0)
        last, value = knots[-1]
        yield Piece(self.step_s(last) + 0.5 * self.period_s, value, 0.0, 0.0)
