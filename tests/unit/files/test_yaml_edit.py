"""A value changed in a text that a person wrote: the rest stays to the last character."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from lss_motion.errors import InputError
from lss_motion.files.yaml_edit import set_comment, set_values

FILE = Path("robot.yaml")
WRIST = ("joints", "wrist", "response")
VALUES = {"lag_s": 0.0312, "retarget": "from_rest"}

WRITINGS = {
    "flow": "joints:\n  # mine\n  wrist: {id: 4}   # and mine\n  arm: {id: 5}\n",
    "flow with a comma at its end": "joints:\n  wrist: {id: 4, }\n  arm: {id: 5}\n",
    "flow over lines": "joints:\n  wrist: {id: 4,  # the id\n    model: x  # it\n  }\n",
    "empty flow": "joints:\n  wrist: {}\n",
    "flow within flow": "joints: {wrist: {id: 4}, arm: {id: 5}}  # all\n",
    "block": "joints:\n  wrist:\n    id: 4  # the id\n\n  # about the arm\n  arm:\n    id: 5\n",
    "block without an end": "joints:\n  wrist:\n    id: 4",
    "block that ends in a block": "joints:\n  wrist:\n    settings:\n      AS: -2\n# end\n",
    "flow response": "joints:\n  wrist: {id: 4, response: {lag_s: 0.02, loop_s: 0.005}}  # x\n",
    "block response": (
        "joints:\n  wrist:\n    response:\n      loop_s: 0.005  # loop\n      lag_s: 0.02   # lag\n"
        "    # after\n    id: 4\n"
    ),
    "windows": "joints:\r\n  wrist:\r\n    id: 4\r\n  arm: {id: 5}\r\n",
    "quoted": "joints:\n  'wrist': {\"id\": 4, 'response': {\"lag_s\": '0.02'}}\n",
    "alias elsewhere": "x: &r {a: 1}\njoints:\n  arm: {response: *r}\n  wrist: {id: 4, b: *r}\n",
}


@pytest.mark.parametrize("text", WRITINGS.values(), ids=WRITINGS)
def test_values_are_set_and_nothing_that_was_written_is_lost(text):
    changed = set_values(FILE, text, WRIST, VALUES)
    was, now = yaml.safe_load(text), yaml.safe_load(changed)
    expected = was["joints"]["wrist"].get("response", {}) | VALUES
    assert now["joints"]["wrist"].pop("response") == expected
    was["joints"]["wrist"].pop("response", None)
    assert now == was
    for line in text.splitlines():
        comment = line.partition("#")[2]
        assert comment in changed
    assert ("\r\n" in changed) == ("\r\n" in text)
    assert changed.count("\n") <= text.count("\n") + 3


def test_setting_the_same_again_changes_no_character():
    once = set_values(FILE, WRITINGS["block"], WRIST, VALUES)
    assert set_values(FILE, once, WRIST, VALUES) == once


@pytest.mark.parametrize("end", ["", "\n", "\n\n# the end\n", "\n...\n"])
def test_a_new_key_of_the_file_comes_behind_what_is_there(end):
    """And not above its first line, where nobody looks for it."""
    text = f"# mine\nrobot: x\njoints:\n  wrist: {{id: 4}}{end}"
    changed = set_values(FILE, text, ("poses", "home"), {"wrist": 10.5})
    assert changed.startswith(text.rstrip("\n."))
    was = yaml.safe_load(text)
    assert yaml.safe_load(changed) == {**was, "poses": {"home": {"wrist": 10.5}}}


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x: &j {id: 4}\njoints:\n  wrist: *j\n", 3),
        ("joints:\n  wrist: &j {id: 4}\n  arm: *j\n", 2),
        ("r: &r {lag_s: 1}\njoints:\n  wrist: {response: *r}\n", 3),
    ],
)
def test_what_an_alias_shares_is_not_changed_behind_its_back(text, line):
    with pytest.raises(InputError) as raised:
        set_values(FILE, text, WRIST, VALUES)
    assert raised.value.line == line
    assert "alias" in str(raised.value)


def test_a_comment_replaces_its_own_lines_of_the_last_time_only():
    text = "joints:\n  # a person's\n  # wrist found 1\n  # wrist found 2\n  wrist: {id: 4}\n"
    changed = set_comment(FILE, text, ("joints", "wrist"), "wrist found", ["3"])
    assert changed == "joints:\n  # a person's\n  # wrist found 3\n  wrist: {id: 4}\n"


def test_a_comment_goes_to_the_end_where_there_is_no_line_of_its_own():
    text = "joints: {wrist: {id: 4}}\n"
    once = set_comment(FILE, text, ("joints", "wrist"), "wrist found", ["1"])
    assert once == text + "# wrist found 1\n"
    assert (
        set_comment(FILE, once, ("joints", "wrist"), "wrist found", ["2"])
        == text + "# wrist found 2\n"
    )


@pytest.mark.parametrize("text", ["robot: x\n", "robot: x\nposes: {}\n", "robot: {a: 1}  # it\n"])
@pytest.mark.parametrize("location", [("poses", "up"), ("poses", "up", "left", "far")])
def test_several_values_of_a_mapping_whose_mappings_do_not_exist_are_all_set(text, location):
    """As the first pose of a robot: neither `poses` nor the pose is there."""
    angles = {"pan": 4.5, "tilt": 0.0, "roll": -3.0}
    made = yaml.safe_load(set_values(FILE, text, location, angles))
    expected = angles
    for part in location[::-1]:
        expected = {part: expected}
    assert made == yaml.safe_load(text) | expected
