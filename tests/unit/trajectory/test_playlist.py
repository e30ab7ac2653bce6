"""Play lists: steps, the moves between them, pauses and loops."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import PlaylistStep, Sequence
from tests.unit.trajectory.shows import at, blink, show


def test_steps_follow_one_another_with_their_pauses(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    listed = Sequence(
        name="list",
        play=(
            PlaylistStep(sequence=lift),
            PlaylistStep(pause_s=2.0),
            PlaylistStep(sequence=blink(frame)),
            PlaylistStep(sequence=lift, move_s=1.5),
        ),
    )
    robot = make_robot()
    trajectory = plan(listed, robot)
    verify(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(1.0 + 2.0 + 1.0 + 1.5 + 1.0)
    assert at(trajectory, "base", 1.0, 2.5, 3.9, 5.5, 6.5) == pytest.approx([20, 20, 20, 0, 20])
    assert at(trajectory, "elbow", 0.5, 3.5, 5.0) == pytest.approx([0.0, 20.0, 0.0])
    assert at(trajectory, "base", 2.0, order=1) == 0.0
    reached = {mark.planned_s for mark in trajectory.marks}
    assert 3.5 in {round(planned_s, 9) for planned_s in reached}


def test_a_move_to_the_start_of_a_step_has_the_approach_speed(make_robot, frame):
    up = show(frame(0.0, base=60.0, hold_s=1.0), name="up")
    down = show(frame(0.0, base=0.0, hold_s=1.0), name="down")
    robot = replace(make_robot(), approach_speed_deg_s=30.0)
    trajectory = plan(
        Sequence(name="list", play=(PlaylistStep(sequence=up), PlaylistStep(sequence=down))), robot
    )
    assert trajectory.duration_s == pytest.approx(2.0 + 1.5 * 60.0 / 30.0)
    speeds = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 5000), 1)
    assert np.abs(speeds).max() == pytest.approx(30.0, rel=1e-3)


def test_a_step_that_returns_is_repeated_without_a_stop(make_robot, frame):
    sway = show(
        frame(0.0, base=0.0), frame(1.0, base=20.0), frame(3.0, base=-20.0), frame(4.0, base=0.0)
    )
    trajectory = plan(
        Sequence(name="list", play=(PlaylistStep(sequence=sway, times=3),)), make_robot()
    )
    assert trajectory.duration_s == pytest.approx(12.0)
    assert at(trajectory, "base", 4.0, 8.0, order=1) == pytest.approx(20.0)


def test_a_step_that_does_not_return_is_brought_back_before_each_repeat(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    robot = make_robot()
    trajectory = plan(
        Sequence(name="list", play=(PlaylistStep(sequence=lift, times=2, move_s=0.8),)), robot
    )
    verify(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(2.8)
    assert at(trajectory, "base", 1.0, 1.8, 2.8) == pytest.approx([20.0, 0.0, 20.0])


def test_a_looped_list_returns_to_its_start(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    listed = Sequence(name="list", play=(PlaylistStep(sequence=lift),), loop=None)
    robot = replace(make_robot(), approach_speed_deg_s=30.0)
    trajectory = plan(listed, robot)
    verify(trajectory, robot)
    assert trajectory.first.duration_s == pytest.approx(2.0)
    assert at(trajectory, "base", 20.0, 21.0, 22.0) == pytest.approx([0.0, 20.0, 0.0], abs=1e-9)


def test_lists_nest(make_robot, frame):
    inner = Sequence(
        name="inner", play=(PlaylistStep(sequence=blink(frame)), PlaylistStep(pause_s=0.5)), loop=2
    )
    outer = Sequence(
        name="outer",
        play=(PlaylistStep(sequence=inner, times=2), PlaylistStep(sequence=blink(frame))),
        speed_ratio=0.5,
    )  # fmt: skip
    trajectory = plan(outer, make_robot())
    assert trajectory.duration_s == pytest.approx(2.0 * (4 * 1.5 + 1.0))
    assert at(trajectory, "elbow", 1.0, 4.0, 13.0) == pytest.approx([20.0, 20.0, 20.0])


def test_the_verifier_finds_a_fault_in_a_part(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    trajectory = plan(Sequence(name="list", play=(PlaylistStep(sequence=lift),)), make_robot())
    with pytest.raises(PlanningError, match="speed"):
        verify(trajectory, make_robot(speed=20.0, accel=2000.0))
    whole = trajectory.first
    moved = replace(whole, parts=whole.parts * 2, starts_s=np.array([0.0, 1.0]),
                    poses_deg=np.tile(whole.poses_deg, (2, 1)), duration_s=2.0)  # fmt: skip
    with pytest.raises(PlanningError, match="base"):
        verify(replace(trajectory, first=moved, middle=moved, last=moved), make_robot())
