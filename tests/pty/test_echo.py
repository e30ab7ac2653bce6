"""Commands on a port that returns what is sent to it, with servos behind it and without."""

from __future__ import annotations

import os
import re
import threading
import tty
from contextlib import contextmanager
from pathlib import Path
from select import select

import pytest

from lss_motion.sim.faults import Fault, FaultKind

ARM = """\
robot: arm
defaults: {model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {a: {id: 1, range_deg: [-90, 90]}}
"""
SHOW = "sequence: x\nrobot: arm.yaml\nkeyframes: [{at_s: 0, deg: {a: 0}}, {at_s: 1, deg: {a: 9}}]\n"


@contextmanager
def echoing(behind: str | None):
    """Make `./echo`, a port that returns what is sent, and passes it on to the port `behind`."""
    master, slave = os.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    Path("echo").symlink_to(os.ttyname(slave))
    back = None if behind is None else os.open(behind, os.O_RDWR | os.O_NOCTTY)
    if back is not None:
        tty.setraw(back)
    is_over = threading.Event()

    def carry() -> None:
        while not is_over.is_set():
            for fd in select([master] + ([] if back is None else [back]), [], [], 0.02)[0]:
                data = os.read(fd, 4096)
                os.write(master, data)
                if fd == master and back is not None:
                    os.write(back, data)

    thread = threading.Thread(target=carry)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join(5.0)
        for fd in (master, slave, *([] if back is None else [back])):
            os.close(fd)


@pytest.fixture
def files(on_terminal):
    Path("arm.yaml").write_text(ARM, encoding="utf-8")
    Path("x.yaml").write_text(SHOW, encoding="utf-8")


def test_a_port_that_only_echoes_is_named(files, lss_motion):
    with echoing(None):
        code, out, errors = lss_motion("scan", "echo", "--baud", "115200")
        assert code != 0
        assert "echo returns what is sent, and nothing else" in out + errors
        assert "several servos" not in out + errors
        code, out, errors = lss_motion("play", "x.yaml", "--port", "echo", "--yes")
        assert code != 0
        assert "echo returns what is sent, and nothing else" in out + errors


def test_a_show_plays_through_a_port_that_echoes(files, on_terminal, servo, lss_motion):
    with on_terminal(servo(1)) as bus, echoing("port"):
        code, out, errors = lss_motion("play", "x.yaml", "--port", "echo", "--yes")
        assert code == 0, out + errors
        # Before it plays, and in its report.
        assert (out + errors).count("returns what is sent") == 2
        assert "another program" not in out + errors
        assert any(line.startswith(b"#1D") for _, line in bus.lines)


def test_the_doctor_names_a_port_that_only_echoes_and_one_with_servos_behind_it(
    files, on_terminal, servo, lss_motion
):
    with echoing(None):
        code, out, errors = lss_motion("doctor", "arm.yaml", "--port", "echo")
        assert code == 4, out + errors
        assert re.search(
            r"^BAD +robot +port echo returns what is sent, and nothing else", out, re.MULTILINE
        )
    Path("echo").unlink()
    with on_terminal(servo(1)), echoing("port"):
        _, out, errors = lss_motion("doctor", "arm.yaml", "--port", "echo")
        assert "its adapter echoes. The echo is left out" in out, out + errors
        assert "1 servos answer as" in out


def test_the_simulated_bus_can_echo(files, on_terminal, servo, lss_motion):
    with on_terminal(servo(1), faults=[Fault(kind=FaultKind.ECHO)]) as bus:
        code, out, errors = lss_motion("play", "x.yaml", "--port", "port", "--yes")
        assert code == 0, out + errors
        assert "port returns what is sent: its adapter echoes" in out + errors
        assert any(line.startswith(b"#1D") for _, line in bus.lines)
