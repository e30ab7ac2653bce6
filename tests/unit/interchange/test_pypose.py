"""PyPose projects: sequences, resolutions, and errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.interchange.reader import ForeignMotion, RefusedMotion
from lss_motion.interchange.step_tables import PYPOSE

SAMPLE = """\
droid:2
Pose=up: 512, 612
Pose=down: 512, 412
Seq=nod: up|250, down|500
Seq=once: down|100
"""


def test_pypose_sequences_play_their_poses() -> None:
    nod, once = PYPOSE.motions(Path("m"), SAMPLE.encode())
    assert isinstance(nod, ForeignMotion)
    still, moved = nod.channels
    assert (nod.name, once.name, still.name, moved.name) == ("nod", "once", "ID1", "ID2")
    assert moved.times_s.tolist() == [0.25, 0.75]
    assert moved.values.tolist() == [100 * 300 / 1024, -100 * 300 / 1024]
    assert [note.label for note in nod.notes.values()] == ["up", "down"]


def test_pypose_resolutions_may_differ_from_servo_to_servo(read_one) -> None:
    text = "droid:2:1024,4096\nPose=a: 512, 3072\nSeq=s: a|250\n"
    motion = read_one(PYPOSE, text)
    assert [channel.values.tolist() for channel in motion.channels] == [[0.0], [90.0]]


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("512, 612", "512", 2, "1 position for 2 servos"),
        ("droid:2", "droid:2:77", 1, "resolution 77 is not 1024 or 4096"),
        ("Pose=down: ", "Pose=down ", 3, "is neither"),
        ("512, 612", "512, -3", 2, "'-3' is not a whole number"),
        ("Seq=nod: up|250, down|500\nSeq=once: down|100\n", "", None, "has no sequence"),
    ],
)
def test_a_wrong_pypose_line_is_refused_with_its_number(refusal, old, new, line, reason) -> None:
    error = refusal(PYPOSE, SAMPLE.replace(old, new))
    assert (error.line, reason in error.reason) == (line, True), error


def test_a_pypose_sequence_of_unknown_poses_is_refused_alone() -> None:
    bad, good = PYPOSE.motions(Path("m"), SAMPLE.replace("nod: up", "nod: op").encode())
    assert isinstance(bad, RefusedMotion)
    assert "step 1 names pose 'op', which does not exist" in bad.error.reason
    assert isinstance(good, ForeignMotion)


def test_blank_lines_and_blanks_at_the_start_change_nothing(read_one) -> None:
    text = "\n\n  droid:1\n\n  Pose=a: 512\n  Seq=s: a|250\n"
    assert read_one(PYPOSE, text).channels[0].values.tolist() == [0.0]
