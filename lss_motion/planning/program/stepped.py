"""The `stepped` drive: model and fit of whole degrees for the RC servo of a 2IO board.

A command makes the servo jump, so that its profile is a staircase. The best instant of a step is
where the reference is half-way between two whole degrees.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.planning.program.moves import Setpoint
from lss_motion.planning.program.quantize import nearest_wire
from lss_motion.planning.program.reference_grid import GRID_S, STILL_ROUNDING_DEG
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.robot.profile import Piece

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lss_motion.planning.program.reference_grid import Reference, ServoLimits

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
