"""Every file and name of `lss_motion/ARCHITECTURE.md` exists, so a reader finds it."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "lss_motion" / "ARCHITECTURE.md"
TOP = ("tests/", "tools/", "sequences/", "lss_motion/", "pyproject.toml")
SPAN = re.compile(r"`([^`\n]+)`")
FILE = re.compile(r"(?P<path>[\w/.]+\.(?:py|yaml|lss|md|toml|json))(?::(?P<name>[\w.]+))?")
FOLDER = re.compile(r"[\w/]+/")


@cache
def names_in(path: Path) -> set[str]:
    """Return what a module defines or imports, and `Class.member` of its classes."""
    found: set[str] = set()
    for node in ast.parse(path.read_text("utf-8")).body:
        found |= defined(node)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{name}" for inner in node.body for name in defined(inner)}
    return found


def defined(node: ast.stmt) -> set[str]:
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            return {name}
        case ast.Assign(targets=targets):
            return {target.id for target in targets if isinstance(target, ast.Name)}
        case ast.AnnAssign(target=ast.Name(id=name)):
            return {name}
        case ast.ImportFrom(names=names):
            return {alias.asname or alias.name for alias in names}
        case _:
            return set()


def problem(span: str) -> str:
    """Return why a span of code names something that is not there; empty if it does not."""
    match = FILE.fullmatch(span)
    if match is None:
        if FOLDER.fullmatch(span) and not (place(span)).is_dir():
            return f"{span}: no such folder"
        return ""
    path = place(match["path"])
    if not path.is_file():
        return "" if match["path"] in ("file.py", "__init__.py") else f"{span}: no such file"
    if match["name"] and match["name"] not in names_in(path):
        return f"{span}: no such name in it"
    return ""


def place(path: str) -> Path:
    return ROOT / path if path.startswith(TOP) else PAGE.parent / path


def test_every_file_and_name_of_the_page_exists():
    spans = SPAN.findall(PAGE.read_text(encoding="utf-8"))
    assert sum(":" in span for span in spans) > 100
    assert [text for span in spans if (text := problem(span))] == []


@pytest.mark.parametrize(
    "span",
    [
        "player/no.py",
        "playing/player/player.py:Play",
        "playing/player/player.py:Player.no",
        "no_folder/",
    ],
)
def test_what_does_not_exist_is_noticed(span):
    assert problem(span)


def test_every_package_and_module_of_the_top_is_on_the_page():
    text = PAGE.read_text(encoding="utf-8")
    for path in sorted(PAGE.parent.iterdir()):
        if path.is_dir() and (path / "__init__.py").exists():
            assert f"`{path.name}`" in text, path.name


def test_the_one_frozen_dataclass_is_the_one_that_is_named():
    """All other values are Structs, whose classes are made without delay (FACTS.md N24)."""
    sources = {path.name: path.read_text() for path in PAGE.parent.rglob("*.py")}
    frozen = {name for name, text in sources.items() if re.search(r"@dataclass\(.*frozen", text)}
    assert frozen == {"move_table.py"}


PACKAGES = sorted(path.parent for path in PAGE.parent.glob("*/**/__init__.py"))
ROW = re.compile(r"^ *(?:\| )?`(\w+)(?:\.py|/)?`(?: +\||  )", re.MULTILINE)


def table_problems(package: Path, text: str) -> list[str]:
    """Return the modules that the table in a package's docstring lacks, and rows of no module."""
    names = {path.stem for path in package.glob("*.py")} - {"__init__", "__main__"}
    names |= {path.parent.name for path in package.glob("*/__init__.py")}
    lacking = [name for name in names if not re.search(rf"^[ |`]*{name}\b", text, re.MULTILINE)]
    others = [
        name for name in ROW.findall(text) if name not in names and not (package / name).is_dir()
    ]
    return sorted(lacking) + others


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_the_table_of_a_package_has_a_row_for_each_module(package):
    text = ast.get_docstring(ast.parse((package / "__init__.py").read_text("utf-8")))
    assert table_problems(package, text) == []
