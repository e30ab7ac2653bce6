"""`lss-play` from the outside: what it prints, writes and returns, on the simulated bus."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lss_motion.cli.play import main
from lss_motion.playing.log import SentLine, read_log
from tests.pair import NOD, ROBOT

ROOT = Path(__file__).resolve().parents[3]
SEQUENCES = ROOT / "sequences"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "nod.yaml").write_text(NOD)
    return tmp_path


def show(folder, text):
    path = folder / "show.yaml"
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)
    return str(path)


def test_a_virtual_show_ends_with_a_report_a_truth_and_a_log(folder, capsys):
    report, truth, log = folder / "r.json", folder / "t.csv", folder / "l.txt"
    code = main([str(folder / "nod.yaml"), "--virtual", "--report", str(report), "--truth",
                 str(truth), "--log", str(log)])  # fmt: skip
    assert code == 0
    said = json.loads(report.read_text())
    assert said["schema"] == 1
    assert said["outcome"] == "finished"
    assert said["simulated"] is True
    assert said["planned_s"] == said["played_s"] == 2.0
    assert said["timing"]["commands"] > 4
    assert said["timing"]["missed"] == 0
    assert said["faults"] == said["warnings"] == said["stretched"] == []
    assert said["buses"]["main"]["replies"] > 150
    assert set(said["joints"]) == {"pan", "tilt"}
    assert all(joint["horn_error_rms_deg"] < 0.3 for joint in said["joints"].values())

    header, *rows = truth.read_text().splitlines()
    assert header == "t_s,pan,tilt"
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.01, atol=1e-9)
    assert table[-1, 0] == 2.0
    assert abs(table[100, 1] - 40.0) < 0.5

    sent = [line for line in read_log(log).lines if isinstance(line, SentLine)]
    assert sent[-1].data.endswith(b"#254H\r")
    printed = capsys.readouterr().out
    assert "simulated" in printed
    assert "played well: no joint more than 1° off" in printed
    assert "p99" not in printed


def test_numbers_about_the_bus_come_with_verbose(folder, capsys):
    assert main([str(folder / "nod.yaml"), "--virtual", "--verbose"]) == 0
    printed = capsys.readouterr().out
    assert printed.index("played well") < printed.index("p99") < printed.index("replies (")
    assert "missed 0" in printed


@pytest.mark.parametrize("option", ["--speed", "--freewheel"])
def test_an_option_with_a_decimal_comma_names_it(folder, capsys, option):
    with pytest.raises(SystemExit):
        main([str(folder / "nod.yaml"), option, "0,5"])
    assert "a decimal comma is written as a point: 0.5" in capsys.readouterr().err


def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_ones(folder):
    logs = []
    for seed in ("7", "7", "8"):
        path = folder / "l.txt"
        assert main([str(folder / "nod.yaml"), "--virtual", "--seed", seed, "--log", str(path),
                     "--quiet"]) == 0  # fmt: skip
        logs.append(path.read_bytes())
    assert logs[0] == logs[1]
    assert logs[0] != logs[2]


def test_a_dry_run_explains_and_moves_nothing(folder, capsys):
    log = folder / "l.txt"
    assert main([str(folder / "nod.yaml"), "--dry-run", "--log", str(log)]) == 0
    assert "2.000 s" in capsys.readouterr().out
    assert not log.exists()


def test_half_speed_takes_twice_as_long(folder):
    report = folder / "r.json"
    main([str(folder / "nod.yaml"), "--virtual", "--quiet", "--speed", "0.5", "--report",
          str(report)])  # fmt: skip
    assert json.loads(report.read_text())["planned_s"] == pytest.approx(4.0, abs=0.001)


def test_looping_three_times_takes_three_times_as_long(folder):
    report = folder / "r.json"
    main([str(folder / "nod.yaml"), "--virtual", "--quiet", "--loop", "3", "--report", str(report)])
    assert json.loads(report.read_text())["played_s"] == pytest.approx(6.0, abs=0.001)


def test_a_show_started_in_its_middle_plays_only_the_rest(folder):
    truth = folder / "t.csv"
    assert main([str(folder / "nod.yaml"), "--virtual", "--quiet", "--from", "1.0", "--truth",
                 str(truth)]) == 0  # fmt: skip
    rows = [[float(cell) for cell in row.split(",")] for row in truth.read_text().splitlines()[1:]]
    assert rows[0][1] == pytest.approx(40.0, abs=0.5)
    assert rows[-1][1] == pytest.approx(0.0, abs=0.5)


def test_a_compiled_program_plays_like_its_sequence(folder):
    from lss_motion.cli.main import main as lss_motion

    compiled, report = folder / "nod.lss", folder / "r.json"
    assert lss_motion(["compile", str(folder / "nod.yaml"), "-o", str(compiled)]) == 0
    logs = []
    for file in ("nod.yaml", "nod.lss"):
        log = folder / f"{file}.txt"
        code = main([str(folder / file), "--virtual", "--quiet", "--log", str(log), "--report",
                     str(report)])  # fmt: skip
        assert code == 0
        head, rest = log.read_bytes().split(b"\n", 1)
        assert json.loads(head)["played"]["file"].endswith(file)
        logs.append(rest)
    assert logs[0] == logs[1]
    assert json.loads(report.read_text())["outcome"] == "finished"


WRONG = {
    "unknown joint": (NOD.replace("tilt: 30", "tlit: 30"), ":6:", "did you mean 'tilt'"),
    "unknown key": (NOD.replace("at_s: 1,", "at_z: 1,"), ":6:", "at_s"),
    "unknown pose": (NOD.replace("pose: home}\n  - {at_s: 1", "pose: hom}\n  - {at_s: 1"), ":5:",
                     "home"),
    "out of range": (NOD.replace("pan: 40", "pan: 140"), ":6:", "-90"),
    "times going back": (NOD.replace("at_s: 2", "at_s: 0.5"), ":7:", "0.5"),
    "no keyframes": ("sequence: nod\nrobot: robot.yaml\nkeyframes: []\n", ":3:", "keyframe"),
    "keyframes missing": ("sequence: nod\nrobot: robot.yaml\n", ":", "keyframes"),
    "YAML syntax": (NOD.replace("{at_s: 1,", "{at_s: 1"), ":6:", ""),
    "NaN": (NOD.replace("tilt: 30", "tilt: .nan"), ":6:", "number"),
    "empty file": ("", ":", "empty"),
    "binary file": (bytes(range(256)) * 4, "", ""),
    "missing robot": (NOD.replace("robot.yaml", "robbot.yaml"), ":3:", "robbot.yaml"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_explained_and_moves_nothing(name, folder, capsys):
    text, place, hint = WRONG[name]
    log = folder / "l.txt"
    assert main([show(folder, text), "--virtual", "--log", str(log)]) == 2
    message = capsys.readouterr().err
    assert "show.yaml" in message or "robbot.yaml" in message
    assert place in message
    assert hint in message
    assert "Traceback" not in message
    assert not log.exists()


def test_two_joints_with_one_id_are_refused(folder, capsys):
    (folder / "robot.yaml").write_text(ROBOT.replace("id: 2", "id: 1"))
    assert main([str(folder / "nod.yaml"), "--virtual"]) == 2
    message = capsys.readouterr().err
    assert "robot.yaml:" in message
    assert "pan" in message
    assert "tilt" in message


FAST = """
sequence: fast
robot: robot.yaml
keyframes:
  - {at_s: 0, pose: home}
  - {at_s: 1, deg: {tilt: 20}}
  - {at_s: 1.08, deg: {pan: 80}%s}
  - {at_s: 3, pose: home}
"""


def test_what_is_too_fast_is_slowed_there_and_said(folder, capsys):
    path = show(folder, FAST.replace("{tilt: 20}", "{tilt: 20, pan: 0}") % "")
    report = folder / "r.json"
    assert main([path, "--virtual", "--report", str(report), "--quiet"]) == 0
    stretched = json.loads(report.read_text())["stretched"]
    assert [span["joint"] for span in stretched] == ["pan"]
    assert 0.9 < stretched[0]["from_s"] < 1.1
    assert stretched[0]["by_s"] > 0.3


def test_an_anchor_that_cannot_be_met_ends_with_exit_code_3(folder, capsys):
    path = show(folder, FAST.replace("{tilt: 20}", "{tilt: 20, pan: 0}") % ", anchor: true")
    assert main([path, "--virtual"]) == 3
    message = capsys.readouterr().err
    assert "pan" in message
    assert " s" in message


def test_options_that_cannot_be_are_refused_before_anything_moves(folder, capsys):
    nod = str(folder / "nod.yaml")
    assert main([nod, "--virtual", "--from", "5"]) == 2
    assert main([nod, "--virtual", "--from", "nowhere"]) == 2
    assert main([nod, "--virtual", "--loop", "forever"]) == 2
    assert main([nod, "--port", "/dev/null/x", "--virtual"]) == 2
    assert main([nod, "--port", "/dev/null/x", "--truth", "t.csv"]) == 2
    assert main([nod, "--virtual", "--report", str(folder / "no" / "r.json")]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_port_that_is_not_there_ends_with_exit_code_4(folder, capsys):
    assert main([str(folder / "nod.yaml"), "--port", str(folder / "nothing"), "--yes"]) == 4
    assert "nothing" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["wave", "show", "fastest"])
def test_every_example_plays_with_the_horn_within_a_degree(name, tmp_path):
    copy = shutil.copytree(SEQUENCES, tmp_path / "sequences")
    report = tmp_path / "r.json"
    assert main([str(copy / f"{name}.yaml"), "--virtual", "--quiet", "--report", str(report)]) == 0
    said = json.loads(report.read_text())
    assert said["timing"]["missed"] == 0
    assert all(joint["horn_error_rms_deg"] < 1.0 for joint in said["joints"].values())


def test_an_interrupt_after_the_show_loses_no_report(folder, monkeypatch):
    from lss_motion.playing import report as reports

    write_report, path = reports.write_report, folder / "r.json"

    def interrupted(report, path):
        signal.raise_signal(signal.SIGINT)
        write_report(report, path)

    monkeypatch.setattr(reports, "write_report", interrupted)
    assert main([str(folder / "nod.yaml"), "--virtual", "--quiet", "--report", str(path)]) == 0
    assert json.loads(path.read_text())["outcome"] == "finished"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
def test_a_full_disk_under_standard_output_ends_no_show(folder):
    report = folder / "r.json"
    command = [sys.executable, "-m", "lss_motion.cli.play", str(folder / "nod.yaml"), "--virtual"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*command, "--report", str(report)], stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert done.returncode == 0
    [line] = done.stderr.decode().splitlines()
    assert "standard output cannot be written (No space left on device)" in line
    assert json.loads(report.read_text())["played_s"] == 2.0


def test_the_closing_lines_name_what_went_wrong(folder, capsys):
    (folder / "faults.yaml").write_text("faults:\n  - {kind: stuck, servo: 1, at_s: 1.2}\n")
    main([str(folder / "nod.yaml"), "--virtual", "--loop", "3", "--faults",
          str(folder / "faults.yaml")])  # fmt: skip
    said = capsys.readouterr().out
    ending = said[said.index("nod: fault after") :].splitlines()
    lines = [line for line in ending if line.startswith("fault: joint 'pan'")]
    assert lines
    assert lines[-1].endswith(" (hold)")
