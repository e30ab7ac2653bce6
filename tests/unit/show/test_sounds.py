"""The sound of a show and the sounds among its events, from the file to the compiled text."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

import lss_motion as lss
from lss_motion.errors import InputError
from lss_motion.planning.program.text import cue_line, from_text, read_cue
from lss_motion.show.model import Cue, SoundStyle

ROBOT = Path(__file__).parents[3] / "sequences" / "robots" / "desk_arm.yaml"
FRAMES = """\
sequence: s
keyframes:
  - {at_s: 0.0, deg: {elbow: 0}}
  - {at_s: 1.0, deg: {elbow: 10}}
  - {at_s: 2.0, deg: {elbow: 0}}
"""


def load(folder, text):
    for name in ("music.ogg", "bell.wav"):
        (folder / name).write_bytes(b"")
    path = folder / "s.yaml"
    path.write_text(FRAMES + text)
    return lss.load_sequence(path, lss.load_robot(ROBOT))


def compiled(folder, text):
    robot = lss.load_robot(ROBOT)
    return lss.compile(lss.plan(load(folder, text), robot), robot)


def sounds(program, until_s=100.0):
    found = []
    for start_s, cue in program.unrolled_cues():
        if start_s > until_s:
            break
        found.append((round(start_s, 3), Path(cue.sound).name, cue.style))
    return found


def test_the_sound_of_a_show_begins_and_ends_with_every_pass(tmp_path):
    program = compiled(tmp_path, "loop: 3\nsound: {file: music.ogg, gain_db: -6}\n")
    starts = [start_s for start_s, _, _ in sounds(program)]
    assert len(starts) == 3
    assert starts[0] == 0.0
    for (start_s, name, style), end_s in zip(
        sounds(program), [*starts[1:], program.duration_s], strict=True
    ):
        assert (name, style.is_bed, style.gain_db) == ("music.ogg", True, -6.0)
        assert start_s + style.lasts_s == pytest.approx(end_s, abs=1e-3)


def test_an_endless_show_has_its_sound_in_every_pass(tmp_path):
    program = compiled(tmp_path, "loop: forever\nsound: music.ogg\n")
    starts = [start_s for start_s, _, _ in sounds(program, until_s=30.0)]
    gaps = {round(after - before, 2) for before, after in itertools.pairwise(starts[1:])}
    assert len(starts) > 5
    assert len(gaps) == 1


def test_at_another_speed_a_sound_knows_its_own(tmp_path):
    program = compiled(tmp_path, "speed_ratio: 0.5\nsound: music.ogg\n")
    assert [style.speed_ratio for _, _, style in sounds(program)] == [0.5]


def test_a_looped_sound_among_the_events_ends_with_the_pass_and_another_is_not_cut(tmp_path):
    program = compiled(
        tmp_path,
        "events:\n  - {at_s: 0.5, sound: bell.wav, loop: true, duck_db: 12}\n"
        "  - {at_s: 1.0, sound: bell.wav, lead_s: 0.2}\n",
    )
    (_, _, looped), (start_s, _, once) = sounds(program)
    assert (looped.is_looped, looped.duck_db) == (True, 12.0)
    assert looped.lasts_s == pytest.approx(program.duration_s - 0.5)
    assert (start_s, once.lasts_s) == (0.8, None), "a spawned player starts earlier"


def test_the_text_of_a_program_keeps_how_a_sound_is_played(tmp_path):
    program = compiled(tmp_path, "loop: 2\nsound: {file: music.ogg, loop: true}\n")
    again = from_text(program.to_text(), lss.load_robot(ROBOT))
    assert [cue.style for cue in again.cues] == [cue.style for cue in program.cues]
    plain = Cue(at_s=1.0, sound="/a/bell.wav")
    assert "style" not in cue_line(plain)
    assert read_cue(cue_line(plain), ()) == plain
    for bad in ('{"sound": "a", "style": {"x": 1}}', '{"sound": "a", "style": {"gain_db": "1"}}'):
        with pytest.raises(ValueError, match="style"):
            read_cue(f"0 {bad}", ())
    assert read_cue('0 {"sound": "a", "style": {"is_bed": true}}', ()).style == SoundStyle(
        is_bed=True
    )


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("sound: nothing.ogg\n", 6, "sound file 'nothing.ogg' not found"),
        ("sound: {file: music.ogg, gain_db: 90}\n", 6, "gain_db"),
        ("sound: 5\n", 6, "sound"),
        ("events: [{at_s: 1, say: hi, gain_db: 3}]\n", 6, "gain_db belongs to a sound"),
        ("events: [{at_s: 1, say: hi, loop: true}]\n", 6, "loop belongs to a sound"),
        ("on_fault: {sound: slow}\n", 6, "use warn or hold"),
    ],
)
def test_a_mistake_about_a_sound_is_named_with_its_line(tmp_path, text, line, reason):
    with pytest.raises(InputError, match=reason) as caught:
        load(tmp_path, text)
    assert caught.value.line == line
