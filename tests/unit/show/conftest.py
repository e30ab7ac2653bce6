"""A small robot file, sequence files for it, and the errors of refused ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from lss_motion.errors import InputError
from lss_motion.show.load import load_sequence
from lss_motion.show.model import Sequence

if TYPE_CHECKING:
    from pathlib import Path

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  base: {id: 1}
  elbow: {id: 2}
poses:
  home: {base: 0, elbow: -20}
  out: {elbow: 45}
"""

START = "sequence: test\nrobot: robot.yaml\nkeyframes:\n"

Load = Callable[[str], Sequence]
Refusals = Callable[[str], list[tuple[int | None, str]]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    return tmp_path


@pytest.fixture
def load(folder: Path) -> Load:
    """Load a sequence file with this text below `keyframes:`; the text starts in line 4."""

    def load(text: str) -> Sequence:
        path = folder / "test.yaml"
        path.write_text(START + text, encoding="utf-8")
        return load_sequence(path)

    return load


@pytest.fixture
def refusals(load: Load) -> Refusals:
    """Return line and reason of every problem of such a file."""

    def refusals(text: str) -> list[tuple[int | None, str]]:
        with pytest.raises(InputError) as caught:
            load(text)
        return [(error.line, error.reason) for error in (caught.value, *caught.value.more)]

    return refusals
