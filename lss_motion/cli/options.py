"""The options that several commands have, each declared once."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.files.texts import comma_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.sound.files import Channel

_FILE: Final = {"type": Path, "metavar": "FILE"}
_FLAG: Final = {"action": "store_true"}

OPTIONS: Final[Mapping[str, Mapping[str, Any]]] = {
    # What is played, and where.
    "--robot": {**_FILE, "help": "use this robot file"},
    "--robot-cache": {
        **_FILE,
        "help": "read limits that the robot file does not give from this backup, not from the "
        "servos; `lss-motion configure ROBOT --backup FILE` writes one",
    },
    "--port": {
        "metavar": "URL",
        "help": "serial device or URL, such as /dev/ttyUSB0; sim:// simulates the servos",
    },
    "--baud": {
        "type": int,
        "metavar": "BPS",
        "help": "baud rate without a robot file (default 115200)",
    },
    "--real-time": {
        **_FLAG,
        "help": "request real-time priority and locked memory, to be on time beside other programs",
    },
    "--no-feedback": {**_FLAG, "help": "send no queries, correct nothing"},
    "--follow": {
        **_FLAG,
        "help": "with the headroom of a show that follows timecode (lss-play --follow)",
    },
    # What is simulated.
    "--virtual": {**_FLAG, "help": "simulate in virtual time: fast, and the same on every run"},
    "--seed": {
        "type": int,
        "default": 0,
        "metavar": "N",
        "help": "seed of the simulated bus (default 0)",
    },
    "--faults": {
        **_FILE,
        "help": "simulated bus only: faults to simulate; `lss-motion sim --help` describes the "
        "file",
    },
    "--sim": {
        "metavar": "K=V,...|FILE",
        "help": "simulated bus only: servos that differ from what is assumed, such as "
        "lag=+30ms,droop=3deg; or a file; `lss-motion sim --help` lists the keys",
    },
    "--hand": {
        "metavar": "FILE|SEED",
        "help": "simulated bus only: a simulated hand moves the limp joints, from a CSV file "
        "t_s,<joint>,... or a seed",
    },
    # What needs the consent of a person.
    "--yes": {
        **_FLAG,
        "help": "move a real robot without the question; it is checked all the same",
    },
    "--careful": {
        **_FLAG,
        "help": "first move one joint at a time, slowly and a little, and compare direction, speed "
        "and lag with what is expected; then play at half speed, which + raises",
    },
    "--allow-run": {**_FLAG, "help": "call the Python functions of the show without the question"},
    "--on-operator-lost": {
        "choices": ("stop", "hold", "go_on"),
        "default": "go_on",
    },
    "--tls-certificate": {"type": Path, "metavar": "F.pem"},
    "--tls-key": {"type": Path, "metavar": "F.pem", "help": "the key of the certificate"},
    # What is written and printed.
    "--output": {**_FILE},
    "--report": {**_FILE, "help": "write the report to this JSON file"},
    "--plot": {
        "type": Path,
        "metavar": "F.png",
        "help": "draw it into this picture; the suffix sets the format",
    },
    "--force": {**_FLAG, "help": "overwrite an existing file"},
    "--all": {
        **_FLAG,
        "help": "list all slow spans and late keyframes, not only the worst ten",
    },
    "--json": {**_FLAG, "help": "print JSON for other programs"},
    "--verbose": {**_FLAG, "help": "print all numbers, not only what a person wants to know"},
    "--quiet": {**_FLAG, "help": "print errors only, no display"},
}
"""What `add_argument` gets, by option."""

SHORT: Final = {"--output": "-o"}

UNLIMITED_HELP: Final = (
    "with --no-feedback: play although servos store higher limits than their joints have, so that "
    "one which restarts would move too fast and nothing would notice it"
)
"""What `--force` does where a show is played."""


def add_options(
    parser: argparse._ActionsContainer,  # a parser, or a group of one
    *names: str,
    **changes: Any,  # noqa: ANN401  (what add_argument takes)
) -> None:
    """Add options of `OPTIONS` in this order; `changes` replace what stands there."""
    for name in names:
        flags = [SHORT[name], name] if name in SHORT else [name]
        parser.add_argument(*flags, **{**OPTIONS[name], **changes})


def add_robot(parser: argparse.ArgumentParser, *, is_required: bool) -> None:
    """Add the robot file as ROBOT or `--robot`, for a command that has no other file."""
    group = parser.add_mutually_exclusive_group(required=is_required)
    group.add_argument(
        "robot", nargs="?", action=_RobotAction, metavar="ROBOT", help="the robot file"
    )
    group.add_argument("--robot", action=_RobotAction, metavar="FILE", help="the robot file")


class _RobotAction(argparse.Action):
    """Stores the given robot file. An omitted argument leaves the value of the other one."""

    def __call__(
        self,
        _parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        _option: str | None = None,
    ) -> None:
        if values is not None:
            setattr(namespace, self.dest, Path(str(values)))


def number_from(
    low: float, high: float, unit: str = "", *, is_above: bool = False
) -> Callable[[str], float]:
    """Return the type of an argument: a number from `low` to `high`, or above `low`."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or (is_above and value == low):
            bounds = f"{'above' if is_above else 'from'} {low:g} to {high:,.12g} {unit}".rstrip()
            raise argparse.ArgumentTypeError(f"{text!r} is not a number {bounds}{comma_text(text)}")
        return value

    return number


CHANNELS_MAX: Final = 1024
"""The most that a sound file can have (libsndfile)."""


def channel_of(text: str) -> Channel:
    """Return the channel of a sound that an argument names."""
    if text in ("left", "right", "mix"):
        return text  # type: ignore[return-value]  # mypy does not narrow a str to literals
    if text.isascii() and text.isdigit() and 1 <= int(text) <= CHANNELS_MAX:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not left, right, mix or a number from 1 on")
