"""`lss-motion check`: what a plan and its program come to, for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lss_motion.cli.shows import Show
    from lss_motion.robot.model import Robot
    from lss_motion.trajectory.model import Stretch, Trajectory

TIGHTEST_STEP_S = 0.002


def plan_lines(trajectory: Trajectory, robot: Robot) -> list[str]:
    """Return how long the plan is, what was stretched and why, and how near each limit is."""
    first = trajectory.first
    length = "forever" if trajectory.loop is None else f"{trajectory.duration_s:.3f} s"
    passes = "" if trajectory.loop == 1 else f", one pass {trajectory.middle.duration_s:.3f} s"
    lines = [f"{trajectory.name}: {length}{passes}, {len(trajectory.joints)} joints moved"]
    if not trajectory.stretched:
        lines.append("every keyframe is on time" if _has_times(trajectory) else "no times given")
    lines += [f"slower: {stretch_text(stretch)}" for stretch in trajectory.stretched]
    steps = max(2, int(first.duration_s / TIGHTEST_STEP_S))
    times_s = np.linspace(0.0, first.duration_s, steps)
    speed = np.abs(trajectory.sample(times_s, 1)).max(axis=0)
    accel = np.abs(trajectory.sample(times_s, 2)).max(axis=0)
    width = max(len(name) for name in (*trajectory.joints, "joint"))
    lines.append(f"{'joint':{width}}  fastest deg/s (limit)   hardest deg/s² (limit)")
    for name, fastest, hardest in zip(trajectory.joints, speed, accel, strict=True):
        joint = robot.joints[name]
        lines.append(
            f"{name:{width}}  {fastest:7.1f} ({joint.speed_max_deg_s:g}) "
            f"{fastest / joint.speed_max_deg_s:6.0%}   {hardest:7.1f} "
            f"({joint.accel_max_deg_s2:g}) {hardest / joint.accel_max_deg_s2:6.0%}"
        )
    return lines


def stretch_text(stretch: Stretch) -> str:
    """Return one stretched span in words."""
    unit = "deg/s" if stretch.limit == "speed" else "deg/s²"
    return (
        f"{stretch.from_s:.3f} s to {stretch.to_s:.3f} s takes {stretch.by_s:.3f} s longer: joint "
        f"{stretch.joint!r} would need {stretch.limit} {stretch.authored:.0f} {unit}, allowed "
        f"{stretch.allowed:g} {unit}"
    )


def _has_times(trajectory: Trajectory) -> bool:
    return any(mark.authored_s is not None for mark in trajectory.marks)


def program_lines(show: Show) -> list[str]:
    """Return what the compiled show asks of the lines and how near it comes to the plan."""
    lines = [] if show.trajectory is None else plan_lines(show.trajectory, show.robot)
    program = show.program
    for use in program.line_use.values():
        lines.append(
            f"bus {use.bus}: {use.commands} commands, {use.utilisation_ratio:.1%} of "
            f"{use.baud_bps} bps, {use.worst_100_ms_ratio:.0%} in the worst 100 ms, "
            f"{use.overlaps} overlaps"
        )
    if program.error_max_deg:
        name = max(program.error_max_deg, key=lambda joint: program.error_max_deg[joint])
        lines.append(
            f"predicted horns stay within {program.error_max_deg[name]:.2f} deg of the plan "
            f"({name}; tolerance {program.tolerance_deg:g} deg)"
        )
    return lines
