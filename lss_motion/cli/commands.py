"""What several commands share: declaring a command, checks of arguments, and loading the robot.

Two rules hold for all commands:

- `--robot FILE` names the robot file. A command about the robot itself also accepts it alone.
- `files.output` decides what an output may replace, before any work. A YAML file (robot, sequence,
  map, backup) may have been edited, so it is overwritten only with `--force`. Tables, pictures,
  compiled programs, reports and logs replace a file of the same kind; `lss-play` and `walk` replace
  no other file, the other commands do so with `--force`. A file that a command reads is never an
  output; `jog`, `calibrate` and `identify` change single values of the robot file.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeAlias

from lss_motion import __version__
from lss_motion.cli.messages import say
from lss_motion.errors import InputError
from lss_motion.files.texts import escaped

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from lss_motion.planning.shows import Show
    from lss_motion.robot.model import Robot
    from lss_motion.sim.deviation import Deviation

    Commands: TypeAlias = "argparse._SubParsersAction[SubcommandParser]"  # noqa: SLF001
    """The type that `add_subparsers` returns; argparse has no public name for it."""

TOLERANCE_MAX_DEG: Final = 90.0
"""The largest tolerance of a reduced recording; beyond it no motion is left."""

SIMULATED_NOTE: Final = "The servos are simulated: these values tell nothing about a real robot."

COMMAND_GROUPS: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "make a show": {
        "example": ("examples", "list the examples, or write one here"),
        "check": ("planning", "check a file; print what was slowed and why"),
        "plan": ("planning", "plan a sequence; write it as a table or a picture"),
        "compile": ("planning", "compile a sequence to a program (.lss)"),
        "gait": ("planning", "describe how a gait walks; write keyframes or a picture"),
        "record": ("by_hand", "record a motion shown by hand as a sequence file"),
        "jog": ("by_hand", "move joints with keys; write poses into the robot file"),
        "import": ("exchange", "turn another tool's motion into a sequence file"),
        "export": ("exchange", "write the motion of a sequence for other tools"),
        "publish": ("publish", "write a show as one page for others"),
        "verify": ("publish", "plan the show in such a page again, and compare"),
        "beats": ("beats", "find the beats of music, and put them into a show"),
    },
    "play it": {
        "play": ("play", "the same as lss-play"),
        "walk": ("walk", "walk a gait, steered with keys or a gamepad"),
        "studio": ("serving", "see and run a show in a browser"),
        "sim": ("simulate", "simulate a robot behind a pseudo-terminal"),
        "replay": ("report", "print a log of lss-play, or run it again"),
        "report": ("report", "print a report of lss-play, or compare two"),
    },
    "look after robots": {
        "import-urdf": ("import_urdf", "make a robot file of a URDF or xacro file"),
        "scan": ("scan", "find ports, baud rates and servos"),
        "configure": ("configure", "read, compare and write settings"),
        "calibrate": ("by_hand", "find zero and direction of each joint by hand"),
        "identify": ("identify", "measure the response of servos"),
        "field-test": ("field_test", "judge all assumptions about servos in an hour"),
        "monitor": ("monitor", "show the live state of all servos"),
        "send": ("send", "send one command to one servo; print the reply"),
        "doctor": ("doctor", "check this computer; print what to do"),
        "devices": ("doctor", "list the sound devices"),
    },
    "several shows and computers": {
        "serve": ("serving", "run a stage: shows, cues, its operator's page"),
        "install-service": ("stages", "start a stage with the computer, by systemd"),
        "stage-keys": ("stages", "make keys for the computers of a stage"),
        "morning": ("stages", "sum up a night of a stage from its log"),
    },
    "other": {
        "docs": ("docs", "open the guides"),
        "pack-report": ("pack", "pack what somebody needs to find a fault of a show"),
        "mcp": ("agents", "serve shows to a program that writes them; moves nothing"),
        "schema": ("planning", "print the JSON Schema of our files or messages"),
        "reference": ("manual", "print the commands of the servos"),
        "completion": ("manual", "print the script that completes commands with the Tab key"),
    },
}
"""The commands of `lss-motion` by what a person wants: module of `cli`, line in the list.

Here, so that the list is printed without importing the modules of all commands.
"""
COMMANDS: Final = {name: row for group in COMMAND_GROUPS.values() for name, row in group.items()}


class Parser(argparse.ArgumentParser):
    """A parser whose errors, which hold arguments, cannot steer the terminal."""

    def error(self, message: str) -> NoReturn:
        """End with this message and the usage."""
        super().error(escaped(message))


class ProgramParser(Parser):
    """The parser of `lss-motion`: its help lists the commands by what a person wants."""

    def format_help(self) -> str:
        """Return the help."""
        [found] = (one for one in self._actions if isinstance(one, argparse._SubParsersAction))  # noqa: SLF001
        listed = {action.dest: action for action in found._choices_actions}  # noqa: SLF001
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        for title, commands in COMMAND_GROUPS.items():
            formatter.start_section(title)
            formatter.add_arguments([listed[name] for name in commands if name in listed])
            formatter.end_section()
        formatter.start_section("options")
        formatter.add_arguments([action for action in self._actions if action is not found])
        formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()


class SubcommandParser(Parser):
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
    description: str | None = None,
) -> argparse.ArgumentParser:
    """Add a command that runs `handler`, which returns the exit code; return its parser.

    Without `description` the help of the command begins with its line of `COMMANDS`, as a sentence.
    """
    _, text = COMMANDS[name]
    added = commands.add_parser(
        name,
        help=text,
        description=description or f"{text[0].upper()}{text[1:]}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    added.set_defaults(handler=handler)
    return added


def add_version(parser: argparse.ArgumentParser) -> None:
    """Add `--version`, which prints the program and its version."""
    parser.add_argument(
        "--version", action="version", version=f"%(prog)s {__version__}", help="print the version"
    )


def require_joint(robot: Robot, name: str) -> None:
    """Raise `InputError`, with similar names, if the robot has no joint of this name."""
    if name not in robot.joints:
        from lss_motion.files.texts import known_names

        known = known_names(name, robot.joints)
        raise InputError(f"unknown joint {name!r}; {known}", path=robot.path)


def require_baud(option: str, rate_bps: int | None) -> None:
    """Raise `InputError` if servos do not support the baud rate that `option` gives."""
    from lss_motion.protocol.constants import BAUD_RATES_BPS

    if rate_bps is not None and rate_bps not in BAUD_RATES_BPS:
        allowed = ", ".join(map(str, BAUD_RATES_BPS))
        raise InputError(f"{option} {rate_bps}: servos support {allowed}")


def print_json(value: Any) -> None:  # noqa: ANN401  JSON
    """Print a value as JSON. A number that is not finite (an endless show) becomes null."""
    text = json.dumps(_finite(value), indent=2, ensure_ascii=False, default=str)
    say(escaped(text, as_json=True))


def _finite(value: Any) -> Any:  # noqa: ANN401  JSON
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def robot_at(path: Path, port: str | None) -> Robot:
    """Return the robot of a file, at another port if one is given."""
    from lss_motion.playing.connection import with_port
    from lss_motion.robot.load import load_robot

    return with_port(load_robot(path), port)


def deviation_of(arguments: argparse.Namespace, robot: Robot) -> Deviation | None:
    """Return how `--sim` makes the servos of `robot` differ; raises `InputError` on a real port."""
    from lss_motion.playing.connection import is_simulated

    if arguments.sim is None:
        return None
    if not is_simulated(robot):
        raise InputError("--sim needs the simulated bus: use it with --port sim://")
    from lss_motion.sim.deviation import read_deviation

    return read_deviation(arguments.sim, robot)


def prepared(
    arguments: argparse.Namespace,
    *,
    may_query: bool,
    speed_ratio: float = 1.0,
    loop: int | str | None = None,
    is_following: bool = False,
) -> Show:
    """Return the show in the file of a command: `shows.prepare`, or what was kept of it."""
    from lss_motion.planning import shows
    from lss_motion.planning.show_cache import cached

    names = (arguments.file, arguments.robot, arguments.robot_cache)
    return cached(
        (*map(str, names), speed_ratio, loop, is_following),
        lambda: shows.prepare(
            arguments.file,
            arguments.robot,
            reader(arguments, may_query=may_query),
            speed_ratio=speed_ratio,
            loop=loop,
            is_following=is_following,
        ),
    )


def reader(arguments: argparse.Namespace, *, may_query: bool) -> Callable[[Path], Robot]:
    """Return the function that reads robot files for a command, with limits that a file omits.

    It reads those limits from `--robot-cache`, or queries the servos if `may_query`. Otherwise they
    stay unread, and no plan can be made.
    """

    def read(path: Path) -> Robot:
        from lss_motion.robot.load import load_robot

        robot = load_robot(path)
        if robot.unread and arguments.robot_cache is None and may_query:
            from lss_motion.playing.connection import ask_limits

            return ask_limits(robot, port=arguments.port)
        if robot.unread and arguments.robot_cache is not None:
            from lss_motion.maintenance.settings import with_backup

            return with_backup(robot, arguments.robot_cache)
        return robot

    return read
