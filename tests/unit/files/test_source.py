"""The text about an unknown name: the nearest one, and a list."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from lss_motion.errors import InputError
from lss_motion.files.source import text_of
from lss_motion.files.texts import LISTED_MAX, known_names
from lss_motion.show.model import Cue, Keyframe

if TYPE_CHECKING:
    from pathlib import Path


def test_the_nearest_name_is_offered_whatever_its_case() -> None:
    assert known_names("ELBW", ["base", "elbow"]) == "did you mean 'elbow'? there are: base, elbow"


def test_nothing_is_offered_when_nothing_is_near() -> None:
    assert known_names("zzz", ["base", "elbow"]) == "there are: base, elbow"
    assert known_names("zzz", []) == "there are none"


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
