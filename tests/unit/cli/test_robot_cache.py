"""Limits left to the servos, from the command line: asked, cached, and played again from a log."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from lss_motion.cli import main as lss_motion
from lss_motion.cli import play as lss_play

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def show(tmp_path):
    """Return a sequence whose robot leaves its limits to the servos."""
    robot = (ROOT / "sequences/robots/desk_arm.yaml").read_text()
    for key in ("speed_max_deg_s: 180", "accel_max_deg_s2: 600"):
        assert key in robot
        robot = robot.replace(key, key.split(":")[0] + ": servo")
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots/desk_arm.yaml").write_text(robot)
    return Path(shutil.copy(ROOT / "sequences/fastest.yaml", tmp_path))


def test_offline_nothing_is_planned_without_them(show, capsys):
    assert lss_motion.main(["check", str(show)]) == 2
    assert lss_play.main([str(show), "--dry-run"]) == 2
    assert capsys.readouterr().err.count("--robot-cache FILE") == 2


def test_a_show_asks_its_servos_and_a_log_of_it_plays_again_without_them(show, tmp_path, capsys):
    log = tmp_path / "show.log"
    assert lss_play.main([str(show), "--virtual", "--quiet", "--log", str(log)]) == 0
    played = next(line for line in log.read_text("ascii").splitlines() if "# played: " in line)
    limits = json.loads(played.partition("# played: ")[2])["limits"]
    assert limits["elbow"] == {"speed_max_deg_s": 360.0, "accel_max_deg_s2": 1000.0}
    assert lss_motion.main(["replay", "--again", str(log)]) == 0
    assert "outputs compared, 0 differ" in capsys.readouterr().out


def test_a_backup_takes_their_place(show, tmp_path, capsys):
    backup, robot = tmp_path / "backup.yaml", show.parent / "robots/desk_arm.yaml"
    assert lss_motion.main(["configure", str(robot), "--backup", str(backup)]) == 0
    backup.write_text(backup.read_text().replace("SD: 3600 ", "SD: 600 "))
    table = tmp_path / "plan.csv"
    options = ["--robot-cache", str(backup), "--csv", str(table)]
    assert lss_motion.main(["plan", str(show), *options]) == 0
    assert lss_play.main([str(show), "--dry-run", "--robot-cache", str(backup)]) == 0
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    speeds = np.diff(rows[:, 1:], axis=0) / np.diff(rows[:, :1], axis=0)
    assert 59.0 < np.abs(speeds).max() < 60.5
    capsys.readouterr()
