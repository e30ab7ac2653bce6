"""The torques of a figure with masses: against closed forms, and against MuJoCo."""

from __future__ import annotations

import math
import random
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from lss_motion.robot.dynamics import BLOCK, GRAVITY_M_S2, RigidTree
from lss_motion.robot.figure import Figure, FigureLink, Shape, capsule, turned, unit_vector
from lss_motion.robot.load import load_robot
from lss_motion.show.gait.kinematics import figure_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

TOLERANCE_N_M = 0.0137
"""A hundredth of what an LSS-ST1 holds."""


def _figure(*links: FigureLink) -> Figure:
    return Figure(source="figure", links=links)


def _arm(mass_kg: float, length_mm: float, **keys: Any) -> FigureLink:
    """Return an even thin bar ahead that a joint lifts."""
    com = (length_mm / 2.0, 0.0, 0.0)
    bar = mass_kg * (0.001 * length_mm) ** 2 / 12.0
    inertia = ((0.0, 0.0, 0.0), (0.0, bar, 0.0), (0.0, 0.0, bar))
    given = {"axis": (0.0, -1.0, 0.0), "mass_kg": mass_kg, "com_mm": com, "inertia_kg_m2": inertia}
    return FigureLink(**(given | keys))


def test_bar_on_a_level_axis_is_a_pendulum() -> None:
    """An even bar: m g l/2 cos + m l²/3 a, for angles above the level."""
    tree = RigidTree(_figure(_arm(0.3, 200.0, name="arm", joint="arm")), ["arm"])
    deg = np.linspace(-180.0, 180.0, 2 * BLOCK + 7)[:, None]
    deg_s2 = 500.0 * np.sin(deg)
    found = tree.torques_n_m(deg, 300.0 * np.cos(deg), deg_s2)
    static = 0.3 * GRAVITY_M_S2 * 0.1 * np.cos(np.radians(deg))
    assert np.allclose(found, static + 0.3 * 0.2**2 / 3.0 * np.radians(deg_s2), atol=1e-12)


def test_two_links_in_a_level_plane_have_the_torques_of_the_textbook() -> None:
    """Point masses at the ends of two links with upright axes: no weight, only motion."""
    end = FigureLink(name="upper", joint="shoulder", mass_kg=0.4, com_mm=(300.0, 0.0, 0.0))
    tip = FigureLink(
        name="lower",
        joint="elbow",
        parent=0,
        origin_mm=(300.0, 0.0, 0.0),
        mass_kg=0.2,
        com_mm=(200.0, 0.0, 0.0),
    )
    tree = RigidTree(
        _figure(end, tip),
        ["shoulder", "elbow"],
    )
    rng = np.random.default_rng(1)
    deg, deg_s, deg_s2 = (rng.uniform(-300.0, 300.0, (50, 2)) for _ in range(3))
    q, w, a = (np.radians(one).T for one in (deg, deg_s, deg_s2))
    m1, m2, l1, l2 = 0.4, 0.2, 0.3, 0.2
    coupling, rest = m2 * l1 * l2 * np.cos(q[1]), m2 * l2**2
    swirl = m2 * l1 * l2 * np.sin(q[1])
    shoulder = ((m1 + m2) * l1**2 + rest + 2.0 * coupling) * a[0] + (rest + coupling) * a[1]
    shoulder -= swirl * (2.0 * w[0] * w[1] + w[1] ** 2)
    elbow = (rest + coupling) * a[0] + rest * a[1] + swirl * w[0] ** 2
    assert np.allclose(tree.torques_n_m(deg, deg_s, deg_s2), np.stack([shoulder, elbow], 1))


def test_a_joint_that_turns_two_links_carries_both_by_their_ratios() -> None:
    """A jaw of two halves that one joint opens, the second by half and the other way."""
    one = _arm(0.1, 100.0, name="lower", joint="jaw")
    two = _arm(0.1, 100.0, name="upper", joint="jaw", ratio=-0.5)
    tree = RigidTree(_figure(one, two), ["jaw"])
    weight = 0.1 * GRAVITY_M_S2 * 0.05
    wished = weight * (math.cos(math.radians(40.0)) - 0.5 * math.cos(math.radians(20.0)))
    still = np.zeros((1, 1))
    assert tree.torques_n_m(np.array([[40.0]]), still, still)[0, 0] == pytest.approx(wished)


def test_what_is_fixed_to_a_link_counts_with_it_and_what_has_no_joint_stands_still() -> None:
    base = _arm(9.0, 500.0, name="base")
    arm = FigureLink(name="arm", joint="arm", parent=0, axis=(0.0, -1.0, 0.0))
    hand = _arm(0.2, 0.0, name="hand", parent=1, origin_mm=(150.0, 0.0, 0.0))
    frame = FigureLink(name="frame", joint="idle", parent=2)
    tree = RigidTree(_figure(base, arm, hand, frame), ["arm", "idle"])
    still = np.zeros((1, 2))
    found = tree.torques_n_m(still, still, still)
    assert found[0] == pytest.approx([0.2 * GRAVITY_M_S2 * 0.15, 0.0])


def _random_figure(rng: random.Random) -> Figure:
    """A tree of 3 to 20 links, some fixed, some weightless, some turned by the joint of another."""
    links: list[FigureLink] = []
    for index in range(rng.randrange(3, 21)):

        def vector(size: float) -> tuple[float, float, float]:
            return (rng.uniform(-size, size), rng.uniform(-size, size), rng.uniform(-size, size))

        sizes = np.sort([rng.uniform(1e-5, 4e-4) for _ in range(2)])
        about = np.array(turned(unit_vector(vector(1.0)), rng.uniform(0.0, 6.0)))
        # Of three moments two together are never less than the third.
        inertia = about @ np.diag([*sizes, rng.uniform(sizes[1], sizes.sum())]) @ about.T
        rows = tuple(tuple(map(float, row)) for row in inertia)
        mass = rng.uniform(0.02, 0.3)
        earlier = [link.joint for link in links if link.joint is not None]
        joint = rng.choice([None, f"j{index}", f"j{index}", f"j{index}", *earlier[-1:]])
        links.append(
            FigureLink(
                name=f"l{index}",
                parent=rng.randrange(-1, index) if index else -1,
                joint=joint,
                ratio=rng.choice([1.0, 1.0, -0.5, 2.0]) if joint else 1.0,
                rest_deg=rng.uniform(-90.0, 90.0),
                axis=unit_vector(vector(1.0)),
                origin_mm=vector(120.0),
                rotation=turned(unit_vector(vector(1.0)), rng.uniform(-3.0, 3.0)),
                mass_kg=None if rng.random() < 0.2 else mass,
                com_mm=vector(80.0),
                inertia_kg_m2=rows,  # type: ignore[arg-type]
            )
        )
    return Figure(source="urdf", links=tuple(links))


def _mjcf(figure: Figure) -> str:
    """Return the same links for MuJoCo, each with a hinge of its own."""

    def bodies(parent: int) -> str:
        text = ""
        for index, link in enumerate(figure.links):
            if link.parent != parent:
                continue
            place = " ".join(f"{0.001 * part:.12g}" for part in link.origin_mm)
            axes = [" ".join(map(repr, column)) for column in zip(*link.rotation, strict=True)]
            text += f'<body pos="{place}" xyaxes="{axes[0]} {axes[1]}">'
            if link.joint is not None:
                axis = " ".join(map(repr, link.axis))
                text += f'<joint name="{index}" type="hinge" axis="{axis}"/>'
            if link.mass_kg is None or link.inertia_kg_m2 is None:
                text += '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
            else:
                com = " ".join(f"{0.001 * part:.12g}" for part in link.com_mm)
                i = link.inertia_kg_m2
                six = (i[0][0], i[1][1], i[2][2], i[0][1], i[0][2], i[1][2])
                full = " ".join(map(repr, six))
                text += f'<inertial pos="{com}" mass="{link.mass_kg}" fullinertia="{full}"/>'
            text += f"{bodies(index)}</body>"
        return text

    return (
        '<mujoco><compiler autolimits="false"/><option gravity="0 0 -9.81"/>'
        f"<worldbody>{bodies(-1)}</worldbody></mujoco>"
    )


@pytest.mark.parametrize("seed", range(40))
def test_random_trees_have_the_torques_of_mujoco(seed: int) -> None:
    """Within a hundredth of what a servo holds, at speeds and accelerations of a show."""
    mujoco: Any = pytest.importorskip("mujoco", reason="pip install 'lss-motion[physics]'")
    figure = _random_figure(random.Random(seed))
    turning = [link for link in figure.links if link.joint is not None]
    names = list(dict.fromkeys(link.joint for link in turning if link.joint is not None))
    if not names:
        pytest.skip("nothing turns")
    model = mujoco.MjModel.from_xml_string(_mjcf(figure))
    data = mujoco.MjData(model)
    order = [model.joint(str(figure.links.index(link))).id for link in turning]
    columns = [names.index(link.joint or "") for link in turning]
    ratios = np.array([link.ratio for link in turning])
    rests = np.array([link.rest_deg for link in turning])
    rng = np.random.default_rng(seed)
    deg, deg_s, deg_s2 = (
        rng.uniform(-most, most, (20, len(names))) for most in (180.0, 360.0, 1000.0)
    )
    found = RigidTree(figure, names).torques_n_m(deg, deg_s, deg_s2)
    for row in range(len(deg)):
        data.qpos[order] = np.radians(ratios * (deg[row, columns] - rests))
        data.qvel[order] = np.radians(ratios * deg_s[row, columns])
        data.qacc[order] = np.radians(ratios * deg_s2[row, columns])
        mujoco.mj_inverse(model, data)
        wished: NDArray[np.float64] = np.zeros(len(names))
        np.add.at(wished, columns, ratios * data.qfrc_inverse[order])
        assert np.abs(found[row] - wished).max() < TOLERANCE_N_M, names


URDF = """\
<robot name="arm">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper">
    <inertial>
      <origin xyz="0.1 0.02 -0.01" rpy="0.3 -0.4 0.5"/><mass value="0.4"/>
      <inertia ixx="0.0004" iyy="0.003" izz="0.0029" ixy="0.0001" ixz="-0.0002" iyz="0.00005"/>
    </inertial>
  </link>
  <link name="lower">
    <inertial>
      <origin xyz="0.05 0 0.08" rpy="-1 0.2 2"/><mass value="0.2"/>
      <inertia ixx="0.0003" iyy="0.002" izz="0.0019" ixy="0.0001" ixz="0.0002" iyz="0"/>
    </inertial>
  </link>
  <link name="tool"><inertial><origin xyz="0 0 0.03"/><mass value="0.1"/>
    <inertia ixx="0.0001" iyy="0.0001" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0.1 0.2" rpy="0.2 0.1 -0.7"/><axis xyz="0 1 0.2"/>
    <limit lower="-2" upper="2" effort="1" velocity="3"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.2 0 0" rpy="1 0 0.3"/><axis xyz="0.1 -1 0"/></joint>
  <joint name="grip" type="fixed"><parent link="lower"/><child link="tool"/>
    <origin xyz="0 0 0.15" rpy="0 1 0"/></joint>
</robot>
"""
ROBOT = """\
robot: arm
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {shoulder: {id: 1}, elbow: {id: 2}}
urdf: {file: arm.urdf}
"""


def _arm_of(folder: Path, urdf: str) -> Figure:
    (folder / "arm.urdf").write_text(urdf)
    (folder / "robot.yaml").write_text(ROBOT)
    figure = figure_of(load_robot(folder / "robot.yaml"))
    assert figure is not None
    return figure


def test_a_urdf_file_has_the_torques_that_mujoco_reads_from_it(tmp_path: Path) -> None:
    mujoco: Any = pytest.importorskip("mujoco", reason="pip install 'lss-motion[physics]'")
    figure = _arm_of(tmp_path, URDF)
    model = mujoco.MjModel.from_xml_string(URDF)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(5)
    deg, deg_s, deg_s2 = (rng.uniform(-most, most, (20, 2)) for most in (90.0, 360.0, 1000.0))
    found = RigidTree(figure, ["shoulder", "elbow"]).torques_n_m(deg, deg_s, deg_s2)
    for row in range(len(deg)):
        data.qpos[:], data.qvel[:], data.qacc[:] = np.radians([deg[row], deg_s[row], deg_s2[row]])
        mujoco.mj_inverse(model, data)
        assert found[row] == pytest.approx(data.qfrc_inverse, abs=1e-9)


def test_a_urdf_file_without_masses_has_none_and_a_wrong_mass_is_a_note(tmp_path: Path) -> None:
    assert _arm_of(tmp_path, URDF).has_masses
    weightless = re.sub("<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL)
    assert not _arm_of(tmp_path, weightless).has_masses
    wrong = _arm_of(tmp_path, URDF.replace('value="0.2"', 'value="-0.2"'))
    assert [link.mass_kg for link in wrong.links] == [1.0, 0.4, None, 0.1]
    assert "must not be below 0; the mass counts as unknown" in wrong.notes[0]


def test_links_without_an_inertia_have_that_of_what_they_fill() -> None:
    """Two balls apart, a box: against what each has by its formula, about the axis of the joint."""
    ball = Shape(kind="sphere", size_mm=(30.0,), origin_mm=(100.0, 0.0, 0.0))
    small = Shape(kind="ellipsoid", size_mm=(30.0, 30.0, 15.0), origin_mm=(-50.0, 0.0, 0.0))
    box = Shape(kind="box", size_mm=(60.0, 30.0, 10.0))
    cylinder = Shape(kind="cylinder", size_mm=(20.0, 50.0))
    mesh = Shape(kind="mesh", size_mm=(1.0, 1.0, 1.0), path="a.stl")
    long = capsule((-500.0, 0.0, 0.0), (500.0, 0.0, 0.0), 2.0)
    for shapes, com_mm, wished in (
        ([ball, small], 50.0, (2 / 5 * 0.03**2 * 2 + 0.1**2 * 2 + 2 / 5 * 0.03**2 + 0.05**2) / 3),
        ([box], 0.0, (0.06**2 + 0.03**2) / 12),
        ([cylinder], 0.0, 0.02**2 / 2),
        ([mesh], 40.0, 0.04**2),
        ([long], 0.0, 1.0 / 12),
    ):
        link = FigureLink(
            name="a", joint="a", mass_kg=3.0, com_mm=(com_mm, 0.0, 0.0), shapes=tuple(shapes)
        )
        still = np.zeros((1, 1))
        found = RigidTree(_figure(link), ["a"]).torques_n_m(still, still, np.degrees([[1.0]]))
        assert found[0, 0] == pytest.approx(3.0 * wished, rel=0.005)
