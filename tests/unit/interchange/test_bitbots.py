"""Keyframe JSON of the Bit-Bots: times, angles, comments, and errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.json_motions import BITBOTS
from lss_motion.interchange.reader import LABEL_MAX_CHARS

if TYPE_CHECKING:
    from lss_motion.interchange.reader import ForeignMotion

PATH = Path("nod.json")


def nod() -> dict[str, Any]:
    return {
        "name": "nod",
        "author": "A. Person",
        "keyframes": [
            {"duration": 2.0, "pause": 0.5, "goals": {"Head": -58.00000000000001}, "name": "down"},
            {"duration": 0.25, "pause": 0, "goals": {"Head": 10, "Jaw": 3.5}, "name": "up"},
        ],
    }


def read(content: object) -> ForeignMotion:
    return BITBOTS.motions(PATH, json.dumps(content).encode())[0]


def refusal(data: bytes) -> InputError:
    with pytest.raises(InputError) as caught:
        BITBOTS.motions(PATH, data)
    assert caught.value.path == PATH
    return caught.value


def test_a_keyframe_is_reached_its_duration_after_the_pause_before() -> None:
    first, second = read(nod()).keyframes
    assert (first.at_s, first.hold_s, first.label) == (2.0, 0.5, "down")
    assert (second.at_s, second.hold_s, second.label) == (2.75, 0.0, "up")
    assert first.deg == {"Head": -58.0}
    assert second.deg == {"Head": 10.0, "Jaw": 3.5}


def test_keys_that_a_sequence_cannot_hold_are_listed_in_comments() -> None:
    content = nod() | {"stiff": [1, 2], "empty": {}}
    content["keyframes"][1]["torque"] = {"Head": 0}
    content["keyframes"][0]["torque"] = {}
    assert read(content).comments == (
        "Imported from nod.json (Bit-Bots keyframes).",
        "author: A. Person",
        "Not carried over: stiff",
        "Not carried over: keyframes: torque",
    )


def test_labels_are_made_printable_and_short() -> None:
    content = nod()
    content["keyframes"][0]["name"] = "a\nb" + "c" * 100
    content["name"] = ""
    motion = read(content)
    assert motion.name == "nod"
    assert motion.keyframes[0].label == "a b".ljust(LABEL_MAX_CHARS, "c")


def test_a_byte_order_mark_is_ignored() -> None:
    marked = b"\xef\xbb\xbf" + json.dumps(nod()).encode()
    assert BITBOTS.motions(PATH, marked)[0].keyframes == read(nod()).keyframes


def test_the_content_decides_what_is_recognised() -> None:
    reader = BITBOTS
    assert reader.recognises(json.dumps(nod()).encode())
    assert reader.recognises(b"\xef\xbb\xbf \n" + json.dumps(nod()).encode())
    assert not reader.recognises(b'{"positions": []}')
    assert not reader.recognises(b"keyframes: goals:")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda k: k.pop("duration"), "keyframes[1] has no 'duration'"),
        (lambda k: k.pop("pause"), "keyframes[1] has no 'pause'"),
        (lambda k: k.pop("goals"), "keyframes[1].goals must be an object"),
        (lambda k: k.update(goals={}), "keyframes[1].goals names no joint"),
        (lambda k: k.update(goals=[1]), "keyframes[1].goals must be an object"),
        (lambda k: k.update(goals={"Head": "3"}), "keyframes[1].goals.Head is '3', but must be"),
        (lambda k: k.update(goals={"Head": None}), "keyframes[1].goals.Head is None"),
        (lambda k: k.update(goals={"Head": True}), "keyframes[1].goals.Head is True"),
        (lambda k: k.update(goals={"Head": 10**400}), "out of range"),
        (lambda k: k.update(duration=0), "keyframes[1].duration is 0, but must be more than 0 s"),
        (lambda k: k.update(duration=-1), "keyframes[1].duration is -1"),
        (lambda k: k.update(pause=-0.5), "keyframes[1].pause is -0.5, but must be 0 s or more"),
    ],
)
def test_a_wrong_keyframe_is_refused_with_its_place(change, reason: str) -> None:
    content = nod()
    change(content["keyframes"][1])
    assert reason in refusal(json.dumps(content).encode()).reason


@pytest.mark.parametrize(
    ("data", "line", "reason"),
    [
        (b"", 1, "ends inside of its JSON: it was cut off"),
        (b'{\n"keyframes": [\n{]\n', 3, "not JSON"),
        (b"[]", None, "the file must be an object"),
        (b"{}", None, "must have a list 'keyframes' with at least one entry"),
        (b'{"keyframes": []}', None, "with at least one entry"),
        (b'{"keyframes": [3]}', None, "keyframes[0] must be an object"),
        (b'{"keyframes": [{"duration": NaN}]}', None, "NaN is no number"),
        (b'{"keyframes": [{"duration": -Infinity}]}', None, "-Infinity is no number"),
        (b'{"a": 1, "a": 2}', None, "key 'a' is given twice"),
        (b'{"a": ' + b"1" * 5000 + b"}", None, "not JSON that can be read"),
        (b'{"a": ' + b"[" * 100_000, None, "not JSON that can be read"),
        (b"{\n\xff}", 2, "is not UTF-8"),
        (b"\x00\x01", None, "is a binary file"),
    ],
)
def test_another_kind_of_file_is_refused(data: bytes, line: int | None, reason: str) -> None:
    error = refusal(data)
    assert reason in error.reason
    assert error.line == line


def test_a_number_that_overflows_is_refused() -> None:
    data = json.dumps(nod()).replace("0.25", "1e999").encode()
    assert "keyframes[1].duration is inf" in refusal(data).reason
