"""`lss-motion send` in all its forms, on simulated servos."""

from __future__ import annotations

import threading
from contextlib import contextmanager

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_UNREACHABLE
from lss_motion.protocol.constants import Family
from lss_motion.robot.model import ServoModel
from lss_motion.sim.bus import SimBus
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics, ServoSpec
from lss_motion.sim.pty import serve_buses

pytestmark = pytest.mark.realtime

ROBOT = """
robot: two
buses:
  main: {port: "sim://", baud_bps: 115200, firmware: 370}
joints:
  arm:  {id: 5, range_deg: [-90, 90], model: LSS-ST1, speed_max_deg_s: 90, accel_max_deg_s2: 300}
  hand: {id: 6, range_deg: [-90, 90], model: LSS-P-S1, speed_max_deg_s: 90, accel_max_deg_s2: 300}
"""


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return path


@pytest.fixture
def send(capsys):
    def run(*words):
        code = main(["send", *map(str, words)])
        out, errors = capsys.readouterr()
        return code, out.rstrip("\n"), errors

    return run


@contextmanager
def served(link, *specs, faults=()):
    bus = SimBus(
        specs,
        baud_bps=115200,
        firmware=370,
        physics=Physics(noise_deg=0.0),
        faults=faults,
    )
    bus.record()
    stop, ready = threading.Event(), threading.Event()
    thread = threading.Thread(
        target=serve_buses,
        args=({"main": bus}, link),
        kwargs={"announce": lambda _: ready.set(), "should_stop": stop.is_set},
    )
    thread.start()
    try:
        assert ready.wait(5.0)
        yield bus
    finally:
        stop.set()
        thread.join(5.0)


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (["QMS"], "*5QMSLSS-ST1   LSS-ST1"),
        (["qg"], "*5QG1   1"),
        (["QAA"], "*5QAA100   1000 deg/s²"),
        (["QSD"], "*5QSD3600   360 deg/s"),
        (["QSD", "1"], "*5QSD3600   360 deg/s"),
        (["QB"], "*5QB115200   115200 bps"),
        (["Q"], "*5Q1   limp"),
        (["Q", "1"], "*5Q0   none"),
        (["QLED"], "*5QLED7   white"),
        (["QFD"], "*5QFDDIS   no value"),
        (["QDT"], "*5QDT   no value"),
        (["QF", "3"], "*5QF370.0.0   370.0.0"),
        (["QID"], "*5QID5   5"),
    ],
)
def test_a_question_is_answered_with_its_unit(send, robot, words, shown):
    assert send("--robot", robot, "--id", 5, *words) == (EXIT_FINISHED, shown, "")


def test_the_family_comes_from_the_joint(send, robot):
    code, out, _ = send("--robot", robot, "--id", 6, "QAR")
    assert (code, out) == (EXIT_FINISHED, "*6QAR1800   180 deg")
    code, _, errors = send("--robot", robot, "--id", 6, "QFPC")
    assert code == EXIT_INPUT
    assert "'QFPC' is no LSS-PRO keyword" in errors


def test_values_are_in_units_and_reach_the_servo_in_its_own(send, tmp_path):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=MODELS["LSS"])) as bus:
        assert send("--port", link, "--id", 5, "D", 45, "T", 300) == (EXIT_FINISHED, "", "")
        assert send("--port", link, "--id", 5, "sd", 90) == (EXIT_FINISHED, "", "")
        assert send("--port", link, "--id", 5, "--raw", "LED3") == (EXIT_FINISHED, "", "")
        code, out, _ = send("--port", link, "--id", 5, "QLED")
        heard = [line for _, line in bus.heard]
    assert heard == [b"#5D450T300\r", b"#5SD900\r", b"#5LED3\r", b"#5QLED\r"]
    assert (code, out) == (EXIT_FINISHED, "*5QLED3   blue")


def test_a_board_obeys_and_answers(send, tmp_path):
    link = tmp_path / "port"
    asked = ("--port", link, "--family", "LSS-2IO")
    seen = Fault(kind=FaultKind.INPUT, servo_id=203, raw=426)
    with served(link, ServoSpec(servo_id=209, model=MODELS["LSS-2IO"]), faults=[seen]):
        assert send(*asked, "--id", 209, "D", 45) == (EXIT_FINISHED, "", "")
        assert send(*asked, "--id", 209, "QD")[:2] == (EXIT_FINISHED, "*209QD450   45 deg")
        assert send(*asked, "--id", 203, "QA")[:2] == (EXIT_FINISHED, "*203QA426   426")
        assert send(*asked, "--id", 203, "QA", 1)[:2] == (EXIT_FINISHED, "*203QA50   50 mm")
        code, out, errors = send(*asked, "--id", 254, "QMS")
    assert (code, out) == (EXIT_UNREACHABLE, "")
    assert "no reply to QMS from servo 254" in errors


MODELS = {
    "LSS": ServoModel(name="LSS-ST1", family=Family.LSS, speed_max_deg_s=360.0, wire_per_deg=10),
    "LSS-2IO": ServoModel(
        name="LSS-2IO", family=Family.IO2, speed_max_deg_s=400.0, wire_per_deg=10
    ),
}


def test_a_servo_that_is_not_there_ends_with_its_exit_code(send, robot):
    code, out, errors = send("--robot", robot, "--id", 77, "QD")
    assert (code, out) == (EXIT_UNREACHABLE, "")
    assert "no reply to QD from servo 77 on sim:// at 115200 bps" in errors


def test_a_port_that_does_not_exist_is_named(send):
    code, _, errors = send("--port", "/dev/no-such-port", "--id", 5, "QD")
    assert code == EXIT_UNREACHABLE
    assert "cannot open port /dev/no-such-port: there is no such device" in errors


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["QDD"], "'QDD' is no LSS keyword; did you mean QD"),
        (["D", "fast"], "'fast' is not a number"),
        (["D", "90", "T"], "then by pairs of modifier and value"),
        (["LED", "9"], "LED 9: allowed are 0 to 7"),
        (["D", "90", "X", "1"], "allowed modifiers are T, SD, CH, CL"),
        (["D"], "D needs a value"),
        (["--raw", "D9#6L"], "is not one command"),
        (["--raw", "D9;"], "is not one command"),
    ],
)
def test_what_no_servo_would_understand_is_refused_with_what_is_allowed(send, robot, words, said):
    code, out, errors = send("--robot", robot, "--id", 5, *words)
    assert (code, out) == (EXIT_INPUT, "")
    assert said in errors


def test_newer_commands_are_refused_for_older_firmware(send, robot):
    code, _, errors = send("--robot", robot, "--id", 5, "--firmware", 367, "QFPC")
    assert code == EXIT_INPUT
    assert "QFPC needs firmware 368 or newer, not 367" in errors


@pytest.mark.parametrize("port", [[], ["--port", "sim://"]])
def test_without_a_port_or_a_robot_nothing_is_sent(send, port):
    code, _, errors = send(*port, "--id", 5, "QD")
    assert code == EXIT_INPUT
    assert "give --port, or --robot with the servos that are simulated" in errors


def test_negative_values_are_values(send, tmp_path):
    link = tmp_path / "port"
    with served(link, ServoSpec(servo_id=5, model=MODELS["LSS"])) as bus:
        assert send("--port", link, "--id", 5, "D", "-12.3")[0] == EXIT_FINISHED
        send("--port", link, "--id", 5, "QG")
        assert bus.heard[0][1] == b"#5D-123\r"
