"""JSON of HULKs, pypot and Blender: times, units, what is not carried over, what is refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from lss_motion.interchange.blender import TENTHS, BlenderReader
from lss_motion.interchange.fields import parsed_json
from lss_motion.interchange.hulks import HulksReader
from lss_motion.interchange.pypot import PypotReader
from lss_motion.interchange.reader import Unit

HULKS = {
    "initial_positions": {"head": {"yaw": 0.0}, "left_arm": {"hand": 0.0}},
    "motion": [
        {
            "keyframes": [
                {"duration": 0.5, "positions": {"head": {"yaw": 0.5}, "left_arm": {"hand": 1.0}}},
                {"duration": 1.0, "positions": {"head": {"yaw": -0.5}}},
            ],
            "exit_condition": {"tolerance": 0.1},
        },
        {"keyframes": [{"duration": 0.25, "positions": {"head": {"yaw": 0.0}}}]},
    ],
}

FRAMES = {"fps": 25, "frames": 4, "file": "a.blend", "positions": [{"0": 10}, {}, {"0": 30}, {}]}


def test_hulks_keyframes_follow_each_other_from_the_initial_positions(read_one) -> None:
    motion = read_one(HulksReader(), json.dumps(HULKS))
    yaw, hand = motion.channels
    assert (yaw.name, yaw.unit) == ("head.yaw", Unit.RAD)
    assert yaw.times_s.tolist() == [0.0, 0.5, 1.5, 1.75]
    assert yaw.values.tolist() == [0.0, 0.5, -0.5, 0.0]
    assert (hand.name, hand.unit) == ("left_arm.hand", Unit.RAW)
    assert hand.times_s.tolist() == [0.0, 0.5]
    assert "Not carried over: motion: exit_condition" in motion.comments


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda k: k.update(duration=0), "motion[0].keyframes[1]: times must increase"),
        (lambda k: k.update(duration=-1), "motion[0].keyframes[1].duration is -1"),
        (lambda k: k.pop("positions"), "motion[0].keyframes[1].positions must be an object"),
        (lambda k: k.update(positions={"head": {"yaw": "x"}}), "positions.head.yaw is 'x'"),
        (lambda k: k.update(positions={"head": 3}), "positions.head must be an object"),
    ],
)
def test_a_wrong_hulks_keyframe_is_refused_with_its_place(refusal, change, reason) -> None:
    content = json.loads(json.dumps(HULKS))
    change(content["motion"][0]["keyframes"][1])
    assert reason in refusal(HulksReader(), json.dumps(content)).reason


def test_pypot_samples_are_sorted_by_their_real_times(read_one) -> None:
    positions = {"1.5": {"neck": [3.0, 0.0]}, "0.5": {"neck": [1.0, 9.0]}, "10": {"neck": [2, 0]}}
    motion = read_one(PypotReader(), json.dumps({"framerate": 50.0, "positions": positions}))
    (neck,) = motion.channels
    assert neck.times_s.tolist() == [0.5, 1.5, 10.0]
    assert neck.values.tolist() == [1.0, 3.0, 2.0]
    assert neck.unit is Unit.DEG
    assert not motion.is_recording
    assert "Not carried over: recorded speeds" in motion.comments


def test_dense_pypot_samples_are_a_recording(read_one) -> None:
    positions = {str(index / 50): {"neck": [index, 0.0]} for index in range(100)}
    motion = read_one(PypotReader(), json.dumps({"framerate": 50.0, "positions": positions}))
    assert motion.is_recording
    assert len(motion.channels[0].times_s) == 100


@pytest.mark.parametrize(
    ("positions", "reason"),
    [
        ({"soon": {"neck": [1.0, 0.0]}}, "positions.soon: the name must be a time"),
        ({"nan": {"neck": [1.0, 0.0]}}, "positions.nan is nan"),
        ({"1": {"neck": []}}, "positions.1.neck is []"),
        ({"1": {"neck": [None, 0.0]}}, "positions.1.neck is None"),
        ({"1": {"neck": [1.0, 0]}, "1.0": {"neck": [2.0, 0]}}, "times must increase"),
        ({"1": {}}, "moves no joint"),
        ({}, "moves no joint"),
        ([], "positions must be an object"),
    ],
)
def test_wrong_pypot_positions_are_refused_with_their_place(refusal, positions, reason) -> None:
    content = json.dumps({"framerate": 50.0, "positions": positions})
    assert reason in refusal(PypotReader(), content).reason


def test_a_blender_servo_that_a_frame_does_not_name_stays(read_one) -> None:
    motion = read_one(BlenderReader(), json.dumps(FRAMES))
    (servo,) = motion.channels
    assert (servo.name, servo.unit) == ("0", Unit.RAW)
    assert servo.times_s.tolist() == [0.0, 0.04, 0.08, 0.12]
    assert servo.values.tolist() == [10.0, 10.0, 30.0, 30.0]
    assert motion.is_recording
    assert "file: a.blend" in motion.comments


def test_a_blender_servo_begins_with_the_first_frame_that_names_it(read_one) -> None:
    content = FRAMES | {"positions": [{"0": 1}, {"0": 1, "7": 5}, {"0": 2}]}
    late = read_one(BlenderReader(), json.dumps(content)).channels[1]
    assert (late.name, late.times_s.tolist(), late.values.tolist()) == ("7", [0.04, 0.08], [5, 5])


def test_version_1_of_the_blender_format_lists_positions_by_servo(read_one) -> None:
    servos = {"3": {"name": "Jaw", "positions": [1, 2, 3]}}
    (jaw,) = read_one(BlenderReader(), json.dumps({"fps": 10, "servos": servos})).channels
    assert (jaw.name, jaw.times_s.tolist(), jaw.values.tolist()) == ("3", [0, 0.1, 0.2], [1, 2, 3])


def test_a_blender_file_of_ours_says_its_unit_and_its_joints(read_one) -> None:
    content = FRAMES | {"unit": TENTHS, "names": {"0": "elbow"}}
    (elbow,) = read_one(BlenderReader(), json.dumps(content)).channels
    assert (elbow.name, elbow.unit) == ("elbow", Unit.DEG)
    assert elbow.values.tolist() == [1.0, 1.0, 3.0, 3.0]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"fps": 0}, "fps is 0"),
        ({"fps": "25"}, "the file.fps is '25'"),
        ({"positions": [{"0": 1}, [1]]}, "positions[1] must be an object"),
        ({"positions": [{"0": 1}, {"0": "a"}]}, "positions[1].0 is 'a'"),
        ({"positions": [{}, {}]}, "names no servo"),
        ({"positions": []}, "list 'positions' with at least one entry"),
        ({"servos": {}}, "servos names no servo"),
        ({"servos": {"1": {"positions": []}}}, "servos.1 must have a list 'positions'"),
    ],
)
def test_a_wrong_blender_file_is_refused_with_its_place(refusal, change, reason) -> None:
    assert reason in refusal(BlenderReader(), json.dumps(FRAMES | change)).reason


def test_ten_megabytes_of_samples_are_read(read_one) -> None:
    motors = ",".join(f'"joint_{n}":[12.34,0.0]' for n in range(20))
    rows = ",".join(f'"{index / 100}":{{{motors}}}' for index in range(20_000))
    text = f'{{"framerate":100,"positions":{{{rows}}}}}'
    motion = read_one(PypotReader(), text)
    assert [len(channel.times_s) for channel in motion.channels] == [20_000] * 20
    np.testing.assert_array_equal(motion.channels[0].values, 12.34)


def test_json_numbers_are_what_they_say(tmp_path) -> None:
    assert parsed_json(tmp_path, b'{"a": [1, -2.5e1, true, null]}') == {"a": [1, -25.0, True, None]}
    assert math.isinf(parsed_json(tmp_path, b"[1e999]")[0])  # Refused where it is used.
