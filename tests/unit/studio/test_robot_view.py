"""A robot as the pages get it."""

from __future__ import annotations

import json

from lss_motion.robot.load import load_robot
from lss_motion.studio.robot_view import robot_view

ROBOT = """\
robot: test
joints:
  pan: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: servo, accel_max_deg_s2: 600}
poses: {up: {pan: 10}}
"""


def view(tmp_path, text):
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT + text, encoding="utf-8")
    return json.loads(json.dumps(robot_view(load_robot(path)), allow_nan=False))


def test_a_robot_is_json_with_its_figure(tmp_path):
    found = view(tmp_path, "figure: {post: {joint: pan, axis: z, along: z, length_mm: 10}}\n")
    assert found["joints"][0]["speed_max_deg_s"] is None, "the servo has it"
    assert found["figure"]["links"][0]["lines_mm"] == [[[0, 0, 0], [0, 0, 10]]]
    assert found["figure_problem"] is None
    assert found["poses"] == {"up": {"pan": 10}}


def test_a_wrong_urdf_costs_the_figure_and_not_the_show(tmp_path):
    (tmp_path / "arm.urdf").write_text("<robot>\n<link/>\n</robot>")
    found = view(tmp_path, "urdf: {file: arm.urdf}\n")
    assert found["figure"] is None
    assert "arm.urdf:2: <link> has no 'name'" in found["figure_problem"]
