"""The figure of a robot: links of its file and URDF files, where they stand, and refused files."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.show.gait.kinematics import figure_of, figure_of_legs, forward
from lss_motion.show.gait.load import load_gait

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {pan: {id: 1}, tilt: {id: 2}, grip: {id: 3}}
"""


def load(tmp_path, text):
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT + text, encoding="utf-8")
    return load_robot(path)


def refusals(tmp_path, text):
    with pytest.raises(InputError) as caught:
        figure_of(load(tmp_path, text))
    return [(error.line, error.reason) for error in (caught.value, *caught.value.more)]


def end_mm(figure, name, pose):
    return figure.points_mm(pose)[name][-1]


def test_a_link_begins_at_the_end_of_its_parent_and_turns_about_its_axis(tmp_path):
    figure = load(
        tmp_path,
        "figure:\n"
        "  arm: {parent: post, joint: tilt, axis: y, along: x, length_mm: 50, rest_deg: 10}\n"
        "  post: {joint: pan, axis: z, along: z, length_mm: 100}\n"
        "  tip: {parent: arm, along: [1, 0, 1], length_mm: 20, offset_mm: [0, 5, 0]}\n",
    ).figure
    assert [link.name for link in figure.links] == ["post", "arm", "tip"]
    # Tilted by a quarter turn about the left, the arm points down; panned, forward becomes left.
    np.testing.assert_allclose(end_mm(figure, "arm", {"tilt": 10}), [50, 0, 100], atol=1e-9)
    np.testing.assert_allclose(end_mm(figure, "arm", {"tilt": 100}), [0, 0, 50], atol=1e-9)
    np.testing.assert_allclose(
        end_mm(figure, "arm", {"tilt": 10, "pan": 90}), [0, 50, 100], atol=1e-9
    )
    edge = 20 / math.sqrt(2)
    np.testing.assert_allclose(
        end_mm(figure, "tip", {"tilt": 100}), [edge, 5, 50 - edge], atol=1e-9
    )
    assert figure.reach_mm == pytest.approx(100 + math.hypot(50, 5) + 20)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("figure:\n  a: {length_mm: 5}\n  b:\n    parent: c\n", 7, "unknown parent 'c'"),
        ("figure:\n  a:\n    joint: pam\n    axis: z\n", 6, "pan"),
        ("figure:\n  a:\n    joint: pan\n", 5, "no 'axis'"),
        ("figure:\n  a:\n    axis: z\n", 6, "no 'joint'"),
        ("figure:\n  a: {parent: b}\n  b: {parent: a}\n", 5, "parents of each other"),
        ("figure:\n  a:\n    along: up\n", 6, "x, -x, y, -y, z, -z"),
        ("figure:\n  a:\n    along: [0, 0, 0]\n", 6, "is no direction"),
        ("figure:\n  a:\n    along: [0, 1]\n", 6, "a direction such as"),
        ("figure:\n  a:\n    lenght_mm: 4\n", 6, "length_mm"),
        ("figure:\n  a:\n    length_mm: -4\n", 6, "0 or more"),
        ("figure:\n  a:\n    shape: ball\n", 6, "bar, capsule, box"),
        ("figure:\n  a:\n    shape: box\n", 6, "no 'size_mm'"),
        ("figure:\n  a:\n    size_mm: [4, 4, 4]\n", 6, "'shape: ellipsoid'"),
        ("figure:\n  a:\n    size_mm: [4, 4]\n    shape: box\n", 6, "3"),
        ("figure:\n  a:\n    size_mm: [4, 0, 4]\n    shape: box\n", 6, "more than 0"),
        ("figure:\n  a:\n    shape: capsule\n    length_mm: 9\n", 6, "no 'width_mm'"),
        (
            "figure:\n  a:\n    shape: box\n    size_mm: [4, 4, 4]\n    width_mm: 3\n",
            8,
            "no meaning for shape box",
        ),
        ("figure:\n  a:\n    com_mm: [0, 0, 4]\n", 6, "no 'mass_kg'"),
        ("figure:\n  a:\n    mass_kg: -1\n", 6, "0 or more"),
        ("figure: {a: {}}\nurdf: {file: a.urdf}\n", 5, "exclude each other"),
        ("urdf:\n  file: ../a.urdf\n", 5, "below the folder"),
        ("urdf:\n  file: /etc/passwd\n", 5, "below the folder"),
        ("urdf: {file: a.urdf, joints: {pam: x}}\n", 4, "unknown joint 'pam'"),
    ],
)
def test_a_wrong_figure_is_refused_at_its_line(tmp_path, text, line, said):
    found = refusals(tmp_path, text)
    assert found[0][0] == line, found
    assert said in found[0][1]


@pytest.mark.parametrize("name", ["hexapod_walk", "quadruped_trot"])
def test_the_feet_of_a_gait_stand_where_its_kinematics_say(name):
    legs = load_gait(EXAMPLES / f"{name}.yaml").legs
    figure = figure_of_legs(legs)
    draw = np.random.default_rng(3)
    for _ in range(20):
        pose = {joint: draw.uniform(-90, 90) for leg in legs for joint in leg.joints}
        placed = figure.placed(pose)
        for leg, (link, point) in zip(legs, figure.feet, strict=True):
            rotation, origin = placed[link]
            expected = forward(leg, np.array([[pose[joint] for joint in leg.joints]]))[0]
            np.testing.assert_allclose(rotation @ np.array(point) + origin, expected, atol=1e-9)
            assert np.linalg.norm(expected) <= figure.reach_mm


def test_the_figure_of_the_hexapod_file_is_that_of_its_legs():
    robot = load_robot(EXAMPLES / "robots/hexapod.yaml")
    legs = load_gait(EXAMPLES / "hexapod_walk.yaml").legs
    by_legs = figure_of_legs(legs)
    draw = np.random.default_rng(4)
    for _ in range(5):
        pose = {joint: draw.uniform(-60, 60) for joint in robot.joints}
        for leg in legs:
            np.testing.assert_allclose(
                end_mm(robot.figure, leg.joints[2], pose),
                end_mm(by_legs, leg.joints[2], pose),
                atol=0.05,  # The file has its directions to four places.
            )


def test_the_figures_of_the_examples_stand_in_their_poses():
    arm = load_robot(EXAMPLES / "robots/desk_arm.yaml")
    fingers = arm.figure.points_mm({**arm.poses["upright"], "gripper": 0})
    np.testing.assert_allclose(
        fingers["left_finger"][-1], fingers["right_finger"][-1], atol=1e-9
    )  # Closed.
    assert fingers["left_finger"][-1][2] > 450, "upright"
    body = load_robot(EXAMPLES / "robots/figure.yaml")
    up = body.figure.points_mm(body.poses["hands_up"])
    top_mm = up["neck"][-1][2] + 110.0  # The head stands 110 mm on the neck.
    assert min(up["left_forearm"][-1][2], up["right_forearm"][-1][2]) > top_mm
    wide = body.figure.points_mm(body.poses["arms_wide"])
    # Mirror images: the same but for the sign of y.
    np.testing.assert_allclose(wide["left_forearm"] * [1, -1, 1], wide["right_forearm"], atol=1e-9)


def test_an_ellipsoid_stands_in_the_middle_of_its_link_and_turns_with_it():
    ghost = load_robot(EXAMPLES / "robots/ghost.yaml")
    names = [link.name for link in ghost.figure.links]
    jaw = ghost.figure.links[names.index("jaw")]
    (ball,) = jaw.shapes
    assert (jaw.lines_mm, ball.kind, ball.size_mm) == ((), "ellipsoid", (46.0, 42.0, 19.0))
    heights = []
    for deg in (0.0, 40.0):
        rotation, origin = ghost.figure.placed({"jaw": deg})[names.index("jaw")]
        heights.append((rotation @ np.array(ball.origin_mm) + origin)[2])
    assert heights[1] < heights[0] - 20.0, "it opens downwards"
    skull = ghost.figure.links[names.index("skull")].shapes[0]
    assert ghost.figure.reach_mm > 2 * max(skull.size_mm)
    shades = {
        shape["shade"] for link in ghost.figure.as_json()["links"] for shape in link["shapes"]
    }
    assert shades == {None, "dark", "light"}


def inside(shape, points):
    """Whether points of a link are in one of its shapes, by the definition of the shape."""
    local = (points - np.array(shape.origin_mm)) @ np.array(shape.rotation)
    if shape.kind == "box":
        return (np.abs(local) <= np.array(shape.size_mm) / 2 + 1e-9).all(axis=1)
    if shape.kind == "ellipsoid":
        return ((local / np.array(shape.size_mm)) ** 2).sum(axis=1) <= 1.0 + 1e-9
    radius, length = shape.size_mm
    away = local - np.clip(local, [0, 0, -length / 2], [0, 0, length / 2])
    return np.linalg.norm(away, axis=1) <= radius + 1e-9


def test_what_links_fill_and_weigh(tmp_path):
    figure = load(
        tmp_path,
        "figure:\n"
        "  bar: {along: [3, 0, 4], length_mm: 50, width_mm: 10, mass_kg: 0.2}\n"
        "  rod: {along: [0, -1, -1], length_mm: 40, width_mm: 8, shape: capsule, shade: dark}\n"
        "  box: {along: z, length_mm: 20, shape: box, size_mm: [4, 6, 30], mass_kg: 1,\n"
        "        com_mm: [1, 2, 3]}\n"
        "  egg: {shape: ellipsoid, size_mm: [10, 20, 30], offset_mm: [1, 2, 3]}\n"
        "  none: {length_mm: 0}\n",
    ).figure
    solids = dict(zip([link.name for link in figure.links], figure.solids(), strict=True))
    edges = {
        "bar": ([[0, 0, 0], [30, 0, 40], [15 + 4, 0, 20 - 3], [33, 0, 44]], [[15, 5.1, 20]]),
        "rod": ([[0, 0, 0], [0, 0, 4], [0, -28.28, -28.28]], [[0, 0, 4.1], [4.1, -14, -14]]),
        "box": ([[2, 3, 25], [-2, -3, -5]], [[2.1, 0, 10], [0, 0, 25.1]]),
        "egg": ([[5, 0, 0], [0, 10, 0], [0, 0, -15]], [[5, 1, 0], [0, 0, 15.1]]),
    }
    for name, (within, without) in edges.items():
        (shape,) = solids[name]
        assert inside(shape, np.array(within)).all(), name
        assert not inside(shape, np.array(without)).any(), name
    assert solids["none"] == ()
    weights = {link.name: (link.mass_kg, link.com_mm) for link in figure.links}
    assert weights["bar"] == (0.2, (15.0, 0.0, 20.0)), "its middle"
    assert weights["box"] == (1.0, (1.0, 2.0, 3.0))
    assert weights["egg"] == (None, (0.0, 0.0, 0.0)), "unknown"
    draw = np.random.default_rng(2).normal(size=(5000, 3))
    points = draw / np.linalg.norm(draw, axis=1)[:, None] * (figure.reach_mm + 1e-6)
    for link, own in zip(figure.links, figure.solids(), strict=True):
        for shape in own if link.shapes else ():
            assert not inside(shape, points - np.array(link.origin_mm)).any(), link.name


def test_the_masses_of_a_urdf_are_those_of_its_links(tmp_path):
    inertial = '<inertial><origin xyz="0.01 0 -0.02"/><mass value="{}"/></inertial>'
    for mass, known in (("0.25", (0.25, (10.0, 0.0, -20.0))), ("-1", (None, (0.0, 0.0, 0.0)))):
        (tmp_path / "test.urdf").write_text(
            URDF.replace('<link name="jaw"/>', f'<link name="jaw">{inertial.format(mass)}</link>')
        )
        figure = figure_of(load(tmp_path, NAMED))
        (jaw,) = [link for link in figure.links if link.name == "jaw"]
        assert (jaw.mass_kg, jaw.com_mm) == known
        assert any("the mass counts as unknown" in note for note in figure.notes) == (mass == "-1")


URDF = """\
<?xml version="1.0"?>
<robot name="test">
  <link name="base">
    <visual><geometry><box size="0.1 0.2 0.03"/></geometry></visual>
  </link>
  <link name="head">
    <visual>
      <origin xyz="0 0 0.01" rpy="0 1.5 0"/>
      <geometry><mesh filename="package://meshes/head.stl" scale="0.001 0.001 0.001"/></geometry>
    </visual>
    <visual><geometry><mesh filename="meshes/other.dae"/></geometry></visual>
    <visual><geometry><cylinder radius="0.01" length="0.2"/></geometry></visual>
  </link>
  <link name="jaw"/><link name="finger"/><link name="other_finger"/><link name="lens"/>
  <joint name="neck_pan" type="revolute">
    <parent link="base"/><child link="head"/>
    <origin xyz="0.01 -0.02 0.3" rpy="0.3 -0.4 1.2"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="tilt" type="continuous">
    <parent link="head"/><child link="jaw"/>
    <origin xyz="0.05 0 0" rpy="0 0 0.5"/><axis xyz="0 2 0"/>
  </joint>
  <joint name="grip" type="revolute">
    <parent link="jaw"/><child link="finger"/><origin xyz="0 0.03 0"/>
  </joint>
  <joint name="grip_2" type="revolute">
    <parent link="jaw"/><child link="other_finger"/><origin xyz="0 -0.03 0"/><axis xyz="0 0 1"/>
    <mimic joint="grip" multiplier="-0.5" offset="0.2"/>
  </joint>
  <joint name="zoom" type="prismatic">
    <parent link="finger"/><child link="lens"/><origin xyz="0.02 0.01 0"/><axis xyz="1 0 0"/>
  </joint>
</robot>
"""
NAMED = "urdf: {file: test.urdf, joints: {pan: neck_pan}}\n"


def placed_by_hand(text, angle_rad):
    """Forward kinematics of a URDF text by 4×4 matrices, sharing nothing with the reader."""
    joints = {joint.find("child").get("link"): joint for joint in ET.fromstring(text).iter("joint")}

    def numbers(element, key, default):
        return [
            float(v) for v in (default if element is None else element.get(key, default)).split()
        ]

    def of(link):
        if link not in joints:
            return np.eye(4)
        joint = joints[link]
        here = np.eye(4)
        origin = joint.find("origin")
        here[:3, 3] = numbers(origin, "xyz", "0 0 0") if origin is not None else 0.0
        rpy = numbers(origin, "rpy", "0 0 0") if origin is not None else [0, 0, 0]
        turn = Rotation.from_euler("xyz", rpy).as_matrix()
        axis = joint.find("axis")
        axis = np.array([float(v) for v in ("1 0 0" if axis is None else axis.get("xyz")).split()])
        angle = angle_rad.get(joint.get("name"), 0.0)
        if (mimic := joint.find("mimic")) is not None:
            angle = angle_rad[mimic.get("joint")] * float(mimic.get("multiplier"))
            angle += float(mimic.get("offset"))
        axis = axis / np.linalg.norm(axis)
        here[:3, :3] = turn @ Rotation.from_rotvec(axis * angle).as_matrix()
        return of(joint.find("parent").get("link")) @ here

    return {link: of(link) for link in ["base", *joints]}


def test_a_urdf_stands_where_an_independent_reader_puts_it(tmp_path):
    (tmp_path / "test.urdf").write_text(URDF)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/head.stl").write_bytes(b"solid")
    (tmp_path / "meshes/other.dae").write_bytes(b"<x/>")
    figure = figure_of(load(tmp_path, NAMED))
    draw = np.random.default_rng(5)
    for _ in range(20):
        pose = {joint: draw.uniform(-90, 90) for joint in ("pan", "tilt", "grip")}
        rad = {name: math.radians(deg) for name, deg in pose.items()}
        expected = placed_by_hand(URDF, {**rad, "neck_pan": rad["pan"]})
        for link, (rotation, origin) in zip(figure.links, figure.placed(pose), strict=True):
            np.testing.assert_allclose(rotation, expected[link.name][:3, :3], atol=1e-9)
            np.testing.assert_allclose(origin, 1000 * expected[link.name][:3, 3], atol=1e-6)
    shapes = {link.name: link.shapes for link in figure.links}
    assert [(shape.kind, shape.size_mm) for shape in shapes["base"]] == [("box", (100, 200, 30))]
    mesh, cylinder = shapes["head"]
    assert (mesh.path, mesh.size_mm, mesh.origin_mm) == ("meshes/head.stl", (1, 1, 1), (0, 0, 10))
    assert cylinder.size_mm == (10, 200)
    assert len(figure.notes) == 1
    assert "other.dae" in figure.notes[0]


def changed(old, new):
    assert URDF.count(old) >= 1, old
    return URDF.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (changed("package://meshes/head.stl", "../../head.stl"), "line 9: "),
        (changed("package://meshes/head.stl", "file:///etc/passwd"), "below the folder"),
        (changed("package://meshes/head.stl", "package:///meshes/head.stl"), "below the folder"),
        (changed("package://meshes/head.stl", ""), "line 9: <mesh> has no 'filename'"),
        (changed('box size="0.1', 'box size="-0.1'), "above 0; it is not drawn"),
        (changed('box size="0.1', 'box size="0'), "line 4: <box>: a size must be above 0"),
        (changed('box size="0.1', 'box size="wide'), "3 numbers"),
        (changed("<box ", "<bocks "), "no shape"),
    ],
)
def test_a_part_that_cannot_be_drawn_is_a_note(tmp_path, text, said):
    (tmp_path / "test.urdf").write_text(text)
    assert any(said in note for note in figure_of(load(tmp_path, NAMED)).notes)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (changed("0.01 -0.02 0.3", "0.01 -0.02"), 17, "3 numbers"),
        (changed("0.01 -0.02 0.3", "0.01 nan 0.3"), 17, "3 numbers"),
        (changed('<child link="head"/>', '<child link="haed"/>'), 16, "head"),
        (changed('type="revolute"', 'type="floating"'), 15, "not supported"),
        (changed('<child link="jaw"/>', '<child link="head"/>'), 20, "child of 'neck_pan' already"),
        (changed('<parent link="base"/>', '<parent link="lens"/>'), 15, "circle of joints"),
        (changed('name="jaw"/>', 'name="jaw"/><link name="x"/>'), 2, "2 links have no parent"),
        (changed('type="revolute"', 'type="prismatic"'), 15, "a servo turns it"),
        (changed("0 0.6 0.8", "0 0 0"), 17, "axis is 0 0 0"),
        (changed('joint="grip" m', 'joint="gripp" m'), 29, "grip"),
        (changed('joint="grip" m', 'joint="grip_2" m'), 29, "mimic each other"),
        (changed('name="jaw"', 'name="head"'), 14, "given twice, first in line 6"),
        (changed("</link>", "</lick>"), 5, "not XML"),
        (changed('<robot name="test">', '<!DOCTYPE a [<!ENTITY b "c">]>\n<robot>'), 2, "document"),
        (changed("<robot", "<sdf").replace("</robot>", "</sdf>"), 2, "<sdf>"),
        (changed('box size="0.1', 'box size="${w}'), 4, "lss-motion import-urdf test.urdf"),
        (changed("<link", "<xacro:wheel/><link"), 3, "is a xacro file"),
        ("", 1, "not XML"),
        ("<a>" * 40 + "</a>" * 40, 1, "deep"),
    ],
)
def test_a_wrong_urdf_is_refused_at_its_line(tmp_path, text, line, said):
    (tmp_path / "test.urdf").write_text(text)
    with pytest.raises(InputError) as caught:
        figure_of(load(tmp_path, NAMED))
    assert caught.value.path == tmp_path / "test.urdf"
    assert (caught.value.line, said in caught.value.reason) == (line, True), caught.value


def test_a_urdf_without_joints_of_the_robot_or_outside_of_its_folder_is_refused(tmp_path):
    (tmp_path / "test.urdf").write_text(URDF)
    assert "neck_pan" in refusals(tmp_path, "urdf: {file: test.urdf, joints: {pan: pan_2}}\n")[0][1]
    text = "<robot><link name='a'/><link name='b'/><joint name='x' type='fixed'><parent link='a'/>"
    (tmp_path / "still.urdf").write_text(text + "<child link='b'/></joint></robot>")
    line, reason = refusals(tmp_path, "urdf:\n  file: still.urdf\n")[0]
    assert (line, "no joint of the robot" in reason) == (5, True)
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "link.urdf").symlink_to(tmp_path / "test.urdf")
    assert "outside" in refusals(inside, "urdf: {file: link.urdf}\n")[0][1]
    assert "not found" in refusals(tmp_path, "urdf: {file: none.urdf}\n")[0][1]
