"""Making up for lateness: how often it solves, and that it is on time behind slow parts."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.planning.trajectory import catch_up
from lss_motion.planning.trajectory.tracks import planned_track
from lss_motion.show.model import Interpolation, Keyframe, Sequence
from tests.property.test_lateness import any_show

SHOWS = 40
SOLVES_PER_WINDOW = 2.5
"""As fast as possible, at the pace of the author, and with the keys at that pace."""


def test_a_slow_part_is_solved_few_times(monkeypatch) -> None:
    solves = windows = 0
    solve, made_up = catch_up.solve, catch_up._Sweep.run

    def counted(*args, **kwargs):
        nonlocal solves
        solves += 1
        return solve(*args, **kwargs)

    def run(self):
        nonlocal windows
        found = made_up(self)
        windows += len(found)
        return found

    monkeypatch.setattr(catch_up, "solve", counted)
    monkeypatch.setattr(catch_up._Sweep, "run", run)
    for seed in range(SHOWS):
        planned_track(*any_show(seed))
    assert windows > 0.5 * SHOWS, solves
    assert solves <= SOLVES_PER_WINDOW * windows, windows


@pytest.mark.parametrize("gap_s", [0.3, 0.5, 0.7, 0.9, 1.1])
def test_slow_parts_that_follow_closely_leave_no_lateness(gap_s) -> None:
    _, robot = any_show(2)
    name = next(iter(robot.joints))
    robot = replace(robot, joints={name: robot.joints[name]})
    step_deg = 0.35 * robot.joints[name].accel_max_deg_s2 * 0.2**2
    at_s, frames, deg = 0.0, [Keyframe(at_s=0.0, deg={name: 0.0})], 0.0
    for _ in range(6):
        frames.append(Keyframe(at_s=at_s + gap_s, deg={name: deg}))
        at_s, deg = at_s + gap_s + 0.2, step_deg - deg
        frames.append(Keyframe(at_s=at_s, deg={name: deg}))
    frames.append(Keyframe(at_s=at_s + 4.0, deg={name: 0.0}))
    trajectory = planned_track(Sequence(name="steps", keyframes=tuple(frames)), robot)
    late_s = np.array([mark.planned_s - (mark.authored_s or 0.0) for mark in trajectory.marks])
    assert late_s.min() > -1e-6
    assert late_s[1:-1].max() > 0.02
    assert late_s[-1] < 1e-5


def test_an_anchor_is_met_that_is_passed_faster_than_authored() -> None:
    """The motion is ahead of the curve behind it, and on time at the next key again."""
    _, robot = any_show(2)
    joint = next(iter(robot.joints.values()))
    joint = replace(
        joint,
        speed_max_deg_s=101.0,
        accel_max_deg_s2=330.0,
        position_min_deg=-90.0,
        position_max_deg=90.0,
    )
    robot = replace(robot, joints={joint.name: joint})
    keys = (
        (0.0, 0.0),
        (1.497, -1.9),
        (2.311, -8.9),
        (2.8655, 44.7),
        (4.348, -19.6),
        (5.836, -16.2),
    )
    frames = tuple(
        Keyframe(
            at_s=at_s,
            deg={joint.name: deg},
            ease=Interpolation.SPLINE if at_s else Interpolation.SMOOTH,
            is_anchor=deg in (-8.9, 44.7),
        )
        for at_s, deg in keys
    )
    trajectory = planned_track(Sequence(name="swing", keyframes=frames), robot)
    late_s = np.array([mark.planned_s - mark.authored_s for mark in trajectory.marks])
    assert np.abs(late_s).max() < 1e-3
