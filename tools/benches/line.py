"""How much of the line is filled with questions, and how many answers that makes.

The limit is physics alone: both lines of the bus never idle, the commands first. No client can
reach it, since the start of a reply is not known before.

Over a pseudo-terminal both clients, and the robot, wait for a processor: ours got 2.75 (115200 bps)
and 3.3 times (500000) as many answers on a quiet virtual machine, and 2.4 and 2.8 on the same one
while its owner took much of it away.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import serial

from benches.behind_pty import robot_behind_pty
from benches.shows import lively_show, robot_of
from benches.table import Row
from lss_motion.playing import api
from lss_motion.playing.player.events import Phase, PhaseEntered
from lss_motion.playing.run import Observer, perform
from lss_motion.units import LINE_BITS_PER_BYTE, line_time_ns, s_from_ns

if TYPE_CHECKING:
    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event
    from lss_motion.robot.model import Robot

SERVOS = 18
SHOW_S = 6.0
FILL_TARGET = 0.9
PTY_SHOW_S = 3.0
ROUNDS = 3
RATIO_TARGET = 3.0
COMMAND_BYTES = len(b"#12D-450T50\r")


def measure() -> list[Row]:
    """Return the share of the line that is filled, the lateness that costs, and the answers."""
    rows = []
    for baud_bps in (115_200, 500_000):
        rows += _in_virtual_time(baud_bps)
    for baud_bps in (115_200, 500_000):
        rows.append(_against_blocking(baud_bps))
    return rows


class _Count:
    """A `Tap` that counts what goes over the line while the show is on."""

    def __init__(self) -> None:
        self.is_on = False
        self.command_bytes = self.query_bytes = self.queries = 0
        self.reply_bytes = self.replies = 0
        self._first_ns = self._last_ns = 0

    def note(self, event: Event) -> None:
        if isinstance(event, PhaseEntered):
            self.is_on = event.phase is Phase.SHOW

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        if self.is_on:
            self._first_ns, self._last_ns = self._first_ns or now_ns, now_ns
        for line in data.split(b"\r")[:-1] if self.is_on else ():
            if b"Q" in line:
                self.queries += 1
                self.query_bytes += len(line) + 1
            else:
                self.command_bytes += len(line) + 1

    def received(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        if self.is_on:
            self.replies += data.count(b"\r")
            self.reply_bytes += len(data)

    def turned(self, now_ns: int) -> None: ...

    def requested(self, request: object, now_ns: int) -> None: ...

    def noted(self, bus: str, state: str, now_ns: int, reason: str = "") -> None: ...

    def happened(self, event: Event, now_ns: int) -> None: ...

    @property
    def lasted_s(self) -> float:
        return s_from_ns(self._last_ns - self._first_ns)

    def limit_hz(self, baud_bps: int, over_s: float) -> float:
        """Return how many answers a second both lines could carry beside the commands."""
        bytes_hz = baud_bps / LINE_BITS_PER_BYTE
        asked_hz = (bytes_hz - self.command_bytes / over_s) * self.queries / self.query_bytes
        return min(asked_hz, bytes_hz * self.replies / self.reply_bytes)


def _program(robot: Robot, duration_s: float) -> Program:
    return api.compile(api.plan(lively_show(robot, duration_s, seed=3), robot), robot)


def _in_virtual_time(baud_bps: int) -> list[Row]:
    robot, count = robot_of(SERVOS, baud_bps=baud_bps), _Count()
    observer = Observer(on_event=count.note, make_tap=lambda _: count)
    result = perform(_program(robot, SHOW_S), robot, is_virtual=True, observer=observer, pace=None)
    got_hz = count.replies / count.lasted_s
    limit_hz = count.limit_hz(baud_bps, count.lasted_s)
    late_us = result.report.timing.late_max_us
    command_us = line_time_ns(COMMAND_BYTES, baud_bps) // 1000
    what = f"{SERVOS} servos at {baud_bps} bps, virtual time"
    return [
        Row(
            what=what,
            ours=f"{got_hz:.0f} answers/s",
            reference=f"{limit_hz:.0f}/s, both lines never idle",
            ratio=got_hz / limit_hz,
            target=f">= {FILL_TARGET:.0%}",
            is_met=got_hz >= FILL_TARGET * limit_hz,
        ),
        Row(
            what="  latest command meanwhile",
            ours=f"{late_us} us",
            reference=f"{command_us} us, one command's line time",
            ratio=late_us / command_us,
            target="<= 1",
            is_met=late_us <= command_us,
        ),
    ]


def _against_blocking(baud_bps: int) -> Row:
    """Compare with a client that asks and waits, in turns on the same pseudo-terminal."""
    robot = robot_of(SERVOS, baud_bps=baud_bps)
    program = _program(robot, PTY_SHOW_S)
    ours, theirs = [], []
    with robot_behind_pty(robot) as (real, _):
        for _ in range(ROUNDS):
            count = _Count()
            observer = Observer(on_event=count.note, make_tap=lambda _, count=count: count)
            perform(program, real, observer=observer, pace=None)
            ours.append(count.replies / count.lasted_s)
            theirs.append(_blocking_hz(program, real))
    ours_hz, theirs_hz = sorted(ours)[ROUNDS // 2], sorted(theirs)[ROUNDS // 2]
    ratio = ours_hz / theirs_hz
    full_hz = baud_bps / LINE_BITS_PER_BYTE / len(b"*12QD-123\r")
    # Where even a line that never idles is not so much quicker, the line is all there is.
    target = min(RATIO_TARGET, FILL_TARGET * full_hz / theirs_hz)
    return Row(
        what=f"{SERVOS} servos at {baud_bps} bps behind a pseudo-terminal, commanded",
        ours=f"{ours_hz:.0f} answers/s",
        reference=f"{theirs_hz:.0f}/s, asking and waiting (line: {full_hz:.0f}/s)",
        ratio=ratio,
        target=f">= {target:.3g} x",
        is_met=ratio >= target,
    )


def _blocking_hz(program: Program, robot: Robot) -> float:
    """Send the program's commands when due, and ask one servo after the other in between."""
    [bus] = robot.buses.values()
    moves, index, answers = program.moves, 0, 0
    with serial.Serial(bus.port, bus.baud_bps, timeout=0.05) as port:
        started_s = time.monotonic()
        while (now_s := time.monotonic() - started_s) < program.duration_s:
            while index < len(moves) and moves[index].due_us <= 1e6 * now_s:
                port.write(moves[index].data)
                index += 1
            port.write(b"#%dQD\r" % (1 + answers % SERVOS))
            answers += port.read_until(b"\r").endswith(b"\r")
    return answers / program.duration_s
