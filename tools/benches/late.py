"""How late commands are where the servo hears them, over a pseudo-terminal, the display being on.

A loop in C sends the same bytes at the same instants to the same simulated robot, in turns with
the player: what it cannot do on this machine, nobody can.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from benches.behind_pty import busy_cores, robot_behind_pty
from benches.shows import lively_show, robot_of
from benches.table import Row
from lss_motion import api
from lss_motion.cli.display import Display
from lss_motion.runtime.real_time import PRIORITY, real_time
from lss_motion.units import NS_PER_US, line_time_ns, ns_from_s, s_from_us

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from benches.behind_pty import Heard
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Robot

SERVOS = 18
SHOW_S = 10.0
ROUNDS = 6
"""A minute of show, in turns with a minute of the loop."""
COMMAND_BYTES = len(b"#12D-450T50\r")
QUANTILES = (50.0, 99.0, 99.9, 100.0)
MOVE: Final = re.compile(rb"#(\d+)D-?\d+T")

DEADLINES_C: Final = r"""
#include <fcntl.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>
int main(int count, char **words) {
    int port = open(words[1], O_RDWR | O_NOCTTY);
    struct termios settings;
    if (count != 3 || port < 0 || tcgetattr(port, &settings)) return 1;
    cfmakeraw(&settings);
    tcsetattr(port, TCSANOW, &settings);
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
    struct sched_param priority = {atoi(words[2])};
    if (priority.sched_priority && sched_setscheduler(0, SCHED_FIFO, &priority)) return 1;
    long long due_ns;
    char line[64];
    while (scanf("%lld %63s", &due_ns, line) == 2) {
        struct timespec due = {due_ns / 1000000000, due_ns % 1000000000};
        strcat(line, "\r");
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL)) {}
        if (write(port, line, strlen(line)) < 0) return 1;
    }
    return 0;
}
"""


def measure(rounds: int = ROUNDS) -> list[Row]:
    """Return the lateness of the player and of the loop in C, idle and with all cores busy."""
    robot = robot_of(SERVOS)
    program = api.compile(api.plan(lively_show(robot, SHOW_S, seed=4), robot), robot)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        loop = _compiled(Path(folder))
        rows.append(_compared("idle", program, robot, loop, rounds))
        with busy_cores():
            rows.append(_compared("every core busy", program, robot, loop, rounds))
            with real_time() as refused:
                pass
            if any("priority" in text for text in refused):
                rows.append(Row(what="every core busy, --real-time", ours="not permitted here"))
                return rows
            what = "every core busy, --real-time"
            rows.append(_compared(what, program, robot, loop, rounds, is_real_time=True))
    return rows


def measure_short() -> list[Row]:
    """Return the same from one round, in which the worst of a thousand is about the worst."""
    return measure(1)


def _compared(
    what: str,
    program: Program,
    robot: Robot,
    loop: Path | None,
    rounds: int,
    *,
    is_real_time: bool = False,
) -> Row:
    ours: list[float] = []
    theirs: list[float] = []
    with robot_behind_pty(robot) as (real, heard):
        for _ in range(rounds):
            ours += _player_us(program, real, heard, is_real_time=is_real_time)
            if loop is not None:
                theirs += _loop_us(program, real, heard, loop, is_real_time=is_real_time)
    command_us = line_time_ns(COMMAND_BYTES, 115_200) / NS_PER_US
    what = f"{what}: late at the servo, p50, p99, p99.9, max of {len(ours)}"
    own = np.percentile(ours, QUANTILES)
    if loop is None:
        return Row(what=what, ours=_said(own), reference="no C compiler")
    bare = np.percentile(theirs, QUANTILES)
    return Row(
        what=what,
        ours=_said(own),
        reference=f"{_said(bare)} for a loop in C",
        ratio=float(own[2] - bare[2]) / command_us,
        target="p99.9 <= C + 1 command's line time",
        is_met=bool(own[2] <= bare[2] + command_us),
    )


def _said(quantiles_us: np.ndarray) -> str:
    return ", ".join(f"{value:.0f}" for value in quantiles_us) + " us"


def _player_us(
    program: Program, robot: Robot, heard: Callable[[], Heard], *, is_real_time: bool
) -> list[float]:
    heard()
    with _screen() as display:
        observer = api.Observer(on_turn=display.show)
        result = api.perform(program, robot, observer=observer, is_real_time=is_real_time)
    show = result.player.show
    assert show is not None
    dues_ns = []
    for move in program.moves:
        due_ns = show.clock.instant_ns(s_from_us(move.due_us))
        assert due_ns is not None
        dues_ns.append(due_ns)
    return _late_us(program, robot, dues_ns, heard())


def _loop_us(
    program: Program,
    robot: Robot,
    heard: Callable[[], Heard],
    loop: Path,
    *,
    is_real_time: bool,
) -> list[float]:
    heard()
    [bus] = robot.buses.values()
    start_ns = time.monotonic_ns() + ns_from_s(0.5)
    dues_ns = [start_ns + move.due_us * NS_PER_US for move in program.moves]
    plan = zip(dues_ns, program.moves, strict=True)
    text = "".join(f"{due_ns} {move.data.decode().strip()}\n" for due_ns, move in plan)
    priority = str(PRIORITY if is_real_time else 0)
    subprocess.run([loop, bus.port, priority], input=text, text=True, check=True)
    time.sleep(0.1)
    return _late_us(program, robot, dues_ns, heard())


def _late_us(program: Program, robot: Robot, dues_ns: list[int], heard: Heard) -> list[float]:
    """Return how late every move was heard."""
    [bus] = robot.buses.values()
    heard_ns: dict[int, list[int]] = {}
    expected_ns: dict[int, list[int]] = {}
    for instant_ns, line in heard:
        if (match := MOVE.match(line)) is not None:
            heard_ns.setdefault(int(match[1]), []).append(instant_ns)
    for due_ns, move in zip(dues_ns, program.moves, strict=True):
        line_ns = line_time_ns(len(move.data), bus.baud_bps)
        expected_ns.setdefault(move.servo_id, []).append(due_ns + line_ns)
    return [
        late_ns / NS_PER_US
        for servo_id, instants_ns in expected_ns.items()
        for late_ns in _in_order(np.array(instants_ns), np.array(heard_ns[servo_id]))
    ]


def _in_order(expected_ns: np.ndarray, heard_ns: np.ndarray) -> np.ndarray:
    """Return the lateness of one servo's moves, each taken for another line, in their order.

    There are more lines than moves: the approach, and what is said once more after a late move, for
    the sake of the speed limit. The lines are chosen that are nearest in all.
    """
    late_ns = heard_ns[:, None] - expected_ns
    best = np.full((len(heard_ns) + 1, len(expected_ns) + 1), np.inf)
    best[:, 0] = 0.0
    for line in range(len(heard_ns)):
        taken = best[line, :-1] + np.abs(late_ns[line])
        best[line + 1, 1:] = np.minimum(best[line, 1:], taken)
    lates_ns = np.empty(len(expected_ns))
    line, move = len(heard_ns), len(expected_ns)
    while move:
        line -= 1
        if best[line + 1, move] < best[line, move]:
            move -= 1
            lates_ns[move] = late_ns[line, move]
    return lates_ns


def _compiled(folder: Path) -> Path | None:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        return None
    source, target = folder / "deadlines.c", folder / "deadlines"
    source.write_text(DEADLINES_C)
    subprocess.run([compiler, "-O2", "-o", target, source], check=True)
    return target


@contextlib.contextmanager
def _screen() -> Iterator[Display]:
    """Show on a terminal that somebody reads, as a real one would."""
    master_fd, slave_fd = os.openpty()
    # In a process of its own, as a terminal program is.
    quiet = subprocess.DEVNULL
    reader = subprocess.Popen(["cat"], stdin=master_fd, stdout=quiet, stderr=quiet)
    before_fd = os.dup(2)
    os.dup2(slave_fd, 2)
    try:
        display = Display()
        yield display
        display.close()
    finally:
        os.dup2(before_fd, 2)
        for fd in (before_fd, slave_fd, master_fd):
            os.close(fd)
        reader.kill()
        reader.wait()
