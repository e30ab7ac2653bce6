"""Where links of a figure touch each other in a plan."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.planning.check_json import show_as_json
from lss_motion.planning.shows import prepare
from lss_motion.planning.trajectory import touches as module
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.touches import touch_lines, touches
from lss_motion.robot.figure import Shape, turned
from lss_motion.robot.load import load_robot
from lss_motion.show.model import Keyframe, Sequence

ROBOT = """\
robot: arm
defaults: {model: LSS-ST1, range_deg: [-170, 170], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {shoulder: {id: 1}, elbow: {id: 2}}
figure:
  base: {along: z, length_mm: 100, width_mm: 40}
  upper: {parent: base, joint: shoulder, axis: -y, length_mm: 200, width_mm: 30}
  lower: {parent: upper, joint: elbow, axis: -y, length_mm: 250, width_mm: 20}
"""


def load(tmp_path, text=ROBOT):
    (tmp_path / "robot.yaml").write_text(text)
    return load_robot(tmp_path / "robot.yaml")


def moved(robot, *poses, every_s=2.0):
    frames = tuple(
        Keyframe(at_s=index * every_s, deg={"shoulder": a, "elbow": b})
        for index, (a, b) in enumerate(poses)
    )
    return plan(Sequence(name="fold", keyframes=frames), robot)


def test_a_forearm_that_folds_onto_the_base_is_named_with_its_instant(tmp_path):
    """The upper arm is level; the forearm folds back under it until it meets the post."""
    robot = load(tmp_path)
    trajectory = moved(robot, (0, 0), (0, -165), (0, 0))
    found = touches(trajectory, robot)
    assert [(touch.one, touch.other) for touch in found] == [("base", "lower")]
    # Where the axes of both are nearer than their radii, 20 and 10 mm, seen from the side.
    times_s = np.arange(0.0, 2.0, 0.005)
    turn = np.radians(trajectory.sample(times_s)[:, 1])
    reach = np.linspace(0.0, 250.0, 251)
    ahead = 200.0 + np.cos(turn)[:, None] * reach
    below = -np.sin(turn)[:, None] * reach
    apart = np.hypot(ahead, below - np.clip(below, 0.0, 100.0)).min(axis=1)
    first_s = times_s[apart < 30.0 - 0.5][0]
    assert found[0].at_s == pytest.approx(first_s, abs=0.02)
    assert found[0].depth_mm == pytest.approx(30.0 - apart.min(), abs=1.0)
    line = touch_lines(found)[0]
    assert line.startswith(f"warning: base and lower touch at {found[0].at_s:.2f} s, most at ")


@pytest.mark.parametrize(
    "poses", [[(0, 0), (90, 100), (0, -100)], [(-60, 90), (120, -60), (-60, 90)]]
)
def test_neighbours_and_what_stays_apart_are_not_named(tmp_path, poses):
    robot = load(tmp_path)
    assert touches(moved(robot, *poses), robot) == ()


def test_what_touches_at_rest_or_has_joints_in_one_place_is_not_named(tmp_path):
    """A head on a neck of two joints in one place, with a collar around it."""
    text = ROBOT[: ROBOT.index("figure:")] + (
        "figure:\n  neck: {along: z, length_mm: 60, width_mm: 30}\n"
        "  pan: {parent: neck, joint: shoulder, axis: z}\n"
        "  head: {parent: pan, joint: elbow, axis: y, along: z, length_mm: 80, width_mm: 60}\n"
        "  hat: {parent: head, length_mm: 90, width_mm: 60}\n"
        "  collar: {parent: pan, along: y, length_mm: 50, width_mm: 40}\n"
    )
    robot = load(tmp_path, text)
    assert touches(moved(robot, (0, 0), (90, 30), (-90, -30)), robot) == ()


def test_check_has_what_touches_and_a_robot_without_a_figure_has_nothing(tmp_path):
    load(tmp_path)
    frames = "  - {at_s: 0, deg: {elbow: 0}}\n  - {at_s: 2, deg: {elbow: -165}}\n"
    (tmp_path / "fold.yaml").write_text(f"sequence: fold\nrobot: robot.yaml\nkeyframes:\n{frames}")
    found = show_as_json(prepare(tmp_path / "fold.yaml", None))
    assert [(one["one"], one["other"]) for one in found["touches"]] == [("base", "lower")]
    load(tmp_path, ROBOT[: ROBOT.index("figure:")])
    assert "touches" not in show_as_json(prepare(tmp_path / "fold.yaml", None))


def test_distances_of_segments_are_those_of_fine_steps_along_both():
    rng = np.random.default_rng(3)
    one, other = rng.uniform(-1.0, 1.0, (2, 2, 300, 3))
    other[:, :60] = one[:, :60] + rng.uniform(-1.0, 1.0, (60, 3))  # Parallel ones.
    one[1, 60:90] = one[0, 60:90]  # Points.
    other[1, 80:120] = other[0, 80:120]
    share = np.linspace(0.0, 1.0, 201)[:, None, None]
    along = one[0] + share * (one[1] - one[0])
    beside = other[0] + share * (other[1] - other[0])
    near = np.full(300, np.inf)
    for points in along:
        near = np.minimum(near, np.linalg.norm(points - beside, axis=2).min(axis=0))
    found = module._distances(one, other)
    assert (found <= near + 1e-9).all()
    assert np.abs(found - near).max() < 0.02


@pytest.mark.parametrize(
    "shape",
    [
        Shape(kind="box", size_mm=(20.0, 80.0, 30.0)),
        Shape(kind="ellipsoid", size_mm=(15.0, 20.0, 60.0)),
        Shape(kind="ellipsoid", size_mm=(50.0, 20.0, 45.0)),
        Shape(kind="ellipsoid", size_mm=(30.0, 30.0, 30.0)),
        Shape(kind="cylinder", size_mm=(30.0, 20.0)),
        Shape(kind="cylinder", size_mm=(10.0, 90.0), origin_mm=(5.0, 0.0, 9.0)),
    ],
)
def test_the_capsule_of_a_shape_lies_within_it(shape):
    """Random points on the capsule are inside of the shape, turned as well."""
    rotation = turned((0.6, 0.0, 0.8), 0.7)
    made = Shape(
        kind=shape.kind, size_mm=shape.size_mm, origin_mm=shape.origin_mm, rotation=rotation
    )
    capsule = module._capsule(0, made)
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(2000, 3))
    share = rng.uniform(0.0, 1.0, (2000, 1))
    points = capsule.ends[0] + share * (capsule.ends[1] - capsule.ends[0])
    points = points + capsule.radius_mm * ways / np.linalg.norm(ways, axis=1)[:, None]
    x, y, z = (np.array(rotation).T @ (points - np.array(shape.origin_mm)).T) / (1.0 + 1e-9)
    size = shape.size_mm
    if shape.kind == "box":
        inside = np.abs([x / size[0], y / size[1], z / size[2]]).max(axis=0) <= 0.5
    elif shape.kind == "ellipsoid":
        inside = (x / size[0]) ** 2 + (y / size[1]) ** 2 + (z / size[2]) ** 2 <= 1.0
    else:
        inside = (np.hypot(x, y) <= size[0]) & (np.abs(z) <= size[1] / 2.0)
    assert inside.all()
    assert capsule.radius_mm > 0.3 * min(size)
