"""Durations that are given: the author's times scaled, or the fastest motion slowed."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError, PlanningError
from lss_motion.trajectory.clock import Clock
from lss_motion.trajectory.layout import laid_out
from lss_motion.trajectory.model import Motion, Trajectory, motions_of
from lss_motion.trajectory.retime import strained
from lss_motion.trajectory.timeline import pause_s, slowed

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Sequence

FIT_TOLERANCE_S: Final = 0.001
"""A fitted pass is as long as wanted, to the millisecond."""

FIT_STEPS: Final = 24
"""Bisections to find the least feasible duration: a ratio of 1e-7."""


def slowed_to(trajectory: Trajectory, wanted_s: float) -> Trajectory:
    """Slow the motion of a fastest trajectory so that one pass takes `wanted_s`."""
    motions = motions_of(trajectory)
    clock = motions[1].clock
    paused_s = pause_s(clock)
    moving_s = clock.duration_s - paused_s
    if clock.duration_s > wanted_s + FIT_TOLERANCE_S:
        raise PlanningError(
            f"one pass cannot be done in {wanted_s:g} s: the fastest takes "
            f"{clock.duration_s:.3f} s, of which {paused_s:g} s are holds"
        )
    if moving_s <= 0.0:
        raise PlanningError(
            f"nothing moves, so that {wanted_s:g} s cannot be filled; give a hold of that length"
        )
    ratio = max(1.0, (wanted_s - paused_s) / moving_s)
    return _reclocked(trajectory, lambda clock: slowed(clock, ratio))


def at_ratio(trajectory: Trajectory, ratio: float) -> Trajectory:
    """Slow a fastest trajectory down to `ratio` of its speed, pauses included."""
    return _reclocked(
        trajectory,
        lambda clock: Clock(
            times_s=clock.times_s / ratio,
            path_s=clock.path_s,
            rates=clock.rates * ratio,
            rate_slopes=clock.rate_slopes * ratio**2,
        ),
    )


def _reclocked(trajectory: Trajectory, change: Callable[[Clock], Clock]) -> Trajectory:
    """Return the trajectory with other clocks on the same paths; same passes stay the same."""
    motions = motions_of(trajectory)
    changed = {id(m): Motion(path=m.path, clock=change(m.clock)) for m in motions}
    first, middle, last = (changed[id(motion)] for motion in motions)
    reached_s = [mark.planned_s for mark in trajectory.marks]
    moved_s = np.interp(reached_s, motions[0].clock.times_s, first.clock.times_s).tolist()
    return replace(
        trajectory,
        first=first,
        middle=middle,
        last=last,
        marks=tuple(
            replace(mark, planned_s=at_s)
            for mark, at_s in zip(trajectory.marks, moved_s, strict=True)
        ),
    )


def scaled(sequence: Sequence, wanted_s: float) -> Sequence:
    """Return the sequence with times and holds scaled so that it lasts `wanted_s`."""
    lasts_s = max(((frame.at_s or 0.0) + frame.hold_s for frame in sequence.keyframes), default=0.0)
    if not lasts_s > 0.0:
        raise InputError("all times are 0 s: there is nothing to fit", path=sequence.path)
    ratio = wanted_s / lasts_s
    return replace(
        sequence,
        keyframes=tuple(
            replace(
                frame,
                at_s=None if frame.at_s is None else frame.at_s * ratio,
                hold_s=frame.hold_s * ratio,
            )
            for frame in sequence.keyframes
        ),
    )


def least_fit_s(sequence: Sequence, robot: Robot) -> float:
    """Return the least duration at which nothing must be slowed."""

    def is_feasible(duration_s: float) -> bool:
        layout = laid_out(scaled(sequence, duration_s), robot)
        is_authored = np.array_equal(layout.spacing.path_s, layout.spacing.authored_s)
        return bool(is_authored and not strained(layout.task({})).any())

    high_s = sequence.fit_duration_s or 0.0
    while not is_feasible(high_s):
        high_s *= 2.0
    low_s = 0.5 * high_s
    for _ in range(FIT_STEPS):
        middle_s = 0.5 * (low_s + high_s)
        low_s, high_s = (low_s, middle_s) if is_feasible(middle_s) else (middle_s, high_s)
    return math.ceil(high_s * 1000.0) / 1000.0
