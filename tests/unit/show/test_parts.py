"""Tracks, play lists, layers, speed and mirror of files with several parts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from lss_motion.errors import InputError
from lss_motion.show.keyframes import at_speed
from lss_motion.show.load import load_sequence

if TYPE_CHECKING:
    from pathlib import Path

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  l: {id: 1}
  r: {id: 2, range_deg: [-20, 90]}
  head: {id: 3}
groups: {arms: [l, r]}
mirror: {same: {l: r}, opposite: {head: head}}
sensors: {eye: {id: 203, kind: GP2Y0A41SK0F}, knob: {id: 204}}
"""

NOD = "sequence: nod\nkeyframes:\n  - {at_s: 0, deg: {head: 0}}\n  - {at_s: 1, deg: {head: 20}}\n"
LIFT = "sequence: lift\nkeyframes:\n  - {at_s: 0, deg: {l: 0}}\n  - {at_s: 2, deg: {l: 40}}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    (tmp_path / "nod.yaml").write_text(NOD, encoding="utf-8")
    (tmp_path / "lift.yaml").write_text(LIFT, encoding="utf-8")
    return tmp_path


@pytest.fixture
def load(folder):
    def load(text: str):
        path = folder / "show.yaml"
        path.write_text("sequence: show\nrobot: robot.yaml\n" + text, encoding="utf-8")
        return load_sequence(path)

    return load


@pytest.fixture
def refused(load):
    def refused(text: str) -> str:
        with pytest.raises(InputError) as caught:
            load(text)
        return str(caught.value)

    return refused


def test_tracks_have_their_own_keyframes_timing_and_loop(load):
    show = load(
        "keyframes:\n  - {at_s: 0, deg: {l: 0}}\n"
        "tracks:\n  head:\n    timing: fastest\n    loop: forever\n"
        "    keyframes:\n      - {deg: {head: 0}}\n      - {deg: {head: 9}}\n"
        "      - {deg: {head: 0}}\n"
    )
    (track,) = show.tracks
    assert (track.name, track.loop, str(track.timing)) == ("head", None, "fastest")
    assert [frame.deg["head"] for frame in track.keyframes] == [0, 9, 0]
    assert track.keyframes[1].line == 11


def test_what_is_muted_is_left_out_and_checked_all_the_same(load, refused):
    base = "keyframes: [{at_s: 0, deg: {l: 0}}, {at_s: 1, deg: {l: 9}}]\n"
    show = load(
        base + "tracks:\n  one: {keyframes: [{at_s: 0, deg: {head: 1}}]}\n"
        "  other: {mute: true, keyframes: [{at_s: 0, deg: {head: 5}}]}\n"
        "layers: [{file: nod.yaml, mute: true}, {file: nod.yaml, weight: 0.5}]\n"
    )
    assert [track.name for track in show.tracks] == ["one"], "it does not key head twice"
    assert [layer.weight for layer in show.layers] == [0.5]
    assert "900" in refused(base + "tracks: {a: {mute: true, keyframes: [{deg: {head: 900}}]}}\n")
    assert "nod2.yaml" in refused(base + "layers: [{file: nod2.yaml, mute: true}]\n")
    assert "nothing moves" in refused("tracks: {a: {mute: true, keyframes: [{deg: {l: 1}}]}}\n")


def test_a_show_that_loops_forever_may_have_layers(load):
    show = load(
        "loop: forever\nkeyframes:\n  - {at_s: 0, deg: {l: 0}}\n  - {at_s: 1, deg: {l: 9}}\n"
        "  - {at_s: 2, deg: {l: 0}}\nlayers: [{file: nod.yaml, from_s: 3}]\n"
    )
    assert show.loop is None
    assert [layer.sequence.name for layer in show.layers] == ["nod"]


def test_a_play_list_holds_files_and_pauses(load, folder):
    show = load(
        "play:\n  - {file: nod.yaml, times: 3, speed_ratio: 0.5}\n  - {pause_s: 2}\n"
        "  - {file: lift.yaml, move_s: 1.5}\n"
    )
    nod, pause, lift = show.play
    assert (nod.times, nod.sequence.speed_ratio, nod.sequence.name) == (3, 0.5, "nod")
    assert (pause.sequence, pause.pause_s) == (None, 2.0)
    assert (lift.move_s, lift.sequence.path) == (1.5, folder / "lift.yaml")


def test_join_through_appends_the_keyframes_of_the_step(load):
    show = load(
        "play:\n  - {file: nod.yaml}\n  - {file: lift.yaml, join: through, speed_ratio: 2}\n"
        "  - {file: nod.yaml, join: through, move_s: 0.5}\n"
    )
    (step,) = show.play
    assert [(frame.at_s, *frame.deg.items()) for frame in step.sequence.keyframes] == [
        (0.0, ("head", 0)),
        (1.0, ("head", 20)),
        (1.0, ("l", 0)),
        (2.0, ("l", 40)),
        (2.5, ("head", 0)),
        (3.5, ("head", 20)),
    ]


def test_mirror_exchanges_left_and_right(load):
    for text in (
        "mirror: true\nkeyframes: [{at_s: 0, deg: {l: 10, head: 5}}]\n",
        "mirror: true\ntracks: {a: {keyframes: [{at_s: 0, deg: {r: -10}}]},"
        " b: {keyframes: [{at_s: 0, deg: {l: 10, head: 5}}]}}\n",
    ):
        show = load(text)
        assert (show.tracks[1:] or [show])[0].keyframes[0].deg == {"r": 10, "head": -5}
    step = load("play: [{file: nod.yaml, mirror: true}]\n").play[0]
    assert step.sequence.keyframes[1].deg == {"head": -20}


def test_a_mirrored_angle_out_of_range_is_refused(refused):
    message = refused("mirror: true\nkeyframes:\n  - {at_s: 0, deg: {l: -30}}\n")
    assert "show.yaml:5: joint 'r' at -30 deg is outside its range, -20 to 90 deg" in message


def test_a_layer_has_joints_and_groups(load):
    base = "keyframes: [{at_s: 0, deg: {l: 0, r: 0}}]\nlayers:\n"
    whole, part = load(
        base + "  - {file: lift.yaml}\n  - {file: lift.yaml, joints: [arms], mode: add, from_s: 1,"
        " to_s: 3, weight: 0.5, fade_s: 0.2}\n"
    ).layers
    assert (whole.joints, whole.mode, whole.weight, whole.to_s) == (("l",), "override", 1.0, None)
    assert (part.joints, part.mode, part.weight) == (("l", "r"), "add", 0.5)
    assert (part.from_s, part.to_s, part.fade_s) == (1.0, 3.0, 0.2)


def test_an_added_layer_can_have_angles_beyond_the_range(load, refused, folder):
    (folder / "dip.yaml").write_text(
        "sequence: dip\nkeyframes: [{at_s: 0, deg: {r: -50}}]\n", encoding="utf-8"
    )
    base = "keyframes: [{at_s: 0, deg: {r: 60}}]\nlayers: "
    assert load(base + "[{file: dip.yaml, mode: add}]\n").layers
    assert "dip.yaml:2: joint 'r' at -50 deg" in refused(base + "[{file: dip.yaml}]\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("play: [{file: nod.yaml, pause_s: 1}]", "a step is a 'file', a 'pause_s' or a 'wait_for'"),
        ("play: [{times: 2}]", "a step is a 'file', a 'pause_s' or a 'wait_for'"),
        ("play: [{pause_s: 1, times: 2}]", "times belongs to a file"),
        ("play: [{file: none.yaml}]", "sequence file 'none.yaml' not found; looked for"),
        ("play: [{file: show.yaml}]", "show.yaml would play itself without end"),
        ("play: [{file: endless.yaml}]", "endless.yaml loops forever"),
        ("play: [{pause_s: 1}, {file: nod.yaml, join: through}]", "through needs keyframes"),
        ("play: [{file: nod.yaml, idle: nod.yaml}]", "idle belongs to a wait_for"),
        (
            "play: [{wait_for: {sensor: eye, below_mm: 3}, idle: tracks.yaml}]",
            "tracks.yaml has tracks that loop forever; give each loop a count",
        ),
        ("play: [{file: nod.yaml}, {file: nod.yaml, join: through}]", "20 to 0 deg in no time"),
        ("play: [{wait_for: {sensor: nose, below_mm: 300}}]", "has no sensor 'nose'"),
        ("play: [{wait_for: {sensor: eye}}]", "needs one of 'below_mm' and 'above_mm'"),
        ("play: [{wait_for: {sensor: eye, below_raw: 3}}]", "needs one of 'below_mm'"),
        ("play: [{wait_for: {sensor: knob, below_mm: 3}}]", "of kind raw needs one of 'below_raw'"),
        ("play: [{wait_for: {sensor: eye, below_mm: 3, above_mm: 9}}]", "needs one of"),
        ("play: [{pause_s: 1, timeout_s: 3}]", "timeout_s belongs to a wait_for"),
        ("play: [{wait_for: {sensor: eye, below_mm: 3}, times: 2}]", "times belongs to a file"),
        ("play: [{file: bad.yaml}]", "bad.yaml:2: joint 'l' at 900 deg"),
        ("play: [{file: quick.yaml, speed_ratio: 2}]", "as fast as the limits allow"),
        ("timing: fastest\nplay: [{pause_s: 1}]", "timing does not go with 'play'"),
        ("loop: 2\ntracks: {a: {keyframes: [{deg: {l: 1}}]}}", "nothing to loop"),
        ("mirror: true", "give 'keyframes', 'tracks' or 'play'"),
        ("play: [{pause_s: 1}]\nlayers: [{file: nod.yaml, joints: [hed]}]", "did you mean 'head'"),
        ("play: [{pause_s: 1}]\nlayers: [{file: nod.yaml, joints: [arms]}]", "keys none of them"),
        ("play: [{pause_s: 1}]\nlayers: [{file: nod.yaml, from_s: 2, to_s: 1}]", "not after from"),
        ("play: [{pause_s: 1}]\nlayers: [{file: nod.yaml, weight: 2}]", "must be 1 or less"),
    ],
)
def test_wrong_parts_are_refused_with_the_reason(refused, folder, text, message):
    (folder / "endless.yaml").write_text(
        "sequence: e\nloop: forever\nkeyframes: [{at_s: 0, hold_s: 1, deg: {l: 1}}]\n"
    )
    (folder / "tracks.yaml").write_text(
        "sequence: t\n"
        "tracks: {a: {loop: forever, keyframes: [{at_s: 0, hold_s: 1, deg: {l: 1}}]}}\n"
    )
    (folder / "bad.yaml").write_text("sequence: b\nkeyframes: [{at_s: 0, deg: {l: 900}}]\n")
    (folder / "quick.yaml").write_text("sequence: q\nkeyframes: [{deg: {l: 0}}, {deg: {l: 1}}]\n")
    assert message in refused(text + "\n")


def test_of_an_idle_motion_that_loops_forever_one_pass_is_repeated(load, folder):
    (folder / "endless.yaml").write_text(
        "sequence: e\nloop: forever\nkeyframes: [{at_s: 0, deg: {l: 0}}, {at_s: 2, deg: {l: 0}}]\n"
    )
    show = load("play: [{wait_for: {sensor: eye, below_mm: 300}, idle: endless.yaml}]\n")
    (step,) = show.play
    assert step.wait is not None
    assert step.sequence is not None
    assert (step.sequence.name, step.sequence.loop) == ("e", 1)


def test_files_that_play_each_other_are_refused(refused, folder):
    (folder / "other.yaml").write_text("sequence: o\nplay: [{file: show.yaml}]\n")
    assert "other.yaml:2: show.yaml would play itself" in refused("play: [{file: other.yaml}]\n")


def test_a_play_list_with_too_many_nested_steps_is_refused(refused, folder):
    (folder / "0.yaml").write_text(NOD)
    for level in range(1, 4):
        steps = ", ".join([f"{{file: {level - 1}.yaml}}"] * 11)
        (folder / f"{level}.yaml").write_text(f"sequence: x\nplay: [{steps}]\n")
    assert "more than 1000 steps" in refused("play: [{file: 3.yaml}]\n")


def test_every_time_is_divided_by_the_speed(load):
    show = load(
        "speed_ratio: 0.5\nplay:\n  - {file: nod.yaml, speed_ratio: 0.5, move_s: 2}\n"
        "  - {pause_s: 1}\nlayers: [{file: lift.yaml, from_s: 1, to_s: 2, fade_s: 0.25}]\n"
    )
    slow = at_speed(show)
    nod, pause = slow.play
    (layer,) = slow.layers
    assert [frame.at_s for frame in nod.sequence.keyframes] == [0.0, 4.0]
    assert (nod.move_s, pause.pause_s) == (4.0, 2.0)
    assert (layer.from_s, layer.to_s, layer.fade_s) == (2.0, 4.0, 0.5)
    assert layer.sequence.keyframes[-1].at_s == 4.0
    assert at_speed(slow) == slow
