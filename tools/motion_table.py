#!/usr/bin/env python3
"""Import, plan, compile and play every motion in a folder of other tools' files; print a table.

    tools/run tools/motion_table.py FOLDER            a row for each motion
    tools/run tools/motion_table.py FOLDER --write    a summary by file into tools/FIGURES.md

Each is played in virtual time, with feedback and without it, on a generous simulated robot with the
joints of the motion, both from the same phase of its control loops (`benches.in_phase`). What
slides goes through a map with a spindle of 0.4 m a turn. The largest horn error of each run stands
beside the bound that the compiler predicts. Exit code 1 when a motion neither plays nor is refused
in words, when a horn without feedback is beyond the bound, or when feedback makes the RMS of the
horns more than `HARM_RATIO` times as large.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benches.in_phase import bound_ratios, horn_rms_deg, with_and_without_feedback
from lss_motion.errors import LssMotionError
from lss_motion.interchange.importing import imported, read_motions
from lss_motion.interchange.mapping import load_map, map_template
from lss_motion.interchange.reader import ForeignMotion, LabelTrack, Measure
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.load import load_robot

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.interchange.reader import RefusedMotion
    from lss_motion.robot.model import Robot

HEAD = (
    "| file | motion | joints | keys | authored s | planned s | by its moves deg | bound deg "
    "| simulated deg | with feedback deg | RMS with / without | verdict |"
)
FIGURES = Path(__file__).with_name("FIGURES.md")
HARM_RATIO = 1.02
MARKS = "<!-- motions -->\n", "<!-- end of motions -->\n"
SUMMARY = (
    "| motions of | played | predicted by the moves | predicted bound | simulated | with feedback "
    "| nearest to its bound | RMS with / without feedback |\n|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What came of one motion; angles are the largest of all joints."""

    text: str
    joints: str = ""
    keys: str = ""
    authored: str = ""
    planned: str = ""
    moves_deg: float = math.nan
    bound_deg: float = math.nan
    simulated_deg: float = math.nan
    fed_back_deg: float = math.nan
    bound_ratio: float = math.nan
    """The largest simulated error of a joint over its own bound."""
    feedback_ratio: float = math.nan
    """RMS of all horns with feedback over that without."""

    @property
    def is_bad(self) -> bool:
        is_beyond = self.bound_ratio > 1.0 or self.feedback_ratio > HARM_RATIO
        return "not played" in self.text or is_beyond

    def cells(self) -> list[str]:
        angles = (self.moves_deg, self.bound_deg, self.simulated_deg, self.fed_back_deg)
        numbers = (*angles, self.feedback_ratio)
        shown = ["" if math.isnan(number) else f"{number:.2f}" for number in numbers]
        over = " (BEYOND THE BOUND)" if self.bound_ratio > 1.0 else ""
        over += " (HARM)" if self.feedback_ratio > HARM_RATIO else ""
        counts = [self.joints, self.keys, self.authored, self.planned]
        return [*counts, *shown, self.text + over]


def main(words: list[str]) -> int:
    """Print a row for every motion; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="files of other tools")
    parser.add_argument("--write", action="store_true", help="write a summary into FIGURES.md")
    arguments = parser.parse_args(words)
    if not arguments.folder.is_dir():
        parser.error(f"{arguments.folder} is no folder")
    print(HEAD)
    print("|---" * (HEAD.count("|") - 1) + "|")
    is_good, lines = True, []
    for path in sorted(arguments.folder.iterdir()):
        if path.suffix in {".md", ""} or path.name.startswith("LICENSE"):
            continue
        verdicts = []
        for name, verdict in rows(path):
            verdicts.append(verdict)
            is_good = is_good and not verdict.is_bad
            print(f"| {' | '.join([path.name, name, *verdict.cells()])} |", flush=True)
        lines.append(_summary(path.name, verdicts))
    if arguments.write:
        before, _, rest = FIGURES.read_text(encoding="utf-8").partition(MARKS[0])
        table = "\n".join([SUMMARY, *filter(None, lines)])
        after = rest.partition(MARKS[1])[2]
        FIGURES.write_text(f"{before}{MARKS[0]}{table}\n{MARKS[1]}{after}", encoding="utf-8")
    return 0 if is_good else 1


def _summary(file: str, verdicts: list[Verdict]) -> str:
    """Return the row of a file: the range of its motions; empty if none was played."""
    played = [one for one in verdicts if not math.isnan(one.simulated_deg)]
    if not played:
        return ""

    def span(name: str) -> str:
        values = sorted(getattr(one, name) for one in played)
        ends = dict.fromkeys((f"{values[0]:.2f}", f"{values[-1]:.2f}"))
        return " to ".join(ends) + " deg"

    names = ("moves_deg", "bound_deg", "simulated_deg", "fed_back_deg")
    ratio = max(one.bound_ratio for one in played)
    harm = max(one.feedback_ratio for one in played)
    return (
        f"| `{file}` | {len(played)} of {len(verdicts)} | {' | '.join(map(span, names))} "
        f"| {ratio:.2f} | at most {harm:.3f} |"
    )


def rows(path: Path) -> Iterator[tuple[str, Verdict]]:
    """Yield name and verdict of every motion in a file."""
    try:
        motions = read_motions(path)
    except LssMotionError as error:
        yield "", Verdict(text=f"refused: {error}")
        return
    for motion in motions:
        with tempfile.TemporaryDirectory() as folder:
            yield motion.name, verdict_of(motion, Path(folder))


def verdict_of(motion: ForeignMotion | LabelTrack | RefusedMotion, folder: Path) -> Verdict:
    """Return what came of a motion."""
    if isinstance(motion, LabelTrack):
        text = "labels: poses of a robot make them motion"
        return Verdict(keys=str(len(motion.spans)), text=text)
    if not isinstance(motion, ForeignMotion):
        return Verdict(text=f"refused: {motion.error.reason}")
    joints = str(len(motion.channels))
    try:
        robot = robot_for(motion, folder)
        made = imported(motion, robot, motion_map=load_map(map_for(motion, robot, folder)))
        trajectory = plan(made.sequence, robot)
        program = compile_program(trajectory, robot)
    except LssMotionError as error:
        return Verdict(joints=joints, text=f"refused: {error}".replace("\n", "; "))
    end_s = max((k.at_s or 0.0) + k.hold_s for k in made.sequence.keyframes)
    runs = with_and_without_feedback(program, robot, trajectory)
    fed_back, plain = (run.report for run in runs)
    fed_back_deg, plain_deg = (horn_rms_deg(run, trajectory) for run in runs)
    is_played = plain.outcome == "finished" and plain.timing.missed == 0
    slowed = f", {len(trajectory.stretched)} spans slowed" if trajectory.stretched else ""
    return Verdict(
        joints=joints,
        keys=str(sum(len(keyframe.deg) for keyframe in made.sequence.keyframes)),
        authored=f"{end_s:.3f}",
        planned=f"{trajectory.duration_s:.3f}",
        moves_deg=max(program.error_max_deg.values()),
        bound_deg=max(program.bound_deg.values()),
        simulated_deg=max(one.horn_error_max_deg or 0.0 for one in plain.joints.values()),
        fed_back_deg=max(one.horn_error_max_deg or 0.0 for one in fed_back.joints.values()),
        bound_ratio=max(bound_ratios(program, runs[1]).values()),
        feedback_ratio=fed_back_deg / plain_deg if plain_deg else 1.0,
        text=f"played{slowed}" if is_played else "not played",
    )


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
        if channel.unit is Measure.RAD_OR_M:
            name = f'name: "{channel.name}"'
            text = text.replace(name, f"{name}, unit: m, scale: 900")
    path = folder / "map.yaml"
    path.write_text(text, encoding="utf-8")
    return path


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
