"""Commands with a port, interrupted at any byte: real processes on a simulated robot.

A seed is a command, a signal (INT, INT twice, TERM, HUP, QUIT, KILL) and how many lines the servos
have received by then. Promised is: the command ends, with the exit code of its signal and without a
traceback; the last bytes leave servos that moved safe, and all horns come to rest, also after KILL;
no file is left but what was asked for; servos that were being configured are found again.
"""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from served_bus import served_bus

from campaign import Told
from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import bus_from_robot
from lss_motion.system.reactor import wait_for

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from lss_motion.sim.bus import SimBus

ROBOT: Final = """\
robot: pair
buses: {main: {port: port}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan: {id: 1, stored: {LED: 3}}
  tilt: {id: 2, stored: {LED: 4}}
"""
SHOW: Final = """\
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, deg: {pan: 20, tilt: 0}}
  - {at_s: 0.6, deg: {pan: -20, tilt: 20}}
  - {at_s: 1.2, deg: {pan: 0, tilt: 0}}
"""
STAGE: Final = """\
stage: nodding
robot: robot.yaml
shows: {nod: show.yaml}
idle: nod
"""
GAIT: Final = "trot.yaml"
SEQUENCES: Final = Path(__file__).resolve().parents[2] / "sequences"
BACKUP: Final = "backup.yaml"
COMMANDS: Final = (
    "play show.yaml --yes",
    "monitor robot.yaml",
    "scan port --baud 115200",
    "doctor robot.yaml",
    "jog robot.yaml",
    "record --robot robot.yaml -o shown.yaml --seconds 3",
    "calibrate robot.yaml",
    "identify --robot robot.yaml pan --span-deg 6 --yes",
    "field-test robot.yaml -o field.zip --joints pan",
    "send --robot robot.yaml --id 1 --yes D 30 T 800",
    "configure robot.yaml --yes",
    "configure --port port --id 1 --new-id 5 --yes",
    "configure robot.yaml --new-baud 57600 --yes",
    f"configure robot.yaml --restore {BACKUP} --yes",
    "serve stage.yaml",
    "studio show.yaml --no-browser",
    f"walk {GAIT} --port port --yes",
)
SIGNALS: Final = (
    (signal.SIGINT,),
    (signal.SIGINT, signal.SIGINT),
    (signal.SIGTERM,),
    (signal.SIGHUP,),
    (signal.SIGQUIT,),
    (signal.SIGKILL,),
)
AFTER_LINES: Final = (0, 1, 2, 4, 7, 12, 20, 35, 60, 120)
"""The interrupt comes when the servos have received so many lines; 0: as soon as the
program handles signals."""
SEEDS: Final = len(COMMANDS) * len(SIGNALS) * len(AFTER_LINES)
"""Each combination once."""
OUTPUTS: Final = {"field.zip", "shown.yaml", "robot.learnt.yaml", "log"}
"""What a command may leave, besides the files that it was given."""
IN_FRONT: Final = (
    "import os, sys; os.setsid(); os.close(os.open(os.ttyname(0), os.O_RDWR)); "
    "from lss_motion.cli.start import main; sys.exit(main())"
)
WAIT_S: Final = 60.0
"""A command that has not ended so long after its signal hangs."""
LOOK_S: Final = 0.002
QUIET_S: Final = 0.7
START_S: Final = 20.0
"""A command that has sent nothing by then waits for a key, or for a browser."""
KEY_S: Final = 3.0
"""The same of one that has sent nothing more."""
TWICE_S: Final = 0.1
REST_NS: Final = 12_000_000_000
"""Every move has ended by then: the longest T."""
MOVE: Final = re.compile(rb"#(\d+)(D|MD|WD|WR|RDM|RPM)-?\d")
SAFE: Final = re.compile(rb"#(254|\d+)[HL]\r")
RESTS_DEG: Final = 0.2


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options of this kind: there are none."""
    del parser


def play(seed: int, options: argparse.Namespace) -> Told:
    """Interrupt one command."""
    del options
    words = COMMANDS[seed % len(COMMANDS)]
    signals = SIGNALS[seed // len(COMMANDS) % len(SIGNALS)]
    after = AFTER_LINES[seed // (len(COMMANDS) * len(SIGNALS)) % len(AFTER_LINES)]
    names = " and ".join(one.name for one in signals)
    about = f"lss-motion {words}: {names} after {after} lines"
    with tempfile.TemporaryDirectory() as folder, _served(Path(folder), words) as bus:
        if BACKUP in words:
            _run(Path(folder), f"configure robot.yaml --backup {BACKUP} --yes").wait(WAIT_S)
        one = _Interrupted(Path(folder), words, bus, signals, after)
        broken = [*one.broken(), *_found_again(Path(folder), words)]
    broken += [] if _rests(bus) else ["a horn does not come to rest"]
    return Told(one.outcome, tuple(broken), (about, *one.screen.splitlines()[-12:]))


@contextmanager
def _served(folder: Path, words: str) -> Iterator[SimBus]:
    """Serve the servos behind the port `port` of a folder, from a thread: two, or those of legs."""
    (folder / "robot.yaml").write_text(ROBOT)
    (folder / "show.yaml").write_text(SHOW)
    (folder / "stage.yaml").write_text(STAGE)
    (folder / "robots").mkdir()
    shutil.copy(SEQUENCES / "robots" / "quadruped.yaml", folder / "robots")
    shutil.copy(SEQUENCES / "quadruped_trot.yaml", folder / GAIT)
    robot = load_robot(folder / ("robots/quadruped.yaml" if GAIT in words else "robot.yaml"))
    bus = bus_from_robot(robot, next(iter(robot.buses)), seed=1)
    bus.record()
    with served_bus(bus, folder / "port"):
        yield bus


def _run(folder: Path, words: str, fd: int | None = None) -> subprocess.Popen[bytes]:
    start = ["-c", IN_FRONT] if fd is not None else ["-m", "lss_motion.cli.start"]
    stream = subprocess.DEVNULL if fd is None else fd
    state = str(folder / "state")
    return subprocess.Popen(
        [sys.executable, *start, *words.split()],
        cwd=folder,
        stdin=stream,
        stdout=stream,
        stderr=stream,
        env={
            **os.environ,
            "LSS_MOTION_STATE_DIR": state,
            "LSS_MOTION_CACHE_DIR": state,
            "PYTHONPATH": str(Path(__file__).resolve().parents[2]),
        },
    )


class _Interrupted:
    """A command in a terminal of its own, from its start to its end."""

    def __init__(
        self, folder: Path, words: str, bus: SimBus, signals: tuple[signal.Signals, ...], after: int
    ) -> None:
        self._words, self._signals = words, signals
        self.screen = ""
        own_fd, their_fd = pty.openpty()
        given = {path.name for path in folder.iterdir()}
        assert bus.lines is not None
        first = len(bus.lines)
        process = _run(folder, words, their_fd)
        os.close(their_fd)
        reader = threading.Thread(target=self._read, args=(own_fd,))
        reader.start()
        while process.poll() is None and not _handles_signals(process.pid):
            wait_for((), LOOK_S)
        end_s, count = time.monotonic() + START_S, first
        while len(bus.lines) - first < after and process.poll() is None:
            if len(bus.lines) > count:
                end_s, count = time.monotonic() + KEY_S, len(bus.lines)
            if time.monotonic() > end_s:
                break
            wait_for((), LOOK_S)
        self.is_early = process.poll() is not None
        for number in signals:
            if process.poll() is None:
                process.send_signal(number)
                wait_for((), TWICE_S)
        try:
            self.code: int | None = process.wait(WAIT_S)
        except subprocess.TimeoutExpired:
            self.code = None
            process.kill()
            process.wait(WAIT_S)
        self._wait_for_rest(bus)
        reader.join(WAIT_S)
        os.close(own_fd)
        self._left = {path.name for path in folder.iterdir()} - given - OUTPUTS - {"state"}
        self._received = [line for _, line in bus.lines[first:]]

    def _wait_for_rest(self, bus: SimBus) -> None:
        """Wait until its helpers, which may outlive it, send nothing more."""
        assert bus.lines is not None
        end_s, count = time.monotonic() + WAIT_S, -1
        while count != len(bus.lines) and time.monotonic() < end_s:
            count = len(bus.lines)
            wait_for((), QUIET_S)

    def _read(self, fd: int) -> None:
        while select.select([fd], [], [], WAIT_S)[0]:
            try:
                data = os.read(fd, 65536)
            except OSError:  # The process has closed the terminal.
                return
            self.screen += data.decode("utf-8", "replace")

    @property
    def outcome(self) -> str:
        return "ended before" if self.is_early else f"exit code {self.code}"

    def broken(self) -> list[str]:
        """Return every promise that was broken, in words."""
        number = self._signals[0]
        is_killed = number is signal.SIGKILL
        wanted = {-number} if is_killed else {128 + number, -number}
        found = []
        if self.code is None:
            found.append(f"it did not end within {WAIT_S:g} s")
        elif not self.is_early and self.code not in wanted | {0}:
            found.append(f"the exit code is {self.code}, not {sorted(wanted)}")
        if "Traceback" in self.screen:
            found.append("it printed a traceback")
        moves = [at for at, line in enumerate(self._received) if MOVE.search(line)]
        ends_itself = is_killed or self._words.startswith("send")  # Its one move was asked for.
        if moves and not ends_itself and not self._is_safe_after(moves[-1]):
            found.append(f"no halt follows the last move: {self._received[-3:]}")
        if self._left:
            found.append(f"files are left: {sorted(self._left)}")
        return found

    def _is_safe_after(self, last: int) -> bool:
        return any(SAFE.search(line) for line in self._received[last + 1 :])


def _handles_signals(pid: int) -> bool:
    """Return whether a program is past the start of its interpreter, which ends it as it likes."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False
    caught = re.search(r"^SigCgt:\s*([0-9a-f]+)$", status, re.MULTILINE)
    return caught is not None and bool(int(caught[1], 16) >> (signal.SIGTERM - 1) & 1)


def _found_again(folder: Path, words: str) -> list[str]:
    """Return what is wrong with servos that were being configured: they must be found."""
    if not words.startswith("configure"):
        return []
    scan = _run(folder, "scan port")
    code = scan.wait(WAIT_S)
    return [] if code == 0 else [f"scan ends with exit code {code} afterwards"]


def _rests(bus: SimBus) -> bool:
    """Return whether the horns rest at the end of the time of every move."""
    assert bus.lines is not None
    until_ns = max((at_ns for at_ns, _ in bus.lines), default=0) + REST_NS
    bus.advance(until_ns)
    deg = bus.horn_deg(np.array([until_ns - REST_NS // 10, until_ns]))
    return bool(np.abs(deg[1] - deg[0]).max() < RESTS_DEG)
