"""Random gaits in the physics of MuJoCo: what `gait` predicts, and what happens.

tools/run tools/benches/walks.py 0 40        the gaits of 40 seeds, a line each, and a table

A quadruped and a hexapod walk straight on in random patterns, paces, heights, strides, steps and
frictions, with bodies of 0.3 to 1.2 kg. A gait that would fall, or leave a range, is not counted.

Measured, seeds 0 to 59: 45 gaits that are predicted to walk get to 59 to 104 % of the way, 15 that
are predicted to get nowhere (`pacing.TIP_RATIO_MIN`) to 4 % at most; none falls over.
"""

from __future__ import annotations

import random
import sys
import tempfile
from pathlib import Path
from typing import Final

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]

from lss_motion.errors import LssMotionError  # noqa: E402
from lss_motion.planning import shows  # noqa: E402
from lss_motion.planning.gait_physics import (  # noqa: E402
    PhysicsWorld,
    WalkVerdict,
    judged_walk,
)
from lss_motion.planning.trajectory.planner import plan  # noqa: E402
from lss_motion.robot.load import load_robot  # noqa: E402
from lss_motion.show.gait.load import sequence_from  # noqa: E402
from lss_motion.show.gait.pacing import TIP_RATIO_MIN, paced  # noqa: E402

EXAMPLES: Final = Path(__file__).resolve().parents[2] / "sequences"
ROBOTS: Final = {
    "quadruped_trot.yaml": (("trot", "pace", "bound", "walk", "crawl"), (120.0, 150.0)),
    "hexapod_walk.yaml": (("tripod", "ripple", "wave", "amble"), (65.0, 95.0)),
}
DRAWN: Final = ("pattern", "cycle_s", "step_height_mm", "height_mm", "sway_mm", "start")
WALKS_RATIO: Final = 0.5
"""Chosen: a gait that gets to half of its way walks."""


def main(first: int, count: int) -> int:
    """Print a line for each gait, then how often the prediction was right."""
    good = {True: [0, 0], False: [0, 0]}
    for seed in range(first, first + count):
        found = _walked(random.Random(seed))  # noqa: S311
        if found is None:
            continue
        name, tip_ratio, verdict = found
        way = verdict.walked_mm[0] / verdict.planned_mm[0]
        is_predicted = tip_ratio >= TIP_RATIO_MIN
        walks = verdict.is_upright and way > WALKS_RATIO
        good[is_predicted][walks] += 1
        mark = " " if walks is is_predicted else "!"
        print(
            f"{mark} {seed:4} {name:48} tips after {tip_ratio:4.2f} of a step: {way:5.0%} of the "
            f"way, leans {verdict.tilt_max_deg:4.1f} deg, upright {verdict.is_upright}"
        )
    print(f"predicted to walk: {good[True][1]} walk, {good[True][0]} do not")
    print(f"predicted not to walk: {good[False][1]} walk, {good[False][0]} do not")
    return 0


def _walked(drawn: random.Random) -> tuple[str, float, WalkVerdict] | None:
    example = drawn.choice(list(ROBOTS))
    patterns, heights = ROBOTS[example]
    keys = {
        "pattern": drawn.choice(patterns),
        "cycle_s": round(drawn.uniform(0.8, 3.0), 2),
        "step_height_mm": round(drawn.uniform(6.0, 30.0), 1),
        "height_mm": round(drawn.uniform(*heights), 1),
    }
    world = PhysicsWorld(
        friction=round(drawn.uniform(0.4, 1.0), 2), body_kg=round(drawn.uniform(0.3, 1.2), 2)
    )
    stride_mm = round(drawn.uniform(15.0, 45.0))
    head = (EXAMPLES / example).read_text("utf-8").partition("do:\n")[0]
    lines = [line for line in head.splitlines() if line.partition(":")[0] not in DRAWN]
    lines += [f"{key}: {value}" for key, value in keys.items()]
    lines += ["do:", f"  - walk: {{stride_mm: {stride_mm}, cycles: 4}}", ""]
    text = "\n".join(lines).replace("robots/", f"{EXAMPLES}/robots/")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gait.yaml"
        path.write_text(text, "utf-8")
        try:
            gait, robot = shows.load_gait(path, None, load_robot)
            passages = paced(gait, robot)
            trajectory = plan(sequence_from(gait, passages), robot)
        except LssMotionError:
            return None
        verdict = judged_walk(gait, robot, passages, trajectory, world)
    name = f"{keys['pattern']} {keys['cycle_s']} s, {stride_mm} mm, friction {world.friction}"
    return name, passages[0].tip_ratio, verdict


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:3])))
