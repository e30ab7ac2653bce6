"""Body and feet at instants: what moves over what stands, and how safely it stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

SAME_POINT_MM: Final = 1e-9
"""How far a foot may be on the wrong side of an edge that it spans itself: rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stance:
    """Body and feet at n instants, over a ground whose origin is below the body's start.

    `places`: x, y in mm and heading in rad, (n, 3). `shift_mm`: the body over that place, up from
    the ground, (n, 3), and `tilt_deg`: its tilt there, (n, 3). `feet_mm`: on or over the ground,
    (n, legs, 3). `is_down`: which feet stand, (n, legs).
    """

    places: FloatArray
    shift_mm: FloatArray
    tilt_deg: FloatArray
    feet_mm: FloatArray
    is_down: NDArray[np.bool_]

    def feet_in_body(self) -> FloatArray:
        """Return the feet as the body sees them, (n, legs, 3)."""
        relative = self.feet_mm.copy()
        relative[:, :, :2] -= self.places[:, None, :2]
        relative = _rotated(relative, _about(2, -self.places[:, 2])) - self.shift_mm[:, None, :]
        roll, pitch, yaw = np.radians(self.tilt_deg).T
        for axis, angle in ((2, yaw), (1, pitch), (0, roll)):
            relative = _rotated(relative, _about(axis, -angle))
        return relative

    def centre_mm(self) -> FloatArray:
        """Return the point of the ground below the body's centre, (n, 2)."""
        shift = np.zeros((len(self.places), 1, 3))
        shift[:, 0, :2] = self.shift_mm[:, :2]
        turned = _rotated(shift, _about(2, self.places[:, 2]))[:, 0, :2]
        return np.asarray(self.places[:, :2] + turned)

    def margin_mm(self) -> FloatArray:
        """Return how far the body's centre is inside of the feet that stand, (n,).

        That is the distance to the nearest edge of their polygon; negative outside of it, and
        where fewer than three feet stand.
        """
        centre = self.centre_mm()
        margin = np.full(len(centre), -np.inf)
        groups, group = np.unique(self.is_down, axis=0, return_inverse=True)
        for index, down in enumerate(groups):
            chosen = np.flatnonzero(group.ravel() == index)
            feet = self.feet_mm[chosen][:, down, :2]
            margin[chosen] = _margin(feet, centre[chosen])
        return margin


def _margin(feet: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the distance to the nearest edge: a line that all feet are to the left of."""
    if feet.shape[1] == 0:
        return np.full(len(centre), -np.inf)
    if feet.shape[1] == 1:
        return np.asarray(-np.hypot(*(feet[:, 0] - centre).T))
    edges = feet[:, None, :, :] - feet[:, :, None, :]
    lengths = np.hypot(edges[..., 0], edges[..., 1])
    is_pair = lengths > SAME_POINT_MM
    units = edges / np.where(is_pair, lengths, 1.0)[..., None]

    def left_of(points: FloatArray) -> FloatArray:
        ahead = points[:, None, None, :] - feet[:, :, None, :]
        return np.asarray(units[..., 0] * ahead[..., 1] - units[..., 1] * ahead[..., 0])

    is_edge = is_pair
    for other in range(feet.shape[1]):
        is_edge = is_edge & (left_of(feet[:, other]) >= -SAME_POINT_MM)
    return np.asarray(np.where(is_edge, left_of(centre), np.inf).min(axis=(1, 2)))


def _about(axis: int, angle: FloatArray) -> FloatArray:
    """Return the rotations about one axis, (n, 3, 3)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.zeros((len(angle), 3, 3))
    rotation[:, axis, axis] = 1.0
    rotation[:, first, first] = rotation[:, second, second] = np.cos(angle)
    rotation[:, second, first] = np.sin(angle)
    rotation[:, first, second] = -rotation[:, second, first]
    return rotation


def _rotated(points: FloatArray, rotation: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nlj->nli", rotation, points))
