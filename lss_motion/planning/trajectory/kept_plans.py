"""Plans kept for the next time (`planning.kept`); a loaded one passes the verifier again."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from lss_motion.files.cache import PLAN_SUFFIX
from lss_motion.planning.kept import MissError, keep, loaded
from lss_motion.planning.trajectory.model import motions_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence

PIECES_MIN: Final = 64
"""Plans with fewer polynomials and clock pieces are not kept: they are made as fast as loaded."""


def kept_plan(name: str, make: Callable[[], Trajectory], robot: Robot) -> Trajectory:
    """Return the plan that is kept under `name`, if it passes `verify`, else that of `make`.

    `name` is a hash of all that the plan depends on; `make` returns a verified plan.
    """
    from lss_motion.planning.trajectory.verify import verify

    def check(trajectory: Trajectory) -> None:
        verify(trajectory, robot)

    with suppress(MissError):
        return loaded(PLAN_SUFFIX, name, check)
    trajectory = make()
    motions = {id(part): part for part in motions_of(trajectory)}.values()
    if sum(len(m.path.knots_s) + len(m.clock.rates) for m in motions) >= PIECES_MIN:
        keep(PLAN_SUFFIX, name, trajectory)
    return trajectory


def cache_name(sequence: Sequence, robot: Robot, *, may_flow: bool = True) -> str:
    """Return the name of an entry: a hash of keys, times and limits."""
    digest = hashlib.sha256(
        repr(
            (
                sequence.name,
                str(sequence.timing),
                sequence.fit_duration_s,
                sequence.loop,
                sorted(sequence.keeps_time),
                sequence.loop_span_s,
                may_flow,
                sequence.smooth_s,
                [
                    (
                        joint.name,
                        joint.position_min_deg,
                        joint.position_max_deg,
                        joint.speed_max_deg_s,
                        joint.accel_max_deg_s2,
                        joint.jerk_max_deg_s3,
                    )
                    for joint in (*robot.joints.values(), *robot.servos.values())
                ],
                *robot.mechanisms.values(),
            )
        ).encode()
    )
    for frame in sequence.keyframes:
        digest.update(
            repr(
                (
                    frame.at_s,
                    frame.hold_s,
                    frame.hold_may_shrink,
                    frame.is_anchor,
                    frame.is_exact,
                    frame.weight,
                    str(frame.ease),
                    frame.label,
                    [(name, float(angle_deg)) for name, angle_deg in frame.deg.items()],
                    sorted(frame.slope_deg_s.items()),
                )
            ).encode()
        )
    return digest.hexdigest()
