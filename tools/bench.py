"""Measures what the package promises, each figure next to a peer or a limit in the same run.

tools/run tools/bench.py                 everything, in fifteen minutes on two quiet cores
tools/run tools/bench.py late plan       some of it, the long way where there is one
tools/run tools/bench.py network --full  an hour of it, too
tools/run tools/bench.py all --json F    also as JSON
tools/run tools/bench.py all --readme    and into tools/FIGURES.md and README.md
tools/run tools/bench.py play --readme   into these, too; the other figures stay as they were
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import os
import platform
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
# Processor time is compared, and threads that wait for each other count twice.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benches import headline
from benches.table import Row, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

BENCHES = (
    "states", "plan", "lateness", "compile", "large", "compress", "horn", "feedback", "robust",
    "random_pairs", "loop", "line", "late", "identify", "load", "capacity", "play", "sound",
    "network", "sync", "start",
)  # fmt: skip
PACKAGES = ("numpy", "scipy", "toppra", "pyserial", "ruckig")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the named benches; return 1 if a target was not reached."""
    parser = argparse.ArgumentParser(
        prog="tools/bench.py", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", default=["all"], help=" | ".join((*BENCHES, "all")))
    parser.add_argument("--full", action="store_true", help="all there is, however long it takes")
    parser.add_argument("--json", type=Path, metavar="F")
    parser.add_argument(
        "--readme", action="store_true", help="keep the figures, show the main ones"
    )
    arguments = parser.parse_args(argv)
    is_all = "all" in arguments.names
    names = BENCHES if is_all else tuple(arguments.names)
    if unknown := set(names) - set(BENCHES):
        parser.error(f"no such bench: {', '.join(sorted(unknown))}")
    about = machine()
    print(*(f"{what}: {value}" for what, value in about.items()), sep="\n")
    rows: dict[str, list[Row]] = {}
    taken_s: dict[str, float] = {}
    for name in names:
        is_short = is_all or arguments.readme
        measure = _measure(name, "full" if arguments.full else "short" if is_short else "")
        started_s = time.monotonic()
        rows[name] = measure()
        taken_s[name] = round(time.monotonic() - started_s, 1)
        print(f"\n{name} ({taken_s[name]:.0f} s)\n{shown(rows[name])}", flush=True)
    short = [row for some in rows.values() for row in some if row.is_met is False]
    judged = sum(row.is_met is not None for some in rows.values() for row in some)
    print(f"\n{judged - len(short)} of {judged} targets met, {sum(taken_s.values()):.0f} s in all")
    tables = {name: [row.as_json() for row in some] for name, some in rows.items()}
    whole = {"machine": about, "seconds": taken_s, "benches": tables}
    text = json.dumps(whole, indent=1, ensure_ascii=False) + "\n"
    if arguments.json is not None:
        arguments.json.write_text(text, encoding="utf-8")
    if arguments.readme:
        headline.keep(whole, is_whole=is_all)
    return 1 if short else 0


def _measure(name: str, way: str) -> Callable[[], list[Row]]:
    """Return what measures: the bench's `measure_short` or `measure_full`, if it has that."""
    module = importlib.import_module(f"benches.{name}")
    measure: Callable[[], list[Row]] = getattr(module, f"measure_{way}", module.measure)
    return measure


def machine() -> dict[str, Any]:
    """Return what the figures were measured on: computer, load, and versions."""
    versions = []
    for name in PACKAGES:
        try:
            versions.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{name} is not installed")
    load = ", ".join(f"{one:.2f}" for one in os.getloadavg()) if hasattr(os, "getloadavg") else "?"
    return {
        "system": platform.platform(),
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "load before": load,
        "versions": f"Python {platform.python_version()}, {', '.join(versions)}",
    }


def _processor() -> str:
    about = Path("/proc/cpuinfo")
    if not about.exists():
        return platform.processor() or platform.machine()
    lines = [line.partition(":") for line in about.read_text(encoding="utf-8").splitlines()]
    return next((value.strip() for key, _, value in lines if key.strip() == "model name"), "?")


if __name__ == "__main__":
    sys.exit(main())
