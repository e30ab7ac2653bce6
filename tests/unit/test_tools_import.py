"""What a tool imports from the package is there: benches run too seldom to find that out."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"
FOLDERS = ("benches", "campaign", "freezing", "judge", "mutation")
MODULES = sorted(
    ".".join(path.relative_to(TOOLS).with_suffix("").parts)
    for folder in FOLDERS
    for path in (TOOLS / folder).glob("*.py")
    if path.stem != "__main__"
)


@pytest.mark.parametrize("name", MODULES)
def test_a_module_of_the_tools_imports(name: str) -> None:
    assert importlib.import_module(name).__doc__
