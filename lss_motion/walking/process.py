"""The planner in a process of its own, so that planning never delays a command.

What comes back is a handful of arrays: moves are made of them one by one as they fall due, so that
taking over a stretch costs the loop that plays well below a millisecond.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import time
from dataclasses import replace
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion.errors import PlanningError
from lss_motion.gait.stepping import Twist
from lss_motion.program.response import PiecewiseProfile
from lss_motion.walking.planner import PlanRequest, WalkPlanner

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection
    from types import TracebackType

    from lss_motion.gait.model import Gait
    from lss_motion.robot.model import Robot
    from lss_motion.walking.planner import PlanReply

FIRST_S: Final = 1.0
FIRST: Final = Twist(forward_mm_s=1.0)
"""Show time and velocity of a stretch that is planned to see how long it takes, and not walked."""
START_MAX_S: Final = 60.0
CLOSE_S: Final = 2.0
"""A planner that has not ended this long after it was told to is ended."""
LOST: Final = "the process that plans the walk has ended; the robot goes to a stand by itself"


class PlannerProcess:
    """A planner elsewhere; a context manager, which is entered when the planner is ready.

    `planning_s` is how long its first stretch took to plan.
    """

    def __init__(self, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(other, gait, robot, tolerance_deg), daemon=True
        )
        with _unheard():
            self._process.start()
        other.close()
        self.planning_s = 0.0

    def __enter__(self) -> PlannerProcess:
        """Wait for the planner; raises `PlanningError` if it does not start."""
        is_ready = False
        with contextlib.suppress(EOFError, OSError):
            is_ready = self._connection.poll(START_MAX_S)
            self.planning_s = float(self._connection.recv()) if is_ready else 0.0
        if is_ready and self.planning_s > 0.0:
            return self
        self.close()
        raise PlanningError("the process that plans the walk does not start; is it busy here?")

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the planner."""
        self._connection.close()
        self._process.join(CLOSE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def fileno(self) -> int:
        """Return what becomes readable when there is an answer."""
        return self._connection.fileno()

    def send(self, request: PlanRequest, now_ns: int) -> None:  # noqa: ARG002  (real time passes)
        try:
            self._connection.send(request)
        except OSError as error:
            raise PlanningError(LOST) from error

    def poll(self, now_ns: int) -> PlanReply | None:  # noqa: ARG002
        try:
            if not self._connection.poll():
                return None
            return unpacked(*self._connection.recv())
        except (EOFError, OSError) as error:
            raise PlanningError(LOST) from error


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Let a process that is started meanwhile hear nothing of the keyboard: the player does."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # It would let them through again when it starts.
    before = signal.pthread_sigmask(
        signal.SIG_BLOCK, (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP)
    )
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def packed(answer: PlanReply) -> tuple[PlanReply, Any]:
    """Return an answer without its profiles, and those as arrays; its moves are arrays already."""
    extension = answer.extension
    if extension is None:
        return answer, None
    tables = {name: np.stack(own.table) for name, own in extension.profiles.items()}
    return replace(answer, extension=replace(extension, profiles={})), tables


def unpacked(answer: PlanReply, tables: Any) -> PlanReply:  # noqa: ANN401  (what `packed` returned)
    """Return the answer that was packed."""
    if answer.extension is None:
        return answer
    profiles = {name: PiecewiseProfile.of(tuple(table)) for name, table in tables.items()}
    return replace(answer, extension=replace(answer.extension, profiles=profiles))


def _serve(connection: Connection, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
    """Answer until the other end is closed."""
    planner = WalkPlanner(gait, robot, tolerance_deg)
    first = PlanRequest(commanded=FIRST, was_taken=False, begins_s=FIRST_S)
    planner.plan(first)  # Loads all that planning needs.
    started_s = time.monotonic()
    planner.plan(first)
    with contextlib.suppress(EOFError, OSError):
        connection.send(time.monotonic() - started_s)
        while True:
            connection.send(packed(planner.plan(connection.recv())))
