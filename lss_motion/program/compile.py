"""Trajectory → Program: every joint's moves, on the lines that carry them."""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError, LineLoadError
from lss_motion.program.choose import choices
from lss_motion.program.cone import GRID_S, Course
from lss_motion.program.drives import late_max_s, lead, longest_move, make_fitter
from lss_motion.program.line import LineSchedule, LineUse, line_use
from lss_motion.program.model import TIMED, Driving, Move, Program, Repeat
from lss_motion.program.verify import verify_program
from lss_motion.protocol.line import encode_move
from lss_motion.trajectory.cues import all_cues, all_marks
from lss_motion.units import NS_PER_US, line_time_ns, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.program.choose import Choice
    from lss_motion.program.drives import JointFitter
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.trajectory.model import Trajectory

TOLERANCE_DEG: Final = 0.2
"""How far the predicted horn may be from the plan (design 7)."""
RELAXED_RATIOS: Final = (1.0, 1.5, 2.5, 4.0, 6.0)
"""By how much the tolerance is relaxed, step by step, when the line is too slow."""
PREROLL_S: Final = 0.25
"""The show clock starts this long before the plan, so that all first moves find a slot."""


def compile_program(
    trajectory: Trajectory, robot: Robot, *, tolerance_deg: float = TOLERANCE_DEG
) -> Program:
    """Return the program that makes `robot` follow `trajectory`.

    Joints whose drive is `auto` get the one that predicts best within what the line can carry; the
    program says which and why. Its bytes have passed `verify_program`. Raises `LineLoadError` when
    the line cannot carry it even at the most relaxed tolerance, and `InputError` when a joint of
    the trajectory is not one of the robot's.
    """
    if unknown := [name for name in trajectory.joints if name not in robot.joints]:
        raise InputError(f"robot {robot.name!r} has no joint {unknown[0]!r}")
    repeat = _repeat(trajectory)
    seams_s = () if repeat is None else (s_from_us(repeat.from_us), s_from_us(repeat.to_us))
    found = choices(robot, lambda driven: _courses(trajectory, driven), tolerance_deg)
    trials = [(choice, 1.0) for choice in found[:-1]]
    trials += [(found[-1], ratio) for ratio in RELAXED_RATIOS]
    tight: _Attempt | None = None
    for choice, ratio in trials:
        courses = _courses(trajectory, choice.robot)
        attempt = _Attempt(courses, choice.robot, tolerance_deg * ratio, seams_s)
        if not attempt.is_tight:
            program = _program(trajectory, choice, courses, attempt, repeat)
            verify_program(program, choice.robot)
            return program
        tight = attempt
    assert tight is not None
    raise _overload(tight, robot)


def _repeat(trajectory: Trajectory) -> Repeat | None:
    """Return the pass that is played again and again, if the show has no end."""
    if trajectory.loop is not None:
        return None
    from_s = trajectory.first.duration_s
    return Repeat(from_us=us_from_s(from_s), to_us=us_from_s(from_s + trajectory.middle.duration_s))


def _courses(trajectory: Trajectory, robot: Robot) -> dict[str, Course]:
    """Return what each servo's profile has to do: the plan, earlier by what the servo lags."""
    end_s = trajectory.duration_s
    if trajectory.loop is None:
        end_s = trajectory.first.duration_s + 2.0 * trajectory.middle.duration_s
    courses = {}
    steps = math.ceil((end_s + 2.0 * PREROLL_S) / GRID_S) + 1
    for lead_s in {lead(robot.joints[name]) for name in trajectory.joints}:
        times_s = -PREROLL_S + GRID_S * np.arange(steps, dtype=np.float64)
        angles_deg = trajectory.sample(times_s + lead_s)
        for column, name in enumerate(trajectory.joints):
            joint = robot.joints[name]
            if lead(joint) == lead_s:
                servo_deg = joint.zero_deg + joint.direction * angles_deg[:, column]
                courses[name] = Course(start_s=-PREROLL_S, position_deg=servo_deg)
    return courses


class _Attempt:
    """All joints fitted at one tolerance, on the lines they share."""

    def __init__(
        self,
        courses: Mapping[str, Course],
        robot: Robot,
        tolerance_deg: float,
        seams_s: Sequence[float],
    ) -> None:
        self.tolerance_deg = tolerance_deg
        self.late_max_us = 0
        self.is_tight = False
        self.fitters = {
            name: make_fitter(robot.joints[name], course, tolerance_deg, seams_s)
            for name, course in courses.items()
        }
        self._lines = {bus: LineSchedule() for bus in robot.buses}
        queue: list[tuple[float, str]] = []
        for name, fitter in self.fitters.items():
            if (wanted_s := fitter.wanted(None)) is not None:
                heapq.heappush(queue, (self._grant(robot, name, wanted_s, -PREROLL_S), name))
        while queue:
            granted_s, name = heapq.heappop(queue)
            wanted_s = self.fitters[name].wanted(granted_s)
            if wanted_s is not None:
                next_s = self._grant(robot, name, wanted_s, granted_s)
                heapq.heappush(queue, (next_s, name))

    def _grant(self, robot: Robot, name: str, wanted_s: float, after_s: float) -> float:
        """Reserve the line for the next move of a joint; return when that move is heard."""
        joint = robot.joints[name]
        size_us = slot_us(joint, robot.buses[joint.bus].baud_bps)
        wanted_us = us_from_s(wanted_s)
        heard = self._lines[joint.bus].reserve(wanted_us, size_us, us_from_s(after_s))
        self.late_max_us = max(self.late_max_us, heard - wanted_us)
        self.is_tight = self.is_tight or s_from_us(heard - wanted_us) > late_max_s(joint)
        self.fitters[name].grant(s_from_us(heard))
        return s_from_us(heard)


def slot_us(joint: Joint, baud_bps: int) -> int:
    """Return the line time of the longest move that the joint can be sent."""
    return -(-line_time_ns(len(longest_move(joint)), baud_bps) // NS_PER_US)


def glide_moves(courses: Mapping[str, Course], robot: Robot, tolerance_deg: float) -> list[Move]:
    """Return the moves that take joints along courses of their own, with nothing else to do."""
    attempts = (_Attempt(courses, robot, tolerance_deg * r, ()) for r in RELAXED_RATIOS)
    for attempt in attempts:
        if not attempt.is_tight or attempt.tolerance_deg == tolerance_deg * RELAXED_RATIOS[-1]:
            return moves_of(attempt.fitters, robot)
    raise AssertionError("the last attempt is taken as it is")


def _program(
    trajectory: Trajectory,
    choice: Choice,
    courses: Mapping[str, Course],
    attempt: _Attempt,
    repeat: Repeat | None,
) -> Program:
    robot = choice.robot
    moves = [
        move
        for move in moves_of(attempt.fitters, robot)
        if repeat is None or move.due_us < repeat.to_us
    ]
    start = trajectory.sample(np.zeros(1))[0]
    end_s = trajectory.duration_s if repeat is None else s_from_us(repeat.to_us)
    return Program(
        name=trajectory.name,
        robot=robot.name,
        robot_path=robot.path,
        moves=tuple(moves),
        duration_s=trajectory.duration_s,
        start_deg={n: float(v) for n, v in zip(trajectory.joints, start, strict=True)},
        tolerance_deg=attempt.tolerance_deg,
        drives=driving_of(robot, trajectory.joints),
        drive_reasons={n: why for n, why in choice.reasons.items() if n in trajectory.joints},
        repeat=repeat,
        marks=tuple(mark for mark in all_marks(trajectory, end_s) if mark.planned_s <= end_s),
        cues=tuple(cue for cue in all_cues(trajectory, end_s) if cue.at_s <= end_s),
        stretched=trajectory.stretched,
        line_use=lines_use(moves, robot),
        error_max_deg={
            name: _error_max_deg(fitter, courses[name]) for name, fitter in attempt.fitters.items()
        },
    )


def driving_of(robot: Robot, names: Iterable[str]) -> dict[str, Driving]:
    """Return how the joints are commanded that are not timed."""
    driving = {}
    for name in names:
        drive = robot.joints[name].drive
        assert drive != "auto", "somebody has chosen by now"
        count = robot.joints[name].filter_count if drive == "streamed" else 0
        driving[name] = Driving(drive, count)
    return {name: chosen for name, chosen in driving.items() if chosen != TIMED}


def moves_of(fitters: Mapping[str, JointFitter], robot: Robot) -> list[Move]:
    """Return the moves of all joints in the order in which they are due."""
    moves = []
    for name, fitter in fitters.items():
        joint = robot.joints[name]
        for fitted in fitter.moves:
            size = len(encode_move(joint.servo_id, fitted.target_wire, fitted.duration_ms))
            sent_us = -(-line_time_ns(size, robot.buses[joint.bus].baud_bps) // NS_PER_US)
            moves.append(
                Move(
                    due_us=us_from_s(fitted.heard_s) - sent_us,
                    bus=joint.bus,
                    servo_id=joint.servo_id,
                    target_wire=fitted.target_wire,
                    duration_ms=fitted.duration_ms,
                )
            )
    return sorted(moves, key=lambda move: (move.due_us, move.bus, move.servo_id))


def lines_use(moves: list[Move], robot: Robot) -> dict[str, LineUse]:
    """Return how the moves use each bus: the proof of the schedule, from the bytes alone."""
    use = {}
    for name, bus in robot.buses.items():
        slots_us = [
            (move.due_us, -(-line_time_ns(len(move.data), bus.baud_bps) // NS_PER_US))
            for move in moves
            if move.bus == name
        ]
        use[name] = line_use(name, bus.baud_bps, slots_us)
    return use


def _error_max_deg(fitter: JointFitter, course: Course) -> float:
    times_s = course.start_s + GRID_S * np.arange(len(course.position_deg), dtype=np.float64)
    return float(np.abs(fitter.reference().sample(times_s) - course.position_deg).max())


def _overload(attempt: _Attempt, robot: Robot) -> LineLoadError:
    """Return the error that says how much is too much, and what would help."""
    commands: dict[str, int] = dict.fromkeys(robot.buses, 0)
    busy_us: dict[str, int] = dict.fromkeys(robot.buses, 0)
    span_s = 1e-3
    for name, fitter in attempt.fitters.items():
        joint = robot.joints[name]
        commands[joint.bus] += len(fitter.moves)
        busy_us[joint.bus] += len(fitter.moves) * slot_us(joint, robot.buses[joint.bus].baud_bps)
        span_s = max(span_s, fitter.moves[-1].heard_s if fitter.moves else 0.0)
    worst = max(busy_us, key=lambda bus: busy_us[bus])
    ratio = s_from_us(busy_us[worst]) / span_s
    baud_bps = robot.buses[worst].baud_bps
    return LineLoadError(
        f"bus {worst!r} at {baud_bps} bps cannot carry the show: {commands[worst]} commands need "
        f"{ratio:.0%} of the line and some would be {attempt.late_max_us / 1e3:.0f} ms late, even "
        f"with a tolerance of {attempt.tolerance_deg:.1f} deg. What would help: a faster baud "
        f"rate, joints on a second bus, or fewer joints moving at once",
        bus=worst,
        utilisation_ratio=ratio,
    )
