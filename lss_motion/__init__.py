"""Plans, compiles and plays multi-servo motion on Lynxmotion smart-servo buses.

A human-written keyframe file becomes motion that a bus of smart servos really performs. Five
steps, each a pure function of the one before, each usable alone:

>>> import lss_motion as lss
>>> robot = lss.load_robot("sequences/robots/desk_arm.yaml")
>>> sequence = lss.load_sequence("sequences/fastest.yaml")
>>> trajectory = lss.plan(sequence, robot)      # within every limit, or PlanningError
>>> trajectory.sample([0.0, 1.0]).shape         # joint angles in degrees, (n, joints)
(2, 5)
>>> program = lss.compile(trajectory, robot)    # bytes at instants, or LineLoadError
>>> program.moves[0].data.startswith(b"#")
True
>>> report = lss.play(program, robot, port="sim://", is_virtual=True)
>>> report.outcome, report.timing.missed
('finished', 0)

`start` plays in a process of its own and returns at once, with a handle that steers the show:

>>> with lss.start(program, robot, port="sim://", is_virtual=True) as show:
...     report = show.wait()                    # or show.pause(), show.rate(0.5), show.stop()
>>> report.outcome
'finished'

Every error is a `LssMotionError`; `lss_motion.errors` draws the tree. Angles are degrees of the
joint, times are seconds, unless a name says otherwise.
"""

from __future__ import annotations

from functools import wraps
from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING

from lss_motion.errors import (
    BusError,
    InputError,
    LineLoadError,
    LssMotionError,
    PlanningError,
    PlaybackError,
    ProtocolError,
    in_python_words,
)

if TYPE_CHECKING:
    from lss_motion.interchange.importing import import_motion
    from lss_motion.maintenance.api import calibrate, identify, identify_log, scan
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.api import (
        check,
        compile,  # noqa: A004
        export,
        gait,
        load_robot,
        load_sequence,
        plan,
        play,
    )
    from lss_motion.playing.live import Live, connect
    from lss_motion.playing.remote.handle import Handle, start, walk
    from lss_motion.playing.remote.player_end import LossRule
    from lss_motion.playing.report import Report
    from lss_motion.playing.targets import TargetRule
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Keyframe, Sequence

__version__ = "0.1.0"

__all__ = [
    "BusError",
    "Handle",
    "InputError",
    "Keyframe",
    "LineLoadError",
    "Live",
    "LossRule",
    "LssMotionError",
    "PlanningError",
    "PlaybackError",
    "Program",
    "ProtocolError",
    "Report",
    "Robot",
    "Sequence",
    "TargetRule",
    "Trajectory",
    "calibrate",
    "check",
    "compile",
    "connect",
    "export",
    "gait",
    "identify",
    "identify_log",
    "import_motion",
    "load_robot",
    "load_sequence",
    "plan",
    "play",
    "scan",
    "start",
    "walk",
]

_HOME = {
    "Handle": "lss_motion.playing.remote.handle",
    "Keyframe": "lss_motion.show.model",
    "Live": "lss_motion.playing.live",
    "LossRule": "lss_motion.playing.remote.player_end",
    "Program": "lss_motion.planning.program.model",
    "Report": "lss_motion.playing.report",
    "Robot": "lss_motion.robot.model",
    "Sequence": "lss_motion.show.model",
    "TargetRule": "lss_motion.playing.targets",
    "Trajectory": "lss_motion.planning.trajectory.model",
    "calibrate": "lss_motion.maintenance.api",
    "check": "lss_motion.playing.api",
    "compile": "lss_motion.playing.api",
    "connect": "lss_motion.playing.live",
    "export": "lss_motion.playing.api",
    "gait": "lss_motion.playing.api",
    "identify": "lss_motion.maintenance.api",
    "identify_log": "lss_motion.maintenance.api",
    "import_motion": "lss_motion.interchange.importing",
    "load_robot": "lss_motion.playing.api",
    "load_sequence": "lss_motion.playing.api",
    "plan": "lss_motion.playing.api",
    "play": "lss_motion.playing.api",
    "scan": "lss_motion.maintenance.api",
    "start": "lss_motion.playing.remote.handle",
    "walk": "lss_motion.playing.remote.handle",
}


def __getattr__(name: str) -> object:
    """Import what is asked for, so that importing the package costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module 'lss_motion' has no attribute {name!r}")
    found = getattr(import_module(_HOME[name]), name)
    if isinstance(found, FunctionType):
        found = _with_python_words(found)
    globals()[name] = found
    return found


_MAKES = {
    "Program": "compile(trajectory, robot) makes one",
    "Robot": "load_robot(path) reads one",
    "Sequence": "load_sequence(path) reads one",
    "Trajectory": "plan(sequence, robot) makes one",
}


def _require_kinds(
    function: FunctionType, args: tuple[object, ...], more: dict[str, object]
) -> None:
    """Raise `InputError` where one value of ours was given in place of another one."""
    from inspect import signature

    for name, value in signature(function).bind(*args, **more).arguments.items():
        kinds = str(function.__annotations__.get(name, "")).split(" | ")
        if not set(kinds) <= {*_MAKES, "None"} or (value is None and "None" in kinds):
            continue
        if not any(one.__name__ in kinds for one in type(value).__mro__):
            wanted, given = kinds[0], type(value).__name__
            raise InputError(
                f"{name}: a {wanted.lower()} is needed here, not a {given}; {_MAKES[wanted]}"
            )


def _with_python_words(function: FunctionType) -> object:
    """Return the function; its errors name arguments of Python where a command has options."""

    @wraps(function)
    def call(*args: object, **kwargs: object) -> object:
        _require_kinds(function, args, kwargs)
        try:
            return function(*args, **kwargs)
        except LssMotionError as error:
            in_python_words(error)
            raise

    return call


def __dir__() -> list[str]:
    """Return all public names, those that are imported on first use included."""
    return sorted({*globals(), *__all__})
