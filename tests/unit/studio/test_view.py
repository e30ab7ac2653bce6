"""The view of a plan, against the plan and the program themselves."""

from __future__ import annotations

import base64
import json
import math
import wave
from pathlib import Path

import numpy as np
import pytest

import lss_motion as lss
from lss_motion.planning.program.verify import driven, profiles
from lss_motion.planning.shows import Show
from lss_motion.robot.profile import profile_lead_s
from lss_motion.studio.view import ViewWindow, view_of
from lss_motion.studio.view_curves import Curve

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"
SHOWS = ("wave", "tracks", "playlist", "owl", "fastest")


def planned(source):
    sequence = lss.load_sequence(source)
    robot = lss.load_robot(sequence.robot_path)
    trajectory = lss.plan(sequence, robot)
    return sequence, trajectory, lss.compile(trajectory, robot), robot


def viewed(values):
    sequence, trajectory, program, robot = values
    show = Show(robot=robot, program=program, trajectory=trajectory, sequence=sequence)
    return json.loads(json.dumps(view_of(show, "0123456789abcdef"), allow_nan=False))


@pytest.fixture(scope="module", params=SHOWS)
def show(request):
    values = planned(EXAMPLES / f"{request.param}.yaml")
    return *values, viewed(values)


def unpacked(text, kind):
    return np.frombuffer(base64.b64decode(text), dtype=kind).astype(float)


def curve_of(entry):
    times_s = unpacked(entry["times_s"], "<f8")
    return Curve(times_s, unpacked(entry["deg"], "<f4"), unpacked(entry["deg_s"], "<f4"))


def test_curves_are_the_plan_and_the_predicted_horn(show):
    _, trajectory, program, robot, view = show
    robot = driven(robot, program)
    horns = profiles(program, robot)
    times_s = np.linspace(0.0, view["view_s"], 4001)
    for column, joint in enumerate(view["joints"]):
        name = joint["name"]
        plan = curve_of(view["curves"][name]["plan"])
        limits = 0.05, 0.02 * joint["speed_max_deg_s"], 0.05 * joint["accel_max_deg_s2"]
        for order, allowed in enumerate(limits):
            off = np.abs(plan.at(times_s, order) - trajectory.sample(times_s, order)[:, column])
            # Where the acceleration jumps, either side may be given.
            assert np.quantile(off, 0.98 if order == 2 else 1.0) < allowed, (name, order)
        own = robot.joints[name]
        servo_deg = horns[name].sample(times_s - profile_lead_s(own))
        horn_deg = own.direction * (servo_deg - own.zero_deg)
        predicted = curve_of(view["curves"][name]["predicted"])
        assert np.abs(predicted.at(times_s) - horn_deg).max() < 0.1, name
        assert view["error"][name]["max_deg"] == pytest.approx(
            program.error_max_deg[name], abs=0.03, rel=0.1
        )


def test_every_key_is_in_a_lane_and_the_plan_is_there_at_its_time(show):
    sequence, _, _, _, view = show
    keyed = {name for lane in view["lanes"] for name in lane["joints"]}
    assert keyed == {joint["name"] for joint in view["joints"]}
    for lane in view["lanes"]:
        assert lane["keys"] == sorted(lane["keys"], key=lambda key: key["at_s"])
        if lane["kind"] == "layer" or sequence.layers:
            continue  # What counts there is the sum.
        for key in lane["keys"]:
            for name, deg in key["deg"].items():
                plan = curve_of(view["curves"][name]["plan"])
                ends_s = np.array([key["at_s"], key["at_s"] + key["hold_s"]])
                assert plan.at(ends_s) == pytest.approx(deg, abs=0.01), (name, key)
                assert key["line"], key


def test_the_lanes_hold_as_many_keys_as_the_file_in_each_pass():
    values = planned(EXAMPLES / "wave.yaml")
    view = viewed(values)
    (lane,) = view["lanes"]
    assert len(lane["keys"]) == 3 * len(values[0].keyframes)
    assert [key["at_s"] for key in lane["keys"] if key["is_anchor"]] == [6.5, 13.0, 19.5]
    assert sorted(mark["at_s"] for mark in view["marks"] if mark["label"] == "wave") == [
        2.0,
        8.5,
        15.0,
    ]


def test_the_lanes_of_a_play_list_stand_where_its_parts_are_played():
    values = planned(EXAMPLES / "playlist.yaml")
    view = viewed(values)
    kinds = {(lane["kind"], lane["name"]) for lane in view["lanes"]}
    assert {("layer", "nod"), ("part", "greet")} <= kinds
    nod = next(lane for lane in view["lanes"] if lane["kind"] == "layer")
    marks = {round(mark.planned_s, 3) for mark in values[1].marks}
    assert marks >= {round(key["at_s"], 3) for key in nod["keys"] if key["at_s"] <= 3.0}
    assert nod["is_added"]
    assert nod["file"] == "parts/nod.yaml"
    times = [round(key["at_s"], 3) for key in nod["keys"]]
    assert times == [
        *(1.0, 1.5, 2.0, 2.5, 3.0, 3.0, 3.5, 4.0, 4.5, 5.0),
        *(9.0, 9.5, 10.0, 10.5, 11.0, 11.0, 11.5, 12.0, 12.5, 13.0),
    ], "both passes of both layers"
    for lane in view["lanes"]:
        for key in lane["keys"] if lane["kind"] == "part" else ():
            for name, deg in key["deg"].items():
                plan = curve_of(view["curves"][name]["plan"])
                is_there = abs(plan.at(np.array([key["at_s"]]))[0] - deg) < 0.02
                assert is_there or name.startswith("Head"), (lane["name"], name, key)


def keys_of(joint, *at_deg):
    return [{"at_s": at_s, "deg": {joint: deg}} for at_s, deg in at_deg]


SWING = keys_of("shoulder", (0.0, 0.0), (0.6, 20.0), (1.2, 0.0))
FAST = keys_of("shoulder", (0.0, 0.0), (0.2, 30.0), (0.4, 0.0))
BASE = keys_of("base", (0.0, 0.0), (3.0, 60.0), (6.0, 0.0))
LUNGE = keys_of("base", (0.0, 0.0), (0.3, 80.0), (0.6, 0.0))
NOD = {"elbow": {"keyframes": keys_of("elbow", (0.0, 0.0), (0.5, 9.0), (1.0, 0.0)), "loop": 4}}
PAIR = [{"file": "swing.yaml"}, {"pause_s": 0.25}, {"file": "nod.yaml"}]


def added(**more):
    return {"layers": [{"file": "layer.yaml", "from_s": 0.5, **more}]}


LAYERED = {
    "a layer that loops": ({"keyframes": BASE, **added()}, {"keyframes": SWING, "loop": 3}, 3 * 3),
    "one that never ends": (
        {"keyframes": BASE, **added(from_s=0)}, {"keyframes": SWING, "loop": "forever"}, 5 * 3,
    ),
    "one that is cut": (
        {"keyframes": BASE, **added(to_s=2.9)}, {"keyframes": SWING, "loop": "forever"}, 2 * 3,
    ),
    "one that starts from rest": (
        {"keyframes": BASE, **added()}, {"keyframes": FAST, "loop": 4}, 4 * 3,
    ),
    "one with a track that loops": (
        {"keyframes": BASE, **added()}, {"keyframes": SWING, "tracks": NOD}, 3 + 4 * 3,
    ),
    "one that is a play list, twice": (
        {"keyframes": BASE, **added()}, {"play": PAIR, "loop": 2}, 2 * (3 + 3),
    ),
    "below it a show that loops": (
        {"keyframes": BASE, "loop": 3, **added()}, {"keyframes": SWING, "loop": 2}, 2 * 3,
    ),
    "neither ever ends": (
        {"keyframes": BASE, "loop": "forever", **added(from_s=0)},
        {"keyframes": SWING, "loop": "forever"}, None,
    ),
    "only some of its joints": (
        {"keyframes": BASE, **added(joints=["shoulder"])},
        {"keyframes": SWING, "tracks": NOD, "loop": 3}, 3 * 3,
    ),
    "the sum is slowed": (
        {"keyframes": BASE, "layers": [
            {"file": "layer.yaml"}, {"file": "lunge.yaml", "mode": "add", "from_s": 1.0},
        ]},
        {"keyframes": SWING, "loop": 4}, 4 * 3,
    ),
    "some joints keep their time": (
        {"keyframes": BASE, "keep": {"shoulder": "time"}, "layers": [
            {"file": "layer.yaml"}, {"file": "lunge.yaml", "mode": "add", "from_s": 1.0},
        ]},
        {"keyframes": SWING, "loop": 4}, 4 * 3,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", LAYERED)
def test_keys_of_layers_stand_on_the_plan_in_every_pass(tmp_path, case):
    """Each key of a layer that replaces angles is where the plan is at its angle."""
    robot = str(EXAMPLES / "robots" / "desk_arm.yaml")
    show, layer, count = LAYERED[case]
    files = {
        "show": show, "layer": layer, "lunge": {"keyframes": LUNGE},
        "swing": {"keyframes": SWING}, "nod": NOD["elbow"] | {"loop": 1},
    }  # fmt: skip
    for name, content in files.items():
        text = json.dumps({"sequence": name, "robot": robot, **content})
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    values = planned(tmp_path / "show.yaml")
    view = viewed(values)
    lanes = [lane for lane in view["lanes"] if lane["kind"] == "layer" and not lane["is_added"]]
    keys = [key for lane in lanes for key in lane["keys"]]
    for key in keys:
        for name, deg in key["deg"].items():
            plan = curve_of(view["curves"][name]["plan"])
            assert plan.at(np.array([key["at_s"]])) == pytest.approx(deg, abs=0.02), key
    assert {lane["file"] for lane in lanes} <= {"layer.yaml", "swing.yaml", "nod.yaml"}
    if count is not None:
        assert len(keys) == count
        own = [lane for lane in view["lanes"] if lane["kind"] == "track"]
        assert len(own[0]["keys"]) == 3 * show.get("loop", 1), "the show itself"
        return
    times_s = [key["at_s"] for key in keys]
    assert max(times_s) == pytest.approx(view["view_s"])
    assert len(times_s) == 1 + 3 * round(view["view_s"] / 1.2), "the next pass begins at its end"


def test_the_line_is_used_as_long_as_the_bytes_take(show):
    _, _, program, robot, view = show
    for bus, use in view["line"].items():
        sent_s = sum(
            10 * len(move.data) / robot.buses[bus].baud_bps
            for move in program.moves
            if move.bus == bus
        )
        busy_s = use["step_s"] * unpacked(use["use_ratio"], "<f4").sum()
        assert busy_s == pytest.approx(sent_s, rel=1e-3)


def fast(tmp_path, **more):
    """Return the file of a show with a move that is too fast for its joint."""
    keyframes = [
        {"at_s": 0.0, "deg": {"base": 0}},
        {"at_s": 0.3, "deg": {"base": 60}, "label": "there"},
        {"at_s": 3.0, "deg": {"base": 0}},
    ]
    robot = str(EXAMPLES / "robots" / "desk_arm.yaml")
    path = tmp_path / "fast.yaml"
    content = {"sequence": "fast", "robot": robot, "keyframes": keyframes, **more}
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_a_stretched_span_names_joint_and_limit_and_the_authored_angle_stays(tmp_path):
    values = planned(fast(tmp_path))
    view = viewed(values)
    (span,) = view["stretched"]
    assert span["joint"] == "base"
    assert span["text"] == values[1].stretched[0].text
    key = view["lanes"][0]["keys"][1]
    assert key["at_s"] > key["authored_s"] + 0.01
    authored = curve_of(view["curves"]["base"]["authored"])
    assert authored.at(np.array([0.3])) == pytest.approx(60.0, abs=0.2)
    assert curve_of(view["curves"]["base"]["plan"]).at(np.array([0.3])) < 59.0


def test_given_up_angle_has_its_text_and_what_was_asked(tmp_path):
    values = planned(fast(tmp_path, keep="time"))
    view = viewed(values)
    assert view["stretched"] == []
    assert [span["text"] for span in view["given_up"]] == [s.text for s in values[1].given_up]
    asked = unpacked(view["asked"][0]["deg"], "<f4")
    assert asked.max() > 59.0


@pytest.mark.parametrize(("loop", "times"), [("forever", None), (500, 497)])
def test_a_repeated_part_is_in_the_view_once(tmp_path, loop, times):
    keyframes = [{"at_s": at_s, "deg": {"base": deg}} for at_s, deg in ((0, 0), (1, 9), (2, 0))]
    robot = str(EXAMPLES / "robots" / "desk_arm.yaml")
    path = tmp_path / "loop.yaml"
    content = {"sequence": "loop", "robot": robot, "keyframes": keyframes, "loop": loop}
    path.write_text(json.dumps(content), encoding="utf-8")
    values = planned(path)
    view = viewed(values)
    assert view["repeat"]["times"] == times
    assert (view["duration_s"] is None) == (loop == "forever")
    keys = view["lanes"][0]["keys"]
    assert [key["at_s"] for key in keys] == pytest.approx(
        [n + 2 * k for k in range(len(keys) // 3) for n in range(3)]
    )
    assert keys[-1]["at_s"] == pytest.approx(view["view_s"], abs=1e-3)
    window = ViewWindow(values[2])
    in_the_middle_s = 2.0 * (window.repeat["to_s"] + 1.0)
    assert window.written(in_the_middle_s) is None
    if times is not None:
        last_s = values[2].duration_s - 1.0
        deg = curve_of(view["curves"]["base"]["plan"]).at(np.array([window.written(last_s)]))
        assert deg == pytest.approx(values[1].sample(np.array([last_s]))[0], abs=0.01)


def test_a_sound_has_its_peaks_where_it_sounds_and_a_missing_one_says_why(tmp_path):
    pytest.importorskip("soundfile")
    sound = tmp_path / "beat.wav"
    with wave.open(str(sound), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        silence, tone = np.zeros(8000), 16000.0 * np.sin(np.arange(8000) * 0.3)
        file.writeframes(np.concatenate([silence, tone]).astype("<i2").tobytes())
    values = planned(fast(tmp_path, events=[{"at_s": 0.5, "sound": "beat.wav"}]))
    view = viewed(values)
    (form,) = view["waveforms"]
    assert form["to_s"] - form["from_s"] == pytest.approx(2.0)
    peaks = unpacked(form["peaks"], "i1").reshape(-1, 2)
    half = len(peaks) // 2
    assert len(peaks) == pytest.approx(2.0 * form["rate_hz"], abs=1)
    assert np.abs(peaks[: half - 1]).max() == 0
    assert peaks[half + 1 :].max() == pytest.approx(127 * 16000 / 32768, abs=3)
    sound.unlink()
    (form,) = viewed(values)["waveforms"]
    assert "beat.wav" in form["error"]
    assert math.isfinite(form["to_s"])
