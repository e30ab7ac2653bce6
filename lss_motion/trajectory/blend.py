"""A show and its layers blended, as if there were no limits: angles and speeds at any instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.units import significant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Layer, Sequence
    from lss_motion.trajectory.model import Trajectory

    FloatArray = NDArray[np.float64]

JUMP_DEG: Final = 1e-6
JUMP_DEG_S: Final = 1e-3
"""Angles and speeds that differ by less on both sides of an instant are equal: rounding."""

SIDE_S: Final = 1e-9
"""How far from an instant both of its sides are."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """One layer with its plan, over the show from `from_s` to `to_s`."""

    layer: Layer
    trajectory: Trajectory
    from_s: float
    to_s: float

    def weights(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how much of the layer counts at each instant, and how fast that grows."""
        rise, rise_slope = _eased(times_s - self.from_s, self.layer.fade_s)
        fall, fall_slope = _eased(self.to_s - times_s, self.layer.fade_s)
        weight = self.layer.weight
        return weight * rise * fall, weight * (rise_slope * fall - rise * fall_slope)


def _eased(since_s: FloatArray, fade_s: float) -> tuple[FloatArray, FloatArray]:
    """Return a smooth step from 0 to 1 within `fade_s`, and its slope."""
    if fade_s <= 0.0:
        return np.where(since_s >= 0.0, 1.0, 0.0), np.zeros_like(since_s)
    share = np.clip(since_s / fade_s, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share), 6.0 * share * (1.0 - share) / fade_s


@dataclass(frozen=True, slots=True)
class Sum:
    """The show and its layers, as if there were no limits."""

    joints: tuple[str, ...]
    base: Trajectory
    sheets: tuple[Sheet, ...]
    rest_deg: FloatArray
    """Where a joint is that only layers move."""

    @property
    def duration_s(self) -> float:
        return max(self.base.duration_s, *(sheet.to_s for sheet in self.sheets))

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angles and speeds, (n, joints)."""
        deg = np.tile(self.rest_deg, (len(times_s), 1))
        speed = np.zeros_like(deg)
        columns = [self.joints.index(name) for name in self.base.joints]
        deg[:, columns] = self.base.sample(times_s)
        speed[:, columns] = self.base.sample(times_s, 1)
        for sheet in self.sheets:
            rows = np.flatnonzero((times_s >= sheet.from_s) & (times_s <= sheet.to_s))
            if len(rows):
                self._lay(sheet, times_s[rows], rows, (deg, speed))
        return deg, speed

    def _lay(
        self,
        sheet: Sheet,
        times_s: FloatArray,
        rows: NDArray[np.intp],
        below: tuple[FloatArray, FloatArray],
    ) -> None:
        own = [k for k, name in enumerate(sheet.trajectory.joints) if name in sheet.layer.joints]
        columns = [self.joints.index(sheet.trajectory.joints[k]) for k in own]
        place = np.ix_(rows, np.array(columns, dtype=np.intp))
        top_deg = sheet.trajectory.sample(times_s - sheet.from_s)[:, own]
        top_speed = sheet.trajectory.sample(times_s - sheet.from_s, 1)[:, own]
        if sheet.layer.mode == "override":
            top_deg -= below[0][place]
            top_speed -= below[1][place]
        weight, growth = (value[:, None] for value in sheet.weights(times_s))
        below[0][place] += weight * top_deg
        below[1][place] += weight * top_speed + growth * top_deg


def summed(base: Trajectory, sheets: tuple[Sheet, ...], robot: Robot) -> Sum:
    """Return the sum; raise `InputError` for a layer that adds to what nothing below moves."""
    rest_deg: dict[str, float] = {}
    for sheet in sheets:
        if sheet.layer.mode == "override":
            start_deg = sheet.trajectory.sample(np.zeros(1))[0].tolist()
            for name, angle_deg in zip(sheet.trajectory.joints, start_deg, strict=True):
                if name in sheet.layer.joints:
                    rest_deg.setdefault(name, angle_deg)
    moved = {*base.joints}
    for sheet in sheets:
        own = {*sheet.trajectory.joints} & {*sheet.layer.joints}
        if sheet.layer.mode == "add" and (alone := sorted(own - moved - {*rest_deg})):
            raise InputError(
                f"a layer adds to joint {alone[0]!r}, but nothing below says where that is",
                path=sheet.layer.sequence.path,
                line=sheet.layer.line,
            )
        moved |= own
    joints = tuple(name for name in robot.joints if name in moved)
    return Sum(joints, base, sheets, np.array([rest_deg.get(name, 0.0) for name in joints]))


def check_jumps(total: Sum, show: Sequence) -> None:
    """Raise `InputError` where a layer begins or ends with a jump of angle or speed."""
    for sheet in total.sheets:
        for at_s in (sheet.from_s, sheet.to_s):
            if not 0.0 < at_s < total.duration_s:
                continue
            sides = at_s + SIDE_S * np.array([-2.0, -1.0, 1.0, 2.0])
            # Carried on to the seam from both sides: bending there is no jump.
            deg, speed = (
                np.abs(2.0 * value[2] - value[3] - 2.0 * value[1] + value[0])
                for value in total.at(sides)
            )
            if deg.max() > JUMP_DEG or speed.max() > JUMP_DEG_S:
                column = int((deg + speed).argmax())
                raise InputError(
                    f"layer {sheet.layer.sequence.name!r} would make joint "
                    f"{total.joints[column]!r} jump by {significant(deg[column], 3)} deg and "
                    f"{significant(speed[column], 3)} deg/s at {at_s:g} s; give it a fade_s",
                    path=show.path,
                    line=sheet.layer.line,
                )
