"""`lss-motion report`: a report as text and picture, and two compared."""

from __future__ import annotations

import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from lss_motion.cli.main import main
from lss_motion.cli.report import draw_buses, draw_lateness, plot_report, report_lines
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT


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


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({"error_max_deg": 0.01}, "played well: no joint more than 1° off"),
        ({"error_max_deg": 1.01}, "played well: no joint more than 2° off"),
        ({"error_max_deg": 7.26}, "played, but joint 'base' was up to 7.3° off"),
        ({"readings": 0}, "played well: no joint more than 1° off; 1 joint was not read"),
    ],
)
def test_the_end_of_a_show_says_how_well_it_was_played(played, changes, verdict):
    report = json.loads((played / "a.json").read_text())
    report["timing"]["missed"] = 0
    for joint in report["joints"].values():
        joint |= {"error_max_deg": 0.5}
        del joint["horn_error_rms_deg"], joint["horn_error_max_deg"]
    report["joints"]["base"] |= changes
    assert report_lines(report)[1] == verdict
    for joint in report["joints"].values():
        joint["readings"] = 0
    assert report_lines(report)[1].startswith("played; no joint was read")
    report["timing"]["missed"] = 3
    assert report_lines(report)[1].startswith("played, but 3 of ")
    report["outcome"] = "stopped"
    assert not any(line.startswith("played") for line in report_lines(report))


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
        assert len(at_s) == len(trace["planned_deg"]) == len(trace["measured_deg"]) > 12
        assert at_s == sorted(at_s)
        off_deg = [a - b for a, b in zip(trace["planned_deg"], trace["measured_deg"], strict=True)]
        rms_deg = (sum(x * x for x in off_deg) / len(off_deg)) ** 0.5
        assert rms_deg == pytest.approx(joint["error_rms_deg"], rel=0.1, abs=0.02)
    counts = [count for _, count in report["timing"]["late_histogram_us"]]
    assert sum(counts) == report["timing"]["commands"]
    capsys.readouterr()


def test_a_joint_that_reports_nothing_is_drawn_with_its_plan(played, tmp_path, monkeypatch):
    """An RC servo: it was left out of the picture."""
    import matplotlib as mpl

    monkeypatch.setitem(mpl.rcParams, "svg.fonttype", "none")
    report = json.loads((played / "a.json").read_text())
    for name in ("base", "wrist"):
        report["joints"][name] |= {"readings": 0}
        report["joints"][name]["trace"] = {"at_s": [], "planned_deg": [], "measured_deg": []}
    plot_report(report, tmp_path / "a.svg")
    drawn = (tmp_path / "a.svg").read_text()
    assert all(f">{name}<" in drawn for name in report["joints"])
    assert drawn.count("not read") == 2


def test_one_bar_of_a_picture_does_not_fill_it(played, tmp_path):
    report = json.loads((played / "a.json").read_text())
    report["timing"]["late_histogram_us"] = [[8, 100]]
    figure = Figure()
    late, lines = figure.subplots(1, 2)
    draw_lateness(late, report["timing"])
    draw_buses(lines, report["buses"])
    assert len(late.patches) >= 8
    assert all(bar.get_width() < 0.2 * np.ptp(late.get_xlim()) for bar in late.patches)
    assert all(bar.get_height() < 0.2 * np.ptp(lines.get_ylim()) for bar in lines.patches)


def test_what_cannot_be_drawn_is_refused_and_nothing_is_written(played, tmp_path, capsys):
    one, picture = str(played / "a.json"), tmp_path / "a.svg"
    report = json.loads((played / "a.json").read_text())
    for joint in report["joints"].values():
        joint["trace"] = {"at_s": [], "planned_deg": [], "measured_deg": []}
        joint["plan"] = {"at_s": [], "deg": []}
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
