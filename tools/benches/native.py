"""Small programs in C, compiled on the spot, that judge what Python cannot judge about itself.

A loop that only sends at deadlines is what this machine can do (`DEADLINES_C`). What leaves a port
is noted at its far end by a process that does nothing else (`tapped`): a simulated robot is busy
answering, and would note it late.

A virtual machine is taken off its processors for milliseconds at a time, which no program in it can
see but by the clock. `away` runs a loop on every processor at the highest real-time priority, which
wakes twice a millisecond: when it wakes late, nothing else ran on that processor either.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.system.real_time import PRIORITY
from lss_motion.units import line_time_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from benches.behind_pty import Heard
    from lss_motion.robot.model import Robot

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
"""Writes the lines that it reads to the port `words[1]`, each when it is due, at a priority."""

TAP_C: Final = r"""
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>
static void make_raw(int port) {
    struct termios settings;
    if (tcgetattr(port, &settings)) exit(1);
    cfmakeraw(&settings);
    cfsetspeed(&settings, B115200);
    tcsetattr(port, TCSANOW, &settings);
}
int main(int count, char **words) {
    if (count != 3) return 1;
    int near = posix_openpt(O_RDWR | O_NOCTTY), far = open(words[1], O_RDWR | O_NOCTTY);
    if (near < 0 || far < 0 || grantpt(near) || unlockpt(near)) return 1;
    int kept_open = open(ptsname(near), O_RDWR | O_NOCTTY);
    make_raw(kept_open);
    make_raw(far);
    struct sched_param priority = {atoi(words[2])};
    sched_setscheduler(0, SCHED_FIFO, &priority);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    setvbuf(stdout, NULL, _IOLBF, 4096);
    printf("%s\n", ptsname(near));
    struct pollfd ends[2] = {{near, POLLIN, 0}, {far, POLLIN, 0}};
    unsigned char data[1024];
    while (poll(ends, 2, -1) >= 0) {
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        for (int end = 0; end < 2; end++) {
            if (!ends[end].revents) continue;
            ssize_t size = read(ends[end].fd, data, sizeof data);
            if (size <= 0 || write(ends[1 - end].fd, data, size) != size) return 1;
            if (end) continue;
            printf("%lld ", now.tv_sec * 1000000000LL + now.tv_nsec);
            for (ssize_t i = 0; i < size; i++) printf("%02x", data[i]);
            printf("\n");
        }
    }
    return 1;
}
"""
"""Joins a new port, whose name it prints, and the port `words[1]`, at a priority. Then it prints
when it had something for that one, and what."""

WATCH_C: Final = r"""
#define _GNU_SOURCE
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
static long long clock_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}
int main(int count, char **words) {
    const long long step_ns = 500000;
    if (count != 2) return 1;
    cpu_set_t own;
    CPU_ZERO(&own);
    CPU_SET(atoi(words[1]), &own);
    struct sched_param priority = {sched_get_priority_max(SCHED_FIFO)};
    if (sched_setaffinity(0, sizeof own, &own)) return 1;
    if (sched_setscheduler(0, SCHED_FIFO, &priority)) return 1;
    mlockall(MCL_CURRENT | MCL_FUTURE);
    setvbuf(stdout, NULL, _IOLBF, 4096);
    for (;;) {
        long long due_ns = clock_ns() + step_ns;
        struct timespec due = {due_ns / 1000000000, due_ns % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        long long now_ns = clock_ns();
        if (now_ns - due_ns > step_ns / 2) printf("%lld %lld\n", due_ns, now_ns);
    }
}
"""
"""Prints from when to when nothing ran on the processor `words[1]`, until it is ended."""


def compiled(source: str, folder: Path, name: str) -> Path | None:
    """Return the program that a source in C makes; None where there is no compiler for it."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        return None
    text, target = folder / f"{name}.c", folder / name
    text.write_text(source)
    subprocess.run([compiler, "-O2", "-o", target, text], check=True)
    return target


class Away:
    """When a processor of this machine was away, so far. Empty where the system hides it."""

    def __init__(self, files: list[Path]) -> None:
        self._files = files

    @property
    def is_known(self) -> bool:
        return bool(self._files)

    def within_ns(self, from_ns: np.ndarray, until_ns: np.ndarray) -> np.ndarray:
        """Return for how much of each interval one processor or another was away."""
        lines = [line.split() for file in self._files for line in file.read_text().splitlines()]
        edges = sorted(edge for a, b in lines for edge in ((int(a), 1), (int(b), -1)))
        at_ns, depths = np.array(edges, dtype=np.int64).reshape(-1, 2).T
        if not len(at_ns):
            return np.zeros(len(from_ns))
        is_away = np.cumsum(depths)[:-1] > 0
        gone_ns = np.concatenate([[0], np.cumsum(np.diff(at_ns) * is_away)])
        start_ns = at_ns[0]
        gone = [np.interp(t - start_ns, at_ns - start_ns, gone_ns) for t in (from_ns, until_ns)]
        return np.maximum(0.0, gone[1] - gone[0])


@contextlib.contextmanager
def tapped(robot: Robot) -> Iterator[tuple[Robot, Callable[[], Heard]] | None]:
    """Yield the robot with another port, and what returns the lines that came through it so far.

    A line is received when its last byte has left a line of the bus's rate that begins at the port.
    None where there is no compiler.
    """
    [(name, bus)] = robot.buses.items()
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        program = compiled(TAP_C, Path(folder), "tap")
        if program is None:
            yield None
            return
        file = Path(folder) / "received.txt"
        words = [program, bus.port, str(PRIORITY + 20)]
        with file.open("w") as output:
            process = subprocess.Popen(words, stdout=output)
        stack.callback(_end, process)
        while not (text := file.read_text()).endswith("\n"):
            assert process.poll() is None, "the tap failed"
            time.sleep(0.01)
        port, taken = text.strip(), len(text)

        def received() -> Heard:
            nonlocal taken
            new = file.read_text()[taken:]
            taken += len(new)
            return _lines(new, bus.baud_bps)

        yield replace(robot, buses={name: replace(bus, port=port)}), received


def _lines(log: str, baud_bps: int) -> Heard:
    """Return when each line of a tap's log had come over a wire of `baud_bps`."""
    lines: Heard = []
    free_ns, line = 0, b""
    for entry in log.splitlines():
        instant, data = entry.split()
        for piece in bytes.fromhex(data).splitlines(keepends=True):
            free_ns = max(free_ns, int(instant)) + line_time_ns(len(piece), baud_bps)
            line += piece
            if line.endswith(b"\r"):
                lines.append((free_ns, line))
                line = b""
    return lines


@contextlib.contextmanager
def away(*, is_wanted: bool = True) -> Iterator[Away]:
    """Note meanwhile when each processor is away; needs leave for real-time priority."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        program = compiled(WATCH_C, Path(name), "watch") if is_wanted else None
        if program is None:
            yield Away([])
            return
        files: list[Path] = []
        for processor in os.sched_getaffinity(0):
            file = Path(name) / f"{processor}.txt"
            with file.open("w") as output:
                process = subprocess.Popen([program, str(processor)], stdout=output)
            stack.callback(_end, process)
            files.append(file)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.1)
                files.clear()  # It ended: no such priority is permitted.
                break
        yield Away(files)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGTERM)
    process.wait()
