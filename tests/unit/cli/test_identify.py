"""`lss-motion identify` on simulated servos that are not what the robot file assumes."""

from __future__ import annotations

from functools import partial

import pytest
from msgspec.structs import replace

from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.maintenance.api import measurable
from lss_motion.playing import api
from lss_motion.playing.run import perform
from lss_motion.protocol.constants import Family
from lss_motion.robot.load import load_robot
from lss_motion.sim import bus
from lss_motion.sim.physics import Physics

ROBOT = """
robot: odd
defaults:
  {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  # the one that lags
  pan: {id: 1}  # mine
poses:
  home: {pan: 0}
"""
SWAY = """
sequence: sway
robot: robot.yaml
keyframes:
  - {at_s: 0, pose: home}
  - {at_s: 0.8, deg: {pan: 40}}
  - {at_s: 1.3, deg: {pan: 15}}
  - {at_s: 2.2, deg: {pan: -30}}
  - {at_s: 3.0, pose: home}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "sway.yaml").write_text(SWAY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rms_deg(robot_file, *, has_feedback):
    robot = load_robot(robot_file)
    trajectory = api.plan(api.load_sequence("sway.yaml"), robot)
    program = api.compile(trajectory, robot)
    result = perform(
        program, robot, is_virtual=True, trajectory=trajectory, has_feedback=has_feedback
    )
    assert result.report.outcome == "finished"
    return result.report.joints["pan"].horn_error_rms_deg


@pytest.mark.slow
@pytest.mark.parametrize(
    ("physics", "difference", "better_ratio"),
    [
        (Physics(lag_s=0.03, t_law="exact"), "t_law is exact, not cruise", 5.0),
        (Physics(ramp_ratio=0.6), "where 600 is set", 2.0),
        (Physics(lag_s=0.045, retarget="from_rest"), "retarget is from_rest, not keep_speed", 1.5),
    ],
)
def test_a_show_follows_many_times_better_with_what_was_identified(
    folder, monkeypatch, capsys, physics, difference, better_ratio
):
    odd = partial(bus.bus_from_robot, physics=physics)
    monkeypatch.setattr(bus, "bus_from_robot", odd)
    asked = ["identify", "--robot", "robot.yaml", "pan", "--virtual", "-o", "found.yaml"]
    assert main(asked) == 0
    said = capsys.readouterr().out
    assert "simulated: these values tell nothing about a real robot" in said
    assert difference in said
    assert (folder / "robot.yaml").read_text() == ROBOT
    found = (folder / "found.yaml").read_text()
    assert "# the one that lags" in found
    assert "}  # mine" in found
    for has_feedback in (False, True):
        before_deg = rms_deg("robot.yaml", has_feedback=has_feedback)
        after_deg = rms_deg("found.yaml", has_feedback=has_feedback)
        assert before_deg > better_ratio * after_deg


def test_the_experiment_is_practised_on_a_servo_that_is_not_as_assumed(folder, capsys):
    words = ["identify", "--robot", "robot.yaml", "pan", "--virtual", "--no-write"]
    assert main([*words, "--sim", "t_law=exact,droop=3deg"]) == 0
    said = capsys.readouterr().out
    assert "t_law is exact, not cruise" in said
    assert "its load pulls it by up to 3.0 deg" in said


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["pann"], 2, "unknown joint 'pann'; did you mean 'pan'?"),
        (["pan", "--span-deg", "2"], 2, "too little to measure"),
        (["pan", "-o", "robot.yaml"], 2, "choose another name"),
        (["pan", "-o", "nowhere/found.yaml"], 2, "folder does not exist"),
        (["pan", "--port", "/dev/does-not-exist"], 2, "add --yes"),
        (["pan", "--port", "/dev/does-not-exist", "--yes"], 4, "no such device"),
        (["pan", "--port", "/dev/x", "--virtual", "--yes"], 2, "--virtual needs the simulated"),
        (["pan", "--port", "/dev/x", "--sim", "lag=+9ms", "--yes"], 2, "--sim needs the simulated"),
        (["pan", "--sim", "lagg=+9ms"], 2, "'lagg' is no key here"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_moves(folder, capsys, words, code, text):
    options = [] if "--port" in words else ["--virtual"]
    assert main(["identify", "--robot", "robot.yaml", *words, *options]) == code
    errors = capsys.readouterr().err
    assert text in errors
    assert "Traceback" not in errors


def test_an_rc_servo_has_nothing_to_measure(folder):
    robot = load_robot("robot.yaml")
    model = replace(robot.joints["pan"].model, name="LSS-2IO", family=Family.IO2)
    rc = replace(robot, joints={"eye": replace(robot.joints["pan"], name="eye", model=model)})
    with pytest.raises(InputError, match="reports no position"):
        measurable(rc, "eye")
