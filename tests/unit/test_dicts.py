"""Robots and sequences from dicts are those of files, and their mistakes name the place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import lss_motion as lss

ROOT = Path(__file__).resolve().parents[2] / "sequences"
ROBOT = {
    "robot": "one",
    "buses": {"main": {"port": "sim://"}},
    "joints": {
        "a": {
            "id": 1,
            "model": "LSS-ST1",
            "range_deg": (-90, 90),
            "speed_max_deg_s": 180,
            "accel_max_deg_s2": 600,
        }
    },
}
SHOW = {"sequence": "s", "keyframes": [{"at_s": 0, "deg": {"a": 0}}]}


def test_the_values_of_a_file_make_the_same_robot_and_sequence(monkeypatch):
    monkeypatch.chdir(ROOT)
    path = ROOT / "robots" / "desk_arm.yaml"
    file = lss.load_robot(path)
    robot = lss.load_robot(yaml.safe_load(path.read_text()))
    assert robot.joints == file.joints
    assert robot.poses == file.poses
    assert robot.path is None
    show = yaml.safe_load((ROOT / "wave.yaml").read_text())
    assert lss.load_sequence(show) == lss.load_sequence(ROOT / "wave.yaml")


def test_numbers_of_numpy_and_odd_texts_stay_what_they_are():
    robot = lss.load_robot({**ROBOT, "robot": "1e3"})
    frames = [
        {"at_s": np.float64(0), "deg": {"a": np.int64(7)}, "label": "yes"},
        {"at_s": 1e-5 + 1, "deg": {"a": np.float32(0.5)}, "label": "null"},
    ]
    sequence = lss.load_sequence({"sequence": "0x10", "keyframes": frames}, robot)
    assert (robot.name, sequence.name) == ("1e3", "0x10")
    assert [dict(f.deg) for f in sequence.keyframes] == [{"a": 7.0}, {"a": 0.5}]
    assert [f.label for f in sequence.keyframes] == ["yes", "null"]
    assert sequence.keyframes[1].at_s == 1.00001


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"keyframes": [{"at_s": 0, "deg": {"b": 0}}]},
            r"^keyframes\.0\.deg\.b: unknown joint 'b'",
        ),
        ({"lop": 1}, r"^lop: unknown key 'lop'; did you mean 'loop'"),
        ({"keyframes": [{"at_s": object()}]}, r"^keyframes\.0\.at_s: 'object' is no type"),
        ({3: 4}, r"^3: a key must be a text"),
        ({"loop": float("nan")}, r"^loop: "),
        ({"play": [{"file": "nix.yaml"}], "keyframes": []}, r"'nix\.yaml' not found"),
    ],
)
def test_a_mistake_names_its_place(changes, text):
    with pytest.raises(lss.InputError, match=text):
        lss.load_sequence({**SHOW, **changes}, lss.load_robot(ROBOT))
