"""The text about an unknown name: the nearest one, and a list."""

from __future__ import annotations

from lss_motion.files.source import LISTED_MAX, known_names


def test_the_nearest_name_is_offered_whatever_its_case() -> None:
    assert known_names("ELBW", ["base", "elbow"]) == "did you mean 'elbow'? there are: base, elbow"


def test_nothing_is_offered_when_nothing_is_near() -> None:
    assert known_names("zzz", ["base", "elbow"]) == "there are: base, elbow"
    assert known_names("zzz", []) == "there are none"


def test_a_long_list_is_cut_and_counted() -> None:
    said = known_names("zzz", [f"j{n}" for n in range(LISTED_MAX + 3)])
    assert said.endswith(f"j{LISTED_MAX - 1} and 3 more")
