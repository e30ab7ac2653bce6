"""How much faster than the robot the simulator is, and what it costs in real time."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import statistics
import tempfile
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING

import serial

from benches.table import Row, core_seconds
from lss_motion.protocol.constants import Family
from lss_motion.robot.model import Bus, Joint, Robot, ServoModel
from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import ServoSpec
from lss_motion.sim.pty import serve
from lss_motion.system.real_time import prompt_waits
from lss_motion.units import LINE_BITS_PER_BYTE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnContext

ST1 = ServoModel(name="LSS-ST1", family=Family.LSS, speed_max_deg_s=360.0, wire_per_deg=10)
SERVOS = 40
SIMULATED_S = 20.0
MOVE_S = 0.1
BAUD_BPS = 921_600
REPEATS = 5
SPEED_TARGET = 20.0

WALKERS = 18
WALK_S = 8.0
WALK_BPS = 115_200
CPU_TARGET = 0.25

ROUNDS = 100
TURNAROUND_S = 0.6e-3
"""The middle of 0.2 to 1.0 ms (`lss_motion.sim.physics.turnaround_of`)."""
LATENESS_TARGET = 1.3
LEAST_LATENESS = 0.9


def measure() -> list[Row]:
    """Return the speed in virtual time, the cost in real time, and how late replies are."""
    ratio = SIMULATED_S / statistics.median(core_seconds(_move_all) for _ in range(REPEATS))
    cost, ours, bare = _in_real_time()
    return [
        Row(
            what=f"{SERVOS} moving servos, virtual time",
            ours=f"{ratio:.1f} x real time",
            reference="real time, one core",
            ratio=ratio,
            target=f">= {SPEED_TARGET:g} x",
            is_met=ratio >= SPEED_TARGET,
        ),
        Row(
            what=f"{WALKERS} moving servos behind a pseudo-terminal",
            ours=f"{cost:.1%} of one core",
            reference="one core",
            ratio=cost,
            target=f"< {CPU_TARGET:.0%}",
            is_met=cost < CPU_TARGET,
        ),
        Row(
            what=f"{WALKERS} servos x {ROUNDS} rounds of QD there",
            ours=f"{ours:.2f} x the line and the turnaround",
            reference=f"{bare:.2f} x for a process that only waits and answers",
            ratio=ours / bare,
            target=f"<= {LATENESS_TARGET:g}, and not below the line less chance",
            is_met=ours >= LEAST_LATENESS and ours <= LATENESS_TARGET * bare,
        ),
    ]


def _move_all() -> None:
    """Stream moves to all servos and ask one of them in every gap, in virtual time."""
    specs = [ServoSpec(servo_id=number, model=ST1) for number in range(SERVOS)]
    bus = SimBus(specs, baud_bps=BAUD_BPS, firmware=370, seed=1)
    step_ns = round(MOVE_S * 1e9)
    for turn in range(round(SIMULATED_S / MOVE_S)):
        now_ns = turn * step_ns
        lines = [_move(number, turn) for number in range(SERVOS)]
        bus.write(b"".join(lines) + b"#%dQD\r" % (turn % SERVOS), now_ns)
        while (arrival_ns := bus.next_arrival_ns()) is not None:
            assert bus.read(arrival_ns)
    bus.advance(round(SIMULATED_S * 1e9))


def _move(number: int, turn: int) -> bytes:
    target = ((turn * 37 + number * 11) % 61 - 30) * 10
    return b"#%dD%dT%d\r" % (number, target, round(MOVE_S * 1000))


def _in_real_time() -> tuple[float, float, float]:
    """Return what the simulator takes of a core while servos walk, and how long answers take.

    That is a share of what physics needs: its own, and those of a process that does nothing else.
    They are asked in turns; the median counts. A process on a virtual machine wakes late.
    """
    processes = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        link = Path(folder) / "port"
        ours, theirs = processes.Pipe()
        process = processes.Process(target=_simulate, args=(link, theirs))
        process.start()
        stack.callback(process.join)
        stack.callback(ours.send, "end")
        ours.recv()
        bare_path = stack.enter_context(_bare(processes))
        bare = stack.enter_context(serial.Serial(bare_path, WALK_BPS, timeout=1.0))
        port = stack.enter_context(serial.Serial(str(link), WALK_BPS, timeout=1.0))
        started_s, before_s = time.monotonic(), _used_s(ours)
        _walk(port)
        cost = (_used_s(ours) - before_s) / (time.monotonic() - started_s)
        taken = [(_ask_all(port), _ask_all(bare)) for _ in range(ROUNDS)]
        own, others = (statistics.median(column) for column in zip(*taken, strict=True))
    return cost, own, others


@contextlib.contextmanager
def _bare(processes: SpawnContext) -> Iterator[str]:
    """Yield a port behind which a process answers every question as late as a servo would."""
    ours, theirs = processes.Pipe()
    process = processes.Process(target=_answer, args=(theirs,), daemon=True)
    process.start()
    yield ours.recv()
    process.kill()
    process.join()


def _answer(pipe: Connection) -> None:
    master_fd, slave_fd = os.openpty()
    tty.setraw(slave_fd)
    pipe.send(os.ttyname(slave_fd))
    with prompt_waits():
        while True:
            query = os.read(master_fd, 64)
            asked_s = time.monotonic()
            while not query.endswith(b"\r"):
                query += os.read(master_fd, 64)
            reply = b"*" + query[1:-1] + b"-450\r"
            on_line_s = (len(query) + len(reply)) * LINE_BITS_PER_BYTE / WALK_BPS
            time.sleep(max(asked_s + on_line_s + TURNAROUND_S - time.monotonic(), 0.0))
            os.write(master_fd, reply)


def _simulate(link: Path, pipe: Connection) -> None:
    """Serve the robot until the pipe says `end`; answer anything else with the time used."""

    def should_stop() -> bool:
        while pipe.poll():
            if pipe.recv() == "end":
                return True
            pipe.send(time.process_time())
        return False

    serve(_robot(), link, seed=1, announce=lambda _: pipe.send("ready"), should_stop=should_stop)


def _used_s(pipe: Connection) -> float:
    pipe.send("time")
    return float(pipe.recv())


def _walk(port: serial.Serial) -> None:
    """Move all servos ten times a second and read one of them each time."""
    started_s = time.monotonic()
    for turn in range(round(WALK_S / MOVE_S)):
        port.write(b"".join(_move(number, turn) for number in range(WALKERS)))
        port.write(b"#%dQD\r" % (turn % WALKERS))
        assert port.read_until(b"\r").endswith(b"\r")
        time.sleep(max(started_s + (turn + 1) * MOVE_S - time.monotonic(), 0.0))


def _ask_all(port: serial.Serial) -> float:
    """Ask every servo in turn; return the time taken as a share of what physics needs."""
    bytes_both_ways, started_s = 0, time.monotonic()
    for number in range(WALKERS):
        query = b"#%dQD\r" % number
        port.write(query)
        bytes_both_ways += len(query) + len(port.read_until(b"\r"))
    needed_s = bytes_both_ways * LINE_BITS_PER_BYTE / WALK_BPS + WALKERS * TURNAROUND_S
    return (time.monotonic() - started_s) / needed_s


def _robot() -> Robot:
    joints = {
        f"joint{number}": Joint(
            name=f"joint{number}",
            servo_id=number,
            bus="main",
            model=ST1,
            position_min_deg=-90.0,
            position_max_deg=90.0,
            speed_max_deg_s=180.0,
            accel_max_deg_s2=600.0,
        )
        for number in range(WALKERS)
    }
    bus = Bus(name="main", port="sim://", baud_bps=WALK_BPS, firmware=370)
    return Robot(name="bench", path=None, buses={"main": bus}, joints=joints)
