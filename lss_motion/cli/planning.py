"""The commands that need no servo: `check`, `plan`, `compile`, `schema` and `gait`."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import add_command, prepared, print_json, reader
from lss_motion.cli.messages import StepLine, say
from lss_motion.cli.options import add_options, number_from
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.source import RECORDING_MAX_BYTES, read_text

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from lss_motion.cli.commands import Commands
    from lss_motion.planning.shows import Show
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.robustness import RobustnessTrial
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.pacing import Paced
    from lss_motion.stage.check import Planned

    FloatArray = NDArray[np.float64]

CHECK_TEXT: Final = """\
Check a file: read it, plan and compile it, and print what was slowed down and why, the use of each
limit and the load of the bus; of a robot with masses also the torque of its servos, current and
heat. Nothing is written and no servo is contacted. Of slow spans and late keyframes the worst ten
are listed after the totals; `--all` and `--json` list all.

`--robust` then plays up to 60 s of the show on 26 simulated robots that are worse than assumed
(lag, dead time, ramps, motors, load, play, losses, a push), each with feedback and `on_fault`. It
prints how far their horns were from the plan and which of them would stop the show. The exit code
does not depend on that. `lss-play --virtual --sim` with the words of a line repeats it.

  lss-motion check wave.yaml
  lss-motion check wave.yaml --robust
  lss-motion check wave.yaml --all
  lss-motion check robots/desk_arm.yaml --json
  lss-motion check stages/haunted_hall.yaml
"""

PLAN_TEXT: Final = """\
Plan a sequence and print the use of each limit; also as a table or a picture.

  lss-motion plan wave.yaml --plot wave.png
  lss-motion plan wave.yaml --csv wave.csv --rate-hz 50
"""

COMPILE_TEXT: Final = """\
Compile a sequence to a program (.lss): the commands that lss-play sends, with their times. A
program starts without planning.

  lss-motion compile wave.yaml -o wave.lss
"""


WORLD_OPTIONS: Final = (
    ("--friction", 5.0, "", "friction of feet on the ground (default 0.8, rubber on wood)"),
    ("--body-kg", 1000.0, "kg", "body, battery and computer, without servos of legs (default 0.6)"),
    ("--slope-deg", 45.0, "degrees", "how far the ground rises ahead (default 0)"),
    ("--strength", 10.0, "", "torque of the servos against their data sheet (default 1)"),
)
"""Fields of `gait_physics.PhysicsWorld` as options: largest value, unit, help."""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    _add_check(commands)
    planned = add_command(commands, "plan", _plan, PLAN_TEXT)
    planned.add_argument("file", type=Path, metavar="FILE", help="a sequence or a gait")
    add_options(planned, "--robot", "--robot-cache", "--all")
    planned.add_argument(
        "--csv", type=Path, metavar="F", help="write this table: t_s,<joint>,... in degrees"
    )
    planned.add_argument(
        "--rate-hz",
        type=number_from(0.1, 10_000.0, "Hz"),
        default=100.0,
        metavar="N",
        help="rows of the table per second (default 100)",
    )
    add_options(planned, "--plot")
    planned.add_argument(
        "--truth",
        type=Path,
        metavar="F",
        help="also draw the true horn angles, from the file of lss-play --truth",
    )
    add_options(planned, "--force")
    compiled = add_command(commands, "compile", _compile, COMPILE_TEXT)
    compiled.add_argument("file", type=Path, metavar="FILE", help="a sequence or a gait")
    add_options(compiled, "--follow", "--robot", "--robot-cache")
    add_options(compiled, "--output", metavar="F.lss", help="the program to write (default: print)")
    add_options(compiled, "--all", "--force")
    schema = add_command(commands, "schema", _schema)
    schema.add_argument(
        "kind",
        nargs="?",
        choices=(
            "robot",
            "sequence",
            "gait",
            "learnt",
            "stage",
            "remote",
            "log",
            "check",
            "report",
        ),
        help="only the schema of this kind of file, of the messages that steer a running show, a "
        "line of a log, check --json, or a report (default: all)",
    )
    gait = add_command(commands, "gait", _gait)
    gait.add_argument("file", type=Path, metavar="FILE", help="a gait file")
    add_options(gait, "--robot", "--robot-cache")
    add_options(gait, "--output", metavar="S.yaml", help="write the keyframes as a sequence")
    add_options(gait, "--force", "--plot", "--json")
    _add_physics(gait)


def _add_physics(gait: argparse.ArgumentParser) -> None:
    """Add what is assumed of robot and ground."""
    group = gait.add_argument_group("physics (extra `physics`)")
    group.add_argument(
        "--physics",
        action="store_true",
        help="let the robot walk in MuJoCo: whether it stays upright, how far it gets, how far its "
        "feet slip, and how hard its servos work",
    )
    for option, most, unit, text in WORLD_OPTIONS:
        group.add_argument(
            option,
            type=number_from(-most if option == "--slope-deg" else 0.0, most, unit),
            metavar="N",
            help=text,
        )


def _add_check(commands: Commands) -> None:
    check = add_command(commands, "check", _check, CHECK_TEXT)
    check.add_argument(
        "file", type=Path, metavar="FILE", help="a sequence, a gait, a program, a robot or a stage"
    )
    add_options(check, "--robot", "--robot-cache", "--follow", "--all")
    check.add_argument(
        "--robust",
        action="store_true",
        help="also play the show on simulated robots that are worse than assumed; takes minutes "
        "for a long show with many joints",
    )
    add_options(check, "--json")


def _files(arguments: argparse.Namespace) -> tuple[Path, Path | None, Callable[[Path], Robot]]:
    """Return the file, the robot file or None, and the function that reads robot files."""
    return arguments.file, arguments.robot, reader(arguments, may_query=False)


def _inputs(arguments: argparse.Namespace) -> list[Path | None]:
    """Return the files that the arguments name as input."""
    truth = getattr(arguments, "truth", None)
    return [arguments.file, arguments.robot, arguments.robot_cache, truth]


def _check(arguments: argparse.Namespace) -> int:
    from lss_motion.planning import shows
    from lss_motion.planning.summaries import advice_lines, program_lines, robot_lines
    from lss_motion.show.gait import is_gait_file
    from lss_motion.show.gait.kinematics import figure_of
    from lss_motion.stage import is_stage_file

    if shows.is_robot_file(arguments.file):
        if arguments.robust:
            raise InputError(
                "is a robot; --robust plays a show, so give a sequence, a gait or a program",
                path=arguments.file,
            )
        robot = reader(arguments, may_query=False)(arguments.file)
        robot.require_turns(robot.servo_robot.joints.values())
        if arguments.json:
            from lss_motion.planning.check_json import robot_as_json

            print_json(robot_as_json(robot))
        else:
            say("\n".join(robot_lines(robot)))
        return EXIT_FINISHED
    if is_stage_file(arguments.file):
        return _check_stage(arguments)
    lines = []
    if shows.is_program(arguments.file) or not is_gait_file(arguments.file):
        show = prepared(arguments, may_query=False, is_following=arguments.follow)
    else:
        from lss_motion.show.gait.load import sequence_from
        from lss_motion.show.gait.pacing import gait_lines, paced

        gait, robot = shows.load_gait(*_files(arguments))
        passages = paced(gait, robot)
        sequence = sequence_from(gait, passages)
        show = shows.compiled(sequence, robot, is_following=arguments.follow)
        lines = gait_lines(gait, passages)
    figure_of(show.robot)  # Raises where its URDF file is wrong, as for the robot alone.
    if not arguments.json:
        lines += program_lines(show, is_whole=arguments.all)
        say("\n".join([*lines, *advice_lines(show, is_whole=arguments.all)]))
        if arguments.robust:
            from lss_motion.playing.robustness import robust_lines

            say("\n".join(["", *robust_lines(_trials(show), show.program.duration_s)]))
        return EXIT_FINISHED
    from lss_motion.planning.check_json import show_as_json

    found = show_as_json(show)
    if arguments.robust:
        from lss_motion.playing.robustness import robust_as_json

        found["robust"] = robust_as_json(_trials(show), show.program.duration_s)
    print_json(found)
    return EXIT_FINISHED


def _check_stage(arguments: argparse.Namespace) -> int:
    """Plan every show of a stage, with figures those of each; print what does not go together."""
    from lss_motion.stage.check import plan_stage, stage_as_json, stage_lines
    from lss_motion.stage.load import load_stage

    for option in ("robust", "robot"):
        if getattr(arguments, option):
            raise InputError(f"--{option} is for a show; this is a stage", path=arguments.file)
    stage = load_stage(arguments.file)
    read = reader(arguments, may_query=False)
    planned: Mapping[str | None, Planned]
    if stage.figures:
        from lss_motion.stage.hosts.plans import planned_figures

        robots = {name: read(one.robot_path) for name, one in stage.figures.items()}
        planned = {name or "all figures": one for name, one in planned_figures(stage, robots)}
    else:
        planned = {None: plan_stage(stage, read)}
    if arguments.json:
        found = {figure: stage_as_json(one) for figure, one in planned.items()}
        print_json(found if stage.figures else found[None])
        return EXIT_FINISHED
    for figure, one in planned.items():
        heading = [] if figure is None else [figure]
        say("\n".join([*heading, *stage_lines(one)]))
    return EXIT_FINISHED


def _trials(show: Show) -> list[RobustnessTrial]:
    """Return all trials of `--robust`; on a terminal, show how many of them are done."""
    from lss_motion.playing.robustness import WORSE, trials

    found: list[RobustnessTrial] = []
    step = StepLine()
    try:
        for trial in trials(show, WORSE):
            found.append(trial)
            step.show(f"simulated robots: {len(found)} of {1 + len(WORSE)}")
    finally:
        step.show("")
    return found


def _plan(arguments: argparse.Namespace) -> int:
    from lss_motion.planning import shows
    from lss_motion.planning.summaries import plan_lines

    outputs = [Output(arguments.csv, OutputKind.TABLE), Output(arguments.plot, OutputKind.PICTURE)]
    given = _inputs(arguments)
    require_outputs(outputs, sources=given, is_forced=arguments.force)
    sequence, robot = shows.load(*_files(arguments))
    sources = [*given, *shows.files_of(sequence)]
    require_outputs(outputs, sources=sources, is_forced=arguments.force)
    trajectory = shows.planned(sequence, robot)
    if arguments.csv is not None:
        shows.require_rows(trajectory, arguments.rate_hz)
        write_output(arguments.csv, plan_table(trajectory, arguments.rate_hz))
    if arguments.plot is not None:
        from lss_motion.planning.trajectory.plot import plot

        horn = None if arguments.truth is None else read_table(arguments.truth, trajectory.joints)
        plot(trajectory, robot, arguments.plot, horn=horn, beats_s=sequence.beats_s)
    say("\n".join(plan_lines(trajectory, robot, is_whole=arguments.all)))
    return EXIT_FINISHED


def _compile(arguments: argparse.Namespace) -> int:
    from lss_motion.planning import shows
    from lss_motion.planning.program.text import to_text
    from lss_motion.planning.summaries import program_lines

    if arguments.output is not None:
        shows.require_program_suffix(arguments.output)
    outputs = [Output(arguments.output, OutputKind.PROGRAM)]
    require_outputs(outputs, sources=_inputs(arguments), is_forced=arguments.force)
    show = prepared(arguments, may_query=False, is_following=arguments.follow)
    if arguments.output is None:
        say(to_text(show.program, folder=Path.cwd()), end="")
        return EXIT_FINISHED
    text = to_text(show.program, folder=arguments.output.absolute().parent)
    write_output(arguments.output, text)
    say("\n".join(program_lines(show, is_whole=arguments.all)))
    return EXIT_FINISHED


def _schema(arguments: argparse.Namespace) -> int:
    from lss_motion.planning.check_json import check_schema
    from lss_motion.playing.log import log_schema
    from lss_motion.playing.remote.schema import schema as remote_schema
    from lss_motion.playing.report import report_schema
    from lss_motion.robot.learnt import learnt_schema
    from lss_motion.robot.load import robot_schema
    from lss_motion.show.gait.load import gait_schema
    from lss_motion.show.load import sequence_schema
    from lss_motion.stage.load import stage_schema

    schemas = {
        "robot": robot_schema,
        "sequence": sequence_schema,
        "gait": gait_schema,
        "learnt": learnt_schema,
        "stage": stage_schema,
        "remote": remote_schema,
        "log": log_schema,
        "check": check_schema,
        "report": report_schema,
    }
    if arguments.kind is not None:
        shown = schemas[arguments.kind]()
    else:
        shown = {kind: make() for kind, make in schemas.items()}
    print_json(shown)
    return EXIT_FINISHED


def _gait(arguments: argparse.Namespace) -> int:
    from lss_motion.planning import shows
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.gait.load import sequence_from
    from lss_motion.show.gait.pacing import gait_as_json, gait_lines, paced
    from lss_motion.show.write import write_sequence

    outputs = [
        Output(arguments.output, OutputKind.YAML),
        Output(arguments.plot, OutputKind.PICTURE),
    ]
    require_outputs(outputs, sources=_inputs(arguments), is_forced=arguments.force)
    gait, robot = shows.load_gait(
        arguments.file, arguments.robot, reader(arguments, may_query=False)
    )
    require_outputs(outputs, sources=[robot.path], is_forced=arguments.force)
    passages = paced(gait, robot)
    sequence = sequence_from(gait, passages)
    # The verifier of the planner must accept it before anything is written.
    trajectory = plan(sequence, robot)
    if arguments.output is not None:
        write_sequence(sequence, arguments.output, comments=[f"The keyframes of {arguments.file}."])
    if arguments.plot is not None:
        from lss_motion.planning.picture import plot_gait

        plot_gait(gait, passages, arguments.plot)
    verdict = _judged(arguments, gait, robot, passages, trajectory)
    if arguments.json:
        print_json(gait_as_json(gait, passages) | ({} if verdict is None else {"physics": verdict}))
    else:
        say("\n".join(gait_lines(gait, passages)))
        if verdict is not None:
            say("\n".join(verdict["lines"]))
    return EXIT_FINISHED


def _judged(
    arguments: argparse.Namespace,
    gait: Gait,
    robot: Robot,
    passages: tuple[Paced, ...],
    trajectory: Trajectory,
) -> dict[str, Any] | None:
    """Return what physics say of a gait as JSON, with `lines` for people; None: not asked."""
    names = {option[2:].replace("-", "_"): option for option, *_ in WORLD_OPTIONS}
    given = {name: value for name in names if (value := getattr(arguments, name)) is not None}
    if not arguments.physics:
        if given:
            raise InputError(f"{names[next(iter(given))]} is for --physics")
        return None
    import msgspec

    from lss_motion.planning.gait_physics import PhysicsWorld, judged_walk, verdict_lines

    world = PhysicsWorld(**given)
    verdict = judged_walk(gait, robot, passages, trajectory, world)
    found: dict[str, Any] = msgspec.to_builtins(verdict)
    return found | {"assumed": msgspec.to_builtins(world), "lines": verdict_lines(verdict, world)}


def plan_table(trajectory: Trajectory, rate_hz: float) -> str:
    """Return the plan as CSV, one row every `1 / rate_hz` and one at the end.

    An endless show gives its first pass and one more.
    """
    import numpy as np

    from lss_motion.planning.shows import shown_s

    end_s = shown_s(trajectory)
    times_s = np.arange(int(end_s * rate_hz + 1e-9) + 1) / rate_hz
    if end_s - times_s[-1] > 1e-9:
        times_s = np.append(times_s, end_s)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["t_s", *trajectory.joints])
    for time_s, angles_deg in zip(times_s, trajectory.sample(times_s), strict=True):
        writer.writerow([f"{time_s:.6g}", *(f"{angle:.4f}" for angle in angles_deg)])
    return out.getvalue()


def read_table(path: Path, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Return times and (n, joints) angles of the named joints from a table at `path`."""
    import numpy as np

    text = read_text(path, RECORDING_MAX_BYTES)
    try:
        rows = list(csv.reader(io.StringIO(text, newline="")))
        columns = [rows[0].index(name) for name in ("t_s", *joints)]
        table = np.array([[float(row[column]) for column in columns] for row in rows[1:]])
    except (ValueError, IndexError, csv.Error) as error:
        raise InputError(
            f"is not a table with the columns t_s,{','.join(joints)} in numbers", path=path
        ) from error
    return table[:, 0], table[:, 1:]
