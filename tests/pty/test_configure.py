"""`lss-motion configure` on a pseudo-terminal, in real time, as on the evening before a show."""

from __future__ import annotations

import pytest

from lss_motion.errors import EXIT_FINISHED, EXIT_UNREACHABLE
from lss_motion.sim.faults import Fault, FaultKind

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

ROBOT = """
robot: pair
buses: {main: {port: port}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints:
  pan:  {id: 1, stored: {O: 2.5, FD: 10}}
  tilt: {id: 2, stored: {LED: 3}}
"""


def test_a_servo_that_restarts_meanwhile_and_one_that_is_missing(on_terminal, servo, lss_motion):
    from pathlib import Path

    reset = Fault(kind=FaultKind.RESET, servo_id=1, at_s=0.5)
    with on_terminal(servo(1), servo(2), faults=[reset]) as bus:
        Path("robot.yaml").write_text(ROBOT)
        code, out, errors = lss_motion("configure", "robot.yaml", "--yes")
        stored = {known.servo_id: known.settings.eeprom for known in bus._servos}
    assert (code, errors) == (EXIT_FINISHED, "")
    assert "written and read back: 3 settings" in out
    assert (stored[1]["O"], stored[1]["FD"], stored[2]["LED"]) == (25, 100, 3)
    with on_terminal(servo(1)) as bus:
        code, _, errors = lss_motion("configure", "robot.yaml", "--yes")
        assert not any(b"#1C" in line for _, line in bus.lines)
    assert code == EXIT_UNREACHABLE
    assert "no servo replies at id 2" in errors


def test_a_servo_of_the_bag_gets_its_id_and_goes_to_the_rate_of_the_others(
    on_terminal, servo, lss_motion
):
    with on_terminal(servo(0, baud_bps=250000), servo(3)) as bus:
        asked = ("configure", "--port", "port", "--baud", 250000, "--yes")
        code, out, errors = lss_motion(*asked, "--id", 0, "--new-id", 7)
        assert (code, errors) == (EXIT_FINISHED, "")
        assert "now has id 7" in out
        code, out, errors = lss_motion(*asked, "--id", 7, "--new-baud", 115200)
        assert (code, errors) == (EXIT_FINISHED, "")
        assert {known.servo_id: known.baud_bps for known in bus._servos} == {7: 115200, 3: 115200}
        assert lss_motion("send", "--port", "port", "--id", 7, "QID")[1] == "*7QID7   7\n"
