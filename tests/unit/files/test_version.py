"""Files of a newer program are refused by their version, and by nothing else."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from lss_motion.cli.main import main

SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"
FILES = [
    ("wave.yaml", "sequence: "),
    ("quadruped_trot.yaml", "gait: "),
    ("robots/desk_arm.yaml", "robot: "),
    ("stages/haunted_hall.yaml", "stage: "),
]


@pytest.fixture
def examples(tmp_path):
    shutil.copytree(SEQUENCES, tmp_path / "sequences", ignore=shutil.ignore_patterns("my_*"))
    return tmp_path / "sequences"


@pytest.mark.parametrize(("name", "first"), FILES)
@pytest.mark.parametrize("version", [1, 2, 0, "one"])
def test_a_newer_version_is_the_only_thing_that_is_said(examples, capsys, name, first, version):
    path = examples / name
    lines = path.read_text(encoding="utf-8").splitlines()
    place = next(n for n, line in enumerate(lines) if line.startswith(first)) + 1
    lines[place:place] = [f"version: {version}"] + ["from_the_future: 1"] * (version != 1)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    code = main(["check", str(path)])
    said = capsys.readouterr().err
    if version == 1:
        assert code == 0
    elif version == 2:
        assert code == 2
        assert said == (
            f"{path}:{place + 1}: version (2): is newer than this program, which reads version 1; "
            "install a newer lss-motion\n"
        )
    else:
        assert code == 2
        assert f"{path}:{place + 1}: version ({version!r})" in said
        assert "from_the_future" not in said
