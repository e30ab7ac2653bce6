"""Shows with sounds where they cannot be played on a stream, and what a person is told."""

from __future__ import annotations

import json
import sys
import wave
from pathlib import Path
from types import SimpleNamespace

import pytest
from msgspec.structs import replace

import lss_motion as lss
from lss_motion.cli.play import main as play
from lss_motion.cli.terminal import Inputs
from lss_motion.errors import install_command
from lss_motion.playing.player.show_clock import ShowClock
from lss_motion.playing.run import perform
from lss_motion.playing.sound_choice import SoundChoice
from lss_motion.playing.sounds import SoundDesk
from lss_motion.show.model import Cue

ROBOT = Path(__file__).parents[3] / "sequences" / "robots" / "desk_arm.yaml"
SHOW = """\
sequence: s
robot: {robot}
sound: music.wav
on_fault: {{sound: {step}}}
keyframes:
  - {{at_s: 0.0, deg: {{elbow: 0}}}}
  - {{at_s: 0.3, deg: {{elbow: 1}}}}
"""


def silence(path):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(8000))


def nod(folder):
    """Return a short program and its robot, beside a file `music.wav`."""
    silence(folder / "music.wav")
    (folder / "s.yaml").write_text(SHOW.format(robot=ROBOT, step="warn"))
    robot = lss.load_robot(ROBOT)
    return lss.compile(lss.plan(lss.load_sequence(folder / "s.yaml"), robot), robot), robot


@pytest.fixture
def show(tmp_path, monkeypatch):
    """Return a function that plays a show and returns its code, and its report."""
    monkeypatch.setenv("PATH", str(tmp_path))  # no player of the system
    monkeypatch.setenv("JACK_DEFAULT_SERVER", "none")
    silence(tmp_path / "music.wav")

    def played(*options, step="warn"):
        (tmp_path / "s.yaml").write_text(SHOW.format(robot=ROBOT, step=step))
        report = tmp_path / "r.json"
        code = play([str(tmp_path / "s.yaml"), "--report", str(report), *options])
        return code, json.loads(report.read_text())

    return played


def test_without_the_extra_the_show_plays_and_says_once_what_to_install(show, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "soundfile", None)
    code, report = show()
    output = capsys.readouterr()
    assert (code, report["outcome"]) == (0, "finished")
    assert output.out.count("warning: no sounds: a library is missing") == 2, "and in the report"
    assert install_command("sound") in output.out
    assert "lss-play: not played: music.wav" in output.err
    assert report["sound"]["not_played"] == ["music.wav"]


def test_a_show_that_must_have_its_sound_moves_nothing_without_it(show, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "soundfile", None)
    code, report = show(step="hold")
    assert (code, report["outcome"], report["timing"]["commands"]) == (5, "fault", 0)
    assert "no sounds" in capsys.readouterr().err
    assert [fault["kind"] for fault in report["faults"]] == ["sound"]


@pytest.mark.slow
def test_a_file_that_is_no_sound_is_named_and_the_show_plays(show, tmp_path, capsys):
    pytest.importorskip("soundfile", exc_type=ImportError)
    (tmp_path / "music.wav").write_text("no sound at all")
    code, report = show("--sound-device", "a device that is not there")
    assert (code, report["outcome"]) == (0, "finished")
    assert "sound music.wav cannot be played: is not a sound that can be read" in " ".join(
        report["warnings"]
    )
    assert "lss-play: not played: music.wav" in capsys.readouterr().err


def test_a_show_without_sound_on_request_opens_nothing(show, capsys):
    code, report = show("--no-sound")
    assert (code, report["sound"], report["warnings"]) == (0, None, [])


def test_check_names_what_does_not_fit(show, tmp_path, capsys):
    pytest.importorskip("soundfile", exc_type=ImportError)
    from lss_motion.cli.main import main

    (tmp_path / "s.yaml").write_text(SHOW.format(robot=ROBOT, step="warn"))
    assert main(["check", str(tmp_path / "s.yaml")]) == 0
    assert "sound music.wav, with the show: 0.50 s, 8000 Hz" in capsys.readouterr().out


SCRIPTED = """\
import time
import msgspec
from lss_motion.system.sound_messages import *
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import serve

def main(pipe, device):
    typed = TypedPipe(pipe, SoundOrder)
    report = typed.send
    report(DeviceOpened("desk", "none", 0.02))
    received = open({received!r}, "wb")
    start_ns = 1 << 62
    def obey(order):
        nonlocal start_ns
        received.write(msgspec.json.encode(order) + b"\\n")
        received.flush()
        if isinstance(order, SetLeg):
            start_ns = order.leg.start_ns
        if isinstance(order, StillPlaying) and time.monotonic_ns() > start_ns + 50_000_000:
            {on_alive}
    serve(typed, obey)
"""


@pytest.fixture
def scripted(tmp_path, monkeypatch):
    """Return a function that replaces the process of the stream; it returns what that received."""
    pytest.importorskip("soundfile", exc_type=ImportError)

    def replace(on_alive="pass"):
        received = tmp_path / "received.txt"
        text = SCRIPTED.format(received=str(received), on_alive=on_alive)
        (tmp_path / "scripted_sounds.py").write_text(text)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.setattr("lss_motion.playing.sounds.PROCESS", "scripted_sounds")
        return received

    return replace


def orders(received, kind):
    """Return the orders of one kind that the process has received."""
    found = [json.loads(line) for line in received.read_text().splitlines()]
    return [order for order in found if order["type"] == kind]


LOST = "report(DeviceLost('sound device desk has stopped'))"


@pytest.mark.slow
@pytest.mark.parametrize(("step", "code"), [("warn", 0), ("hold", 5)])
def test_a_device_that_vanishes_is_named_and_the_show_goes_on_or_ends(
    show, scripted, capsys, step, code
):
    scripted(on_alive=LOST)
    found, report = show(step=step)
    assert (found, report["outcome"]) == (code, "fault" if code else "finished")
    told = [*report["warnings"], *(fault["cause"] for fault in report["faults"])]
    assert sum("desk has stopped: the show goes on without sound" in text for text in told) == 1


@pytest.mark.slow
def test_a_device_at_a_wrong_rate_is_named_once(show, scripted):
    scripted(on_alive="report(WrongRate(0.91))")
    _, report = show()
    assert sum("runs at 0.91 of its rate" in text for text in report["warnings"]) >= 1


def test_the_stream_is_told_show_clock_sounds_and_end(show, scripted):
    received = scripted()
    code, report = show()
    leg = orders(received, "SetLeg")[0]["leg"]
    [sound] = orders(received, "PlaySound")
    assert code == 0
    assert [*leg.values()][2:] == [1.0, 1.0, 0, 0.0]
    assert (Path(sound["path"]).name, sound["at_s"], sound["is_bed"]) == ("music.wav", 0.0, True)
    assert sound["until_s"] == pytest.approx(report["planned_s"])
    assert orders(received, "EndSounds")


def test_the_show_follows_what_is_heard_and_a_replay_of_its_log_sends_the_same(
    show, scripted, tmp_path, capsys
):
    lead = "report(Heard(time.monotonic_ns(), (time.monotonic_ns()-start_ns)*1.0002e-9, 1.0002))"
    scripted(on_alive=lead)
    log = tmp_path / "show.log"
    code, report = show("--log", str(log))
    assert (code, report["sound"]["leads"]) == (0, True)
    assert report["sound"]["device_ppm"] == pytest.approx(200.0, abs=0.1)
    assert '"name":"follow"' in log.read_text()
    capsys.readouterr()
    from lss_motion.cli.main import main

    assert main(["replay", str(log)]) == 0, capsys.readouterr()


@pytest.mark.slow
def test_a_leader_besides_the_device_is_named_and_each_sound_is_handed_over_once(
    tmp_path, scripted
):
    received = scripted()
    cues = tuple(
        Cue(at_s=0.1 * n, sound=str(tmp_path / "music.wav"), lead_s=0.05) for n in range(1, 5)
    )
    program, robot = nod(tmp_path)
    program = replace(program, cues=(*cues, Cue(at_s=0.2, say="hello")))
    result = perform(program, robot, sound=SoundChoice(leads=False))
    assert orders(received, "SetLeads") == [{"type": "SetLeads", "leads": False}]
    starts = [order["at_s"] for order in orders(received, "PlaySound")]
    assert starts == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert result.report.sound.not_played == []


@pytest.mark.slow
def test_an_offset_that_a_person_found_by_ear_is_kept_and_used_in_the_next_show(
    show, scripted, tmp_path, capsys, monkeypatch
):
    robot = tmp_path / "arm.yaml"
    robot.write_text(ROBOT.read_text())
    received = scripted()
    keys = iter([".", ".", ",", ".", "k"])
    monkeypatch.setattr(Inputs, "take", lambda self: (0, next(keys, "")))
    code, report = show("--robot", str(robot))
    assert (code, report["sound"]["offset_s"]) == (0, 0.02)
    assert orders(received, "SetOffset")[-1]["offset_s"] == 0.02
    assert "the sounds stay at 0.02 s: kept in arm.learnt.yaml" in capsys.readouterr().out
    assert "sound_offset_s: 0.02\n" in (tmp_path / "arm.learnt.yaml").read_text()
    _, report = show("--robot", str(robot))
    assert report["sound"]["offset_s"] == 0.02
    robot.write_text(f"sound_offset_s: -0.1\n{ROBOT.read_text()}")
    _, report = show("--robot", str(robot))
    assert report["sound"]["offset_s"] == -0.1, "the author's value stays his"


def test_a_show_that_is_sent_back_hands_its_sounds_over_again(tmp_path, scripted):
    received = scripted()
    program, _ = nod(tmp_path)
    desk = SoundDesk(program, SoundChoice(), offset_s=0.0, start_s=None)
    clock = ShowClock(0, 0.0, 1.0)
    show = SimpleNamespace(clock=clock, show_s=clock.show_s)
    player = SimpleNamespace(show=show, show_ended_ns=None, changes=0, is_leaving=False)
    for now_ns in (0, 100_000_000, 250_000_000):
        desk.turn(player, now_ns)
    show.clock = ShowClock(250_000_000, 0.0, 1.0)
    show.show_s = show.clock.show_s
    desk.turn(player, 260_000_000)
    desk.close()
    kinds = [json.loads(line)["type"] for line in received.read_text().splitlines()]
    kinds = [kind for kind in kinds if kind in ("PlaySound", "ClearSounds")]
    assert kinds == ["PlaySound", "ClearSounds", "PlaySound"]


def test_a_show_that_is_left_falls_silent_at_once_and_the_next_one_has_its_own_sounds(
    tmp_path, scripted
):
    received = scripted()
    program, _ = nod(tmp_path)
    desk = SoundDesk(program, SoundChoice(), offset_s=0.0, start_s=None)
    clock = ShowClock(0, 0.0, 1.0)
    show = SimpleNamespace(clock=clock, show_s=clock.show_s)
    player = SimpleNamespace(
        show=show, show_ended_ns=None, changes=0, is_leaving=False, program=program, start_s=None
    )
    desk.turn(player, 0)
    player.is_leaving = True  # It brakes.
    desk.turn(player, 100_000_000)
    desk.turn(player, 200_000_000)
    player.show, player.is_leaving, player.changes = None, False, 1
    desk.turn(player, 300_000_000)
    show.clock = ShowClock(900_000_000, 0.0, 1.0)
    show.show_s, player.show = show.clock.show_s, show
    desk.turn(player, 900_000_000)
    desk.close()
    lines = [json.loads(line) for line in received.read_text().splitlines()]
    kinds = [line["type"] for line in lines if line["type"] != "StillPlaying"]
    expected = ["SetLeg", "PlaySound", "ClearSounds", "SetLeg", "PlaySound"]
    assert kinds[kinds.index("SetLeg") :] == expected
    legs = orders(received, "SetLeg")
    assert [order["leg"]["start_ns"] for order in legs] == [0, 900_000_000]
