"""How planning and compiling grow to a robot of 250 joints on 8 lines, for ten minutes.

Once with keyframes that all can be met, once with 2 % that are too fast, which makes some places of
a line crowded. Each in a process of its own, for the memory; processor time.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from benches.table import Row

JOINTS, LINES, SHOW_S = 250, 8, 600.0
INFEASIBLE_RATIOS = (0.0, 0.02)
RATIO_TARGET = 2.0
"""Compiling takes at most so many times as long as planning."""
MEMORY_TARGET_MB = 400.0

CHILD = """
import sys, time
from msgspec.structs import replace
from benches.shows import lively_show, robot_of
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
joints, lines, show_s, ratio = int(sys.argv[1]), int(sys.argv[2]), *map(float, sys.argv[3:5])
robot = robot_of(joints)
buses = {f"line{at}": replace(robot.buses["main"], name=f"line{at}") for at in range(lines)}
own = {
    name: replace(joint, bus=f"line{at % lines}", servo_id=1 + at // lines)
    for at, (name, joint) in enumerate(robot.joints.items())
}
robot = replace(robot, buses=buses, joints=own)
show = lively_show(robot, show_s, seed=1, infeasible_ratio=ratio)
begun = time.process_time()
trajectory = plan(show, robot)
planned = time.process_time()
program = compile_program(trajectory, robot)
ended = time.process_time()
kb = open("/proc/self/status").read().split("VmHWM:")[1].split()[0]
print(planned - begun, ended - planned, len(program.moves), max(program.bound_deg.values()), kb)
"""


def measure(show_s: float = SHOW_S) -> list[Row]:
    """Return the time of compiling against that of planning, and the memory of both."""
    if not Path("/proc/self/status").exists():
        return []
    return [row for ratio in INFEASIBLE_RATIOS for row in _rows(show_s, ratio)]


def measure_short() -> list[Row]:
    """Return the same for a minute."""
    return measure(60.0)


def _rows(show_s: float, infeasible_ratio: float) -> list[Row]:
    with tempfile.TemporaryDirectory() as cache:
        arguments = (str(JOINTS), str(LINES), str(show_s), str(infeasible_ratio))
        done = subprocess.run(
            [sys.executable, "-c", CHILD, *arguments],
            env={
                "LSS_MOTION_CACHE_DIR": cache,
                "OPENBLAS_NUM_THREADS": "1",
                "PYTHONPATH": str(Path(__file__).resolve().parent.parent),
            },
            capture_output=True,
            text=True,
            check=True,
        )
    planning_s, compiling_s, moves, bound_deg, memory_kb = map(float, done.stdout.split())
    what = f"{JOINTS} joints, {LINES} lines, {show_s:g} s, {infeasible_ratio:.0%} too fast"
    ratio, memory_mb = compiling_s / planning_s, memory_kb / 1024
    return [
        Row(
            what=f"{what}: compiling {moves:.0f} moves, bound {bound_deg:.2f} deg",
            ours=f"{compiling_s:.1f} s",
            reference=f"planning {planning_s:.1f} s",
            ratio=ratio,
            target=f"<= {RATIO_TARGET:g}",
            is_met=ratio <= RATIO_TARGET,
        ),
        Row(
            what=f"{what}: memory of both",
            ours=f"{memory_mb:.0f} MB",
            target=f"<= {MEMORY_TARGET_MB:g} MB",
            is_met=memory_mb <= MEMORY_TARGET_MB,
        ),
    ]
