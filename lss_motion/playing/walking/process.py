"""The walk planner in a process of its own, so that planning never delays a command.

A reply comes back as a few arrays. The player makes moves from them one by one as they fall due,
so taking a reply costs the loop that plays well below a millisecond.
"""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.playing.walking.planner import PlanRequest, WalkPlanner
from lss_motion.show.gait.stepping import Twist
from lss_motion.system.closing import Closing
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import serve

if TYPE_CHECKING:
    from lss_motion.playing.walking.planner import PlanReply
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.system.messages import MessagePipe

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
