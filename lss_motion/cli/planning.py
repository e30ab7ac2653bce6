"""`lss-motion check | plan | compile | schema`: everything before a robot is involved.

`lss-motion check`: what a plan and its program come to, for people.
"""

from __future__ import annotations

import argparse
import json
import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion.cli.commands import add_cache_option, add_command, add_json, print_json, reader
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.source import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.shows import Show
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.trajectory.model import SlowSpan, Trajectory


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    check = add_command(
        commands, "check", _check, "validate, plan, compile; say what was slowed and why"
    )
    add_json(check)
    plan = add_command(commands, "plan", _plan, "plan a sequence; write it as a table or a picture")
    plan.add_argument("--csv", type=Path, metavar="F", help="write t_s,<joint>... in degrees")
    plan.add_argument("--plot", type=Path, metavar="F.png", help="draw it; the suffix says how")
    plan.add_argument("--rate-hz", type=_rate, default=100.0, metavar="N", help="of the table")
    plan.add_argument(
        "--truth",
        type=Path,
        metavar="F",
        help="draw also the horn angles that lss-play --truth wrote",
    )
    compiled = add_command(commands, "compile", _compile, "compile a sequence to a program (.lss)")
    compiled.add_argument("-o", "--output", type=Path, metavar="F.lss", help="default: print it")
    for added in (check, plan, compiled):
        kinds = "a sequence, a gait, a program or a robot" if added is check else "a sequence"
        added.add_argument("file", type=Path, metavar="FILE", help=kinds)
        added.add_argument("--robot", type=Path, metavar="FILE", help="use this robot file")
        add_cache_option(added)
    schema = add_command(
        commands, "schema", _schema, "print the JSON Schema of a robot, sequence or gait file"
    )
    schema.add_argument(
        "kind", nargs="?", choices=("robot", "sequence", "gait"), help="one of them"
    )


def _files(arguments: argparse.Namespace) -> tuple[Path, Path | None, Callable[[Path], Robot]]:
    """Return the file, that of its robot if one is given, and what reads robot files."""
    return arguments.file, arguments.robot, reader(arguments, may_ask=False)


def _check(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.gait.load import is_gait_file
    from lss_motion.gait.pacing import gait_lines, paced
    from lss_motion.gait.to_sequence import sequence_from

    if is_robot_file(arguments.file):
        robot = reader(arguments, may_ask=False)(arguments.file)
        if arguments.json:
            print_json(robot_as_json(robot))
        else:
            print("\n".join(robot_lines(robot)))
        return EXIT_FINISHED
    lines = []
    if shows.is_program(arguments.file) or not is_gait_file(arguments.file):
        show = shows.prepare(*_files(arguments))
    else:
        gait, robot = shows.load_gait(*_files(arguments))
        passages = paced(gait, robot)
        show = shows.compiled(sequence_from(gait, passages), robot)
        lines = gait_lines(gait, passages)
    if arguments.json:
        print_json(show_as_json(show))
    else:
        print("\n".join([*lines, *program_lines(show)]))
    return EXIT_FINISHED


def _plan(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.cli.tables import plan_table, read_table, write_text

    sequence, robot = shows.load(*_files(arguments))
    trajectory = shows.planned(sequence, robot)
    if arguments.csv is not None:
        write_text(arguments.csv, plan_table(trajectory, arguments.rate_hz))
    if arguments.plot is not None:
        from lss_motion.trajectory.plot import plot

        horn = None if arguments.truth is None else read_table(arguments.truth, trajectory.joints)
        plot(trajectory, robot, arguments.plot, horn=horn)
    print("\n".join(plan_lines(trajectory, robot)))
    return EXIT_FINISHED


def _compile(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.cli.tables import write_text
    from lss_motion.program.text import to_text

    if arguments.output is not None and not shows.is_program(arguments.output):
        raise InputError(
            "must end in .lss, or lss-play takes it for a sequence", path=arguments.output
        )
    show = shows.prepare(*_files(arguments))
    if arguments.output is None:
        print(to_text(show.program, folder=Path.cwd()), end="")
        return EXIT_FINISHED
    write_text(arguments.output, to_text(show.program, folder=arguments.output.absolute().parent))
    print("\n".join(program_lines(show)))
    return EXIT_FINISHED


def _schema(arguments: argparse.Namespace) -> int:
    from lss_motion.gait.load import gait_schema
    from lss_motion.robot.load import robot_schema
    from lss_motion.sequence.load import sequence_schema

    schemas = {"robot": robot_schema, "sequence": sequence_schema, "gait": gait_schema}
    if arguments.kind is not None:
        shown = schemas[arguments.kind]()
    else:
        shown = {kind: make() for kind, make in schemas.items()}
    print(json.dumps(shown, indent=2, ensure_ascii=False))
    return EXIT_FINISHED


def _rate(text: str) -> float:
    value = float(text)
    if not 0.1 <= value <= 10_000.0:
        raise argparse.ArgumentTypeError(f"{text} is not in 0.1 to 10000")
    return value


SAMPLE_S: Final = 0.001
"""What is shown is found by sampling at 1 kHz, as the verifier does."""

BLOCK: Final = 8192
"""Samples at a time, so that a long show needs no more memory than a short one."""

FULL_RATIO: Final = 0.995
"""A limit that is used up to here is used up: planning keeps a thousandth or so of it free."""

_ROBOT_KEYS: Final = re.compile(r"^(buses|joints)\s*:", re.MULTILINE)
"""Keys at the top of a robot file, and of no other."""


@dataclass(frozen=True, slots=True)
class Use:
    """The largest speed and acceleration of a joint, and when."""

    joint: Joint
    speed_deg_s: float
    speed_at_s: float
    accel_deg_s2: float
    accel_at_s: float

    @property
    def speed_ratio(self) -> float:
        return self.speed_deg_s / self.joint.speed_max_deg_s

    @property
    def accel_ratio(self) -> float:
        return self.accel_deg_s2 / self.joint.accel_max_deg_s2

    @property
    def faster_ratio(self) -> float:
        """How many times as fast the joint could go: acceleration grows with the square."""
        return 1.0 / max(self.speed_ratio, math.sqrt(self.accel_ratio), 1e-9)


def plan_lines(trajectory: Trajectory, robot: Robot) -> list[str]:
    """Return how long the plan is, what was stretched and why, and how near each limit is."""
    length = "forever" if trajectory.loop is None else f"{trajectory.duration_s:.3f} s"
    passes = "" if trajectory.loop == 1 else f", one pass {trajectory.middle.duration_s:.3f} s"
    lines = [f"{trajectory.name}: {length}{passes}, {len(trajectory.joints)} joints moved"]
    if not trajectory.stretched:
        lines.append("every keyframe is on time" if _has_times(trajectory) else "no times given")
    lines += [f"slower: {stretch_text(stretch)}" for stretch in trajectory.stretched]
    uses = limit_uses(trajectory, robot)
    width = max(len(name) for name in (*trajectory.joints, "joint"))
    lines.append(f"{'joint':{width}}  fastest deg/s (limit)   hardest deg/s² (limit)")
    for use in uses:
        lines.append(
            f"{use.joint.name:{width}}  {use.speed_deg_s:7.1f} ({use.joint.speed_max_deg_s:g}) "
            f"{use.speed_ratio:6.0%}   {use.accel_deg_s2:7.1f} "
            f"({use.joint.accel_max_deg_s2:g}) {use.accel_ratio:6.0%}"
        )
    return [*lines, *_margin_lines(trajectory, uses)]


def limit_uses(trajectory: Trajectory, robot: Robot) -> list[Use]:
    """Return how far each joint uses its limits, over the first pass and one more."""
    end_s = trajectory.first.duration_s
    if trajectory.loop != 1:
        end_s += trajectory.middle.duration_s
    steps = math.ceil(end_s / SAMPLE_S) + 1
    worst = np.zeros((2, len(trajectory.joints)))
    worst_at_s = np.zeros_like(worst)
    for first in range(0, steps, BLOCK):
        times_s = np.minimum(np.arange(first, min(first + BLOCK, steps)) * SAMPLE_S, end_s)
        for row, order in enumerate((1, 2)):
            sizes = np.abs(trajectory.sample(times_s, order))
            tops = sizes.max(axis=0)
            worst_at_s[row] = np.where(
                tops > worst[row], times_s[sizes.argmax(axis=0)], worst_at_s[row]
            )
            worst[row] = np.maximum(worst[row], tops)
    return [
        Use(robot.joints[name], *(float(value) for value in values))
        for name, *values in zip(
            trajectory.joints, worst[0], worst_at_s[0], worst[1], worst_at_s[1], strict=True
        )
    ]


def _margin_lines(trajectory: Trajectory, uses: Sequence[Use]) -> list[str]:
    """Return which joint is nearest to a limit, and how much faster the show could run."""
    tightest = min(uses, key=lambda use: use.faster_ratio)
    if tightest.speed_ratio >= math.sqrt(tightest.accel_ratio):
        what, unit, at_s = "speed", "deg/s", tightest.speed_at_s
        value, allowed = tightest.speed_deg_s, tightest.joint.speed_max_deg_s
    else:
        what, unit, at_s = "acceleration", "deg/s²", tightest.accel_at_s
        value, allowed = tightest.accel_deg_s2, tightest.joint.accel_max_deg_s2
    if value == 0.0:
        return ["nothing moves"]
    lines = [
        f"tightest: joint {tightest.joint.name!r}, {what} {value:.0f} of {allowed:g} {unit} at "
        f"{at_s:.3f} s, {max(0.0, 1.0 - value / allowed):.0%} to spare"
    ]
    # Rounded down, so that what is said is possible.
    ratio = math.floor(100.0 * tightest.faster_ratio) / 100.0
    if value >= FULL_RATIO * allowed or ratio <= 1.0:
        return [*lines, "the show runs as fast as it can without slowing more of it"]
    pass_s = trajectory.middle.duration_s / ratio
    return [
        *lines,
        f"the show could run {ratio:.2f} times as fast, a pass in {pass_s:.3f} s, before anything "
        f"is slowed (--speed {ratio:.2f})",
    ]


def stretch_text(stretch: SlowSpan) -> str:
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
            f"{use.overlaps} overlaps, none later than {use.late_max_us} us"
        )
        if math.isfinite(use.reading_rate_hz):
            least_hz = show.robot.buses[use.bus].reading_rate_min_hz
            lines.append(
                f"bus {use.bus}: {1.0 - use.utilisation_ratio:.1%} free for questions; in the "
                f"worst second each joint can be read {use.reading_rate_hz:.1f} times "
                f"(at least {least_hz:g})"
            )
    lines += drive_lines(program)
    errors_deg = {n: e for n, e in program.error_max_deg.items() if n not in _stepped(program)}
    if errors_deg:
        name = max(errors_deg, key=lambda joint: errors_deg[joint])
        lines.append(
            f"predicted horns stay within {errors_deg[name]:.2f} deg of the plan "
            f"({name}; tolerance {program.tolerance_deg:g} deg)"
        )
    return lines


def _stepped(program: Program) -> set[str]:
    """Return the joints for which there is no tolerance: whole degrees are what they are."""
    return {name for name, driving in program.drives.items() if driving.drive == "stepped"}


def drive_lines(program: Program) -> list[str]:
    """Return one line for every joint that is not simply timed: how it is commanded, and why."""
    lines = []
    for name in program.start_deg:
        driving = program.drives.get(name)
        if driving is None and name not in program.drive_reasons:
            continue
        how = "timed (D…T… in EM1)"
        if driving is not None and driving.drive == "streamed":
            how = f"streamed (bare D in EM0, FPC {driving.filter_count})"
        elif driving is not None:
            how = "stepped (whole degrees to an RC servo, no feedback)"
        error_deg = program.error_max_deg.get(name)
        within = "" if error_deg is None else f", predicted within {error_deg:.2f} deg"
        why = program.drive_reasons.get(name, "as the robot file says").partition(": ")
        lines.append(f"joint {name}: {how}{within}; {why[2] or why[0]}")
    return lines


def show_as_json(show: Show) -> dict[str, Any]:
    """Return what `check` finds in a show, for other programs; angles in degrees."""
    program, trajectory = show.program, show.trajectory
    uses = [] if trajectory is None else limit_uses(trajectory, show.robot)
    joints: dict[str, dict[str, Any]] = {name: {} for name in program.start_deg}
    for use in uses:
        joints[use.joint.name] |= {
            "speed_deg_s": use.speed_deg_s,
            "speed_max_deg_s": use.joint.speed_max_deg_s,
            "speed_at_s": use.speed_at_s,
            "accel_deg_s2": use.accel_deg_s2,
            "accel_max_deg_s2": use.joint.accel_max_deg_s2,
            "accel_at_s": use.accel_at_s,
        }
    for name, error_deg in program.error_max_deg.items():
        joints[name]["error_max_deg"] = error_deg
    return {
        "kind": "show",
        "name": program.name,
        "robot": program.robot,
        "duration_s": program.duration_s if trajectory is None else trajectory.duration_s,
        "tolerance_deg": program.tolerance_deg,
        "joints": joints,
        "stretched": [asdict(stretch) for stretch in program.stretched],
        "buses": {name: asdict(use) for name, use in program.line_use.items()},
    }


def is_robot_file(path: Path) -> bool:
    """Return whether a file describes a robot; raises `InputError` if it is unreadable."""
    from lss_motion.files.source import read_text

    return path.suffix.lower() in (".yaml", ".yml") and bool(_ROBOT_KEYS.search(read_text(path)))


def robot_lines(robot: Robot) -> list[str]:
    """Return what a robot file describes: its buses, and the limits of each joint."""
    counts = [counted(robot.joints, "joint"), counted(robot.poses, "pose")]
    lines = [f"{robot.name}: {', '.join(counts)}, {counted(robot.buses, 'bus', 'buses')}"]
    lines += [f"bus {b.name}: {b.port} at {b.baud_bps} bps" for b in robot.buses.values()]
    width = max(len(name) for name in (*robot.joints, "joint"))
    lines.append(f"{'joint':{width}}   id  model          range deg        deg/s   deg/s²")
    for joint in robot.joints.values():
        reach = f"{joint.position_min_deg:g} to {joint.position_max_deg:g}"
        speed, accel = (
            "servo" if limit in joint.unread else f"{value:g}"
            for limit, value in (
                ("speed_max_deg_s", joint.speed_max_deg_s),
                ("accel_max_deg_s2", joint.accel_max_deg_s2),
            )
        )
        lines.append(
            f"{joint.name:{width}}  {joint.servo_id:3d}  {joint.model.name:13}  {reach:15}  "
            f"{speed:>5}  {accel:>7}"
        )
    return lines


def robot_as_json(robot: Robot) -> dict[str, Any]:
    """Return what `check` finds in a robot file, for other programs; null where servos decide."""
    return {
        "kind": "robot",
        "name": robot.name,
        "buses": {b.name: {"port": b.port, "baud_bps": b.baud_bps} for b in robot.buses.values()},
        "joints": {
            joint.name: {
                "bus": joint.bus,
                "id": joint.servo_id,
                "model": joint.model.name,
                "range_deg": [joint.position_min_deg, joint.position_max_deg],
                **{
                    limit: None if limit in joint.unread else getattr(joint, limit)
                    for limit in ("speed_max_deg_s", "accel_max_deg_s2")
                },
            }
            for joint in robot.joints.values()
        },
        "poses": list(robot.poses),
    }
