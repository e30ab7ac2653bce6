"""The table of servo models, and the drives, lines and ranges that a model or a board refuses."""

from __future__ import annotations

import pytest

from lss_motion.errors import InputError
from lss_motion.protocol.constants import Family
from lss_motion.robot.load import load_robot
from lss_motion.robot.servo_models import BAUD_FIRMWARE_MIN, FAMILIES, SERVO_MODELS


def test_every_model_has_the_wire_unit_of_its_family() -> None:
    assert {model.wire_per_deg for model in SERVO_MODELS.values()} == {10, 100}
    for name, model in SERVO_MODELS.items():
        assert model.name == name
        assert model.wire_per_deg == FAMILIES[model.family].wire_per_deg
        family = {"LSS-P": Family.LSS_PRO, "LSS-2": Family.IO2}.get(name[:5], Family.LSS)
        assert model.family is family


def test_no_load_speeds_are_those_of_the_datasheets() -> None:
    speeds = {name: model.speed_max_deg_s for name, model in SERVO_MODELS.items()}
    assert (speeds["LSS-ST1"], speeds["LSS-HS1"], speeds["LSS-HT1"]) == (360.0, 600.0, 360.0)


def test_the_fast_baud_rates_came_with_firmware_369() -> None:
    late = {baud_bps for baud_bps, firmware in BAUD_FIRMWARE_MIN.items() if firmware == 369}
    assert late == {750000, 921600}
    assert len(BAUD_FIRMWARE_MIN) == 11


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


def test_the_default_drive_depends_on_the_model(tmp_path):
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
    ("joint", "reason"),
    [
        ("bus: old, drive: streamed", "cannot be streamed: that needs firmware 368 or later"),
        ("id: 112, model: LSS-P-S1, range_deg: [-180,180]", "#112D-18000T9999 has more than"),
        ("model: LSS-2IO, range_deg: [-95,0]", "would go to -95 deg"),
    ],
)
def test_joints_that_model_or_bus_do_not_allow_are_refused(tmp_path, joint, reason):
    written = FILE.replace("id: 1, bus: main, %s", "%s")
    fields = {"id": "1", "bus": "main"} | dict(part.split(": ", 1) for part in joint.split(", "))
    path = tmp_path / "robot.yaml"
    line = ", ".join(f"{key}: {value}" for key, value in fields.items())
    path.write_text(written % (115200, line), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_robot(path)
    assert reason in str(caught.value)
    assert str(caught.value).startswith(f"{path}:5:")


def test_a_bus_that_is_too_fast_for_its_board_is_refused(tmp_path):
    with pytest.raises(InputError, match="750000 bps is too fast for the LSS-2IO on bus 'main'"):
        load(tmp_path, baud_bps=750000)
