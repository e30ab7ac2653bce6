"""How much more time anchors need that cannot be met: found by planning with it.

Before a keyframe (`planned_or_advised`), or where layers make them late for the whole show
(`planned_or_slower`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.explain import MissedAnchorError, MissedUnderLayersError
from lss_motion.show.keyframes import at_speed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence

PLANS_MAX: Final = 40
"""Plans that are made to find the times. Measured: two for each anchor that is missed."""

GROWTH: Final = 0.1
"""Least growth of a time that did not suffice: a later key makes another curve."""

UNIT_S: Final = 0.001
"""Times are given in whole milliseconds."""


SPEEDS: Final = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Shares of the speed that are tried, until anchors are met; then hundredths above that one."""


def planned_or_slower(sequence: Sequence, plan: Callable[[Sequence], Trajectory]) -> Trajectory:
    """Return the plan of a whole show at its speed.

    Raises `PlanningError` with a speed that suffices where layers make anchors late.
    """
    try:
        return plan(at_speed(sequence))
    except MissedUnderLayersError as error:
        ratio = _slow_enough(sequence, plan)
        slower = "" if ratio is None else f"write `speed_ratio: {ratio:g}`, "
        raise PlanningError(
            f"{error.reason}; {slower}lower a weight, or fade longer",
            joint=error.joint,
            time_s=error.time_s,
        ) from error


def _slow_enough(sequence: Sequence, plan: Callable[[Sequence], Trajectory]) -> float | None:
    """Return the largest speed, in hundredths, that was planned with; None if there is none."""

    def is_met(percent: int) -> bool:
        slower = replace(sequence, speed_ratio=percent / 100.0)
        try:
            plan(at_speed(slower))
        except PlanningError:
            return False
        return True

    percents = [math.floor(100.0 * share * sequence.speed_ratio) for share in SPEEDS]
    high = math.ceil(100.0 * sequence.speed_ratio)
    for low in percents:
        if low < 1:
            return None
        if is_met(low):
            break
        high = low
    else:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if is_met(middle) else (low, middle)
    return low / 100.0


def planned_or_advised(
    sequence: Sequence, robot: Robot, plan: Callable[[Sequence, Robot], Trajectory]
) -> Trajectory:
    """Return the plan; raise `PlanningError` with times that suffice if anchors are missed."""
    try:
        return plan(sequence, robot)
    except MissedAnchorError as error:
        more_s = _enough_s(error, sequence, robot, plan)
        advice = "Use a smaller move" if more_s is None else _text(error.index, more_s, sequence)
        raise PlanningError(
            f"{error.reason}. {advice}", joint=error.joint, time_s=error.time_s
        ) from error


def later(sequence: Sequence, more_s: Mapping[int, float]) -> Sequence:
    """Return the sequence with more time before keyframes; what comes after is as much later."""
    frames, by_s = [], 0.0
    for index, frame in enumerate(sequence.keyframes):
        by_s += more_s.get(index, 0.0)
        frames.append(replace(frame, at_s=None if frame.at_s is None else frame.at_s + by_s))
    return replace(sequence, keyframes=tuple(frames))


def _enough_s(
    error: MissedAnchorError,
    sequence: Sequence,
    robot: Robot,
    plan: Callable[[Sequence, Robot], Trajectory],
) -> dict[int, float] | None:
    """Return how much more time is planned with before which keyframes; None if it is not found."""
    if sequence.fit_duration_s is not None:
        return None
    more_s: dict[int, float] = {}
    missed = error
    for _ in range(PLANS_MAX):
        before_s = more_s.get(missed.index, 0.0)
        needed_s = before_s + max(missed.late_s, GROWTH * before_s)
        more_s[missed.index] = UNIT_S * math.ceil(needed_s / UNIT_S)
        try:
            plan(later(sequence, more_s), robot)
        except MissedAnchorError as again:
            missed = again
        except PlanningError:
            return None
        else:
            return more_s
    return None


def _text(index: int, more_s: Mapping[int, float], sequence: Sequence) -> str:
    frames = sequence.keyframes
    parts = [
        f"{'it' if key == index else f'the keyframe at {frames[key].at_s:g} s'} {by_s:.3f} s more"
        for key, by_s in sorted(more_s.items(), key=lambda item: (item[0] != index, item[0]))
    ]
    is_last = max(more_s) == len(frames) - 1 and len(more_s) == 1
    rest = "" if is_last else ", and all that comes after as much later"
    return f"Give {', '.join(parts)}{rest}, or use a smaller move"
