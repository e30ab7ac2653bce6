"""How far apart the same move reaches the servos of several hosts, in real time.

    tools/run python tools/rig/spread.py [--hosts 8] [--joints 2] [--show-s 20] [--real-time]
    tools/run python tools/rig/spread.py --joints 18 --show-s 600 --until-start

Each host is a network namespace with its own process, player and simulated robot, all on this
computer, over plain lines. A move is known by its joint and its number in the plan, which every
host has; what a servo received is paired with the plan by the order of its targets, which are
different for every swing. Beside it, meanwhile and before: how far apart as many idle processes
wake for one instant; and which processes took the processors.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rig.stage import RigStage, why_not

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.planning.program.model import Program

NEAR: Final = 30
"""In tenths of a degree: a target that was corrected for a load is not that of another swing."""
LATE_MS: Final = 10.0
IDLE: Final = """
import json, sys, time
begin, count = int(sys.argv[1]), int(sys.argv[2])
late = []
for index in range(count):
    at = begin + index * 250_000_000
    time.sleep(max(0.0, (at - time.monotonic_ns()) / 1e9))
    late.append(time.monotonic_ns())
print(json.dumps(late))
"""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--hosts", type=int, default=8)
    parser.add_argument("--joints", type=int, default=2)
    parser.add_argument("--show-s", type=float, default=20.0)
    parser.add_argument("--real-time", action="store_true")
    parser.add_argument(
        "--until-start", action="store_true", help="measure only from the load to the first leg"
    )
    given = parser.parse_args()
    if why := why_not():
        print(why, file=sys.stderr)
        return 2
    print("idle processes, alone:    ", told(spreads(idle_of(start_idle(given.hosts, 10.0)))))
    with (
        tempfile.TemporaryDirectory(prefix="lss-rig-") as folder,
        RigStage(
            Path(folder),
            hosts=given.hosts,
            joints=given.joints,
            show_s=given.show_s,
            is_real_time=given.real_time,
            is_separate=given.until_start,
        ) as rig,
    ):
        if given.until_start:
            measure_start(rig)
        else:
            measure(rig, given.hosts, given.show_s)
    return 0


def measure_start(rig: RigStage) -> None:
    """Print how long it takes until all are ready, and until all stand at the start."""
    before = cpu_s()
    rig.start_all()
    rig.say("f0", "l show")
    rig.wait("f0", "loads 'show'", 900)
    loaded = time.monotonic()
    for name in rig.names:
        rig.wait(name, "-> ready", 300)
    print(f"from the load to all ready: {time.monotonic() - loaded:.1f} s")
    plans = list((rig.folder / "f1.store").iterdir())
    print(f"fetched by one figure: {sum(one.stat().st_size for one in plans) / 1e6:.2f} MB")
    rig.wait("f0", "all stand at the start", 300)
    print("GO:", re.search(r"all stand at the start after ([\d.]+ s)", rig.log("f0"))[0])  # type: ignore[index]
    after = cpu_s()
    for kind, used_s in sorted(after.items()):
        print(f"  {used_s - before.get(kind, 0.0):6.1f} s of a core: {kind}")
    load = Path("/proc/loadavg").read_text().split()[0]
    print(f"load of the computer: {load} on {os.cpu_count()} cores")
    rig.say("f0", "s")
    verdicts = rig.end()
    print("objections:", sum(len(one["objections"]) for one in verdicts.values()))


def measure(rig: RigStage, hosts: int, show_s: float) -> None:
    """Play a show, and print what was measured."""
    rig.start_all()
    loaded = time.monotonic()
    for name in rig.names:
        rig.wait(name, "-> ready", 300)
    print(f"all ready {time.monotonic() - loaded:.1f} s after the last host was started")
    rig.wait("f0", "all stand at the start", 300)
    print("GO:", re.search(r"all stand at the start after ([\d.]+ s)", rig.log("f0"))[0])  # type: ignore[index]
    before = cpu_s()
    idle = start_idle(hosts, show_s - 4.0)
    began = time.monotonic()
    rig.wait("f0", "the show has ended", show_s + 120)
    took_s = time.monotonic() - began
    after = cpu_s()
    print("idle processes, meanwhile:", told(spreads(idle_of(idle))))
    for kind, used_s in sorted(after.items()):
        if (used_s - before.get(kind, 0.0)) / took_s > 0.01:
            print(f"  {(used_s - before.get(kind, 0.0)) / took_s:5.2f} of a core: {kind}")
    plans = plans_of(rig)
    verdicts = rig.end()
    rejoined = [name for name in rig.names if "rejoins it" in rig.log(name)]
    print("objections:", sum(len(one["objections"]) for one in verdicts.values()))
    rows = [paired(plans[name], verdicts[name]["moves"]) for name in rig.names]
    shared = sorted(set.intersection(*(set(row) for row in rows)))
    counts = [len(verdicts[name]["moves"]) for name in rig.names]
    print(f"moves of the plan: {len(plans['f0'].moves)}, at all hosts {len(shared)}; received at "
          f"each, with those of the approach and corrections: {counts}")  # fmt: skip
    print(
        "same move at the servos:  ", told(spreads([[row[key] for key in shared] for row in rows]))
    )
    worst = sorted(
        shared, key=lambda key: min(row[key] for row in rows) - max(row[key] for row in rows)
    )
    began = min(rows[0].values())
    for key in worst[:8]:
        at = min(row[key] for row in rows)
        behind_ms = " ".join(f"{(row[key] - at) / 1e6:.1f}" for row in rows)
        print(f"  servo {key[0]}, move {key[1]}, {(at - began) / 1e9:.2f} s: {behind_ms}")
    for name, row in zip(rig.names, rows, strict=True):
        first = [min(other[key] for other in rows) for key in shared]
        behind = [(row[key] - at) / 1e6 for key, at in zip(shared, first, strict=True)]
        late = sum(one > LATE_MS for one in behind)
        print(f"  {name}: behind the first p50 {statistics.median(behind):.2f}, max "
              f"{max(behind):.2f} ms; {late} by more than {LATE_MS:g} ms")  # fmt: skip
    print("figures that were late and rejoined the show:", ", ".join(rejoined) or "none")


def start_idle(count: int, seconds: float) -> list[subprocess.Popen[str]]:
    """Start processes that wake four times a second, all at the same instants."""
    begin = time.monotonic_ns() + 3_000_000_000
    words = [sys.executable, "-c", IDLE, str(begin), str(max(round(4 * (seconds - 3.0)), 8))]
    return [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(count)]


def idle_of(processes: Sequence[subprocess.Popen[str]]) -> list[list[int]]:
    """Return at which instants they woke."""
    return [json.loads(one.communicate()[0]) for one in processes]


def plans_of(rig: RigStage) -> dict[str, Program]:
    """Return what every host plays."""
    from lss_motion.robot.load import load_robot
    from lss_motion.stage.hosts.plans import planned_cast, read_plan

    robot = load_robot(rig.folder / "robot.yaml")
    planned = planned_cast(
        "show", rig.folder / "show.yaml", dict.fromkeys(rig.names, robot), rig.names[0]
    )
    parts, contents = planned.cast.parts, planned.contents
    return {name: read_plan(contents[parts[name].plan], robot) for name in rig.names}


def paired(program: Program, moves: Sequence[tuple[int, str]]) -> dict[tuple[int, int], int]:
    """Return when each move of the plan arrived, by servo and number."""
    planned, received = defaultdict(list), defaultdict(list)
    for move in sorted(program.moves, key=lambda one: one.due_us):
        planned[move.servo_id].append(move.target_wire)
    for at, line in sorted((int(at), line) for at, line in moves):
        servo, target = target_of(line)
        received[servo].append((at, target))
    found = {}
    for servo, targets in planned.items():
        for number, index in aligned(targets, [target for _, target in received[servo]]):
            found[servo, number] = received[servo][index][0]
    return found


def target_of(line: str) -> tuple[int, int]:
    """Return servo and target of a move."""
    match = re.match(r"#(\d+)D(-?\d+)", line)
    assert match is not None, line
    return int(match[1]), int(match[2])


def aligned(planned: Sequence[int], received: Sequence[int]) -> list[tuple[int, int]]:
    """Return pairs of indices, in order, whose targets are the nearest to each other in total."""
    rows, columns = len(planned) + 1, len(received) + 1
    cost = [[0.0] * columns for _ in range(rows)]
    for i in range(rows):
        for j in range(columns):
            if i == 0 or j == 0:
                cost[i][j] = (i + j) * NEAR / 2
                continue
            pair = cost[i - 1][j - 1] + abs(planned[i - 1] - received[j - 1])
            cost[i][j] = min(pair, cost[i - 1][j] + NEAR / 2, cost[i][j - 1] + NEAR / 2)
    pairs, i, j = [], rows - 1, columns - 1
    while i and j:
        if cost[i][j] == cost[i][j - 1] + NEAR / 2:
            j -= 1  # A move that was sent again has the same target: the first one counts.
        elif cost[i][j] == cost[i - 1][j] + NEAR / 2:
            i -= 1
        else:
            i, j = i - 1, j - 1
            pairs.append((i, j))
    return pairs[::-1]


def spreads(rows: Sequence[Sequence[int]]) -> list[float]:
    """Return how far apart the instants of each column are, in ms."""
    return [(max(each) - min(each)) / 1e6 for each in zip(*rows, strict=True)]


def told(spreads_ms: Sequence[float]) -> str:
    """Return p50, p99 and max."""
    ordered = sorted(spreads_ms)
    p99 = ordered[int(0.99 * len(ordered))]
    return (
        f"p50 {statistics.median(ordered):.2f}, p99 {p99:.2f}, max {ordered[-1]:.2f} ms "
        f"({len(ordered)} instants)"
    )


KINDS: Final = {
    "rig.serve": "hosts", "remote.process": "players", "rig.robot": "robots", "rig.proxy": "proxy"
}  # fmt: skip


def cpu_s() -> Mapping[str, float]:
    """Return how many seconds of a core each kind of process has taken, of this rig or not."""
    tick_s = 1.0 / os.sysconf("SC_CLK_TCK")
    found: dict[str, float] = defaultdict(float)
    for path in Path("/proc").glob("[0-9]*"):
        try:
            words = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            fields = (path / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        kind = next((text for word, text in KINDS.items() if word in words), "others")
        found[kind] += (int(fields[11]) + int(fields[12])) * tick_s
    return found


if __name__ == "__main__":
    sys.exit(main())
