"""The functions for users: load, plan, compile, play. `lss_motion` exports them."""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lss_motion.errors import InputError
from lss_motion.planning.program.compile import compile_program as compile  # noqa: A004
from lss_motion.planning.program.model import Program
from lss_motion.planning.trajectory.model import Trajectory
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
    "check",
    "compile",
    "export",
    "gait",
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


def check(
    path: Path | str | Mapping[str, object], robot: Robot | None = None, *, is_robust: bool = False
) -> dict[str, Any]:
    """Return what `lss-motion check --json` prints of a sequence or gait: numbers for each joint.

    `is_robust` also plays it on simulated robots that are worse than assumed, which takes a minute.
    Raises `InputError`, `PlanningError` or `LineLoadError`, as loading, planning and compiling do.
    """
    from lss_motion.planning import shows
    from lss_motion.planning.check_json import show_as_json
    from lss_motion.playing import robustness

    sequence = load_sequence(path, robot)
    if robot is None:
        assert sequence.robot_path is not None, "without a robot it would not have been loaded"
        robot = load_robot(sequence.robot_path)
    show = shows.compiled(sequence, robot)
    found = show_as_json(show)
    if is_robust:
        trials = list(robustness.trials(show))
        found["robust"] = robustness.robust_as_json(trials, show.program.duration_s)
    return found


def gait(path: Path | str, robot: Robot | None = None) -> dict[str, Any]:
    """Return what `lss-motion gait --json` prints: margin, pace, foot errors of each passage.

    Raises `InputError` or `PlanningError` for a gait that cannot be walked.
    """
    from lss_motion.show.gait.load import load_gait, sequence_from
    from lss_motion.show.gait.pacing import gait_as_json, paced

    loaded = load_gait(Path(path), robot)
    if robot is None:
        assert loaded.robot_path is not None, "without a robot it would not have been loaded"
        robot = load_robot(loaded.robot_path)
    passages = paced(loaded, robot)
    plan(sequence_from(loaded, passages), robot)  # As the command: the verifier must accept it.
    return gait_as_json(loaded, passages)


def export(trajectory: Trajectory, format_name: str, *, rate_hz: float = 50.0) -> str:
    """Return a plan as text for another program, as `lss-motion export` writes it.

    `format_name` is `csv`, `ros`, `blender-csv` or `blender-json`. An endless show gives its first
    pass and one more. Raises `InputError` for another format or rate.
    """
    from lss_motion.files.texts import known_names
    from lss_motion.interchange.export import EXPORT_NAMES, PlanSamples, exported
    from lss_motion.planning import shows

    if format_name not in EXPORT_NAMES:
        raise InputError(
            f"unknown format {format_name!r}; {known_names(format_name, EXPORT_NAMES)}"
        )
    shows.require_rows(trajectory, rate_hz)
    return exported(
        PlanSamples.of(trajectory, shows.shown_s(trajectory), float(rate_hz)), format_name
    )


def play(  # noqa: PLR0913  (the options of one run)
    program: Program,
    robot: Robot,
    *,
    port: str | None = None,
    is_virtual: bool = False,
    seed: int = 0,
    has_feedback: bool = True,
    allow_run: bool = False,
    is_forced: bool = False,
    sim: str = "",
    trajectory: Trajectory | None = None,
) -> Report:
    """Play `program` on `robot` and return the report.

    `port` overrides the robot file's. `is_virtual` needs a simulated robot: its time passes as
    fast as the computer can, and the same `seed` gives the same bytes. `allow_run` lets the show
    call the Python functions that its events name, with all that your user may do. Without feedback
    the servos must store no higher limits than their joints have, unless `is_forced`. `sim` makes a
    simulated robot worse than assumed, such as `lag=+30ms,droop=3deg`. With the
    `trajectory` of the program the report of a simulated run has the true error of each horn
    (`horn_error_rms_deg`, `horn_error_max_deg`).

    Raises `BusError` when a port or a servo cannot be reached, and `InputError` or `PlaybackError`
    when the robot is not what the file says or not fit to move; however it ends, the last bytes are
    the safe state.
    """
    from lss_motion.sim.deviation import deviation_from_text

    result = perform(
        program,
        with_port(robot, port),
        deviation=deviation_from_text(sim) if sim else None,
        trajectory=trajectory,
        is_virtual=is_virtual,
        seed=seed,
        has_feedback=has_feedback,
        may_run=allow_run,
        is_forced=is_forced,
    )
    if result.error is not None:
        raise result.error
    return result.report
