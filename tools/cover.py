"""How much of each package the tests reach: statements and branches, by folder.

tools/run tools/cover.py                          all tests, on one core; takes many minutes
tools/run tools/cover.py tests/unit tests/property  these
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT = Path(__file__).resolve().parent.parent
KEYS = ("num_statements", "covered_lines", "num_branches", "covered_branches")


def main(tests: Sequence[str]) -> int:
    """Run the tests with `coverage` and print a line for each package; return what pytest did."""
    with tempfile.TemporaryDirectory() as folder:
        data, report = f"--data-file={folder}/data", Path(folder) / "report.json"
        done = _coverage("run", data, "-m", "pytest", "-m", "", "-q", "-n0", *tests)
        _coverage("json", data, "-q", "-o", str(report))
        files = json.loads(report.read_text(encoding="utf-8"))["files"]
    packages: dict[str, Counter[str]] = {}
    for name, found in files.items():
        folders = Path(name).parts[1:-1] or (".",)
        counts = {key: found["summary"][key] for key in KEYS}
        for package in (folders[0], "all"):
            packages.setdefault(package, Counter()).update(counts)
    print(f"\n{'package':14} {'statements':>10} {'reached':>8} {'branches':>9} {'taken':>6}")
    for package, counts in sorted(packages.items(), key=lambda pair: (pair[0] == "all", pair[0])):
        statements, lines, branches, taken = (counts[key] for key in KEYS)
        shares = (
            f"{got / most:.0%}" if most else ""
            for got, most in ((lines, statements), (taken, branches))
        )
        line_share, branch_share = shares
        print(f"{package:14} {statements:10} {line_share:>8} {branches:9} {branch_share:>6}")
    return done


def _coverage(*words: str) -> int:
    return subprocess.run(
        [sys.executable, "-m", "coverage", *words], cwd=ROOT, check=False
    ).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
