"""The check of a stored plan, in closed form: cheap enough for every plan that is loaded.

Between two knots of path and clock the square of the rate is linear in the path position. So the
acceleration of a joint is a quadratic, and the extremes of acceleration, speed and angle follow
from roots of quadratics: no sample is needed. `verify` samples a new plan 20 times slower; it
decides where this check finds no proof, such as where rounding makes a jump, and checks the jerk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.model import motions_of
from lss_motion.planning.trajectory.verify import (
    EXCESS_MAX_RATIO,
    RANGE_SLACK_DEG,
    SAMPLE_S,
    verify,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import PathMotion, Trajectory
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

JUMP_RATIO: Final = EXCESS_MAX_RATIO - 1.0
"""A jump of the speed is rounding, if over one sample of the verifier it adds this to the limit."""


def is_within_limits(trajectory: Trajectory, robot: Robot) -> bool:
    """Return whether the plan of a single track would pass `verify`.

    It may hold any numbers: those that make no motion are not within limits.
    """
    with np.errstate(all="ignore"):
        if not all(map(_is_motion, motions_of(trajectory))):
            return False
        if not trajectory.smoothing and _is_proved(trajectory, robot):
            return True
        try:
            verify(trajectory, robot)
        except PlanningError:
            return False
    return True


def _is_motion(motion: PathMotion) -> bool:
    """Return whether the arrays fit each other, are finite, and times do not decrease."""
    path, clock = motion.path, motion.clock
    count = len(clock.rates)
    if not (
        path.coefficients.shape[:2] == (len(path.knots_s) - 1, 4)
        and (len(clock.times_s), len(clock.path_s)) == (count + 1, count + 1)
        and len(clock.rate_slopes) == count > 0
    ):
        return False
    arrays = (path.knots_s, path.coefficients, clock.times_s, clock.path_s, clock.rates)
    return (
        all(np.isfinite(array).all() for array in (*arrays, clock.rate_slopes))
        and bool((np.diff(path.knots_s) >= 0.0).all())
        and bool((np.diff(clock.times_s) >= 0.0).all())
        and bool(clock.times_s[0] == 0.0)
    )


BLOCK_PIECES: Final = 1024
"""Pieces that are checked at once. Measured with 38,240 pieces and 18 joints: with all at once the
check takes two to three times as long, because no array stays in the processor's cache."""


class _Ends(Struct, frozen=True):
    """Angles and speeds of all joints at both ends of a motion."""

    start: tuple[FloatArray, FloatArray]
    end: tuple[FloatArray, FloatArray]


class _Limits:
    """The limits of the joints, with what the verifier allows beyond them."""

    def __init__(self, trajectory: Trajectory, robot: Robot) -> None:
        joints = [robot.joints[name] for name in trajectory.joints]
        self.low_deg = np.array([joint.position_min_deg for joint in joints]) - RANGE_SLACK_DEG
        self.high_deg = np.array([joint.position_max_deg for joint in joints]) + RANGE_SLACK_DEG
        accel_deg_s2 = np.array([joint.accel_max_deg_s2 for joint in joints])
        self.speed_deg_s = EXCESS_MAX_RATIO * np.array([joint.speed_max_deg_s for joint in joints])
        self.accel_deg_s2 = EXCESS_MAX_RATIO * accel_deg_s2
        self.jump_deg_s = JUMP_RATIO * SAMPLE_S * accel_deg_s2

    def hold_angles(self, *angles_deg: FloatArray) -> bool:
        """Return whether all angles are in range; NaN is not."""
        return all(
            bool(((deg >= self.low_deg) & (deg <= self.high_deg)).all()) for deg in angles_deg
        )

    def join(
        self, end: tuple[FloatArray, FloatArray], start: tuple[FloatArray, FloatArray]
    ) -> bool:
        """Return whether a motion at `end` (angle, speed) continues at `start` without a jump."""
        return bool(
            (np.abs(end[0] - start[0]) <= RANGE_SLACK_DEG).all()
            and (np.abs(end[1] - start[1]) <= self.jump_deg_s).all()
        )


def _is_proved(trajectory: Trajectory, robot: Robot) -> bool:
    """Return whether every piece keeps the limits, and every seam is without a jump."""
    limits = _Limits(trajectory, robot)
    ends: dict[int, _Ends] = {}
    for motion in {id(part): part for part in motions_of(trajectory)}.values():
        found = _pieces_within(motion, limits)
        if found is None:
            return False
        ends[id(motion)] = found
    still = np.zeros(len(trajectory.joints))
    begin = ends[id(trajectory.first)]
    if not limits.join(begin.start, (begin.start[0], still)):
        return False
    if not all(
        limits.join(ends[id(before)].end, ends[id(after)].start)
        for before, after in _seams(trajectory)
    ):
        return False
    end = ends[id(trajectory.last)].end
    return trajectory.loop is None or limits.join(end, (end[0], still))


def _seams(trajectory: Trajectory) -> Iterator[tuple[PathMotion, PathMotion]]:
    """Yield the passes before and after every kind of seam."""
    first, middle, last = motions_of(trajectory)
    count = trajectory.loop
    if count is None or count > 2:
        yield first, middle
        yield middle, middle
    if count is not None and count > 1:
        yield (first if count == 2 else middle), last


def _pieces_within(motion: PathMotion, limits: _Limits) -> _Ends | None:
    """Return the ends of a pass; None if a piece of it is not proved to keep the limits."""
    times_s = motion.knots_s
    whole: _Ends | None = None
    for first in range(0, len(times_s) - 1, BLOCK_PIECES):
        block = _block_within(motion, times_s[first : first + BLOCK_PIECES + 1], limits)
        if block is None or (whole is not None and not limits.join(whole.end, block.start)):
            return None
        whole = block if whole is None else _Ends(whole.start, block.end)
    return whole


def _block_within(motion: PathMotion, times_s: FloatArray, limits: _Limits) -> _Ends | None:
    """Do the same for the pieces between these knots."""
    path, clock = motion.path, motion.clock
    middles_s = 0.5 * (times_s[:-1] + times_s[1:])
    pieces = np.clip(
        np.searchsorted(clock.times_s, middles_s, side="right") - 1, 0, len(clock.rates) - 1
    )
    slopes = clock.rate_slopes[pieces][:, None]
    starts_s, start_rates = _moved(motion, pieces, times_s[:-1])
    ends_s, end_rates = _moved(motion, pieces, times_s[1:])
    if (start_rates < -JUMP_RATIO).any() or (end_rates < -JUMP_RATIO).any():
        return None
    segments = path.segments_of(_moved(motion, pieces, middles_s)[0] + path.knots_s[0])
    from_s = (starts_s + path.knots_s[0] - path.knots_s[segments])[:, None]
    width_s = (ends_s - starts_s)[:, None]
    # Cubics of the position in the piece, u from 0 to its width.
    c0, c1, c2, c3 = (path.coefficients[segments, power] for power in range(4))
    c0, c1, c2 = (
        c0 + from_s * (c1 + from_s * (c2 + from_s * c3)),
        c1 + from_s * (2.0 * c2 + 3.0 * from_s * c3),
        c2 + 3.0 * from_s * c3,
    )
    square = (start_rates**2)[:, None]
    cubics = _Cubics(c0, c1, c2, c3, width_s, square, slopes)
    end_rates = np.sqrt(np.maximum(square + 2.0 * slopes * width_s, 0.0))
    # Control points of the cubic, of its slope and of the acceleration: these lie between them.
    w1, w2 = width_s * c1, width_s * width_s * c2
    w3 = width_s * width_s * width_s * c3
    end_deg = c0 + (w1 + (w2 + w3))
    first_deg = c0 + w1 / 3.0
    second_deg = first_deg + (w1 + w2) / 3.0
    end_slopes = c1 + width_s * (2.0 * c2 + 3.0 * width_s * c3)
    steepest = np.maximum(np.maximum(np.abs(c1), np.abs(end_slopes)), np.abs(c1 + width_s * c2))
    fastest = steepest * np.maximum(np.sqrt(square), end_rates)
    a0, a1, a2 = cubics.accels()
    hardest = np.maximum(np.abs(a0), np.abs(a0 + 0.5 * width_s * a1))
    np.maximum(hardest, np.abs(a0 + width_s * (a1 + width_s * a2)), out=hardest)
    start_deg_s, end_deg_s = c1 * np.sqrt(square), end_slopes * end_rates
    is_within = (
        limits.hold_angles(c0, end_deg)
        and cubics.hold_angles(limits, first_deg, second_deg)
        and cubics.hold_speeds(limits, fastest)
        and cubics.hold_accels(limits, hardest)
        and limits.join((end_deg[:-1], end_deg_s[:-1]), (c0[1:], start_deg_s[1:]))
    )
    if not is_within:
        return None
    return _Ends((c0[0], start_deg_s[0]), (end_deg[-1], end_deg_s[-1]))


class _Cubics(Struct, frozen=True):
    """The angles of all joints in all pieces: cubics of the path position `u`, 0 to the width.

    Each check gets bounds of what it looks at. Only where those are beyond the limits the extremes
    are computed: for one in 300 cubics of a plan that is at its limits all the time.
    """

    c0: FloatArray
    c1: FloatArray
    c2: FloatArray
    c3: FloatArray
    width_s: FloatArray
    square: FloatArray
    """Of the rate at the start; by piece, as width and slope of the rate."""
    slopes: FloatArray

    def accels(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the coefficients of the acceleration, a quadratic of `u`."""
        # (2 c2 + 6 c3 u) (square + 2 slope u) + (c1 + 2 c2 u + 3 c3 u²) slope
        a0 = 2.0 * self.c2 * self.square + self.c1 * self.slopes
        a1 = 6.0 * (self.c3 * self.square + self.c2 * self.slopes)
        return a0, a1, 15.0 * self.c3 * self.slopes

    def hold_angles(self, limits: _Limits, *bounds_deg: FloatArray) -> bool:
        """Return whether the angles stay in range, which they do where `bounds_deg` are."""
        is_safe = np.ones(self.c0.shape, dtype=bool)
        for deg in bounds_deg:
            is_safe &= (deg >= limits.low_deg) & (deg <= limits.high_deg)
        part, joints = self._part(~is_safe)
        low_deg, high_deg = limits.low_deg[joints], limits.high_deg[joints]
        return all(
            bool(((deg >= low_deg) & (deg <= high_deg)).all())
            for u in _roots(part.c1, 2.0 * part.c2, 3.0 * part.c3, part.width_s)
            for deg in [part.c0 + u * (part.c1 + u * (part.c2 + u * part.c3))]
        )

    def hold_speeds(self, limits: _Limits, bounds_deg_s: FloatArray) -> bool:
        """Return whether no speed is beyond its limit; `bounds_deg_s` are not below the speeds."""
        part, joints = self._part(~(bounds_deg_s <= limits.speed_deg_s))
        most_deg_s = limits.speed_deg_s[joints]
        zero = np.zeros_like(part.width_s)
        return all(
            bool((np.abs(part.speeds(u)) <= most_deg_s).all())
            for u in (zero, part.width_s, *_roots(*part.accels(), part.width_s))
        )

    def hold_accels(self, limits: _Limits, bounds_deg_s2: FloatArray) -> bool:
        """Return whether no acceleration is beyond its limit, of which `bounds_deg_s2` is none."""
        part, joints = self._part(~(bounds_deg_s2 <= limits.accel_deg_s2))
        most_deg_s2 = limits.accel_deg_s2[joints]
        a0, a1, a2 = part.accels()
        turn = _inside(-a1 / (2.0 * a2), part.width_s)
        return all(
            bool((np.abs(a0 + u * (a1 + u * a2)) <= most_deg_s2).all())
            for u in (np.zeros_like(turn), part.width_s, turn)
        )

    def speeds(self, u: FloatArray) -> FloatArray:
        """Return the speeds at `u` of each piece."""
        rate = np.sqrt(np.maximum(self.square + 2.0 * self.slopes * u, 0.0))
        return np.asarray((self.c1 + u * (2.0 * self.c2 + 3.0 * u * self.c3)) * rate)

    def _part(self, is_asked: NDArray[np.bool_]) -> tuple[_Cubics, NDArray[np.intp]]:
        """Return some cubics in a row, and the joint of each."""
        pieces, joints = np.nonzero(is_asked)
        cubics = (c[pieces, joints] for c in (self.c0, self.c1, self.c2, self.c3))
        shared = (one[pieces, 0] for one in (self.width_s, self.square, self.slopes))
        return _Cubics(*cubics, *shared), joints


def _moved(
    motion: PathMotion, pieces: NDArray[np.intp], times_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return path position and rate at each instant, by the given piece of the clock."""
    clock = motion.clock
    local_s = times_s - clock.times_s[pieces]
    rates, slopes = clock.rates[pieces], clock.rate_slopes[pieces]
    path_s = clock.path_s[pieces] + local_s * (rates + 0.5 * slopes * local_s)
    return path_s, rates + slopes * local_s


def _roots(
    constant: FloatArray, linear: FloatArray, square: FloatArray, width_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the roots of quadratics that lie from 0 to the width; 0 in place of the others."""
    root = np.sqrt(np.maximum(linear**2 - 4.0 * square * constant, 0.0))
    # Added with equal signs, so that no digits are lost.
    total = -0.5 * (linear + np.copysign(root, linear))
    return _inside(total / square, width_s), _inside(constant / total, width_s)


def _inside(u: FloatArray, width_s: FloatArray) -> FloatArray:
    """Return the positions that lie from 0 to the width; 0 in place of the others and of NaN."""
    return np.where((u > 0.0) & (u < width_s), u, 0.0)
