"""The functions for users: load, plan, compile, play. `lss_motion` exports them."""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from lss_motion.planning.program.compile import compile_program as compile  # noqa: A004
from lss_motion.planning.program.model import Program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.connection import ask_limits, is_simulated, with_port
from lss_motion.playing.report import Report
from lss_motion.playing.run import perform
from lss_motion.robot.load import load_robot
from lss_motion.robot.model import Robot
from lss_motion.show import load as sequences
from lss_motion.show.model import Sequence

__all__ = [
    "ask_limits",
    "compile",
    "is_simulated",
    "load_robot",
    "load_sequence",
    "plan",
    "play",
    "with_port",
]


def load_sequence(path: Path | str | Mapping[str, object], robot: Robot | None = None) -> Sequence:
    """Return the sequence of a sequence or gait file, checked against its robot.

    In place of a sequence file, a dict with the same keys and values may be given.

    The robot is `robot`, or else the one that the file names. Raises `InputError` with file, line,
    value and remedy; its `more` holds all further problems, those of other files included.
    """
    from lss_motion.show.gait import gait_as_sequence, is_gait_file

    if isinstance(path, Path | str) and is_gait_file(path):
        from lss_motion.show.gait.load import load_gait, sequence_of

        gait = load_gait(path, robot)
        assert gait.robot_path is not None, "without a robot it would not have been loaded"
        return sequence_of(gait, robot or load_robot(gait.robot_path))
    return sequences.load_sequence(path, robot, read_other=gait_as_sequence)


def play(
    program: Program,
    robot: Robot,
    *,
    port: str | None = None,
    is_virtual: bool = False,
    seed: int = 0,
    has_feedback: bool = True,
    allow_run: bool = False,
    is_forced: bool = False,
) -> Report:
    """Play `program` on `robot` and return the report.

    `port` overrides the robot file's. `is_virtual` needs a simulated robot: its time passes as
    fast as the computer can, and the same `seed` gives the same bytes. `allow_run` lets the show
    call the Python functions that its events name, with all that your user may do. Without feedback
    the servos must store no higher limits than their joints have, unless `is_forced`.

    Raises `BusError` when a port or a servo cannot be reached, and `InputError` or `PlaybackError`
    when the robot is not what the file says or not fit to move; however it ends, the last bytes are
    the safe state.
    """
    result = perform(
        program,
        with_port(robot, port),
        is_virtual=is_virtual,
        seed=seed,
        has_feedback=has_feedback,
        may_run=allow_run,
        is_forced=is_forced,
    )
    if result.error is not None:
        raise result.error
    return result.report
