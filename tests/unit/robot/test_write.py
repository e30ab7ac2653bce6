"""Measured values, written into robot files as people write them."""

from __future__ import annotations

import stat

import pytest

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.robot.write import write_response

VALUES = {"lag_s": 0.0312, "loop_s": 0.004, "retarget": "from_rest", "t_law": "exact"}
ROBOT = """\
# my robot
robot: pair
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints:
  # it squeaks
  pan:  {id: 1}   # oil it
  tilt: {id: 2, response: {lag_s: 0.05}}
poses:
  home: {pan: 0}  # straight
"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path / "robot.yaml"


def test_the_response_is_written_and_every_other_line_stays(path):
    write_response(path, "pan", VALUES, ["today"])
    robot = load_robot(path)
    response = robot.joints["pan"].response
    assert {key: getattr(response, key) for key in VALUES} == VALUES
    assert robot.joints["tilt"].response.lag_s == 0.05
    lines = path.read_text().splitlines()
    assert "  # pan identified today" in lines
    assert [line for line in ROBOT.splitlines() if line not in lines] == [
        "  pan:  {id: 1}   # oil it"
    ]
    assert any(
        line.startswith("  pan:  {id: 1, ") and line.endswith("}   # oil it") for line in lines
    )


def test_writing_again_leaves_one_comment_and_the_newest_values(path):
    write_response(path, "tilt", VALUES, ["first", "and more"])
    write_response(path, "tilt", {"lag_s": 0.01}, ["second"])
    text = path.read_text()
    assert text.count("# tilt identified") == 1
    response = load_robot(path).joints["tilt"].response
    assert (response.lag_s, response.loop_s) == (0.01, 0.004)


def test_a_copy_leaves_the_file_alone_and_a_mode_is_kept(path):
    path.chmod(0o640)
    copy = path.with_name("copy.yaml")
    write_response(path, "pan", VALUES, [], output=copy)
    assert path.read_text() == ROBOT
    assert load_robot(copy).joints["pan"].response.lag_s == 0.0312
    assert stat.S_IMODE(copy.stat().st_mode) == 0o640


def test_a_link_stays_a_link(path):
    link = path.with_name("link.yaml")
    link.symlink_to(path)
    write_response(link, "pan", VALUES, [])
    assert link.is_symlink()
    assert load_robot(path).joints["pan"].response.lag_s == 0.0312


def test_a_byte_order_mark_and_windows_lines_are_kept(path):
    path.write_bytes(b"\xef\xbb\xbf" + ROBOT.replace("\n", "\r\n").encode())
    write_response(path, "pan", VALUES, ["today"])
    data = path.read_bytes()
    assert data.startswith(b"\xef\xbb\xbf# my robot\r\n")
    assert data.count(b"\n") == data.count(b"\r\n") == ROBOT.count("\n") + 1


def test_values_that_would_not_load_are_not_written(path):
    with pytest.raises(InputError):
        write_response(path, "pan", {"lag_s": 7.0}, [])
    assert path.read_text() == ROBOT
    assert [one.name for one in path.parent.iterdir()] == ["robot.yaml"]


def test_a_missing_folder_is_an_input_error(path, tmp_path):
    missing = tmp_path / "nowhere" / "copy.yaml"
    with pytest.raises(InputError, match="cannot be written"):
        write_response(path, "pan", VALUES, [], output=missing)
