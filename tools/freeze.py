#!/usr/bin/env python3
"""Freeze what the code does, and compare: a change of the inside must not change the outside.

    tools/run tools/freeze.py write DIR [--quick] [--full] [--only CASE]
    tools/run tools/freeze.py compare DIR_A DIR_B [--only CASE] [--new-words]

`write` runs the commands of the package on all examples and on robots, shows and fault plans of its
own, in virtual time, and keeps compiled text, plans, every byte on every bus with its instant, horn
angles, reports, imported and exported files, and what refused commands say. `compare` fails (exit
code 1) if a byte, an instant, a number, an exit code or the text of an error differs; other texts
for people that differ are shown, and are no failure. With --new-words, after words were changed on
purpose, texts of errors are shown like that, too: read them. Both folders must come from one
machine with the same libraries: numbers depend on them.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import platform
import shutil
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from fnmatch import fnmatchcase
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from freezing.capture import TIME, run_step
from freezing.cases import Case, cases
from freezing.folders import Item, compare_folders, write_items, write_manifest
from freezing.inputs import write_inputs

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT: Final = Path(__file__).resolve().parent.parent
LIBRARIES: Final = ("numpy", "scipy", "toppra", "pyyaml")
TEXTS_SHOWN: Final = 20


def main(words: Sequence[str] | None = None) -> int:
    """Write or compare; return the exit code."""
    arguments = _parser().parse_args(words)
    if arguments.action == "compare":
        return _compare(arguments)
    return _write(arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    actions = parser.add_subparsers(dest="action", required=True)
    write = actions.add_parser("write", help="run all cases and write what they did")
    write.add_argument("folder", type=Path, metavar="DIR", help="written anew")
    write.add_argument("--quick", action="store_true", help="about a minute and a half of one core")
    write.add_argument("--full", action="store_true", help="store long contents whole")
    write.add_argument("--only", default="*", metavar="CASE", help="such as 'faults.timed.*'")
    write.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default 2)")
    write.add_argument("--times", action="store_true", help="print how long each case takes")
    write.add_argument(
        "--sequences", type=Path, default=ROOT / "sequences", metavar="DIR",
        help="the examples, if they are to be those of another version",
    )  # fmt: skip
    compare = actions.add_parser("compare", help="say how two folders differ")
    compare.add_argument("a", type=Path, metavar="DIR_A")
    compare.add_argument("b", type=Path, metavar="DIR_B")
    compare.add_argument("--only", default="*", metavar="CASE")
    compare.add_argument(
        "--new-words", action="store_true", help="show texts of errors that differ, do not fail"
    )
    compare.add_argument("--all", action="store_true", help="show all texts that differ")
    return parser


def _write(arguments: argparse.Namespace) -> int:
    sequences = arguments.sequences.resolve()
    chosen = [
        case
        for case in cases(sequences, is_quick=arguments.quick)
        if fnmatchcase(case.name, arguments.only)
    ]
    if not chosen:
        print(f"no case matches {arguments.only!r}", file=sys.stderr)
        return 2
    if arguments.folder.exists():
        if any(arguments.folder.iterdir()) and not (arguments.folder / "manifest.json").exists():
            print(f"{arguments.folder} is not a folder of this tool", file=sys.stderr)
            return 2
        shutil.rmtree(arguments.folder)
    arguments.folder.mkdir(parents=True)
    os.environ["PYTHONPATH"] = f"{ROOT}{os.pathsep}{ROOT / 'tools'}"
    started_s = time.monotonic()
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.jobs, mp_context=spawn, initializer=_prepare) as pool:
        running = {pool.submit(_run_case, case, sequences): case for case in chosen}
        for done in as_completed(running):
            case = running[done]
            took_s, items = done.result()
            write_items(arguments.folder, case.name, items, is_full=arguments.full)
            if arguments.times:
                print(f"{took_s:6.1f} s  {case.name}", flush=True)
    facts = {library: version(library) for library in LIBRARIES}
    facts |= {"python": platform.python_version(), "machine": platform.machine()}
    facts["cases"] = f"{'quick' if arguments.quick else 'all'}, {arguments.only}"
    write_manifest(arguments.folder, facts)
    took_s = time.monotonic() - started_s
    print(f"{len(chosen)} cases in {took_s:.0f} s, written to {arguments.folder}")
    return 0


def _prepare() -> None:
    """Make a process ready: before the package is imported, time can be replaced."""
    assert not any(name.partition(".")[0] == "lss_motion" for name in sys.modules)
    TIME.install()
    sys.path.insert(0, str(ROOT))


def _run_case(case: Case, sequences: Path) -> tuple[float, list[Item]]:
    """Run the steps of a case in a folder of its own, with a cache of its own."""
    started_s = time.monotonic()
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary).resolve() / "case"
        shutil.copytree(sequences, folder / "sequences")
        write_inputs(folder)
        cache = str(Path(temporary) / "cache")
        os.environ |= {"LSS_MOTION_CACHE_DIR": cache, "XDG_CACHE_HOME": cache, "HOME": cache}
        os.chdir(folder)
        try:
            items = [item for step in case.steps for item in run_step(step, ROOT)]
        finally:
            os.chdir(before)
    return time.monotonic() - started_s, items


def _compare(arguments: argparse.Namespace) -> int:
    try:
        found = compare_folders(
            arguments.a, arguments.b, arguments.only, has_new_words=arguments.new_words
        )
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    shown = found.texts if arguments.all else found.texts[:TEXTS_SHOWN]
    for text in shown:
        print(f"text: {text}")
    if len(found.texts) > len(shown):
        print(f"… and {len(found.texts) - len(shown)} more texts (--all)")
    for failure in found.failures:
        print(f"FAILED {failure}")
    print(
        f"{found.files_count} files: {len(found.failures)} failures, "
        f"{len(found.texts)} texts differ"
    )
    return 1 if found.failures else 0


if __name__ == "__main__":
    sys.exit(main())
