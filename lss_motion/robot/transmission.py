"""The transmissions of mechanisms (`robot.mechanism`): matrices, curves, surfaces.

`Linear` is a matrix: a gear, a pair, a differential. `LinkageCurve` is a smooth curve of one joint:
a measured table, or a four-bar (`FourBar.curve`). `Grid` is a measured surface of two joints. Both
have continuous second derivatives, so that the acceleration of a servo does not jump where that of
the joint does not. Outside of what was measured they go on straight.
"""

from __future__ import annotations

import itertools
import math
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

SLOPE_MIN: Final = 0.02
"""Servo degrees per joint degree below which a transmission counts as singular. Chosen: one unit of
an LSS, 0.1 deg, is then 5 deg of the joint."""
STEP_DEG: Final = 0.1
"""Step in which a four-bar is computed. Chosen: the cubics between are then exact to 1e-9 deg."""
POINTS_MIN: Final = 64
GRID_CHECKS: Final = 41
"""Places along each joint at which a measured surface is examined."""
NEWTON_STEPS: Final = 12
"""Measured over random surfaces: at most 6 were needed for 1e-9 deg."""
NEWTON_DEG: Final = 1e-9
"""A smaller step ends the search: the error left is about the square of it."""
SMOOTH_POINTS_MIN: Final = 5
"""What a smoothing spline needs."""


class Linear(Struct, frozen=True):
    """A matrix: the servos are rows, the joints columns."""

    matrix: tuple[tuple[float, ...], ...]

    @property
    def is_constant(self) -> bool:
        return True

    def servo_deg(self, joint_deg: FloatArray) -> FloatArray:
        return np.asarray(joint_deg @ np.array(self.matrix).T)

    def slopes(self, joint_deg: FloatArray) -> FloatArray:
        matrix = np.array(self.matrix)
        return np.broadcast_to(matrix, (len(joint_deg), *matrix.shape))

    def bends(self, joint_deg: FloatArray, first: FloatArray) -> FloatArray:
        return np.zeros((*np.broadcast_shapes(joint_deg.shape, first.shape)[:1], len(self.matrix)))

    def joint_deg(self, servo_deg: FloatArray) -> FloatArray:
        return np.asarray(servo_deg @ np.linalg.pinv(np.array(self.matrix)).T)


class LinkageCurve(Struct, frozen=True, dict=True):
    """A cubic spline through points of one joint and one servo; both rise or fall all the way."""

    joint_points_deg: tuple[float, ...]
    servo_points_deg: tuple[float, ...]

    @property
    def is_constant(self) -> bool:
        return False

    @cached_property
    def _spline(self) -> Any:  # noqa: ANN401  scipy is untyped
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.joint_points_deg, self.servo_points_deg)

    @cached_property
    def _fine(self) -> tuple[FloatArray, FloatArray]:
        """Joint angles in small steps, with the servo rising, for a first guess of the inverse."""
        low, high = self.joint_points_deg[0], self.joint_points_deg[-1]
        joint_deg = np.linspace(low, high, max(POINTS_MIN, 8 * len(self.joint_points_deg)))
        servo_deg = self._spline(joint_deg)
        return (
            (joint_deg, servo_deg)
            if servo_deg[-1] > servo_deg[0]
            else (
                joint_deg[::-1],
                servo_deg[::-1],
            )
        )

    def _inside(self, joint_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nearest angles of the curve, and how far outside of it the given ones are."""
        inside = np.clip(joint_deg, self.joint_points_deg[0], self.joint_points_deg[-1])
        return inside, joint_deg - inside

    def servo_deg(self, joint_deg: FloatArray) -> FloatArray:
        inside, over_deg = self._inside(joint_deg)
        return np.asarray(self._spline(inside) + self._spline(inside, 1) * over_deg)

    def slopes(self, joint_deg: FloatArray) -> FloatArray:
        return np.asarray(self._spline(self._inside(joint_deg)[0], 1))[:, :, None]

    def bends(self, joint_deg: FloatArray, first: FloatArray) -> FloatArray:
        inside, over_deg = self._inside(joint_deg)
        return np.where(over_deg == 0.0, self._spline(inside, 2) * first**2, 0.0)

    def joint_deg(self, servo_deg: FloatArray) -> FloatArray:
        joint_deg, rising_deg = self._fine
        found = np.interp(servo_deg, rising_deg, joint_deg)
        for _ in range(NEWTON_STEPS):
            step = (self.servo_deg(found) - servo_deg) / self.slopes(found)[:, :, 0]
            found = found - step
            if np.abs(step).max(initial=0.0) < NEWTON_DEG:
                break
        return np.asarray(found)

    def turn_deg(self) -> float | None:
        """Return the joint angle where the curve turns or becomes flat; None: nowhere."""
        joint_deg, _ = self._fine
        slopes = self._spline(joint_deg, 1)
        is_flat = np.abs(slopes) < SLOPE_MIN
        is_flat |= np.sign(slopes) != np.sign(slopes[np.abs(slopes).argmax()])
        return float(np.sort(joint_deg[is_flat])[0]) if is_flat.any() else None

    def steepest(self, from_deg: float, to_deg: float) -> tuple[float, float, float]:
        """Return the largest |g'| and |g''| in a range, and where the latter is."""
        joint_deg = np.linspace(from_deg, to_deg, max(POINTS_MIN, 8 * len(self.joint_points_deg)))
        bends = np.abs(self._spline(joint_deg, 2))
        most = int(bends.argmax())
        slope = float(np.abs(self._spline(joint_deg, 1)).max())
        return slope, float(bends[most]), float(joint_deg[most])


class Grid(Struct, frozen=True, dict=True):
    """A bicubic spline through a measured grid of two joints; `servos_deg[s][a][b]`."""

    first_deg: tuple[float, ...]
    second_deg: tuple[float, ...]
    servos_deg: tuple[tuple[tuple[float, ...], ...], ...]

    @property
    def is_constant(self) -> bool:
        return False

    @cached_property
    def _splines(self) -> list[Any]:
        from scipy.interpolate import RectBivariateSpline

        return [
            RectBivariateSpline(self.first_deg, self.second_deg, np.array(own), s=0)
            for own in self.servos_deg
        ]

    def _inside(self, joint_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        low = np.array([self.first_deg[0], self.second_deg[0]])
        inside = np.clip(joint_deg, low, np.array([self.first_deg[-1], self.second_deg[-1]]))
        return inside, joint_deg - inside

    def _at(self, inside: FloatArray, first: int, second: int) -> FloatArray:
        a, b = inside.T
        return np.stack([own.ev(a, b, dx=first, dy=second) for own in self._splines], axis=1)

    def servo_deg(self, joint_deg: FloatArray) -> FloatArray:
        inside, over_deg = self._inside(joint_deg)
        slopes = self.slopes(joint_deg)
        return np.asarray(self._at(inside, 0, 0) + np.einsum("nsj,nj->ns", slopes, over_deg))

    def slopes(self, joint_deg: FloatArray) -> FloatArray:
        inside, _ = self._inside(joint_deg)
        return np.stack([self._at(inside, 1, 0), self._at(inside, 0, 1)], axis=2)

    def bends(self, joint_deg: FloatArray, first: FloatArray) -> FloatArray:
        inside, over_deg = self._inside(joint_deg)
        a, b = np.where(over_deg == 0.0, first, 0.0).T
        square, mixed = self._at(inside, 2, 0), self._at(inside, 1, 1)
        value = square * (a**2)[:, None] + 2.0 * mixed * (a * b)[:, None]
        return np.asarray(value + self._at(inside, 0, 2) * (b**2)[:, None])

    def joint_deg(self, servo_deg: FloatArray) -> FloatArray:
        places, known = self._known
        nearest = ((servo_deg[:, None, :] - known[None]) ** 2).sum(axis=2).argmin(axis=1)
        found = places[nearest]
        for _ in range(NEWTON_STEPS):
            missing = servo_deg - self.servo_deg(found)
            step = np.einsum("njs,ns->nj", np.linalg.pinv(self.slopes(found)), missing)
            found = found + step
            if np.abs(step).max(initial=0.0) < NEWTON_DEG:
                break
        return np.asarray(found)

    @cached_property
    def _known(self) -> tuple[FloatArray, FloatArray]:
        """Joint angles all over the grid and their servos, for a first guess of the inverse."""
        places = self._places()
        return places, self.servo_deg(places)

    def _places(self, count: int = 9) -> FloatArray:
        a = np.linspace(self.first_deg[0], self.first_deg[-1], count)
        b = np.linspace(self.second_deg[0], self.second_deg[-1], count)
        return np.array(list(itertools.product(a, b)))

    def turn_deg(self) -> tuple[float, float] | None:
        """Return a place where the joints can no longer be told from the servos; None: nowhere."""
        places = self._places(GRID_CHECKS)
        slopes = self.slopes(places)
        weakest = np.linalg.svd(slopes, compute_uv=False)[:, -1]
        is_bad = weakest < SLOPE_MIN
        if slopes.shape[1] == slopes.shape[2]:
            signs = np.sign(np.linalg.det(slopes))
            is_bad |= signs != signs[len(signs) // 2]
        if not is_bad.any():
            return None
        a, b = places[int(np.argmax(is_bad))].tolist()
        return a, b


class FourBar(Struct, frozen=True, kw_only=True):
    """Lengths of a four-bar linkage in mm, and how it is put together.

    The base is the line from the axis of the servo to that of the joint. At joint angle 0 the
    rocker leans `offset_deg` from the perpendicular of the base, away from the servo. Larger joint
    angles turn it towards the servo, or `away`. `is_crossed`: the rod crosses the base.
    """

    crank_mm: float
    rod_mm: float
    rocker_mm: float
    base_mm: float
    offset_deg: float = 0.0
    is_away: bool = False
    is_crossed: bool = False

    def crank_deg(self, joint_deg: FloatArray) -> FloatArray:
        """Return the angle of the crank from the base; NaN where the linkage cannot close."""
        sign = -1.0 if self.is_away else 1.0
        rocker = np.radians(90.0 - self.offset_deg + sign * joint_deg)
        x = self.base_mm + self.rocker_mm * np.cos(rocker)
        y = self.rocker_mm * np.sin(rocker)
        reach = np.hypot(x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (self.crank_mm**2 + reach**2 - self.rod_mm**2) / (2.0 * self.crank_mm * reach)
            between = np.where(np.abs(share) <= 1.0, np.arccos(share), math.nan)
        turned = np.arctan2(y, x) + (-between if self.is_crossed else between)
        return np.degrees(np.unwrap(turned)) if np.isfinite(turned).all() else np.degrees(turned)

    def curve(self, low_deg: float, high_deg: float) -> LinkageCurve:
        """Return the servo over the joint, 0 at joint angle 0 or at the nearest one of the range.

        Raises `ValueError` with the joint angle where the linkage cannot close or turns.
        """
        steps = max(POINTS_MIN, math.ceil((high_deg - low_deg) / STEP_DEG))
        joint_deg = np.linspace(low_deg, high_deg, steps + 1)
        crank_deg = self.crank_deg(joint_deg)
        if np.isnan(crank_deg).any():
            at_deg = float(joint_deg[int(np.argmax(np.isnan(crank_deg)))])
            raise ValueError(f"cannot close at {at_deg:.1f} deg")
        slopes = np.diff(crank_deg) / np.diff(joint_deg)
        is_bad = (np.abs(slopes) < SLOPE_MIN) | (np.sign(slopes) != np.sign(slopes[0]))
        # Near a dead point the rocker stands while the crank turns: the servo races.
        is_bad |= np.abs(slopes) > 1.0 / SLOPE_MIN
        if is_bad.any():
            at_deg = float(joint_deg[int(np.argmax(is_bad))])
            raise ValueError(f"is at a dead point at {at_deg:.1f} deg")
        zero_deg = np.interp(min(max(0.0, low_deg), high_deg), joint_deg, crank_deg)
        return LinkageCurve(tuple(joint_deg.tolist()), tuple((crank_deg - zero_deg).tolist()))


def smoothed(
    joint_deg: Sequence[float], servo_deg: Sequence[float], most_deg: float
) -> tuple[float, ...]:
    """Return the servo angles of a table on the smoothest curve that stays within `most_deg`."""
    from scipy.interpolate import make_smoothing_spline

    x, y = np.array(joint_deg), np.array(servo_deg)
    low, high = -12.0, 12.0
    best = y
    for _ in range(40):
        middle = 0.5 * (low + high)
        found = make_smoothing_spline(x, y, lam=10.0**middle)(x)
        if np.abs(found - y).max() <= most_deg:
            low, best = middle, found
        else:
            high = middle
    return tuple(np.round(best, 6).tolist())
