"""What a browser is told of the servos of a bus that another host disturbs."""

from __future__ import annotations

import pytest

from lss_motion.maintenance.survey import found_on
from lss_motion.playing.api import load_robot
from lss_motion.playing.connection import connect
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.system.clock import VirtualClock


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("#254QD", "unreadable bytes come that this program did not ask for"),
        ("#2QD", "servo 2 sent"),
    ],
)
def test_another_host_is_a_problem_for_a_person(line, said):
    defaults = {"model": "LSS-ST1", "range_deg": [-90, 90]}
    limits = {"speed_max_deg_s": 90, "accel_max_deg_s2": 300}
    joints = {"pan": {"id": 1}, "tilt": {"id": 2}}
    robot = load_robot({"robot": "pair", "defaults": defaults | limits, "joints": joints})
    master = Fault(kind=FaultKind.SECOND_MASTER, text=line, every_s=0.3)
    for faults in ([], [master]):
        with connect(robot.buses, robot=robot, clock=VirtualClock(), faults=faults) as connection:
            servos, problems = found_on(connection, robot, "main", lambda _: None)
        assert [servo.joint for servo in servos] == ["pan", "tilt"]
        assert any(said in text for text in problems) is bool(faults)
