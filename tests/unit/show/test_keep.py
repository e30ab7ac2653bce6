"""`keep: time` for files, tracks, layers and joints; `exact` and `weight` of keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence
from lss_motion.show.parts import time_keepers
from lss_motion.show.write import write_sequence

ROBOT = """\
robot: face
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  jaw: {id: 1}
  lip: {id: 2}
  neck: {id: 3}
groups: {mouth: [jaw, lip]}
mirror: {same: {lip: neck}}
"""

KEYS = """\
keyframes:
  - {at_s: 0, deg: {jaw: 0, neck: 0}}
  - {at_s: 1, deg: {jaw: 20, neck: 5}}
"""


@pytest.fixture
def load(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)

    def load(text, name="show.yaml"):
        path = tmp_path / name
        path.write_text(f"sequence: s\nrobot: robot.yaml\n{text}")
        return load_sequence(path)

    return load


@pytest.mark.parametrize(
    ("keep", "joints"),
    [
        ("keep: time", {"jaw", "neck"}),
        ("keep: angle", set()),
        ("keep: {jaw: time}", {"jaw"}),
        ("keep: {mouth: time}", {"jaw"}),
        ("keep: {jaw: angle}", set()),
    ],
)
def test_a_file_says_which_joints_keep_their_time(load, keep, joints):
    assert load(f"{keep}\n{KEYS}").keeps_time == joints


CLAP = """\
keyframes:
  - {at_s: 0, deg: {jaw: 0, lip: 0, neck: 0}}
  - {at_s: 1, deg: {jaw: 20, neck: 5}, keep: time}
  - {at_s: 2, deg: {jaw: 0, lip: 9}, label: end, hold_s: 1}
"""


def test_a_keyframe_gives_up_angle_and_the_others_of_its_joints_keep_both(load):
    sequence = load(CLAP)
    assert sequence.keeps_time == {"jaw", "neck"}
    assert [frame.is_exact for frame in sequence.keyframes] == [True, False, True]


def test_a_beat_is_met_in_time_and_the_keyframes_around_it_in_both(load, tmp_path):
    sequence = load(CLAP.replace("at_s: 2,", "at_s: 1.2,"))
    planned = plan(sequence, load_robot(tmp_path / "robot.yaml"))
    jaw = planned.joints.index("jaw")
    deg = planned.sample(np.array([0.0, 1.0, 1.2, 2.2]))[:, jaw]
    assert deg[[0, 2, 3]] == pytest.approx(0.0, abs=1e-3)
    assert 5.0 < deg[1] < 19.0
    assert {span.joint for span in planned.given_up} == {"jaw"}
    assert [mark.planned_s for mark in planned.marks if "jaw" in mark.kept] == [0.0, 1.0, 1.2]


def test_what_the_file_says_of_joints_counts_at_the_keyframes_without_it(load):
    sequence = load(f"keep: {{jaw: time, lip: time}}\n{CLAP}")
    assert [(frame.is_exact, *frame.deg) for frame in sequence.keyframes] == [
        (False, "jaw", "lip"),
        (True, "neck"),
        (False, "jaw", "neck"),
        (False, "jaw", "lip"),
    ]
    assert len({(frame.at_s, frame.line) for frame in sequence.keyframes}) == 3
    assert not any(frame.is_exact for frame in load(f"keep: time\n{CLAP}").keyframes)


TRACKS = """\
tracks:
  talk:
    keyframes: [{at_s: 0, deg: {jaw: 0, lip: 0}}, {at_s: 1, deg: {jaw: 9, lip: 9}}]
  look:
    keep: angle
    keyframes: [{at_s: 0, deg: {neck: 0}}, {at_s: 1, deg: {neck: 9}}]
"""


@pytest.mark.parametrize(
    ("keep", "talk"), [("keep: time", {"jaw", "lip"}), ("keep: {lip: time}", {"lip"}), ("", set())]
)
def test_tracks_inherit_and_override(load, keep, talk):
    sequence = load(f"{keep}\n{TRACKS}")
    assert [track.keeps_time for track in sequence.tracks] == [talk, set()]
    assert time_keepers(sequence) == talk


def test_a_layer_can_keep_the_time_of_its_file_or_its_own(load, tmp_path):
    load(f"keep: {{jaw: time}}\n{KEYS}", "talk.yaml")
    top = "keyframes: [{at_s: 0, deg: {lip: 0}}, {at_s: 1, deg: {lip: 3}}]\nlayers:\n"
    for keep, kept in (("", {"jaw"}), (", keep: time", {"jaw", "neck"}), (", keep: angle", set())):
        sequence = load(f"{top}  - {{file: talk.yaml{keep}}}\n")
        assert time_keepers(sequence) == kept
    assert time_keepers(load(f"{top}  - {{file: talk.yaml, keep: time, joints: [neck]}}\n")) == {
        "neck"
    }


def test_mirrored_joints_keep_their_time_on_the_other_side(load):
    sequence = load(f"mirror: true\nkeep: {{neck: time}}\n{KEYS}")
    assert sequence.keeps_time == {"lip"}


ONE_TRACK = """\
tracks:
  talk:
    keyframes: [{at_s: 0, deg: {lip: 0}}, {at_s: 1, deg: {lip: 9}}]
"""


@pytest.mark.parametrize("keep", ["keep: time", "keep: {neck: time}"])
@pytest.mark.parametrize("tracks", ["", ONE_TRACK, f"{ONE_TRACK}    keep: angle\n"])
def test_a_written_file_keeps_the_same(load, tmp_path, keep, tracks):
    keys = KEYS.replace("neck: 5}", "neck: 5}, exact: true, weight: 2.5")
    sequence = load(f"{keep}\n{keys}{tracks}")
    write_sequence(sequence, tmp_path / "again.yaml")
    assert load_sequence(tmp_path / "again.yaml") == sequence


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (f"keep: {{jow: time}}\n{KEYS}", 3, "did you mean 'jaw'"),
        (f"keep: never\n{KEYS}", 3, "keep"),
        (
            "keep: time\ntiming: fastest\nkeyframes: [{deg: {jaw: 0}}, {deg: {jaw: 9}}]\n",
            3,
            "keeps the author's times, but this file gives none",
        ),
        (KEYS.replace("neck: 5}", "neck: 5}, exact: true"), 5, "exact is for joints that keep"),
        (CLAP.replace("keep: time", "keep: time, exact: true"), 5, "remove one of them"),
        (CLAP.replace("keep: time", "keep: angle"), 5, "there are: time"),
        (
            "timing: fastest\nkeyframes: [{deg: {jaw: 0}}, {deg: {jaw: 9}, keep: time}]\n",
            4,
            "keeps the author's times, but this file gives none",
        ),
        (KEYS.replace("neck: 5}", "neck: 5}, weight: 3"), 5, "weight is for joints that keep"),
        (KEYS.replace("neck: 5}", "neck: 5}, weight: 0.5"), 5, "weight"),
        ("keep: time\nplay: [{pause_s: 1}]\n", 3, "keep does not go with 'play'"),
    ],
)
def test_what_contradicts_is_named_with_its_line(load, text, line, reason):
    with pytest.raises(InputError) as caught:
        load(text)
    assert reason in caught.value.reason
    assert caught.value.line == line
