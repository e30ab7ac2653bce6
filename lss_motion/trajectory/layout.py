"""A sequence laid out along a path: every pass that differs, one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lss_motion.errors import InputError
from lss_motion.trajectory.curves import JointKeys, build_path, joint_keys, seam_slope_deg_s
from lss_motion.trajectory.keys import is_timed, keys_by_joint
from lss_motion.trajectory.path import Path, concatenate
from lss_motion.trajectory.solve import RATE_FREE, Task
from lss_motion.trajectory.spacing import Spacing, spaced

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Sequence

    FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A checked sequence and the paths of its passes: one, or those that differ (two or three)."""

    sequence: Sequence
    robot: Robot
    keys: Mapping[str, JointKeys]
    spacing: Spacing
    paths: tuple[Path, ...]
    is_timed: bool

    def authored(self, path_s: FloatArray) -> FloatArray:
        """Return the authored time of positions along all passes."""
        length_s = self.spacing.length_s
        if len(self.paths) == 1 or length_s == 0.0:
            return self.spacing.authored(path_s)
        passes = np.clip(np.floor(path_s / length_s), 0, len(self.paths) - 1)
        period_s = float(self.spacing.authored_s[-1])
        return passes * period_s + self.spacing.authored(path_s - passes * length_s)

    def seams(self) -> tuple[int, ...]:
        """Return the knots of the joined path where one pass ends and the next starts."""
        counts = np.cumsum([len(path.knots_s) - 1 for path in self.paths])
        return tuple(counts[:-1].tolist())

    def task(self, caps: Mapping[int, float]) -> Task:
        joints = [self.robot.joints[name] for name in self.keys]
        return Task(
            path=concatenate(self.paths),
            speed_max_deg_s=np.array([joint.speed_max_deg_s for joint in joints]),
            accel_max_deg_s2=np.array([joint.accel_max_deg_s2 for joint in joints]),
            rate_max=1.0 if self.is_timed else RATE_FREE,
            knot_caps=caps,
        )


def laid_out(sequence: Sequence, robot: Robot, *, may_flow: bool = True) -> Layout:
    """Return the layout of a sequence; `may_flow` False lets every pass end at rest."""
    checked = keys_by_joint(sequence, robot)
    if not checked:
        raise InputError("the sequence moves no joint", path=sequence.path)
    spacing = spaced(sequence, checked, robot)
    keys = {name: joint_keys(own, spacing) for name, own in checked.items()}
    length_s = spacing.length_s
    slopes: dict[str, float] = {}
    if sequence.loop != 1 and may_flow:
        slopes = {name: seam_slope_deg_s(own, length_s) for name, own in keys.items()}
    if not any(slopes.values()):
        paths: tuple[Path, ...] = (build_path(keys, robot, length_s),)
    else:
        first = build_path(keys, robot, length_s, end_slopes=slopes)
        middle = build_path(keys, robot, length_s, start_slopes=slopes, end_slopes=slopes)
        last = build_path(keys, robot, length_s, start_slopes=slopes)
        paths = (first, last) if sequence.loop == 2 else (first, middle, last)
    return Layout(
        sequence=sequence,
        robot=robot,
        keys=keys,
        spacing=spacing,
        paths=paths,
        is_timed=is_timed(sequence),
    )
