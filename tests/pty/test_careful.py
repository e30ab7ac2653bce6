"""The careful run on a terminal: offered, run, kept, and offered no more."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from lss_motion.robot.learnt import load_learnt
from lss_motion.robot.load import load_robot
from lss_motion.robot.model import learnt_path
from tests.pty.test_play import (
    SWAY,
    at_a_keyboard,
    folder,  # noqa: F401  (a fixture)
    lines_heard,
    simulated,
    wait_for_question,
)

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

FEW_DEG = 5.5


def read_until(process, text):
    """Return what the process prints, up to `text`."""
    said = ""
    while not said.endswith(text):
        if not (char := process.stdout.read(1)):
            pytest.fail(f"it never printed {text!r}: {said}")
        said += char
    return said


def test_it_is_offered_runs_is_kept_and_is_offered_no_more(folder):  # noqa: F811
    robot_file = folder / "robot.yaml"
    with simulated(folder) as port:
        with at_a_keyboard(folder, port) as (process, keyboard):
            assert "Press c for a\ncareful run first" in wait_for_question(process)
            os.write(keyboard, b"c")
            said = read_until(process, "Begin? [y/N] ")
            assert all(line[2:3] == b"Q" for line in lines_heard(port)), "only queries so far"
            os.write(keyboard, b"y\n")
            said = wait_for_question(process)
            assert "pan: turned" in said
            assert "tilt: turned" in said
            assert "Press c" not in said
            careful_ns = port.bus.lines[-1][0]
            os.write(keyboard, b"y")
            said, _ = process.communicate(timeout=60)
            assert process.returncode == 0, said
        horns = port.bus.horn_deg(list(range(0, careful_ns, 5_000_000)))
        assert np.abs(horns).max() < FEW_DEG
        assert np.abs(np.diff(horns, axis=0)).max() / 0.005 < 31.0
        kept = load_learnt(load_robot(robot_file))
        for name in ("pan", "tilt"):
            assert kept.joints[name].scale_ok
            assert kept.joints[name].direction_ok
            assert kept.joints[name].completed_run
        with at_a_keyboard(folder, port) as (process, keyboard):
            assert "Press c" not in wait_for_question(process)
            os.write(keyboard, b"n")
            process.communicate(timeout=30)
        robot_file.write_text(robot_file.read_text().replace("[-40, 60]", "[-40, 61]"))
        with learnt_path(robot_file).open("a") as file:
            file.write("  wrist: 3\n")
        with at_a_keyboard(folder, port) as (process, keyboard):
            said = wait_for_question(process)
            assert "robot.learnt.yaml:" in said
            assert "Traceback" not in said
            assert "Press c" in said
            os.write(keyboard, b"n")
            process.communicate(timeout=30)


def test_yes_alone_does_not_add_it(folder):  # noqa: F811
    (folder / "sway.yaml").write_text(SWAY % 1)
    with simulated(folder) as port:
        command = [sys.executable, "-m", "lss_motion.cli.play", str(folder / "sway.yaml"), "--port"]
        done = subprocess.run(
            [*command, port.path, "--yes"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert "careful" not in done.stdout
    assert load_learnt(load_robot(folder / "robot.yaml")).joints["pan"].completed_run
