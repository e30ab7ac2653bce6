"""Exchanges of clocks over the lines of the rig, for the link models of the bench.

    tools/run python tools/rig/exchanges.py [--write]

Two namespaces and zenoh between them: over the line itself, and over the proxy with the model of a
Wi-Fi. With `--write` the round trips go to `tools/benches/exchanges.json`, to which
`benches.stage_model.LOOPBACK` and `WIFI` are fitted (`benches.network.fit`).
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rig.stage import PLAIN, WIFI, RigStage, in_space, rig_environment, why_not

COUNT = 1600
FILE = Path(__file__).resolve().parents[1] / "benches" / "exchanges.json"
ANSWERER = """
import sys
from lss_motion.stage.hosts.peer import Peer
from lss_motion.stage.hosts.peer import NetworkSettings
with Peer(NetworkSettings(stage="rig", figure="f0", conductor="f0", figures=["f0", "f1"],
                          address="10.77.0.1:7447", is_trusted=True), clock_id="0" * 16) as peer:
    peer.answer_clock()
    print("ready", flush=True)
    sys.stdin.read()
"""
ASKER = """
import json, sys
from msgspec.structs import astuple
from benches.network import exchanged_with
from lss_motion.stage.hosts.peer import Peer
from lss_motion.stage.hosts.peer import NetworkSettings
with Peer(NetworkSettings(stage="rig", figure="f1", conductor="f0", figures=["f0", "f1"],
                          address=sys.argv[1], is_trusted=True)) as peer:
    made = exchanged_with(peer, "f1", int(sys.argv[2]), 120.0)
print(json.dumps([astuple(one) for one in made]))
"""


def measured(line: tuple[str, ...], address: str) -> list[list[int]]:
    """Return the four instants of each exchange, all of one clock, in ns from the first."""
    with tempfile.TemporaryDirectory() as folder, RigStage(Path(folder), hosts=2, line=line) as rig:
        answerer = subprocess.Popen(
            [*in_space(rig.space("f0")), sys.executable, "-c", ANSWERER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=rig_environment(),
        )
        assert answerer.stdout is not None
        answerer.stdout.readline()
        done = subprocess.run(
            [*in_space(rig.space("f1")), sys.executable, "-c", ASKER, address, str(COUNT)],
            stdout=subprocess.PIPE,
            env=rig_environment(),
            check=True,
        )
        answerer.kill()
        answerer.wait()
    made = json.loads(done.stdout)
    return [[at - made[0][0] for at in one] for one in made]


def main() -> int:
    """Measure both lines."""
    if why := why_not():
        print(why, file=sys.stderr)
        return 2
    found = {
        "wired": measured(PLAIN, "10.77.0.1:7447"),
        "wifi": measured(WIFI, "10.77.0.254:7001"),
    }
    for name, made in found.items():
        trips = sorted((d - a) - (c - b) for a, b, c, d in made)
        quantiles = [
            trips[int(share * (len(trips) - 1))] / 1e6 for share in (0.0, 0.5, 0.9, 0.99, 1.0)
        ]
        print(name, len(trips), "round trips, ms:", " ".join(f"{one:.3f}" for one in quantiles))
    load = Path("/proc/loadavg").read_text().split()[0]
    if "--write" in sys.argv:
        rows = {
            name: [[d - a, (d - a) - (c - b)] for a, b, c, d in made]
            for name, made in found.items()
        }
        content = {"load": load, "at": time.strftime("%Y-%m-%d"), "round_trips_ns": {
            name: [trip for _, trip in made] for name, made in rows.items()}}  # fmt: skip
        FILE.write_text(json.dumps(content, separators=(",", ":")) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
