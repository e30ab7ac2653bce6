"""How far apart the same move reaches the servos of several hosts, in real time.

    tools/run python tools/rig/spread.py [HOSTS] [JOINTS] [SHOW_S]

Each host is a network namespace with its own process, player and simulated robot, all on this
computer, over plain lines. Beside it: how far apart as many idle processes wake for one instant.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rig.stage import RigStage, why_not

IDLE = """
import json, sys, time
begin, count = int(sys.argv[1]), int(sys.argv[2])
late = []
for index in range(count):
    at = begin + index * 250_000_000
    time.sleep(max(0.0, (at - time.monotonic_ns()) / 1e9))
    late.append(time.monotonic_ns())
print(json.dumps(late))
"""


def main(hosts: int = 8, joints: int = 2, show_s: float = 20.0) -> int:
    """Measure and print."""
    if why := why_not():
        print(why, file=sys.stderr)
        return 2
    begin = time.monotonic_ns() + 3_000_000_000
    idle = [
        subprocess.Popen(
            [sys.executable, "-c", IDLE, str(begin), "60"], stdout=subprocess.PIPE, text=True
        )
        for _ in range(hosts)
    ]
    print("idle processes:", told([json.loads(one.communicate()[0]) for one in idle]))
    with (
        tempfile.TemporaryDirectory(prefix="lss-rig-") as folder,
        RigStage(Path(folder), hosts=hosts, joints=joints, show_s=show_s) as rig,
    ):
        rig.start_all()
        loaded = time.monotonic()
        for name in rig.names:
            rig.wait(name, "-> ready", 300)
        print(f"all ready {time.monotonic() - loaded:.1f} s after the last host was started")
        began = time.monotonic()
        rig.go()
        print(f"GO to the first move: {time.monotonic() - began:.1f} s")
        rig.wait("f0", "the show has ended", show_s + 120)
        verdicts = rig.end()
        rejoined = [name for name in rig.names if "rejoins it" in rig.log(name)]
    print("objections:", sum(len(one["objections"]) for one in verdicts.values()))
    print("same move at the servos:", told(matched(list(verdicts.values()))))
    print("figures that were late and rejoined the show:", ", ".join(rejoined) or "none")
    return 0


def matched(verdicts: list[dict[str, list[list[object]]]]) -> list[list[int]]:
    """Return the instants of the moves that all hosts sent, found by their targets in order."""
    rows = []
    for verdict in verdicts:
        seen: dict[str, int] = {}
        found = {}
        for at, line in verdict["moves"]:
            target = str(line).partition("T")[0]
            seen[target] = seen.get(target, 0) + 1
            found[f"{target} {seen[target]}"] = int(str(at))
        rows.append(found)
    shared = set.intersection(*(set(row) for row in rows))
    return [[row[key] for key in sorted(shared)] for row in rows]


def told(rows: list[list[int]]) -> str:
    """Return p50, p99 and max of the spread of each column."""
    spreads = sorted((max(each) - min(each)) / 1e6 for each in zip(*rows, strict=True))
    p99 = spreads[int(0.99 * len(spreads))]
    return (
        f"p50 {statistics.median(spreads):.2f}, p99 {p99:.2f}, max {spreads[-1]:.2f} ms "
        f"({len(spreads)} instants)"
    )


if __name__ == "__main__":
    sys.exit(main(*(int(word) for word in sys.argv[1:])))
