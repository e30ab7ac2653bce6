"""Beats of synthetic music: what is right, what is half a beat off, and what becomes of it."""

from __future__ import annotations

import json

import numpy as np
import pytest

import lss_motion as lss
from benches.drums import RATE_HZ, Style, music, verdict
from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.sound.beats import beats_of, every, half_shifted
from lss_motion.sound.files import SoundPart

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)
SHOW = """\
# my show
sequence: s
robot: robot.yaml
keyframes:                        # three of them
  - {at_s: 0, deg: {a: 0}}
  - {at_s: 4, deg: {a: 10}}
"""


def written(folder, style, seconds=16.0):
    samples, true_s = music(style, seconds)
    path = folder / "song.wav"
    soundfile.write(path, np.clip(samples, -1.0, 1.0), RATE_HZ)
    return SoundPart(path=path), true_s


@pytest.mark.parametrize(
    "style",
    [
        Style(name="slow", bpm=60),
        Style(name="off-beats", bpm=97, off_gain=0.4, has_chords=True),
        Style(name="swing", bpm=120, off_gain=0.4, swing=0.66),
        Style(name="change", bpm=120, to_bpm=138, off_gain=0.3),
        Style(name="fast", bpm=180),
    ],
    ids=lambda style: style.name,
)
def test_beats_are_found_to_ten_milliseconds_with_their_tempo(tmp_path, style):
    part, true_s = written(tmp_path, style)
    found = beats_of(part)
    name, share, error_s = verdict(found.at_s, true_s)
    assert (name, share > 0.95) == ("right", True), (name, share, found.bpm)
    assert abs(error_s) < 0.01
    assert found.bpm_range[0] <= style.bpm * 1.01
    assert found.bpm_range[1] >= (style.to_bpm or style.bpm) * 0.99


def test_music_that_is_louder_off_the_beat_is_half_off_said_so_and_shifted_by_hand(tmp_path):
    part, true_s = written(tmp_path, Style(name="x", bpm=120, off_gain=0.8, has_kick=False))
    found = beats_of(part)
    assert verdict(found.at_s, true_s)[0] == "half off"
    assert found.off_beat_ratio > 0.4
    assert verdict(half_shifted(found.at_s), true_s)[0] == "right"


def test_a_tempo_that_is_known_decides_between_octaves(tmp_path):
    part, true_s = written(tmp_path, Style(name="x", bpm=75, off_gain=0.4))
    assert verdict(beats_of(part).at_s, true_s)[0] == "double"
    assert verdict(beats_of(part, 76.0).at_s, true_s)[0] == "right"


def test_every_second_beat_begins_with_the_one_nearest_to_a_time():
    at_s = np.array([0.5, 1.0, 1.5, 2.0, 2.5])
    assert every(at_s, 0.9, 2).tolist() == [1.0, 2.0]
    assert every(at_s, 0.0, 3).tolist() == [0.5, 2.0]


@pytest.mark.parametrize(
    ("samples", "said"),
    [(np.zeros(8 * RATE_HZ), "has no onset"), (np.zeros(RATE_HZ), "is shorter than 4 s")],
)
def test_what_has_no_beats_is_refused(tmp_path, samples, said):
    soundfile.write(tmp_path / "a.wav", samples, RATE_HZ)
    with pytest.raises(InputError, match=said):
        beats_of(SoundPart(path=tmp_path / "a.wav"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, Style(name="x", bpm=120, off_gain=0.3))
    (tmp_path / "show.yaml").write_text(SHOW)
    (tmp_path / "robot.yaml").write_text(
        "robot: r\njoints:\n  a: {id: 1, model: LSS-ST1, range_deg: [-90, 90], "
        "speed_max_deg_s: 180, accel_max_deg_s2: 600}\n"
    )
    return tmp_path


def test_beats_are_a_proposal_until_they_are_put_into_a_show(folder, capsys):
    assert main(["beats", "song.wav", "--plot", "song.png"]) == 0
    said = capsys.readouterr().out
    assert "31 beats from 0." in said
    assert "a minute (steady)" in said
    assert "this is a proposal" in said
    assert (folder / "song.png").stat().st_size > 10_000
    assert (folder / "show.yaml").read_text() == SHOW
    assert main(["beats", "song.wav", "--from", "2.3", "--into", "show.yaml"]) == 0
    assert "at_beat: 1 is at 2." in capsys.readouterr().out
    text = (folder / "show.yaml").read_text()
    assert text.startswith(SHOW)
    first_s = lss.load_sequence("show.yaml").beats_s[0]
    assert first_s == pytest.approx(2.2, abs=0.01)
    (folder / "show.yaml").write_text(text.replace("at_s: 4", "at_beat: 3.5"))
    sequence = lss.load_sequence("show.yaml")
    assert sequence.keyframes[1].at_s == pytest.approx(first_s + 1.25, abs=0.01)
    assert main(["plan", "show.yaml", "--plot", "show.png"]) == 0


def test_beats_that_a_show_has_are_replaced_only_with_force_and_as_anchors_on_request(
    folder, capsys, monkeypatch
):
    assert main(["beats", "song.wav", "--into", "show.yaml"]) == 0
    before = (folder / "show.yaml").read_text()
    assert main(["beats", "song.wav", "--shift", "half", "--into", "show.yaml"]) == 2
    assert "show.yaml:7: has beats already; --force replaces them" in capsys.readouterr().err
    assert (folder / "show.yaml").read_text() == before
    words = ["--shift", "half", "--every", "4", "--into", "show.yaml", "--anchors", "--force"]
    assert main(["beats", "song.wav", *words, "--json"]) == 0
    printed = capsys.readouterr()
    assert "in place of those before" in printed.err
    at_s = json.loads(printed.out)["at_s"]
    assert at_s[0] == pytest.approx(0.95, abs=0.01)
    assert np.diff(at_s) == pytest.approx([2.0] * (len(at_s) - 1), abs=0.01)
    (folder / "show.yaml").write_text(
        (folder / "show.yaml").read_text().replace("at_s: 4", "at_beat: 2")
    )
    assert lss.load_sequence("show.yaml").keyframes[1].is_anchor
    monkeypatch.setattr("lss_motion.show.file.EVENTS_MAX", 20)
    assert main(["beats", "song.wav", "--into", "show.yaml", "--force"]) == 2
    assert "has 31 beats, at most 20 go into a show; give --every" in capsys.readouterr().err
    assert main(["beats", "song.wav", "--into", "robot.yaml"]) == 2
    assert "is no sequence file" in capsys.readouterr().err
