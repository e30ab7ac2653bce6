"""What is kept of one joint's readings for a picture: few points, however long a show is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

POINTS_MAX: Final = 1000
"""Chosen: one for every pixel of a wide picture."""


@dataclass(slots=True)
class Trace:
    """Readings that were believed, as `(seconds, planned angle, measured angle)` of the joint.

    Every `stride`-th is kept; when there are too many, every other one of those, so what is kept
    always covers the whole show evenly.
    """

    points: list[tuple[float, float, float]] = field(default_factory=list)
    stride: int = 1
    _count: int = 0

    def add(self, at_s: float, planned_deg: float, measured_deg: float) -> None:
        """Take the next reading, at seconds since the start of the show, pauses included."""
        if self._count % self.stride == 0:
            self.points.append((at_s, planned_deg, measured_deg))
        self._count += 1
        if len(self.points) > POINTS_MAX:
            del self.points[1::2]
            self.stride *= 2
