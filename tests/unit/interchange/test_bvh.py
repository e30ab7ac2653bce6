"""Motion capture as BVH: angles of the file, turns about single axes, and errors."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.cli.main import main
from lss_motion.interchange.bvh import BVH
from lss_motion.interchange.reader import Measure
from lss_motion.show.load import load_sequence

SKELETON = """\
HIERARCHY
ROOT Hips
{
  OFFSET 0.0 0.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Head
  {
    OFFSET 0.0 5.2 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0.0 3.9 0.0
    }
  }
}
MOTION
"""
UNIT_OF = {"x": np.eye(3)[0], "y": np.eye(3)[1], "z": np.eye(3)[2]}


def bvh(
    *heads: tuple[float, float, float], frame_s: str = "0.04", frames: int | None = None
) -> str:
    rows = "\n".join(f"1.5 90.0 -2e1 0 0 0 {z} {x} {y}" for z, x, y in heads)
    return f"{SKELETON}Frames: {frames or len(heads)}\nFrame Time: {frame_s}\n{rows}\n"


def turned(axis: str, angle_deg: float) -> np.ndarray:
    """Return the matrix of a turn, by the formula of Rodrigues."""
    x, y, z = UNIT_OF[axis]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(angle_deg)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def test_the_angles_are_those_of_the_file_at_the_instants_of_its_frames(read_one):
    motion = read_one(BVH, bvh((10, 20, -30), (11, 21, -31), (12, 22, -32)))
    found = {channel.name: channel for channel in motion.channels}
    assert found["Head.Zrotation"].values.tolist() == [10, 11, 12]
    assert found["Head.Yrotation"].values.tolist() == [-30, -31, -32]
    assert found["Head.Xrotation"].times_s.tolist() == [0.0, 0.04, 0.08]
    assert {channel.unit for channel in motion.channels} == {Measure.DEG}
    assert not any("position" in name for name in found)
    assert any("place of Hips" in comment for comment in motion.comments)
    assert motion.is_recording


def test_a_turn_about_one_axis_is_the_nearest_turn_about_it(read_one):
    """The judge looks for the nearest turn in steps of 0.01 deg, by matrices."""
    heads = [(10, 20, -30), (-75, 40, 60), (0, 0, 35), (150, 10, 5)]
    motion = read_one(BVH, bvh(*heads))
    found = {channel.name: channel.values for channel in motion.channels}
    steps_deg = np.arange(-180.0, 180.0, 0.01)
    for frame, (z, x, y) in enumerate(heads):
        whole = turned("z", z) @ turned("x", x) @ turned("y", y)
        for axis in "xyz":
            near = [np.trace(whole @ turned(axis, step).T) for step in steps_deg[::100]]
            coarse = steps_deg[::100][int(np.argmax(near))]
            fine = coarse + np.arange(-1.5, 1.5, 0.01)
            best = fine[int(np.argmax([np.trace(whole @ turned(axis, step).T) for step in fine]))]
            away = (found[f"Head.{axis}"][frame] - best + 180.0) % 360.0 - 180.0
            assert abs(away) < 0.02, (frame, axis)


def test_a_turn_through_180_degrees_has_no_jump(read_one):
    heads = [(0, 0, angle if angle <= 180 else angle - 360) for angle in range(0, 400, 10)]
    motion = read_one(BVH, bvh(*heads))
    found = {channel.name: channel.values for channel in motion.channels}
    for name in ("Head.Yrotation", "Head.y"):
        assert found[name] == pytest.approx(np.arange(0, 400, 10))


@pytest.mark.parametrize(
    ("content", "line", "said"),
    [
        (SKELETON.removesuffix("MOTION\n"), None, "no line MOTION"),
        (bvh((1, 2, 3), frames=7), 17, "promises 7 frames, but has 1"),
        (bvh((1, 2, 3), frame_s="0"), 18, "Frame Time is 0 s"),
        (bvh((1, 2, 3)).replace(" 1 2 3", " 1 2"), 19, "has 8 values, but the skeleton has 9"),
        (bvh((1, 2, 3)).replace(" 1 2 3", " 1 2 nan"), 19, "'nan' is not a number"),
        (bvh((1, 2, 3)).replace("S 3 Z", "S 2 Z"), 9, "expected CHANNELS"),
        (bvh((1, 2, 3)).replace("JOINT Head", "JOINT Hips"), 6, "needs a name that no other"),
        (bvh((1, 2, 3)).replace("JOINT Head", "BONE Head"), 6, "'BONE' is not known"),
        (bvh((1, 2, 3)).replace("}\n}\n", "}\n"), 14, "does not close its braces"),
        (SKELETON, 16, "must be followed by `Frames: N`"),
    ],
)
def test_what_is_wrong_stands_at_its_line(refusal, content, line, said):
    error = refusal(BVH, content)
    assert said in str(error)
    assert error.line == line


def test_a_map_chooses_joints_and_axes(tmp_path):
    (tmp_path / "head.yaml").write_text(
        "robot: head\n"
        "defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180,"
        " accel_max_deg_s2: 600}\n"
        "joints: {neck_yaw: {id: 1}, neck_tilt: {id: 2}}\n"
    )
    (tmp_path / "map.yaml").write_text(
        "others: skip\njoints:\n"
        "  Head.y: {name: neck_yaw}\n  Head.Xrotation: {name: neck_tilt, sign: -1}\n"
    )
    heads = [(0.0, 10.0 * np.sin(0.1 * n), 30.0 * np.sin(0.05 * n)) for n in range(100)]
    (tmp_path / "walk.bvh").write_text(bvh(*heads))
    words = ["walk.bvh", "--robot", "head.yaml", "--map", "map.yaml", "-o", "walk.yaml"]
    paths = [str(tmp_path / word) if "." in word else word for word in words]
    assert main(["import", *paths]) == 0
    show = load_sequence(tmp_path / "walk.yaml")
    assert {joint for key in show.keyframes for joint in key.deg} == {"neck_yaw", "neck_tilt"}
    tilts = [key.deg["neck_tilt"] for key in show.keyframes if "neck_tilt" in key.deg]
    assert min(tilts) == pytest.approx(-10.0, abs=1.0)  # the tolerance of keys
    assert show.keyframes[-1].at_s == pytest.approx(99 * 0.04)
