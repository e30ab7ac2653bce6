"""`lss-play --careful` on the simulated bus, judged at the horns and by what a person reads."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lss_motion.cli import walk
from lss_motion.cli.careful import CAREFUL_RATE
from lss_motion.cli.main import main as lss_motion
from lss_motion.cli.play import main
from lss_motion.errors import InputError
from lss_motion.playing.log import HappenedLine, RequestedLine, read_log
from lss_motion.playing.player.events import Phase, PhaseEntered, PlayerRequest
from lss_motion.units import s_from_ns

ROBOT = """
robot: pair
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan:  {id: 1}
  tilt: {id: 2, range_deg: [-40, 60]}
"""
NOD = """
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, deg: {pan: 0, tilt: 0}}
  - {at_s: 0.6, deg: {pan: 20, tilt: 10}}
  - {at_s: 1.2, deg: {pan: 0, tilt: 0}}
"""


@pytest.fixture
def play(tmp_path, capsys):
    """Return what plays the show: exit code, output and errors."""
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "nod.yaml").write_text(NOD)

    def run(*options, robot=None, show=None, faults=None):
        if show is not None:
            (tmp_path / "nod.yaml").write_text(show)
        if robot is not None:
            (tmp_path / "robot.yaml").write_text(robot)
        if faults is not None:
            (tmp_path / "faults.yaml").write_text(f"faults: [{faults}]\n")
            options += ("--faults", str(tmp_path / "faults.yaml"))
        capsys.readouterr()
        code = main([str(tmp_path / "nod.yaml"), "--virtual", *map(str, options)])
        return code, *capsys.readouterr()

    return run


def test_every_joint_passes_and_the_show_after_it_has_half_the_speed(play, tmp_path):
    lasts_s = []
    for options in ((), ("--careful",)):
        truth, log, report = tmp_path / "t.csv", tmp_path / "a.log", tmp_path / "r.json"
        code, out, errors = play(*options, "--truth", truth, "--log", log, "--report", report)
        assert (code, errors) == (0, "")
        assert json.loads(report.read_text())["outcome"] == "finished"
        lines = read_log(log).lines
        entered = (one for one in lines if isinstance(one, HappenedLine))
        begins = next(one for one in entered if one.event == PhaseEntered(Phase.SHOW))
        lasts_s.append(s_from_ns(lines[-1].at_ns - begins.at_ns))
        pan_deg = np.loadtxt(truth, delimiter=",", skiprows=1)[:, 1]
        assert pan_deg.max() == pytest.approx(20.0, abs=1.0)
    assert 1.5 < lasts_s[1] / lasts_s[0] < 2.1
    for name in ("pan", "tilt"):
        assert f"  {name}: turned " in out
    assert f"plays at {CAREFUL_RATE:.0%} of its speed" in out
    assert not list(tmp_path.glob("*.learnt.yaml")), "simulated servos teach nothing"
    requests = [line.request for line in lines if isinstance(line, RequestedLine)]
    assert PlayerRequest("rate", (0.5,)) in requests
    assert lss_motion(["replay", "--again", str(log)]) == 0


@pytest.mark.parametrize(
    ("fault", "code", "text"),
    [
        ("{kind: wrong_scale, servo: 2, setting: D, scale_ratio: 10}", 5, "joint 'tilt'"),
        ("{kind: wrong_scale, servo: 1, setting: D, scale_ratio: 0.0001}", 4, "no two angles (QD)"),
        ("{kind: wrong_scale, servo: 2, setting: SD, scale_ratio: 1000}", 5, "speed limit (SD)"),
        ("{kind: wrong_scale, servo: 2, setting: AA, scale_ratio: 0.1}", 5, "acceleration (AA)"),
        ("{kind: stored, servo: 2, settings: {G: -1}}", 2, "gyre (G)"),
        ("{kind: stuck, servo: 2}", 5, "joint 'tilt'"),
    ],
)
def test_a_servo_that_deviates_is_named_and_nothing_is_played(play, fault, code, text):
    found, out, errors = play("--careful", faults=fault)
    assert found == code
    assert text in errors
    assert "Traceback" not in errors
    assert "playing" not in out


def test_what_cannot_be_tested_is_named_and_a_streamed_joint_is_tested_by_its_ramps(play):
    robot = (
        ROBOT
        + """\
  eye:  {id: 3, model: LSS-2IO}
  lid:  {id: 4, range_deg: [-0.9, 0.9]}
  jaw:  {id: 5, drive: streamed, accel_max_deg_s2: 3000}
"""
    )
    show = NOD.replace("tilt: 0}", "tilt: 0, eye: 0, lid: 0, jaw: 0}")
    code, out, _ = play("--careful", robot=robot, show=show)
    assert code == 0
    assert "eye: not tested, an RC servo" in out
    assert "lid: not tested, its range leaves no room" in out
    assert "eye: turned" not in out
    assert "jaw: turned" in out


def test_a_dry_run_tests_nothing(play):
    code, out, _ = play("--careful", "--dry-run")
    assert code == 0
    assert "turned" not in out


@pytest.mark.parametrize(("options", "ratio"), [([], 1.0), (["--careful"], CAREFUL_RATE)])
def test_a_walk_after_a_careful_run_begins_at_half_of_its_speed(monkeypatch, options, ratio):
    begun = []

    def performed(arguments, gait, robot, steered, print_line, asking):
        wishes, _ = steered
        wishes.steer(1.0, 0.0, 0.0)
        begun.append((wishes.twist().forward_mm_s / wishes.top.forward_mm_s, asking))
        raise InputError("enough")

    monkeypatch.setattr(walk, "_perform", performed)
    command = ["walk", "sequences/quadruped_trot.yaml", "--yes", "--quiet", *options]
    monkeypatch.setattr(walk, "careful_run", lambda *_, **__: 130)
    assert lss_motion(command) == (130 if options else 2)
    monkeypatch.setattr(walk, "careful_run", lambda *_, **__: 0)
    assert lss_motion(command) == 2
    assert begun[-1] == (ratio, (False, ""))
