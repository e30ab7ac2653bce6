"""Blender JSON: both versions, missing positions, exported files, and errors."""

from __future__ import annotations

import json

import pytest

from lss_motion.interchange.json_motions import BLENDER, TENTHS
from lss_motion.interchange.reader import Measure

FRAMES = {"fps": 25, "frames": 4, "file": "a.blend", "positions": [{"0": 10}, {}, {"0": 30}, {}]}


def test_a_blender_servo_that_is_missing_in_a_frame_keeps_its_position(read_one) -> None:
    motion = read_one(BLENDER, json.dumps(FRAMES))
    (servo,) = motion.channels
    assert (servo.name, servo.unit) == ("0", Measure.RAW)
    assert servo.times_s.tolist() == [0.0, 0.04, 0.08, 0.12]
    assert servo.values.tolist() == [10.0, 10.0, 30.0, 30.0]
    assert motion.is_recording
    assert "file: a.blend" in motion.comments


def test_a_blender_servo_begins_with_its_first_frame(read_one) -> None:
    content = FRAMES | {"positions": [{"0": 1}, {"0": 1, "7": 5}, {"0": 2}]}
    late = read_one(BLENDER, json.dumps(content)).channels[1]
    assert (late.name, late.times_s.tolist(), late.values.tolist()) == ("7", [0.04, 0.08], [5, 5])


def test_version_1_of_the_blender_format_lists_positions_by_servo(read_one) -> None:
    servos = {"3": {"name": "Jaw", "positions": [1, 2, 3]}}
    (jaw,) = read_one(BLENDER, json.dumps({"fps": 10, "servos": servos})).channels
    assert (jaw.name, jaw.times_s.tolist(), jaw.values.tolist()) == ("3", [0, 0.1, 0.2], [1, 2, 3])


def test_an_exported_blender_file_has_its_unit_and_its_joints(read_one) -> None:
    content = FRAMES | {"unit": TENTHS, "names": {"0": "elbow"}}
    (elbow,) = read_one(BLENDER, json.dumps(content)).channels
    assert (elbow.name, elbow.unit) == ("elbow", Measure.DEG)
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
    assert reason in refusal(BLENDER, json.dumps(FRAMES | change)).reason
