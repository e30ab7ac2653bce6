"""Runs a command of the package in process and returns what it did as items.

Only stable entry points are used: the two command lines, and scripts that use the public names.
Facts of the wall clock and of the machine are replaced by name, see `VOLATILE`. What has no virtual
time of its own (scan, jog, walk) runs on `StandInTime`: waiting takes no time, but the clock moves
on, and keys are pressed at its instants.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import math
import os
import pty
import re
import select
import selectors
import signal
import sys
import time
import traceback
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO
from unittest.mock import patch

from freezing import inside, scripts
from freezing.folders import Item

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

NS_PER_S: Final = 1_000_000_000
VOLATILE: Final = (
    ("date", re.compile(r"\b20\d\d-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?Z?)?")),
    ("version", re.compile(r"(?<=lss_motion )\d+\.\d+\.\d+|(?<=lss-motion )\d+\.\d+\.\d+")),
)
"""Facts of the day and the release, by the name that stands in their place."""
NUMBER: Final = re.compile(r"(?<![\w.])[-+−]?\d[\d,]*(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w])")
COLUMNS: Final = "200"
CTRL_C: Final = "\x03"
LONGEST_S: Final = 200
"""A step that lasts longer than this, of the stand-in time, will not end any more."""
PTY_S: Final = 5.0


@dataclass(frozen=True, slots=True)
class Step:
    """One command line, run in the folder of its case.

    `words` begin with `lss-play`, `lss-motion` or `script`; `files` are what it writes and what is
    frozen. `has_numbers` is false for pages of words; `is_real_time` asks for the stand-in of time,
    `keys` for a terminal on which they are pressed so many seconds after the start, and `has_wire`
    for the bytes at the simulated ports. What goes wrong is compared to the word, see `run_step`.
    """

    name: str
    words: tuple[str, ...]
    files: tuple[str, ...] = ()
    is_quick: bool = False
    has_numbers: bool = True
    is_real_time: bool = False
    keys: tuple[tuple[float, str], ...] = ()
    has_wire: bool = False
    change: tuple[str, str] | None = None
    """A file, and `old -> new` in its text, for this step only."""


class StandInTime:
    """Stands in for the functions of `time` and `select`; passes on to them unless it is active.

    It must be installed before the package is imported, since a module may bind the functions.
    Whoever makes a default selector gets one that uses `select`.
    """

    def __init__(self) -> None:
        self._is_active = False
        self._now_ns = self._begin_ns = 1000 * NS_PER_S
        self._keys: deque[tuple[int, str]] = deque()
        self._person_fd = self._stdin_fd = -1
        self._select, self._sleep = select.select, time.sleep
        self._monotonic, self._monotonic_ns = time.monotonic, time.monotonic_ns

    def install(self) -> None:
        """Replace the functions, for the life of this process."""
        time.monotonic, time.monotonic_ns = self.monotonic, self.monotonic_ns
        time.sleep, select.select = self.sleep, self.select  # type: ignore[assignment]
        setattr(selectors.SelectSelector, "_select", staticmethod(self.select))  # noqa: B010
        selectors.DefaultSelector = selectors.SelectSelector  # type: ignore[misc,assignment]

    @contextlib.contextmanager
    def active(self) -> Iterator[None]:
        """Let time pass only by waiting, from the same instant each time."""
        self._is_active, self._now_ns = True, self._begin_ns
        try:
            yield
        finally:
            self._is_active = False

    @contextlib.contextmanager
    def terminal(self, keys: tuple[tuple[float, str], ...]) -> Iterator[Keyboard]:
        """Return a standard input that is a terminal, on which these keys are pressed."""
        self._person_fd, self._stdin_fd = pty.openpty()
        self._keys.extend((self._begin_ns + round(at_s * NS_PER_S), key) for at_s, key in keys)
        try:
            # The terminal is not the one that controls this process.
            with patch.object(os, "tcgetpgrp", lambda _: os.getpgrp()):
                yield Keyboard(self, self._stdin_fd)
        finally:
            self._keys.clear()
            os.close(self._person_fd)
            os.close(self._stdin_fd)

    def next_line(self) -> str:
        """Let time pass until the next keys are pressed, and return them as a line."""
        at_ns, keys = self._keys.popleft()
        self._now_ns = max(self._now_ns, at_ns)
        return keys

    def _pass(self, until_ns: int) -> bool:
        """Let time pass, but stop at keys; return whether some were pressed."""
        assert until_ns < self._begin_ns + LONGEST_S * NS_PER_S, "it does not end"
        if not self._keys or self._keys[0][0] > until_ns:
            self._now_ns = until_ns
            return False
        at_ns, keys = self._keys.popleft()
        self._now_ns = max(self._now_ns, at_ns)
        if keys == CTRL_C:
            os.kill(os.getpid(), signal.SIGINT)
        else:
            os.write(self._person_fd, keys.encode())
            assert self._select([self._stdin_fd], [], [], PTY_S)[0], "nobody reads single keys"
        return True

    def monotonic_ns(self) -> int:
        return self._now_ns if self._is_active else self._monotonic_ns()

    def monotonic(self) -> float:
        return self._now_ns / NS_PER_S if self._is_active else self._monotonic()

    def sleep(self, seconds: float) -> None:
        if self._is_active:
            goal_ns = self._now_ns + math.ceil(seconds * NS_PER_S)
            while self._pass(goal_ns):
                pass
        else:
            self._sleep(seconds)

    def select(self, *arguments: Any) -> Any:  # noqa: ANN401  (as select.select)
        if not self._is_active:
            return self._select(*arguments)
        *waited_for, timeout_s = arguments if len(arguments) == 4 else (*arguments, None)
        ready = self._select(*waited_for, 0.0)
        if not any(ready):
            assert timeout_s is not None, "it would wait for ever"
            if self._pass(self._now_ns + math.ceil(timeout_s * NS_PER_S)):
                return self._select(*waited_for, 0.0)
        return ready


class Keyboard(io.StringIO):
    """A standard input that is a terminal: single keys by its file number, or whole lines."""

    def __init__(self, time: StandInTime, fileno: int) -> None:
        super().__init__()
        self._time, self._fileno = time, fileno

    def fileno(self) -> int:
        return self._fileno

    def isatty(self) -> bool:
        return True

    def readline(self, _size: int | None = -1, /) -> str:
        return self._time.next_line()


TIME: Final = StandInTime()


def run_step(step: Step, root: Path) -> list[Item]:
    """Run a command in the working folder; return its texts, numbers and files as items.

    What a command that failed writes to standard error must stay to the word (`errors`); other
    texts are for people to read.
    """
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(errors))
        stack.enter_context(inside.planner_in_process())
        wire = stack.enter_context(inside.wire_of_all()) if step.has_wire else None
        if step.change is not None:
            stack.enter_context(_changed(*step.change))
        stdin = stack.enter_context(TIME.terminal(step.keys) if step.keys else _nothing())
        if step.is_real_time:
            stack.enter_context(TIME.active())
            # A run in real time begins with it, which takes long in this process of many cases.
            stack.enter_context(patch.object(gc, "collect"))
        try:
            code = _run(step.words, stdin)
        except Exception as failed:  # noqa: BLE001  (it is what the command did)
            code = f"{type(failed).__name__}: {failed}"
            print(f"{step.words} raises\n{traceback.format_exc()}", file=sys.__stderr__)
    texts = {"out": _plain(out.getvalue(), root), "err": _plain(errors.getvalue(), root)}
    items = [Item(step.name, "numbers", f"exit code {code}\n")]
    if wire is not None:
        items.append(Item(f"{step.name}.wire", "data", wire.text))
    for stream, text in texts.items():
        is_error = stream == "err" and (code not in (0, None) or step.words[0] == "script")
        items.append(Item(f"{step.name}.{stream}", "errors" if is_error else "text", text))
        if step.has_numbers:
            items.append(Item(f"{step.name}.{stream}", "numbers", numbers(text)))
    for file in step.files:
        items += _file_items(f"{step.name}.{file}", Path(file), root)
    return items


def _run(words: tuple[str, ...], stdin: TextIO) -> int | str | None:
    from lss_motion.cli.main import main
    from lss_motion.cli.play import main as play

    program, *arguments = words
    programs: dict[str, Callable[[list[str]], int]] = {
        "lss-play": play, "lss-motion": main, "script": lambda given: scripts.run(*given)
    }  # fmt: skip
    with patch.object(sys, "stdin", stdin), patch.dict(os.environ, COLUMNS=COLUMNS):
        try:
            return programs[program](arguments)
        except SystemExit as ended:
            return ended.code


@contextlib.contextmanager
def _changed(file: str, change: str) -> Iterator[None]:
    path = Path(file)
    text, (old, new) = path.read_text(encoding="utf-8"), (change + " ").split(" -> ", 1)
    assert old in text, f"{file} has no {old!r}"
    path.write_text(text.replace(old, new.rstrip(" "), 1), encoding="utf-8")
    try:
        yield
    finally:
        path.write_text(text, encoding="utf-8")


def _nothing() -> TextIO:
    return Path(os.devnull).open(encoding="utf-8")


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
    if text.startswith('{"format":"lss_motion log",'):
        return _log_items(name, text.encode("latin-1").decode("utf-8"))
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
    for instant, bus, mark, content in inside.log_rows(text):
        if mark in "<>":
            traffic.append(f"{instant} {bus} {mark} {content}")
        elif mark == "!":
            turns.append(f"{instant} {bus} {mark}")
            events.append(f"{instant} {content}")
        else:
            turns.append(f"{instant} {bus} {mark} {content}".rstrip())
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
