"""Chooses the drive of joints whose robot file says `drive: auto`, and says why.

Each drive that the servo can do is fitted, alone, and predicted: how far its horn would be from the
plan, with what nobody can know about the servo added. That is the instant, within its control loop
or within its filter's period, at which it takes up a command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.attempt import fitted_alone
from lss_motion.program.course import GRID_S
from lss_motion.robot.drives import FILTER_FIRMWARE_MIN, can_be_streamed
from lss_motion.robot.models import FAMILIES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.program.course import Course
    from lss_motion.robot.model import Drive, Joint, Robot

    Courses = Callable[[Robot], Mapping[str, Course]]

WORTH_RATIO: Final = 0.9
"""Streaming must predict this much better than timed moves. Chosen: those take less of the line,
and the servo itself keeps their limits."""
UNKNOWN_RATIO: Final = 1.0 / math.sqrt(12.0)
"""RMS of an instant that is equally likely anywhere in a period, in periods."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A robot without `auto`, and why each of those joints is driven as it is."""

    robot: Robot
    reasons: Mapping[str, str] = field(default_factory=dict)


def choices(robot: Robot, courses: Courses, tolerance_deg: float) -> list[Choice]:
    """Return what predicts best first, then with fewer and fewer of its joints streamed.

    The last one streams only what cannot be timed. `courses` gives what the profiles of a robot
    have to do; only the joints of those are looked at.
    """
    opened = {n: j for n, j in robot.joints.items() if j.drive == "auto"}
    if not opened:
        return [Choice(robot=robot)]
    timed = courses(_with(robot, dict.fromkeys(opened, "timed")))
    streamed = courses(_with(robot, dict.fromkeys(opened, "streamed")))
    drives: dict[str, Drive] = {}
    reasons: dict[str, str] = {}
    gains: dict[str, float] = {}
    for name, joint in opened.items():
        family, reason = FAMILIES[joint.model.family], _only(joint, robot)
        drives[name] = "streamed" if _needs_filter(joint) else family.drives[0]
        if not reason and name in timed:
            by_ramps = predicted_deg(replace(joint, drive="timed"), timed[name], tolerance_deg)
            by_filter = predicted_deg(
                replace(joint, drive="streamed"), streamed[name], tolerance_deg
            )
            reason = f"timed predicts {by_ramps:.2f} deg RMS, streamed {by_filter:.2f} deg"
            if by_filter < WORTH_RATIO * by_ramps:
                drives[name] = "streamed"
                gains[name] = by_ramps - by_filter
        reasons[name] = f"{drives[name]}: {reason or 'the show does not move it'}"
    return _with_fewer(robot, drives, reasons, sorted(gains, key=lambda name: gains[name]))


def _with_fewer(
    robot: Robot, drives: Mapping[str, Drive], reasons: Mapping[str, str], by_gain: list[str]
) -> list[Choice]:
    """Return the choice, and those that time half of the rest of `by_gain`, least gain first."""
    found = [Choice(robot=_with(robot, drives), reasons=reasons)]
    while by_gain:
        cut = -(-len(by_gain) // 2)
        given_up, by_gain = by_gain[:cut], by_gain[cut:]
        drives = {**drives, **dict.fromkeys(given_up, "timed")}
        why = "timed: the line has no room to stream it;"
        reasons = {**reasons, **{n: f"{why} {reasons[n].partition(': ')[2]}" for n in given_up}}
        found.append(Choice(robot=_with(robot, drives), reasons=reasons))
    return found


def _with(robot: Robot, drives: Mapping[str, Drive]) -> Robot:
    changed = {name: replace(robot.joints[name], drive=drive) for name, drive in drives.items()}
    return replace(robot, joints={**robot.joints, **changed})


def _needs_filter(joint: Joint) -> bool:
    facts = FAMILIES[joint.model.family]
    return "streamed" in facts.drives and joint.accel_max_deg_s2 > facts.accel_max_deg_s2


def _only(joint: Joint, robot: Robot) -> str:
    """Return why the joint has no choice, or nothing if it has one."""
    if _needs_filter(joint):
        most = FAMILIES[joint.model.family].accel_max_deg_s2
        return f"{joint.accel_max_deg_s2:g} deg/s² is more than its ramps can express, {most:g}"
    if "streamed" not in FAMILIES[joint.model.family].drives:
        return f"a {joint.model.name} knows no other drive"
    if not can_be_streamed(joint, robot.buses[joint.bus]):
        return f"streaming needs firmware {FILTER_FIRMWARE_MIN}"
    return ""


def predicted_deg(joint: Joint, course: Course, tolerance_deg: float) -> float:
    """Return the RMS of what a joint's horn will be off, fitted with nothing else on its line."""
    profile = fitted_alone(joint, course, tolerance_deg)
    times_s = course.start_s + GRID_S * np.arange(len(course.position_deg), dtype=np.float64)
    error_deg = profile.sample(times_s) - course.position_deg
    speed_deg_s = np.gradient(course.position_deg, GRID_S)
    period_s = joint.response.filter_s if joint.drive == "streamed" else joint.response.loop_s
    unknown_deg = UNKNOWN_RATIO * period_s * speed_deg_s
    return float(np.sqrt(np.mean(error_deg**2) + np.mean(unknown_deg**2)))
