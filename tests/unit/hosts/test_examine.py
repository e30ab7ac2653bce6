"""A whole stage is examined before the doors open."""

import json
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("zenoh", reason="needs the extra `network`")

from lss_motion.cli.main import main
from lss_motion.stage.hosts.examine import rows_of
from lss_motion.stage.hosts.messages import FigureFinding, FigureStatus, Findings, hash_of
from lss_motion.stage.hosts.remote_figures import RemoteFigure
from tests.network import free_port
from tests.programs import ProgramBeside, command

ROOT = Path(__file__).parents[3]
STAGE = """\
stage: hall
figures:
  left: {{robot: {robot}, address: "127.0.0.1:{port}"}}
  right: {{robot: {robot}}}
  middle: {{robot: {robot}}}
conductor: left
shows: {{wave: {{left: {wave}}}}}
"""


@pytest.fixture
def stage(tmp_path):
    port = free_port()
    path = tmp_path / "hall.yaml"
    robot = ROOT / "sequences" / "robots" / "desk_arm.yaml"
    path.write_text(STAGE.format(robot=robot, wave=ROOT / "sequences" / "wave.yaml", port=port))
    return path


@pytest.mark.slow
def test_doctor_asks_every_figure(stage, capsys, monkeypatch):
    monkeypatch.setattr("lss_motion.stage.hosts.examine.WAIT_S", 15.0)
    words = command("serve", stage, "--figure", "right")
    with ProgramBeside(words, stdin=subprocess.PIPE) as other:
        code = main(["doctor", "--stage", str(stage), "--json"])
        other.stdin.write(b"q\n")
        other.stdin.flush()
        other.ended()
    rows = json.loads(capsys.readouterr().out)["rows"]
    found = {(row["figure"], row["subject"]): row["level"] for row in rows}
    assert code == 4  # Nothing answers for `middle`.
    assert found["middle", "network"] == "bad"
    for name in ("left", "right"):
        assert {found[name, what] for what in ("network", "version", "robot file")} == {"ok"}
        assert (name, "disk") in found
        assert (name, "robot") in found
    assert "examines this computer" in other.said


def seat(**changes):
    plain = {
        "figure": "right",
        "instance": "0" * 16,
        "version": "1",
        "state": "idle",
        "epoch": 1,
        "run": 0,
        "robot": hash_of(b"a"),
        "bound_ns": 200_000,
        "round_trip_ns": 400_000,
    }
    return RemoteFigure("right", status=FigureStatus(**{**plain, **changes}))


@pytest.mark.parametrize(
    ("changes", "subject", "level"),
    [
        ({"version": "2"}, "version", "bad"),
        ({"robot": hash_of(b"b")}, "robot file", "bad"),
        ({"bound_ns": 4_000_000}, "clock", "hint"),
        ({"bound_ns": 12_000_000}, "clock", "bad"),
        ({"bound_ns": None}, "clock", "bad"),
    ],
)
def test_what_differs_is_named(changes, subject, level):
    findings = Findings(
        figure="right", number=1, findings=(FigureFinding(level="BAD", subject="robot", text="x"),)
    )
    rows = {
        row.subject: row.level for row in rows_of(seat(**changes), findings, "1", hash_of(b"a"))
    }
    assert rows[subject] == level
    assert rows["robot"] == "bad"


def test_a_stage_with_figures_is_served_figure_by_figure(stage, capsys):
    assert main(["serve", str(stage)]) == 2
    assert "one of left, right, middle" in capsys.readouterr().err
    assert main(["serve", str(stage), "--figure", "nobody"]) == 2
    assert "there are left, right, middle" in capsys.readouterr().err
