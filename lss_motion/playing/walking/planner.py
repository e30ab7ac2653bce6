"""Plans a walk ahead: a commanded velocity → an extension of the program that is being played.

`WalkPlanner` keeps the state of the walk at the end of what is played. It reads no clock, so the
same requests give the same plans. `PlannerProcess` runs it in a process of its own, so that
planning never delays a command. A reply comes back as a few arrays. The player makes moves from
them one by one as they fall due, so taking a reply costs the loop that plays well below a
millisecond.
"""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import LssMotionError, PlanningError
from lss_motion.planning.program.model import Program
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.splice import SpliceState, initial_splice_state, splice_lead_s
from lss_motion.planning.trajectory.curves import cubics
from lss_motion.planning.trajectory.window import planned_window
from lss_motion.show.gait.curves import spline
from lss_motion.show.gait.model import BodyMove, BodyPose
from lss_motion.show.gait.pacing import paced
from lss_motion.show.gait.steering import HISTORY_S, SteeredGait
from lss_motion.show.gait.stepping import STILL, Twist
from lss_motion.system.closing import Closing
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import serve

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.planning.program.splice import Extension
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.stepping import Walker
    from lss_motion.system.messages import MessagePipe

    FloatArray = NDArray[np.float64]

POSE_S: Final = 1.0
"""How long the body takes to reach a pose. Chosen: a calm move. A limit can make it longer."""


class PlanRequest(Struct, frozen=True, kw_only=True):
    """A request for the next part of a walk.

    `was_taken`: the last reply is being played. `begins_s`: begin from a stand, at that show
    time; None: continue from the next boundary. `hold`: for how many phases to walk at
    `commanded`. `pose`: from a stand, bring the body to this pose instead of walking.
    """

    commanded: Twist
    was_taken: bool
    begins_s: float | None = None
    hold: int = 1
    pose: BodyPose | None = None


class PlanReply(Struct, frozen=True, kw_only=True):
    """The next part of a walk, in show time. Without `extension` there is none, for `reason`.

    The part begins at `from_s`. The part after it begins at `next_s`. Where that is None, the
    robot stands from `end_s` on.
    """

    extension: Extension | None
    twist: Twist = STILL
    from_s: float = 0.0
    next_s: float | None = None
    end_s: float = 0.0
    reason: str = ""


class _Progress(Struct, frozen=True):
    """The state of the walk at the end of what is played, or of what was offered."""

    splice_state: SpliceState
    walker: Walker
    pose: BodyPose
    starts_s: float = 0.0


class WalkPlanner:
    """Plans for one robot that stands at first.

    Each reply is an offer; the next request reports whether it was taken (`was_taken`).
    """

    def __init__(self, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
        self._gait = gait
        self._robot = robot
        steering = SteeredGait(gait, robot, BodyPose())
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
        self._played = _Progress(initial_splice_state(self.program, robot), walker, BodyPose())
        self._offered: _Progress | None = None

    @property
    def phase_s(self) -> float:
        """How long a phase takes; a velocity can change at its boundaries."""
        return self._steering().stepper.phase_s

    @property
    def splice_s(self) -> float:
        """How long before a boundary the player needs the moves from there on."""
        return splice_lead_s(self._robot, self._played.splice_state.profiles)

    def plan(self, request: PlanRequest) -> PlanReply:
        """Return the reply to `request`; a request that cannot be planned raises nothing."""
        if request.was_taken and self._offered is not None:
            self._played = self._offered
        self._offered = None
        try:
            if request.pose is not None:
                return self._plan_pose(request, request.pose)
            return self._plan_walk(request)
        except LssMotionError as error:
            return PlanReply(extension=None, reason=str(error))

    def _steering(self) -> SteeredGait:
        return SteeredGait(self._gait, self._robot, self._played.pose)

    def _plan_walk(self, request: PlanRequest) -> PlanReply:
        steering, played = self._steering(), self._played
        walker, starts_s = played.walker, played.starts_s
        if request.begins_s is not None:
            walker, starts_s = steering.standing(), request.begins_s
        part = steering.plan_towards(walker, request.commanded, request.hold)
        from_s, end_s = starts_s + part.from_s, starts_s + part.end_s
        curve = (part.times_s, part.angles_deg, part.slopes_deg_s)
        extension = self._extension(*curve, starts_s=starts_s, from_s=from_s)
        following = part.following
        self._offered = replace(
            played,
            splice_state=played.splice_state.taken(extension),
            walker=following,
            starts_s=starts_s,
        )
        goes_on = not steering.is_standing(following)
        return PlanReply(
            extension=extension,
            twist=part.twist,
            from_s=from_s,
            next_s=starts_s + part.next_s if goes_on else None,
            end_s=end_s,
        )

    def _plan_pose(self, request: PlanRequest, pose: BodyPose) -> PlanReply:
        """Plan the move of the body from a stand to a pose; the feet do not move."""
        played, starts_s = self._played, request.begins_s
        assert starts_s is not None, "a pose is planned from a stand only"
        gait = replace(
            self._gait, start=played.pose, actions=(BodyMove(pose=pose, in_s=POSE_S, label="pose"),)
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
        splice_state = played.splice_state.taken(extension)
        self._offered = replace(played, splice_state=splice_state, pose=pose, starts_s=starts_s)
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
        """Return the moves along these cubics, from show time `from_s` on."""
        trajectory = planned_window(
            self._gait.name,
            self._steering().joints,
            self._robot,
            cubics(times_s - times_s[0], angles_deg, speeds_deg_s),
        )
        splice_state = self._played.splice_state
        return splice_state.extended(
            trajectory, starts_s=starts_s + float(times_s[0]), from_s=from_s
        )


TRIAL_S: Final = 1.0
TRIAL: Final = Twist(forward_mm_s=1.0)
"""Show time and velocity of a plan that measures the planning time; it is not walked."""
START_MAX_S: Final = 60.0
CLOSE_S: Final = 2.0
"""A planner that has not ended this long after its connection was closed is killed."""
LOST: Final = "the process that plans the walk has ended; the robot goes to a stand by itself"


class PlannerProcess(Closing):
    """A `PlannerLink` to a planner process. As a context manager it is entered when that is ready.

    `planning_s` is the time that planning the trial took.
    """

    def __init__(self, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
        self._child: ChildProcess[Any] = ChildProcess(__name__)
        self._child.send_object((gait, robot, tolerance_deg))
        self._replies: deque[Any] = deque()
        self.planning_s = 0.0

    def __enter__(self) -> PlannerProcess:
        """Wait until the planner is ready; raises `PlanningError` if it does not start."""
        ready = self._child.receive_within(START_MAX_S)
        if not ready:
            self.close()
            raise PlanningError(
                "the process that plans the walk does not start; is this computer busy?"
            )
        self.planning_s = float(ready[0])
        return self

    def close(self) -> None:
        """End the planner process."""
        self._child.end(CLOSE_S)

    def fileno(self) -> int:
        """Return what becomes readable when there is a reply."""
        return self._child.fileno()

    def send(self, request: PlanRequest, now_ns: int) -> None:  # noqa: ARG002  (real time passes)
        """Send a request; raises `PlanningError` if the process has ended."""
        if not self._child.send_object(request):
            raise PlanningError(LOST)

    def poll(self, now_ns: int) -> PlanReply | None:  # noqa: ARG002
        """Return the reply once; raises `PlanningError` if the process has ended."""
        self._replies += self._child.receive()
        if self._replies:
            return unpacked(*self._replies.popleft())
        if self._child.has_ended:
            raise PlanningError(LOST)
        return None


def packed(reply: PlanReply) -> tuple[PlanReply, Any]:
    """Return a reply without its profiles, and those as arrays; its moves are arrays already."""
    extension = reply.extension
    if extension is None:
        return reply, None
    tables = {name: np.stack(own.table) for name, own in extension.profiles.items()}
    return replace(reply, extension=replace(extension, profiles={})), tables


def unpacked(reply: PlanReply, tables: Any) -> PlanReply:  # noqa: ANN401  (from `packed`)
    """Return the reply that was packed."""
    if reply.extension is None:
        return reply
    profiles = {name: PiecewiseProfile.of(tuple(table)) for name, table in tables.items()}
    return replace(reply, extension=replace(reply.extension, profiles=profiles))


def main(pipe: MessagePipe) -> int:
    """Plan for each request until the pipe ends."""
    typed: TypedPipe[Any] = TypedPipe(pipe)
    planner: WalkPlanner | None = None

    def obey(message: Any) -> None:  # noqa: ANN401
        nonlocal planner
        if planner is not None:
            typed.send_object(packed(planner.plan(message)))
            return
        planner = WalkPlanner(*message)
        trial = PlanRequest(commanded=TRIAL, was_taken=False, begins_s=TRIAL_S)
        planner.plan(trial)  # Imports what planning needs.
        started_s = time.monotonic()
        planner.plan(trial)
        typed.send_object(time.monotonic() - started_s)

    serve(typed, obey)
    return 0
