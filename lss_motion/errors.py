"""Every exception of the package. Exit codes are those of `lss-play`.

    LssMotionError                     exit
     ├── InputError(ValueError)          2   change your files or arguments
     ├── PlanningError                   3   legal input, but no plan
     │    └── LineLoadError              3   the bus cannot carry the plan
     ├── ProtocolError(ValueError)       2   a command that cannot be expressed on the wire
     ├── BusError(OSError)               4   the port or the servos cannot be reached
     │    └── LostPortError              4   a port that was open is gone
     │         └── BlockedPortError      4   it is there, but no byte leaves it
     └── PlaybackError                   5   the robot did not follow

The errors from `BusError` on come from the port or the robot, those before it from files and
arguments.
"""

# ruff: noqa: TC003 - public: `help` looks up the annotations.
from __future__ import annotations

import sys
from collections.abc import Sequence
from os import PathLike
from typing import ClassVar, Final

EXIT_FINISHED = 0
EXIT_INPUT = 2
EXIT_NO_PLAN = 3
EXIT_UNREACHABLE = 4
EXIT_NOT_FOLLOWED = 5
EXIT_INTERRUPTED = 130
EXIT_OF_SIGNAL = 128
"""Plus the number of the signal, as in a shell: 129 hangup, 130 interrupt, 143 terminate."""


def install_command(*extras: str) -> str:
    """Return the command that adds extras of the package to the environment that runs this."""
    from pathlib import Path  # pathlib takes longer to import than this module.

    names, environment = ",".join(extras), Path(sys.prefix)
    run = environment.parent / "tools" / "run"  # It makes the environment of a clone.
    if (environment / "home").is_file() and run.is_file():
        shown = run.relative_to(Path.cwd()) if run.is_relative_to(Path.cwd()) else run
        return f"{shown} --with {names}"
    if (environment / "pipx_metadata.json").is_file():
        return f"pipx install --force 'lss-motion[{names}]'"
    return f"pip install 'lss-motion[{names}]'"


class LssMotionError(Exception):
    """Base of every exception that this package raises."""

    exit_code: ClassVar[int] = EXIT_INPUT


class InputError(LssMotionError, ValueError):
    """Your files or arguments must change. `path` and `line` say where, when it is a file.

    `more` holds further problems of the same file, so that one run shows all of them.
    """

    def __init__(
        self,
        reason: str,
        *,
        path: PathLike[str] | str | None = None,
        line: int | None = None,
        more: Sequence[InputError] = (),
    ) -> None:
        self.reason = reason
        self.path = path
        self.line = line
        self.more = tuple(more)
        super().__init__(str(self))

    def __str__(self) -> str:
        place = "" if self.path is None else f"{self.path}:"
        if place and self.line is not None:
            place += f"{self.line}:"
        own = f"{place} {self.reason}".lstrip()
        return "\n".join([own, *map(str, self.more)])


class PlanningError(LssMotionError):
    """The input is legal, but no motion of this robot fulfils it."""

    exit_code = EXIT_NO_PLAN

    def __init__(
        self, reason: str, *, joint: str | None = None, time_s: float | None = None
    ) -> None:
        super().__init__(reason)
        self.reason = reason
        self.joint = joint
        self.time_s = time_s


class LineLoadError(PlanningError):
    """The serial line cannot carry the commands. The message names the remedies."""

    def __init__(self, reason: str, *, bus: str, utilisation_ratio: float) -> None:
        super().__init__(reason)
        self.bus = bus
        self.utilisation_ratio = utilisation_ratio


class ProtocolError(LssMotionError, ValueError):
    """A command that has no form on the wire: value out of range or not representable."""


class BusError(LssMotionError, OSError):
    """The port failed, or no servo answered."""

    exit_code = EXIT_UNREACHABLE

    def __init__(self, reason: str, *, url: str | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.url = url


class LostPortError(BusError):
    """A port that was open is gone: no byte reaches the servos on it."""


class BlockedPortError(LostPortError):
    """A port that is still there, but takes no bytes, or none leaves it."""


class StoppedError(LssMotionError):
    """A person stopped the motion, by a key or a signal; what it was for has no result."""

    exit_code = EXIT_INTERRUPTED

    def __init__(self, text: str, exit_code: int = EXIT_INTERRUPTED) -> None:
        super().__init__(text)
        self.ended_code = exit_code


class PlaybackError(LssMotionError):
    """The robot did not follow: stalled, in safe mode, silent, or out of tolerance."""

    exit_code = EXIT_NOT_FOLLOWED

    def __init__(self, reason: str, *, joint: str | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.joint = joint


PYTHON_NAMES: Final = {
    "--clip": "is_clipped=True",
    "--force": "is_forced=True",
    "--from": "format_name",
    "--motion": "motion_name",
    "--no-feedback": "has_feedback=False",
    "--port": "port",
    "--rate-hz": "rate_hz",
    "--robot": "robot",
    "--sim": "sim",
    "--tolerance-deg": "tolerance_deg",
    "--unwrap": "is_unwrapped=True",
    "--virtual": "is_virtual=True",
}
"""What the functions for users call the options that messages name."""


def in_python_words(error: LssMotionError) -> LssMotionError:
    """Let the message of an error name arguments of Python, not options; return the error.

    Options of a command that the message shows stay as they are.
    """
    import re  # It takes longer to import than this module.

    def named(text: str) -> str:
        parts = re.split(r"(`[^`]*`|lss-[^;,.]*)", text)
        parts[::2] = [
            re.sub(r"(?<![\w-])--[a-z-]+", lambda at: PYTHON_NAMES.get(at[0], at[0]), part)
            for part in parts[::2]
        ]
        return "".join(parts)

    if isinstance(error, InputError | PlanningError | BusError | PlaybackError):
        error.reason = named(error.reason)
    error.args = tuple(named(arg) if isinstance(arg, str) else arg for arg in error.args)
    for other in error.more if isinstance(error, InputError) else ():
        in_python_words(other)
    return error
