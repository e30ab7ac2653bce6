#!/usr/bin/env python3
"""Import, plan, compile and play every motion in a folder of other tools' files; print a table.

    tools/run tools/motion_table.py FOLDER

Each is played in virtual time, without feedback, on a generous simulated robot with the joints of
the motion. What
slides goes through a map with a spindle of 0.4 m a turn. Exit code 1 when a motion neither plays
nor is refused in words.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.errors import LssMotionError
from lss_motion.interchange import (
    ForeignMotion,
    LabelTrack,
    Unit,
    imported,
    load_map,
    map_template,
    read_motions,
)
from lss_motion.perform import perform
from lss_motion.program.compile import compile_program
from lss_motion.robot.load import load_robot
from lss_motion.trajectory.planner import plan

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.interchange import RefusedMotion
    from lss_motion.robot.model import Robot

HEAD = "| file | motion | joints | keys | authored s | planned s | verdict |"


def main(folder: Path) -> int:
    """Print a row for every motion; return the exit code."""
    print(HEAD)
    print("|---" * 7 + "|")
    is_good = True
    for path in sorted(folder.iterdir()):
        if path.suffix in {".md", ""} or path.name.startswith("LICENSE"):
            continue
        for cells in rows(path):
            is_good = is_good and "not played" not in cells[-1]
            print(f"| {' | '.join(cells)} |", flush=True)
    return 0 if is_good else 1


def rows(path: Path) -> Iterator[list[str]]:
    """Yield the cells of every motion in a file."""
    try:
        motions = read_motions(path)
    except LssMotionError as error:
        yield [path.name, "", "", "", "", "", f"refused: {error}"]
        return
    for motion in motions:
        with tempfile.TemporaryDirectory() as folder:
            yield [path.name, motion.name, *verdict(motion, Path(folder))]


def verdict(motion: ForeignMotion | LabelTrack | RefusedMotion, folder: Path) -> list[str]:
    """Return joints, keys, authored and planned seconds, and what came of the motion."""
    if isinstance(motion, LabelTrack):
        return ["", str(len(motion.spans)), "", "", "labels: poses of a robot make them motion"]
    if not isinstance(motion, ForeignMotion):
        return ["", "", "", "", f"refused: {motion.error.reason}"]
    joints = str(len(motion.channels))
    try:
        robot = robot_for(motion, folder)
        made = imported(motion, robot, motion_map=load_map(map_for(motion, robot, folder)))
        trajectory = plan(made.sequence, robot)
        program = compile_program(trajectory, robot)
    except LssMotionError as error:
        return [joints, "", "", "", f"refused: {error}".replace("\n", "; ")]
    end_s = max((k.at_s or 0.0) + k.hold_s for k in made.sequence.keyframes)
    keys = str(sum(len(keyframe.deg) for keyframe in made.sequence.keyframes))
    run = perform(program, robot, is_virtual=True, trajectory=trajectory, has_feedback=False)
    report = run.report
    worst_deg = max((j.horn_error_rms_deg for j in report.joints.values()), default=0.0)
    is_played = report.outcome == "finished" and report.timing.missed == 0
    slowed = f", {len(trajectory.stretched)} spans slowed" if trajectory.stretched else ""
    said = f"played, horns {worst_deg:.2f} deg RMS{slowed}" if is_played else "not played"
    return [joints, keys, f"{end_s:.3f}", f"{trajectory.duration_s:.3f}", said]


def robot_for(motion: ForeignMotion, folder: Path) -> Robot:
    """Return a robot with the joints of the motion and generous limits."""
    joints = [f"  {channel.name}: {{id: {n}}}" for n, channel in enumerate(motion.channels, 1)]
    path = folder / "robot.yaml"
    path.write_text(
        "robot: generous\nbuses: {main: {port: 'sim://', baud_bps: 921600}}\n"
        "defaults: {model: LSS-HS1, range_deg: [-360, 360], speed_max_deg_s: 360,\n"
        "           accel_max_deg_s2: 1000, turns: powered}\njoints:\n" + "\n".join([*joints, ""]),
        encoding="utf-8",
    )
    return load_robot(path)


def map_for(motion: ForeignMotion, robot: Robot, folder: Path) -> Path:
    """Return the template of a map, with a spindle behind what slides."""
    text = map_template(motion, robot)
    for channel in motion.channels:
        if channel.unit is Unit.RAD_OR_M:
            name = f'name: "{channel.name}"'
            text = text.replace(name, f"{name}, unit: m, scale: 900")
    path = folder / "map.yaml"
    path.write_text(text, encoding="utf-8")
    return path


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
