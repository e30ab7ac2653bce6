"""HULKs motion JSON: times, units, and what is not carried over."""

from __future__ import annotations

import json

import pytest

from lss_motion.interchange.json_motions import HULKS
from lss_motion.interchange.reader import Measure

SAMPLE = {
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


def test_hulks_keyframes_follow_each_other_from_the_initial_positions(read_one) -> None:
    motion = read_one(HULKS, json.dumps(SAMPLE))
    yaw, hand = motion.channels
    assert (yaw.name, yaw.unit) == ("head.yaw", Measure.RAD)
    assert yaw.times_s.tolist() == [0.0, 0.5, 1.5, 1.75]
    assert yaw.values.tolist() == [0.0, 0.5, -0.5, 0.0]
    assert (hand.name, hand.unit) == ("left_arm.hand", Measure.RAW)
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
    content = json.loads(json.dumps(SAMPLE))
    change(content["motion"][0]["keyframes"][1])
    assert reason in refusal(HULKS, json.dumps(content)).reason


def test_initial_positions_may_stand_beside_stiffnesses(read_one) -> None:
    content = json.loads(json.dumps(SAMPLE))
    plain = read_one(HULKS, json.dumps(content))
    content["initial_positions"] = {
        "positions": content["initial_positions"],
        "stiffnesses": {"head": {"yaw": 0.8}},
    }
    content["interpolation_mode"] = "Linear"
    content["motion"][0]["interpolation_mode"] = "Spline"
    motion = read_one(HULKS, json.dumps(content))
    for own, other in zip(motion.channels, plain.channels, strict=True):
        assert own.name == other.name
        assert own.values.tolist() == other.values.tolist()
    assert "Not carried over: initial_positions: stiffnesses" in motion.comments
    for mode in ("Linear", "Spline"):
        assert any(f"interpolation_mode {mode};" in text for text in motion.comments)


def test_keyframes_of_jumps_have_stiffnesses_beside_their_positions(read_one) -> None:
    """Nested as `jump_left.json` of the team, with stiffnesses once more among the groups."""
    plain = read_one(HULKS, json.dumps(SAMPLE))
    content = json.loads(json.dumps(SAMPLE))
    stiffnesses = {"head": {"yaw": 0.9}}
    start = {**content["initial_positions"], "stiffnesses": stiffnesses}
    content["initial_positions"] = {"positions": start, "stiffnesses": stiffnesses}
    for part in content["motion"]:
        for keyframe in part["keyframes"]:
            positions = keyframe["positions"]
            keyframe["positions"] = {"positions": positions, "stiffnesses": stiffnesses}
    motion = read_one(HULKS, json.dumps(content))
    assert [channel.name for channel in motion.channels] == ["head.yaw", "left_arm.hand"]
    for own, other in zip(motion.channels, plain.channels, strict=True):
        assert own.times_s.tolist() == other.times_s.tolist()
        assert own.values.tolist() == other.values.tolist()
    assert set(motion.comments[1:]) == {
        "Not carried over: initial_positions: stiffnesses",
        "Not carried over: keyframes: stiffnesses",
        "Not carried over: motion: exit_condition",
    }


def test_a_condition_among_the_frames_is_listed(read_one) -> None:
    frames = [*SAMPLE["motion"][0]["keyframes"]]
    frames.insert(1, {"StabilizedCondition": {"tolerance": 0.1, "timeout_duration": 5.0}})
    content = {"initial_positions": SAMPLE["initial_positions"], "frames": frames}
    motion = read_one(HULKS, json.dumps(content))
    assert motion.channels[0].times_s.tolist() == [0.0, 0.5, 1.5]
    assert "Not carried over: StabilizedCondition" in motion.comments


def test_older_files_have_one_list_of_frames(read_one) -> None:
    frames = SAMPLE["motion"][0]["keyframes"]
    content = {"initial_positions": SAMPLE["initial_positions"], "frames": frames}
    motion = read_one(HULKS, json.dumps(content))
    assert motion.channels[0].times_s.tolist() == [0.0, 0.5, 1.5]
    assert not any("Not carried over" in text for text in motion.comments)
