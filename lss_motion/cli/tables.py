"""Tables of angles over time as text: `t_s,<joint>…`, joint degrees."""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING

import numpy as np

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.trajectory.model import Trajectory

    FloatArray = NDArray[np.float64]


def plan_table(trajectory: Trajectory, rate_hz: float) -> str:
    """Return the plan as CSV, one row every `1 / rate_hz` and one at the end.

    A show without end gives its first pass and one more.
    """
    end_s = trajectory.duration_s
    if math.isinf(end_s):
        end_s = trajectory.first.duration_s + trajectory.middle.duration_s
    times_s = np.arange(int(end_s * rate_hz + 1e-9) + 1) / rate_hz
    if end_s - times_s[-1] > 1e-9:
        times_s = np.append(times_s, end_s)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["t_s", *trajectory.joints])
    for time_s, angles_deg in zip(times_s, trajectory.sample(times_s), strict=True):
        writer.writerow([f"{time_s:.6g}", *(f"{angle:.4f}" for angle in angles_deg)])
    return out.getvalue()


def read_table(path: Path, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Return times and (n, joints) angles of the named joints from a table at `path`."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        columns = [rows[0].index(name) for name in ("t_s", *joints)]
        table = np.array([[float(row[column]) for column in columns] for row in rows[1:]])
    except OSError as error:
        raise InputError(f"cannot read it: {error.strerror}", path=path) from error
    except (ValueError, IndexError) as error:
        raise InputError(f"is no table of t_s,{','.join(joints)} in numbers", path=path) from error
    return table[:, 0], table[:, 1:]


def write_text(path: Path, text: str) -> None:
    """Write a file whole, or raise `InputError` and leave what was there."""
    try:
        scratch = path.with_name(path.name + ".new")
        scratch.write_text(text, encoding="utf-8")
        scratch.replace(path)
    except OSError as error:
        raise InputError(f"cannot write it: {error.strerror}", path=path) from error
