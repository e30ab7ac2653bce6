"""The careful run on a terminal: offered, run, kept, and offered no more."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.robot.learnt import load_learnt
from lss_motion.robot.load import load_robot
from lss_motion.robot.model import learnt_path
from tests.pty.test_play import (
    QUESTION,
    at_a_keyboard,
    folder,  # noqa: F401  (a fixture)
    lines_heard,
    playing,
    simulated,
)

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

FEW_DEG = 5.5


def test_it_is_offered_runs_is_kept_and_is_offered_no_more(folder):  # noqa: F811
    robot_file = folder / "robot.yaml"
    with simulated(folder) as port:
        with at_a_keyboard(folder, port) as process:
            assert "Press c for a\ncareful run first" in process.wait_for(QUESTION)
            process.press("c")
            process.wait_for(r"Begin\? \[y/N\] ")
            assert all(line[2:3] == b"Q" for line in lines_heard(port)), "only queries so far"
            process.press("y\n")
            said = process.wait_for(QUESTION)
            assert "pan: turned" in said
            assert "tilt: turned" in said
            assert "Press c" not in said
            careful_ns = port.bus.lines[-1][0]
            process.press("y")
            assert process.ended() == 0, process.said
        horns = port.bus.horn_deg(list(range(0, careful_ns, 5_000_000)))
        assert np.abs(horns).max() < FEW_DEG
        assert np.abs(np.diff(horns, axis=0)).max() / 0.005 < 31.0
        kept = load_learnt(load_robot(robot_file))
        for name in ("pan", "tilt"):
            assert kept.joints[name].scale_ok
            assert kept.joints[name].direction_ok
            assert kept.joints[name].completed_run
        with at_a_keyboard(folder, port) as process:
            assert "Press c" not in process.wait_for(QUESTION)
            process.press("n")
            process.ended()
        robot_file.write_text(robot_file.read_text().replace("[-40, 60]", "[-40, 61]"))
        with learnt_path(robot_file).open("a") as file:
            file.write("  wrist: 3\n")
        with at_a_keyboard(folder, port) as process:
            said = process.wait_for(QUESTION)
            assert "robot.learnt.yaml:" in said
            assert "Traceback" not in said
            assert "Press c" in said
            process.press("n")
            process.ended()


def test_yes_alone_does_not_add_it(folder):  # noqa: F811
    with simulated(folder) as port, playing(folder, port) as process:
        assert process.ended() == 0, process.errors
    assert "careful" not in process.said
    assert load_learnt(load_robot(folder / "robot.yaml")).joints["pan"].completed_run
