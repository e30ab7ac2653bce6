"""No text of a file or of a servo steers the terminal, in any field and through any command."""

from __future__ import annotations

import copy
import json
import unicodedata

import pytest

from lss_motion.cli import play
from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT
from lss_motion.sim.readings import Readings

STEERING = "\x1b[2J\x1b]0;taken\x07\r\x9b31m\u202e"

ROBOT = {
    "robot": "pair",
    "buses": {"main": {"port": "sim://", "baud_bps": 115200}},
    "defaults": {
        "model": "LSS-ST1",
        "range_deg": [-90, 90],
        "speed_max_deg_s": 180,
        "accel_max_deg_s2": 600,
    },
    "joints": {"pan": {"id": 1}, "tilt": {"id": 2, "bus": "main"}},
    "poses": {"away": {"pan": 20, "tilt": 10}},
    "groups": {"head": ["pan", "tilt"]},
    "on_fault": {"silent": ["warn", "hold"]},
}
SHOW = {
    "sequence": "nod",
    "robot": "robot.yaml",
    "interpolation": "smooth",
    "keyframes": [
        {"at_s": 0, "deg": {"pan": 0, "tilt": 0}, "label": "begin"},
        {"at_s": 0.6, "pose": "away", "label": "away", "ease": "linear"},
        {"at_s": 0.9, "deg": {"pan": 21}, "label": "too far", "anchor": False},
        {"at_s": 1.6, "deg": {"pan": 0, "tilt": 0}, "label": "end"},
    ],
    "events": [{"at_s": 0.5, "sound": "ding.wav"}],
}
STAGE = {
    "stage": "hall",
    "robot": "robot.yaml",
    "shows": {"nod": "show.yaml"},
    "idle": "nod",
    "cues": [{"cue": "visit", "on": {"key": "v"}, "play": "nod"}],
}
FAULTS = {"faults": [{"kind": "lost_reply", "ratio": 0.1, "at_s": 0.2}]}
FILES = {"robot.yaml": ROBOT, "show.yaml": SHOW, "stage.yaml": STAGE, "faults.yaml": FAULTS}

SHOWS = (
    ["check", "show.yaml"],
    ["check", "show.yaml", "--all", "--json"],
    ["plan", "show.yaml", "--csv", "plan.csv"],
    ["compile", "show.yaml", "-o", "out.lss"],
    ["export", "show.yaml", "-o", "out.json"],
    ["publish", "show.yaml", "-o", "page.html"],
    ["verify", "page.html"],
    ["check", "stage.yaml"],
    ["doctor", "robot.yaml"],
    ["monitor", "robot.yaml", "--for", "0.6", "--quiet"],
    ["configure", "robot.yaml"],
    ["send", "--robot", "robot.yaml", "--id", "1", "--yes", "QMS"],
    ["send", "--robot", "robot.yaml", "--id", "1", "--yes", "QN"],
    ["report", "a.json"],
    ["replay", "a.log"],
)
PLAYED = ["show.yaml", "--virtual", "--faults", "faults.yaml", "--log", "a.log"]
PLAYED += ["--report", "a.json", "--yes", "--verbose"]


def yaml_of(document):
    """Return a document as YAML, with the escapes of JSON, which YAML has, too."""
    return "".join(
        f"{key if key.isidentifier() else json.dumps(key)}: {json.dumps(value)}\n"
        for key, value in document.items()
    )


def places(value, way=()):
    """Yield the way to each text of a document, and to each key."""
    if isinstance(value, dict):
        for key, one in value.items():
            yield (*way, key), True
            yield from places(one, (*way, key))
    elif isinstance(value, list):
        for index, one in enumerate(value):
            yield from places(one, (*way, index))
    elif isinstance(value, str):
        yield way, False


def hostile(document, way, *, is_key):
    """Return the document with what steers a terminal at one place."""
    made = copy.deepcopy(document)
    owner = made
    for step in way[:-1]:
        owner = owner[step]
    if is_key:
        owner[f"{way[-1]}{STEERING}"] = owner.pop(way[-1])
    else:
        owner[way[-1]] += STEERING
    return made


ALL = [(name, *place) for name, document in FILES.items() for place in places(document)]
EACH = [
    pytest.param(
        name,
        way,
        is_key,
        id=f"{name} {'/'.join(map(str, way))}{' key' * is_key}",
        marks=[pytest.mark.slow] if number % 6 else [],
    )
    for number, (name, way, is_key) in enumerate(ALL)
]
"""Every sixth is tried in the quick tier, all in the other."""


def steers(text):
    """Return what of a text a terminal would obey rather than show."""
    kinds = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return [char for char in text if unicodedata.category(char) in kinds and char not in "\n\t"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, document in FILES.items():
        (tmp_path / name).write_text(yaml_of(document))
    rate = 8_000
    head = b"RIFF" + (36 + rate).to_bytes(4, "little") + b"WAVEfmt " + (16).to_bytes(4, "little")
    head += (1).to_bytes(2, "little") * 2 + rate.to_bytes(4, "little") * 2
    head += (1).to_bytes(2, "little") + (8).to_bytes(2, "little") + b"data"
    (tmp_path / "ding.wav").write_bytes(head + rate.to_bytes(4, "little") + bytes([128]) * rate)
    return tmp_path


def said(capsys, words):
    """Run a command; return what it printed, to both streams."""
    capsys.readouterr()
    code = play.main(words) if words is PLAYED else main(words)
    captured = capsys.readouterr()
    return code, captured.out + captured.err


def test_the_files_are_played_as_they_are(folder, capsys):
    code, text = said(capsys, PLAYED)
    assert code == EXIT_FINISHED, text
    for words in SHOWS:
        code, text = said(capsys, words)
        assert code == EXIT_FINISHED, (words, text)
        assert not steers(text)


@pytest.mark.parametrize(("name", "way", "is_key"), EACH)
def test_a_hostile_text_in_any_field_is_printed_as_an_escape(folder, capsys, name, way, is_key):
    (folder / name).write_text(yaml_of(hostile(FILES[name], way, is_key=is_key)))
    codes = []
    for words in (["check", "show.yaml"], ["check", "stage.yaml"], PLAYED):
        code, text = said(capsys, words)
        codes.append(code)
        assert not steers(text), (words, text)
    if set(codes) <= {EXIT_INPUT}:
        return
    for words in SHOWS:
        assert not steers(said(capsys, words)[1]), words


@pytest.mark.parametrize("letter", ["N", "MS", "F"])
def test_no_answer_of_a_servo_steers_the_terminal(folder, capsys, monkeypatch, letter):
    value = Readings.value

    def lying(self, row, *arguments):
        answer = value(self, row, *arguments)
        return f"{answer}{STEERING}" if f"Q{letter}" in row.queries else answer

    monkeypatch.setattr(Readings, "value", lying)
    for words in (PLAYED, *SHOWS):
        assert not steers(said(capsys, words)[1]), words
