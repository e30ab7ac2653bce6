"""`beats` of a file, and keyframes at beats."""

from __future__ import annotations

from pathlib import Path

import pytest

import lss_motion as lss
from lss_motion.errors import InputError
from lss_motion.show.keyframes import at_speed

ROBOT = Path(__file__).parents[3] / "sequences" / "robots" / "desk_arm.yaml"
TEXT = """\
sequence: s
beats: [0.5, 1.0, 1.75, 2.5]
keyframes:
  - {at_s: 0.0, deg: {elbow: 0}}
  - {at_beat: 1, deg: {elbow: 5}}
  - {at_beat: 2.5, deg: {elbow: 0}}
  - {after_s: 0.1, deg: {elbow: 5}}
tracks:
  nod:
    keyframes:
      - {at_beat: 2, deg: {wrist: 0}, anchor: false}
      - {at_beat: 4, deg: {wrist: 5}}
"""


def load(folder, text):
    path = folder / "s.yaml"
    path.write_text(text)
    return lss.load_sequence(path, lss.load_robot(ROBOT))


def test_a_keyframe_is_at_its_beat_and_at_a_part_of_the_way_to_the_next(tmp_path):
    sequence = load(tmp_path, TEXT)
    assert [frame.at_s for frame in sequence.keyframes] == [0.0, 0.5, 1.375, 1.475]
    assert [frame.at_s for frame in sequence.tracks[0].keyframes] == [1.0, 2.5]
    assert sequence.beats_s == (0.5, 1.0, 1.75, 2.5)
    assert not any(frame.is_anchor for frame in sequence.keyframes)
    assert at_speed(sequence, 0.5).beats_s == (1.0, 2.0, 3.5, 5.0)


def test_beats_can_be_anchors_unless_a_keyframe_says_otherwise(tmp_path):
    text = TEXT.replace("[0.5, 1.0, 1.75, 2.5]", "{at_s: [0.5, 1.0, 1.75, 2.5], anchor: true}")
    sequence = load(tmp_path, text)
    assert [frame.is_anchor for frame in sequence.keyframes] == [False, True, True, False]
    assert [frame.is_anchor for frame in sequence.tracks[0].keyframes] == [False, True]


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("at_beat: 4", "at_beat: 4.5", 12, "no beat 4.5; beats has those from 1 to 4"),
        ("at_beat: 1,", "at_beat: 1, at_s: 2,", 5, "at_beat is a time, and so is at_s"),
        ("beats: [0.5, 1.0, 1.75, 2.5]", "", 5, "`lss-motion beats SONG --into FILE` writes them"),
        ("1.75, 2.5", "1.75, 1.5", 2, "1.5 s comes after 1.75 s"),
        ("at_beat: 1,", "at_beat: 0,", 5, "must be 1 or more"),
        ("keyframes:\n  - {at_s", "timing: fastest\nkeyframes:\n  - {at_s", 6, "use authored"),
    ],
)
def test_what_is_wrong_with_a_beat_is_named_with_its_line(tmp_path, old, new, line, words):
    with pytest.raises(InputError) as caught:
        load(tmp_path, TEXT.replace(old, new, 1))
    assert caught.value.line == line
    assert words in str(caught.value)
