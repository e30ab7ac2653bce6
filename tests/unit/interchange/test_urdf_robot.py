"""`import-urdf`: robots that others described; each guess is a line."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.interchange.urdf_legs import placed
from lss_motion.interchange.urdf_robot import imported_robot
from lss_motion.planning.shows import prepare
from lss_motion.robot.load import load_robot
from lss_motion.robot.urdf import MM_PER_M, UrdfFile, urdf_figure
from lss_motion.show.gait.kinematics import inverse
from lss_motion.show.gait.load import load_gait
from tests import urdf_files


@pytest.fixture
def made(tmp_path):
    """Import a text; return the folder with its files, and what was made."""

    def make(text: str, **options: object):
        source = tmp_path / "given" / "given.urdf"
        source.parent.mkdir(exist_ok=True)
        source.write_text(text)
        output = tmp_path / "robot.yaml"
        result = imported_robot(source, output, **options)
        output.write_text(result.robot)
        if result.urdf is not None:
            output.with_suffix(".urdf").write_text(result.urdf)
        if result.gait is not None:
            (tmp_path / "gait.yaml").write_text(result.gait)
        return tmp_path, result

    return make


def test_an_arm_becomes_a_robot_with_its_limits(made):
    folder, _ = made(urdf_files.arm())
    robot = load_robot(folder / "robot.yaml")
    assert robot.name == "desk_arm"
    assert {name: _range(joint) for name, joint in robot.joints.items()} == {
        "base_yaw": (-180.0, 180.0),
        "shoulder": (-180.0, 114.6),  # 2 rad is 114.59: it is rounded, for it is nearer than 0.01.
        "elbow": (-90.0, 90.0),
        "grip": (-14.3, 28.6),  # -0.25 to 0.5 rad, rounded inwards.
    }
    assert robot.joints["shoulder"].speed_max_deg_s == 360.0
    assert robot.joints["grip"].speed_max_deg_s == pytest.approx(math.degrees(3.0), abs=0.1)


def _range(joint) -> tuple[float, float]:
    return joint.position_min_deg, joint.position_max_deg


@pytest.mark.parametrize(
    "note",
    [
        "base_yaw: turns without end; -180..180 deg is allowed",
        "shoulder: its limits are -229.2..114.6 deg; without `turns` its servo counts "
        "-180..114.6 deg, which is written",
        "shoulder: its velocity is 1146 deg/s; an LSS-ST1 does 360",
        "shoulder: its effort is 6.5 N·m; an LSS-ST1 holds 1.373",
        "elbow: both limits are 0 deg; -90..90 deg is assumed",
        "grip: its limits stand in the wrong order; -14.32..28.65 deg is written",
        "grip_twin: mimics grip: it is drawn, and no servo turns it",
        "turn: its inertia is 0; that of its box is written",
        "upper: 5 kg in its box is denser than steel; 0.144 kg are assumed",
        "lower: has no mass; 0.057 kg are assumed, those of a servo",
        "ids 1 to 4 are numbered in the order of the file: write yours",
    ],
)
def test_each_guess_is_a_line_and_a_comment(made, note):
    folder, result = made(urdf_files.arm())
    assert note in result.notes
    assert f"# - {note}\n" in (folder / "robot.yaml").read_text()


def test_the_mended_file_is_one_that_a_body_can_have(made):
    folder, _ = made(urdf_files.arm())
    root = ET.parse(folder / "robot.urdf").getroot()
    for inertial in root.iter("inertial"):
        mass = float(inertial.find("mass").get("value"))
        assert 0.0 < mass < 1.0
        moments = sorted(float(inertial.find("inertia").get(key)) for key in ("ixx", "iyy", "izz"))
        assert moments[0] > 0.0
        assert moments[0] + moments[1] >= moments[2]
    for limit in root.iter("limit"):
        assert float(limit.get("effort")) <= 1.373
    assert "<!-- drawn by hand -->" in (folder / "robot.urdf").read_text()


def test_a_file_with_nothing_to_mend_in_the_folder_of_the_robot_is_named_as_it_is(tmp_path):
    text = urdf_files.robot(
        "plain",
        urdf_files.link("a"),
        urdf_files.link("b", '<box size="0.1 0.1 0.1"/>', mass=0.2, inertia=3.3e-4),
        urdf_files.joint("turn", "a", "b"),
    )
    (tmp_path / "plain.urdf").write_text(text)
    result = imported_robot(tmp_path / "plain.urdf", tmp_path / "robot.yaml")
    assert result.urdf is None
    assert "urdf: {file: plain.urdf}" in result.robot
    assert not any("inertia" in note or "mass" in note for note in result.notes)


def test_the_figure_turns_as_the_file_says_mimics_included(made):
    folder, result = made(urdf_files.arm())
    robot = load_robot(folder / "robot.yaml")
    figure = urdf_figure(robot.urdf, robot.joints)
    angles = {"base_yaw": 20.0, "shoulder": -35.0, "elbow": 50.0, "grip": 12.0}
    own = dict(zip([link.name for link in figure.links], figure.placed(angles), strict=True))
    theirs = placed(
        UrdfFile(folder / "robot.urdf"),
        {one.urdf.name: angles[one.name] for one in result.joints}
        | {"grip_twin": -2.0 * 12.0 + math.degrees(0.1)},
    )
    for name, (rotation, origin) in theirs.items():
        assert own[name][0] == pytest.approx(rotation, abs=1e-9)
        assert own[name][1] == pytest.approx(origin, abs=1e-9)


@pytest.mark.parametrize("kind", ["hexapod", "quadruped"])
def test_recognised_legs_stand_where_the_file_has_them(made, kind):
    """The foot that a gait commands is there in the URDF file, too."""
    folder, result = made(getattr(urdf_files, kind)())
    gait = load_gait(folder / "gait.yaml")
    file = UrdfFile(folder / "given" / "given.urdf")
    names = {one.name: one.urdf.name for one in result.joints}
    for leg in gait.legs:
        side = math.copysign(1.0, leg.hip_mm[1])
        assert leg.name.startswith("left" if side > 0.0 else "right")
        out = np.array([*leg.hip_mm, 0.0]) + np.array([5.0, side * leg.stance_mm, -70.0])
        if kind == "hexapod":
            out[:2] = np.array(leg.hip_mm) + 0.95 * leg.stance_mm * np.array(
                [math.cos(math.radians(leg.yaw_deg)), math.sin(math.radians(leg.yaw_deg))]
            )
        angles = inverse(leg, out[None])[0]
        frames = placed(file, {names[j]: a for j, a in zip(leg.joints, angles, strict=True)})
        tip = frames[_foot_link(leg.joints[2])][1] if kind == "hexapod" else None
        if tip is None:
            rotation, origin = frames[leg.joints[2].replace("knee", "shank_link")]
            tip = rotation @ np.array([0.0, 0.0, -100.0]) + origin
        # Angles are written in hundredths of a degree: 0.03 mm at the end of a leg of 0.2 m.
        assert tip == pytest.approx(out, abs=0.1)


def _foot_link(tibia: str) -> str:
    return tibia.removesuffix("_t") + "_foot"


@pytest.mark.parametrize("kind", ["hexapod", "quadruped"])
def test_the_first_gait_of_recognised_legs_can_be_played(made, kind):
    folder, _ = made(getattr(urdf_files, kind)())
    show = prepare(folder / "gait.yaml", None)
    assert show.program.moves
    assert show.program.start_deg.keys() == load_robot(folder / "robot.yaml").joints.keys()


def test_a_leg_that_is_built_in_another_way_makes_no_gait(made):
    text = urdf_files.hexapod().replace('rpy="0 -0.35 0"', 'rpy="0.3 -0.35 0"', 1)
    _, result = made(text)
    assert result.gait is None
    assert any(note.startswith("no gait file was made: joints 2 and 3") for note in result.notes)


def test_a_gear_outside_of_the_servo_is_a_ratio(made):
    gear = (
        '<transmission name="t"><joint name="turn"/><actuator name="m">'
        "<mechanicalReduction>2.5</mechanicalReduction></actuator></transmission>\n"
    )
    folder, result = made(
        urdf_files.robot(
            "geared",
            urdf_files.link("a"),
            urdf_files.link("b", mass=0.1, inertia=1e-4),
            urdf_files.joint("turn", "a", "b", kind="continuous", limit=""),
            gear,
        )
    )
    assert _range(load_robot(folder / "robot.yaml").joints["turn"]) == (-72.0, 72.0)
    assert "ratio: 2.5" in result.robot
    assert any("has a gear of 2.5" in note for note in result.notes)


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("<robot", 1, "not XML"),
        ("<mujoco/>", 1, "the outermost element is <mujoco>"),
        (urdf_files.robot("r", urdf_files.link("a")), 2, "no joint in it turns"),
        (
            urdf_files.robot(
                "r",
                urdf_files.link("a"),
                urdf_files.link("b"),
                urdf_files.joint("j", "a", "b", limit='lower="x" upper="1"'),
            ),
            6,
            "<limit>: lower 'x' must be a number",
        ),
        ('<!DOCTYPE robot [<!ENTITY a "b">]><robot/>', 1, "a document type is not accepted"),
    ],
)
def test_a_file_that_is_no_robot_is_refused_with_its_line(made, text, line, reason):
    with pytest.raises(InputError) as refused:
        made(text)
    assert refused.value.line == line
    assert reason in refused.value.reason


XACRO = """<?xml version="1.0"?>
<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="half" value="${pi / 4}"/>
  <link name="a"/><link name="b"/>
  <joint name="turn" type="revolute"><parent link="a"/><child link="b"/>
    <axis xyz="0 0 1"/><limit lower="${-half}" upper="${half}" effort="1" velocity="1"/></joint>
</robot>
"""


def test_a_xacro_file_is_expanded_with_consent_only(tmp_path):
    source = tmp_path / "x.urdf.xacro"
    source.write_text(XACRO)
    with pytest.raises(InputError, match="--allow-run"):
        imported_robot(source, tmp_path / "robot.yaml")
    result = imported_robot(source, tmp_path / "robot.yaml", may_run=True)
    assert "turn: {id: 1, range_deg: [-45, 45]" in result.robot


@pytest.mark.parametrize(
    "expression", ["${1 / 0}", "${missing}", "$(find no_such_package)", "${__import__('os')}"]
)
def test_a_xacro_file_that_cannot_be_expanded_is_an_error_of_one_line(tmp_path, expression):
    source = tmp_path / "x.xacro"
    source.write_text(XACRO.replace("${pi / 4}", expression))
    with pytest.raises(InputError, match="xacro cannot expand it") as refused:
        imported_robot(source, tmp_path / "robot.yaml", may_run=True)
    assert "\n" not in refused.value.reason


def test_the_command_writes_files_that_check_accepts(tmp_path, capsys):
    source = tmp_path / "hexa.urdf"
    source.write_text(urdf_files.hexapod())
    output = tmp_path / "my.yaml"
    assert main(["import-urdf", str(source), "-o", str(output)]) == 0
    assert "18 joints" in capsys.readouterr().out
    assert main(["check", str(output)]) == 0
    assert main(["check", str(tmp_path / "my_gait.yaml")]) == 0
    before = output.read_bytes()
    assert main(["import-urdf", str(source), "-o", str(output)]) == 2
    assert output.read_bytes() == before


def _angles(result, seed: int) -> dict[str, float]:
    random = np.random.default_rng(seed)
    return {one.urdf.name: float(random.uniform(*one.range_deg)) for one in result.joints}


@pytest.mark.parametrize("kind", ["arm", "hexapod", "quadruped"])
def test_links_stand_where_yourdfpy_has_them(made, kind):
    yourdfpy = pytest.importorskip("yourdfpy", reason="pip install 'lss-motion[oracles]'")
    folder, result = made(getattr(urdf_files, kind)())
    file = folder / "robot.urdf"
    if result.urdf is None:
        file = folder / "given" / "given.urdf"
    model = yourdfpy.URDF.load(str(file))
    for seed in range(20):
        angles = _angles(result, seed)
        model.update_cfg({name: math.radians(angle) for name, angle in angles.items()})
        twin = {"grip_twin": -2.0 * angles["grip"] + math.degrees(0.1)} if kind == "arm" else {}
        for name, (rotation, origin) in placed(UrdfFile(file), angles | twin).items():
            theirs = model.get_transform(name)
            assert theirs[:3, :3] == pytest.approx(rotation, abs=1e-6)
            assert MM_PER_M * theirs[:3, 3] == pytest.approx(origin, abs=1e-3)


@pytest.mark.parametrize("kind", ["hexapod", "quadruped"])
def test_links_stand_where_pinocchio_has_them(made, kind):
    pinocchio = pytest.importorskip("pinocchio", reason="pip install 'lss-motion[oracles]'")
    folder, result = made(getattr(urdf_files, kind)())
    file = folder / ("robot.urdf" if result.urdf is not None else "given/given.urdf")
    model = pinocchio.buildModelFromUrdf(str(file))
    data = model.createData()
    for seed in range(20):
        angles = _angles(result, seed)
        q = pinocchio.neutral(model)
        for name, angle in angles.items():
            q[model.joints[model.getJointId(name)].idx_q] = math.radians(angle)
        pinocchio.framesForwardKinematics(model, data, q)
        for name, (rotation, origin) in placed(UrdfFile(file), angles).items():
            theirs = data.oMf[model.getFrameId(name)]
            assert theirs.rotation == pytest.approx(rotation, abs=1e-6)
            assert MM_PER_M * theirs.translation == pytest.approx(origin, abs=1e-3)
