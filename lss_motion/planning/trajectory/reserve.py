"""A reserve of acceleration where a joint would use all of it for a long time.

A servo whose ramps are no steeper than its plan cannot make up for what its control loop and its
line add to each turn: after some seconds its horn falls behind. `with_reserve` finds the stretches
in which a joint is at its acceleration limit without a break, and times the motion again with a
little less of the limit there. Short motions, and what is feasible at the author's times, stay.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.show.splines import near_runs

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import PathClock
    from lss_motion.planning.trajectory.solver import RateTask, RateWindow

    FloatArray = NDArray[np.float64]
    BoolArray = NDArray[np.bool_]
    Timed = tuple[list[RateWindow], PathClock]

RELENTLESS_S: Final = 2.5
RELENTLESS_SHARE: Final = 0.995
RELENTLESS_LONG_S: Final = 8.0
RELENTLESS_SHARE_KEPT: Final = 0.98
"""Where the acceleration is at its limit for longer than 2.5 s, 99.5 % of it are used, and 98 % for
longer than 8 s by motions that keep their time.

Measured in the simulator with 12 motions of 10 to 40 s, of LSS and LSS-PRO, 90 to 360 deg/s, 300 to
900 deg/s², turns every 0.32 to 0.9 s, with and without feedback. Largest distance of a horn from
its plan: slowed motions 0.8 deg with 98 %, 1.1 deg with 99.5 %; motions that keep their time 0.6
deg with 98 %, 13 deg with 99.5 %. Measured before with 8 such motions: up to 10 deg (slowed) and
12 deg (keep: time) with all of the limit, 10 deg with 99 % (keep: time). Up to 2 s all are alike.
Of the two that fall behind with 99.5 %, the horns are within 0.5 deg for 11 s, and then go off.
Full acceleration in between, with less for half a second, is worse."""

AT_LIMIT_RATIO: Final = 0.97
"""An acceleration above this share of its limit is at it: less than all shares above."""

BREAK_S: Final = 0.1
"""A shorter time below the limit is no break. Measured with a cruise between the turns: with 50 ms
the horn is 9.9 deg off after 20 s, with 100 ms 0.7 deg. 10 to 20 ms at both ends of a cruise have
less than the limit."""

STEP_S: Final = 0.025
"""Step in which a motion is sampled: a quarter of a break."""

ROUNDS_MAX: Final = 4
"""With less acceleration in one stretch, the next one may become longer. Measured: one round."""


def with_reserve(
    task: RateTask,
    follow: Callable[[RateTask, Sequence[RateWindow]], Timed],
    *,
    seams_s: Sequence[float] = (),
    loop: int | None = 1,
    is_met: Callable[[PathClock], BoolArray],
) -> tuple[RateTask, Timed]:
    """Return the task with its reserves, and how `follow` times it then.

    `follow` gets the windows that it found with fewer reserves, at first none. At the positions
    `seams_s` passes begin; those amid them are repeated, as `loop` says. `is_met` returns which
    anchors are met: none is given up for a reserve.
    """
    timed = first = follow(task, ())
    met = is_met(timed[1])
    reserved = task
    for _ in range(ROUNDS_MAX):
        shares = _shares(reserved, timed, seams_s, loop)
        if shares is None:
            break
        reserved = replace(reserved, accel_shares=shares)
        timed = follow(reserved, timed[0])
    if (met & ~is_met(timed[1])).any():
        return task, first
    return reserved, timed


def _shares(
    task: RateTask, timed: Timed, seams_s: Sequence[float], loop: int | None
) -> FloatArray | None:
    """Return the shares of the limits of each segment and joint; None: nothing changes."""
    windows, clock = timed
    if not windows or (loop == 1 and clock.duration_s <= RELENTLESS_S):
        return None
    times_s = np.arange(0.5 * STEP_S, clock.duration_s, STEP_S)
    order = _played(times_s, clock.times_of(np.asarray(seams_s)), clock.duration_s, loop)
    path_s, rates, slopes = clock.positions(times_s)
    ends_s = np.array([(window.from_s, window.to_s) for window in windows]).ravel()
    is_inside = np.searchsorted(ends_s, path_s) % 2 == 1
    near = np.unique(_relentless(is_inside[order, None], order)[0])
    if not len(near):
        return None
    first, second = task.path.slopes(path_s[near])
    accel = np.abs(second * rates[near, None] ** 2 + first * slopes[near, None])
    is_at_limit = np.zeros((len(times_s), accel.shape[1]), dtype=np.bool_)
    is_at_limit[near] = accel > AT_LIMIT_RATIO * task.accel_max_deg_s2
    samples, joints = _relentless(is_at_limit[order], order)
    if not len(samples):
        return None
    segments = task.path.segments_of(path_s[samples])
    before = task.accel_shares
    shares = np.ones((len(task.path.knots_s) - 1, accel.shape[1])) if before is None else before
    shares = shares.copy()
    shares[segments, joints] = RELENTLESS_SHARE
    return None if before is not None and np.array_equal(shares, before) else shares


def _played(
    times_s: FloatArray, seams_s: FloatArray, duration_s: float, loop: int | None
) -> NDArray[np.intp]:
    """Return the samples in the order of play, with the repeated pass as often as it matters."""
    edges = [0, *np.searchsorted(times_s, seams_s).tolist(), len(times_s)]
    passes = [np.arange(low, high) for low, high in itertools.pairwise(edges)]
    if loop == 1 or len(passes) == 2:
        return np.arange(len(times_s))
    middle = len(passes) // 2
    count = math.ceil(RELENTLESS_S / duration_s * len(passes)) + 1
    if loop is not None:
        count = min(count, loop - len(passes) + 1)
    return np.concatenate([*passes[:middle], np.tile(passes[middle], count), *passes[middle + 1 :]])


def _relentless(
    flags: BoolArray, order: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return samples and columns of the runs of set flags that last too long without a break."""
    least, gap = round(RELENTLESS_S / STEP_S), round(BREAK_S / STEP_S)
    found = [
        (order[first:end], np.full(end - first, column))
        for column in range(flags.shape[1])
        for first, end in near_runs(flags[:, column], gap)
        if end - first > least
    ]
    if not found:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    samples, columns = zip(*found, strict=True)
    return np.concatenate(samples), np.concatenate(columns)
