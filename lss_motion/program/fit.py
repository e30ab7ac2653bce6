"""Fits the fewest timed moves to the course of one joint: the heart of the `timed` drive.

A move in mid-course is used for its travel speed: its target lies beyond the instant of the next
move, so that the servo ramps to that speed and keeps it, and never brakes before its successor
arrives. Only where the course comes to rest does a move end on its target.

All angles are servo angles in degrees; instants are those at which the servo hears a move.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.cone import (
    CONE_RATIO,
    GRID_S,
    ROOM_RATIO,
    Cones,
    Course,
    ServoLimits,
    ramped,
)
from lss_motion.program.landing import SEGMENT_MIN_S, best_landing
from lss_motion.program.response import Piece, Profile, Reference
from lss_motion.program.wording import aim, lattice
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.program.cone import FloatArray

SEGMENT_MAX_S: Final = 1.5
"""The longest that one move is relied on: a lost command is repaired by its successor."""
CUT_RATIOS: Final = (1.0, 0.93, 0.85, 0.75, 0.6, 0.45, 0.3)
"""How much of the longest possible move is tried; what counts is how far its successor reaches."""
CONE_RATIOS: Final = (0.5, 0.25, 0.75, 0.05, 0.95)
"""Where in its cone the travel speed is tried."""
FOLLOW_RATIO: Final = CONE_RATIO - ROOM_RATIO
"""An excursion up to this share of the tolerance is chosen; the rest is for what the wire rounds
and for the slot that a move is really granted."""
BEND_RATIO: Final = 0.2
"""A jump of the acceleration by this share of the ramp is worth a move of its own."""
BEND_TRIALS: Final = 12
RECOVERY_STEPS: Final = (2, 4, 7, 12, 20, 32, 48)
"""Instants tried, in grid steps, where the tolerance is lost and must be won back."""
WINDOW_STEPS: Final = 48
"""Grid steps looked ahead at first; doubled while the cone stays open."""
REACH: Final = (20, 3)
"""Steps and stride in which it is judged how far a successor reaches (300 ms); it is only compared,
so every third grid step will do."""
SEARCH_STEPS: Final = 1024
"""Looked through at once for the end of a standstill."""
STILL_ROUNDING_DEG: Final = 1e-6
"""A course is where it was if it is nearest to the same wire value, up to rounding errors."""


@dataclass(frozen=True, slots=True)
class FittedMove:
    """Move to `target_wire` in `duration_ms`, heard at `heard_s`; None where there is no T."""

    heard_s: float
    target_wire: int
    duration_ms: int | None


class Fitter:
    """Fits one joint, move by move, to instants that somebody else grants.

    wanted_s = fitter.wanted(None)           when the first move is to be heard at the latest
    while wanted_s is not None:
        fitter.grant(granted_s)              it will be heard then, if possible not later
        wanted_s = fitter.wanted(granted_s)  the same for its successor
    """

    def __init__(
        self,
        course: Course,
        limits: ServoLimits,
        seams_s: Sequence[float] = (),
        profile: Profile | None = None,
    ) -> None:
        """Fit `course`; while it moves, a move is heard at, or shortly before, each of `seams_s`.

        Between two seams the moves can then be repeated without end. `profile` is what the servo
        does before the course begins; without it, it stands where the course does.
        """
        self._course = course
        self._seams = [course.index(seam_s) for seam_s in seams_s]
        self._limits = limits
        self._cones = Cones(course, limits)
        self._rests = course.rests()
        self._rest_starts = [first for first, _ in self._rests]
        self._rest_ends = [last for _, last in self._rests]
        self._bends = course.bends(BEND_RATIO * limits.ramp_deg_s2)
        self._profile = profile or Profile(
            lattice(float(course.position_deg[0]), limits) / limits.wire_per_deg,
            ramp_deg_s2=limits.ramp_deg_s2,
            speed_max_deg_s=limits.speed_max_deg_s,
            response=limits.response,
        )
        self._pending: tuple[Piece, float] | None = None
        self.moves: list[FittedMove] = []

    def wanted(self, granted_s: float | None) -> float | None:
        """Return when the next move is to be heard at the latest; None when none is needed.

        `granted_s` is when the pending move is heard; None when there is none yet.
        """
        if granted_s is None:
            return self._departure(self._course.start_s)
        state = self._profile.state(granted_s)
        landed_s = self._land(state)
        if landed_s is not None:
            return self._departure(landed_s)
        if granted_s >= self._course.end_s:
            return None
        return self._choose(state)

    def grant(self, granted_s: float) -> None:
        """Settle the pending move, now that its successor is known to be heard at `granted_s`."""
        if self._pending is not None:
            state, speed_deg_s = self._pending
            self._pending = None
            self._emit(state, *aim(state, speed_deg_s, granted_s, self._limits))

    def reference(self) -> Reference:
        """Return the whole profile that the moves so far make."""
        return Reference(self._profile.pieces())

    def _emit(self, state: Piece, target_wire: int, duration_ms: int) -> None:
        target_deg = target_wire / self._limits.wire_per_deg
        self._profile.retarget(state.start_s, target_deg, s_from_ms(duration_ms))
        self.moves.append(FittedMove(state.start_s, target_wire, duration_ms))

    # ---- out of rest

    def _departure(self, from_s: float) -> float | None:
        """Return when the move that ends the standstill after `from_s` should be heard."""
        course, grid = self._course, self._course.position_deg
        position_deg, _ = self._profile.at(from_s)
        half_unit_deg = 0.5 / self._limits.wire_per_deg + STILL_ROUNDING_DEG
        leaves = self._first_away(course.index(from_s), position_deg, half_unit_deg)
        if leaves is None:
            return None
        before = bisect_right(self._rest_ends, leaves)
        onset = self._rest_ends[before - 1] if before else leaves
        after = bisect_left(self._rest_starts, leaves)
        latest = self._rest_starts[after] if after < len(self._rests) else len(grid) - 1
        outside = self._first_away(
            leaves, position_deg, FOLLOW_RATIO * self._limits.tolerance_deg, latest
        )
        latest = latest if outside is None else min(latest, max(outside - 1, leaves))
        onset_s = max(from_s, course.time_s(onset))
        start_s = min(max(self._start_s(onset), onset_s), course.time_s(latest))
        if self._lands_from(start_s):
            return start_s
        trials_s = np.linspace(onset_s, max(course.time_s(latest), onset_s), len(CUT_RATIOS))
        still = np.zeros_like(trials_s)
        reach_s = self._cones.reach_s(
            trials_s,
            still + position_deg,
            still,
            *REACH,
        )
        return float(trials_s[int(np.argmax(reach_s))])

    def _first_away(
        self, first: int, position_deg: float, distance_deg: float, last: int | None = None
    ) -> int | None:
        """Return the first index from `first` to `last` further off than `distance_deg`."""
        grid = self._course.position_deg
        end = len(grid) if last is None else last + 1
        while first < end:
            some = grid[first : min(first + SEARCH_STEPS, end)]
            away = np.flatnonzero(np.abs(some - position_deg) > distance_deg)
            if away.size:
                return first + int(away[0])
            first += SEARCH_STEPS
        return None

    def _start_s(self, onset: int) -> float:
        """Return when the course leaves its standstill, between two grid points, as a parabola."""
        course, grid = self._course, self._course.position_deg
        first, second = (
            math.sqrt(abs(grid[min(onset + step, len(grid) - 1)] - grid[onset])) for step in (1, 2)
        )
        if second <= first:
            return course.time_s(onset)
        return course.time_s(onset + 1) - GRID_S * first / (second - first)

    def _lands_from(self, start_s: float) -> bool:
        """Return whether one move, heard at `start_s` at rest, is all the way to the next rest."""
        state = self._profile.state(start_s)
        rest = self._next_rest(state)
        landing = None if rest is None else best_landing(state, rest, self._course, self._limits)
        return landing is not None and landing[0] <= CONE_RATIO * self._limits.tolerance_deg

    # ---- on the way

    def _choose(self, state: Piece) -> float:
        """Return the instant for the successor after which two moves reach furthest.

        Only what the servo can follow from there is chosen: its excursion, with the ramp that the
        course leaves it, must stay within the tolerance. Where that fails, the least excursion.
        """
        first = math.ceil((state.start_s - self._course.start_s) / GRID_S - 1e-9)
        index, speeds, is_held = self._trials(state, first)
        times_s = self._course.times_s(first + index)
        positions, reached = ramped(
            state.position_deg,
            state.speed_deg_s,
            speeds,
            times_s - state.start_s,
            self._limits.ramp_deg_s2,
        )
        excursion = self._cones.excursion_deg(first + index, positions, reached)
        followable = excursion <= FOLLOW_RATIO * self._limits.tolerance_deg
        if is_held and followable.any():
            reach_s = self._cones.reach_s(times_s, positions, reached, *REACH)
            merit = np.where(followable, reach_s + 1e-6 * index, -np.inf)
        else:
            merit = -excursion
        best = int(np.argmax(merit))
        self._pending = state, float(speeds[best])
        return float(times_s[best])

    def _trials(self, state: Piece, first: int) -> tuple[NDArray[np.intp], FloatArray, bool]:
        """Return steps after `first` and speeds to try, and whether any keeps the tolerance.

        Besides an even choice inside the cone, the course's own speed: where the course is at its
        acceleration limit, only that leaves the servo in step with it. No successor comes after
        the next standstill began: it has to land there.
        """
        least = math.ceil(SEGMENT_MIN_S / GRID_S)
        lowest, highest, held = self._cone(state)
        rest = self._next_rest(state)
        latest = len(self._course.position_deg) if rest is None else rest[0] - first - least
        for seam in self._seams:
            if first + least < seam:
                latest = min(latest, seam - first)
        latest = max(latest, least)
        is_held = held > least
        if is_held:
            held = min(held, latest + 1)
            cuts = {max(least, round(ratio * (held - 1))) for ratio in CUT_RATIOS}
            low, high = np.searchsorted(self._bends, (first + least, first + held))
            cuts |= {int(bend) - first for bend in self._bends[low:high][:BEND_TRIALS]}
        else:
            cuts = {min(cut, latest) for cut in RECOVERY_STEPS}
        index = np.array(sorted(cuts), dtype=np.intp)
        if is_held:
            low_speed, high_speed = lowest[index], highest[index]
        else:
            gain = self._limits.ramp_deg_s2 * GRID_S * index
            most = self._limits.speed_max_deg_s
            low_speed = np.clip(state.speed_deg_s - gain, -most, most)
            high_speed = np.clip(state.speed_deg_s + gain, -most, most)
        own = np.clip(self._course.speed_deg_s(first + index), low_speed, high_speed)
        spread = low_speed + np.outer(CONE_RATIOS, high_speed - low_speed)
        speeds = np.concatenate((own, spread.ravel()))
        return np.tile(index, 1 + len(CONE_RATIOS)), speeds, is_held

    def _cone(self, state: Piece) -> tuple[FloatArray, FloatArray, int]:
        """Return lowest and highest speed per grid step, and how many steps the cone is open."""
        row = [np.array([v]) for v in (state.start_s, state.position_deg, state.speed_deg_s)]
        steps, most = WINDOW_STEPS, round(SEGMENT_MAX_S / GRID_S)
        while True:
            lowest, highest = self._cones.open(row[0], row[1], row[2], steps)
            held = int(np.logical_and.accumulate(lowest[0] <= highest[0]).sum())
            if held < steps or steps >= most:
                return lowest[0], highest[0], held
            steps = min(2 * steps, most)

    # ---- to rest

    def _land(self, state: Piece) -> float | None:
        """Emit the move that ends on the next standstill, if that keeps the tolerance already.

        Returns from when on the servo stands there; None when it is too early to land.
        """
        rest = self._next_rest(state)
        if rest is None:
            return None
        rest_s = self._course.time_s(rest[0])
        is_overdue = state.start_s + SEGMENT_MIN_S >= rest_s
        braking_s = self._limits.speed_max_deg_s / self._limits.ramp_deg_s2
        if rest_s - state.start_s > SEGMENT_MAX_S + braking_s and not is_overdue:
            return None
        error_deg, landed_s, wire, duration_ms = best_landing(
            state, rest, self._course, self._limits
        )
        if error_deg > CONE_RATIO * self._limits.tolerance_deg and not is_overdue:
            return None
        self._emit(state, wire, duration_ms)
        return max(landed_s, rest_s)

    def _next_rest(self, state: Piece) -> tuple[int, int] | None:
        at = bisect_right(self._rest_ends, self._course.index(state.start_s))
        return self._rests[at] if at < len(self._rests) else None
