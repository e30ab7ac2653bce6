"""A joint that is at its acceleration limit for long is planned with a reserve, others are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lss_motion.perform import perform
from lss_motion.program import compile as compiling
from lss_motion.program.compile import compile_program
from lss_motion.robot.model import Bus, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sequence.model import Keyframe, Sequence, Timing
from lss_motion.trajectory import reserve
from lss_motion.trajectory.tracks import planned_track
from tests.joints import joint

HORN_DEG = 1.5


def robot_with(model="LSS-ST1", accel_max_deg_s2=600.0):
    bus = Bus(name="main", port="sim://", baud_bps=115_200, firmware=370)
    jaw = joint("jaw", model=SERVO_MODELS[model], accel_max_deg_s2=accel_max_deg_s2)
    return Robot(name="talker", path=Path("r.yaml"), buses={"main": bus}, joints={"jaw": jaw})


def jaw(keys, gap_s=0.15, deg=30.0, **fields):
    frames = [Keyframe(at_s=round(gap_s * k, 3), deg={"jaw": deg * (k % 2)}) for k in range(keys)]
    return Sequence(name="jaw", keyframes=tuple(frames), **fields)


@pytest.fixture
def unreserved(monkeypatch):
    """Return what plans without any reserve."""

    def planned(sequence, robot):
        with monkeypatch.context() as patch:
            patch.setattr(reserve, "RELENTLESS_S", 1e6)
            return planned_track(sequence, robot)

    return planned


def accel_used(trajectory, robot):
    times_s = np.arange(0.01, trajectory.duration_s, 0.01)
    return np.abs(trajectory.sample(times_s, 2)[:, 0]) / robot.joints["jaw"].accel_max_deg_s2


def test_a_joint_at_its_limit_for_half_a_minute_stays_with_its_plan():
    robot = robot_with("LSS-P-S1")
    trajectory = planned_track(jaw(67), robot)
    program = compile_program(trajectory, robot)
    result = perform(program, robot, is_virtual=True, seed=1, trajectory=trajectory)
    assert trajectory.duration_s > 25.0
    assert result.report.outcome == "finished"
    assert not result.report.faults
    times_s, horn_deg = result.truth.times_s, result.truth.horn_deg[:, 0]
    off_deg = np.abs(horn_deg - trajectory.sample(times_s)[:, 0])
    assert off_deg.max() < HORN_DEG


@pytest.mark.parametrize("timing", [Timing.AUTHORED, Timing.FASTEST])
def test_long_motions_have_a_reserve_and_short_ones_are_exact(unreserved, timing):
    robot = robot_with()
    for keys, is_long in ((5, False), (30, True)):
        show = jaw(keys, timing=timing)
        if timing is Timing.FASTEST:
            frames = tuple(replace(frame, at_s=None) for frame in show.keyframes)
            show = replace(show, keyframes=frames)
        own, other = planned_track(show, robot), unreserved(show, robot)
        share = np.median(accel_used(own, robot))
        assert share == pytest.approx(0.98 if is_long else 1.0, abs=0.01)
        ratio = own.duration_s / other.duration_s
        assert 1.005 < ratio < 1.012 if is_long else ratio == 1.0


@pytest.mark.parametrize(("loop", "share"), [(2, 1.0), (40, 0.98), (None, 0.98)])
def test_short_passes_have_a_reserve_where_they_are_repeated_for_long(loop, share):
    robot = robot_with()
    trajectory = planned_track(jaw(3, loop=loop), robot)
    cycle = trajectory.middle
    times_s = np.arange(0.01, cycle.duration_s, 0.01)
    used = np.abs(cycle.sample(times_s, 2)[:, 0]) / 600.0
    assert np.median(used) == pytest.approx(share, abs=0.004)


def test_an_anchor_that_all_of_the_limit_meets_is_not_missed_for_a_reserve(unreserved):
    robot = robot_with()
    show = jaw(12)
    least_s = unreserved(show, robot).duration_s
    last = Keyframe(at_s=least_s + 0.01, deg={"jaw": 30.0}, is_anchor=True)
    show = replace(show, keyframes=(*show.keyframes[:-1], last))
    trajectory = planned_track(show, robot)
    assert trajectory.marks[-1].planned_s == pytest.approx(last.at_s, abs=0.001)
    assert planned_track(replace(show, loop=1), robot).duration_s < least_s * 1.005


def test_moves_that_lose_their_plan_are_chosen_again_at_another_tolerance(monkeypatch):
    robot = robot_with("LSS-HS1", accel_max_deg_s2=900.0)
    trajectory = planned_track(jaw(100, gap_s=0.1), robot)
    with monkeypatch.context() as patch:
        patch.setattr(compiling, "RECOVERY_RATIOS", ())
        assert compile_program(trajectory, robot).bound_deg["jaw"] > 4.0
    assert compile_program(trajectory, robot).bound_deg["jaw"] < 1.3
