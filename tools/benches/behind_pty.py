"""A simulated robot in a process of its own, behind a pseudo-terminal, that reports its bytes."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from lss_motion.sim.bus import bus_from_robot
from lss_motion.sim.pty import serve_buses
from lss_motion.system.real_time import PRIORITY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection

    from lss_motion.robot.model import Robot

    Heard = list[tuple[int, bytes]]

_PROCESSES = multiprocessing.get_context("spawn")


@contextlib.contextmanager
def robot_behind_pty(robot: Robot, *, seed: int = 1) -> Iterator[tuple[Robot, Callable[[], Heard]]]:
    """Yield the robot with the port to open, and what returns all lines its servos received so far.

    A line is received, by the monotonic clock, when its last byte has arrived at the servos.
    """
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "port"
        ours, theirs = _PROCESSES.Pipe()
        process = _PROCESSES.Process(target=_serve, args=(robot, link, seed, theirs))
        process.start()
        theirs.close()
        try:
            assert ours.recv() == "ready"
            buses = {name: replace(bus, port=str(link)) for name, bus in robot.buses.items()}

            def received() -> Heard:
                ours.send("received")
                lines: Heard = ours.recv()
                return lines

            yield replace(robot, buses=buses), received
        finally:
            with contextlib.suppress(BrokenPipeError):
                ours.send("end")
            process.join()


def _serve(robot: Robot, link: Path, seed: int, pipe: Connection) -> None:
    """Serve until the pipe says `end`; answer anything else with what was received since.

    Servos do not wait for a processor: where the system permits, neither does this process.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY + 10))
    buses = {name: bus_from_robot(robot, name, seed=seed) for name in robot.buses}
    [bus] = buses.values()
    bus.record()

    def should_stop() -> bool:
        while pipe.poll():
            if pipe.recv() == "end":
                return True
            assert bus.lines is not None
            pipe.send(list(bus.lines))
            bus.lines.clear()
        return False

    serve_buses(buses, link, announce=lambda _: pipe.send("ready"), should_stop=should_stop)


@contextlib.contextmanager
def busy_cores() -> Iterator[None]:
    """Keep every core busy with ordinary work meanwhile."""
    count = os.cpu_count() or 1
    processes = [_PROCESSES.Process(target=_work, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
            process.join()


def _work() -> None:
    value = 1
    while True:
        value = value * 3 % 1_000_003
