"""Trajectory → Program: every joint's moves, on the lines that carry them.

`compile_program` takes the choices of drives in order, and for each the candidates of the schedule
in order, until one fits the lines and leaves room for readings. The bytes of that one pass the
verifier, or an error is raised.
"""

# ruff: noqa: TC001 - public: `help` looks up the annotations.
from __future__ import annotations

import math
from bisect import bisect_left
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import InputError, LineLoadError
from lss_motion.files.texts import counted
from lss_motion.planning.program.accuracy import HornError, horn_errors
from lss_motion.planning.program.drives import choices
from lss_motion.planning.program.mates import fights
from lss_motion.planning.program.model import TOLERANCE_DEG, Program, Repeat, driving_of
from lss_motion.planning.program.move_table import lines_use, moves_of
from lss_motion.planning.program.reference_grid import GRID_S, GivenCommand, Reference
from lss_motion.planning.program.schedule import (
    RELAXED_RATIOS,
    Schedule,
    TooLateError,
    candidates,
    closed_pass,
    overload_error,
)
from lss_motion.planning.program.verify import verify_program
from lss_motion.planning.trajectory.model import JOINT_SECONDS_MAX, LoopedSpan, Trajectory
from lss_motion.planning.trajectory.playlist import all_cues, all_marks, all_waits
from lss_motion.planning.trajectory.servo_motion import servo_motion
from lss_motion.robot.model import Robot
from lss_motion.robot.profile import profile_lead_s
from lss_motion.units import MS_PER_S, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from lss_motion.planning.program.drives import Choice
    from lss_motion.planning.program.line import LineUse
    from lss_motion.planning.program.model import Move
    from lss_motion.planning.program.moves import FittedJoint
    from lss_motion.robot.model import Joint
    from lss_motion.show.model import Cue

WRITTEN_PASSES: Final = 4
"""Passes of a long loop that are written; one of them is repeated. The first, two in the middle and
the last have every pass and every kind of seam."""
WRITTEN_MAX_S: Final = 120.0
"""A loop that is over by then is written out: its file is easier to read. Chosen: two minutes."""
LOST_RATIO: Final = 2.0
"""A joint whose bound is larger than this multiple of tolerance and half a control tick at its top
speed has lost its plan. Measured on motions at their limits: 0.9 to 1.4 as a rule, else 2 to 30."""
RECOVERY_RATIOS: Final = (0.85, 0.6, 1.15, 0.75)
"""Multiples of the tolerance that are tried then. Measured on 13 motions at their limits for 10 to
35 s: each alone recovers half to three quarters of them, together all."""
PREROLL_S: Final = 0.25
"""The show clock starts this long before the plan, so that all first moves find a slot."""
SAMPLED_AT_ONCE: Final = 2048
"""Instants at which a plan is sampled at once, so that its working data stays in the cache."""


def compile_program(
    trajectory: Trajectory, robot: Robot, *, tolerance_deg: float = TOLERANCE_DEG
) -> Program:
    """Return the program that makes `robot` follow `trajectory`.

    Joints whose drive is `auto` get the one that predicts best within what the line can carry; the
    program holds the drive and the reason. Its bytes have passed `verify_program`. Raises
    `LineLoadError` if the line cannot carry it even at the most relaxed tolerance, or leaves its
    joints fewer readings than the bus requires, and `InputError` if a joint of the trajectory is
    not one of the robot's.
    """
    if unknown := [name for name in trajectory.joints if name not in robot.joints]:
        raise InputError(f"robot {robot.name!r} has no joint {unknown[0]!r}")
    trajectory, repeat = _written(trajectory)
    _check_length(trajectory)
    joints, trajectory = trajectory, servo_motion(trajectory, robot)
    led = _leds(robot)
    robot = robot.servo_robot
    seams_s = () if repeat is None else (s_from_us(repeat.from_us), s_from_us(repeat.to_us))
    finish = partial(_program, (trajectory, joints), led=led, repeat=repeat)
    problem: LineLoadError | None = None
    found = choices(robot, lambda driven: _references(trajectory, driven), tolerance_deg)
    for choice in found:
        references, lacks_readings = _references(trajectory, choice.robot), False
        for candidate in candidates(choice.robot, with_relaxed=choice is found[-1]):
            if lacks_readings and candidate.ratio == 1.0:
                continue  # Another placement of as many commands leaves little more room.
            try:
                schedule = candidate.schedule(references, tolerance_deg, seams_s)
            except TooLateError:
                continue
            if schedule.is_tight:
                problem = overload_error(schedule, choice.robot)
                continue
            program = finish(choice, references, schedule)
            unreadable = [use for use in program.line_use.values() if _lacks_readings(use, robot)]
            lacks_readings = bool(unreadable)
            if unreadable:
                problem = _readings_error(unreadable[0], program, robot)
                continue
            try:
                verify_program(program, choice.robot)
            except LineLoadError as error:
                problem = error
                continue
            fit = partial(candidate.schedule, references, tolerance_deg, seams_s)
            again = partial(finish, choice, references)
            return _recovered(_Compiled(program, schedule), choice.robot, fit, again)
    assert problem is not None
    raise problem


class _Compiled(NamedTuple):
    program: Program
    schedule: Schedule


def _recovered(
    first: _Compiled,
    robot: Robot,
    fit: Callable[[Mapping[str, float], Mapping[str, FittedJoint]], Schedule],
    finish: Callable[[Schedule, _Compiled], Program],
) -> Program:
    """Return the program in which the horns of joints that lose their plan lose it least.

    A choice of moves can end where no move regains the plan. With a slightly different tolerance
    the choice takes another way. `fit` multiplies the tolerances of those joints, and keeps the
    moves of all others where the line has room between them; `finish` keeps the errors of these.
    """
    best, found = first.program, first
    ratios: dict[str, float] = {}
    for ratio in RECOVERY_RATIOS:
        lost = _lost(found.program, robot)
        if not lost:
            break
        ratios |= dict.fromkeys(lost, ratio)
        others = {name: one for name, one in found.schedule.fitted.items() if name not in lost}
        try:
            try:
                schedule = fit(ratios, others)
            except TooLateError:
                schedule = fit(ratios, {})
            found = _Compiled(finish(schedule, found), schedule)
            if any(_lacks_readings(use, robot) for use in found.program.line_use.values()):
                break
            left = max(_lost(found.program, robot).values(), default=0.0)
            if left < max(_lost(best, robot).values()):
                verify_program(found.program, robot)
                best = found.program
        except (TooLateError, LineLoadError):
            break
    return best


def _lost(program: Program, robot: Robot) -> dict[str, float]:
    """Return by how much of what is usual the horns of timed joints may lose the plan."""
    ratios = {}
    for name, bound_deg in program.bound_deg.items():
        joint = robot.joints[name]
        usual_deg = (
            joint.tolerance_ratio * program.tolerance_deg
            + 0.5 * joint.response.loop_s * joint.speed_max_deg_s
        )
        if joint.drive == "timed" and bound_deg > LOST_RATIO * usual_deg:
            ratios[name] = bound_deg / usual_deg
    return ratios


def _lacks_readings(use: LineUse, robot: Robot) -> bool:
    """Return whether the commands on a line leave too little room for queries."""
    return use.reading_rate_hz < robot.buses[use.bus].reading_rate_min_hz


def _readings_error(use: LineUse, program: Program, robot: Robot) -> LineLoadError:
    """Return the error with the rate at which the joints of a line could be read."""
    return LineLoadError(
        f"bus {use.bus!r} at {use.baud_bps} bps carries the show, {use.utilisation_ratio:.0%} of "
        f"the line, but in its worst second each joint could be read {use.reading_rate_hz:.1f} "
        f"times, not {robot.buses[use.bus].reading_rate_min_hz:g}, even with a tolerance of "
        f"{program.tolerance_deg:.1f} deg. What would help: a faster baud rate, joints on a second "
        f"bus, or a lower reading_rate_min_hz of the bus in the robot file",
        bus=use.bus,
        utilisation_ratio=use.utilisation_ratio,
    )


def _written(trajectory: Trajectory) -> tuple[Trajectory, Repeat | None]:
    """Return the passes that are written, and the one of them that is repeated.

    It is the second, if the show has no end, or is long and has more passes than are written.
    """
    count = trajectory.loop
    if count is not None and (count <= WRITTEN_PASSES or trajectory.duration_s <= WRITTEN_MAX_S):
        return trajectory, None
    from_s = trajectory.first.duration_s
    to_s = from_s + trajectory.middle.duration_s
    times = None if count is None else count - WRITTEN_PASSES + 1
    repeat = Repeat(from_us=us_from_s(from_s), to_us=us_from_s(to_s), times=times)
    return trajectory if count is None else _shortened(trajectory, count), repeat


def _shortened(trajectory: Trajectory, count: int) -> Trajectory:
    """Return the show with `WRITTEN_PASSES` of its `count` passes."""
    marks = trajectory.marks
    if isinstance(trajectory.middle, LoopedSpan):  # Its marks are in the time of the whole show.
        skipped_s = (count - WRITTEN_PASSES) * trajectory.middle.duration_s
        end_s = trajectory.first.duration_s
        marks = tuple(
            replace(mark, planned_s=mark.planned_s - (skipped_s if mark.planned_s > end_s else 0.0))
            for mark in marks
        )
    return replace(trajectory, loop=WRITTEN_PASSES, marks=marks)


def _check_length(trajectory: Trajectory) -> None:
    """Raise `InputError` for a show that cannot be compiled in memory, before any is used."""
    written_s = _written_s(trajectory)
    most_s = JOINT_SECONDS_MAX / max(1, len(trajectory.joints))
    if written_s > most_s:
        raise InputError(
            f"sequence {trajectory.name!r} would be compiled for {written_s:,.0f} s of "
            f"{counted(trajectory.joints, 'joint')}, at most {most_s:,.0f} s is possible: repeat a "
            f"shorter one with `loop`, which is compiled once"
        )


def _written_s(trajectory: Trajectory) -> float:
    if trajectory.loop is None:
        return trajectory.first.duration_s + 2.0 * trajectory.middle.duration_s
    return trajectory.duration_s


def _references(trajectory: Trajectory, robot: Robot) -> dict[str, Reference]:
    """Return what each servo's profile has to do: the plan, earlier by the lead of its profile."""
    end_s = _written_s(trajectory)
    references = {}
    steps = math.ceil((end_s + 2.0 * PREROLL_S) / GRID_S) + 1
    times_s = -PREROLL_S + GRID_S * np.arange(steps, dtype=np.float64)
    leads_s = [profile_lead_s(robot.joints[name]) for name in trajectory.joints]
    for lead_s in set(leads_s):
        own = [index for index, one_s in enumerate(leads_s) if one_s == lead_s]
        joints = [robot.joints[trajectory.joints[index]] for index in own]
        servo_deg = np.empty((len(own), steps))
        for first in range(0, steps, SAMPLED_AT_ONCE):
            some = slice(first, first + SAMPLED_AT_ONCE)
            servo_deg[:, some] = trajectory.sample(times_s[some] + lead_s).T[own]
        # In place: in a long show of many joints, each copy takes hundreds of megabytes.
        servo_deg *= np.array([[joint.direction] for joint in joints])
        servo_deg += np.array([[joint.zero_deg] for joint in joints])
        for joint, position_deg in zip(joints, servo_deg, strict=True):
            references[joint.name] = Reference(
                start_s=-PREROLL_S,
                position_deg=position_deg,
                given=_given(trajectory, joint, lead_s),
            )
    return references


def _given(trajectory: Trajectory, joint: Joint, lead_s: float) -> tuple[GivenCommand, ...]:
    """Return the commands of the author for a joint, received by the lead earlier."""
    per_deg = joint.model.wire_per_deg
    return tuple(
        GivenCommand(
            received_s=move.at_s - lead_s,
            target_wire=round(joint.servo_deg(move.deg) * per_deg),
            duration_ms=round(MS_PER_S * move.duration_s),
        )
        for move in trajectory.commands
        if move.joint == joint.name and joint.drive == "timed"
    )


def glide_moves(
    references: Mapping[str, Reference], robot: Robot, tolerance_deg: float
) -> Sequence[Move]:
    """Return the moves that take joints along `references`, with nothing else on the lines."""
    schedules = (Schedule(references, robot, tolerance_deg * r) for r in RELAXED_RATIOS)
    for schedule in schedules:
        if not schedule.is_tight or schedule.tolerance_deg == tolerance_deg * RELAXED_RATIOS[-1]:
            return moves_of(schedule.fitted, robot)
    raise AssertionError("the last schedule is used as it is")


def _leds(robot: Robot) -> dict[str, tuple[str, ...]]:
    """Return the servos that light up for each joint of a robot with mechanisms."""
    found: dict[str, tuple[str, ...]] = {name: (name,) for name in robot.joints if robot.servos}
    for mechanism in robot.mechanisms.values() if robot.servos else ():
        found |= dict.fromkeys(mechanism.joints, mechanism.servos)
    return found


def _lit(cue: Cue, led: Mapping[str, tuple[str, ...]]) -> Cue:
    """Return a cue with the servos of its joints."""
    if not led or not cue.led:
        return cue
    lights = [(servo, code) for joint, code in cue.led for servo in led[joint]]
    return replace(cue, led=tuple(lights))


def _program(
    motions: tuple[Trajectory, Trajectory],
    choice: Choice,
    references: Mapping[str, Reference],
    schedule: Schedule,
    before: _Compiled | None = None,
    *,
    led: Mapping[str, tuple[str, ...]],
    repeat: Repeat | None,
) -> Program:
    """Return the program of the motion of servos, and of the joints that it was made of.

    `before`: one of the same plan, with the errors of joints that kept their moves.
    """
    trajectory, joints = motions
    robot = choice.robot
    moves: Sequence[Move] = moves_of(schedule.fitted, robot)
    added_s = 0.0 if repeat is None else s_from_us(repeat.added_us)
    if repeat is not None:
        rest = () if repeat.times is None else moves[_first_from(moves, repeat.to_us) :]
        moves = (*closed_pass(moves, repeat, robot), *rest)
    errors = _errors(schedule, references, robot, before)
    start = trajectory.sample(np.zeros(1))[0]
    end_s = trajectory.duration_s
    if repeat is not None and repeat.times is None:
        end_s = s_from_us(repeat.to_us)
    return Program(
        name=trajectory.name,
        robot=robot.name,
        robot_path=robot.path,
        moves=moves,
        duration_s=trajectory.duration_s + added_s,
        start_deg={n: float(v) for n, v in zip(trajectory.joints, start, strict=True)},
        tolerance_deg=schedule.tolerance_deg,
        drives=driving_of(robot, trajectory.joints),
        drive_reasons={n: why for n, why in choice.reasons.items() if n in trajectory.joints},
        repeat=repeat,
        marks=tuple(mark for mark in all_marks(joints, end_s) if mark.planned_s <= end_s),
        cues=tuple(_lit(cue, led) for cue in all_cues(joints, end_s) if cue.at_s <= end_s),
        waits=tuple(point for point in all_waits(joints, end_s) if point.at_s <= end_s),
        stretched=trajectory.stretched,
        given_up=trajectory.given_up,
        on_fault=trajectory.on_fault,
        line_use=lines_use(moves, robot),
        error_max_deg={name: error.moves_deg for name, error in errors.items()},
        bound_deg={name: error.bound_deg for name, error in errors.items()},
        fight_deg=fights(schedule.fitted, references, robot),
    )


def _errors(
    schedule: Schedule,
    references: Mapping[str, Reference],
    robot: Robot,
    before: _Compiled | None,
) -> dict[str, HornError]:
    """Return the errors of all horns; those of joints that kept their moves are known."""
    known: dict[str, HornError] = {}
    if before is not None:
        program, old = before.program, before.schedule.fitted
        known = {
            name: HornError(program.error_max_deg[name], program.bound_deg[name])
            for name, one in schedule.fitted.items()
            if one is old[name]
        }
    new = {name: one for name, one in schedule.fitted.items() if name not in known}
    found = known | horn_errors(new, references, robot.joints, schedule.tolerance_deg)
    return {name: found[name] for name in schedule.fitted}


def _first_from(moves: Sequence[Move], from_us: int) -> int:
    return bisect_left(moves, from_us, key=lambda move: move.due_us)
