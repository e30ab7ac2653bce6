"""Motion that begins where another is under way: given as angles and speeds at instants."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.trajectory.clock import steady
from lss_motion.trajectory.model import Motion, Trajectory
from lss_motion.trajectory.path import cubics
from lss_motion.trajectory.verify import verify

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]


def moving(
    name: str,
    joints: Sequence[str],
    robot: Robot,
    *,
    times_s: FloatArray,
    angles_deg: FloatArray,
    speeds_deg_s: FloatArray,
) -> Trajectory:
    """Return the motion through angles and speeds, (n, joints), cubic between them.

    It starts at 0 s, where `times_s` begins, in whatever motion is given there, and ends at rest.
    Raises `PlanningError` where it breaks a limit of `robot`: nothing is slowed.
    """
    order = [name for name in robot.joints if name in joints]
    columns = [joints.index(joint) for joint in order]
    knots_s = times_s - times_s[0]
    path = cubics(knots_s, angles_deg[:, columns], speeds_deg_s[:, columns])
    motion = Motion(path=path, clock=steady(path.length_s))
    trajectory = Trajectory(
        name=name, joints=tuple(order), first=motion, middle=motion, last=motion
    )
    verify(trajectory, robot, is_from_rest=False)
    return trajectory
