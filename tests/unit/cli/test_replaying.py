from __future__ import annotations

import json

import pytest

from lss_motion.cli import play
from lss_motion.cli.main import main
from lss_motion.cli.replay import event_lines
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_NOT_FOLLOWED
from lss_motion.player.events import (
    CueReached,
    Faulted,
    MarkPassed,
    Phase,
    PhaseEntered,
    Waited,
    Warned,
)
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.sequence.model import Cue

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {base: {id: 1}, elbow: {id: 2}, wrist: {id: 3}}
"""
SHOW = """\
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, deg: {base: 0, elbow: 0, wrist: 0}}
  - {at_s: 0.6, deg: {base: 30, elbow: -20}}
  - {at_s: 1.2, deg: {base: 0, elbow: 0, wrist: 10}}
"""


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """The log and report of a short show with lost answers, on a host that wakes late at times."""
    folder = tmp_path_factory.mktemp("played")
    faults = folder / "faults.yaml"
    (folder / "robot.yaml").write_text(ROBOT)
    (folder / "show.yaml").write_text(SHOW)
    faults.write_text(
        "faults:\n  - {kind: lost_reply, ratio: 0.02, at_s: 0.5}\n"
        "  - {kind: oversleep, ratio: 0.05, late_s: 0.004}\n"
    )
    words = [str(folder / "show.yaml"), "--virtual", "--quiet", "--faults", str(faults)]
    words += ["--log", str(folder / "a.log"), "--report", str(folder / "a.json")]
    assert play.main(words) == EXIT_FINISHED
    return folder


def test_the_player_decides_the_same_when_it_lives_through_its_log_again(played, capsys):
    assert main(["replay", "--again", str(played / "a.log")]) == EXIT_FINISHED
    out = capsys.readouterr().out
    assert "outputs compared, 0 differ" in out
    assert int(out.split(" outputs compared")[0].split()[-1]) > 1000


@pytest.mark.parametrize(
    ("old", "new"), [("*2QD", "*3QD"), ("> #1D", "> #2D")], ids=["an answer", "a command"]
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
        ("Strange(x=1)", ["Strange(x=1)"]),
        ("__import__('os').getcwd()", ["__import__('os').getcwd()"]),
    ],
)
def test_an_event_of_a_log_has_the_words_that_it_had_on_the_screen(event, lines):
    written = event if isinstance(event, str) else repr(event)
    assert event_lines(written.encode("unicode_escape").decode("ascii")) == lines


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hello\n", "a.log:1: not a log"),
        ("# lss_motion log 2\nnonsense\n", "a.log:2: 'nonsense' is no line"),
        ("# lss_motion log 2\n# played: {\n", "a.log:2: `# played:` holds no JSON"),
        ("# lss_motion log 2\n", "does not name the file that was played"),
        ("\xff", "not ASCII"),
    ],
)
def test_what_is_no_log_is_refused_with_its_line(tmp_path, capsys, text, words):
    path = tmp_path / "a.log"
    path.write_bytes(text.encode("latin-1"))
    assert main(["replay", "--again", str(path)]) == EXIT_INPUT
    assert words in capsys.readouterr().err


def test_a_report_is_printed_and_two_are_compared(played, tmp_path, capsys):
    report = json.loads((played / "a.json").read_text())
    other = tmp_path / "b.json"
    report["joints"]["elbow"]["readings"] *= 2
    other.write_text(json.dumps(report))
    assert main(["report", str(played / "a.json"), str(other)]) == EXIT_FINISHED
    out = capsys.readouterr().out
    assert out.count("nod: finished") == 2
    [line] = [line for line in out.splitlines() if line.startswith("joints elbow readings")]
    assert line.endswith("2.00 x")
    assert main(["report", str(other), str(other)]) == EXIT_FINISHED
    assert "the numbers are the same" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[]", "not a report"),
        ("{", "not a report"),
        ('{"schema": 1}', "'timing' is missing"),
        ('{"schema": 1, "timing": 5, "planned_s": []}', "wrong type"),
        ('{"schema": 2}', "not a report"),
    ],
)
def test_what_is_no_report_is_refused(played, tmp_path, capsys, text, why):
    path = tmp_path / "b.json"
    path.write_text(text)
    assert main(["report", str(played / "a.json"), str(path)]) == EXIT_INPUT
    said = capsys.readouterr().err
    assert said.startswith(f"{path}: ")
    assert why in said
    assert "Error" not in said


def test_faults_and_warnings_are_printed_and_that_of_a_port_names_no_joint(
    played, tmp_path, capsys
):
    report = json.loads((played / "a.json").read_text())
    report["faults"] = [
        {"joint": joint, "cause": "is gone", "kind": "silent", "step": "hold"}
        for joint in ("", "base")
    ]
    report["warnings"] = ["it was late"]
    (tmp_path / "faulty.json").write_text(json.dumps(report))
    assert main(["report", str(tmp_path / "faulty.json")]) == EXIT_FINISHED
    said = capsys.readouterr().out.splitlines()
    assert said[-3:] == [
        "fault: is gone (hold)",
        "fault: joint 'base' is gone (hold)",
        "warning: it was late",
    ]


def test_what_nobody_has_measured_is_shown_as_no_zero(played, tmp_path, capsys):
    report = json.loads((played / "a.json").read_text())
    report["joints"]["base"] |= {"readings": 0, "error_rms_deg": 0.0, "error_max_deg": 0.0}
    (tmp_path / "open.json").write_text(json.dumps(report))
    assert main(["report", str(tmp_path / "open.json")]) == EXIT_FINISHED
    rows = {line.split()[0]: line.split()[1:4] for line in capsys.readouterr().out.splitlines()}
    assert rows["base"] == ["0", "-", "-"]
    assert float(rows["elbow"][1]) > 0.0


def test_a_report_is_drawn_with_what_was_read_of_every_joint(played, tmp_path, capsys, monkeypatch):
    import matplotlib as mpl

    monkeypatch.setitem(mpl.rcParams, "svg.fonttype", "none")
    report, picture = json.loads((played / "a.json").read_text()), tmp_path / "a.svg"
    assert main(["report", str(played / "a.json"), "--plot", str(picture)]) == EXIT_FINISHED
    drawn = picture.read_text()
    for word in (*report["joints"], "lateness", "line in use", "timeouts"):
        assert word in drawn
    # With a lost answer the rest of its row is not believed, so one joint may miss the end.
    ends_s = [joint["trace"]["at_s"][-1] for joint in report["joints"].values()]
    assert max(ends_s) > report["played_s"] - 0.1
    for joint in report["joints"].values():
        trace = joint["trace"]
        at_s = trace["at_s"]
        assert len(at_s) == len(trace["planned_deg"]) == len(trace["measured_deg"]) > 100
        assert at_s == sorted(at_s)
        off_deg = [a - b for a, b in zip(trace["planned_deg"], trace["measured_deg"], strict=True)]
        rms_deg = (sum(x * x for x in off_deg) / len(off_deg)) ** 0.5
        assert rms_deg == pytest.approx(joint["error_rms_deg"], rel=0.1, abs=0.02)
    counts = [count for _, count in report["timing"]["late_histogram_us"]]
    assert sum(counts) == report["timing"]["commands"]
    capsys.readouterr()


def test_what_cannot_be_drawn_is_refused_and_nothing_is_written(played, tmp_path, capsys):
    one, picture = str(played / "a.json"), tmp_path / "a.svg"
    report = json.loads((played / "a.json").read_text())
    for joint in report["joints"].values():
        joint["trace"] = {"at_s": [], "planned_deg": [], "measured_deg": []}
    (tmp_path / "unread.json").write_text(json.dumps(report))
    for arguments, words in (
        ([one, one, "--plot", str(picture)], "lss-motion: --plot draws one report"),
        ([one, "--plot", str(tmp_path / "a.txt")], f"{tmp_path}/a.txt: cannot draw .txt"),
        ([one, "--plot", f"{tmp_path}/no/a.svg"], f"{tmp_path}/no/a.svg: cannot be written"),
        ([f"{tmp_path}/unread.json", "--plot", str(picture)], "lss-motion: no joint was read"),
    ):
        assert main(["report", *arguments]) == EXIT_INPUT
        assert capsys.readouterr().err.startswith(words)
    assert not picture.exists()
