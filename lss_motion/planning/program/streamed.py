"""The drives `streamed` and `stepped`.

Streamed: the model of a servo in EM0, and the fit of bare `D` commands to it.

The model: every `Response.filter_s` the servo's own target makes one step, `x += (target - x) /
count`, with `count` the FPC of the session. The servo takes up a command at its next control loop
(`loop_s`), and the command counts from the first step after that. Between steps x stands still. The
horn can follow the mean of this staircase over one period, a polyline; the prediction is that
polyline. The horn follows it `Response.lag_s` later. Sources: `robot.model.Response`, FACTS.md M6.

The fit: every command is the *inverse* of the filter: a target so far beyond the reference that the
filter, which goes only part of the way in each step, is on the reference. One command serves as
many steps as it can within the tolerance. Where the reference comes to rest, the target is the
resting place, repeated until the filter has settled even if some commands were lost.

FPC is a trade: a longer filter is straighter between its commands, so fewer are needed, but its
targets lie further ahead, and so does the place at which a robot without a host comes to rest (FPC
times 20 ms of motion). On simulated servos and the lively show of the benchmarks, six joints take
5.2, 4.3, 3.8 and 3.0 % of a 115200 line with an FPC of 3, 4, 5 and 8; their horns are 0.19 to 0.22
deg off (RMS, without feedback) with each of them, because the instants of the filter's steps are
unknown. 4 is chosen as the middle.

A target that serves several steps makes the first of them long and the others shorter: within the
tolerance the speed is a saw-tooth. So no streamed joint gets more than 0.2 deg
(`TOLERANCE_MAX_DEG`), also where a full line relaxes the tolerance of the others, and no target
changes the steps by more than the acceleration limit and this tolerance. Of 12 lively shows with a
limit of 600 deg/s² and an FPC of 2, 4 and 8, the acceleration behind the lag of the horn is at most
1,046 deg/s²; before, it was up to 1,390.

Targets must come at even distances: a filter whose target is late takes the one before once more,
and brakes by a share of 1 / FPC of its step, whatever the host does. So the joints of a bus aim at
instants apart from each other (`line.with_phases`), they are fitted before all others, and
`verify` computes what their filters make of the targets, whenever they step (`filter_accel`). A
show that a line cannot carry so is refused: it takes a faster line, fewer streamed joints, lower
speeds, a longer filter, or `drive: timed`, whose ramps the servo keeps itself.

Stepped is for whole degrees, the RC servo of a 2IO board: a command makes the servo jump, so that
its profile is a staircase. The best instant of a step is where the reference is half-way between
two whole degrees.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.planning.program.cones import CONE_RATIO
from lss_motion.planning.program.moves import Setpoint, nearest_wire
from lss_motion.planning.program.reference_grid import GRID_S, STILL_DEG, STILL_ROUNDING_DEG
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.robot.profile import Piece

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lss_motion.planning.program.reference_grid import Reference, ServoLimits
    from lss_motion.planning.program.response import FloatArray
    from lss_motion.robot.model import Joint, Response


SETTLED_DEG: Final = 0.05
"""Nearer than this, the filter is on its target: half a wire unit (assumed)."""
ROUNDING: Final = 1e-6
"""In steps or loops: an instant this little before a step or loop still counts for it."""

STEPS_MAX: Final = 16
"""The most steps that one command is relied on (320 ms): the next one repairs a lost command."""
PHASES: Final = 32
"""Instants of a filter's steps for which its acceleration is computed, 0.6 ms apart."""
SETTLING_STEPS: Final = 20
"""After so many steps without a new target a filter brakes no more than before."""
STEPS_AT_ONCE: Final = 128
BEND_LEAST_RATIO: Final = 0.25
"""A reference at its limit bends so far between two steps that it uses up a narrow tolerance; the
fit then still gets this share of the bend."""


class FilterProfile:
    """The filter of one servo, command by command. Instants passed to `retarget` must not decrease.

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

    def acts_on(self, received_s: float) -> int:
        """Return the first step for which a command received at `received_s` counts."""
        loops = math.ceil((received_s - self._step_s) / self._loop_s - ROUNDING)
        return math.floor(loops * self._loop_s / self.period_s + ROUNDING) + 1

    def receive_s(self, step: int) -> float:
        """Return the best instant to receive a command for `step`: amid those that count."""
        return self.step_s(step) - self._loop_s - 0.5 * self.period_s

    def step_s(self, step: int) -> float:
        return self._step_s + step * self.period_s

    def value(self, step: int) -> float:
        """Return x after `step`, with the commands received so far."""
        if not self._steps:
            return self._first_deg
        self._extend(step)
        if step >= self._steps[-1]:
            return self._values[-1]
        at = bisect_right(self._steps, step) - 1
        return self._values[at] if at >= 0 else self._first_deg

    # ---- commands

    def retarget(self, received_s: float, target_deg: float, _duration_s: float | None) -> None:
        """Apply `D target` received at `received_s`, from the filter's value. T has no effect."""
        step = self.acts_on(received_s)
        before_deg = self.value(step - 1)
        while self._steps and self._steps[-1] >= step - 1:
            self._steps.pop()
            self._values.pop()
        self._steps.append(step - 1)
        self._values.append(before_deg)
        self._target_deg = target_deg

    def _extend(self, step: int) -> None:
        """Compute the steps up to `step`, or until the filter is on its target."""
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
        """Yield the polyline. Its first piece has no begin, its last one no end."""
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


def filter_accel(
    received_s: FloatArray, target_deg: FloatArray, begin_deg: float, joint: Joint
) -> tuple[float, float]:
    """Return the largest acceleration of a horn behind its filter, in deg/s², and its instant.

    The servo stands at `begin_deg`, and receives a target at each of `received_s`, in order. The
    filter steps at unknown instants: the largest value of all of them counts. A filter whose target
    is late takes the one before once more, and brakes.
    """
    if not len(received_s):
        return 0.0, 0.0
    period_s, lag_s = joint.response.filter_s, joint.response.lag_s
    step_ratio = 1.0 / joint.filter_count
    lag_ratio = -math.expm1(-period_s / lag_s) if lag_s else 1.0
    targets_deg = np.concatenate(([begin_deg], target_deg))
    phases_s = received_s[0] - period_s * (np.arange(PHASES) + 0.5) / PHASES
    position_deg, step_deg, change_deg = np.zeros((3, PHASES))
    position_deg += begin_deg
    worst_deg, worst_s = 0.0, 0.0
    steps = math.ceil((received_s[-1] - received_s[0]) / period_s) + SETTLING_STEPS
    for first in range(0, steps, STEPS_AT_ONCE):
        times_s = phases_s + period_s * np.arange(first, first + STEPS_AT_ONCE)[:, None]
        wanted_deg = targets_deg[np.searchsorted(received_s, times_s)]
        positions_deg = _low_passed(wanted_deg, position_deg, step_ratio)
        steps_deg = np.diff(positions_deg, axis=0, prepend=position_deg[None])
        changes_deg = np.diff(steps_deg, axis=0, prepend=step_deg[None])
        changes_deg = _low_passed(changes_deg, change_deg, lag_ratio)
        position_deg, step_deg, change_deg = positions_deg[-1], steps_deg[-1], changes_deg[-1]
        at = np.unravel_index(np.argmax(np.abs(changes_deg)), changes_deg.shape)
        if abs(changes_deg[at]) > worst_deg:
            worst_deg, worst_s = float(abs(changes_deg[at])), float(times_s[at])
    return worst_deg / period_s**2, worst_s


def _low_passed(values: FloatArray, before: FloatArray, ratio: float) -> FloatArray:
    """Return what follows `values`, a row each, by `ratio` of the way in each row."""
    rows = np.arange(len(values))
    kept = (1.0 - ratio) ** np.maximum(rows[:, None] - rows, 0)
    passed: FloatArray = ratio * np.tril(kept) @ values
    passed += (1.0 - ratio) ** (rows[:, None] + 1) * before
    return passed


class StreamFitter:
    """Fits one joint, command by command; see `drives.JointFitter`."""

    def __init__(self, reference: Reference, limits: ServoLimits, profile: FilterProfile) -> None:
        """Fit `reference`; `profile` stands where the reference begins."""
        self._limits = limits
        self._profile = profile
        self._first = profile.acts_on(reference.start_s) + 1
        last = profile.acts_on(reference.end_s) - 1
        steps = np.arange(self._first, max(last, self._first) + 1)
        middle_s = profile.step_s(0) + profile.period_s * (steps + 0.5)
        grid_s = reference.start_s + GRID_S * np.arange(len(reference.position_deg))
        self._reference_deg = np.interp(middle_s, grid_s, reference.position_deg)
        is_still = np.abs(np.diff(self._reference_deg, append=self._reference_deg[-1])) < STILL_DEG
        self._is_still = is_still.tolist()
        self._values = self._reference_deg.tolist()
        bend_deg = limits.ramp_deg_s2 * profile.period_s * profile.period_s / 8.0
        self._room_deg = max(
            CONE_RATIO * limits.tolerance_deg - bend_deg, BEND_LEAST_RATIO * bend_deg
        )
        self._change_deg = limits.ramp_deg_s2 * profile.period_s**2 + limits.tolerance_deg
        self._pending: tuple[float, int] | None = None
        self._repeats = 0
        self.setpoints: list[Setpoint] = []

    def request(self, granted_s: float | None) -> float | None:
        """Return the latest instant for the receipt of the next command; None at the end."""
        if granted_s is None:
            return self._departure(self._first, self._values[0])
        step = max(self._profile.acts_on(granted_s), self._first)
        if self._is_still[self._index(step)]:
            return self._rest(granted_s, step)
        self._repeats = 0
        self._pending = granted_s, step
        held, _, _ = self._targets(step, self._most(step))
        return self._profile.receive_s(step + max(held, 1))

    def grant(self, granted_s: float) -> None:
        """Decide the pending command, now that the instant of its successor is known."""
        if self._pending is None:
            return
        received_s, step = self._pending
        self._pending = None
        steps = min(max(self._profile.acts_on(granted_s) - step, 1), self._most(step))
        self._emit(received_s, self._best(step, steps))

    def profile(self) -> PiecewiseProfile:
        """Return the whole profile that the commands so far make."""
        return PiecewiseProfile(self._profile.pieces())

    def _emit(self, received_s: float, target_deg: float) -> None:
        wire = nearest_wire(target_deg, self._limits)
        self._profile.retarget(received_s, wire / self._limits.wire_per_deg, None)
        self.setpoints.append(Setpoint(received_s, wire))

    def _index(self, step: int) -> int:
        return min(max(step - self._first, 0), len(self._values) - 1)

    # ---- in motion

    def _most(self, step: int) -> int:
        """Return for how many steps a command may serve: not beyond the begin of the next rest."""
        index = self._index(step)
        ahead = self._is_still[index : index + STEPS_MAX]
        return max(ahead.index(True) if True in ahead else len(ahead), 1)

    def _targets(self, step: int, most: int) -> tuple[int, float, float]:
        """Return for how many steps one target keeps the tolerance, and which targets do.

        They are within the range, and so near that no step exceeds the speed limit.
        """
        limits, profile = self._limits, self._profile
        before_deg, index = profile.value(step - 1), self._index(step)
        reach_deg = profile.count * profile.period_s * limits.speed_max_deg_s
        low = max(limits.position_min_deg, before_deg - reach_deg)
        high = min(limits.position_max_deg, before_deg + reach_deg)
        tolerance_deg, kept = self._room_deg, 1.0
        step_deg = before_deg - profile.value(step - 2)
        ends_deg = [
            before_deg + profile.count * (step_deg - self._change_deg),
            before_deg + profile.count * (step_deg + self._change_deg),
        ]
        if max(low, ends_deg[0]) <= min(high, ends_deg[1]):
            low, high = max(low, ends_deg[0]), min(high, ends_deg[1])
        for held, reference_deg in enumerate(self._values[index : index + most]):
            saw_deg = profile.count * self._change_deg / (1.0 - kept) if held else math.inf
            kept *= profile.keep_ratio
            middle = (reference_deg - kept * before_deg) / (1.0 - kept)
            room = tolerance_deg / (1.0 - kept)
            least, most_deg = max(low, middle - room), min(high, middle + room)
            least, most_deg = max(least, before_deg - saw_deg), min(most_deg, before_deg + saw_deg)
            if least > most_deg:
                return held, low, high
            low, high = least, most_deg
        return most, low, high

    def _best(self, step: int, steps: int) -> float:
        """Return the allowed target with the least squared error over `steps`."""
        _, low, high = self._targets(step, steps)
        index = self._index(step)
        reference_deg = self._reference_deg[index : index + steps]
        kept = self._profile.keep_ratio ** np.arange(1, len(reference_deg) + 1)
        offset_deg, gained = reference_deg - kept * self._profile.value(step - 1), 1.0 - kept
        target_deg = float(np.dot(gained, offset_deg) / np.dot(gained, gained))
        return min(max(target_deg, low), high)

    # ---- at rest

    def _rest(self, granted_s: float, step: int) -> float | None:
        """Send the resting place; return when to send it again, or when the rest ends."""
        rest_deg = self._values[self._index(step)]
        if self._repeats == 0:
            self._repeats = self._settling_steps(step, rest_deg)
        self._emit(granted_s, rest_deg)
        self._repeats -= 1
        departs_s = self._departure(
            step, nearest_wire(rest_deg, self._limits) / self._limits.wire_per_deg
        )
        again_s = self._profile.receive_s(step + 1)
        if self._repeats == 0:
            return departs_s
        return again_s if departs_s is None else min(again_s, departs_s)

    def _settling_steps(self, step: int, rest_deg: float) -> int:
        """Return how often to send the resting place: a filter that missed two must settle."""
        away_deg = max(abs(self._profile.value(step - lost) - rest_deg) for lost in (1, 2, 3))
        if away_deg <= SETTLED_DEG or self._profile.count == 1:
            return 2
        ratio = math.log(SETTLED_DEG / away_deg) / math.log(self._profile.keep_ratio)
        return 2 + math.ceil(ratio)

    def _departure(self, step: int, standing_deg: float) -> float | None:
        """Return when to send the command that ends the standstill at `step`.

        At the end of a range between two wire values, the standstill itself is off by more than
        half a unit.
        """
        half_unit_deg = 0.5 * self._limits.wire_step / self._limits.wire_per_deg
        away = np.abs(self._reference_deg[self._index(step) :] - standing_deg)
        leaves = np.flatnonzero(away > max(half_unit_deg, away[0]) + STILL_ROUNDING_DEG)
        return (
            self._profile.receive_s(max(step, self._first) + int(leaves[0]))
            if leaves.size
            else None
        )


PULSE_S: Final = 0.02
"""An RC servo receives its target 50 times a second (general knowledge of RC pulses; no document of
the board states it), so that steps in quicker succession would be lost."""
SEARCH_STEPS: Final = 1024
"""Grid points searched at once for the next step."""


class StepProfile:
    """The targets of one servo, command by command: it jumps to each."""

    def __init__(self, position_deg: float) -> None:
        self._times_s = [-math.inf]
        self._values = [position_deg]

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at `time_s`; a jump has no speed."""
        for start_s, value in zip(reversed(self._times_s), reversed(self._values), strict=True):
            if start_s <= time_s:
                return value, 0.0
        return self._values[0], 0.0

    def retarget(self, received_s: float, target_deg: float, _duration_s: float | None) -> None:
        """Apply `D target` received at `received_s`. T has no effect."""
        self._times_s.append(received_s)
        self._values.append(target_deg)

    def forget_before(self, time_s: float) -> None:
        """Drop history that ends before `time_s`, so that memory stays bounded."""
        while len(self._times_s) > 1 and self._times_s[1] <= time_s:
            del self._times_s[0], self._values[0]

    def pieces(self) -> Iterator[Piece]:
        for start_s, value in zip(self._times_s, self._values, strict=True):
            yield Piece(start_s, value, 0.0, 0.0)


class StepFitter:
    """Fits one joint, step by step; see `drives.JointFitter`."""

    def __init__(self, reference: Reference, limits: ServoLimits, seams_s: Sequence[float]) -> None:
        self._reference = reference
        self._limits = limits
        self._seams_s = sorted(seams_s)
        self._hold = round(0.5 * PULSE_S / GRID_S)
        wire = nearest_wire(float(reference.position_deg[0]), limits)
        self._standing_deg = wire / limits.wire_per_deg
        self._profile = StepProfile(self._standing_deg)
        self.setpoints: list[Setpoint] = []

    def request(self, granted_s: float | None) -> float | None:
        """Return the latest instant for the receipt of the next step; None at the end."""
        if granted_s is None:
            return self._next(self._reference.start_s)
        self._emit(granted_s)
        requested_s = self._next(granted_s + PULSE_S)
        seam = bisect_left(self._seams_s, granted_s + PULSE_S)
        if seam == len(self._seams_s):
            return requested_s
        return min(self._seams_s[seam], math.inf if requested_s is None else requested_s)

    def grant(self, granted_s: float) -> None:
        """Accept the granted instant: no step depends on the instant of its successor."""

    def profile(self) -> PiecewiseProfile:
        """Return the whole profile that the steps so far make."""
        return PiecewiseProfile(self._profile.pieces())

    def _emit(self, received_s: float) -> None:
        """Add a step to the whole degree nearest to the reference while the step is held."""
        reference = self._reference.position_deg
        index = min(self._reference.index(received_s) + self._hold, len(reference) - 1)
        wire = nearest_wire(float(reference[index]), self._limits)
        self._standing_deg = wire / self._limits.wire_per_deg
        self._profile.retarget(received_s, self._standing_deg, None)
        self.setpoints.append(Setpoint(received_s, wire))

    def _next(self, from_s: float) -> float | None:
        """Return when, from `from_s` on, another whole degree is nearer to the reference."""
        limits, reference = self._limits, self._reference.position_deg
        half_unit_deg = 0.5 * limits.wire_step / limits.wire_per_deg
        room_deg = max(half_unit_deg, limits.tolerance_deg) + STILL_ROUNDING_DEG
        first = self._reference.index(from_s)
        while first < len(reference):
            some = reference[first + self._hold : first + self._hold + SEARCH_STEPS]
            away = np.flatnonzero(np.abs(some - self._standing_deg) > room_deg)
            if away.size:
                return max(self._reference.time_s(first + int(away[0])), from_s)
            first += SEARCH_STEPS
        return None
