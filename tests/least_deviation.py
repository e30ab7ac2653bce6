"""The least squared deviation from a motion within limits, on a fine grid: a judge of `keep: time`.

It shares no code with the planner: the acceleration is constant in each cell of 2.5 ms, the whole
motion is one problem, and the deviation is summed at samples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import clarabel
import numpy as np
from scipy import sparse

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.robot.model import Joint

STEP_S = 0.0025


def optimum(
    asked: Callable[[np.ndarray], np.ndarray],
    duration_s: float,
    joint: Joint,
    *,
    exact: Sequence[tuple[float, float]] = (),
    ratio: float = 1.0,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return times and angles of the closest motion from rest to rest; None if there is none.

    `exact` has instants and angles that must be met, `ratio` scales the limits of the joint.
    """
    cells = round(duration_s / STEP_S)
    step_s = duration_s / cells
    times_s = step_s * np.arange(cells + 1)
    # Unknown are angle and speed at each instant, then the acceleration of each cell.
    count = cells + 1
    eye = sparse.identity(count, format="csr")
    before, after = eye[:-1], eye[1:]
    still = sparse.csr_matrix((cells, count))
    accels = sparse.identity(cells, format="csr")
    follow = sparse.vstack(
        [
            sparse.hstack([after - before, -step_s * before, -0.5 * step_s**2 * accels]),
            sparse.hstack([still, after - before, -step_s * accels]),
        ]
    )
    wanted = asked(times_s)
    ties = [(0, wanted[0]), (cells, wanted[-1]), (count, 0.0), (2 * count - 1, 0.0)]
    rows, right = [], []
    for index, value in ties:
        rows.append(sparse.csr_matrix(([1.0], ([0], [index])), shape=(1, 2 * count + cells)))
        right.append(value)
    for at_s, deg in exact:
        cell = min(int(at_s / step_s + 1e-9), cells - 1)
        local_s = at_s - cell * step_s
        values = [1.0, local_s, 0.5 * local_s**2]
        columns = [cell, count + cell, 2 * count + cell]
        rows.append(sparse.csr_matrix((values, ([0, 0, 0], columns)), shape=(1, 2 * count + cells)))
        right.append(deg)
    equal = sparse.vstack([follow, *rows])
    right = np.concatenate([np.zeros(2 * cells), right])
    whole = sparse.identity(2 * count + cells, format="csr")
    high = np.concatenate(
        [
            np.full(count, joint.position_max_deg),
            np.full(count, ratio * joint.speed_max_deg_s),
            np.full(cells, ratio * joint.accel_max_deg_s2),
        ]
    )
    low = np.concatenate([np.full(count, joint.position_min_deg), -high[count:]])
    matrix = sparse.csc_matrix(sparse.vstack([equal, whole, -whole]))
    cost = np.zeros(2 * count + cells)
    cost[:count] = 1.0
    linear = np.zeros(2 * count + cells)
    linear[:count] = -wanted
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.ZeroConeT(len(right)), clarabel.NonnegativeConeT(2 * len(high))]
    solver = clarabel.DefaultSolver(
        sparse.diags_array(cost, format="csc"),
        linear,
        matrix,
        np.concatenate([right, high, -low]),
        cones,
        settings,
    )
    found = solver.solve()
    if "Infeasible" in str(found.status):
        return None
    assert "Solved" in str(found.status), found.status
    return times_s, np.array(found.x)[:count]
