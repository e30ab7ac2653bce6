"""Random gaits in the physics of MuJoCo: what `gait` predicts, and what happens.

tools/run tools/benches/walks.py 0 40          the gaits of 40 seeds, a line each, and a table
tools/run tools/benches/walks.py 0 40 stand    random robots that stand on random slopes

Robots with four and six legs: those of the examples, with legs, hips and stance of 0.7 to 1.4 times
the size, each of its own, and bodies of 0.3 to 1.2 kg. They walk straight on in random patterns,
paces, heights, strides, steps and frictions. A gait that would fall, or leave a range, is not
counted. Those that stand do so on slopes in any direction, of up to 1.6 times that on which nothing
is left of their margin, with rubber feet. What is claimed is the margin on that slope
(`Stance.margin_mm` of a centre that is moved downhill).

Measured, seeds 0 to 119: of 89 gaits predicted to walk 88 get to 52 to 105 % of the way, and
one, a walk with a low friction, to 49 %; 26 that are predicted to get nowhere
(`pacing.TIP_RATIO_MIN`) go 2 to 44 % of it backwards; none falls over.
Measured, seeds 0 to 149, standing: of 114 that are claimed to stand 1 falls, of 30 that are claimed
to fall 13 stand, as legs weigh, too, and lower than the body. With a friction of 2 some feet slide
on the steepest slopes at first, and 5 of the 114 trip.
"""

from __future__ import annotations

import math
import random
import re
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

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

if TYPE_CHECKING:
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.pacing import Paced

EXAMPLES: Final = Path(__file__).resolve().parents[2] / "sequences"
ROBOTS: Final = {
    "quadruped_trot.yaml": (("trot", "pace", "bound", "walk", "crawl"), (120.0, 150.0)),
    "hexapod_walk.yaml": (("tripod", "ripple", "wave", "amble"), (65.0, 95.0)),
}
DRAWN: Final = ("pattern", "cycle_s", "step_height_mm", "height_mm", "sway_mm", "start")
WALKS_RATIO: Final = 0.5
"""Chosen: a gait that gets to half of its way walks."""


SIZE_KEYS: Final = ("lengths_mm", "hip_mm", "stance_mm")
SIZES: Final = re.compile(rf"\b({'|'.join(SIZE_KEYS)}): *(\[[^]]*\]|[\d.]+)")
NUMBER: Final = re.compile(r"-?[\d.]+")
SIZE_RATIOS: Final = (0.7, 1.4)
SLOPE_RATIOS: Final = (0.2, 1.6)
STEEP_DEG: Final = 50.0
RUBBER: Final = 8.0
"""A friction with which no foot slides on the steepest slope; with 2 some slide and trip."""


def main(first: int, count: int, way: str = "walk") -> int:
    """Print a line for each gait, then how often the prediction was right."""
    if way == "stand":
        return _stand(first, count)
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


def _stand(first: int, count: int) -> int:
    """Print a line for each standing robot: claimed margin, and whether it stays upright."""
    counts = {(claimed, true): 0 for claimed in (True, False) for true in (True, False)}
    for seed in range(first, first + count):
        drawn = random.Random(seed)  # noqa: S311
        example = drawn.choice(list(ROBOTS))
        _, heights = ROBOTS[example]
        head, size = _sized(example, drawn)
        height_mm = round(size * drawn.uniform(*heights), 1)
        text = f"{head}\nstart: standing\nheight_mm: {height_mm}\ndo:\n"
        planned = _planned(f"{text}  - stand: {{in_s: 0.5, hold_s: 1.5}}\n")
        if planned is None:
            continue
        gait, robot, passages, trajectory = planned
        slope_deg = min(passages[0].slope_max_deg * drawn.uniform(*SLOPE_RATIOS), STEEP_DEG)
        uphill_deg = drawn.uniform(-180.0, 180.0)
        stance = passages[0].passage.at(np.zeros(1))
        by_mm = stance.shift_mm[0, 2] * math.tan(math.radians(slope_deg))
        uphill = math.radians(uphill_deg)
        down = -by_mm * np.array([math.cos(uphill), math.sin(uphill), 0.0])
        margin_mm = float(replace(stance, places=stance.places + down).margin_mm()[0])
        world = PhysicsWorld(
            friction=RUBBER,
            body_kg=round(drawn.uniform(0.3, 1.2), 2),
            slope_deg=slope_deg,
            uphill_deg=uphill_deg,
        )
        verdict = judged_walk(gait, robot, passages, trajectory, world)
        counts[margin_mm > 0.0, verdict.is_upright] += 1
        mark = " " if verdict.is_upright is (margin_mm > 0.0) else "!"
        print(
            f"{mark} {seed:4} {example:22} height {height_mm:5.1f} mm, slope {slope_deg:4.1f} deg "
            f"to {uphill_deg:4.0f}: margin {margin_mm:6.1f} mm, upright {verdict.is_upright}"
        )
    upright, falls = counts[True, True], counts[False, False]
    print(f"claimed to stand: {upright} stand, {counts[True, False]} fall")
    print(f"claimed to fall: {counts[False, True]} stand, {falls} fall")
    return 0


def _sized(example: str, drawn: random.Random) -> tuple[str, float]:
    """Return a gait without actions, each size times a ratio of its kind; and that of the legs."""
    ratios = {key: round(drawn.uniform(*SIZE_RATIOS), 3) for key in SIZE_KEYS}

    def sized(found: re.Match[str]) -> str:
        key, numbers = found.groups()
        return f"{key}: " + NUMBER.sub(lambda one: f"{ratios[key] * float(one[0]):.6g}", numbers)

    head = (EXAMPLES / example).read_text("utf-8").partition("do:\n")[0]
    lines = [line for line in head.splitlines() if line.partition(":")[0] not in DRAWN]
    text = "\n".join(lines).replace("robots/", f"{EXAMPLES}/robots/")
    return SIZES.sub(sized, text), ratios["lengths_mm"]


def _walked(drawn: random.Random) -> tuple[str, float, WalkVerdict] | None:
    example = drawn.choice(list(ROBOTS))
    patterns, heights = ROBOTS[example]
    head, size = _sized(example, drawn)
    keys = {
        "pattern": drawn.choice(patterns),
        "cycle_s": round(drawn.uniform(0.8, 3.0), 2),
        "step_height_mm": round(drawn.uniform(6.0, 30.0), 1),
        "height_mm": round(size * drawn.uniform(*heights), 1),
    }
    world = PhysicsWorld(
        friction=round(drawn.uniform(0.4, 1.0), 2), body_kg=round(drawn.uniform(0.3, 1.2), 2)
    )
    stride_mm = round(drawn.uniform(15.0, 45.0))
    lines = [head, *(f"{key}: {value}" for key, value in keys.items())]
    lines += ["do:", f"  - walk: {{stride_mm: {stride_mm}, cycles: 4}}", ""]
    planned = _planned("\n".join(lines))
    if planned is None:
        return None
    gait, robot, passages, trajectory = planned
    verdict = judged_walk(gait, robot, passages, trajectory, world)
    name = f"{keys['pattern']} {keys['cycle_s']} s, {stride_mm} mm, friction {world.friction}"
    return name, passages[0].tip_ratio, verdict


def _planned(text: str) -> tuple[Gait, Robot, tuple[Paced, ...], Trajectory] | None:
    """Return the gait of a text, planned; None: it would fall, or leave a range."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gait.yaml"
        path.write_text(text, "utf-8")
        try:
            gait, robot = shows.load_gait(path, None, load_robot)
            passages = paced(gait, robot)
            return gait, robot, passages, plan(sequence_from(gait, passages), robot)
        except LssMotionError:
            return None


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:3]), *sys.argv[3:4]))
