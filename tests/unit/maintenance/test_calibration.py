from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from lss_motion.maintenance.settings import JointFrame, frame_of, moved_origin
from lss_motion.robot.load import load_robot
from lss_motion.robot.write import write_frames, write_pose

ARM = Path(__file__).resolve().parents[3] / "sequences" / "robots" / "desk_arm.yaml"


@pytest.fixture
def joint():
    return load_robot(ARM).joints["base"]


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("pose_deg", [0.0, 45.0, -60.0])
@pytest.mark.parametrize("zero_deg", [0.0, 12.3, -170.5])
def test_the_frame_of_a_joint_is_found_for_any_file(joint, direction, pose_deg, zero_deg):
    true = replace(joint, zero_deg=zero_deg, direction=direction)
    found = frame_of(
        joint,
        servo_deg=true.servo_deg(pose_deg),
        pose_deg=pose_deg,
        pushed_deg=true.servo_deg(pose_deg + 9.0),
    )
    assert found == JointFrame(zero_deg=pytest.approx(zero_deg), direction=direction)


def test_too_small_a_push_gives_no_frame_and_none_keeps_the_direction(joint):
    assert frame_of(joint, servo_deg=10.0, pose_deg=0.0, pushed_deg=14.0) is None
    kept = frame_of(replace(joint, direction=-1), servo_deg=10.0, pose_deg=30.0, pushed_deg=None)
    assert kept == JointFrame(zero_deg=40.0, direction=-1)


@pytest.mark.parametrize("gyre", [1, -1])
@pytest.mark.parametrize(("origin", "zero_deg"), [(0, 20.0), (-150, -33.3), (1700, 90.0)])
def test_with_the_moved_origin_the_servo_reports_0_at_its_old_zero(joint, gyre, origin, zero_deg):
    raw = gyre * zero_deg * 10 + origin  # It said gyre * (raw - origin).
    moved = moved_origin(joint, origin_wire=origin, gyre=gyre, zero_deg=zero_deg)
    assert -1800 <= moved < 1800
    assert (gyre * (raw - moved)) % 3600 == pytest.approx(0.0)


def test_frames_and_poses_change_nothing_else_in_a_robot_file(tmp_path):
    path = tmp_path / "robot.yaml"
    before = ARM.read_text(encoding="utf-8")
    path.write_text(before, encoding="utf-8")
    write_frames(path, {"base": (12.5, -1), "shoulder": (0.0, -1)}, {"base": {"G": -1.0}})
    write_pose(path, "pick", {"base": 10.5, "elbow": -20.0})
    write_pose(path, "home", {"base": 3.0})
    after = path.read_text(encoding="utf-8")
    changed = set(after.splitlines()) - set(before.splitlines())
    assert len(changed) == 3
    assert [line for line in before.splitlines() if "#" in line] == [
        line for line in after.splitlines() if "#" in line
    ]
    robot = load_robot(path)
    assert (robot.joints["base"].zero_deg, robot.joints["base"].direction) == (12.5, -1)
    assert robot.poses["pick"] == {"base": 10.5, "elbow": -20.0}
    assert robot.poses["home"]["base"] == 3.0
    assert robot.poses["home"]["elbow"] == -60.0


def test_a_file_without_poses_gets_its_first(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(
        "robot: one  # mine\njoints:\n  a: {id: 1, model: LSS-ST1, range_deg: [-9, 9], "
        "speed_max_deg_s: 90, accel_max_deg_s2: 90}  # the only one\n"
    )
    write_pose(path, "up", {"a": 4.5})
    assert load_robot(path).poses == {"up": {"a": 4.5}}
    assert path.read_text().count("#") == 2
