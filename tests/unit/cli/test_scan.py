"""`lss-motion scan` of simulated servos that differ from the robot file."""

from __future__ import annotations

from functools import partial

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_UNREACHABLE
from lss_motion.playing import connection
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.system.clock import VirtualClock

ROBOT = """
robot: pair
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints: {pan: {id: 1}, tilt: {id: 2}}
"""


@pytest.fixture
def scanned(tmp_path, capsys, monkeypatch):
    """Return a function that scans two servos, of which servo 2 stores `settings`."""
    (tmp_path / "robot.yaml").write_text(ROBOT)
    connect = connection.connect

    def scan(settings):
        other = [Fault(kind=FaultKind.STORED, servo_id=2, settings=settings)] if settings else []
        made = partial(connect, clock=VirtualClock(), faults=other)
        monkeypatch.setattr(connection, "connect", made)
        code = main(["scan", "--robot", str(tmp_path / "robot.yaml"), "--baud", "115200"])
        return code, capsys.readouterr().out

    return scan


def test_servos_that_are_set_up_as_the_robot_file_says_have_no_problem(scanned):
    code, out = scanned({})
    assert code == EXIT_FINISHED
    assert "problem" not in out


@pytest.mark.parametrize(
    ("settings", "texts"),
    [
        ({"G": -1}, ["tilt", "gyre"]),
        ({"O": 50}, ["tilt", "origin", "5"]),
        ({"G": -1, "AR": 900}, ["gyre", "90"]),
    ],
)
def test_another_gyre_origin_or_range_is_a_problem_with_its_remedy(scanned, settings, texts):
    code, out = scanned(settings)
    assert code == EXIT_UNREACHABLE
    (problem,) = [line for line in out.splitlines() if line.startswith("problem:")]
    assert all(text in problem for text in texts), problem
    assert "configure" in problem or "stored" in problem, "what to do"
