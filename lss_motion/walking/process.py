"""The planner in a process of its own, so that planning never delays a command.

What comes back is a handful of arrays: moves are made of them one by one as they fall due, so that
taking over a stretch costs the loop that plays well below a millisecond.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, overload

import numpy as np

from lss_motion.errors import PlanningError
from lss_motion.program.model import Move
from lss_motion.program.response import Reference
from lss_motion.walking.planner import Planner

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from types import TracebackType

    from numpy.typing import NDArray

    from lss_motion.gait.model import Gait
    from lss_motion.robot.model import Robot
    from lss_motion.walking.planner import Answer, Request

NICENESS: Final = 5
"""The planner gives way to the loop that plays where they share a processor."""
CLOSE_S: Final = 2.0
"""A planner that has not ended this long after it was told to is ended."""
LOST: Final = "the process that plans the walk has ended; the robot goes to a stand by itself"


class Moves(Sequence[Move]):
    """Moves as rows of due instant, bus, servo, target and T; each is made when it is asked for."""

    def __init__(self, rows: NDArray[np.int64], buses: tuple[str, ...]) -> None:
        self._rows = rows
        self._buses = buses

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, index: int) -> Move: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Move]: ...

    def __getitem__(self, index: int | slice) -> Move | Sequence[Move]:
        if isinstance(index, slice):
            return Moves(self._rows[index], self._buses)
        due_us, bus, servo_id, target_wire, duration_ms = self._rows[index].tolist()
        return Move(
            due_us=due_us,
            bus=self._buses[bus],
            servo_id=servo_id,
            target_wire=target_wire,
            duration_ms=duration_ms,
        )


class PlannerProcess:
    """A planner elsewhere; a context manager. Its first answer waits until it has started."""

    def __init__(self, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(other, gait, robot, tolerance_deg), daemon=True
        )
        self._process.start()
        other.close()

    def __enter__(self) -> PlannerProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._connection.close()
        self._process.join(CLOSE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def fileno(self) -> int:
        """Return what becomes readable when there is an answer."""
        return self._connection.fileno()

    def ask(self, request: Request, now_ns: int) -> None:  # noqa: ARG002  (real time passes)
        try:
            self._connection.send(request)
        except OSError as error:
            raise PlanningError(LOST) from error

    def poll(self, now_ns: int) -> Answer | None:  # noqa: ARG002
        try:
            if not self._connection.poll():
                return None
            return unpacked(*self._connection.recv())
        except (EOFError, OSError) as error:
            raise PlanningError(LOST) from error


def packed(answer: Answer) -> tuple[Answer, Any]:
    """Return an answer without its moves and profiles, and those as arrays."""
    extension = answer.extension
    if extension is None:
        return answer, None
    buses = tuple(sorted({move.bus for move in extension.moves}))
    rows = np.array(
        [
            (m.due_us, buses.index(m.bus), m.servo_id, m.target_wire, m.duration_ms or 0)
            for m in extension.moves
        ],
        dtype=np.int64,
    ).reshape(-1, 5)
    tables = {name: np.stack(own.table) for name, own in extension.references.items()}
    bare = replace(answer, extension=replace(extension, moves=(), references={}))
    return bare, (rows, buses, tables)


def unpacked(answer: Answer, arrays: Any) -> Answer:  # noqa: ANN401  (what `packed` returned)
    """Return the answer that was packed."""
    if answer.extension is None:
        return answer
    rows, buses, tables = arrays
    references = {name: Reference.of(tuple(table)) for name, table in tables.items()}
    extension = replace(answer.extension, moves=Moves(rows, buses), references=references)
    return replace(answer, extension=extension)


def _serve(connection: Connection, gait: Gait, robot: Robot, tolerance_deg: float) -> None:
    """Answer until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICENESS)
    planner = Planner(gait, robot, tolerance_deg)
    with contextlib.suppress(EOFError, OSError):
        while True:
            connection.send(packed(planner.answer(connection.recv())))
