"""`lss-motion import` and `export`: what they print, write and return."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lss_motion.cli.main import main
from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"

ROBOT = """\
robot: two
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  pan: {id: 1}
  lift_joint: {id: 2}
"""
MOTIONS = """\
motions:
  slow: {joints: [pan], positions: [0.0, 0.5], times_from_start: [0, 1]}
  quick: {joints: [pan], positions: [0.0, 1.5], times_from_start: [0, 0.3]}
  high: {joints: [pan, lift_joint], positions: [0.0, 0.1], times_from_start: [1]}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    (tmp_path / "motions.yaml").write_text(MOTIONS, encoding="utf-8")
    return tmp_path


def run(folder: Path, *words: str) -> int:
    named = [str(folder / word) if word.endswith((".yaml", ".csv")) else word for word in words]
    return main(["import", *named, "--robot", str(folder / "robot.yaml")])


def test_a_file_with_several_motions_needs_a_name(folder: Path, capsys) -> None:
    assert run(folder, "motions.yaml", "-o", "out.yaml") == 2
    assert "holds 3 motions; name one with --motion:\n  slow\n  quick\n" in capsys.readouterr().err
    assert not (folder / "out.yaml").exists()
    assert run(folder, "motions.yaml", "--motion", "slw", "-o", "out.yaml") == 2
    assert "has no motion 'slw'; did you mean 'slow'?" in capsys.readouterr().err


def test_an_imported_motion_is_written_and_its_feasibility_printed(folder: Path, capsys) -> None:
    assert run(folder, "motions.yaml", "--motion", "slow", "-o", "out.yaml") == 0
    assert "every keyframe is on time" in capsys.readouterr().out
    sequence = load_sequence(folder / "out.yaml")
    assert [keyframe.at_s for keyframe in sequence.keyframes] == [0.0, 1.0]
    assert run(folder, "motions.yaml", "--motion", "quick", "-o", "out.yaml", "--force") == 0
    assert "longer: joint 'pan' would need" in capsys.readouterr().out


def test_a_template_is_edited_and_used(folder: Path, capsys) -> None:
    assert run(folder, "motions.yaml", "--motion", "high", "-o", "out.yaml") == 2
    assert "--make-map" in capsys.readouterr().err
    assert run(folder, "motions.yaml", "--motion", "high", "--make-map", "map.yaml") == 0
    assert run(folder, "motions.yaml", "--motion", "high", "--make-map", "map.yaml") == 2
    assert "exists already" in capsys.readouterr().err
    path = folder / "map.yaml"
    text = path.read_text(encoding="utf-8")
    edited = text.replace('name: "lift_joint"', "unit: m, scale: 300")
    assert edited != text
    path.write_text(edited, encoding="utf-8")
    words = ("--motion", "high", "--map", "map.yaml", "-o", "out.yaml")
    assert run(folder, "motions.yaml", *words) == 0
    assert load_sequence(folder / "out.yaml").keyframes[0].deg == {"pan": 0.0, "lift_joint": 30.0}


def test_a_recording_is_reduced_and_the_fit_reported(folder: Path, capsys) -> None:
    rows = "".join(f"{n / 100},{min(n, 300) / 10}\n" for n in range(600))
    (folder / "r.csv").write_text("t_s,pan\n" + rows, encoding="utf-8")
    assert run(folder, "r.csv", "--tolerance-deg", "0.5", "-o", "out.yaml") == 0
    out = capsys.readouterr().out
    assert "Reduced from 600 samples to " in out
    text = (folder / "out.yaml").read_text(encoding="utf-8")
    assert "# Reduced from 600 samples to " in text
    assert len(load_sequence(folder / "out.yaml").keyframes) < 15


@pytest.mark.parametrize(
    "words", [("--tolerance-deg", "-1"), ("--tolerance-deg", "nan"), ("--interpolation", "hold")]
)
def test_a_wrong_option_is_refused_before_anything_is_read(folder: Path, capsys, words) -> None:
    with pytest.raises(SystemExit) as caught:
        run(folder, "motions.yaml", *words, "-o", "out.yaml")
    assert caught.value.code == 2
    assert words[0] in capsys.readouterr().err


@pytest.mark.parametrize(
    ("file", "first"),
    [
        ("wave.csv", "t_s,base,"),
        ("wave.yaml", "joint_names: ["),
        ("wave.json", '{"description": "wave'),
        ("wave.lss", "# lss_motion program 1"),
    ],
)
def test_the_suffix_of_the_file_selects_the_export_format(tmp_path: Path, file, first) -> None:
    output = tmp_path / file
    assert main(["export", str(EXAMPLES / "wave.yaml"), "-o", str(output)]) == 0
    assert output.read_text(encoding="utf-8").startswith(first)


def test_an_export_takes_a_format_and_a_rate(tmp_path: Path, capsys) -> None:
    output = tmp_path / "wave.txt"
    assert main(["export", str(EXAMPLES / "wave.yaml"), "-o", str(output)]) == 2
    assert "add --to: csv, ros" in capsys.readouterr().err
    words = ["--to", "blender-csv", "--rate-hz", "25", "-o", str(output)]
    assert main(["export", str(EXAMPLES / "wave.yaml"), *words]) == 0
    assert output.read_text(encoding="utf-8").startswith("# fps: 25\nframe,base_deg,")


def test_an_exported_blender_file_is_imported_without_a_map(tmp_path: Path) -> None:
    output = tmp_path / "wave.json"
    robot = EXAMPLES / "robots" / "desk_arm.yaml"
    assert main(["export", str(EXAMPLES / "wave.yaml"), "-o", str(output)]) == 0
    assert json.loads(output.read_text(encoding="utf-8"))["fps"] == 100
    target = tmp_path / "again.yaml"
    assert main(["import", str(output), "--robot", str(robot), "-o", str(target)]) == 0
    assert load_sequence(target, load_robot(robot)).keyframes


def test_clip_lists_what_it_limited_and_the_refusal_offers_it(folder: Path, capsys) -> None:
    (folder / "t.csv").write_text("time_s,pan\n0,0\n2,120\n", encoding="utf-8")
    assert run(folder, "t.csv", "-o", "out.yaml") == 2
    err = capsys.readouterr().err
    assert "t.csv:3: keyframe 2 at 2 s: joint 'pan' at 120 deg is outside" in err
    assert "--clip" in err
    assert run(folder, "t.csv", "--clip", "-o", "out.yaml") == 0
    assert "the farthest was 120 deg at 2 s, line 3." in capsys.readouterr().out
    assert load_sequence(folder / "out.yaml").keyframes[1].deg == {"pan": 90.0}


def test_curves_of_scripts_that_would_leave_the_range_are_smooth(folder: Path, capsys) -> None:
    """A command that replaces another makes the script a curve; clipped, it ends at the range."""
    script = "#1D-300T900\nwait 1 ms\n#1D0T999\nwait 2 ms\n#1D99T20\nwait 1 ms\n#1D2500T999\n"
    (folder / "script.txt").write_text(script, encoding="utf-8")
    assert run(folder, str(folder / "script.txt"), "--clip", "-o", "out.yaml") == 0
    assert "A spline would swing joint pan out of its range: smooth" in capsys.readouterr().out
    assert load_sequence(folder / "out.yaml").keyframes[-1].deg == {"pan": 90.0}
