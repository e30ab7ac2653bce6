"""The text about an unknown name: the nearest one, and a list."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from lss_motion.errors import InputError
from lss_motion.files.source import text_of
from lss_motion.files.texts import LISTED_MAX, aligned, comma_text, counted, known_names
from lss_motion.show.model import Cue, Keyframe

if TYPE_CHECKING:
    from pathlib import Path


def test_the_nearest_name_is_offered_whatever_its_case() -> None:
    assert known_names("ELBW", ["base", "elbow"]) == "did you mean 'elbow'? there are: base, elbow"


def test_nothing_is_offered_when_nothing_is_near() -> None:
    assert known_names("zzz", ["base", "elbow"]) == "there are: base, elbow"
    assert known_names("zzz", []) == "there are none"


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("anker", "anchor"), ("Ankor", "anchor"), ("lable", "label"), ("holds", "hold_s"),
        ("wait", "weight"), ("kepe", "keep"), ("exakt", "exact"), ("post", "pose"),
        ("interpolation", None), ("x", None), ("", None),
    ],
)  # fmt: skip
def test_a_key_in_another_spelling_or_language_is_recognised(word: str, meant: str | None) -> None:
    keys = ["at_s", "after_s", "at_beat", "pose", "deg", "hold_s", "hold_may_shrink", "anchor",
            "exact", "keep", "weight", "ease", "label"]  # fmt: skip
    said = known_names(word, keys)
    assert said.startswith("there are" if meant is None else f"did you mean {meant!r}?")


@pytest.mark.parametrize(("text", "number"), [("0,5", "0.5"), (" -12,25 ", "-12.25")])
def test_a_decimal_comma_is_named(text: str, number: str) -> None:
    assert comma_text(text).endswith(f": {number}")


@pytest.mark.parametrize("text", ["0.5", "1,2,3", "a,b", "1,", ",5", "", 5, None, ["0,5"]])
def test_what_has_no_decimal_comma_gets_no_word_about_it(text: object) -> None:
    assert not comma_text(text)


def test_one_thing_is_not_many() -> None:
    assert [counted(n, "cycle") for n in (0, 1, 2)] == ["0 cycles", "1 cycle", "2 cycles"]
    assert counted(["a"], "bus", "buses") == "1 bus"
    assert counted(12345, "key", mark=",") == "12,345 keys"


def test_a_table_that_is_too_wide_loses_columns_and_at_last_the_ends_of_names() -> None:
    rows = [("name", "id", "model"), ("a" * 20, "7", "b" * 20)]
    assert max(map(len, aligned(rows))) == 46
    assert aligned(rows, spare=(2,), most_chars=30) == [f"{'name':20}  id", f"{'a' * 20}  7"]
    assert aligned(rows, spare=(2,), most_chars=12) == ["name      id", "aaaaaaa…  7"]


def test_a_long_list_is_cut_and_counted() -> None:
    said = known_names("zzz", [f"j{n}" for n in range(LISTED_MAX + 3)])
    assert said.endswith(f"j{LISTED_MAX - 1} and 3 more")


def test_the_byte_that_is_not_utf8_is_named_also_after_a_byte_order_mark(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        text_of(b"\xef\xbb\xbfab\xffcd\n", tmp_path)
    assert "byte 0xff is not UTF-8" in caught.value.reason
    with pytest.raises(InputError) as caught:
        text_of(b"\xef\xbb\xbfa\n\xff", tmp_path)
    assert caught.value.line == 2


def test_a_value_is_compared_without_the_place_where_it_was_written():
    cue = Cue(at_s=1.0, say="hello", line=3)
    moved = Cue(at_s=1.0, say="hello", line=7)
    assert cue == moved
    assert hash(cue) == hash(moved)
    assert cue != Cue(at_s=1.0, say="good bye", line=3)
    assert cue != Keyframe(deg={}, at_s=1.0, line=3)
