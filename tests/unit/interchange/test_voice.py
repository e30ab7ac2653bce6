"""`lss-motion import voice.wav --joint jaw`: what the servo gives of a sound, and what is said."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import lss_motion as lss
from lss_motion.cli.main import main
from lss_motion.errors import InputError, install_command
from lss_motion.interchange.voice import VoiceFollow, VoiceStyle, _swells, fitted, voice_sequence
from lss_motion.sound.envelope import TurningPoint
from lss_motion.sound.files import SoundPart
from tests.speech import spoken

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)
PEAKS_S = [0.6, 0.82, 1.02, 1.7, 1.95, 2.6]
ROBOT = """\
robot: talker
defaults: {model: LSS-ST1, speed_max_deg_s: 360, accel_max_deg_s2: 1000}
joints:
  jaw: {id: 1, range_deg: [0, 25]}
  head: {id: 2, range_deg: [-60, 60], speed_max_deg_s: 120, accel_max_deg_s2: 300}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    both = np.stack([spoken(PEAKS_S, 3.2), np.roll(spoken(PEAKS_S, 3.2), 4410)], axis=1)
    soundfile.write("voice.wav", both, 22_050)
    return tmp_path


def run(*words):
    return main(["import", "voice.wav", "--robot", "robot.yaml", *words])


def planned(path="jaw.yaml"):
    sequence = lss.load_sequence(path)
    robot = lss.load_robot("robot.yaml")
    return sequence, lss.plan(sequence, robot)


def test_the_jaw_is_open_when_the_sound_is_loud_within_its_limits_and_says_what_it_lacks(
    folder, capsys
):
    assert run("--joint", "jaw", "--channel", "left", "-o", "jaw.yaml") == 0
    said = capsys.readouterr().out
    assert "6 openings of up to 25 deg: the servo makes 0 of them fully, and 6 less far," in said
    sequence, trajectory = planned()
    assert sequence.keeps_time == {"jaw"}
    assert [cue.sound for cue in sequence.events] == [str(folder / "voice.wav")]
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    jaw_deg = trajectory.sample(times_s)[:, 0]
    assert trajectory.duration_s == pytest.approx(3.2, abs=0.01)
    is_turn = (jaw_deg[1:-1] > jaw_deg[:-2]) & (jaw_deg[1:-1] >= jaw_deg[2:])
    found_s = times_s[1:-1][is_turn & (jaw_deg[1:-1] > 2.0)]
    assert found_s == pytest.approx(PEAKS_S, abs=0.02)
    asked = float(said.partition("at most ")[2].split()[0])
    assert asked == pytest.approx(25.0 - jaw_deg[np.searchsorted(times_s, PEAKS_S)].min(), abs=0.3)
    assert jaw_deg[np.searchsorted(times_s, 2.3)] < 1.0, "closed in the pause"


def test_a_jaw_that_keeps_its_angles_says_how_far_it_falls_behind_the_sound(folder, capsys):
    assert run("--joint", "jaw", "--keep", "angle", "--full", "-o", "jaw.yaml") == 0
    said = capsys.readouterr().out
    sequence, trajectory = planned()
    assert not sequence.keeps_time
    late_s = max(mark.planned_s - mark.authored_s for mark in trajectory.marks)
    assert late_s > 0.5
    assert f"keep: angle leaves the joint up to {late_s:.3f} s behind the sound" in said
    assert "less far" not in said, "it gets to every angle, later"


def test_each_figure_gets_its_own_voice_and_a_small_mouth_opens_fully(folder, capsys):
    words = ("--joint", "jaw", "--channel", "2", "--open-deg", "2", "--no-sound", "-o", "jaw.yaml")
    assert run(*words) == 0
    assert (
        "6 openings of up to 2 deg: the servo makes all of them fully." in capsys.readouterr().out
    )
    sequence, _ = planned()
    assert sequence.events == ()
    highest = [frame.at_s for frame in sequence.keyframes if frame.deg["jaw"] > 1.8]
    assert highest == pytest.approx([peak_s + 0.2 for peak_s in PEAKS_S], abs=0.006)


def test_as_a_layer_it_comes_later_and_keeps_its_time(folder):
    assert run("--joint", "jaw", "--channel", "left", "--open-deg", "2", "-o", "jaw.yaml") == 0
    (folder / "show.yaml").write_text(
        "sequence: show\nrobot: robot.yaml\nkeyframes:\n"
        "  - {at_s: 0, deg: {head: 0, jaw: 0}}\n  - {at_s: 1.0, deg: {head: 100}}\n"
        "  - {at_s: 5, deg: {head: 0}}\n"
        "layers:\n  - {file: jaw.yaml, joints: [jaw], from_s: 1.5}\n".replace("100", "50")
    )
    _, trajectory = planned("show.yaml")
    jaw = trajectory.joints.index("jaw")
    assert trajectory.sample(np.array([1.5 + PEAKS_S[0]]))[0, jaw] == pytest.approx(2.0, abs=0.2)
    assert [(cue.at_s, cue.sound) for cue in trajectory.cues] == [(1.5, str(folder / "voice.wav"))]


def test_a_nod_and_a_sway_are_slow_and_follow_the_sound(folder):
    words = (
        "--joint",
        "head",
        "--closed-deg",
        "-10",
        "--open-deg",
        "20",
        "--speed-max-deg-s",
        "15",
    )
    assert run(*words, "--follow", "energy", "-o", "nod.yaml") == 0
    _, trajectory = planned("nod.yaml")
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    assert 5.0 < np.abs(trajectory.sample(times_s, 1)).max() <= 15.01
    speech_s, pause_s = trajectory.sample(np.array([0.85, 3.1]))[:, 0]
    assert speech_s > pause_s + 5.0

    silence, voice = np.zeros(22_050), spoken([0.2, 0.4, 0.6, 0.8], 1.0)
    left, right = np.concatenate([voice, silence] * 2), np.concatenate([silence, voice] * 2)
    soundfile.write("voice.wav", np.stack([left, right], axis=1), 22_050)
    assert run(*words, "--follow", "stereo", "-o", "sway.yaml") == 0
    _, trajectory = planned("sway.yaml")
    left_deg, right_deg = trajectory.sample(np.array([2.5, 3.5]))[:, 0]
    assert right_deg > left_deg + 5.0


def test_swells_that_are_too_fast_become_smaller_not_faster(folder):
    joint = lss.load_robot("robot.yaml").joints["head"]
    style = VoiceStyle(follow=VoiceFollow.ENERGY, speed_max_deg_s=20.0)
    times_s = np.arange(0.0, 12.0, 0.01)
    turns = _swells((times_s % 1.0 < 0.5).astype(float), 0.01, joint, style, 30.0)
    at_s, deg = np.array([(turn.at_s, 30.0 * turn.ratio) for turn in turns]).T
    fastest_deg_s = 1.5 * np.abs(np.diff(deg)) / np.diff(at_s)
    assert 15.0 < fastest_deg_s.max() <= 20.0 + 1e-9
    assert len(turns) > 20, "each swell is still there"


def test_neighbours_are_within_reach_and_nothing_is_given_up_without_need():
    joint = lss.load_robot({"robot": "r", "joints": {
        "jaw": {"id": 1, "model": "LSS-ST1", "range_deg": [0, 25], "speed_max_deg_s": 360,
                "accel_max_deg_s2": 1000}}}).joints["jaw"]  # fmt: skip
    rng = np.random.default_rng(7)
    times_s = np.cumsum(rng.uniform(0.05, 0.4, 60))
    ratios = np.where(np.arange(60) % 2, rng.uniform(0.3, 1.0, 60), 0.1)
    turns = [
        TurningPoint(at_s=at_s, ratio=ratio) for at_s, ratio in zip(times_s, ratios, strict=True)
    ]
    found_deg = fitted(turns, 25.0 * ratios, joint)
    reach_deg = np.minimum(300.0 * np.diff(times_s) ** 2, 240.0 * np.diff(times_s))
    assert (np.abs(np.diff(found_deg)) - reach_deg).max() < 0.01
    is_free = np.abs(np.diff(25.0 * ratios)) < reach_deg
    alone = is_free[1:] & is_free[:-1]
    assert alone.sum() > 5
    still = [k for k in np.flatnonzero(alone) + 1 if is_free[max(k - 2, 0) : k + 2].all()]
    assert np.abs(found_deg - 25.0 * ratios)[still].max() < 1.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-o", "x.yaml"], "is a sound; name the joint that follows it, such as --joint jaw"),
        (["--joint", "jwa", "-o", "x.yaml"], "has no joint 'jwa'; did you mean 'jaw'?"),
        (["--joint", "head", "-o", "x.yaml"], "give both --closed-deg and --open-deg"),
        (
            ["--joint", "jaw", "--open-deg", "40", "-o", "x.yaml"],
            "outside the range of joint 'jaw'",
        ),
        (["--joint", "jaw", "--motion", "a", "-o", "x.yaml"], "--motion: not for a sound"),
        (["--gain-db", "3", "-o", "x.yaml"], "--gain-db: only for a sound; add --joint"),
        (["--joint", "jaw", "--channel", "3", "-o", "x.yaml"], "has no channel 3; it has 2"),
        (["--joint", "jaw", "--span", "9", "12", "-o", "x.yaml"], "has no sound from 9 s to 12 s"),
    ],
)
def test_what_cannot_be_is_said_and_nothing_is_written(folder, capsys, words, said):
    assert run(*words) == 2
    assert said in capsys.readouterr().err
    assert not (folder / "x.yaml").exists()


def test_without_the_extra_the_command_that_installs_it_is_named(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "soundfile", None)
    assert run("--joint", "jaw", "-o", "x.yaml") == 2
    assert f"sound files need a library: {install_command('sound')}" in capsys.readouterr().err


def test_more_keys_than_a_file_may_have_are_refused_with_the_parts_to_import(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.interchange.voice.KEYFRAMES_MAX", 5)
    part, robot = SoundPart(path=folder / "voice.wav"), lss.load_robot("robot.yaml")
    with pytest.raises(InputError, match=r"at most 5 are allowed; import it in parts .* --span"):
        voice_sequence(part, robot, "jaw", VoiceStyle(follow=VoiceFollow.SYLLABLES))
