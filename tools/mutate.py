"""Would the tests notice? Changes one thing at a time in a module and runs the tests that judge it.

tools/run tools/mutate.py                       all modules named below, with their figures
tools/run tools/mutate.py estimators faults     some of them, by name
tools/run tools/mutate.py estimators --list     what would be changed
tools/run tools/mutate.py polling --sample 40   only so many of each module, from all over it

A mutant is killed when a test fails, or when the tests take ten times the processor time. One that
no test can see, because it means the same, stands in `tools/mutation/explained.txt` with a reason;
any other survivor fails the run. An explanation that no mutant needs any longer fails it, too.

A driver of our own: the usual ones do not fit. mutmut 3 wants a copy of the project in which every
function is a switch between its variants, which changes what the tests of slots and sizes see;
cosmic-ray starts Python and imports numpy for every mutant, which takes five times as long as here,
where each mutant is a fork of a process that has both.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.abc
import importlib.util
import os
import resource
import signal
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))

from mutation.mutants import mutants_of, sampled

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from importlib.machinery import ModuleSpec
    from types import CodeType, ModuleType

    from mutation.mutants import Mutant

ROOT = Path(__file__).resolve().parent.parent
EXPLAINED = ROOT / "tools" / "mutation" / "explained.txt"
_LADDER = "tests/virtual/test_ladder.py"
_SHOW = "tests/virtual/test_show.py"
TARGETS = {
    "protocol/codec": ("tests/unit/protocol",),
    "protocol/framing": ("tests/unit/protocol", "tests/property/test_protocol.py"),
    "planning/trajectory/verify": ("tests/unit/trajectory/test_verify.py",),
    "planning/program/verify": ("tests/unit/program/test_verify.py",),
    "planning/program/line": ("tests/unit/program/test_line.py",),
    "planning/program/move_table": ("tests/unit/program/test_move_table.py",),
    "playing/player/estimators": ("tests/unit/player/test_estimators.py",),
    "playing/player/faults": ("tests/unit/player/test_faults.py", _LADDER),
    "playing/player/health": ("tests/unit/player/test_health.py",),
    "playing/player/joint_state": ("tests/unit/player/test_joint_state.py",),
    "playing/player/servo_model": (
        "tests/unit/player/test_lost_moves.py",
        "tests/unit/player/test_settings_watch.py",
        "tests/unit/player/test_joint_state.py",
    ),
    "playing/player/polling": ("tests/unit/player/test_polling.py",),
    "playing/player/query_tracker": (
        "tests/unit/player/test_query_tracker.py",
        "tests/unit/player/test_serial_line.py",
    ),
    "playing/player/show_clock": (
        "tests/unit/player/test_show_clock.py",
        "tests/unit/player/test_joint_state.py",
        "tests/unit/player/test_streamer.py",
    ),
    "playing/player/streamer": ("tests/unit/player/test_streamer.py",),
    "playing/player/rate_ramps": ("tests/unit/player/test_streamer.py",),
    "playing/player/player": (_LADDER, _SHOW),
    "playing/player/phases": (_LADDER, _SHOW),
}
"""Module → the tests that are to notice."""
WARM = (
    "numpy",
    "scipy.interpolate",
    "yaml",
    "pytest",
    "hypothesis",
    "_pytest.terminal",
)
"""Imported once, before any fork."""
SLOW_RATIO = 10.0
SLOW_S = 5.0
"""Tests that need so much more processor time than usual, and this much more, never end."""
STUCK_S = 300
"""Tests that wait so long, wait for ever."""


@dataclass(kw_only=True)
class Score:
    """What became of the mutants of one module."""

    made: int = 0
    """How many there are."""
    mutants: int = 0
    """How many of them were tried."""
    killed: int = 0
    explained: int = 0
    survived: list[str] = field(default_factory=list)

    def add(self, other: Score) -> None:
        self.made += other.made
        self.mutants += other.mutants
        self.killed += other.killed
        self.explained += other.explained
        self.survived += other.survived

    def shown(self) -> str:
        return (
            f"{self.mutants:5} of {self.made} mutants {self.killed:5} killed "
            f"{self.explained:4} explained {len(self.survived):4} survived"
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Mutate the named modules, or all; return 1 if a mutant survived unexplained."""
    parser = argparse.ArgumentParser(prog="tools/mutate.py", description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(TARGETS)}; default: all")
    parser.add_argument("--list", action="store_true", help="name the mutants, run nothing")
    parser.add_argument("--sample", type=int, metavar="N", help="try N mutants of each module")
    parser.add_argument("--seed", type=int, default=0, help="of the sample; default: 0")
    arguments = parser.parse_args(argv)
    if arguments.sample is not None and arguments.sample < 1:
        parser.error(f"a sample of {arguments.sample}: at least 1")
    chosen = [name for name in TARGETS if not arguments.names or _is_named(name, arguments.names)]
    if not chosen:
        parser.error(f"no such module; there are {', '.join(TARGETS)}")
    os.chdir(ROOT)
    explained = explanations(EXPLAINED.read_text(encoding="utf-8"))
    total, is_good = Score(), True
    for name in chosen:
        mutants = _mutants(name)
        tried = sampled(mutants, arguments.sample or len(mutants), arguments.seed)
        if arguments.list:
            print(*(f"{name} {mutant.name}" for mutant in tried), sep="\n")
            continue
        score = _judged(name, tried, explained)
        score.made = len(mutants)
        known = {f"{name} {mutant.name}" for mutant in mutants}
        stale = [key for key in explained if key.startswith(f"{name} ") and key not in known]
        is_good &= not score.survived and not stale
        print(f"{name:20} {score.shown()}", flush=True)
        for one in score.survived:
            print(f"    survived {one}")
        for key in stale:
            print(f"    explained, but no mutant: {key}")
        total.add(score)
    if not arguments.list:
        print(f"{'all':20} {total.shown()}")
    return 0 if is_good else 1


def explanations(text: str) -> dict[str, str]:
    """Return mutant → reason: a mutant stands at the edge, its reason below it, indented."""
    found: dict[str, str] = {}
    waiting: list[str] = []
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        if not line.startswith(" "):
            waiting = [] if waiting and found[waiting[0]] else waiting
            waiting.append(line)
            found[line] = ""
            continue
        for key in waiting:
            found[key] = f"{found[key]} {line.strip()}".strip()
    if unexplained := [key for key, reason in found.items() if not reason]:
        raise ValueError(f"no reason below: {unexplained[0]}")
    return found


def _is_named(name: str, wanted: Sequence[str]) -> bool:
    return any(name == one or name.split("/")[1] == one for one in wanted)


def _mutants(name: str) -> list[Mutant]:
    path = ROOT / "lss_motion" / f"{name}.py"
    return mutants_of(path.read_text(encoding="utf-8"), str(path))


def _judged(name: str, mutants: Sequence[Mutant], explained: dict[str, str]) -> Score:
    module, tests = f"lss_motion.{name.replace('/', '.')}", TARGETS[name]
    for one in WARM:
        importlib.import_module(one)
    do_pass, used_s = _do_pass(module, None, tests, STUCK_S)
    if not do_pass:
        raise SystemExit(f"{name}: the tests fail without any change: {' '.join(tests)}")
    limit_s = SLOW_S + SLOW_RATIO * used_s
    score = Score(mutants=len(mutants))
    for mutant in mutants:
        if f"{name} {mutant.name}" in explained:
            score.explained += 1
        elif _do_pass(module, mutant.code, tests, limit_s)[0]:
            score.survived.append(f"{name} {mutant.name}")
        else:
            score.killed += 1
    return score


def _do_pass(
    module: str, code: CodeType | None, tests: Sequence[str], limit_s: float
) -> tuple[bool, float]:
    """Return whether the tests pass with the module changed to `code`, and what they use.

    In a process of its own; seconds of the processor.
    """
    child = os.fork()
    if child == 0:
        failed = 1
        try:
            failed = _test(module, code, tests, limit_s)
        finally:
            os._exit(failed)
    _, status, used = os.wait4(child, 0)
    return status == 0, used.ru_utime + used.ru_stime


def _test(module: str, code: CodeType | None, tests: Sequence[str], limit_s: float) -> int:
    import pytest

    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(STUCK_S)
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 1))
    if code is not None:
        sys.meta_path.insert(0, _Changed(module, code))
    with _silence():
        return int(
            pytest.main(["-x", "-q", "-n0", "-p", "no:cacheprovider", "--assert=plain", *tests])
        )


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    null = os.open(os.devnull, os.O_WRONLY)
    for fd in (1, 2):
        os.dup2(null, fd)
    yield


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads one module from changed code; all others come as usual."""

    def __init__(self, name: str, code: CodeType) -> None:
        self._name, self._code = name, code

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        if fullname != self._name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=self._code.co_filename)

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = self._code.co_filename
        exec(self._code, module.__dict__)  # noqa: S102


if __name__ == "__main__":
    sys.exit(main())
