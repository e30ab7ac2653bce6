"""How quickly a long show is compiled, next to how quickly it is planned, and read from its text.

Ten minutes, 18 joints, 1,200 keyframes, 5 % of them too much to ask: the show of the bench `plan`.
Planned cold and compiled in turns in one process; what counts is processor time, which a busy
machine does not stretch.

Parity was reached (0.90 to 0.98) until planning became a third quicker, half of its verifying being
saved: 1.15 to 1.2 since, with compiling as quick as before (0.32 to 0.36 s). A third of compiling
is seeing how far each move and its some seven rivals reach, a third is choosing, quantizing and
landing it, a twentieth its slot on the line; the rest are segments, the samples of the plan and the
verifier, which follows the finished bytes once more. Fewer candidates cost moves (`compress`).
"""

from __future__ import annotations

import pickle
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from benches.plan import bench_show, empty_cache
from benches.table import Row
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.program.text import from_text, to_text
from lss_motion.planning.trajectory.planner import plan

if TYPE_CHECKING:
    from collections.abc import Callable

REPEATS = 3
RATIO_TARGET = 1.0
MEMORY_TARGET_MB = 500.0
LOAD_TARGET_S = 1.0

CHILD = """
import pickle, sys
from pathlib import Path
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
show, robot = pickle.loads(Path(sys.argv[1]).read_bytes())
compile_program(plan(show, robot), robot)
print(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
"""


def measure() -> list[Row]:
    """Return the time of compiling against that of planning, its memory, and the time to load."""
    show, robot = bench_show()
    with empty_cache():
        trajectory = plan(show, robot)
    program = compile_program(trajectory, robot)

    def plan_cold() -> None:
        with empty_cache():
            plan(show, robot)

    taken = [
        (_cpu_s(lambda: compile_program(trajectory, robot)), _cpu_s(plan_cold))
        for _ in range(REPEATS)
    ]
    compiling_s, planning_s = (statistics.median(column) for column in zip(*taken, strict=True))
    text = to_text(program)
    loading_s = min(_cpu_s(lambda: from_text(text, robot)) for _ in range(REPEATS))
    is_identical = to_text(from_text(text, robot)) == text
    each_us = 1e6 * compiling_s / len(program.moves)
    rows = [
        Row(what=f"compiling {len(program.moves)} moves",
            ours=f"{compiling_s:.2f} s, {each_us:.0f} us a move",
            reference=f"planning {planning_s:.2f} s", ratio=compiling_s / planning_s,
            target=f"<= {RATIO_TARGET:g}", is_met=compiling_s <= RATIO_TARGET * planning_s),
        Row(what=f"loading its text, {len(text) / 1e6:.1f} MB", ours=f"{loading_s:.2f} s",
            target=f"<= {LOAD_TARGET_S:g} s", is_met=loading_s <= LOAD_TARGET_S),
        Row(what="text, program and text again", ours="the same" if is_identical else "different",
            target="the same", is_met=is_identical),
    ]  # fmt: skip
    if Path("/proc/self/status").exists():
        memory_mb = _memory_mb()
        rows.append(
            Row(what="memory of planning and compiling", ours=f"{memory_mb:.0f} MB",
                target=f"<= {MEMORY_TARGET_MB:g} MB", is_met=memory_mb <= MEMORY_TARGET_MB)
        )  # fmt: skip
    return rows


def _cpu_s(do: Callable[[], object]) -> float:
    """Return how long one call keeps the processor busy."""
    started = time.process_time()
    do()
    return time.process_time() - started


def _memory_mb() -> float:
    """Return the most memory that a process needs which plans and compiles the show (Linux)."""
    with empty_cache(), tempfile.TemporaryDirectory() as folder:
        question = Path(folder, "question")
        question.write_bytes(pickle.dumps(bench_show()))
        command = [sys.executable, "-c", CHILD, str(question)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout) / 1024.0
