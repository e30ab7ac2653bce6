"""Paths: piecewise cubics of all joints over the path position, without time.

The path position has the unit of seconds (`_s`): for authored shows it is the authored time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]


class Path(Struct, frozen=True, kw_only=True):
    """Cubics of all joints over common knots.

    `coefficients[k, p, j]` belongs to the power p of (path_s - knots_s[k]) of joint j in segment
    k; degrees over seconds to the p. A segment at rest has exact zeros above power 0.
    """

    knots_s: FloatArray
    coefficients: FloatArray

    def __post_init__(self) -> None:
        # Stored power by power, because `_chosen` reads one power of many cubics.
        by_power = np.ascontiguousarray(np.moveaxis(self.coefficients, 1, 0))
        force_setattr(self, "coefficients", np.moveaxis(by_power, 0, 1))

    @property
    def length_s(self) -> float:
        return float(self.knots_s[-1] - self.knots_s[0])

    @property
    def segment_lengths_s(self) -> FloatArray:
        return np.diff(self.knots_s)

    @property
    def rests(self) -> NDArray[np.bool_]:
        """True for each segment in which no joint moves."""
        return np.asarray(~np.any(self.coefficients[:, 1:, :], axis=(1, 2)), dtype=np.bool_)

    def segments_of(self, path_s: FloatArray) -> NDArray[np.intp]:
        """Return the segment of every position; a knot belongs to the segment that it starts."""
        found = np.searchsorted(self.knots_s, path_s, side="right") - 1
        return np.clip(found, 0, len(self.knots_s) - 2)

    def evaluate(self, path_s: FloatArray) -> FloatArray:
        """Return the position, (n, joints)."""
        chosen = self.segments_of(path_s)
        local_s = (path_s - self.knots_s[chosen])[:, None]
        value = self._chosen(3, chosen)
        for power in (2, 1, 0):
            value *= local_s
            value += self._chosen(power, chosen)
        return value

    def _chosen(self, power: int, segments: NDArray[np.intp]) -> FloatArray:
        """Return the coefficient of that power of each chosen cubic, (n, joints).

        Reading power by power takes a quarter of the time of reading whole cubics.
        """
        return self.coefficients[:, power].take(segments, axis=0)

    def slopes(
        self, path_s: FloatArray, segments: NDArray[np.intp] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the first and the second derivative, (n, joints).

        `segments` gives the cubic of each position, for one-sided values at a knot.
        """
        chosen = self.segments_of(path_s) if segments is None else segments
        local_s = (path_s - self.knots_s[chosen])[:, None]
        cubed = self._chosen(3, chosen)
        cubed *= 3.0 * local_s
        squared = self._chosen(2, chosen)
        second = cubed + squared
        first = second + squared
        first *= local_s
        first += self._chosen(1, chosen)
        second *= 2.0
        return first, second


def cubics(knots_s: FloatArray, deg: FloatArray, speed: FloatArray) -> Path:
    """Return the cubics with those angles and speeds at their knots."""
    lengths_s = np.diff(knots_s)[:, None]
    secants = np.diff(deg, axis=0) / lengths_s
    coefficients = hermite(deg[:-1], secants, speed[:-1], speed[1:], lengths_s)
    return Path(knots_s=knots_s, coefficients=coefficients)


def hermite(
    start: FloatArray,
    secants: FloatArray,
    before: FloatArray,
    after: FloatArray,
    lengths_s: FloatArray,
) -> FloatArray:
    """Return cubics with those slopes `before` and `after` at their ends.

    Coefficients in rising powers along axis 1, from the value at the start and the mean slope.
    """
    square = (3.0 * secants - 2.0 * before - after) / lengths_s
    cube = (before + after - 2.0 * secants) / lengths_s**2
    return np.stack([start, before, square, cube], axis=1)


def concatenate(paths: Sequence[Path]) -> Path:
    """Return one path that runs through all of them; each starts where the last one ended."""
    starts_s = np.cumsum([0.0] + [path.length_s for path in paths])
    knots_s = [
        path.knots_s[:-1] - path.knots_s[0] + start_s
        for path, start_s in zip(paths, starts_s, strict=False)
    ]
    return Path(
        knots_s=np.concatenate([*knots_s, starts_s[-1:]]),
        coefficients=np.concatenate([path.coefficients for path in paths]),
    )


def peaks(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return the largest |first| and |second| derivative of each segment and joint, exactly."""
    _, linear, square, cube = np.moveaxis(path.coefficients, 1, 0)
    length_s = path.segment_lengths_s[:, None]
    end_speed = (3.0 * cube * length_s + 2.0 * square) * length_s + linear
    with np.errstate(divide="ignore", invalid="ignore"):
        turn_s = -square / (3.0 * cube)
    is_inside = (cube != 0.0) & (turn_s > 0.0) & (turn_s < length_s)
    turn_s = np.where(is_inside, turn_s, 0.0)
    turn_speed = (3.0 * cube * turn_s + 2.0 * square) * turn_s + linear
    speed = np.maximum(np.abs(linear), np.maximum(np.abs(end_speed), np.abs(turn_speed)))
    accel = np.maximum(np.abs(2.0 * square), np.abs(6.0 * cube * length_s + 2.0 * square))
    return speed, accel
