"""The gate: everything that must hold before a commit, in one command.

tools/run tools/check.py            all of it
tools/run tools/check.py lint types only these steps
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).resolve().parent.parent
MODULE_LINES_MAX = 350
FUNCTION_LINES_MAX = 70
"""About 250 and 40 is the aim; beyond these it is a fault."""
DATA_MODULES = {"lss.py", "lss_later.py", "lss_pro.py", "io2.py"}
"""Tables, one row a command: they are as long as the documents."""
README_COMMAND = re.compile(r"^tools/run (?P<command>.+)$", re.MULTILINE)
README_SKIPPED = ("pytest", "tools/check.py", "tools/bench.py")
"""Run by other steps, or for minutes."""
README_SECONDS_MAX = 120.0


def main(names: list[str]) -> int:
    """Run the named steps, or all; return 1 if one failed."""
    steps: dict[str, Callable[[], bool]] = {
        "format": lambda: _run("ruff", "format", "--check", "--quiet", "."),
        "lint": lambda: _run("ruff", "check", "--quiet", "."),
        "types": lambda: _run("mypy"),
        "imports": lambda: _run("lint-imports", "--no-cache"),
        "size": _sizes,
        "tests": lambda: _run("pytest", "-q"),
        "readme": _readme,
    }
    if unknown := set(names) - set(steps):
        print(f"no such step: {', '.join(sorted(unknown))}; there are {', '.join(steps)}")
        return 2
    failed = []
    for name, step in steps.items():
        if names and name not in names:
            continue
        started = time.monotonic()
        is_good = step()
        print(f"{'ok    ' if is_good else 'FAILED'} {name} ({time.monotonic() - started:.1f} s)")
        if not is_good:
            failed.append(name)
    return 1 if failed else 0


def _run(*command: str) -> bool:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        print(done.stdout + done.stderr)
    return done.returncode == 0


def _sizes() -> bool:
    """Measure modules and functions: what has grown too long is hard to read."""
    faults = []
    for path in sorted((ROOT / "lss_motion").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        lines = source.count("\n")
        if lines > MODULE_LINES_MAX and path.name not in DATA_MODULES:
            faults.append(f"{path.relative_to(ROOT)}: {lines} lines, at most {MODULE_LINES_MAX}")
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
                length = node.end_lineno - node.lineno + 1
                if length > FUNCTION_LINES_MAX:
                    faults.append(
                        f"{path.relative_to(ROOT)}:{node.lineno}: {node.name} has {length} lines, "
                        f"at most {FUNCTION_LINES_MAX}"
                    )
    print("\n".join(faults), end="\n" if faults else "")
    return not faults


def _readme() -> bool:
    """Run every `tools/run …` line of the README that ends by itself."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    commands = [match["command"] for block in blocks for match in README_COMMAND.finditer(block)]
    assert commands, "the README shows no commands"
    is_good = True
    for command in commands:
        words = command.split("  #")[0].split()
        if words[0] in README_SKIPPED or "my_" in command:
            continue
        print(f"       tools/run {' '.join(words)}")
        done = subprocess.run(
            ["tools/run", *words],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            timeout=README_SECONDS_MAX,
            stdin=subprocess.DEVNULL,
        )
        if done.returncode != 0:
            print(done.stdout + done.stderr)
            is_good = False
    return is_good


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
