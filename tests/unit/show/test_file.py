"""The JSON Schemas for editors: shipped, up to date, and in agreement with the loaders."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from lss_motion.files.yaml_source import read_yaml
from lss_motion.playing import api
from lss_motion.robot.load import load_robot, robot_schema
from lss_motion.show.load import load_sequence, sequence_schema

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"
ROBOTS = sorted((EXAMPLES / "robots").glob("*.yaml"))
SEQUENCES = sorted(
    path
    for path in EXAMPLES.rglob("*.yaml")
    if path not in ROBOTS
    and not re.search(r"(gait|stage)\.schema\.json", path.read_text(encoding="utf-8"))
)
SCHEMAS = {"robot": robot_schema, "sequence": sequence_schema}

ROBOT = {
    "robot": "x",
    "joints": {
        "a": {
            "id": 1,
            "model": "LSS-ST1",
            "range_deg": [0, 1],
            "speed_max_deg_s": 1,
            "accel_max_deg_s2": 1,
        }
    },
}
SEQUENCE = {"sequence": "x", "robot": "r.yaml", "keyframes": [{"at_s": 0, "deg": {"a": 0}}]}


def is_valid(content: object, schema: dict[str, Any]) -> bool:
    return bool(jsonschema.Draft202012Validator(schema).is_valid(content))


@pytest.mark.parametrize("kind", SCHEMAS)
def test_a_schema_is_valid_and_describes_every_key(kind: str) -> None:
    schema = SCHEMAS[kind]()
    jsonschema.Draft202012Validator.check_schema(schema)
    for entry in (schema, *schema["$defs"].values()):
        for key, described in entry["properties"].items():
            assert described.get("description") or "$ref" in str(described), key
    assert "null" not in json.dumps(schema)


def test_there_are_examples_of_both_kinds() -> None:
    assert {path.name for path in ROBOTS} >= {"desk_arm.yaml", "figure.yaml"}
    assert {path.name for path in SEQUENCES} >= {"wave.yaml", "show.yaml", "fastest.yaml"}


@pytest.mark.parametrize("path", [*ROBOTS, *SEQUENCES], ids=lambda path: path.name)
def test_every_example_names_its_schema_fulfils_it_and_loads(path: Path) -> None:
    first, _, _ = path.read_text(encoding="utf-8").partition("\n")
    schema_path = path.parent / first.removeprefix("# yaml-language-server: $schema=")
    schema = json.loads(schema_path.read_text(encoding="utf-8"))
    assert is_valid(read_yaml(path).value, schema)
    assert (load_robot if path in ROBOTS else api.load_sequence)(path).name


def test_the_show_is_a_show() -> None:
    show = load_sequence(EXAMPLES / "show.yaml")
    assert show.robot_path is not None
    assert len(load_robot(show.robot_path).joints) == 8
    assert (show.keyframes[-1].at_s or 0.0) >= 20.0
    assert {keyframe.ease.value for keyframe in show.keyframes} == {
        "smooth", "spline", "linear", "hold",
    }  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"extra": 1},
        {"robot": 5},
        {"joints": {}},
        {"joints": {"a": {"id": "1"}}},
        {"joints": {"a": {"id": 251}}},
        {"joints": {"a": {}}},
        {"joints": {"a b": {"id": 1}}},
        {"joints": {"a": {"id": 1, "drive": "fast"}}},
        {"joints": {"a": {"id": 1, "model": None}}},
        {"joints": {"a": {"id": 1, "direction": 2}}},
        {"joints": {"a": {"id": 1, "range_deg": [1]}}},
        {"joints": {"a": {"id": 1, "sped": 1}}},
        {"defaults": {"id": 1}},
        {"buses": {"x": {"baud_bps": 100}}},
        {"poses": {"p": {"a": "1"}}},
        {"end": "float"},
    ],
)
def test_a_wrong_robot_file_does_not_fulfil_the_schema(change: dict[str, object]) -> None:
    assert is_valid(ROBOT, robot_schema())
    assert not is_valid(ROBOT | change, robot_schema())


@pytest.mark.parametrize(
    "change",
    [
        {"tracks": {}},
        {"keyframes": []},
        {"keyframes": [{"at_s": "0"}]},
        {"keyframes": [{"at_s": -1}]},
        {"keyframes": [{"ease": "smoth"}]},
        {"keyframes": [{"anchr": True}]},
        {"keyframes": [{"deg": {"a": True}}]},
        {"keyframes": [{"anchor": "yes"}]},
        {"loop": 0},
        {"loop": "never"},
        {"loop": 1.5},
        {"timing": "quick"},
        {"duration_s": 0},
        {"interpolation": None},
    ],
)
def test_a_wrong_sequence_file_does_not_fulfil_the_schema(change: dict[str, object]) -> None:
    assert is_valid(SEQUENCE, sequence_schema())
    assert is_valid(SEQUENCE | {"loop": "forever"}, sequence_schema())
    assert not is_valid(SEQUENCE | change, sequence_schema())
