from __future__ import annotations

import pytest

from lss_motion.program.text import cue_line, read_cue
from lss_motion.sequence.model import Cue


@pytest.mark.parametrize(
    "cue",
    [
        Cue(at_s=1.5, led=(("elbow", 1), ("base", 0))),
        Cue(at_s=0.0, say='said "so" – now'),
        Cue(at_s=2.0, run="effects:fog", folder="/home/me/my show"),
        Cue(at_s=3.25, sound="/home/me/bell.wav", lead_s=0.1),
    ],
)
def test_a_cue_is_read_as_it_was_written(cue):
    text = cue_line(cue)
    assert text.isascii()
    assert read_cue(text, ["elbow", "base"]) == cue


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('x {"say": "a"}', "whole number of us"),
        ("1500000", "JSON object"),
        ("1500000 []", "JSON object"),
        ('1 {"led": {"bose": 1}}', "no joint 'bose'"),
        ('1 {"led": {"base": 8}}', "colours from 0 to 7"),
        ('1 {"sound": "a", "lead_s": -1}', "lead_s"),
        ('1 {"shout": "a"}', "a cue has"),
        ('1 {"say": 3}', "a cue has"),
    ],
)
def test_a_wrong_cue_is_refused_with_a_reason(text, words):
    with pytest.raises(ValueError, match=words):
        read_cue(text, ["base"])
