from __future__ import annotations

import os
import stat
import sys

import pytest

from lss_motion.errors import InputError
from lss_motion.player.events import CueReached, Warned
from lss_motion.runtime.performer import Performer, performing
from lss_motion.sequence.model import Cue

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="plays a shell script")


@pytest.fixture
def folder(tmp_path):
    """A module whose function records its calls, and a sound player that does so, too."""
    (tmp_path / "effects.py").write_text(
        "from pathlib import Path\n"
        "def fog(at_s): Path(__file__).with_name('fog').open('a').write(f'{at_s} ')\n"
        "def fail(at_s): raise RuntimeError('no fog')\n"
        "def stay(at_s):\n    while True: pass\n"
        "number = 3\n"
    )
    player = tmp_path / "pw-play"
    player.write_text(f'#!/bin/sh\necho "$1" >> {tmp_path}/heard\n')
    player.chmod(player.stat().st_mode | stat.S_IXUSR)
    return tmp_path


def cue(folder, name, at_s=0.0):
    return Cue(at_s=at_s, run=f"effects:{name}", folder=str(folder))


def test_functions_are_called_with_the_time_of_the_show(folder):
    cues = [cue(folder, "fog", 1.5), cue(folder, "fog", 2.5)]
    with Performer(cues) as performer:
        assert not (folder / "fog").exists()
        for one in cues:
            performer.perform(one)
    assert (folder / "fog").read_text() == "1.5 2.5 "
    assert performer.unfinished() == []


def test_an_exception_of_a_function_is_printed_and_the_next_one_runs(folder, capfd):
    cues = [cue(folder, "fail"), cue(folder, "fog", 3.0)]
    with Performer(cues) as performer:
        for one in cues:
            performer.perform(one)
    assert "run: effects:fail: RuntimeError: no fog" in capfd.readouterr().err
    assert (folder / "fog").read_text() == "3.0 "


@pytest.mark.parametrize("name", ["smoke", "number"])
def test_a_missing_function_is_an_input_error_before_the_show(folder, name):
    with pytest.raises(InputError, match=f"effects:{name}"):
        Performer([cue(folder, name)])


def test_sounds_are_played_by_an_installed_program(folder, monkeypatch):
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    with Performer([Cue(at_s=0.0, sound="bell.wav")]) as performer:
        assert performer.warnings == []
        performer.perform(Cue(at_s=0.0, sound="bell.wav"))
    assert (folder / "heard").read_text() == "bell.wav\n"


def test_without_a_sound_player_there_is_a_warning_only(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with Performer([Cue(at_s=0.0, sound="bell.wav")]) as performer:
        [text] = performer.warnings
        assert text.startswith("no sounds: none of pw-play")
        performer.perform(Cue(at_s=0.0, sound="bell.wav"))


def test_a_function_that_never_returns_delays_no_command(folder, monkeypatch):
    """Lines that do not fit into the pipe are lost; the process is ended after the show."""
    monkeypatch.setattr("lss_motion.runtime.performer.CLOSE_S", 0.1)
    stay = cue(folder, "stay")
    with Performer([stay]) as performer:
        for _ in range(3000):
            performer.perform(stay)
    assert performer.lost
    assert "and 2995 more" in performer.unfinished()[0]


def test_functions_that_did_not_run_behind_a_slow_one_are_named(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.runtime.performer.CLOSE_S", 1.0)
    cues = [cue(folder, "fog", 0.5), cue(folder, "stay", 1.0), cue(folder, "fog", 2.0)]
    cues.append(Cue(at_s=2.5, sound="/far/bell.wav"))
    with Performer(cues) as performer:
        for one in cues:
            performer.perform(one)
    [text] = performer.unfinished()
    assert text.startswith(
        "not done: run effects:stay at 1 s (not at its end), run effects:fog at 2 s, sound "
        "bell.wav at 2.5 s. "
    )
    assert (folder / "fog").read_text() == "0.5 "


def test_output_of_functions_does_not_reach_the_reply_pipe(folder, capfd):
    (folder / "loud.py").write_text(
        "import os, subprocess\n"
        "def shout(at_s):\n    print('...')\n    os.write(1, b'....')\n"
        "    subprocess.run(['echo', '.....'])\n"
    )
    loud = Cue(at_s=0.0, run="loud:shout", folder=str(folder))
    with Performer([loud]) as performer:
        performer.perform(loud)
    assert performer.unfinished() == []
    assert "....." in capfd.readouterr().err


def test_a_show_ends_with_a_warning_about_functions_that_did_not_run(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.runtime.performer.CLOSE_S", 0.1)
    stay, told = cue(folder, "stay", 1.0), []
    with performing([stay], told.append, is_virtual=False) as on_event:
        on_event(CueReached(stay, 1.0))
    assert told[0] == CueReached(stay, 1.0)
    assert [event.text[:31] for event in told[1:]] == ["not done: run effects:stay at 1"]
    assert isinstance(told[1], Warned)
