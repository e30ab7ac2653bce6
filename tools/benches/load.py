"""What it costs to know the torques of a long show, and which links touch in it.

Ten minutes, 18 joints in six legs of three, as a hexapod on a stand has them. Processor time.
"""

from __future__ import annotations

from msgspec.structs import replace

from benches.shows import lively_show, robot_of
from benches.table import Row, core_seconds
from lss_motion.planning.summaries import limit_uses
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.torques import plan_load
from lss_motion.planning.trajectory.touches import touches
from lss_motion.robot.figure import Figure, FigureLink, capsule

SHOW_S = 600.0
LEGS, PARTS = 6, 3
SEED = 1
TARGET_S = 3.0
"""Chosen: little beside planning and compiling that show."""


def _figure(names: list[str]) -> Figure:
    size = (0.0, 0.0, 80.0)
    links = [FigureLink(name="stand", shapes=(capsule((0, 0, -100), (0, 0, 0), 90.0, None),))]
    for leg in range(LEGS):
        for part in range(PARTS):
            links.append(
                FigureLink(
                    name=f"leg {leg} part {part}",
                    parent=len(links) - 1 if part else 0,
                    joint=names[PARTS * leg + part],
                    axis=(1.0, 0.0, 0.0) if part else (0.0, 0.0, 1.0),
                    origin_mm=size if part else (150.0 * (leg % 2), 80.0 * leg, 0.0),
                    shapes=(capsule((0.0, 0.0, 0.0), size, 25.0, None),),
                    mass_kg=0.08,
                    com_mm=(0.0, 0.0, 40.0),
                )
            )
    return Figure(source="figure", links=tuple(links))


def measure() -> list[Row]:
    """Measure torques, touches and, to compare them with, the largest speeds."""
    robot = robot_of(LEGS * PARTS)
    robot = replace(robot, figure=_figure([*robot.joints]))
    trajectory = plan(lively_show(robot, SHOW_S, seed=SEED), robot)
    limits_s = core_seconds(lambda: limit_uses(trajectory, robot))
    rows = []
    for what, do in (("torque, current, heat", plan_load), ("links that touch", touches)):
        taken_s = core_seconds(lambda do=do: do(trajectory, robot))  # type: ignore[misc]
        rows.append(
            Row(
                what=f"{what}, {SHOW_S / 60:g} min of {LEGS * PARTS} joints",
                ours=f"{taken_s:.2f} s",
                reference=f"{limits_s:.2f} s for the largest speeds",
                ratio=taken_s,
                target=f"<= {TARGET_S:g}",
                is_met=taken_s <= TARGET_S,
            )
        )
    return rows
