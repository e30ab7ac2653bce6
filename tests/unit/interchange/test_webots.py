"""Webots motions: `*`, line ends, labels, and errors."""

from __future__ import annotations

import pytest

from lss_motion.interchange.reader import Measure
from lss_motion.interchange.step_tables import WEBOTS

SAMPLE = """\
#WEBOTS_MOTION,V1.0,ArmL,ArmR,Lift
00:00:000,Rest,-0.5,0.2,0
00:01:500,Up,*,0.4,*
01:00:000,Rest,-0.5,0.2,0
"""


def test_a_webots_star_sets_no_key(read_one) -> None:
    motion = read_one(WEBOTS, SAMPLE)
    left, right, lift = motion.channels
    assert left.times_s.tolist() == [0.0, 60.0]
    assert right.times_s.tolist() == [0.0, 1.5, 60.0]
    assert right.values.tolist() == [0.2, 0.4, 0.2]
    assert (right.unit, lift.unit) == (Measure.RAD, Measure.RAD_OR_M)
    assert motion.notes[1.5].label == "Up"


def test_line_ends_and_a_byte_order_mark_change_nothing(read_one) -> None:
    plain = read_one(WEBOTS, SAMPLE)
    for content in (
        b"\xef\xbb\xbf" + SAMPLE.encode(),
        SAMPLE.replace("\n", "\r\n").encode(),
        SAMPLE.replace("\n", "\r").encode(),
    ):
        other = read_one(WEBOTS, content)
        assert [c.values.tolist() for c in other.channels] == [
            c.values.tolist() for c in plain.channels
        ]


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("*,0.4,*", "0.4", 3, "2 values for 3 joints"),
        ("00:01:500", "1.5", 3, "'1.5' is not a time of the form mm:ss:mmm"),
        ("0.4", "nan", 3, "'nan' is not a number"),
        ("0.4", "1e999", 3, "'1e999' is out of range"),
        ("01:00:000", "00:01:000", 4, "times must increase, but this is 1 s after 1.5 s"),
        ("ArmL,ArmR", "ArmL,ArmL", 1, "every joint needs a name of its own"),
        (",ArmL,ArmR,Lift", "", 2, "names of joints are expected here"),
    ],
)
def test_a_wrong_webots_line_is_refused_with_its_number(refusal, old, new, line, reason) -> None:
    error = refusal(WEBOTS, SAMPLE.replace(old, new))
    assert (error.line, reason in error.reason) == (line, True), error


@pytest.mark.parametrize(
    ("text", "times_s"),
    [
        ("#WEBOTS_MOTION,V1.0\nArmL,ArmR\n00:00:000,a,1,2\n00:00:500,b,3,4\n", [0.0, 0.5]),
        ("#WEBOTS_MOTION,V1.0\nArmL,ArmR\n00:00:000,1,2,\n00:00:500,3,4,\n", [0.0, 0.5]),
        ("#WEBOTS_MOTION,V1.1\nArmL%ArmR\n40%1%2\n500%3%4\n", [0.04, 0.54]),
        ("#WEBOTS_MOTION%V1.1%ArmL%ArmR\n00:00:040%1%2%\n00:00:540%3%4%\n", [0.04, 0.54]),
    ],
)
def test_names_may_have_a_line_of_their_own_and_durations_are_summed(read_one, text, times_s):
    motion = read_one(WEBOTS, text)
    assert [channel.name for channel in motion.channels] == ["ArmL", "ArmR"]
    assert motion.channels[1].values.tolist() == [2.0, 4.0]
    assert motion.channels[0].times_s.tolist() == times_s
    has_durations = "40%" in text and "00:" not in text
    assert any("assumed to be milliseconds" in text for text in motion.comments) is has_durations


def test_minutes_and_seconds_of_an_instant_may_be_absent(read_one) -> None:
    text = "#WEBOTS_MOTION,V1.0,ArmL\n0,Rest,0\n500,Up,1\n1:250,Up,2\n1:2:3,Rest,0\n"
    motion = read_one(WEBOTS, text)
    assert motion.channels[0].times_s.tolist() == [0.0, 0.5, 1.25, 62.003]
    assert not any("assumed" in comment for comment in motion.comments)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("#WEBOTS_MOTION,V1.0\n00:00:000,a,1,2\n", 2),
        ("#WEBOTS_MOTION,V1.0\n", 1),
        ("#WEBOTS_MOTION,V2.0,ArmL,ArmR\n00:00:000,a,1,2\n", 1),
        ("#WEBOTS_MOTION,one,ArmL\n00:00:000,1\n", 1),
        ("#WEBOTS_MOTION,V1.1\nArmL\n1.5,1\n", 3),
    ],
)
def test_a_refusal_names_the_variants_that_are_read(refusal, text, line) -> None:
    error = refusal(WEBOTS, text)
    assert (error.line, "divided by `%`" in error.reason) == (line, True)
