"""Moves of Reachy Mini: the turn of the head, body and antennas, and errors."""

from __future__ import annotations

import json
import math

import pytest

from lss_motion.interchange.json_motions import REACHY
from lss_motion.interchange.reader import Measure

C, S = math.cos(0.3), math.sin(0.3)
STRAIGHT = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.01], [0, 0, 0, 1]]
TURNS = {
    "head_roll": [[1, 0, 0, 0], [0, C, -S, 0], [0, S, C, 0], [0, 0, 0, 1]],
    "head_pitch": [[C, 0, S, 0], [0, 1, 0, 0], [-S, 0, C, 0], [0, 0, 0, 1]],
    "head_yaw": [[C, -S, 0, 0], [S, C, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
}


def move(**changes) -> dict:
    frames = [
        {"head": STRAIGHT, "antennas": [0.1, -0.2], "body_yaw": 0.2, "check_collision": False},
        {"head": STRAIGHT, "antennas": [0.2, -0.2], "body_yaw": 0.1},
    ]
    return {"description": "nods", "time": [0, 0.5], "set_target_data": frames, **changes}


@pytest.mark.parametrize("angle", TURNS)
def test_the_turn_of_the_head_about_each_axis(read_one, angle: str) -> None:
    content = move()
    content["set_target_data"][1]["head"] = TURNS[angle]
    motion = read_one(REACHY, json.dumps(content))
    values = {channel.name: channel.values.tolist() for channel in motion.channels}
    assert {name for name in TURNS if values[name][1] != pytest.approx(0.0)} == {angle}
    assert values[angle][1] == pytest.approx(math.degrees(0.3))
    assert all(channel.unit is Measure.DEG for channel in motion.channels)
    assert "description: nods" in motion.comments


def test_body_and_antennas_are_angles_and_a_flat_matrix_is_one(read_one) -> None:
    content = move()
    for frame in content["set_target_data"]:
        frame["head"] = [value for row in STRAIGHT for value in row]
    motion = read_one(REACHY, json.dumps(content))
    values = {channel.name: channel.values.tolist() for channel in motion.channels}
    assert values["body_yaw"] == pytest.approx([math.degrees(0.2), math.degrees(0.1)])
    assert values["antenna_1"] == pytest.approx([math.degrees(0.1), math.degrees(0.2)])
    assert values["antenna_2"] == pytest.approx([math.degrees(-0.2)] * 2)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"time": [0]}, "has 2 frames for 1 time"),
        ({"time": [0, "x"]}, "time[1] is 'x', but must be a number"),
        ({"time": [0.5, 0.5]}, "times must increase"),
        ({"set_target_data": []}, "must have a list 'set_target_data'"),
        ({"set_target_data": [{"head": [[2] * 4] * 4}] * 2}, "[0].head is no rotation"),
        ({"set_target_data": [{"head": [1, 2]}] * 2}, "[0].head must be a matrix of 4 x 4"),
        ({"set_target_data": [{"antennas": 3}] * 2}, "[0].antennas must be a list of numbers"),
        ({"set_target_data": [{}, {}]}, "moves no joint"),
    ],
)
def test_a_wrong_move_is_refused_with_its_place(refusal, changes, reason: str) -> None:
    assert reason in refusal(REACHY, json.dumps(move(**changes))).reason
