"""Slow program from where the robot stands to where the show starts."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec.structs import replace

from lss_motion.planning.program.model import TOLERANCE_DEG, Move, Program, driving_of
from lss_motion.planning.program.move_table import lines_use
from lss_motion.planning.program.reference_grid import DURATION_MAX_MS, GRID_S, Reference
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.verify import profiles
from lss_motion.robot.profile import Piece, ramp_deg_s2, trapezoid
from lss_motion.units import MS_PER_S, NS_PER_US, line_time_ns, s_from_ms, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Joint, Robot

APPROACH_LEAST_S: Final = 0.3
"""Even a servo that stands in its place is given this long: it may be limp."""
LEG_MAX_S: Final = s_from_ms(DURATION_MAX_MS)
"""The longest move."""
GLIDE_AFTER_S: Final = 0.25
"""A course of bare `D`s begins this long after the first commands, so that each gets its slot."""
GLIDE_TOLERANCE_DEG: Final = 0.05
"""Half a wire unit: there is no hurry, and the speed should be even."""
NOISE_UNITS: Final = 3.0
"""A joint in EM0 that reads less than this outside of its range stands on its edge. Chosen: the
noise of a reading (FACTS.md E7), of which the filter makes a start of 5 deg/s at most. Without it,
each approach would send the joint further out by the noise of one reading."""
GLIDE_END_S: Final = 0.1
"""Time for which a course stands at its end, so that the end is fitted as a rest."""


def with_room(robot: Robot, standing_deg: Mapping[str, float]) -> Robot:
    """Return `robot` with ranges that include where its servos stand (servo angles).

    A joint without T moves step by step. If it stands outside of its range, it must move back into
    it at the same slow speed as everything else, not jump. A timed joint goes back into its range
    with its first move, unless the way is too long for one T.
    """
    joints = dict(robot.joints)
    for name, servo_deg in standing_deg.items():
        joint = joints[name]
        here_deg = joint.joint_deg(servo_deg)
        out_deg = max(joint.position_min_deg - here_deg, here_deg - joint.position_max_deg)
        if joint.drive != "timed" or out_deg > LEG_MAX_S * _speed(robot, joint):
            joints[name] = replace(
                joint,
                position_min_deg=min(joint.position_min_deg, here_deg),
                position_max_deg=max(joint.position_max_deg, here_deg),
            )
    return replace(robot, joints=joints)


def without_noise(robot: Robot, standing_deg: Mapping[str, float]) -> dict[str, float]:
    """Return the servo angles where joints stand, those in EM0 not outside of a range by noise."""
    standing = dict(standing_deg)
    for name, servo_deg in standing_deg.items():
        joint = robot.joints[name]
        edge_deg = _within_range(joint, servo_deg)
        is_near = abs(edge_deg - servo_deg) <= NOISE_UNITS * joint.unit_deg
        if joint.drive == "streamed" and is_near:
            standing[name] = edge_deg
    return standing


class _Leg(NamedTuple):
    """One move of every timed joint at the same time: servo angles, and T in seconds."""

    targets_deg: dict[str, float]
    lasts_s: float


def _legs(
    robot: Robot, standing_deg: Mapping[str, float], end_deg: Mapping[str, float]
) -> list[_Leg]:
    """Return the moves of the timed joints: as few as T allows, none above the approach speed.

    Every target is in the range of its joint. So a joint that stands outside has a longer way in
    its first move than in the others, and this move takes longer for all joints.
    """
    joints = [robot.joints[name] for name in end_deg]
    for count in itertools.count(1):
        legs, before_deg = [], dict(standing_deg)
        for number in range(1, count + 1):
            targets_deg, lasts_s = {}, APPROACH_LEAST_S / count
            for joint in joints:
                from_deg, whole_deg = standing_deg[joint.name], end_deg[joint.name]
                whole_deg -= from_deg
                target_deg = _within_range(joint, from_deg + number / count * whole_deg)
                way_deg = abs(whole_deg) / count
                if joint.drive == "timed":
                    is_cut = _within_range(joint, from_deg) != from_deg
                    way_deg = abs(target_deg - before_deg[joint.name]) if is_cut else way_deg
                    targets_deg[joint.name] = before_deg[joint.name] = target_deg
                lasts_s = max(lasts_s, way_deg / _speed(robot, joint))
            legs.append(_Leg(targets_deg, lasts_s))
        if all(leg.lasts_s <= LEG_MAX_S for leg in legs):
            return legs
    raise AssertionError("moves get shorter with their number")


def _within_range(joint: Joint, servo_deg: float) -> float:
    """Return the servo angle within the range of a joint that is nearest to `servo_deg`."""
    here_deg = joint.joint_deg(servo_deg)
    if joint.position_min_deg <= here_deg <= joint.position_max_deg:
        return servo_deg
    return joint.servo_deg(min(max(here_deg, joint.position_min_deg), joint.position_max_deg))


def approach(
    robot: Robot, standing_deg: Mapping[str, float], start_deg: Mapping[str, float]
) -> Program:
    """Return the program that takes every joint from where it stands to where the show starts.

    Every joint receives a command at once, which also ends being limp. All take equally long, and
    none is faster than `approach_speed_deg_s`. A timed joint arrives with that one move (or a few,
    where T would become too long), by its servo's own ramps. The others know no T: their first
    command holds them where they stand, and then they follow the same trapezoid. `standing_deg` are
    servo angles, `start_deg` joint angles.
    """
    robot = with_room(robot, standing_deg)
    joints = [robot.joints[name] for name in start_deg]
    end_deg = {joint.name: joint.servo_deg(start_deg[joint.name]) for joint in joints}
    legs = _legs(robot, standing_deg, end_deg)
    slowest_ramp_s = max((_speed(robot, joint) / ramp_deg_s2(joint) for joint in joints), default=0)
    longest_s = sum(leg.lasts_s for leg in legs)
    moves: list[Move] = []
    begins_s = leg_s = 0.0
    for leg in legs:
        targets = dict(leg.targets_deg)
        if leg is legs[0]:
            leg_s = leg.lasts_s + slowest_ramp_s
            targets = {name: targets.get(name, standing_deg[name]) for name in end_deg}
        moves += _at_once(robot, targets, us_from_s(begins_s), math.ceil(MS_PER_S * leg.lasts_s))
        begins_s += leg.lasts_s + slowest_ramp_s
    first_s = s_from_us(max((m.due_us for m in moves if m.due_us < us_from_s(leg_s)), default=0))
    courses = {
        joint.name: _course(
            joint,
            standing_deg[joint.name],
            joint.servo_deg(start_deg[joint.name]),
            (first_s, first_s + GLIDE_AFTER_S, longest_s),
        )
        for joint in joints
        if joint.drive != "timed"
    }
    if courses:
        from lss_motion.planning.program.compile import (
            glide_moves,  # Timed joints need no compiler.
        )

        moves += glide_moves(courses, robot, GLIDE_TOLERANCE_DEG)
    moves.sort(key=lambda move: move.due_us)
    program = Program(
        name="approach",
        robot=robot.name,
        robot_path=robot.path,
        moves=tuple(moves),
        duration_s=0.0,
        start_deg={n: robot.joints[n].joint_deg(standing_deg[n]) for n in start_deg},
        tolerance_deg=TOLERANCE_DEG,
        drives=driving_of(robot, start_deg),
        line_use=lines_use(moves, robot),
    )
    ends_s = [reference.end_s for reference in profiles(program, robot).values()]
    return replace(program, duration_s=max([0.0, *ends_s]))


def approach_s(robot: Robot, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
    """Return about how long the approach between two poses (joint angles) takes."""
    lasts_s, ramp_s = APPROACH_LEAST_S, 0.0
    for name, target_deg in to_deg.items():
        joint = robot.joints[name]
        lasts_s = max(lasts_s, abs(target_deg - from_deg[name]) / _speed(robot, joint))
        ramp_s = max(ramp_s, _speed(robot, joint) / ramp_deg_s2(joint))
    return lasts_s + ramp_s


def _speed(robot: Robot, joint: Joint) -> float:
    return min(robot.approach_speed_deg_s, joint.speed_max_deg_s)


def _at_once(
    robot: Robot, targets_deg: Mapping[str, float], at_us: int, duration_ms: int
) -> list[Move]:
    """Return one command for every joint, one after another on each bus from `at_us` on."""
    moves, due_us = [], dict.fromkeys(robot.buses, at_us)
    for name, servo_deg in targets_deg.items():
        joint = robot.joints[name]
        move = Move(
            due_us=due_us[joint.bus],
            bus=joint.bus,
            servo_id=joint.servo_id,
            target_wire=round(servo_deg / joint.unit_deg) * joint.model.wire_step,
            duration_ms=duration_ms if joint.drive == "timed" else None,
        )
        moves.append(move)
        size_ns = line_time_ns(len(move.data), robot.buses[joint.bus].baud_bps)
        due_us[joint.bus] += -(-size_ns // NS_PER_US)
    return moves


def _course(
    joint: Joint, from_deg: float, to_deg: float, times_s: tuple[float, float, float]
) -> Reference:
    """Return a course that stands from the first of `times_s`, and moves from the second on.

    It takes as long as the third and the ramps, like a timed move with that T.
    """
    stands_s, starts_s, lasts_s = times_s
    state = Piece(starts_s, from_deg, 0.0, 0.0)
    travel_deg_s = max(abs(to_deg - from_deg) / lasts_s, joint.unit_deg)
    reference = PiecewiseProfile(trapezoid(state, to_deg, travel_deg_s, ramp_deg_s2(joint)))
    steps = math.ceil((reference.end_s + GLIDE_END_S - stands_s) / GRID_S) + 1
    grid_s = stands_s + GRID_S * np.arange(steps, dtype=np.float64)
    return Reference(start_s=stands_s, position_deg=reference.sample(grid_s))
