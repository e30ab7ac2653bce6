"""The robot that a command is about: from its file, at its port, with limits that servos know."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from lss_motion.robot.model import Robot

CACHE_HELP: Final = (
    "limits that the robot file leaves to its servos, from `lss-motion configure ROBOT --backup "
    "FILE`, in place of asking them"
)


def add_cache_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot-cache", type=Path, metavar="FILE", help=CACHE_HELP)


def robot_at(path: Path, port: str | None) -> Robot:
    """Return the robot of a file, at another port if one is given."""
    from lss_motion.connection import with_port
    from lss_motion.robot.load import load_robot

    return with_port(load_robot(path), port)


def reader(arguments: argparse.Namespace, *, may_ask: bool) -> Callable[[Path], Robot]:
    """Return what reads robot files for a command, and their missing limits.

    Those are in --robot-cache, or the servos are asked, if they may be; else they stay missing,
    and no plan is made.
    """

    def read(path: Path) -> Robot:
        from lss_motion.robot.load import load_robot

        return complete(load_robot(path), arguments, may_ask=may_ask)

    return read


def complete(robot: Robot, arguments: argparse.Namespace, *, may_ask: bool = True) -> Robot:
    """Return the robot with the limits that its file leaves to the servos."""
    if not robot.unread:
        return robot
    if arguments.robot_cache is not None:
        from lss_motion.maintenance.backup import read_backup
        from lss_motion.maintenance.limits import from_backup

        return from_backup(robot, read_backup(arguments.robot_cache), arguments.robot_cache)
    if not may_ask:
        return robot
    from lss_motion.connection import ask_limits

    return ask_limits(robot, port=arguments.port)
