"""Solved windows on disk, found by content, so that a plan made once needs no solver again.

An entry holds only what the solver is asked for: rates over a grid. It is named by a hash of the
whole question, so that it can never answer another one, and every plan made from it is verified
like a fresh one.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.trajectory.solve import Window

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.trajectory.solve import Task

    FloatArray = NDArray[np.float64]

PLANNER_VERSION: Final = 1
"""Part of every name: to be raised whenever the same question gets another answer."""

DIRECTORY_VARIABLE: Final = "LSS_MOTION_CACHE_DIR"
"""Environment variable that moves the cache."""

BYTES_MAX: Final = 64 * 1024 * 1024
"""The oldest entries go when the cache grows beyond this. Chosen: a hundred long shows."""

SUFFIX: Final = ".plan.npz"


def directory() -> Path:
    """Return where plans are kept: `LSS_MOTION_CACHE_DIR`, else the user's cache folder."""
    if chosen := os.environ.get(DIRECTORY_VARIABLE):
        return Path(chosen)
    import platformdirs

    return Path(platformdirs.user_cache_dir("lss_motion", appauthor=False)) / "plans"


def name_of(task: Task, *extra: object) -> str:
    """Return the name of a question: a hash of path, limits, caps and what else matters."""
    digest = hashlib.sha256()
    for array in (
        task.path.knots_s,
        task.path.coefficients,
        task.speed_max_deg_s,
        task.accel_max_deg_s2,
    ):
        digest.update(repr(array.shape).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    rest = (PLANNER_VERSION, task.rate_max, sorted(task.knot_caps.items()), extra)
    digest.update(repr(rest).encode())
    return digest.hexdigest()


def remembered(name: str, solve: Callable[[], list[Window]]) -> list[Window]:
    """Return the windows stored under `name`, or solve and store them.

    A damaged entry counts as none and is replaced. A cache that cannot be written is no error:
    the plan is only not remembered.
    """
    path = directory() / f"{name}{SUFFIX}"
    windows = _load(path)
    if windows is None:
        windows = solve()
        _store(path, windows)
    return windows


def _load(path: Path) -> list[Window] | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            bounds, grid_s, squares = stored["bounds"], stored["grid_s"], stored["squares"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    if not _is_whole(bounds, grid_s, squares):
        return None
    ends = np.cumsum(bounds[:, 2])
    return [
        Window(int(first), int(end), grid_s[stop - size : stop], squares[stop - size : stop])
        for (first, end, size), stop in zip(bounds.tolist(), ends.tolist(), strict=True)
    ]


def _is_whole(bounds: NDArray[np.int64], grid_s: FloatArray, squares: FloatArray) -> bool:
    return (
        bounds.ndim == 2
        and bounds.shape[1] == 3
        and bounds.dtype == np.int64
        and grid_s.dtype == squares.dtype == np.float64
        and grid_s.shape == squares.shape == (int(bounds[:, 2].sum()),)
        and bool(np.isfinite(grid_s).all() and np.isfinite(squares).all())
    )


def _store(path: Path, windows: Sequence[Window]) -> None:
    nothing = np.zeros(0)
    bounds = [(window.first, window.end, len(window.grid_s)) for window in windows]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
            np.savez(
                part,
                bounds=np.array(bounds, dtype=np.int64).reshape(-1, 3),
                grid_s=np.concatenate([nothing, *(window.grid_s for window in windows)]),
                squares=np.concatenate([nothing, *(window.squares for window in windows)]),
            )
        # A reader sees the whole entry or none.
        Path(part.name).replace(path)
        _trim(path.parent)
    except OSError:
        return


def _trim(folder: Path) -> None:
    """Remove the oldest entries beyond `BYTES_MAX`."""
    entries = sorted(
        ((entry.stat(), entry) for entry in folder.glob(f"*{SUFFIX}")),
        key=lambda pair: pair[0].st_mtime_ns,
        reverse=True,
    )
    total = 0
    for status, entry in entries:
        total += status.st_size
        if total > BYTES_MAX:
            entry.unlink(missing_ok=True)
