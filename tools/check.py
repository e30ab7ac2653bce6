"""The gate: every check that a commit must pass, in one command.

tools/run tools/check.py            the quick tier, for every commit: under 5 minutes on two cores
tools/run tools/check.py --all      all tiers, before a change is published: at most 20
tools/run tools/check.py lint types only these steps

The slow tier has the tests that are marked `slow`, more examples of each property, the commands of
the guides, and some shows of the campaign.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from source_rules import citations, class_names, import_cycles, prose, sizes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = Path(__file__).resolve().parent.parent
COMMAND = re.compile(r"^tools/run (?P<command>.+)$", re.MULTILINE)
FILE = re.compile(r"^```yaml\n# (my_\w+\.yaml)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMANDS_SKIPPED = ("pytest", "tools/check.py", "tools/bench.py", "python tools/campaign")
"""Other steps run them, or they take minutes."""
COMMAND_SECONDS_MAX = 120.0
END_SECONDS_MAX = 20.0
SLOW_STEPS = {"guides", "campaign"}
ALL_TESTS = ("-m", "", "--hypothesis-profile=many")
"""Tests of all tiers, and as many examples of each property as `tests/conftest.py` has for them."""
CAMPAIGN = (
    "tools/campaign",
    "shows",
    "--seeds",
    "200",
    "--all-kinds",
    "--judge",
    "both",
    "--jobs",
    "2",
)
STEP_SECONDS_MAX = 30 * 60.0
"""All tiers take 6 to 8 minutes, and up to three times as long on a busy machine."""
ALONE_MAX = 4
"""Failed tests that are run once more, alone. More at once are not the fault of a busy machine."""
ALONE_SECONDS_MAX = 3 * 60.0
"""None of them takes 30 s alone, but for the hour of the weekend, which takes 66 s."""


def main(argv: list[str] | None = None) -> int:
    """Run the named steps, or a tier; return 1 if one failed."""
    parser = argparse.ArgumentParser(
        prog="tools/check.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="STEP", help="only these steps")
    parser.add_argument("--all", action="store_true", help="all tiers, not the quick one alone")
    arguments = parser.parse_args(argv)
    # Hundreds of processes import the package. Without bytecode each one compiles it again.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    # The steps of a group run at the same time; the tests have both processors of a small machine.
    # `collect` leaves the bytecode of all tests, so that it is not made by each worker of `tests`.
    groups: list[dict[str, Callable[[], bool]]] = [
        {
            "format": lambda: _run("ruff", "format", "--check", "--quiet", "."),
            "lint": lambda: _run("ruff", "check", "--quiet", "."),
            "types": lambda: _run("mypy"),
            "imports": lambda: _run("lint-imports", "--no-cache") and _obeys(import_cycles),
            "size": lambda: _obeys(sizes, class_names),
            "prose": lambda: _obeys(prose, citations),
            "figures": _figures,
            "collect": lambda: _run("pytest", "-n0", "--collect-only", "-qq"),
        },
        {"tests": lambda: _tests(*(ALL_TESTS if arguments.all else ()))},
        {"readme": _readme, "guides": _guides},
        {"campaign": lambda: _run(sys.executable, *CAMPAIGN)},
    ]
    known = [name for steps in groups for name in steps]
    if unknown := set(arguments.names) - set(known):
        parser.error(f"no such step: {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    chosen = set(arguments.names or known)
    if not arguments.names and not arguments.all:
        chosen -= SLOW_STEPS
    started = time.monotonic()
    is_good = True
    for steps in groups:
        names = [name for name in steps if name in chosen]
        with ThreadPoolExecutor() as pool:
            results = list(pool.map(_step, names, [steps[name] for name in names]))
        is_good = is_good and all(results)
    if not arguments.names:
        tier = "all tiers" if arguments.all else "quick tier"
        print(f"{'ok    ' if is_good else 'FAILED'} {tier} ({time.monotonic() - started:.0f} s)")
    return 0 if is_good else 1


def _step(name: str, step: Callable[[], bool]) -> bool:
    """Run a step and print how it ended; return whether it is good."""
    started = time.monotonic()
    is_good = step()
    print(f"{'ok    ' if is_good else 'FAILED'} {name} ({time.monotonic() - started:.1f} s)")
    return is_good


def _run(*command: str) -> bool:
    returncode, output = _ended(command)
    if returncode != 0:
        print(output)
    return returncode == 0


def _tests(*options: str) -> bool:
    """Run the README's test command; run up to `ALONE_MAX` failed tests once more, alone.

    Tests with real clocks and processes share the machine with everything else that it does. A test
    that fails alone, too, has failed; one that passes then is named, so that it can be looked at.
    """
    command = ("pytest", *options)
    returncode, output = _ended(command)
    print("\n".join(output.strip().splitlines()[-1:]))
    if returncode == 0:
        return True
    print(output)
    failed = re.findall(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", output, re.MULTILINE)
    if returncode != 1 or not 0 < len(failed) <= ALONE_MAX:
        return False
    print("Once more, alone:", *failed, sep="\n  ")
    returncode, output = _ended((*command, "-n0", *failed), ALONE_SECONDS_MAX)
    if returncode != 0:
        print(output)
    return returncode == 0


def _ended(command: tuple[str, ...], seconds_max: float = STEP_SECONDS_MAX) -> tuple[int, str]:
    """Run a command; return its exit status and its output.

    One that takes longer is aborted, with all that it has started: pytest prints then where each
    process is. The output goes to a file, so that a process that a test left behind cannot keep it
    open.
    """
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as log,
        subprocess.Popen(
            command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
        ) as process,
    ):
        try:
            process.wait(seconds_max)
        except subprocess.TimeoutExpired:
            print(f"{command[0]} did not end in {seconds_max:.0f} s")
            _end(process, signal.SIGABRT)
        log.seek(0)
        return process.returncode, log.read()


def _end(process: subprocess.Popen[Any], number: int) -> None:
    """Send a signal to a command and all that it has started; kill those that go on."""
    for each in (number, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, each)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(END_SECONDS_MAX)


def _obeys(*rules: Callable[[Path], list[str]]) -> bool:
    """Print the faults of rules about the source text; return whether there are none."""
    faults = [fault for rule in rules for fault in rule(ROOT)]
    print("\n".join(faults), end="\n" if faults else "")
    return not faults


def _readme() -> bool:
    """Follow the README."""
    return _followed(ROOT / "README.md")


def _figures() -> bool:
    """Return whether `tools/FIGURES.md` and README show the last run of the bench."""
    from benches import headline

    if headline.is_current():
        return True
    print("tools/FIGURES.md or README.md differs from tools/benches/last.json; write them again:")
    print("tools/run tools/bench.py all --readme")
    return False


def _guides() -> bool:
    """Follow the guides, in the order of their contents, and make their site."""
    folder = ROOT / "sequences"
    contents = (folder / "README.md").read_text(encoding="utf-8")
    pages = re.findall(r"\]\((guides/[^)#]+)\)", contents)
    with tempfile.TemporaryDirectory() as site:
        is_built = _run("mkdocs", "build", "--quiet", "-f", "tools/mkdocs.yml", "-d", site)
    return _followed(*(folder / page for page in pages)) and is_built


def _followed(*pages: Path) -> bool:
    """Do what pages say: write the files that they show, and type their commands in order.

    This works in a new folder with a copy of the examples, where the files are written, too. A
    command that ends with `&` runs until the others ended.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        ignored = shutil.ignore_patterns("my_*")
        shutil.copytree(ROOT / "sequences", copy / "sequences", ignore=ignored)
        texts = [page.read_text(encoding="utf-8") for page in pages]
        text = "\n".join(texts).replace("/tmp/", f"{folder}/")  # noqa: S108
        place = copy if pages[0].parent == ROOT else copy / "sequences"
        for name, content in FILE.findall(text):
            (place / name).write_text(content, encoding="utf-8")
        return _typed(_commands(text), copy)


def _commands(text: str) -> list[str]:
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    found = [match["command"] for block in blocks for match in COMMAND.finditer(block)]
    assert found, "the page shows no commands"
    return [line for line in found if not line.startswith(COMMANDS_SKIPPED)]


def _typed(commands: list[str], folder: Path) -> bool:
    """Run commands one after the other; print the output of those that fail."""
    is_good = True
    with contextlib.ExitStack() as beside:
        for command in commands:
            words = command.split("  #")[0].split()
            print(f"       tools/run {' '.join(words)}")
            typed = [str(ROOT / "tools" / "run"), *(word for word in words if word != "&")]
            if words[0] == "lss-play":
                typed.append("--yes")  # No person can answer here.
            if words[-1] == "&":
                beside.enter_context(_running(typed, folder))
                continue
            is_good = _typed_once(typed, folder) and is_good
    return is_good


def _typed_once(words: list[str], folder: Path) -> bool:
    try:
        done = subprocess.run(
            words,
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=COMMAND_SECONDS_MAX,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired as error:
        print(f"{error}\n{error.stdout}\n{error.stderr}")
        return False
    if done.returncode != 0:
        print(done.stdout + done.stderr)
    return done.returncode == 0


@contextlib.contextmanager
def _running(words: list[str], folder: Path) -> Iterator[None]:
    """Run a command in the background; return after its first line of output."""
    with subprocess.Popen(
        words, cwd=folder, stdout=subprocess.PIPE, start_new_session=True
    ) as process:
        assert process.stdout is not None
        try:
            if not select.select([process.stdout], [], [], COMMAND_SECONDS_MAX)[0]:
                raise TimeoutError(f"{' '.join(words)} prints nothing")
            yield
        finally:
            _end(process, signal.SIGTERM)


if __name__ == "__main__":
    sys.exit(main())
