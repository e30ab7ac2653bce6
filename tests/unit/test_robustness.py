"""`lss-motion check --robust`: what it says of a robot is what `lss-play --sim` does there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lss_motion.cli.main import main
from lss_motion.cli.play import main as play
from lss_motion.planning import shows
from lss_motion.playing import robustness
from lss_motion.playing.robustness import robust_lines, trials

ARM = Path(__file__).resolve().parents[2] / "sequences" / "robots" / "desk_arm.yaml"
SHOW = """\
keyframes:
  - {at_s: 0, deg: {base: 0}}
  - {at_s: 1, deg: {base: 30}, hold_s: 4}
  - {at_s: 6, deg: {base: 0}}
"""


@pytest.fixture
def nod(tmp_path, monkeypatch):
    """Return the show file, and its plan at the times of a table."""
    monkeypatch.chdir(tmp_path)
    arm = tmp_path / "arm.yaml"
    # A real port: `--robust` never opens it.
    arm.write_text(ARM.read_text(encoding="utf-8").replace("sim://", "/dev/none"), encoding="utf-8")
    path = tmp_path / "nod.yaml"
    path.write_text(f"sequence: nod\nrobot: arm.yaml\n{SHOW}", encoding="utf-8")
    return path


def judged(nod, sim):
    """Return the exit code of `lss-play`, and RMS, largest and standing error of its truth."""
    words = ["--virtual", "--port", "sim://", "--sim", sim, "--truth", "truth.csv", "--quiet"]
    code = play([str(nod), *words])
    table = np.genfromtxt("truth.csv", delimiter=",", names=True)
    plan = shows.planned(*shows.load(nod, None)).sample(table["t_s"])[:, 0]
    error_deg = np.abs(table["base"] - plan)
    holds = (table["t_s"] > 2.51) & (table["t_s"] < 4.89)
    standing_deg = error_deg[holds].max() if holds.any() else None
    return code, np.sqrt(np.mean(error_deg**2)), error_deg.max(), standing_deg


def test_each_robot_does_what_lss_play_does_on_it(nod, monkeypatch, capsys):
    sims = ("droop=8deg,backlash=3deg", "motor=1%")
    monkeypatch.setattr(robustness, "WORSE", sims)
    assert main(["check", str(nod), "--robust", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["name"], found["robust"]["is_whole"]) == ("nod", True)
    assumed, *worse = found["robust"]["robots"]
    assert (assumed["sim"], assumed["standing_deg"]) == ("", 0.0)
    assert [robot["sim"] for robot in worse] == list(sims)
    for robot in worse:
        code, rms_deg, max_deg, standing_deg = judged(nod, robot["sim"])
        assert robot["stops_the_show"] == (code != 0)
        assert robot["rms_deg"] == pytest.approx(rms_deg, abs=0.002)
        assert robot["max_deg"] == pytest.approx(max_deg, abs=0.002)
        assert robot["standing_deg"] == (standing_deg and pytest.approx(standing_deg, abs=0.002))
    slack, weak = worse
    assert slack["standing_deg"] > 0.3
    assert (slack["stops_the_show"], weak["stops_the_show"]) == (False, True)
    assert weak["faults"][-1]["step"] == "hold"
    assert weak["played_s"] < 5.0


def test_the_table_has_the_worst_first_and_names_what_stops_the_show(nod, capsys, monkeypatch):
    monkeypatch.setattr(robustness, "WORSE", ("lag=-10ms", "motor=1%", "push=6deg"))
    assert main(["check", str(nod), "--robust"]) == 0
    lines = capsys.readouterr().out.partition("Played on 3 simulated robots")[2].splitlines()
    rows = [line.split() for line in lines[2:6]]
    assert [row[-1].partition(",")[0] for row in rows] == [
        "assumed", "motor=1%", "push=6deg", "lag=-10ms",
    ]  # fmt: skip
    largest, standing = map(float, rows[2][1:3])
    assert largest > 5.0, "the hand pushed while the show stood"
    assert standing < 0.2, "what the hand did is no standing error"
    assert lines[6] == "1 of 4 would stop the show:"
    assert lines[7].startswith("  motor=1%: joint 'base' ")
    assert lines[7].endswith(" (hold)")
    assert "simulated" in lines[8]


def test_of_a_long_show_only_the_beginning_is_played_also_of_a_compiled_one(nod):
    nod.write_text(nod.read_text(encoding="utf-8") + "loop: forever\n", encoding="utf-8")
    assert main(["compile", str(nod), "-o", "nod.lss"]) == 0
    for path in (nod, Path("nod.lss")):
        (found,) = trials(shows.prepare(path, None), (), played_s=3.0)
        assert (found.outcome, found.played_s) == ("finished", 3.0)
        assert 0.0 < found.max_deg < 1.0
        lines = robust_lines([found], np.inf)
        assert "the first 60 s" in lines[0]
        assert "None of them would stop the show." in lines


def test_a_wait_for_a_sensor_that_never_comes_ends(nod, monkeypatch):
    """A show that is slowed for good, too: neither may hang."""
    monkeypatch.setattr(robustness, "RUN_RATIO_MAX", 0.1)
    monkeypatch.setattr(robustness, "RUN_MORE_S", 0.5)
    (found,) = trials(shows.prepare(nod, None), ())
    assert (found.outcome, found.is_stopped) == ("unfinished", True)
    assert "waits for a sensor" in found.why
    assert found.played_s < 2.5


def test_a_robot_file_cannot_be_played(nod, capsys):
    assert main(["check", "arm.yaml", "--robust"]) == 2
    assert "give a sequence" in capsys.readouterr().err
