"""`lss-motion monitor` on a pseudo-terminal, without a screen: lines, a table on disk, beeps."""

from __future__ import annotations

import csv
import os
import signal
from pathlib import Path

import pytest

from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_INTERRUPTED, EXIT_UNREACHABLE
from lss_motion.sim.faults import Fault, FaultKind
from tests.programs import ProgramBeside, command

pytestmark = pytest.mark.realtime

ROBOT = """
robot: three
buses: {main: {port: port}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints: {pan: {id: 1}, tilt: {id: 2}, gone: {id: 3}}
"""


def monitored(*words, until):
    """Run `monitor` until its output has these texts; then interrupt it.

    Returns the exit code, the output and the errors.
    """
    with ProgramBeside(command("monitor", *words)) as process:
        process.wait_for_all(*until)
        process.send_signal(signal.SIGINT)
        return process.ended(), process.said, process.errors


@pytest.mark.slow
def test_lines_a_table_and_beeps_for_a_hot_servo_and_a_missing_one(on_terminal, servo):
    hot = Fault(kind=FaultKind.HOT, servo_id=2, temperature_c=90.0)
    with on_terminal(servo(1, start_deg=12.0), servo(2), faults=[hot]) as bus:
        Path("robot.yaml").write_text(ROBOT)
        code, out, errors = monitored(
            *("robot.yaml", "--every", "0.3", "--csv", "f.csv"),
            until=(
                "pan     12.0 deg",
                "ALARM  tilt: safe mode",
                "°C, from 65 on it is too hot",
                "ALARM  gone does not answer",
            ),
        )
        orders = [line for _, line in bus.lines if b"Q" not in line]
    assert code == EXIT_INTERRUPTED
    assert errors == "\a" * out.count("ALARM  ")
    assert orders == []
    rows = list(csv.DictReader(Path("f.csv").read_text().splitlines()))
    assert {row["servo"] for row in rows} == {"pan", "tilt"}
    assert {row["status"] for row in rows if row["servo"] == "tilt"} <= {"limp", "safe mode", ""}
    pan_deg = {row["position_deg"] for row in rows if row["servo"] == "pan"} - {""}
    assert {float(angle) for angle in pan_deg} == {12.0}


def test_a_monitor_ends_after_the_seconds_given(on_terminal, servo, lss_motion):
    with on_terminal(servo(1)):
        Path("robot.yaml").write_text(ROBOT)
        code, _, _ = lss_motion("monitor", "robot.yaml", "--for", 0.1, "--every", 0.05)
    assert code == EXIT_FINISHED


@pytest.mark.slow
def test_without_a_robot_file_every_servo_that_answers_is_watched(on_terminal, servo, lss_motion):
    with on_terminal(servo(4), servo(209, "LSS-2IO")):
        code, _, _ = monitored("--port", "port", "--every", "0.2", until=("servo 4 ", "servo 209"))
    assert code == EXIT_INTERRUPTED
    with on_terminal():
        code, _, errors = lss_motion("monitor", "--port", "port", "--for", 1)
    assert (code, "no servo with an id of its own" in errors) == (EXIT_UNREACHABLE, True)


@pytest.mark.slow
def test_another_host_and_its_servos_are_named_in_an_alarm(on_terminal, servo):
    masters = [
        Fault(kind=FaultKind.SECOND_MASTER, text=f"#{number}QD", every_s=0.05, at_s=0.02 * number)
        for number in (1, 2)
    ]
    with on_terminal(servo(1), servo(2), faults=masters):
        Path("robot.yaml").write_text(ROBOT)
        code, out, _ = monitored("robot.yaml", until=("ALARM  bus main: servos 1, 2 sent",))
    assert code == EXIT_INTERRUPTED
    assert "another program or computer asks on this bus" in out


@pytest.mark.slow
def test_a_port_that_is_pulled_ends_it_with_its_reason(on_terminal, servo, lss_motion):
    pulled = Fault(kind=FaultKind.UNPLUGGED, at_s=3.0)
    with on_terminal(servo(1), faults=[pulled]):
        Path("robot.yaml").write_text(ROBOT)
        code, _, errors = lss_motion("monitor", "robot.yaml", "--for", 20)
    assert (code, "lost port port" in errors) == (EXIT_UNREACHABLE, True)


def test_on_a_terminal_there_is_a_table_and_ctrl_c_ends_it(on_terminal, servo):
    with on_terminal(servo(1, start_deg=12.0)):
        Path("robot.yaml").write_text(ROBOT)
        env = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
        words = command("monitor", "robot.yaml")
        with ProgramBeside(words, keys=True, screen=True, env=env) as process:
            process.wait_for("12.0 deg")
            process.send_signal(signal.SIGINT)
            assert process.ended() == EXIT_INTERRUPTED
    assert "Ctrl-C ends" in process.said
    assert "Traceback" not in process.said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "give a ROBOT file, or --port"),
        (("robot.yaml", "--csv", "no/such/f.csv"), "cannot be written"),
    ],
)
def test_what_cannot_be_meant_is_refused(lss_motion, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    Path("robot.yaml").write_text(ROBOT)
    code, _, errors = lss_motion("monitor", *words)
    assert (code, said in errors) == (EXIT_INPUT, True)
