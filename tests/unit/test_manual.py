"""The manual in the package's docstring runs as it is printed."""

from __future__ import annotations

import doctest
from pathlib import Path

import lss_motion

ROOT = Path(__file__).resolve().parents[2]


def test_the_example_of_the_manual_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(lss_motion)
    assert result.attempted >= 8
    assert result.failed == 0
