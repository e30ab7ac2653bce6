"""What all commands have in common: usage, JSON, completion, and files that are there already."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lss_motion.cli.main import main, make_parser
from lss_motion.cli.play import main as play
from lss_motion.errors import install_command
from lss_motion.playing.log import read_log

SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"
ROBOT = str(SEQUENCES / "robots" / "desk_arm.yaml")
WAVE = str(SEQUENCES / "wave.yaml")


@pytest.mark.parametrize("command", ["check", "scan", "sim", "report"])
def test_a_wrong_option_shows_the_usage_of_that_command(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, WAVE, "--bogus"])
    assert ended.value.code == 2
    errors = capsys.readouterr().err
    assert errors.startswith(f"usage: lss-motion {command} ")
    assert "--bogus" in errors


def shown(capsys, *words, code=0):
    assert main(list(words)) == code
    return json.loads(capsys.readouterr().out)


def test_check_as_json_has_limits_and_lines(capsys):
    found = shown(capsys, "check", WAVE, "--json")
    assert (found["name"], found["duration_s"]) == ("wave", pytest.approx(19.5))
    for joint in found["joints"].values():
        assert 0.0 < joint["speed_deg_s"] <= joint["speed_max_deg_s"]
        assert joint["error_max_deg"] <= found["tolerance_deg"]
    assert found["buses"]["main"]["commands"] > 100


def test_check_lists_all_slow_spans_and_late_keyframes_where_asked(capsys, tmp_path):
    rows = ["- {at_s: 0, deg: {base: 0}}"]
    for index in range(24):
        rows.append(f"- {{at_s: {index + 0.15}, deg: {{base: {30 + index}}}}}")
        rows.append(f"- {{at_s: {index + 1}, deg: {{base: 0}}}}")
    path = tmp_path / "talk.yaml"
    head = f"sequence: talk\nrobot: {Path(ROBOT).absolute()}\nkeyframes:\n"
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    found = shown(capsys, "check", str(path), "--json")
    assert len(found["stretched"]) > 20
    lates_s = [mark["late_s"] for mark in found["late_keyframes"]]
    assert len(lates_s) > 20
    assert lates_s == sorted(lates_s, reverse=True)
    for command, words, counts in (
        ("check", [], (10, 10)),
        ("check", ["--all"], (len(found["stretched"]), len(lates_s))),
        ("plan", ["--all"], (len(found["stretched"]), len(lates_s))),
        ("compile", ["-o", str(tmp_path / "talk.lss")], (10, 10)),
        (
            "compile",
            ["-o", str(tmp_path / "talk.lss"), "--all"],
            (len(found["stretched"]), len(lates_s)),
        ),
        ("play", ["--dry-run"], (10, 10)),
        ("play", ["--dry-run", "--all"], (len(found["stretched"]), len(lates_s))),
    ):
        assert main([command, str(path), *words]) == 0
        lines = capsys.readouterr().out.splitlines()
        starts = [line.split(":")[0] for line in lines]
        assert (starts.count("slower"), starts.count("late")) == counts
    assert main(["play", str(path), "--all", "--virtual"]) == 2
    assert "--all lists what --dry-run prints" in capsys.readouterr().err


def test_check_says_where_spline_costs_time_and_following_that_gains_it(capsys, tmp_path):
    keys = ((0.3, 15), (0.5, 25), (0.6, 48), (0.7, 31), (1.2, 13), (1.5, 11), (3.0, 11))
    path = tmp_path / "fast.yaml"

    def write(smooth):
        rows = ["- {at_s: 0, deg: {base: 0}}"]
        for at_s, angle in keys:
            ease = ", ease: smooth" if at_s in smooth else ""
            rows.append(f"- {{at_s: {at_s}, deg: {{base: {angle}}}{ease}}}")
        head = f"sequence: fast\nrobot: {Path(ROBOT).absolute()}\ninterpolation: spline\n"
        path.write_text(head + "keyframes:\n" + "\n".join(rows) + "\n", encoding="utf-8")

    write(())
    (advice,) = shown(capsys, "check", str(path), "--json")["ease_advice"]
    assert advice["would_be_s"] < 0.6 * advice["late_s"]
    assert main(["check", str(path)]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith(f"spline costs time in 'fast': its keyframes are {advice['late_s']:.3f}")
    assert f"(at {advice['at_s'][0]:g} s, " in line
    assert advice["ease"] == "smooth"
    write(advice["at_s"])
    found = shown(capsys, "check", str(path), "--json")
    late_s = sum(mark["late_s"] for mark in found["late_keyframes"])
    assert late_s == pytest.approx(advice["would_be_s"], abs=0.005)
    assert found["ease_advice"] == []


def test_check_says_where_smooth_costs_time_and_following_that_gains_it(capsys, tmp_path):
    path = tmp_path / "fast.yaml"

    def write(interpolation):
        head = f"sequence: fast\nrobot: {Path(ROBOT).absolute()}\ninterpolation: {interpolation}\n"
        rows = (
            f"- {{at_s: {0.05 * n:.2f}, deg: {{base: {40 * math.sin(0.4 * n):.2f}, "
            f"wrist: {40 * math.sin(0.54 * n):.2f}}}}}\n"
            for n in range(32)
        )
        path.write_text(f"{head}keyframes:\n{''.join(rows)}", encoding="utf-8")

    write("smooth")
    (advice,) = shown(capsys, "check", str(path), "--json")["ease_advice"]
    assert (advice["ease"], len(advice["at_s"])) == ("spline", 31)
    assert advice["would_be_s"] < 0.85 * advice["late_s"]
    assert main(["check", str(path)]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith(f"smooth costs time in 'fast': its keyframes are {advice['late_s']:.3f}")
    assert "with ease: spline at every keyframe it would be" in line
    write("spline")
    found = shown(capsys, "check", str(path), "--json")
    late_s = [mark["late_s"] for mark in found["late_keyframes"]]
    assert sum(late_s) == pytest.approx(advice["would_be_s"], abs=0.005)
    assert line.endswith(f"at most {max(late_s):.3f} s")
    assert found["ease_advice"] == []


def test_a_robot_file_is_checked_alone(capsys, tmp_path):
    assert main(["check", ROBOT]) == 0
    assert "desk_arm: 5 joints" in capsys.readouterr().out
    found = shown(capsys, "check", ROBOT, "--json")
    assert found["joints"]["shoulder"]["range_deg"] == [-90, 90]
    wrong = tmp_path / "arm.yaml"
    text = Path(ROBOT).read_text(encoding="utf-8").replace("[-90, 90]", "[90, -90]")
    wrong.write_text(text, encoding="utf-8")
    assert main(["check", str(wrong)]) == 2
    assert str(wrong) in capsys.readouterr().err


@pytest.mark.parametrize("fields", ["range_deg: [-90, 400]", "range_deg: [-60, 90], zero_deg: 150"])
def test_check_refuses_a_joint_whose_turn_is_unknown_and_names_what_to_do(tmp_path, capsys, fields):
    path = tmp_path / "robot.yaml"
    text = (
        "robot: winch\n"
        "defaults: {model: LSS-ST1, speed_max_deg_s: 90, accel_max_deg_s2: 300}\n"
        f"joints:\n  drum: {{id: 1, {fields}}}\n"
    )
    path.write_text(text)
    assert main(["check", str(path)]) == 2
    error = capsys.readouterr().err
    assert f"{path}:4: joint 'drum': its range of" in error
    assert "`turns: by_hand`" in error
    path.write_text(text.replace("id: 1", "id: 1, turns: powered"))
    assert main(["check", str(path)]) == 0


@pytest.mark.slow
def test_doctor_and_scan_as_json(capsys):
    main(["doctor", "--json"])
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert {"Python", "packages"} <= {finding["subject"] for finding in findings}
    (bus,) = shown(capsys, "scan", "--robot", ROBOT, "--baud", "115200", "--json")["buses"]
    assert [servo["id"] for servo in bus["servos"]] == [1, 2, 3, 4, 5]
    assert bus["problems"] == []


def test_doctor_names_the_limits_with_which_a_servo_would_restart(capsys):
    main(["doctor", "--json", ROBOT])
    findings = json.loads(capsys.readouterr().out)["findings"]
    stored = [finding for finding in findings if finding["subject"] == "stored limits"]
    assert [finding["text"].split()[0] for finding in stored] == [
        "base", "shoulder", "elbow", "wrist", "gripper"
    ]  # fmt: skip
    assert "speed 360 deg/s (SD), the joint allows 180" in stored[0]["text"]
    assert stored[0]["fix"] == f"lss-motion configure {ROBOT} --limits"


def test_a_report_as_json_is_the_report(capsys, tmp_path):
    path = tmp_path / "report.json"
    assert play([WAVE, "--virtual", "--quiet", "--loop", "1", "--report", str(path)]) == 0
    capsys.readouterr()
    report = json.loads(path.read_text(encoding="utf-8"))
    assert shown(capsys, "report", str(path), "--json") == report
    assert shown(capsys, "report", str(path), str(path), "--json")["second"] == report


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["scan", "--robot", ROBOT, "--baud", "115200", "-o"], 0),
        (["configure", ROBOT, "--backup"], 0),
        (["import", str(SEQUENCES / "motion.csv"), "--robot", ROBOT, "-o"], 0),
        (["gait", str(SEQUENCES / "quadruped_trot.yaml"), "-o"], 0),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_yaml_file_is_overwritten_with_force_only(words, code, capsys, tmp_path):
    path = tmp_path / "kept.yaml"
    path.write_text("mine\n", encoding="utf-8")
    table = tmp_path / "motion.csv"
    table.write_text("t_s,base\n0,0\n1,20\n2,0\n", encoding="utf-8")
    words = [str(table) if word.endswith("motion.csv") else word for word in words]
    assert main([*words, str(path)]) == 2
    assert f"{path}: exists already" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "mine\n"
    assert main([*words, str(path), "--force"]) == code
    assert path.read_text(encoding="utf-8") != "mine\n"


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_options_and_files(capsys, tmp_path):
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    (tmp_path / "my_show.yaml").touch()

    def completed(*words: str) -> list[str]:
        typed = " ".join(f"'{word}'" for word in words)
        code = (
            f"source {script}; COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; "
            f"completer=$(complete -p {words[0]} | sed 's/.*-F \\([^ ]*\\).*/\\1/'); "
            '"$completer"; printf "%s\\n" "${COMPREPLY[@]}"'
        )
        done = subprocess.run(
            ["bash", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        return done.stdout.split()

    assert {"check", "compile", "completion"} <= set(completed("lss-motion", "c"))
    assert "--json" in completed("lss-motion", "check", "--j")
    assert "my_show.yaml" in completed("lss-play", "my_")
    assert "--real-time" in completed("lss-play", "--re")


def test_help_names_the_completion():
    command = [sys.executable, "-m", "lss_motion.cli.main", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "lss-motion completion" in done.stdout


@pytest.mark.parametrize("command", ["sim", "configure", "monitor", "jog", "calibrate"])
def test_a_command_about_a_robot_accepts_its_file_with_and_without_the_option(command, capsys):
    parser = make_parser()
    for words in ([ROBOT], ["--robot", ROBOT]):
        assert parser.parse_args([command, *words]).robot == Path(ROBOT)
    with pytest.raises(SystemExit):
        parser.parse_args([command, ROBOT, "--robot", ROBOT])
    assert "not allowed with" in capsys.readouterr().err


# ---- limits left to the servos: read from them, from a backup, from a log


@pytest.fixture
def limitless_show(tmp_path):
    """Return a sequence whose robot leaves its limits to the servos."""
    robot = (SEQUENCES / "robots" / "desk_arm.yaml").read_text()
    for key in ("speed_max_deg_s: 180", "accel_max_deg_s2: 600"):
        assert key in robot
        robot = robot.replace(key, key.split(":")[0] + ": servo")
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots/desk_arm.yaml").write_text(robot)
    return Path(shutil.copy(SEQUENCES / "fastest.yaml", tmp_path))


def test_offline_nothing_is_planned_without_them(limitless_show, capsys):
    assert main(["check", str(limitless_show)]) == 2
    assert play([str(limitless_show), "--dry-run"]) == 2
    assert capsys.readouterr().err.count("--robot-cache FILE") == 2


def test_a_show_asks_its_servos_and_a_log_of_it_plays_again_without_them(
    limitless_show, tmp_path, capsys
):
    log = tmp_path / "show.log"
    assert play([str(limitless_show), "--virtual", "--quiet", "--log", str(log)]) == 0
    assert read_log(log).played.limits["elbow"] == {
        "speed_max_deg_s": 360.0,
        "accel_max_deg_s2": 1000.0,
    }
    assert main(["replay", "--again", str(log)]) == 0
    assert "outputs compared, 0 differ" in capsys.readouterr().out


def test_a_backup_takes_their_place(limitless_show, tmp_path, capsys):
    backup, robot = tmp_path / "backup.yaml", limitless_show.parent / "robots/desk_arm.yaml"
    assert main(["configure", str(robot), "--backup", str(backup)]) == 0
    backup.write_text(backup.read_text().replace("SD: 3600 ", "SD: 600 "))
    table = tmp_path / "plan.csv"
    options = ["--robot-cache", str(backup), "--csv", str(table)]
    assert main(["plan", str(limitless_show), *options]) == 0
    assert play([str(limitless_show), "--dry-run", "--robot-cache", str(backup)]) == 0
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    speeds = np.diff(rows[:, 1:], axis=0) / np.diff(rows[:, :1], axis=0)
    assert 59.0 < np.abs(speeds).max() < 60.5
    capsys.readouterr()


def test_devices_are_listed_or_the_command_that_installs_them_is_named(capsys, monkeypatch):
    code = main(["devices", "--json"])
    output = capsys.readouterr()
    assert (code == 0 and "devices" in json.loads(output.out)) or "install" in output.err
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    assert main(["devices"]) == 2
    assert install_command("sound") in capsys.readouterr().err


def test_doctor_names_the_sound_device_or_what_is_missing(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    main(["doctor", "--json", "--tone"])
    findings = json.loads(capsys.readouterr().out)["findings"]
    sound = next(finding for finding in findings if finding["subject"] == "sound")
    assert install_command("sound") in sound["text"]
