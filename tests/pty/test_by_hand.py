"""`record`, `jog` and `calibrate` with keys on a real terminal, servos behind another one."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import threading
from contextlib import contextmanager

import numpy as np
import pytest

from lss_motion.robot.load import load_robot
from lss_motion.sequence.load import load_sequence
from lss_motion.sim.build import bus_from_robot
from lss_motion.sim.hand import Hand
from lss_motion.sim.pty import serve_buses

pytestmark = pytest.mark.realtime

ROBOT = """\
robot: pair   # two joints
joints:
  # the head
  pan:  {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
  tilt: {id: 2, model: LSS-ST1, range_deg: [-40, 60], speed_max_deg_s: 180, accel_max_deg_s2: 600}
poses:
  home: {pan: 0, tilt: 0}   # straight ahead
"""
SAID_MAX_CHARS = 100_000
"""About half a minute of frames: whoever waits longer waits in vain."""
SWAY_S = np.arange(0.0, 60.0, 0.05)
SWAY = Hand(SWAY_S, {"pan": 30.0 * np.sin(SWAY_S), "tilt": 10.0 + 10.0 * np.sin(2.0 * SWAY_S)})


@contextmanager
def simulated(folder, hand=None):
    """Serve the robot behind a pseudo-terminal from a thread; yields the bus and `unplug`."""
    (folder / "robot.yaml").write_text(ROBOT)
    bus = bus_from_robot(load_robot(folder / "robot.yaml"), "main", seed=1, hand=hand)
    bus.record()
    stop, ready = threading.Event(), threading.Event()
    thread = threading.Thread(
        target=serve_buses,
        args=({"main": bus}, folder / "port"),
        kwargs={"announce": lambda _: ready.set(), "should_stop": stop.is_set},
    )
    thread.start()

    def unplug():
        stop.set()
        thread.join(5.0)
        assert not thread.is_alive()

    try:
        assert ready.wait(5.0)
        yield bus, unplug
    finally:
        unplug()


def _own_the_terminal():
    """Make standard input the terminal that Ctrl-C comes from."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class Person:
    """Runs a command with a terminal of its own, presses its keys and reads what it says."""

    def __init__(self, folder, *command):
        self._own_fd, child_fd = pty.openpty()
        words = [str(word) for word in command]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "lss_motion.cli.main", *words, "--robot", folder / "robot.yaml",
             "--port", folder / "port"],
            stdin=child_fd, stdout=child_fd, stderr=child_fd, cwd=folder, start_new_session=True,
            preexec_fn=_own_the_terminal,  # noqa: PLW1509  (it only makes one system call)
        )  # fmt: skip
        os.close(child_fd)
        self.said = ""

    def wait_for(self, pattern):
        """Read on until it says what matches; what was said before does not count again."""
        start = len(self.said)
        while not re.search(pattern, self.said[start:]):
            is_more = self._read(20.0) and len(self.said) < start + SAID_MAX_CHARS
            assert is_more, f"it never said {pattern!r}: {self.said[-2000:]}"

    def press(self, keys):
        os.write(self._own_fd, keys.encode())

    def end(self):
        """Return the exit code; the output to its end is in `said`."""
        while self._read(20.0):
            pass
        return self.process.wait(20.0)

    def close(self):
        self.process.kill()
        self.process.wait(20.0)
        os.close(self._own_fd)

    def _read(self, timeout_s):
        if not select.select([self._own_fd], [], [], timeout_s)[0]:
            return False
        try:
            data = os.read(self._own_fd, 65536)
        except OSError:  # Linux: the other end is closed.
            return False
        self.said += data.decode()
        return bool(data)


@contextmanager
def person(folder, *command):
    someone = Person(folder, *command)
    try:
        yield someone
    finally:
        someone.close()


def heard(bus):
    return [line.rstrip(b"\r") for _, line in bus.heard]


def test_poses_and_a_stretch_that_a_hand_shows_become_a_sequence(tmp_path):
    out = tmp_path / "shown.yaml"
    with simulated(tmp_path, SWAY) as (bus, _), person(tmp_path, "record", "-o", out) as someone:
        someone.wait_for("press l")
        assert not any(line.endswith(b"L") for line in heard(bus))  # Nothing falls unasked.
        someone.press("l")
        someone.wait_for("let go")
        someone.press("p")
        someone.wait_for("pose 1")
        someone.press("r")
        someone.wait_for(r"RECORDING  [1-9]")
        someone.press("r")
        someone.wait_for("recorded")
        someone.press("pu")
        someone.wait_for("forgotten")
        someone.press("q")
        code = someone.end()
        assert code == 0, someone.said
        assert "Traceback" not in someone.said
        lines = heard(bus)
    assert {b"#1L", b"#2L", b"#1H", b"#2H"} <= set(lines)
    assert lines[-1] == b"#254H"
    sequence = load_sequence(out, load_robot(tmp_path / "robot.yaml"))
    assert [k.label for k in sequence.keyframes if k.label] == ["pose 1"]
    recorded = [k for k in sequence.keyframes if not k.label]
    assert 1.0 <= recorded[-1].at_s - recorded[1].at_s < 6.0


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_leaves_servos_that_hold_and_a_file_of_what_was_shown(tmp_path, number, code):
    out = tmp_path / "shown.yaml"
    with simulated(tmp_path, SWAY) as (bus, _), person(tmp_path, "record", "-o", out) as someone:
        someone.wait_for("press l")
        someone.press("lr")
        someone.wait_for(r"RECORDING  (0\.[2-9]|[1-9])")
        if number == signal.SIGINT:
            someone.press("\x03")  # As the terminal makes it of Ctrl-C.
        else:
            someone.process.send_signal(number)
        assert someone.end() == code
        assert heard(bus)[-1] == b"#254H"
        assert b"#1SD3600" in heard(bus)[-14:]
    assert load_sequence(out, load_robot(tmp_path / "robot.yaml")).keyframes
    assert "Traceback" not in someone.said


def test_a_port_that_is_lost_while_recording_loses_nothing_that_was_shown(tmp_path):
    out = tmp_path / "shown.yaml"
    with simulated(tmp_path, SWAY) as (_, unplug), person(tmp_path, "record", "-o", out) as someone:
        someone.wait_for("press l")
        someone.press("lr")
        someone.wait_for(r"RECORDING  (0\.[2-9]|[1-9])")
        unplug()
        assert someone.end() == 4
    assert "lost port" in someone.said
    assert "Traceback" not in someone.said
    assert load_sequence(out, load_robot(tmp_path / "robot.yaml")).keyframes
