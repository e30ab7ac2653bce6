"""Sequences to trajectories: paths through keyframes, followed as fast as limits and author allow.

`planner.plan` makes a `Trajectory`, `verify.verify` is its independent judge, `plot.plot` draws it.
toppra is imported by `parameterize` alone, and only when something must be slowed or hurried.
"""

from lss_motion.trajectory.model import Mark, Motion, Stretch, Trajectory
from lss_motion.trajectory.planner import plan
from lss_motion.trajectory.verify import Verification, verify

__all__ = ["Mark", "Motion", "Stretch", "Trajectory", "Verification", "plan", "verify"]
