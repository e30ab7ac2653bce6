"""How fast a path may be followed: at rate 1 where that is legal, slower only where it is not.

A path whose parameter is the authored time is followed at rate 1 wherever that breaks no limit.
Only windows around the segments where it does are given to the solver, widened until rate 1 is
reached at both of their ends, which makes the result that of solving the whole.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.trajectory.path import peaks
from lss_motion.trajectory.solve import FEASIBLE_RATIO, runs, solve

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.trajectory.path import Path
    from lss_motion.trajectory.solve import Task, Window

    FloatArray = NDArray[np.float64]

WINDOW_MIN_S: Final = 0.2
"""How far a window grows at least. Chosen: braking from rate 1 takes a few tenths of a second."""


def strained(task: Task) -> NDArray[np.bool_]:
    """Return which segments cannot be followed at rate 1."""
    speed, accel = peaks(task.path)
    is_fast = np.any(speed > task.speed_max_deg_s * FEASIBLE_RATIO, axis=1)
    return np.asarray(is_fast | np.any(accel > task.accel_max_deg_s2 * FEASIBLE_RATIO, axis=1))


def slowed_windows(task: Task) -> list[Window]:
    """Return the windows where rate 1 is left, in order; none if the path is legal as it is."""
    is_rest = task.path.rests
    is_active = strained(task)
    for knot, cap in task.knot_caps.items():
        if cap < 1.0:
            is_active[knot - 1 : knot + 1] = True
    solved: dict[tuple[int, int], Window] = {}
    for run in runs(is_active):
        for step in (-1, +1):
            _widen(is_active, is_rest, task.path, run, step)
    while pending := [run for run in runs(is_active) if run not in solved]:
        for first, end in pending:
            window = solve(task, first, end)
            solved[first, end] = window
            if window.squares[0] < 1.0 and _can_widen(is_rest, first - 1):
                _widen(is_active, is_rest, task.path, (first, end), -1)
            if window.squares[-1] < 1.0 and _can_widen(is_rest, end):
                _widen(is_active, is_rest, task.path, (first, end), +1)
    return [solved[run] for run in runs(is_active)]


def _can_widen(is_rest: NDArray[np.bool_], segment: int) -> bool:
    """At a rest the rate may jump, and a path has ends."""
    return 0 <= segment < len(is_rest) and not is_rest[segment]


def _widen(
    is_active: NDArray[np.bool_],
    is_rest: NDArray[np.bool_],
    path: Path,
    run: tuple[int, int],
    step: int,
) -> None:
    """Activate segments before (`step` -1) or after a run, up to the next rest or active one.

    At least `WINDOW_MIN_S`, or half of the run again. Where it meets another run, the two are one
    from now on.
    """
    first, end = run
    wanted_s = max(WINDOW_MIN_S, 0.5 * float(path.knots_s[end] - path.knots_s[first]))
    segment = first - 1 if step < 0 else end
    while wanted_s > 0.0 and _can_widen(is_rest, segment) and not is_active[segment]:
        wanted_s -= float(path.knots_s[segment + 1] - path.knots_s[segment])
        is_active[segment] = True
        segment += step
