"""The archive of a field test: what was measured so far, and the comparison of two of them.

It is one file, written anew after each step, so a test that ends on the way goes on with the steps
that are missing. Logs of shows lie in it beside `field.json`.
"""

from __future__ import annotations

import io
import json
import zipfile
from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec import Struct, field, to_builtins

from lss_motion.errors import InputError
from lss_motion.files.output import write_output
from lss_motion.maintenance.field.verdicts import verdicts

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

FORMAT: Final = "lss_motion field test"
VERSION: Final = 1
BODY: Final = "field.json"


class FieldStep(Struct, frozen=True):
    """A step that is over. `figures` is empty where there was nothing to measure."""

    figures: dict[str, Any]
    simulated: dict[str, Any]
    """The same figures of a simulated robot that is as assumed."""
    lasted_s: float
    asked: int
    """How often a person was asked to do something."""


class Archive(Struct, kw_only=True):
    """What is known so far. `files` are texts and logs by name, besides `field.json`."""

    format: str = FORMAT
    version: int = VERSION
    robot: str = ""
    joints: tuple[str, ...] = ()
    is_simulated: bool = False
    made: str = ""
    steps: dict[str, FieldStep] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)

    def figures(self) -> dict[str, dict[str, Any]]:
        """Return the figures of each step."""
        return {name: step.figures for name, step in self.steps.items()}


def save(archive: Archive, path: Path) -> None:
    """Write the archive; raises `InputError`, and leaves the old one, if it cannot be written."""
    body = {key: value for key, value in to_builtins(archive).items() if key != "files"}
    body["verdicts"] = to_builtins(verdicts(archive.figures()))
    texts: dict[str, bytes] = {
        BODY: json.dumps(body, indent=1).encode(),
        "verdicts.txt": _lines(verdict_lines(archive)),
        "figures.txt": _lines(figure_lines(archive)),
        **archive.files,
    }
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as made:
        for name, data in texts.items():
            made.writestr(name, data)
    write_output(path, out.getvalue())


def _lines(lines: Iterator[str]) -> bytes:
    return "".join(f"{line}\n" for line in lines).encode()


def load(path: Path) -> Archive:
    """Return the field test in a file; raises `InputError` if it holds none."""
    try:
        with zipfile.ZipFile(path) as given:
            body = json.loads(given.read(BODY))
            archive = msgspec.convert(body, Archive)
            others = set(given.namelist()) - {BODY, "verdicts.txt", "figures.txt"}
            archive.files = {name: given.read(name) for name in sorted(others)}
    except FileNotFoundError as error:
        raise InputError("file not found; check the name", path=path) from error
    except (zipfile.BadZipFile, KeyError, ValueError, OSError) as error:
        raise InputError("is no archive of lss-motion field-test", path=path) from error
    if archive.format != FORMAT or archive.version != VERSION:
        raise InputError("is no archive of this version of lss-motion field-test", path=path)
    return archive


def verdict_lines(archive: Archive) -> Iterator[str]:
    """Yield a line for each assumption: what it is, and what the test says."""
    for one in verdicts(archive.figures()):
        yield f"{one.fact:4} {one.verdict}"
        yield f"     {one.title}"


def figure_lines(archive: Archive) -> Iterator[str]:
    """Yield each number that was measured, beside that of the simulated robot."""
    for name, step in archive.steps.items():
        simulated = dict(numbers(step.simulated))
        for figure, value in numbers(step.figures):
            other = simulated.get(figure)
            beside = "" if other is None else f"   simulated {other:.4g}"
            yield f"{name}: {figure} {value:.4g}{beside}"


def numbers(value: object, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers in figures, each with the names that lead to it."""
    if isinstance(value, bool):
        return
    if isinstance(value, int | float):
        yield name, float(value)
    elif isinstance(value, dict):
        for key, one in value.items():
            yield from numbers(one, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple):
        for index, one in enumerate(value):
            yield from numbers(one, f"{name}.{index}")


COMPARED: Final = ("delay_s.0", "lag_s.0", "loop_s.0", "accel_deg_s2.0", "top_deg_s.0",
                   "noise_deg", "play_deg.0", "turnaround_s.1", "deaf_s", "rms_deg")  # fmt: skip
"""Figures of a comparison."""


def comparison_lines(one: Archive, other: Archive) -> Iterator[str]:
    """Yield how two field tests differ: verdicts, then figures of steps that both have."""
    told = {row.fact: row.verdict for row in verdicts(other.figures())}
    for row in verdicts(one.figures()):
        there = told.pop(row.fact, "not seen")
        if _word(row.verdict) != _word(there):
            yield f"{row.fact:4} {row.verdict}"
            yield f"{'':4} {there}"
    yield from (f"{fact:4} not seen\n{'':4} {verdict}" for fact, verdict in told.items())
    for name in one.steps:
        if name not in other.steps:
            continue
        there_by: Mapping[str, float] = dict(numbers(other.steps[name].figures))
        for figure, value in numbers(one.steps[name].figures):
            if figure in there_by and figure.endswith(COMPARED):
                yield f"{name}: {figure} {value:.4g} and {there_by[figure]:.4g}"


def _word(verdict: str) -> str:
    return verdict.partition(" by ")[0]
