"""`lss-motion gait`, its picture, and gait files given to the other commands."""

from __future__ import annotations

import json

import pytest
from msgspec.structs import replace

from lss_motion.cli.main import main
from lss_motion.planning.picture import plot_gait
from lss_motion.show.gait.model import BodyMove, BodyPose
from lss_motion.show.gait.pacing import gait_lines, paced
from lss_motion.show.load import load_sequence


@pytest.fixture(autouse=True)
def _cache(monkeypatch, tmp_path):
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


def test_a_gait_is_explained_action_by_action(kit):
    gait = kit.gait(
        "tripod",
        BodyMove(pose=BodyPose(shift_mm=(0, 0, 5)), in_s=1.0, hold_s=0.2, label="rise", line=4),
        kit.walk(200.0, turn_deg_s=10.0, label="go", line=5),
        cycle_s=0.5,
    )
    parts = paced(gait, kit.robot(gait))
    lines = gait_lines(gait, parts)
    assert "6 legs, pattern tripod (static), duty 0.50" in lines[0]
    assert lines[1].startswith("0.00 s to 1.00 s: at the pace of the file; body at least")
    assert lines[2] == "  rise (line 4): in 1.00 s, held 0.2 s"
    ratio = parts[1].pace_ratio
    assert f"{ratio:.3f} times slower, for acceleration of joint {parts[1].joint!r}" in lines[3]
    assert (
        f"go (line 5): {200 / ratio:.1f} mm/s and {10 / ratio:.1f} deg/s, 3 cycles of" in lines[4]
    )
    trot = kit.gait("trot", kit.walk(20.0))
    assert "mm outside of its feet" in gait_lines(trot, paced(trot, kit.robot(trot)))[1]


def test_looped_cycles_are_counted_in_the_text(kit):
    for more, first, last in (
        (93, "one pass 152.25 s", "100 cycles of 1.50 s"),
        (None, "without end", "forever, in cycles of 1.50 s"),
    ):
        gait = kit.gait("tripod", replace(kit.walk(20.0, cycles=7), more_cycles=more))
        lines = gait_lines(gait, paced(gait, kit.robot(gait)))
        assert first in lines[0]
        assert lines[-1].endswith(last)


def test_the_command_explains_writes_and_draws(kit, tmp_path, capsys):
    written, drawn = tmp_path / "s.yaml", tmp_path / "f.svg"
    file = kit.examples / "quadruped_trot.yaml"
    assert main(["gait", str(file), "-o", str(written), "--plot", str(drawn)]) == 0
    assert "quadruped trot: 4 legs, pattern trot (dynamic)" in capsys.readouterr().out
    assert len(load_sequence(written).keyframes) > 100
    assert b"<svg" in drawn.read_bytes()


def test_a_picture_of_an_unknown_kind_or_in_no_folder_is_refused(kit, tmp_path, capsys):
    file = str(kit.examples / "hexapod_dance.yaml")
    assert main(["gait", file, "--plot", str(tmp_path / "f.doc")]) == 2
    assert "cannot draw .doc" in capsys.readouterr().err
    assert main(["gait", file, "--plot", str(tmp_path / "none" / "f.svg")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_gait_with_a_negative_margin_is_drawn(kit, tmp_path):
    gait = kit.gait("bound", kit.walk(15.0, cycles=1))
    plot_gait(gait, paced(gait, kit.robot(gait)), tmp_path / "f.svg")
    assert (tmp_path / "f.svg").stat().st_size > 10_000


def test_the_schema_of_gait_files_is_printed(capsys):
    assert main(["schema", "gait"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "gait file"


def test_check_accepts_a_gait_file_and_names_the_line_of_an_error(kit, tmp_path, capsys):
    assert main(["check", str(kit.examples / "hexapod_dance.yaml")]) == 0
    assert "18 joints moved" in capsys.readouterr().out
    bad = tmp_path / "bad.yaml"
    bad.write_text(
        f"gait: far\nrobot: {kit.examples}/robots/hexapod.yaml\n"
        f"legs_from: {kit.examples}/hexapod_walk.yaml\nheight_mm: 80\n"
        "do:\n  - walk: {stride_mm: 20, cycles: 1}\n  - walk: {stride_mm: 500, cycles: 1}\n"
    )
    assert main(["check", str(bad)]) == 2
    assert f"{bad}:7: leg '" in capsys.readouterr().err


def test_the_picture_of_an_endless_walk_notes_that_cycles_are_drawn_once(kit, tmp_path):
    gait = kit.gait("tripod", replace(kit.walk(20.0, cycles=7), more_cycles=None))
    plot_gait(gait, paced(gait, kit.robot(gait)), tmp_path / "f.svg")
    assert "looped drawn once" in (tmp_path / "f.svg").read_text(encoding="utf-8")
