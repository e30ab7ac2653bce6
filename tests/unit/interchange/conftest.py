"""A robot for imports, and the results of readers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.reader import ForeignMotion
from lss_motion.robot.load import load_robot

if TYPE_CHECKING:
    from lss_motion.interchange.reader import Reader
    from lss_motion.robot.model import Robot

PATH = Path("motion.file")

ReadOne = Callable[["Reader", "bytes | str"], ForeignMotion]
Refusal = Callable[["Reader", "bytes | str"], InputError]


@pytest.fixture
def read_one() -> ReadOne:
    """Read content that holds one motion."""

    def read(reader: Reader, content: bytes | str) -> ForeignMotion:
        data = content.encode() if isinstance(content, str) else content
        assert reader.recognises(data)
        (motion,) = reader.motions(PATH, data)
        assert isinstance(motion, ForeignMotion)
        return motion

    return read


@pytest.fixture
def refusal() -> Refusal:
    """Return the one error that a reader raises for content."""

    def refused(reader: Reader, content: bytes | str) -> InputError:
        data = content.encode() if isinstance(content, str) else content
        with pytest.raises(InputError) as caught:
            reader.motions(PATH, data)
        assert caught.value.path == PATH
        return caught.value

    return refused


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    """A robot with joints `base` (id 1), `elbow` (id 5, turned round) and `lift` (id 9)."""
    path = tmp_path / "arm.yaml"
    path.write_text(
        "robot: arm\n"
        "defaults: {model: LSS-HS1, range_deg: [-180, 180], speed_max_deg_s: 360,\n"
        "           accel_max_deg_s2: 1000, turns: powered}\n"
        "joints:\n"
        "  base: {id: 1}\n"
        "  elbow: {id: 5, direction: -1, zero_deg: 10}\n"
        "  lift: {id: 9, range_deg: [-10, 3600]}\n",
        encoding="utf-8",
    )
    return load_robot(path)
