"""`lss-motion identify` over a real terminal, as a user runs it, and what can be wrong there."""

from __future__ import annotations

import signal

import pytest

from lss_motion.robot.load import load_robot
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics
from tests.programs import ProgramBeside, command
from tests.swing import until

pytestmark = pytest.mark.realtime

ROBOT = """
robot: bench
buses: {main: {port: port}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 300, accel_max_deg_s2: 1000}
joints:
  pan: {id: 1}  # the free one
"""
RESTORED = {b"#1EM1", b"#1AA100", b"#1AD100", b"#1SD3600"}
ASKED = ("identify", "--robot", "robot.yaml", "pan", "--span-deg", "6")


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path / "robot.yaml"


def received(bus):
    return [line.rstrip(b"\r") for _, line in bus.lines]


@pytest.mark.slow
def test_a_servo_is_measured_and_its_file_says_so(on_terminal, servo, lss_motion, robot):
    physics = Physics(lag_s=0.045, t_law="exact")
    with on_terminal(servo(1), physics=physics) as bus:
        code, out, errors = lss_motion(*ASKED, "--yes")
        last = received(bus)[-5:]
    assert (code, errors) == (0, "")
    assert "pan: written to robot.yaml" in out
    assert last[-1] == b"#1H"
    assert set(last[:-1]) == RESTORED
    response = load_robot(robot).joints["pan"].response
    # A busy computer blurs the instants; how exact it is otherwise is judged in virtual time.
    assert 0.03 < response.lag_s < 0.07
    assert response.retarget == "keep_speed"
    assert response.t_law == "exact" or "t_law could not be decided" in out
    assert "}  # the free one" in robot.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("specs", "faults", "code", "text"),
    [
        ([{"servo_id": 2}], [], 4, "no answer from 1 of 1 servos: pan"),
        ([{"servo_id": 1, "model": "LSS-P-S1"}], [], 2, "servo 1 is an LSS-P-S1"),
        ([{"servo_id": 1, "start_deg": 95.0}], [], 2, "outside its range"),
        ([{"servo_id": 1}], [("hot", {"temperature_c": 95.0})], 5, "safe mode"),
        ([{"servo_id": 1}], [("stuck", {})], 5, "blocked"),
    ],
)
def test_what_is_wrong_with_a_servo_is_told_and_nothing_is_written(
    on_terminal, servo, lss_motion, robot, specs, faults, code, text
):
    befalls = [Fault(kind=FaultKind(kind), servo_id=1, **more) for kind, more in faults]
    with on_terminal(*(servo(**spec) for spec in specs), faults=befalls):
        result, _, errors = lss_motion(*ASKED, "--yes")
    assert result == code
    assert text in errors
    assert "Traceback" not in errors
    assert robot.read_text() == ROBOT


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_brakes_restores_and_holds(on_terminal, servo, robot, number, code):
    with on_terminal(servo(1)) as bus:
        with ProgramBeside(command(*ASKED, "--yes")) as process:
            until(lambda: sum(line.startswith(b"#1D") for line in received(bus)) >= 4)
            process.send_signal(number)
            assert process.ended() == code
        last = received(bus)[-5:]
    assert process.errors == "pan: stopped; nothing was measured\n"
    assert last[-1] == b"#1H"
    assert set(last[:-1]) == RESTORED
    assert robot.read_text() == ROBOT


@pytest.mark.slow
@pytest.mark.parametrize(("answer", "code"), [("n\n", 130), ("\n", 130)])
def test_nobody_agrees_and_nothing_moves(on_terminal, servo, robot, answer, code):
    with on_terminal(servo(1)) as bus:
        with ProgramBeside(command(*ASKED), keys=True) as process:
            process.press(answer)
            assert process.ended() == code
        assert all(b"Q" in line for line in received(bus))
    assert process.errors == ""
    assert "will move between -6.0 and 6.0 deg" in process.said
    assert "nothing was moved" in process.said
