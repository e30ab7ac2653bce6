"""Random robots with mechanisms in random shows, judged by `tests.geared`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.geared import judge

if TYPE_CHECKING:
    from pathlib import Path

SEEDS = 8
"""`python -m tests.geared 300` judges more."""


@pytest.mark.parametrize("seed", range(SEEDS))
def test_no_limit_of_joint_or_servo_is_broken_and_no_time_lost(seed: int, tmp_path: Path) -> None:
    faults, over_optimum = judge(seed, tmp_path)
    assert not faults
    assert over_optimum <= 1.02
