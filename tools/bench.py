"""Measures what the design promises, each figure next to a peer or a limit in the same run.

tools/run tools/bench.py                 everything
tools/run tools/bench.py codec plan      some of it
tools/run tools/bench.py all --json F    also as JSON
"""

from __future__ import annotations

import argparse
import importlib
import json
import platform
import sys
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parent))

from benches.table import Row, shown

if TYPE_CHECKING:
    from collections.abc import Sequence

BENCHES = (
    "codec", "compile", "compress", "horn", "plan", "loop", "line", "late", "identify", "gait"
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run the named benches; return 1 if a target was not reached."""
    parser = argparse.ArgumentParser(prog="tools/bench.py", description=__doc__)
    parser.add_argument("names", nargs="*", default=["all"], help=" | ".join((*BENCHES, "all")))
    parser.add_argument("--json", type=Path, metavar="F")
    arguments = parser.parse_args(argv)
    names = BENCHES if "all" in arguments.names else tuple(arguments.names)
    if unknown := set(names) - set(BENCHES):
        parser.error(f"no such bench: {', '.join(sorted(unknown))}")
    print(f"{platform.platform()}, Python {platform.python_version()}")
    rows: dict[str, list[Row]] = {}
    for name in names:
        rows[name] = importlib.import_module(f"benches.{name}").measure()
        print(f"\n{name}\n{shown(rows[name])}", flush=True)
    if arguments.json is not None:
        text = json.dumps({name: [row.as_json() for row in some] for name, some in rows.items()})
        arguments.json.write_text(text + "\n", encoding="utf-8")
    return 0 if all(row.is_met is not False for some in rows.values() for row in some) else 1


if __name__ == "__main__":
    sys.exit(main())
