"""A pseudo-terminal that takes no bytes, as a stalled adapter does: no command waits for it."""

from __future__ import annotations

import contextlib
import os
import signal
import termios
import time
import tty
from pathlib import Path

import pytest

from lss_motion.errors import EXIT_INTERRUPTED, EXIT_UNREACHABLE
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.system.port import SerialPort
from tests.programs import ProgramBeside, terminal_command
from tests.swing import until

GAIT = Path(__file__).resolve().parents[2] / "sequences" / "quadruped_trot.yaml"
pytestmark = pytest.mark.realtime

ROBOT = """
robot: one
resume_s: 1.0
buses: {main: {port: port}}
defaults: {speed_max_deg_s: 90, accel_max_deg_s2: 600}
joints: {pan: {id: 1, model: LSS-ST1, range_deg: [-90, 90]}}
poses: {home: {pan: 0}}
"""
SHOW = """
sequence: sway
robot: robot.yaml
loop: forever
keyframes: [{at_s: 0, pose: home}, {at_s: 1, deg: {pan: 30}}, {at_s: 2, pose: home}]
"""


@pytest.fixture
def blocked_port(on_terminal, servo):
    """Return a context: a port with one servo that takes no bytes from `at_s` on."""

    @contextlib.contextmanager
    def serve(at_s=0.0, until_s=float("inf")):
        fault = Fault(kind=FaultKind.BLOCKED_PORT, at_s=at_s, until_s=until_s)
        with on_terminal(servo(1), faults=[fault]) as bus:
            Path("robot.yaml").write_text(ROBOT)
            Path("show.yaml").write_text(SHOW)
            if at_s == 0.0:
                wait_until_blocked()
            yield bus

    return serve


def wait_until_blocked():
    """Return when the system refuses a write to the port; an empty line does nothing at a servo."""
    port_fd = os.open("port", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while os.write(port_fd, b"\r"):
            time.sleep(0.01)
    os.close(port_fd)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "play show.yaml --yes",
        "play show.yaml --yes --no-feedback",
        "scan port",
        "monitor robot.yaml --for 5",
        "send --port port --id 1 QD",
        "send --port port --id 1 LED 1",
        "configure robot.yaml --backup saved.yaml",
        "jog robot.yaml",
        "record -o taken.csv --robot robot.yaml",
        "calibrate robot.yaml",
        "identify --robot robot.yaml --yes pan",
        f"walk {GAIT} --port port --yes",
    ],
)
def test_a_port_that_takes_no_bytes_ends_every_command_with_its_reason(blocked_port, words):
    with blocked_port(), ProgramBeside(terminal_command(*words.split()), keys=True) as process:
        code = process.ended()
    assert (code, "takes no bytes" in process.errors) == (EXIT_UNREACHABLE, True), process.errors
    assert "Traceback" not in process.errors


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_ctrl_c_ends_a_show_whose_port_takes_no_bytes(blocked_port, count):
    with blocked_port(4.0):
        command = terminal_command("play", "show.yaml", "--yes")
        with ProgramBeside(command, keys=True) as process:
            process.wait_for("lost_port|takes no bytes")
            for _ in range(count):
                process.send_signal(signal.SIGINT)
                time.sleep(0.05)
            assert process.ended() in (EXIT_UNREACHABLE, EXIT_INTERRUPTED)
    assert "Traceback" not in process.errors


def test_closing_a_port_waits_for_its_bytes_as_long_as_they_leave(blocked_port):
    with blocked_port(0.0, 1.2) as bus:
        until(lambda: time.monotonic_ns() >= bus.blocks_ns()[0][0] + 900_000_000)
        port = SerialPort("port", 115200)
        port.write(b"#254H\r")
        assert not port.has_sent_all()
        port.close()
        until(lambda: any(line != b"\r" for _, line in bus.lines))
    assert [line for _, line in bus.lines if line != b"\r"] == [b"#254H\r"]


def test_the_system_refuses_a_write_to_a_terminal_that_was_stopped():
    """What the simulator and these tests rest on."""
    host_fd, terminal_fd = os.openpty()
    tty.setraw(terminal_fd)
    os.set_blocking(terminal_fd, False)
    termios.tcflow(terminal_fd, termios.TCOOFF)
    with pytest.raises(BlockingIOError):
        os.write(terminal_fd, b"#1QD\r")
    os.close(terminal_fd)
    os.close(host_fd)
