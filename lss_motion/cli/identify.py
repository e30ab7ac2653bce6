"""The command `identify`: measure the response of servos, write it into the robot file."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import (
    SIMULATED_NOTE,
    add_command,
    deviation_of,
    require_joint,
    robot_at,
)
from lss_motion.cli.messages import StepLine, agrees, ended_by, say
from lss_motion.cli.options import add_options, number_from
from lss_motion.errors import (
    EXIT_FINISHED,
    EXIT_INTERRUPTED,
    EXIT_NOT_FOLLOWED,
    InputError,
    PlaybackError,
)
from lss_motion.files.output import Output, OutputKind, require_outputs

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.terminal import Terminal
    from lss_motion.maintenance.identify.estimate import Identified
    from lss_motion.maintenance.identify.joint_run import Experiment
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.log import Log
    from lss_motion.robot.model import Joint, Robot


DESCRIPTION: Final = """\
Measure the response of servos with small moves, one joint after the other.

  lss-motion identify --robot my_robot.yaml elbow        ask, move, measure, write
  lss-motion identify --robot my_robot.yaml elbow wrist --span-deg 30 --yes
  lss-motion identify --robot my_robot.yaml elbow -o measured.yaml
  lss-motion identify --robot my_robot.yaml --from show.log        from a show that was played
  lss-motion identify --robot my_robot.yaml elbow --port sim:// --virtual --no-write \
      --sim t_law=exact,droop=3deg               practise it on a servo that is not as assumed

It measures the delay of replies, the dead time and the lag of the horn, the period at which the
servo applies commands, the start of a new command in mid-move, the meaning of T, ramps and top
speed, the droop under load, and the backlash of the gears. The joint must be free. It moves for
half a minute within --span-deg of its present angle, never outside its range_deg and never faster
than its limits. Ctrl-C brakes and holds; a second one stops at once.

The result is written as the joint's `response` into the robot file, with its uncertainty in a
comment above it; nothing else in the file changes. Differences from the assumptions of a show are
listed.

With --from nothing is moved: the model is fitted to what the servos were sent and what they read in
a show (lss-play --log), of all joints or of those that are named. A show measures delay and ramps
less exactly, and the control loop not at all; what is not certain enough is not written, and joints
that did not move enough are named.

Exit codes: 0 measured; 2 a file or an argument is wrong; 4 port or servo not reachable; 5 the joint
did not move as it should; 130 interrupted.
"""


BEGIN: Final = "Keep its range clear; nothing may touch it. Ctrl-C stops. Begin?"


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    added = add_command(commands, "identify", _identify, DESCRIPTION)
    added.add_argument("joints", nargs="*", metavar="JOINT", help="joints that are free to move")
    add_options(added, "--robot", required=True, help="the robot file")
    added.add_argument(
        "--from",
        type=Path,
        dest="log",
        metavar="LOG",
        help="measure by the log of a show (lss-play --log); nothing moves",
    )
    add_options(added, "--port")
    added.add_argument(
        "--span-deg",
        type=number_from(-1e6, 1e6),
        metavar="DEG",
        help="largest motion to either side (default 20)",
    )
    add_options(added, "--yes", help="move without the question")
    add_options(added, "--output", help="write a copy, not the robot file")
    add_options(added, "--force")
    added.add_argument("--no-write", action="store_true", help="print the result, write nothing")
    add_options(added, "--virtual", "--seed", "--sim")


def _identify(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.terminal import Terminal
    from lss_motion.maintenance.api import measurable
    from lss_motion.maintenance.identify.trials import SPAN_DEG
    from lss_motion.playing.connection import ask_limits, connect, is_simulated
    from lss_motion.system.clock import MonotonicClock, VirtualClock

    if arguments.log is not None:
        return _from_log(arguments)
    if not arguments.joints:
        raise InputError("name the joints to measure; all joints of a show's log: --from LOG")
    span_deg = SPAN_DEG if arguments.span_deg is None else arguments.span_deg
    robot = ask_limits(robot_at(arguments.robot, arguments.port))
    joints = [measurable(robot, name) for name in dict.fromkeys(arguments.joints)]
    simulated = is_simulated(robot)
    _check(arguments, simulated=simulated)
    deviation = deviation_of(arguments, robot.servo_robot)
    if simulated:
        say(SIMULATED_NOTE)
    buses = {name: robot.buses[name] for name in {joint.bus for joint in joints}}
    clock = VirtualClock() if arguments.virtual else MonotonicClock()
    options: dict[str, Any] = {"robot": robot, "clock": clock, "seed": arguments.seed}
    with connect(buses, **options, deviation=deviation) as connection:
        _announce(connection, robot, joints, span_deg)
        if not (simulated or arguments.yes or agrees(BEGIN)):
            say("nothing was moved")
            return EXIT_INTERRUPTED
        with Terminal() as terminal:
            path = arguments.robot
            for joint in joints:
                experiment = _measured(connection, robot, joint, span_deg, terminal)
                if experiment.is_stopped:
                    say(f"{joint.name}: stopped; nothing was measured", sys.stderr)
                    return ended_by(terminal.signal_number)
                path = _conclude(arguments, path, joint, experiment)
    return EXIT_FINISHED


def _from_log(arguments: argparse.Namespace) -> int:
    """Measure by the log of a show, joint by joint; nothing moves."""
    from lss_motion.maintenance.api import recordings_of
    from lss_motion.maintenance.identify.show_fit import identify_from_show
    from lss_motion.playing.log import read_log

    robot = robot_at(arguments.robot, None)
    _check_from_log(arguments)
    log = read_log(arguments.log)
    _require_its_log(log, robot)
    found = recordings_of(log, robot)
    path, is_measured = arguments.robot, False
    for name in dict.fromkeys(arguments.joints or robot.joints):
        require_joint(robot, name)
        if name not in found:
            say(f"  joint {name!r} is not in this log")
            continue
        try:
            result = identify_from_show(found[name])
        except PlaybackError as error:
            say(f"  {error}: {robot.identify_command(name)}")
            continue
        how = f"from {arguments.log.name}, "
        command = robot.identify_command(name)
        path = _write(arguments, path, robot.joints[name], result, how, command)
        is_measured = True
    return EXIT_FINISHED if is_measured else EXIT_NOT_FOLLOWED


def _require_its_log(log: Log, robot: Robot) -> None:
    """Refuse the log of a show whose robot file has other servos than `robot`.

    Where that file, or the show, cannot be read any more, nothing is known.
    """
    from lss_motion.playing.replay import logged_robot

    try:
        logged = logged_robot(log, partial(robot_at, port=None))
    except InputError:
        return
    servos, others = (
        {(name, one.bus, one.servo_id, one.model.name) for name, one in which.joints.items()}
        for which in (robot, logged)
    )
    if servos != others:
        raise InputError(
            f"was played with the robot file {logged.path}, which has other servos than "
            f"{robot.path}; add --robot {logged.path}",
            path=log.path,
        )


def _check_from_log(arguments: argparse.Namespace) -> None:
    for option, is_given in (
        ("--port", arguments.port is not None),
        ("--span-deg", arguments.span_deg is not None),
        ("--virtual", arguments.virtual),
        ("--sim", arguments.sim is not None),
        ("--yes", arguments.yes),
    ):
        if is_given:
            raise InputError(f"{option} is for moves; with --from nothing moves")
    sources, output = [arguments.robot, arguments.log], Output(arguments.output, OutputKind.YAML)
    require_outputs([output], sources=sources, is_forced=arguments.force)


def _check(arguments: argparse.Namespace, *, simulated: bool) -> None:
    """Refuse arguments whose fault would otherwise appear only after the moves."""
    if arguments.virtual and not simulated:
        raise InputError("--virtual needs the simulated bus: use it with --port sim://")
    if not (simulated or arguments.yes or sys.stdin.isatty()):
        raise InputError(
            "the joint would move, and there is no terminal to agree on; add --yes to move it"
        )
    output = arguments.output
    sources = [arguments.robot]
    require_outputs([Output(output, OutputKind.YAML)], sources=sources, is_forced=arguments.force)


def _announce(
    connection: Connection, robot: Robot, joints: Sequence[Joint], span_deg: float
) -> None:
    """Query every servo, refuse joints that cannot be measured, and print the coming moves."""
    from lss_motion.maintenance.identify.trials import (
        estimated_duration_s,
        make_trials,
        make_window,
    )
    from lss_motion.playing.player import handshake

    answers, warnings = connection.examined(joints, robot.servo_robot)
    for text in warnings:
        say(f"warning: {text}", sys.stderr)
    for joint in joints:
        standing_deg = handshake.reported(joint, answers, "QD")
        assert standing_deg is not None, "`examined` raises without it"
        window = make_window(joint, standing_deg, span_deg)
        low, high = sorted((joint.joint_deg(window.low_deg), joint.joint_deg(window.high_deg)))
        lasts_s = estimated_duration_s(make_trials(joint, window, standing_deg))
        say(
            f"{joint.name} (servo {joint.servo_id}) stands at {joint.joint_deg(standing_deg):z.1f} "
            f"deg and will move between {low:.1f} and {high:.1f} deg for about {lasts_s:.0f} s, at "
            f"most at {joint.speed_max_deg_s:g} deg/s"
        )


def _measured(
    connection: Connection, robot: Robot, joint: Joint, span_deg: float, terminal: Terminal
) -> Experiment:
    """Run the trials of one joint; raise the error that ended them."""
    from lss_motion.maintenance.api import make_experiment
    from lss_motion.playing.runner import run

    experiment = make_experiment(connection, robot, joint, span_deg)
    step = StepLine()
    run(
        experiment,
        connection.ports,
        connection.clock,
        on_turn=lambda driven, _: step.show(
            f"{joint.name}: {int(100.0 * driven.progress_ratio)} %"
        ),
        controls=terminal,
    )
    step.show("")
    if experiment.error is not None and not experiment.is_stopped:
        raise experiment.error
    return experiment


def _conclude(
    arguments: argparse.Namespace, path: Path, joint: Joint, experiment: Experiment
) -> Path:
    """Print the result, and write it into the robot file at `path`; return where it stands now."""
    from lss_motion.maintenance.identify.estimate import identify

    return _write(arguments, path, joint, identify(joint, experiment.recording))


def _write(
    arguments: argparse.Namespace,
    path: Path,
    joint: Joint,
    found: Identified,
    how: str = "",
    experiment: str = "",
) -> Path:
    """Print a result and how it differs from the robot file; write it into the one at `path`.

    `how` it was measured, and what command would tell what is left open. Returns the file that
    has what was written so far.
    """
    from lss_motion.maintenance.identify import estimate
    from lss_motion.robot.write import write_response

    for line in estimate.summary_lines(found):
        say(line)
    differences = estimate.difference_lines(found, joint)
    say(
        f"{joint.name} differs from the assumptions of the robot file:"
        if differences
        else f"{joint.name} matches the assumptions of the robot file"
    )
    for line in differences:
        say(f"  - {line}")
    if experiment and (left_open := estimate.left_open(found)):
        say(f"  - {', '.join(left_open)}: an experiment tells more: {experiment}")
    if arguments.no_write:
        return path
    values = estimate.response_values(found, joint)
    if not values:
        say(f"{joint.name}: nothing is known well enough to be written")
        return path
    comments = estimate.comment_lines(found, how + datetime.now(tz=UTC).date().isoformat())
    output: Path = arguments.output or path
    write_response(path, joint.name, values, comments, output=output)
    say(f"{joint.name}: written to {output}")
    return output
