"""The command `stage-keys`."""

from pathlib import Path

import pytest

pytest.importorskip("cryptography", reason="needs the extra `network`")

from lss_motion.cli.main import main

ROBOT = Path(__file__).parents[3] / "sequences" / "robots" / "desk_arm.yaml"
STAGE = """\
stage: hall
figures:
  left: {{robot: {robot}, address: "192.168.1.20:7447"}}
  right: {{robot: {robot}}}
conductor: left
shows: {{wave: {{left: {wave}, right: {wave}}}}}
network: {{keys: keys}}
"""


@pytest.fixture
def stage(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text(STAGE.format(robot=ROBOT, wave=ROBOT.parents[1] / "wave.yaml"))
    return path


def test_keys_are_written_where_the_stage_looks_for_them(stage, capsys):
    assert main(["stage-keys", str(stage)]) == 0
    assert (stage.parent / "keys" / "right.pem").exists()
    out = capsys.readouterr().out
    assert "ca.key" in out
    assert "the computer of right needs ca.pem, right.pem, right.key" in out
    before = (stage.parent / "keys" / "right.key").read_bytes()
    assert main(["stage-keys", str(stage)]) == 0
    assert "for every figure already" in capsys.readouterr().out
    assert (stage.parent / "keys" / "right.key").read_bytes() == before


def test_a_stage_on_one_computer_needs_none(stage, capsys):
    stage.write_text(
        f"stage: hall\nrobot: {ROBOT}\nshows: {{wave: {ROBOT.parents[1]}/wave.yaml}}\n"
    )
    assert main(["stage-keys", str(stage)]) == 2
    assert "needs no keys" in capsys.readouterr().err
