from __future__ import annotations

import os
import stat
import subprocess
import sys

import pytest

from lss_motion.errors import InputError
from lss_motion.playing.performer import Performer, performing
from lss_motion.playing.player.events import CueReached, Warned
from lss_motion.show.model import Cue
from tests.swing import until

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
        "def leave(at_s): raise SystemExit(3)\n"
        "def crash(at_s): import os; os._exit(7)\n"
        "def hold(at_s): import ctypes; ctypes.PyDLL(None).sleep(1000)\n"  # With the GIL.
        "def spawn(at_s): import subprocess; subprocess.Popen(['sleep', '1000'])\n"
    )
    player = tmp_path / "pw-play"
    player.write_text(f'#!/bin/sh\necho "$1" >> {tmp_path}/received\n')
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


@pytest.mark.parametrize(
    ("name", "reason"), [("fail", "RuntimeError: no fog"), ("leave", "SystemExit: 3")]
)
def test_an_exception_of_a_function_is_reported_and_the_next_one_runs(folder, capfd, name, reason):
    cues = [cue(folder, name, 1.0), cue(folder, "fog", 3.0)]
    with Performer(cues) as performer:
        for one in cues:
            performer.perform(one)
    assert performer.take_warnings() == [f"run effects:{name} at 1 s: {reason}"]
    assert (folder / "fog").read_text() == "3.0 "
    assert capfd.readouterr() == ("", "")


def test_a_function_that_ends_its_process_is_reported(folder):
    with Performer([cue(folder, "crash", 1.0)]) as performer:
        performer.perform(cue(folder, "crash", 1.0))
    assert performer.take_warnings() == [
        "the process for functions and sounds ended with exit code 7"
    ]
    assert performer.unfinished()[0].startswith("not done: run effects:crash at 1 s")


def test_a_module_that_hangs_while_it_is_imported_is_an_input_error(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.playing.performer.START_S", 0.8)
    (folder / "slow.py").write_text("import time\ntime.sleep(1000)\n")
    with pytest.raises(InputError, match="'slow:fog' cannot be used: importing its module takes"):
        Performer([Cue(at_s=0.0, run="slow:fog", folder=str(folder))])


def test_a_module_that_ends_the_process_while_it_is_imported_is_an_input_error(folder):
    (folder / "bad.py").write_text("import os\nos._exit(3)\n")
    with pytest.raises(InputError, match="ended while 'bad:fog' was imported"):
        Performer([Cue(at_s=0.0, run="bad:fog", folder=str(folder))])


def in_group(pid):
    """Return the processes of a group that have not ended."""
    listed = subprocess.run(
        ["ps", "-A", "-o", "pgid=,stat=,args="], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    fields = [line.split(None, 2) for line in listed]
    return [words for group, state, words in fields if int(group) == pid and state[0] != "Z"]


def ends_whole(pid):
    """Each process of a group ends; one that was just killed does so in its own time."""
    until(lambda: not in_group(pid), lambda: in_group(pid))


@pytest.mark.parametrize("name", ["stay", "hold", "spawn"])
def test_no_process_is_left_after_the_show(folder, monkeypatch, name):
    monkeypatch.setattr("lss_motion.playing.performer.CLOSE_S", 0.5)
    with Performer([cue(folder, name)]) as performer:
        pid = performer._child.pid
        performer.perform(cue(folder, name))
    ends_whole(pid)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stay", "hold", "spawn", "fog"])
def test_no_process_is_left_when_the_player_is_killed(folder, name):
    code = (
        "import os, sys, time\n"
        "from lss_motion.playing.performer import Performer\n"
        "from lss_motion.show.model import Cue\n"
        f"cue = Cue(at_s=0.0, run='effects:{name}', folder={str(folder)!r})\n"
        "performer = Performer([cue])\n"
        "performer.perform(cue)\n"
        "print(performer._child.pid, flush=True)\n"
        "time.sleep(0.5)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    killed = subprocess.run(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=False
    )
    pid = int(killed.stdout)
    ends_whole(pid)


@pytest.mark.parametrize("name", ["smoke", "number"])
def test_a_missing_function_is_an_input_error_before_the_show(folder, name):
    with pytest.raises(InputError, match=f"effects:{name}"):
        Performer([cue(folder, name)])


def test_sounds_are_played_by_an_installed_program(folder, monkeypatch):
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    with Performer([Cue(at_s=0.0, sound="bell.wav")]) as performer:
        assert performer.take_warnings() == []
        performer.perform(Cue(at_s=0.0, sound="bell.wav"))
    assert (folder / "received").read_text() == "bell.wav\n"


def test_a_sound_that_cannot_be_played_is_reported_with_the_last_line_of_its_player(
    folder, monkeypatch, capfd
):
    (folder / "pw-play").write_text("#!/bin/sh\necho one\necho no such device >&2\nexit 5\n")
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    bell = Cue(at_s=0.0, sound="/far/bell.wav")
    with Performer([bell]) as performer:
        performer.perform(bell)
    assert performer.take_warnings() == [
        "sound bell.wav: pw-play ended with exit code 5: no such device"
    ]
    assert performer.unfinished() == [
        "functions and sounds printed 2 lines; the last:\n  one\n  no such device"
    ]
    assert capfd.readouterr() == ("", "")


def test_a_sound_that_is_longer_than_the_show_is_stopped_and_named(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.playing.performer.CLOSE_S", 0.5)
    (folder / "pw-play").write_text("#!/bin/sh\nsleep 1000\n")
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    bell = Cue(at_s=0.0, sound="/far/bell.wav")
    with Performer([bell]) as performer:
        performer.perform(bell)
        pid = performer._child.pid
    assert performer.unfinished() == ["a sound was stopped that did not end 0.5 s after the show"]
    ends_whole(pid)


def test_a_function_that_never_returns_delays_no_command(folder, monkeypatch):
    """Lines that do not fit into the pipe are lost; the process is ended after the show."""
    monkeypatch.setattr("lss_motion.playing.performer.CLOSE_S", 0.1)
    stay = cue(folder, "stay")
    with Performer([stay]) as performer:
        for _ in range(3000):
            performer.perform(stay)
    assert performer.lost
    assert "and 2995 more" in performer.unfinished()[0]


def test_functions_that_did_not_run_behind_a_slow_one_are_named(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.playing.performer.CLOSE_S", 1.0)
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


def test_output_of_functions_is_kept_from_the_screen_and_reported_at_the_end(folder, capfd):
    (folder / "loud.py").write_text(
        "import os, subprocess, sys\n"
        "print('first')\n"
        "def shout(at_s):\n    print('...')\n    os.write(1, b'....\\n')\n"
        "    subprocess.run(['echo', '.....'])\n    print('!' * 1000, file=sys.stderr)\n"
        "    assert sys.stdin.read() == ''\n"
    )
    loud = Cue(at_s=0.0, run="loud:shout", folder=str(folder))
    with Performer([loud]) as performer:
        performer.perform(loud)
    assert performer.take_warnings() == []
    [text] = performer.unfinished()
    assert text.splitlines() == [
        "functions and sounds printed 5 lines; the last:",
        *["  first", "  ...", "  ....", "  .....", "  " + "!" * 200],
    ]
    assert capfd.readouterr() == ("", "")


def test_a_show_ends_with_a_warning_about_functions_that_did_not_run(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.playing.performer.CLOSE_S", 0.1)
    stay, told = cue(folder, "stay", 1.0), []
    with performing([stay], told.append, is_virtual=False) as on_event:
        on_event(CueReached(stay, 1.0))
    assert told[0] == CueReached(stay, 1.0)
    assert [event.text[:31] for event in told[1:]] == ["not done: run effects:stay at 1"]
    assert isinstance(told[1], Warned)
