"""Runs a command of the package in process and returns what it did as items.

Only stable entry points are used: the two command lines. Facts of the wall clock and of the machine
are replaced by name, see `VOLATILE`. Commands that have no virtual time of their own (scan,
configure, monitor, send) run on `StandInTime`: waiting takes no time, but the clock moves on.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import math
import os
import re
import select
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from unittest.mock import patch

from freezing.folders import Item

if TYPE_CHECKING:
    from collections.abc import Iterator

NS_PER_S: Final = 1_000_000_000
VOLATILE: Final = (
    ("date", re.compile(r"\b20\d\d-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?Z?)?")),
    ("version", re.compile(r"(?<=lss_motion )\d+\.\d+\.\d+|(?<=lss-motion )\d+\.\d+\.\d+")),
)
"""Facts of the day and the release, by the name that stands in their place."""
PLAYED: Final = "# played: "
"""The line of a log that names files, all of which the case itself has given."""
NUMBER: Final = re.compile(r"(?<![\w.])[-+−]?\d[\d,]*(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w])")
COLUMNS: Final = "200"


@dataclass(frozen=True, slots=True)
class Step:
    """One command line, run in the folder of its case.

    `words` begin with `lss-play` or `lss-motion`; `files` are what it writes and what is frozen.
    `has_numbers` is false for pages of words; `is_real_time` asks for the stand-in of time.
    """

    name: str
    words: tuple[str, ...]
    files: tuple[str, ...] = ()
    is_quick: bool = False
    has_numbers: bool = True
    is_real_time: bool = False


class StandInTime:
    """Stands in for the functions of `time` and `select`; passes on to them unless it is active.

    It must be installed before the package is imported, since a module may bind the functions.
    """

    def __init__(self) -> None:
        self._is_active = False
        self._now_ns = 0
        self._select, self._sleep = select.select, time.sleep
        self._monotonic, self._monotonic_ns = time.monotonic, time.monotonic_ns

    def install(self) -> None:
        """Replace the functions, for the life of this process."""
        time.monotonic, time.monotonic_ns = self.monotonic, self.monotonic_ns
        time.sleep, select.select = self.sleep, self.select  # type: ignore[assignment]

    @contextlib.contextmanager
    def active(self) -> Iterator[None]:
        """Let time pass only by waiting, from the same instant each time."""
        self._is_active, self._now_ns = True, 1000 * NS_PER_S
        try:
            yield
        finally:
            self._is_active = False

    def monotonic_ns(self) -> int:
        return self._now_ns if self._is_active else self._monotonic_ns()

    def monotonic(self) -> float:
        return self._now_ns / NS_PER_S if self._is_active else self._monotonic()

    def sleep(self, seconds: float) -> None:
        if self._is_active:
            self._now_ns += math.ceil(seconds * NS_PER_S)
        else:
            self._sleep(seconds)

    def select(self, *arguments: Any) -> Any:  # noqa: ANN401  (as select.select)
        if not self._is_active:
            return self._select(*arguments)
        *waited_for, timeout_s = arguments if len(arguments) == 4 else (*arguments, None)
        ready = self._select(*waited_for, 0.0)
        if not any(ready):
            assert timeout_s is not None, "it would wait for ever"
            self.sleep(timeout_s)
        return ready


TIME: Final = StandInTime()


def run_step(step: Step, root: Path) -> list[Item]:
    """Run a command in the working folder; return its texts, numbers and files as items."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(errors))
        if step.is_real_time:
            stack.enter_context(TIME.active())
            # A run in real time begins with it, which takes long in this process of many cases.
            stack.enter_context(patch.object(gc, "collect"))
        code = _run(step.words)
    texts = {"out": _plain(out.getvalue(), root), "err": _plain(errors.getvalue(), root)}
    items = [Item(step.name, "numbers", f"exit code {code}\n")]
    for stream, text in texts.items():
        items.append(Item(f"{step.name}.{stream}", "text", text))
        if step.has_numbers:
            items.append(Item(f"{step.name}.{stream}", "numbers", numbers(text)))
    for file in step.files:
        items += _file_items(f"{step.name}.{file}", Path(file), root)
    return items


def _run(words: tuple[str, ...]) -> int | str | None:
    from lss_motion.cli.main import main
    from lss_motion.cli.play import main as play

    program, *arguments = words
    os.environ["COLUMNS"] = COLUMNS
    stdin = sys.stdin
    try:
        with Path(os.devnull).open(encoding="utf-8") as sys.stdin:
            return {"lss-play": play, "lss-motion": main}[program](arguments)
    except SystemExit as ended:
        return ended.code
    finally:
        sys.stdin = stdin


def _plain(text: str, root: Path) -> str:
    """Return the text without what depends on the day, the release and the place of files."""
    text = text.replace(str(Path.cwd()), "<folder>").replace(str(root), "<root>")
    for name, pattern in VOLATILE:
        text = pattern.sub(f"<{name}>", text)
    return text


def numbers(text: str) -> str:
    """Return the numbers of a text, one a line; the words around them may change."""
    found = (match.group().replace("−", "-").replace(",", "") for match in NUMBER.finditer(text))
    return "".join(f"{number.lstrip('+')}\n" for number in found)


def _file_items(name: str, path: Path, root: Path) -> list[Item]:
    """Return what a written file holds, divided into what must stay and words for people."""
    if not path.exists():
        return [Item(name, "data", "not written\n")]
    text = _plain(path.read_bytes().decode("latin-1"), root)
    if text.startswith("# lss_motion log"):
        return _log_items(name, text)
    if path.suffix == ".json" and text.startswith('{\n "schema"'):
        return _report_items(name, json.loads(text))
    if path.suffix == ".yaml":
        content = "".join(f"{_uncommented(line)}\n" for line in text.splitlines())
        return [Item(name, "data", content), Item(name, "text", text)]
    return [Item(name, "data", text)]


def _uncommented(line: str) -> str:
    return re.sub(r"(^|\s)#.*", "", line).rstrip()


def _log_items(name: str, text: str) -> list[Item]:
    """Return bytes and instants; what the player decided and when; events as numbers and text."""
    traffic, turns, events = [], [], []
    for line in text.splitlines():
        if line.startswith(PLAYED):
            continue
        if line.startswith("#"):
            turns.append(line)
            continue
        instant, bus, mark, *rest = line.split(" ", 3)
        if mark in "<>":
            traffic.append(line)
        elif mark == "!":
            turns.append(f"{instant} {bus} {mark}")
            events.append(f"{instant} {rest[0] if rest else ''}")
        else:
            turns.append(line)
    described = "".join(f"{line}\n" for line in events)
    return [
        Item(f"{name}.bytes", "data", "".join(f"{line}\n" for line in traffic)),
        Item(f"{name}.turns", "data", "".join(f"{line}\n" for line in turns)),
        Item(f"{name}.events", "numbers", numbers(described)),
        Item(f"{name}.events", "text", described),
    ]


def _report_items(name: str, report: object) -> list[Item]:
    """Return a report as rows `key = value`, and its values alone: keys may get other names."""
    rows = list(_leaves("", report))
    values = [value for _, value in rows if not isinstance(value, str)]
    return [
        Item(name, "numbers", "".join(f"{json.dumps(value)}\n" for value in values)),
        Item(name, "text", "".join(f"{key} = {json.dumps(value)}\n" for key, value in rows)),
    ]


def _leaves(key: str, value: object) -> Iterator[tuple[str, object]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(f"{key}.{name}" if key else name, inner)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _leaves(f"{key}[{index}]", inner)
    else:
        yield key, value
