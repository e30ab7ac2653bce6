"""`<robot>.learnt.yaml`: what is kept of a robot, and what a damaged file says."""

from __future__ import annotations

import jsonschema
import pytest
import yaml
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.robot.learnt import (
    FIRST_LINE,
    Learnt,
    learnt_schema,
    load_learnt,
    save_learnt,
    settings_hash,
)
from lss_motion.robot.load import load_robot
from lss_motion.robot.model import learnt_path

ROBOT = """
robot: pair
buses: {main: {port: /dev/ttyUSB0}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan:  {id: 1}
  "no": {id: 2, direction: -1}
"""


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return load_robot(tmp_path / "robot.yaml")


def learnt_of(robot):
    pan, other = robot.joints.values()
    learnt = Learnt(robot="pair").updated(
        pan,
        careful_run="2026-11-23",
        direction_ok=True,
        scale_ok=True,
        lag_s=0.02134567,
        speed_ratio=0.98,
    )
    return learnt.updated(other, completed_run="2026-11-24")


def test_what_is_saved_is_loaded_and_any_yaml_reader_understands_it(robot, tmp_path):
    learnt = learnt_of(robot)
    path = save_learnt(learnt, robot)
    assert path == learnt_path(robot.path) == tmp_path / "robot.learnt.yaml"
    loaded = load_learnt(robot)
    assert loaded.of(robot.joints["pan"]).lag_s == 0.02135
    assert loaded.of(robot.joints["no"]).known() == learnt.of(robot.joints["no"]).known()
    text = path.read_text()
    assert text.startswith(FIRST_LINE + "\n")
    read = yaml.load(text, Loader=yaml.BaseLoader)
    assert list(read["joints"]) == ["pan", "no"]
    plain = yaml.safe_load(text)
    assert list(plain["joints"]) == ["pan", "no"]
    for entry in plain["joints"].values():
        for key in ("careful_run", "completed_run"):
            if key in entry:
                entry[key] = str(entry[key])
    jsonschema.validate(plain, learnt_schema())


def test_without_a_file_nothing_is_known(robot):
    assert not load_learnt(robot).has_completed(robot.joints.values())
    assert load_learnt(robot).joints == {}


@pytest.mark.parametrize(
    "change",
    [
        {"servo_id": 7},
        {"direction": -1},
        {"zero_deg": 3.0},
        {"position_max_deg": 91.0},
        {"speed_max_deg_s": 181.0},
        {"accel_max_deg_s2": 610.0},
        {"stored": {"G": -1.0}},
        {"settings": {"AS": -2}},
    ],
)
def test_what_was_learnt_of_other_settings_does_not_count(robot, change):
    pan = robot.joints["pan"]
    learnt = learnt_of(robot).updated(pan, completed_run="2026-11-24")
    assert learnt.has_completed(robot.joints.values())
    changed = replace(pan, **change)
    assert settings_hash(changed) != settings_hash(pan)
    assert not learnt.has_completed([changed])
    assert learnt.of(changed).lag_s is None
    assert learnt.updated(changed, completed_run="2026-11-25").of(changed).lag_s is None


def test_thresholds_of_faults_do_not_count_as_a_change(robot):
    pan = robot.joints["pan"]
    assert settings_hash(replace(pan, following_deg=20.0, silent_s=2.0)) == settings_hash(pan)


def test_every_mistake_of_a_damaged_file_is_named_with_its_line(robot):
    path = learnt_path(robot.path)
    path.write_text(
        f"{FIRST_LINE}\nrobot: pair\njoints:\n  pan:\n    settings: xyz\n    lag_s: fast\n"
        "    careful_run: tomorrow\n    speed: 3\n"
    )
    with pytest.raises(InputError) as caught:
        load_learnt(robot)
    lines = str(caught.value).splitlines()
    assert [line.partition("yaml:")[2].partition(":")[0] for line in lines] == list("5678")
    for line, text in zip(lines, ["hash", "number", "a day", "unknown key"], strict=True):
        assert text in line


@pytest.mark.parametrize("data", [b"", b"\0\1", b"joints: [", b"- 1\n", b"\xff\xfe"])
def test_a_file_that_is_none_is_an_ordinary_message(robot, data):
    learnt_path(robot.path).write_bytes(data)
    with pytest.raises(InputError, match=r"robot\.learnt\.yaml"):
        load_learnt(robot)


def test_a_file_of_another_kind_is_never_replaced(robot):
    path = learnt_path(robot.path)
    path.write_text("my: notes\n")
    with pytest.raises(InputError, match="no file of learnt values"):
        save_learnt(learnt_of(robot), robot)
    assert path.read_text() == "my: notes\n"


def test_joints_that_the_robot_no_longer_has_are_left_out(robot):
    gone = replace(robot.joints["pan"], name="gone")
    save_learnt(learnt_of(robot).updated(gone, lag_s=0.1), robot)
    assert list(load_learnt(robot).joints) == ["pan", "no"]
