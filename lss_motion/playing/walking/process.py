"""The walk planner in a process of its own, so that planning never delays a command.

A reply comes back as a few arrays. The player makes moves from them one by one as they fall due,
so taking a reply costs the loop that plays well below a millisecond.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import time
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.playing.walking.planner import PlanRequest, WalkPlanner
from lss_motion.show.gait.stepping import Twist
from lss_motion.system.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection

    from lss_motion.playing.walking.planner import PlanReply
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait

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
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(other, gait, robot, tolerance_deg), daemon=True
        )
        with _keyboard_signals_blocked():
            self._process.start()
        other.close()
        self.planning_s = 0.0

    def __enter__(self) -> PlannerProcess:
        """Wait until the planner is ready; raises `PlanningError` if it does not start."""
        is_ready = False
        with contextlib.suppress(EOFError, OSError):
            is_ready = self._connection.poll(START_MAX_S)
            self.planning_s = float(self._connection.recv()) if is_ready else 0.0
        if is_ready and self.planning_s > 0.0:
            return self
        self.close()
        raise PlanningError(
            "the process that plans the walk does not start; is this computer busy?"
        )

    def close(self) -> None:
        """End the planner process."""
        self._connection.close()
        self._process.join(CLOSE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def fileno(self) -> int:
        """Return what becomes readable when there is a reply."""
        return self._connection.fileno()

    def send(self, request: PlanRequest, now_ns: int) -> None:  # noqa: ARG002  (real time passes)
        """Send a request; raises `PlanningError` if the process has ended."""
        try:
            self._connection.send(request)
        except OSError as error:
            raise PlanningError(LOST) from error

    def poll(self, now_ns: int) -> PlanReply | None:  # noqa: ARG002
        """Return the reply once; raises `PlanningError` if the process has ended."""
        try:
            if not self._connection.poll():
                return None
            return unpacked(*self._connection.recv())
        except (EOFError, OSError) as error:
            raise PlanningError(LOST) from error


@contextlib.contextmanager
def _keyboard_signals_blocked() -> Iterator[None]:
    """Block the signals of the keyboard in a process that is started meanwhile.

    The process that plays handles them and ends this one.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # It unblocks them when it starts.
    before = signal.pthread_sigmask(
        signal.SIG_BLOCK, (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP)
    )
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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


def _serve(connection: Connection, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
    """Plan for each request until the other end closes the connection."""
    planner = WalkPlanner(gait, robot, tolerance_deg)
    trial = PlanRequest(commanded=TRIAL, was_taken=False, begins_s=TRIAL_S)
    planner.plan(trial)  # Imports what planning needs.
    started_s = time.monotonic()
    planner.plan(trial)
    with contextlib.suppress(EOFError, OSError):
        connection.send(time.monotonic() - started_s)
        while True:
            connection.send(packed(planner.plan(connection.recv())))
