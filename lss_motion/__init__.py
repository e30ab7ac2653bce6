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

from importlib import import_module
from typing import TYPE_CHECKING

from lss_motion.errors import (
    BusError,
    InputError,
    LineLoadError,
    LssMotionError,
    PlanningError,
    PlaybackError,
    ProtocolError,
)

if TYPE_CHECKING:
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.api import compile, load_robot, load_sequence, plan, play  # noqa: A004
    from lss_motion.playing.live import Live, connect
    from lss_motion.playing.remote.handle import Handle, start
    from lss_motion.playing.remote.player_end import LossRule
    from lss_motion.playing.report import Report
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
    "Trajectory",
    "compile",
    "connect",
    "load_robot",
    "load_sequence",
    "plan",
    "play",
    "start",
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
    "Trajectory": "lss_motion.planning.trajectory.model",
    "compile": "lss_motion.playing.api",
    "connect": "lss_motion.playing.live",
    "load_robot": "lss_motion.playing.api",
    "load_sequence": "lss_motion.playing.api",
    "plan": "lss_motion.playing.api",
    "play": "lss_motion.playing.api",
    "start": "lss_motion.playing.remote.handle",
}


def __getattr__(name: str) -> object:
    """Import what is asked for, so that importing the package costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module 'lss_motion' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return all public names, those that are imported on first use included."""
    return sorted({*globals(), *__all__})
