"""Declares commands, and the arguments that several commands share.

How a command of `lss-motion` is declared.

The robot that a command is about: from its file, at its port, with limits that servos know.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from lss_motion import __version__
from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.robot.model import Robot

    Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # noqa: SLF001
    """What `add_subparsers` returns; argparse has no public name for it."""


class CommandParser(argparse.ArgumentParser):
    """The parser of one command: it refuses an unknown option with its own usage.

    argparse leaves that to the parser of the program, which shows the list of commands.
    """

    def parse_known_args(  # type: ignore[override]  # as argparse calls it for a command
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Return the arguments; end with the usage of this command if one is unknown."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unknown arguments: {' '.join(unknown)}")
        return found, unknown


def add_command(
    commands: Commands,
    name: str,
    handler: Callable[[argparse.Namespace], int],
    text: str,
    description: str | None = None,
) -> argparse.ArgumentParser:
    """Add a command that runs `handler`, which returns the exit code; return its parser."""
    added = commands.add_parser(
        name,
        help=text,
        description=description or text,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    added.set_defaults(handler=handler)
    return added


def add_version(parser: argparse.ArgumentParser) -> None:
    """Add `--version`, which prints the program and its version."""
    parser.add_argument(
        "--version", action="version", version=f"%(prog)s {__version__}", help="print the version"
    )


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add `--force`, for `refuse_overwriting`."""
    parser.add_argument("--force", action="store_true", help="overwrite a file that is there")


def refuse_overwriting(path: Path | None, *, is_forced: bool) -> None:
    """Raise `InputError` if `path` is there already.

    The rule of all commands: a YAML file (robot, sequence, map, backup) may have been edited, so it
    is overwritten only with `--force`. What a command can make again or has just measured (tables,
    pictures, compiled programs, reports, logs) is replaced. `jog`, `calibrate` and `identify`
    change single values of the robot file that they are given.
    """
    if path is not None and path.exists() and not is_forced:
        raise InputError("is there already; choose another name, or add --force", path=path)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add `--json`, for `print_json`."""
    parser.add_argument("--json", action="store_true", help="print JSON for other programs")


def print_json(value: Any) -> None:  # noqa: ANN401  JSON
    """Print a value as JSON; what is not finite (a show without end) becomes null."""
    sys.stdout.write(json.dumps(_finite(value), indent=2, ensure_ascii=False, default=str) + "\n")


def _finite(value: Any) -> Any:  # noqa: ANN401  JSON
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def add_robot(parser: argparse.ArgumentParser, *, is_required: bool) -> None:
    """Add the robot of a command that is about a robot and no other file: ROBOT or `--robot`.

    The rule of all commands: `--robot FILE` names the robot file. A command whose first file is a
    show has only that; one about the robot itself accepts the file alone as well.
    """
    group = parser.add_mutually_exclusive_group(required=is_required)
    group.add_argument("robot", nargs="?", action=_Robot, metavar="ROBOT", help="a robot file")
    group.add_argument("--robot", action=_Robot, metavar="FILE", help="the same")


class _Robot(argparse.Action):
    """Keeps the robot file that was given; an argument that was left out changes nothing."""

    def __call__(
        self,
        _parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        _option: str | None = None,
    ) -> None:
        if values is not None:
            setattr(namespace, self.dest, Path(str(values)))


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
        from lss_motion.maintenance.limits import robot_from_backup

        return robot_from_backup(robot, read_backup(arguments.robot_cache), arguments.robot_cache)
    if not may_ask:
        return robot
    from lss_motion.connection import ask_limits

    return ask_limits(robot, port=arguments.port)
