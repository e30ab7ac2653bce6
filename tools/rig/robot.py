"""Simulated robots behind pseudo-terminals, each in a process of its own, judged at its end.

`python -m rig.robot` reads lines `[ROBOT.yaml, LINK, OUT.json]` and forks a process for each (what
they import is imported once). It writes `OUT.pid` and serves until SIGTERM, then it writes what
the independent judge (`tools/judge`) objects to, and when the moves of each servo arrived.
"""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from campaign.outside import _rows, _stored, robot_of
from judge.recording import recording_of
from judge.verdict import objections

from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import bus_from_robot, servos_of
from lss_motion.sim.pty import serve_buses
from lss_motion.units import NS_PER_MS, NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Robot
    from lss_motion.sim.bus import SimBus

MOVE = re.compile(rb"#\d+D-?\d+")
STEP_NS = 5 * NS_PER_MS
SETTLE_NS = NS_PER_S


def main() -> None:
    """Fork a robot for every line."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    # Not `for line in sys.stdin`: a child must not have lines of others in its buffer.
    while line := sys.stdin.readline():
        robot_path, link, out = json.loads(line)
        if pid := os.fork():
            fresh = Path(out).with_suffix(".fresh")
            fresh.write_text(str(pid), encoding="utf-8")
            fresh.replace(Path(out).with_suffix(".pid"))
            continue
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        serve(robot_path, link, Path(out))
        sys.stdout.flush()
        os._exit(0)


def serve(robot_path: str, link: str, out: Path) -> None:
    """Serve, then judge."""
    robot = load_robot(Path(robot_path))
    buses = {name: bus_from_robot(robot, name, seed=1) for name in robot.buses}
    for bus in buses.values():
        bus.record()
    started_ns = time.monotonic_ns()
    serve_buses(buses, Path(link), announce=lambda text: print(text, flush=True))
    end_ns = time.monotonic_ns() + SETTLE_NS
    verdict = verdict_of(robot, buses, started_ns, end_ns)
    fresh = out.with_suffix(".new")
    fresh.write_text(json.dumps(verdict), encoding="utf-8")
    fresh.replace(out)


def verdict_of(
    robot: Robot, buses: Mapping[str, SimBus], started_ns: int, end_ns: int
) -> dict[str, Any]:
    """Return what the judge objects to, the lines that a bus got, and the moves of its servos."""
    servos, lines = [], {}
    for name, bus in buses.items():
        bus.advance(end_ns)
        lines[name] = {
            "baud_bps": bus.baud_bps,
            "written": _rows([(at - started_ns, line) for at, line in bus.lines or []]),
        }
        times = np.arange(started_ns, end_ns, STEP_NS)
        seen_deg = bus.horn_deg(times)
        for index, joint_name in enumerate(servos_of(robot, name)):
            joint = robot.joints[joint_name]
            received = [(at - started_ns, line) for at, line in bus.received[index]]
            servos.append(
                {
                    "bus": name,
                    "id": joint.servo_id,
                    "stored": _stored(joint),
                    "received": _rows(received),
                    "step_s": s_from_ns(STEP_NS),
                    "horn_deg": seen_deg[:, index].tolist(),
                }
            )
    record = {"end_s": s_from_ns(end_ns - started_ns), "buses": lines, "servos": servos}
    found = [str(one) for one in objections(recording_of(robot_of(robot, 0.2), record))]
    commands = {name: len(bus["written"]) for name, bus in lines.items()}
    moves = [
        [at, line.decode("latin-1")]
        for bus in buses.values()
        for each in bus.received
        for at, line in each
        if MOVE.match(line)  # Not `#1QDT`.
    ]
    return {"objections": found, "lines": commands, "moves": moves}


if __name__ == "__main__":
    main()
