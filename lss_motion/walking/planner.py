"""From a wish to moves: the next stretch of a walk as an extension of the program that plays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import LssMotionError
from lss_motion.gait.curves import spline
from lss_motion.gait.model import BodyMove, BodyPose
from lss_motion.gait.pacing import paced
from lss_motion.gait.steering import HISTORY_S, Steering
from lss_motion.gait.stepping import STILL
from lss_motion.program.model import Program
from lss_motion.program.splice import SpliceState, initial_splice_state, splice_lead_s
from lss_motion.trajectory.tracks import given_motion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.gait.model import Gait
    from lss_motion.gait.stepping import Twist, Walker
    from lss_motion.program.splice import Extension
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

POSE_S: Final = 1.0
"""How long the body takes to another pose. Chosen: a calm move; what is too fast is slowed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRequest:
    """What is wished for next.

    `was_taken`: the last answer is being played. `begins_s`: begin from a stand, at that show
    time; None: go on from the next boundary. `hold`: for how many phases to walk at `commanded`.
    `pose`: from a stand, bring the body there instead of walking.
    """

    commanded: Twist
    was_taken: bool
    begins_s: float | None = None
    hold: int = 1
    pose: BodyPose | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanReply:
    """What can be played next, in show time; `extension` None: nothing, for `reason`.

    It begins at `from_s`. The one after it would begin at `next_s`, or, where that is None, from
    the stand that is reached at `end_s`.
    """

    extension: Extension | None
    twist: Twist = STILL
    from_s: float = 0.0
    next_s: float | None = None
    end_s: float = 0.0
    reason: str = ""


@dataclass(slots=True)
class _Course:
    """Where the walk has come to: what is played, or may be."""

    splice_state: SpliceState
    walker: Walker
    pose: BodyPose
    starts_s: float = 0.0


class WalkPlanner:
    """Plans for one robot that stands at first; keeps what it offered until it hears of it."""

    def __init__(self, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
        self._gait = gait
        self._robot = robot
        steering = Steering(gait, robot, BodyPose())
        walker = steering.standing()
        angles = walker.past.values[-1].tolist()
        self.program = Program(
            name=gait.name,
            robot=robot.name,
            robot_path=robot.path,
            moves=(),
            duration_s=0.0,
            start_deg=dict(zip(steering.joints, angles, strict=True)),
            tolerance_deg=tolerance_deg,
        )
        self._played = _Course(initial_splice_state(self.program, robot), walker, BodyPose())
        self._offered: _Course | None = None

    @property
    def phase_s(self) -> float:
        return self._steering().stepper.phase_s

    @property
    def splice_s(self) -> float:
        """How long before a boundary its moves must be known."""
        return splice_lead_s(self._robot, self._played.splice_state.profiles)

    def plan(self, request: PlanRequest) -> PlanReply:
        """Return what can be played; never raises what a wish can cause."""
        if request.was_taken and self._offered is not None:
            self._played = self._offered
        self._offered = None
        try:
            if request.pose is not None:
                return self._posed(request, request.pose)
            return self._walked(request)
        except LssMotionError as error:
            return PlanReply(extension=None, reason=str(error))

    def _steering(self) -> Steering:
        return Steering(self._gait, self._robot, self._played.pose)

    def _walked(self, request: PlanRequest) -> PlanReply:
        steering, course = self._steering(), self._played
        walker, starts_s = course.walker, course.starts_s
        if request.begins_s is not None:
            walker, starts_s = steering.standing(), request.begins_s
        stretch = steering.plan_towards(walker, request.commanded, request.hold)
        from_s, end_s = starts_s + stretch.from_s, starts_s + stretch.end_s
        curve = (stretch.times_s, stretch.angles_deg, stretch.slopes_deg_s)
        extension = self._extension(*curve, starts_s=starts_s, from_s=from_s)
        following = stretch.following
        self._offered = replace(
            course,
            splice_state=course.splice_state.taken(extension),
            walker=following,
            starts_s=starts_s,
        )
        goes_on = not steering.is_standing(following)
        return PlanReply(
            extension=extension,
            twist=stretch.twist,
            from_s=from_s,
            next_s=starts_s + stretch.next_s if goes_on else None,
            end_s=end_s,
        )

    def _posed(self, request: PlanRequest, pose: BodyPose) -> PlanReply:
        """Bring the body to a pose from a stand, feet where they are."""
        course, starts_s = self._played, request.begins_s
        assert starts_s is not None, "only from a stand"
        gait = replace(
            self._gait, start=course.pose, actions=(BodyMove(pose=pose, in_s=POSE_S, label="pose"),)
        )
        (part,) = paced(gait, self._robot)
        slopes = spline(float(part.times_s[1]), part.angles_deg).slopes / part.pace_ratio
        extension = self._extension(
            np.append(-HISTORY_S, part.times_s * part.pace_ratio),
            np.concatenate([part.angles_deg[:1], part.angles_deg]),
            np.concatenate([slopes[:1], slopes]),
            starts_s=starts_s,
            from_s=starts_s,
        )
        splice_state = course.splice_state.taken(extension)
        self._offered = replace(course, splice_state=splice_state, pose=pose, starts_s=starts_s)
        end_s = starts_s + part.duration_s
        return PlanReply(extension=extension, from_s=starts_s, end_s=end_s)

    def _extension(
        self,
        times_s: FloatArray,
        angles_deg: FloatArray,
        speeds_deg_s: FloatArray,
        *,
        starts_s: float,
        from_s: float,
    ) -> Extension:
        trajectory = given_motion(
            self._gait.name,
            self._steering().joints,
            self._robot,
            times_s=times_s,
            angles_deg=angles_deg,
            speeds_deg_s=speeds_deg_s,
        )
        splice_state = self._played.splice_state
        return splice_state.extended(
            trajectory, starts_s=starts_s + float(times_s[0]), from_s=from_s
        )
