"""What the package writes and says, as files that a person reads; their diff is the review.

`pytest tests/golden --update-golden` writes them anew. Only what people see and what the bus gets
is kept here, of small examples; `tools/freeze.py` compares all of it between two versions.
"""

from __future__ import annotations

import contextlib
import difflib
import io
import json
import re
from argparse import ArgumentParser, _SubParsersAction
from pathlib import Path

import pytest

from lss_motion.cli.main import main, make_parser
from lss_motion.cli.play import main as play

HERE = Path(__file__).resolve().parent
SEQUENCES = HERE.parents[1] / "sequences"
COLUMNS = "1000"
"""So wide that no explanation is broken: where it breaks depends on the version of Python."""
COMPILED = ("wave.yaml", "tracks.yaml", "parts/nod.yaml")
TRACE_ROWS = 3
"""Readings of each joint that stay in the report: the first ones, so that a person reads it."""


@pytest.fixture(autouse=True)
def _fixed_width_without_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", COLUMNS)
    monkeypatch.setenv("NO_COLOR", "1")  # From Python 3.14 on argparse colours what it prints.


@pytest.fixture
def golden(request: pytest.FixtureRequest):
    """Return what compares a text with the file of that name, or writes it."""

    def judge(name: str, text: str) -> None:
        path = HERE / name
        if request.config.getoption("--update-golden"):
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8", newline="\n")
            return
        kept = path.read_text(encoding="utf-8") if path.exists() else ""
        lines = (kept.splitlines(), text.splitlines())
        changes = "\n".join(difflib.unified_diff(*lines, f"{name} as kept", "now", lineterm=""))
        if kept != text:
            pytest.fail(f"{changes}\nIf this is wanted: pytest --update-golden", pytrace=False)

    return judge


def output(run, *words: str) -> str:
    """Return what a command prints; it must end well."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        try:
            code = run([*words])
        except SystemExit as ended:
            code = ended.code
    assert code == 0, words
    return out.getvalue()


def help_text(text: str) -> str:
    """Return a help text in the form that it has with every version of Python.

    Python 3.13 breaks lines of the usage elsewhere and says `-o, --output F` for
    `-o F, --output F`, which also moves the column of the explanations.
    """
    usage, blank, rest = text.partition("\n\n")
    rest = re.sub(r"(-\w) (\S+), (--[\w-]+ \2)", r"\1, \3", rest)
    rest = re.sub(r"(?<=\S)\n {6,}(?=\S)", "  ", rest)
    rest = re.sub(r"(?<=\S) {2,}(?=\S)", "  ", rest)
    return " ".join(usage.split()) + blank + rest


def commands() -> list[str]:
    (choices,) = (
        action for action in make_parser()._actions if isinstance(action, _SubParsersAction)
    )
    assert all(isinstance(parser, ArgumentParser) for parser in choices.choices.values())
    return sorted(choices.choices)


@pytest.mark.parametrize("file", COMPILED)
def test_compiled_text(golden, tmp_path: Path, file: str) -> None:
    path = tmp_path / "program.lss"
    output(main, "compile", str(SEQUENCES / file), "-o", str(path))
    text = re.sub(r"(?m)^# robot_file: .*/", "# robot_file: ", path.read_text(encoding="utf-8"))
    golden(f"{Path(file).stem}.lss", text)


def test_check(golden) -> None:
    golden("check_wave.txt", output(main, "check", str(SEQUENCES / "wave.yaml")))


def test_report(golden, tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    file = str(SEQUENCES / "parts" / "nod.yaml")
    output(play, file, "--virtual", "--seed", "1", "--quiet", "--report", str(path))
    report = json.loads(path.read_text(encoding="utf-8"))
    for joint in report["joints"].values():
        trace = joint.get("trace", {})
        joint["trace"] = {key: values[:TRACE_ROWS] for key, values in trace.items()}
    golden("report_nod.json", json.dumps(report, indent=1, ensure_ascii=False) + "\n")


@pytest.mark.parametrize("command", ["lss-play", "lss-motion", *commands()])
def test_help(golden, command: str) -> None:
    if command == "lss-play":
        text = output(play, "--help")
    else:
        text = output(main, *([] if command == "lss-motion" else [command]), "--help")
    golden(f"help/{command}.txt", help_text(text))


def test_no_golden_file_is_left_over() -> None:
    kept = {path.stem for path in (HERE / "help").glob("*.txt")}
    assert kept == {"lss-play", "lss-motion", *commands()}
