"""How many moves a reference takes, against the fewest straight segments that keep the tolerance.

The fewest are found exactly (breadth first over all knots on a lattice of instants and angles).
A servo's ramps round the corners, so that ours can even need fewer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benches.shows import lively_show, robot_of
from benches.table import Row
from lss_motion.planning.program.fit import TimedFit
from lss_motion.planning.program.reference_grid import GRID_S, Reference, servo_limits
from lss_motion.playing import api

if TYPE_CHECKING:
    from lss_motion.planning.program.moves import FittedMoves

FloatArray = NDArray[np.float64]

TOLERANCES_DEG = (0.2, 0.5, 1.0)
LATTICE = 8
"""Knots lie on so many angles across the tolerance band."""
COURSE_S = 12.0
SEGMENT_STEPS = 300
TARGET_RATIO = 1.1


def measure() -> list[Row]:
    """Return ours, the fewest, and their ratio, for each reference and tolerance."""
    rows = []
    for name, reference in references().items():
        for tolerance_deg in TOLERANCES_DEG:
            ours = len(moves_of(reference, tolerance_deg))
            fewest = fewest_segments(reference.position_deg, tolerance_deg)
            rows.append(
                Row(
                    what=f"{name}, {tolerance_deg:g} deg",
                    ours=f"{ours} moves",
                    reference=f"{fewest} segments",
                    ratio=ours / fewest,
                    target=f"<= {TARGET_RATIO}",
                    is_met=ours <= TARGET_RATIO * fewest,
                )
            )
    return rows


def references() -> dict[str, Reference]:
    """Return references without a standstill inside: a standstill needs no moves."""
    time_s = GRID_S * np.arange(int(COURSE_S / GRID_S))
    robot = robot_of(3)
    show = api.plan(lively_show(robot, COURSE_S, seed=5), robot).sample(time_s)
    swing = 40.0 * np.sin(2.0 * time_s) * np.clip(time_s / 2.0, 0.0, 1.0) ** 2
    found = {"sine": swing, **{f"show joint {n}": show[:, n] for n in range(3)}}
    return {
        name: Reference(start_s=0.0, position_deg=np.ascontiguousarray(position))
        for name, position in found.items()
    }


def moves_of(reference: Reference, tolerance_deg: float) -> FittedMoves:
    """Return the moves of our fit, each granted as requested."""
    joint = next(iter(robot_of(1).joints.values()))
    fit = TimedFit([reference], [servo_limits(joint, tolerance_deg)])
    return fit.moves(lambda: lambda _joints, requested_us, _after_us: requested_us)


def fewest_segments(reference_deg: FloatArray, tolerance_deg: float) -> int:
    """Return how few joined straight lines stay within `tolerance_deg` of the reference."""
    count = len(reference_deg)
    shifts = tolerance_deg * np.linspace(-1.0, 1.0, LATTICE + 1)
    is_reached = np.zeros((count, len(shifts)), dtype=bool)
    frontier = [(0, LATTICE // 2)]
    is_reached[0] = True
    segments = 0
    while frontier:
        segments += 1
        found = np.zeros_like(is_reached)
        for index, shift in frontier:
            end = min(index + SEGMENT_STEPS, count - 1)
            steps = np.arange(1, end - index + 1)
            rise = reference_deg[index + 1 : end + 1] - reference_deg[index] - shifts[shift]
            lowest = np.maximum.accumulate((rise - tolerance_deg) / steps)
            highest = np.minimum.accumulate((rise + tolerance_deg) / steps)
            slopes = (rise[:, None] + shifts) / steps[:, None]
            fits = (slopes >= lowest[:, None] - 1e-12) & (slopes <= highest[:, None] + 1e-12)
            found[index + 1 : end + 1] |= fits
        found &= ~is_reached
        if found[-1].any():
            return segments
        is_reached |= found
        frontier = [(int(i), int(s)) for i, s in np.argwhere(found)]
    raise AssertionError("the end is always reached")
