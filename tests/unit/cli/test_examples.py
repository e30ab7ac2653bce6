"""What `example` prints can be typed as it stands."""

from __future__ import annotations

import shlex

import pytest

from lss_motion.cli import examples
from lss_motion.cli import serving as serving_command
from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED
from lss_motion.stage.hosts import serving

STAGES = [name for name in examples.example_names() if examples._file(name).startswith("stages/")]


@pytest.mark.parametrize("name", STAGES)
def test_the_commands_that_it_prints_serve_every_figure_of_a_stage(
    name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    served = []
    monkeypatch.setattr(
        serving_command,
        "_run",
        lambda arguments, _stage, _views: served.append(arguments.figure) or 0,
    )
    monkeypatch.setattr(
        serving, "serve_figure", lambda _stage, figure, **_: served.append(figure) or 0
    )
    assert main(["example", name]) == EXIT_FINISHED
    printed = capsys.readouterr().out.splitlines()
    commands = [line.partition(": ")[2] for line in printed if "lss-motion serve" in line]
    for command in commands:
        _, *words = shlex.split(command)
        assert main(words) == EXIT_FINISHED, capsys.readouterr().err
    from lss_motion.stage.load import load_stage

    stage = load_stage(next((tmp_path / "stages").glob("*.yaml")))
    assert sorted(served, key=str) == (sorted(stage.figures) or [None])
