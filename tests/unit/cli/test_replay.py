"""`lss-motion replay`: the content of a log, and the player run again from it."""

from __future__ import annotations

import json

import msgspec
import pytest

from lss_motion.cli import play
from lss_motion.cli.main import main
from lss_motion.cli.report import event_lines
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_NOT_FOLLOWED
from lss_motion.playing.log import HappenedLine, LogLine, encode_line
from lss_motion.playing.player.events import (
    CueReached,
    Faulted,
    MarkPassed,
    Phase,
    PhaseEntered,
    ShowBegan,
    Waited,
    Warned,
)
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.show.model import Cue

HEAD = '{"format":"lss_motion log","version":3}'


def test_the_player_decides_the_same_when_it_lives_through_its_log_again(played, capsys):
    assert main(["replay", "--again", str(played / "a.log")]) == EXIT_FINISHED
    out = capsys.readouterr().out
    assert "outputs compared, 0 differ" in out
    assert int(out.split(" outputs compared")[0].split()[-1]) > 300


@pytest.mark.slow
@pytest.mark.parametrize("resume_s", [10, 0.2])
def test_an_unplugged_port_is_replayed(played, tmp_path, capsys, resume_s):
    """`resume_s` 0.2: the port does not come back in time, and the show ends without it."""
    (tmp_path / "robot.yaml").write_text(
        (played / "robot.yaml").read_text() + f"resume_s: {resume_s}\n"
    )
    (tmp_path / "show.yaml").write_text((played / "show.yaml").read_text())
    (tmp_path / "faults.yaml").write_text("faults: [{kind: unplugged, at_s: 1, until_s: 1.6}]\n")
    words = [str(tmp_path / "show.yaml"), "--virtual", "--quiet"]
    play.main([*words, "--faults", str(tmp_path / "faults.yaml"), "--log", str(tmp_path / "a.log")])
    assert main(["replay", "--again", str(tmp_path / "a.log")]) == EXIT_FINISHED
    assert "outputs compared, 0 differ" in capsys.readouterr().out
    assert main(["replay", str(tmp_path / "a.log")]) == EXIT_FINISHED
    assert "port main: lost" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("steps", ["hold", "[resume, hold]"])
def test_a_stall_is_replayed(played, tmp_path, capsys, steps):
    (tmp_path / "robot.yaml").write_text(
        (played / "robot.yaml").read_text() + f"on_fault: {{stalled: {steps}, lost_port: hold}}\n"
    )
    (tmp_path / "show.yaml").write_text((played / "show.yaml").read_text())
    rows = "{kind: oversleep, at_s: 1, until_s: 1.1, late_s: 2}, {kind: unplugged, at_s: 4}"
    (tmp_path / "faults.yaml").write_text(f"faults: [{rows}]\n")
    words = [str(tmp_path / "show.yaml"), "--virtual", "--quiet"]
    play.main([*words, "--faults", str(tmp_path / "faults.yaml"), "--log", str(tmp_path / "a.log")])
    assert main(["replay", "--again", str(tmp_path / "a.log")]) == EXIT_FINISHED
    assert "outputs compared, 0 differ" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new"),
    [("*2QD", "*3QD"), ('"main","#1D', '"main","#2D')],
    ids=["an answer", "a command"],
)
def test_another_log_is_not_taken_for_the_same(played, tmp_path, capsys, old, new):
    text = (played / "a.log").read_text()
    half = len(text) // 2
    path = tmp_path / "b.log"
    path.write_text(text[:half] + text[half:].replace(old, new, 3))
    assert main(["replay", "--again", str(path)]) == EXIT_NOT_FOLLOWED
    assert " differ\n" in capsys.readouterr().out


def test_a_log_says_what_each_servo_heard_and_what_happened(played, capsys):
    assert main(["replay", str(played / "a.log")]) == EXIT_FINISHED
    out = capsys.readouterr().out
    commands = json.loads((played / "a.json").read_text())["timing"]["commands"]
    moves = [int(line.split(" D ")[1].split(",")[0]) for line in out.splitlines() if " D " in line]
    assert sum(moves) >= commands
    happened = [line.split(maxsplit=1)[-1] for line in out.splitlines()]
    assert {"playing", f"checked {len(moves)} servos", "done"} <= set(happened)
    assert main(["replay", str(played / "a.log"), "--servo", "2"]) == EXIT_FINISHED
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if "#2D" in line]) == moves[1]
    assert lines[-1].endswith("#254H")
    assert not any("#3" in line for line in lines)
    assert main(["replay", str(played / "a.log"), "--servo", "77"]) == EXIT_INPUT
    assert (
        "no line of this log is for servo 77; it has lines for: 1, 2, 3" in capsys.readouterr().err
    )


@pytest.mark.parametrize("is_cut", [True, False])
def test_a_log_that_was_cut_is_read_and_named(played, tmp_path, capsys, is_cut):
    lines = (played / "a.log").read_text().splitlines(keepends=True)
    path = tmp_path / "cut.log"
    path.write_text("".join(lines[: len(lines) // 2] if is_cut else lines))
    for option in ([], ["--again"], ["--servo", "1"]):
        assert main(["replay", str(path), *option]) == EXIT_FINISHED
        assert (f"warning: {path} has no end" in capsys.readouterr().err) is is_cut


@pytest.mark.parametrize(
    ("event", "lines"),
    [
        (PhaseEntered(Phase.SHOW), ["playing"]),
        (MarkPassed("wave \u00fc", 2.0), ["2.00 s wave \u00fc"]),
        (MarkPassed("", 1.6), ["1.60 s a keyframe"]),
        (Warned("it's late"), ["warning: it's late"]),
        (
            Faulted("elbow", "is stuck", Cause.STUCK, FaultStep.SLOW),
            ["fault: joint 'elbow' is stuck (slow)"],
        ),
        (CueReached(Cue(at_s=1.0, led=(("base", 1),)), 1.0), ["1.00 s led base red"]),
        (Waited("a visitor", "met"), ["a visitor: going on"]),
        (ShowBegan("wave", 1.5), ["show wave from 1.50 s"]),
    ],
)
def test_an_event_of_a_log_has_the_words_that_it_had_on_the_screen(event, lines):
    line = HappenedLine(0, event)
    assert msgspec.json.decode(encode_line(line), type=LogLine) == line
    assert event_lines(event) == lines


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hello\n", "a.log:1: not a log"),
        ("# lss_motion log 2\n0.5 - #\n", "a.log:1: a log of version 2; this lss-motion reads"),
        (HEAD.replace("3", "4") + "\n", "a.log:1: a log of version 4; this lss-motion reads"),
        (HEAD + "\nnonsense\n", "a.log:2: 'nonsense' is no line of a log: JSON is malformed"),
        (HEAD + '\n["sent",1,"main"]\n', "at least length 4, got 3"),
        (HEAD[:-1] + ',"played":{"file":1}}\n', "a.log:1: not a log: the first line must be"),
        (HEAD + "\n", "does not name the file that was played"),
        ("\xff", "byte 0xff is not UTF-8"),
    ],
)
def test_what_is_no_log_is_refused_with_its_line(tmp_path, capsys, text, words):
    path = tmp_path / "a.log"
    path.write_bytes(text.encode("latin-1"))
    assert main(["replay", "--again", str(path)]) == EXIT_INPUT
    assert words in capsys.readouterr().err
