"""The angles of all horns over time. They are recorded for tests; no servo can read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

FIRST_ROWS = 1024
"""Rows of the first buffer; it doubles when full."""


class HornHistory:
    """A growing table of instants and raw angles, in order of time.

    Angles between two rows are interpolated, so a horn at rest needs no rows.
    """

    def __init__(self, servo_count: int) -> None:
        self._count = 0
        self._times_ns = np.zeros(FIRST_ROWS, dtype=np.int64)
        self._angles_deg = np.zeros((FIRST_ROWS, servo_count))

    def append(self, time_ns: int, angles_deg: NDArray[np.float64]) -> None:
        self.extend(np.array([time_ns]), angles_deg[None])

    def extend(self, times_ns: NDArray[np.int64], angles_deg: NDArray[np.float64]) -> None:
        """Append rows of (instants, servos)."""
        assert not self._count or self._times_ns[self._count - 1] < times_ns[0], (
            "rows must be in order of time"
        )
        end = self._count + len(times_ns)
        while end > len(self._times_ns):
            self._times_ns = np.concatenate([self._times_ns, np.zeros_like(self._times_ns)])
            self._angles_deg = np.concatenate([self._angles_deg, np.zeros_like(self._angles_deg)])
        self._times_ns[self._count : end] = times_ns
        self._angles_deg[self._count : end] = angles_deg
        self._count = end

    def horn_deg(self, times_ns: Iterable[int] | NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the angles at the given instants, (instants, servos), in the order of the specs.

        Before the first row and after the last the horn stands still.
        """
        asked_ns = np.asarray(list(times_ns), dtype=np.int64)
        start_ns = self._times_ns[0] if self._count else 0
        asked_s = (asked_ns - start_ns).astype(np.float64)
        rows = slice(0, self._count)
        if len(asked_ns):  # Of an hour, only the rows around these instants are converted.
            within = self._times_ns[: self._count]
            first = int(np.searchsorted(within, asked_ns.min(), side="right")) - 1
            last = int(np.searchsorted(within, asked_ns.max(), side="left"))
            rows = slice(max(first, 0), max(min(last + 1, self._count), 1))
        known_s = (self._times_ns[rows] - start_ns).astype(np.float64)
        known_deg = self._angles_deg[rows]
        columns = [np.interp(asked_s, known_s, column) for column in known_deg.T]
        return np.stack(columns, axis=1)
