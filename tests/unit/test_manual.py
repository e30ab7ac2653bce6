"""The manual says what is so: its example runs, its commands exist, its reference is current."""

from __future__ import annotations

import doctest
import re
import shlex
from pathlib import Path

import pytest
from make_reference import PATH, parsers, reference, schemas

import lss_motion
from lss_motion.cli import main, play

ROOT = Path(__file__).resolve().parents[2]
CONTENTS = ROOT / "sequences" / "README.md"
GUIDES = sorted((ROOT / "sequences" / "guides").glob("*.md"))
PAGES = [ROOT / "README.md", CONTENTS, *GUIDES]
LINES_MAX = 160
"""Of a page: what a person reads at a sitting."""
COMMAND = re.compile(r"(?:^|\$ |`)(?:tools/run )?(lss-play|lss-motion) ([^`\n]*)", re.MULTILINE)


def test_the_example_of_the_manual_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(lss_motion)
    assert result.attempted >= 8
    assert result.failed == 0


def blocks(path):
    return re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    "block",
    [block for page in GUIDES for block in blocks(page)],
    ids=lambda text: text.split("(")[0][-20:],
)
def test_every_python_example_of_the_guides_runs(block, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    values: dict[str, object] = {}
    exec(compile(block, "sequences/guides", "exec"), values)
    assert capsys.readouterr().out


def test_the_reference_is_what_the_code_says():
    assert PATH.read_text(encoding="utf-8") == reference(), "run tools/make_reference.py"


def test_the_schemas_are_what_the_code_says():
    made = schemas()
    assert set(made) == set((ROOT / "lss_motion" / "schema").iterdir())
    for path, text in made.items():
        assert path.read_text(encoding="utf-8") == text, "run tools/make_reference.py"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_every_command_of_a_page_has_the_arguments_that_it_shows(path):
    """Also of those that need hands or a robot, which nobody runs."""
    lines = [
        (program, shlex.split(words, comments=True))
        for program, words in COMMAND.findall(path.read_text(encoding="utf-8"))
        if words.strip()
    ]
    assert lines or path.stem not in {"first-show", "first-robot", "stage"}
    names = [parser.prog.partition(" ")[2] for parser in parsers()]
    for program, words in lines:
        parser = play.make_parser() if program == "lss-play" else main.make_parser()
        typed = [word for word in words if word not in ("&", "--help")]
        is_name_only = len(typed) == 1 and program == "lss-motion"
        if is_name_only and typed[0] in names:
            continue
        is_options_only = all(word.startswith("-") for word in typed)
        parser.parse_args([*typed, "FILE"] if is_options_only else typed)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_every_link_of_a_page_leads_to_a_place(path):
    text = path.read_text(encoding="utf-8")
    for link, anchor in re.findall(r"\]\(([^)#\s]*)(#[^)\s]*)?\)", text):
        if link.startswith("http"):
            continue
        target = path.parent / link if link else path
        assert target.exists(), link
        assert not anchor or anchor[1:] in anchors(target), f"{link}{anchor}"


def anchors(path):
    titles = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_the_contents_name_every_page_once_and_no_page_is_long():
    named = re.findall(r"^- \[[^\]]+\]\(guides/([^)]+)\)", CONTENTS.read_text(), re.MULTILINE)
    assert sorted(named) == [page.name for page in GUIDES]
    long = {page.name: len(page.read_text().splitlines()) for page in GUIDES}
    assert {name: lines for name, lines in long.items() if lines > LINES_MAX} == {}
    first = (GUIDES[0].parent / "first-show.md").read_text().splitlines()
    assert len(first) <= 55


def test_what_protects_is_named_with_tests_that_there_are():
    named = re.findall(
        r"`([\w/]+\.py):(test_\w+)`",
        (GUIDES[0].parent / "what-protects-you.md").read_text(encoding="utf-8"),
    )
    assert len(named) > 15
    for file, test in named:
        text = (ROOT / "tests" / file).read_text(encoding="utf-8")
        assert f"def {test}(" in text, f"{file}:{test}"
