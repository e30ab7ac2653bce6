"""ROS: messages, collections, wrappings, times in both forms, joints that may slide."""

from __future__ import annotations

import re

import pytest

from lss_motion.interchange.reader import ForeignMotion, Measure, RefusedMotion
from lss_motion.interchange.ros import ROS
from lss_motion.interchange.yaml_nodes import NODES_MAX
from tests.unit.interchange.conftest import PATH

MESSAGE = """\
joint_names: [a, b]
points:
- positions: [0.0, 1.0]
  velocities: [0.5, 0.5]
  time_from_start: {sec: 0, nanosec: 0}
- positions: [0.5, -1.0]
  time_from_start: {sec: 1, nanosec: 500000000}
"""
COLLECTION = """\
/play_motion2:
  ros__parameters:
    motions:
      wave:
        joints: [a, torso_lift_joint]
        positions: [0.0, 0.1,
                    1.0, 0.2]
        times_from_start: [0.5, 2]
        meta: {name: Wave, usage: demo}
      broken:
        joints: [a, b]
        positions: [1, 2, 3]
        times_from_start: [0.5, 2]
      nothing:
        positions: [1]
"""


def test_a_message_has_times_in_seconds_and_nanoseconds(read_one) -> None:
    motion = read_one(ROS, MESSAGE)
    a, b = motion.channels
    assert (a.name, a.unit, a.times_s.tolist()) == ("a", Measure.RAD, [0.0, 1.5])
    assert b.values.tolist() == [1.0, -1.0]
    assert "Not carried over: velocities" in motion.comments
    assert motion.keyframes[1].deg["a"] == pytest.approx(28.647890)


@pytest.mark.parametrize("key", ["trajectory", "joint_trajectory", "goal"])
def test_a_message_may_be_inside_the_keys_of_an_action(read_one, key: str) -> None:
    inside = "".join(f"  {line}\n" for line in MESSAGE.splitlines())
    wrapped = read_one(ROS, f"header: {{stamp: 0}}\n{key}:\n{inside}")
    assert [c.values.tolist() for c in wrapped.channels] == [[0.0, 0.5], [1.0, -1.0]]


POINT = """\
header: {{stamp: {{sec: {sec}, nanosec: 500000000}}, frame_id: ''}}
joint_names: [a, b]
points:
- positions: [{a}, 0.5]
  velocities: []
  time_from_start: {{sec: 1, nanosec: 0}}
---
"""


def test_each_message_of_an_echo_is_a_motion() -> None:
    echo = MESSAGE + "---\n" + MESSAGE + "---\nx: 1\n"
    first, second, third = ROS.motions(PATH, echo.encode())
    assert isinstance(first, ForeignMotion)
    assert isinstance(second, ForeignMotion)
    assert isinstance(third, RefusedMotion)
    assert [first.name, second.name] == ["message 1", "message 2"]
    assert len(second.channels[0].times_s) == 2
    assert third.error.line == MESSAGE.count("\n") * 2 + 3


def test_single_points_with_increasing_stamps_are_one_motion(read_one) -> None:
    a, b = read_one(ROS, "".join(POINT.format(sec=5 + n, a=n / 10) for n in range(3))).channels
    assert a.times_s.tolist() == [6.5, 7.5, 8.5]
    assert (a.values.tolist(), b.values.tolist()) == ([0.0, 0.1, 0.2], [0.5, 0.5, 0.5])
    standing = "".join(POINT.format(sec=5, a=n / 10) for n in range(3))
    assert len(ROS.motions(PATH, standing.encode())) == 3


def test_what_an_echo_leaves_out_is_named(refusal) -> None:
    error = refusal(ROS, MESSAGE + "- '...'\n---\n")
    assert "write it with --full-length" in error.reason
    assert error.line == MESSAGE.count("\n") + 1


def test_a_collection_gives_its_motions_and_the_errors_of_wrong_ones(tmp_path) -> None:
    wave, broken, nothing = ROS.motions(tmp_path, COLLECTION.encode())
    assert isinstance(wave, ForeignMotion)
    assert [(c.name, c.unit) for c in wave.channels] == [
        ("a", Measure.RAD),
        ("torso_lift_joint", Measure.RAD_OR_M),
    ]
    assert wave.channels[0].times_s.tolist() == [0.5, 2.0]
    assert wave.channels[1].values.tolist() == [0.1, 0.2]
    assert "usage: demo" in wave.comments
    assert isinstance(broken, RefusedMotion)
    assert isinstance(nothing, RefusedMotion)
    assert str(broken.error) == f"{tmp_path}:12: 3 positions are not 2 times 2 joints"
    assert str(nothing.error) == f"{tmp_path}:15: motion 'nothing' has no 'joints'"


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("[0.5, -1.0]", "[0.5]", 6, "point 2 has 1 position for 2 joints"),
        ("[0.5, -1.0]", "[0.5, .nan]", 6, "'.nan' is not a number, or out of range"),
        ("[0.5, -1.0]", "[0.5, nan]", 6, "'nan' is not a number, or out of range"),
        ("[0.5, -1.0]", "[0.5, 1e99]", 6, "'1e99' is not a number, or out of range"),
        ("sec: 1, nanosec: 500000000", "sec: 0", 6, "times must increase"),
        ("{sec: 1, nanosec: 500000000}", "soon", 7, "'soon' is not a number"),
        ("sec: 1, nano", "nano", 7, "a time must be seconds, or {sec"),
        ("- positions: [0.5, -1.0]\n  ", "- ", 6, "point 2 has no 'positions'"),
        ("[a, b]", "[a, a]", 1, "joint 'a' is listed twice"),
        ("[a, b]", "[]", 1, "the list of joints must be a list with at least one entry"),
        ("[a, b]", "[a, b", 2, "not YAML"),
        ("[a, b]", "!!python/object/apply:os.system [b]", 1, "which is not allowed"),
        ("[a, b]", "[a, b]\njoint_names: [c]", 2, "'joint_names' is given twice"),
        ("[a, b]", "*a", 1, "alias *a has no anchor before it"),
        ("[a, b]", "[" * 100_000, 1, "nested more than 16 deep"),
    ],
)
def test_a_wrong_message_is_refused_with_its_line(refusal, old, new, line, reason) -> None:
    error = refusal(ROS, MESSAGE.replace(old, new, 1))
    assert (error.line, reason in error.reason) == (line, True), error


def test_the_content_of_aliases_is_bounded(refusal) -> None:
    text = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    for level in range(1, 9):
        text += f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]\n"
    assert f"more than {NODES_MAX:,}" in refusal(ROS, text + MESSAGE).reason


def test_a_file_without_a_motion_is_refused(refusal) -> None:
    assert "'joint_names' and 'points', or 'motions'" in refusal(ROS, "a: 1\n").reason
    assert "is empty" in refusal(ROS, "# nothing\n").reason
    assert "'motions' holds no motion" in refusal(ROS, "motions: {}\n").reason


PUBLISHER = """\
publisher_joint_trajectory_controller:
  ros__parameters:
    controller_name: "arm_controller"
    wait_sec_between_publish: 6
    repeat_the_same_goal: 1
    goal_names: ["pos1", "pos2", "pos1"]
    pos1:
      positions: [0.5, -0.25]
    pos2: {positions: [0.0, 1.0], time_from_start: {sec: 2, nanosec: 500000000}}
    joints:
      - joint1
      - joint2
"""


def test_the_goals_of_a_publisher_are_poses_at_the_times_at_which_it_sends_them(read_one) -> None:
    motion = read_one(ROS, PUBLISHER)
    first, second, third = motion.keyframes
    assert [k.at_s for k in motion.keyframes] == [4.0, 8.5, 16.0]
    assert [k.hold_s for k in motion.keyframes] == [2.0, 3.5, 2.0]
    assert [k.label for k in motion.keyframes] == ["pos1", "pos2", "pos1"]
    assert first.deg == third.deg
    assert second.deg == {"joint1": 0.0, "joint2": pytest.approx(57.29578)}
    assert "Not carried over: repeat_the_same_goal" in motion.comments


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("between_publish: 6", "between_publish: 0", 10, "above 0 s"),
        ('"pos2"', '"pos3"', 6, "pos3.* does not exist"),
        ("[0.0, 1.0]", "[0.0]", 9, "1 position for 2 joints"),
        ("    joints:\n      - joint1\n      - joint2\n", "", 6, "'joints'"),
    ],
)
def test_goals_that_do_not_fit_are_refused_with_their_line(refusal, old, new, line, reason) -> None:
    error = refusal(ROS, PUBLISHER.replace(old, new))
    assert re.search(reason, error.reason)
    assert error.line in (line, line + 1)


@pytest.mark.parametrize("time", ["[1, 500000000]", "{secs: 1, nsecs: 500000000}", "1.5"])
def test_a_time_has_the_forms_of_both_generations(read_one, time: str) -> None:
    text = MESSAGE.replace("{sec: 1, nanosec: 500000000}", time)
    assert read_one(ROS, text).channels[0].times_s.tolist() == [0.0, 1.5]


def test_a_time_of_a_list_of_three_is_refused(refusal) -> None:
    text = MESSAGE.replace("{sec: 1, nanosec: 500000000}", "[1, 2, 3]")
    assert "must be [seconds, nanoseconds]" in refusal(ROS, text).reason


def test_an_echo_of_joint_states_is_a_recording(read_one, refusal) -> None:
    text = "".join(
        f"header:\n  stamp:\n    sec: {1700000000 + n // 20}\n    nanosec: {n % 20 * 50_000_000}\n"
        f"  frame_id: ''\nname:\n- a\n- b\nposition:\n- {n / 100}\n- 0.5\nvelocity: []\n"
        "effort: []\n---\n"
        for n in range(40)
    )
    motion = read_one(ROS, text)
    a, b = motion.channels
    assert motion.is_recording
    assert (a.name, a.unit, len(a.values)) == ("a", Measure.RAD, 40)
    assert a.times_s[39] - a.times_s[0] == pytest.approx(1.95, abs=1e-6)
    assert set(b.values.tolist()) == {0.5}
    assert "'header'" in refusal(ROS, text.replace("header:", "top:")).reason
