"""What an LSS-2IO, an old firmware or a model does not allow is refused where it is written."""

from __future__ import annotations

import pytest

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot

FILE = """\
robot: x
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
buses: {main: {baud_bps: %d}, old: {firmware: 367}}
joints:
  a: {id: 1, bus: main, %s}
  lid: {id: 209, bus: main, model: LSS-2IO}
"""


def load(tmp_path, joint="drive: streamed", baud_bps=500000):
    path = tmp_path / "robot.yaml"
    path.write_text(FILE % (baud_bps, joint), encoding="utf-8")
    return load_robot(path)


def test_every_model_has_its_own_drive_unless_told_otherwise(tmp_path):
    robot = load(tmp_path)
    assert {name: joint.drive for name, joint in robot.joints.items()} == {
        "a": "streamed",
        "lid": "stepped",
    }
    assert load(tmp_path, "direction: -1").joints["a"].drive == "timed"


def test_ramps_bound_timed_joints_only(tmp_path):
    brisk = "drive: streamed, accel_max_deg_s2: 2345, filter_count: 6"
    joint = load(tmp_path, brisk).joints["a"]
    assert (joint.accel_max_deg_s2, joint.filter_count) == (2345.0, 6)
    with pytest.raises(InputError, match="a joint with `drive: streamed` needs none"):
        load(tmp_path, "accel_max_deg_s2: 2345")
    assert load(tmp_path, "drive: auto, accel_max_deg_s2: 455").joints["a"].accel_max_deg_s2 == 450


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        ("bus: old, drive: streamed", "cannot be streamed: that needs firmware 368 or later"),
        (
            "id: 112, model: LSS-P-S1, range_deg: [-180,180]",
            "#112D-18000T9999 has more than",
        ),
        ("model: LSS-2IO, range_deg: [-95,0]", "would go to -95 deg"),
    ],
)
def test_what_the_bus_cannot_bear_is_refused(tmp_path, joint, said):
    written = FILE.replace("id: 1, bus: main, %s", "%s")
    fields = {"id": "1", "bus": "main"} | dict(part.split(": ", 1) for part in joint.split(", "))
    path = tmp_path / "robot.yaml"
    line = ", ".join(f"{key}: {value}" for key, value in fields.items())
    path.write_text(written % (115200, line), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_robot(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{path}:5:")


def test_a_bus_with_a_board_is_no_faster_than_the_board(tmp_path):
    with pytest.raises(InputError, match="750000 bps is too fast for the LSS-2IO on bus 'main'"):
        load(tmp_path, baud_bps=750000)
