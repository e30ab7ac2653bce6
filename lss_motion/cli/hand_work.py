"""`lss-motion jog | calibrate`: joints moved by keys and by hand, into the robot file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, add_robot
from lss_motion.cli.messages import ended_by
from lss_motion.cli.robots import robot_at
from lss_motion.errors import EXIT_FINISHED, InputError

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.hands import HandsControls
    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.robot.model import Robot

JOG_TEXT: Final = """\
Move joints by keys, within their ranges, at the robot's approach_speed_deg_s at most.

Keys: up and down choose a joint; left and right move it by a step; [ and ] make the step smaller
and larger; l lets the joint go limp (hold it: it falls), h holds it; c writes where all joints are
into the robot file as a pose; q ends. All else in the robot file stays as you wrote it.
"""

CALIBRATE_TEXT: Final = """\
Find out by hand where the zero of each joint is, and which way it turns.

The joints go limp: hold the robot. Bring it to its zero pose (or to the pose --at), then push each
joint towards its larger angles when asked. What comes of it is shown and, when you agree, written
as zero_deg and direction into the robot file; all else in it stays as you wrote it. With
--to-servos the origin offset of each servo is set and stored as well, so that the servo itself
says 0 at the zero pose.
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    jog = add_command(commands, "jog", _jog, "move joints by keys; keep poses", JOG_TEXT)
    calibrate = add_command(
        commands,
        "calibrate",
        _calibrate,
        "find zero and direction of each joint by hand",
        CALIBRATE_TEXT,
    )
    for command in (jog, calibrate):
        add_robot(command, is_required=True)
        command.add_argument("--port", metavar="URL", help="serial device or URL")
        command.add_argument(
            "--joints", nargs="+", metavar="NAME", help="joints or groups; default: all"
        )
        command.add_argument(
            "--hand", metavar="FILE|SEED", help="simulated bus only: who leads limp joints"
        )
    jog.add_argument("--pose", default="pose", metavar="NAME", help="name of the poses kept by c")
    calibrate.add_argument("--at", metavar="POSE", help="a pose of the robot file in place of 0")
    calibrate.add_argument(
        "--to-servos", action="store_true", help="set and store the origin of the servos, too"
    )


def _jog(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.jog_controls import JogControls
    from lss_motion.maintenance.hands_on import HandsOn

    robot, joints = _loaded(arguments)
    if not _is_name(arguments.pose):
        raise InputError(f"--pose {arguments.pose!r}: letters, digits, - and _ make a name")
    return _run(arguments, HandsOn(robot, joints), JogControls(robot, arguments.pose))


def _calibrate(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.calibrate_controls import CalibrateControls
    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.spelling import known_names

    robot, joints = _loaded(arguments)
    if arguments.at is not None and arguments.at not in robot.poses:
        known = known_names(arguments.at, robot.poses)
        raise InputError(f"unknown pose {arguments.at!r}; {known}", path=robot.path)
    pose = robot.poses.get(arguments.at, {})
    hands_on = HandsOn(robot, joints, also_ask=("QO", "QG") if arguments.to_servos else ())
    return _run(
        arguments, hands_on, CalibrateControls(robot, pose, is_to_servos=arguments.to_servos)
    )


def _is_name(name: str) -> bool:
    return name.replace("_", "").replace("-", "").isalnum() and name.isascii()


def _loaded(arguments: argparse.Namespace) -> tuple[Robot, list[str]]:
    from lss_motion.cli.hands import chosen_joints
    from lss_motion.connection import ask_limits, is_simulated

    robot = ask_limits(robot_at(arguments.robot, arguments.port))
    if arguments.hand is not None and not is_simulated(robot):
        raise InputError("--hand needs the simulated bus: use it with --port sim://")
    return robot, chosen_joints(robot, arguments.joints)


def _run(arguments: argparse.Namespace, hands_on: HandsOn, controls: HandsControls) -> int:
    from lss_motion.cli.hands import perform
    from lss_motion.sim.hand import hand_of

    hand = None if arguments.hand is None else hand_of(arguments.hand, hands_on.robot)
    with controls:
        if not controls.has_keys:
            raise InputError("needs a terminal: it is steered by keys")
        perform(hands_on, controls, hand=hand)
    if hands_on.error is not None:
        raise hands_on.error
    if controls.error is not None:
        raise controls.error
    if controls.signal_number is not None:
        return ended_by(controls.signal_number)
    return EXIT_FINISHED
