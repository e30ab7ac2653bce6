"""`lss-motion monitor` on a pseudo-terminal, without a screen: lines, a table on disk, beeps."""

from __future__ import annotations

import contextlib
import csv
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_INTERRUPTED, EXIT_UNREACHABLE
from lss_motion.sim.faults import Fault, FaultKind

pytestmark = pytest.mark.realtime

ROBOT = """
robot: three
buses: {main: {port: port}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints: {pan: {id: 1}, tilt: {id: 2}, gone: {id: 3}}
"""


def test_lines_a_table_and_beeps_for_a_hot_servo_and_a_missing_one(on_terminal, servo, lss_motion):
    hot = Fault(kind=FaultKind.HOT, servo_id=2, temperature_c=90.0)
    with on_terminal(servo(1, start_deg=12.0), servo(2), faults=[hot]) as bus:
        Path("robot.yaml").write_text(ROBOT)
        code, out, errors = lss_motion(
            "monitor", "robot.yaml", "--for", 1.5, "--every", 0.3, "--csv", "f.csv"
        )
        orders = [line for _, line in bus.heard if b"Q" not in line]
    assert code == EXIT_FINISHED
    assert "pan     12.0 deg" in out
    assert "ALARM  tilt: safe mode" in out
    assert "ALARM  tilt: 90 °C" in out
    assert "ALARM  gone does not answer" in out
    assert errors == "\a" * 3
    assert orders == []
    rows = list(csv.DictReader(Path("f.csv").read_text().splitlines()))
    assert {row["servo"] for row in rows} == {"pan", "tilt"}
    assert rows[-1]["status"] in {"limp", "safe mode"}
    assert float(next(row for row in rows if row["servo"] == "pan")["position_deg"]) == 12.0


def test_without_a_robot_file_everybody_who_answers_is_watched(on_terminal, servo, lss_motion):
    with on_terminal(servo(4), servo(209, "LSS-2IO")):
        code, out, _ = lss_motion("monitor", "--port", "port", "--for", 0.6, "--every", 0.2)
    assert code == EXIT_FINISHED
    assert "servo 4 " in out
    assert "servo 209" in out
    with on_terminal():
        code, _, errors = lss_motion("monitor", "--port", "port", "--for", 1)
    assert (code, "no servo with an id of its own" in errors) == (EXIT_UNREACHABLE, True)


def test_a_port_that_is_pulled_ends_it_with_its_reason(on_terminal, servo, lss_motion):
    pulled = Fault(kind=FaultKind.UNPLUGGED, at_s=3.0)
    with on_terminal(servo(1), faults=[pulled]):
        Path("robot.yaml").write_text(ROBOT)
        code, _, errors = lss_motion("monitor", "robot.yaml", "--for", 20)
    assert (code, "lost port port" in errors) == (EXIT_UNREACHABLE, True)


def test_on_a_terminal_there_is_a_table_and_ctrl_c_ends_it(on_terminal, servo):
    with on_terminal(servo(1, start_deg=12.0)):
        Path("robot.yaml").write_text(ROBOT)
        main_fd, terminal_fd = pty.openpty()
        command = [sys.executable, "-m", "lss_motion.cli.main", "monitor", "robot.yaml"]
        process = subprocess.Popen(
            command,
            stdout=terminal_fd,
            stderr=subprocess.PIPE,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
        )
        os.close(terminal_fd)
        shown = b""
        while b"12.0 deg" not in shown:
            shown += os.read(main_fd, 4096)
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(OSError):  # Linux ends a terminal so.
            while data := os.read(main_fd, 4096):
                shown += data
        os.close(main_fd)
        _, errors = process.communicate(timeout=10)
    assert process.returncode == EXIT_INTERRUPTED
    assert b"Ctrl-C ends" in shown
    assert b"Traceback" not in errors


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give a ROBOT file, or --port"),
        (("robot.yaml", "--csv", "no/such/f.csv"), "cannot write it"),
    ],
)
def test_what_cannot_be_meant_is_refused(lss_motion, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    Path("robot.yaml").write_text(ROBOT)
    code, _, errors = lss_motion("monitor", *words)
    assert (code, said in errors) == (EXIT_INPUT, True)
