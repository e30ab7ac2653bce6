"""`lss-motion check STAGE.yaml` plans every show and says what does not go together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_INPUT, EXIT_NO_PLAN, InputError
from lss_motion.stage.check import findings, plan_stage
from lss_motion.stage.load import load_stage

STAGES = Path(__file__).resolve().parents[3] / "sequences" / "stages"

CUES = """\
cues:
  - {cue: a, on: {key: g}, play: scare, start: add}
  - {cue: b, on: {key: g}, play: hello}
  - {cue: c, on: {key: h}, play: hello, start: add, enabled: false}
"""


def test_the_shows_are_planned_and_the_idle_show_loops(kit):
    planned = plan_stage(kit.load())
    assert planned.shows["idle"].program.is_endless
    assert planned.shows["hello"].program.duration_s >= 2.0


def test_what_does_not_go_together_is_found_with_its_line(kit):
    (kit.folder / "sleep.yaml").write_text(
        "sequence: sleep\nloop: forever\nkeyframes:\n  - {at_s: 0, deg: {jaw: 0}}\n"
        "  - {at_s: 1, deg: {jaw: 9}}\n  - {at_s: 2, deg: {jaw: 0}}\n"
    )
    found = {(one.line, one.text.split(";")[0]) for one in findings(plan_stage(kit.load(CUES)))}
    assert any(line == 3 and "'sleep' loops forever" in text for line, text in found)
    assert (3, "no cue plays 'sleep'") in found
    assert any(line == 7 and "has the trigger of 'a'" in text for line, text in found)
    assert any(line == 8 and "adds 'hello', which moves neck" in text for line, text in found)
    assert (8, "no cue enables 'c'") in found
    assert not any("adds 'scare'" in text for _, text in found)


def test_a_show_that_can_only_play_alone_is_not_added_to_an_idle_show(kit):
    cue = "cues:\n  - {cue: a, on: {key: g}, play: scare, start: add}\n"
    (kit.folder / "bite.yaml").write_text((kit.folder / "scare.yaml").read_text())
    (kit.folder / "scare.yaml").write_text(
        "sequence: scare\nrobot: robot.yaml\nplay:\n  - {wait_for: {sensor: door, below_mm: 300}}\n"
        "  - {file: bite.yaml}\n"
    )
    with pytest.raises(InputError) as refused:
        plan_stage(kit.load(cue))
    assert refused.value.line == 6
    assert "adds 'scare', which waits for a sensor: a show that does so" in refused.value.reason
    planned = plan_stage(kit.load(cue, kit.stage.replace("idle: idle\n", "")))
    assert any("adds 'scare', which waits" in one.text for one in findings(planned))


def test_check_prints_shows_cues_and_findings(kit, capsys):
    assert main(["check", str(kit.write(CUES))]) == 0
    out = capsys.readouterr().out
    assert "hall: 4 shows, 3 cues, robot puppet" in out
    assert "a  on key g: scare, add" in out
    assert "stage.yaml:8: no cue enables 'c'; an operator can" in out
    assert main(["check", str(kit.write(CUES)), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["shows"]["scare"]["joints"] == ["jaw"]
    assert {one["line"] for one in found["findings"]} == {3, 7, 8}


def test_check_names_all_shows_that_cannot_be_played(kit, capsys):
    (kit.folder / "hello.yaml").write_text("sequence: hello\nkeyframes: [{deg: {nek: 3}}]\n")
    (kit.folder / "scare.yaml").write_text(
        "sequence: scare\nkeyframes:\n  - {at_s: 0, deg: {jaw: 0}}\n"
        "  - {at_s: 0.1, deg: {jaw: 80}, anchor: true}\n"
    )
    assert main(["check", str(kit.write())]) == EXIT_INPUT
    err = capsys.readouterr().err
    assert "hello.yaml:2: unknown joint 'nek'" in err
    assert "stage.yaml:3: show 'scare':" in err
    (kit.folder / "hello.yaml").write_text(
        "sequence: h\nkeyframes:\n  - {at_s: 1, deg: {jaw: 3}}\n"
    )
    assert main(["check", str(kit.write())]) == EXIT_NO_PLAN
    assert "stage.yaml:3: show 'scare':" in capsys.readouterr().err


def test_the_haunted_hall_can_be_played_as_it_is():
    planned = plan_stage(load_stage(STAGES / "haunted_hall.yaml"))
    assert findings(planned) == []
    assert planned.shows["breathe"].program.is_endless
    assert set(planned.shows["mutter"].program.start_deg) == {"jaw"}


def test_an_example_that_is_a_stage_is_written_with_all_its_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["example", "haunted_hall"]) == 0
    assert "run it: lss-motion serve stages/haunted_hall.yaml" in capsys.readouterr().out
    assert main(["check", "stages/haunted_hall.yaml"]) == 0
    head = (tmp_path / "stages" / "haunted_hall.yaml").read_text("utf-8").splitlines()[0]
    assert (tmp_path / "stages" / head.partition("$schema=")[2]).exists()


@pytest.mark.parametrize("option", [["--robust"], ["--robot", "robot.yaml"]])
def test_check_refuses_options_of_a_show(kit, option, capsys):
    assert main(["check", str(kit.write()), *option]) == EXIT_INPUT
    assert "is for a show; this is a stage" in capsys.readouterr().err
