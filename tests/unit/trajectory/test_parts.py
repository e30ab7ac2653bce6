"""Tracks, play lists and layers: what is planned of several parts, and what joins them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lss_motion.errors import InputError, PlanningError
from lss_motion.sequence.model import Layer, Sequence, Step, Timing
from lss_motion.trajectory.planner import plan
from lss_motion.trajectory.verify import verify


def show(*frames, name="test", **more):
    return Sequence(name=name, keyframes=frames, **more)


def at(trajectory, joint, *times_s, order=0):
    column = trajectory.joints.index(joint)
    return trajectory.sample(np.array(times_s), order)[:, column]


def blink(frame, *, name="blink", joint="elbow", top=20.0, **more):
    """Up and down within 1 s."""
    return show(
        frame(0.0, **{joint: 0.0}),
        frame(0.5, **{joint: top}),
        frame(1.0, **{joint: 0.0}),
        name=name,
        **more,
    )


# speed


def test_a_speed_ratio_divides_authored_times(make_robot, frame):
    slow = show(frame(0.0, base=0.0), frame(1.0, base=30.0, hold_s=1.0), speed_ratio=0.5)
    trajectory = plan(slow, make_robot())
    assert trajectory.duration_s == pytest.approx(4.0)
    assert trajectory.marks[1].planned_s == pytest.approx(2.0)


def test_a_fastest_show_is_slowed_as_a_whole(make_robot, frame):
    frames = (frame(base=0.0), frame(base=30.0, hold_s=1.0), frame(base=0.0))
    quick = plan(show(*frames, timing=Timing.FASTEST), make_robot())
    slow = plan(show(*frames, timing=Timing.FASTEST, speed_ratio=0.5), make_robot())
    times_s = np.linspace(0.0, quick.duration_s, 50)
    assert slow.sample(2.0 * times_s) == pytest.approx(quick.sample(times_s), abs=1e-9)
    assert slow.marks[2].planned_s == pytest.approx(2.0 * quick.marks[2].planned_s)


# tracks


def test_a_track_is_not_slowed_by_another(make_robot, frame):
    hasty = show(
        frame(0.0, base=0.0), frame(0.2, base=100.0), frame(3.0, base=0.0), tracks=(blink(frame),)
    )
    robot = make_robot()
    trajectory = plan(hasty, robot)
    verify(trajectory, robot)
    assert trajectory.joints == ("base", "elbow")
    assert at(trajectory, "elbow", 0.5, 1.0, 2.0) == pytest.approx([20.0, 0.0, 0.0])
    assert at(trajectory, "elbow", 2.0, order=1) == 0.0
    assert trajectory.duration_s > 3.4
    assert {stretch.joint for stretch in trajectory.stretched} == {"base"}


def test_an_endless_track_is_played_as_often_as_it_fits(make_robot, frame):
    length = show(frame(0.0, base=0.0), frame(3.7, base=10.0), tracks=(blink(frame, loop=None),))
    trajectory = plan(length, make_robot())
    assert trajectory.duration_s == pytest.approx(3.7)
    assert at(trajectory, "elbow", 0.5, 1.5, 2.5, 3.0, 3.5) == pytest.approx([20, 20, 20, 0, 0])


@pytest.mark.parametrize("length_s", [0.4, 1.9])
def test_an_endless_track_is_played_once_at_least(make_robot, frame, length_s):
    track = show(
        frame(0.0, elbow=0.0), frame(0.5, elbow=10.0), frame(1.0, elbow=-10.0),
        frame(1.5, elbow=0.0), loop=None, name="sway",
    )  # fmt: skip
    whole = show(frame(0.0, base=0.0, hold_s=length_s), tracks=(track,))
    robot = make_robot()
    trajectory = plan(whole, robot)
    verify(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(max(1.5, length_s))
    assert at(trajectory, "elbow", 1.0, 1.5) == pytest.approx([-10.0, 0.0], abs=1e-6)


def test_endless_tracks_repeat_together_after_their_common_period(make_robot, frame):
    other = show(
        frame(0.0, base=0.0), frame(0.75, base=10.0), frame(1.5, base=0.0), loop=None, name="b"
    )
    robot = make_robot()
    trajectory = plan(Sequence(name="both", tracks=(blink(frame, loop=None), other)), robot)
    verify(trajectory, robot)
    assert math.isinf(trajectory.duration_s)
    assert trajectory.middle.duration_s == pytest.approx(3.0)
    times_s = np.linspace(0.0, 2.9, 30) + trajectory.first.duration_s
    later = trajectory.sample(times_s + 300.0)
    assert trajectory.sample(times_s) == pytest.approx(later, abs=1e-6)
    assert at(trajectory, "elbow", 300.5) == pytest.approx(20.0)
    assert at(trajectory, "base", 300.75) == pytest.approx(10.0)


def test_endless_tracks_that_never_meet_are_refused(make_robot, frame):
    odd = show(frame(0.0, base=0.0), frame(math.pi, base=0.0, hold_s=0.1), loop=None, name="odd")
    with pytest.raises(PlanningError, match=r"'blink' 1 s, 'odd' 3\.24159 s\) do not meet"):
        plan(Sequence(name="both", tracks=(blink(frame, loop=None), odd)), make_robot())


def test_a_loop_around_tracks_alone_is_refused(make_robot, frame):
    with pytest.raises(InputError, match="nothing to loop"):
        plan(Sequence(name="both", tracks=(blink(frame),), loop=2), make_robot())


def test_anchors_tie_tracks_together(make_robot, frame):
    late = show(
        frame(0.0, elbow=0.0), frame(0.2, elbow=100.0, anchor=True, label="beat"), name="late"
    )
    with pytest.raises(PlanningError, match="anchor 'beat'"):
        plan(show(frame(0.0, base=0.0), tracks=(late,)), make_robot())


@pytest.mark.parametrize("part", ["tracks", "play", "layers"])
def test_a_track_holds_nothing_but_keyframes(make_robot, frame, part):
    inner = {
        "tracks": (blink(frame),),
        "play": (Step(pause_s=1.0),),
        "layers": (Layer(sequence=blink(frame), joints=("elbow",)),),
    }
    track = replace(blink(frame), **{part: inner[part]})
    with pytest.raises(InputError, match="nothing else"):
        plan(Sequence(name="both", tracks=(track,)), make_robot())


# play lists


def test_steps_follow_one_another_with_their_pauses(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    listed = Sequence(
        name="list",
        play=(
            Step(sequence=lift),
            Step(pause_s=2.0),
            Step(sequence=blink(frame)),
            Step(sequence=lift, move_s=1.5),
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


def test_the_way_to_a_step_is_gone_at_the_approach_speed(make_robot, frame):
    up = show(frame(0.0, base=60.0, hold_s=1.0), name="up")
    down = show(frame(0.0, base=0.0, hold_s=1.0), name="down")
    robot = replace(make_robot(), approach_speed_deg_s=30.0)
    trajectory = plan(Sequence(name="list", play=(Step(sequence=up), Step(sequence=down))), robot)
    assert trajectory.duration_s == pytest.approx(2.0 + 1.5 * 60.0 / 30.0)
    speeds = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 5000), 1)
    assert np.abs(speeds).max() == pytest.approx(30.0, rel=1e-3)


def test_a_step_that_returns_is_repeated_without_a_stop(make_robot, frame):
    sway = show(
        frame(0.0, base=0.0), frame(1.0, base=20.0), frame(3.0, base=-20.0), frame(4.0, base=0.0)
    )
    trajectory = plan(Sequence(name="list", play=(Step(sequence=sway, times=3),)), make_robot())
    assert trajectory.duration_s == pytest.approx(12.0)
    assert at(trajectory, "base", 4.0, 8.0, order=1) == pytest.approx(20.0)


def test_a_step_that_does_not_return_is_brought_back_before_each_repeat(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    robot = make_robot()
    trajectory = plan(
        Sequence(name="list", play=(Step(sequence=lift, times=2, move_s=0.8),)), robot
    )
    verify(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(2.8)
    assert at(trajectory, "base", 1.0, 1.8, 2.8) == pytest.approx([20.0, 0.0, 20.0])


def test_a_looped_list_returns_to_its_start(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    listed = Sequence(name="list", play=(Step(sequence=lift),), loop=None)
    robot = replace(make_robot(), approach_speed_deg_s=30.0)
    trajectory = plan(listed, robot)
    verify(trajectory, robot)
    assert trajectory.first.duration_s == pytest.approx(2.0)
    assert at(trajectory, "base", 20.0, 21.0, 22.0) == pytest.approx([0.0, 20.0, 0.0], abs=1e-9)


def test_lists_nest(make_robot, frame):
    inner = Sequence(name="inner", play=(Step(sequence=blink(frame)), Step(pause_s=0.5)), loop=2)
    outer = Sequence(
        name="outer", play=(Step(sequence=inner, times=2), Step(sequence=blink(frame))),
        speed_ratio=0.5,
    )  # fmt: skip
    trajectory = plan(outer, make_robot())
    assert trajectory.duration_s == pytest.approx(2.0 * (4 * 1.5 + 1.0))
    assert at(trajectory, "elbow", 1.0, 4.0, 13.0) == pytest.approx([20.0, 20.0, 20.0])


def test_a_part_that_is_broken_is_found_by_the_verifier(make_robot, frame):
    lift = show(frame(0.0, base=0.0), frame(1.0, base=20.0), name="lift")
    trajectory = plan(Sequence(name="list", play=(Step(sequence=lift),)), make_robot())
    with pytest.raises(PlanningError, match="speed"):
        verify(trajectory, make_robot(speed=20.0, accel=2000.0))
    whole = trajectory.first
    moved = replace(whole, parts=whole.parts * 2, starts_s=np.array([0.0, 1.0]),
                    poses_deg=np.tile(whole.poses_deg, (2, 1)), duration_s=2.0)  # fmt: skip
    with pytest.raises(PlanningError, match="base"):
        verify(replace(trajectory, first=moved, middle=moved, last=moved), make_robot())


# layers


def base_show(frame, **more):
    return show(
        frame(0.0, base=0.0, elbow=0.0), frame(4.0, base=60.0, elbow=0.0),
        frame(8.0, base=0.0, elbow=0.0), name="base", **more,
    )  # fmt: skip


def layer_of(sequence, *joints, **more):
    return Layer(sequence=sequence, joints=joints, **more)


def test_an_added_layer_is_the_sum_by_its_weight(make_robot, frame):
    top = layer_of(blink(frame, joint="base"), "base", mode="add", weight=0.5, from_s=2.0)
    robot = make_robot()
    plain = plan(base_show(frame), robot)
    trajectory = plan(base_show(frame, layers=(top,)), robot)
    verify(trajectory, robot)
    times_s = np.linspace(0.0, 8.0, 400)
    added = 0.5 * plan(blink(frame, joint="base"), robot).sample(times_s - 2.0)[:, 0]
    wanted = at(plain, "base", *times_s) + added
    assert at(trajectory, "base", *times_s) == pytest.approx(wanted, abs=1e-4)
    assert added.max() > 9.0
    assert trajectory.stretched == ()


def test_an_overriding_layer_fades_in_and_out(make_robot, frame):
    still = show(frame(0.0, base=-30.0, hold_s=9.0), name="still")
    top = layer_of(still, "base", from_s=2.0, to_s=6.0, fade_s=1.0)
    robot = make_robot()
    trajectory = plan(base_show(frame, layers=(top,)), robot)
    plain = plan(base_show(frame), robot)
    verify(trajectory, robot)
    for at_s in (0.5, 2.0, 6.0, 7.5):
        assert at(trajectory, "base", at_s) == pytest.approx(at(plain, "base", at_s), abs=1e-6)
    assert at(trajectory, "base", 3.0, 4.0, 5.0) == pytest.approx([-30.0] * 3, abs=1e-6)
    middle = 0.5 * (at(plain, "base", 2.5) - 30.0)
    assert at(trajectory, "base", 2.5) == pytest.approx(middle, abs=1e-4)


def test_a_mask_leaves_the_other_joints_alone(make_robot, frame):
    both = show(
        frame(0.0, base=-30.0, elbow=0.0), frame(1.0, base=9.0, elbow=20.0),
        frame(2.0, base=0.0, elbow=0.0), name="both",
    )  # fmt: skip
    trajectory = plan(base_show(frame, layers=(layer_of(both, "elbow", from_s=1.0),)), make_robot())
    assert at(trajectory, "elbow", 2.0) == pytest.approx(20.0, abs=1e-6)
    plain = plan(base_show(frame), make_robot())
    times_s = np.linspace(0.0, 8.0, 50)
    assert at(trajectory, "base", *times_s) == pytest.approx(at(plain, "base", *times_s), abs=1e-6)


def test_the_limits_hold_for_the_sum_and_only_there_it_is_slower(make_robot, frame):
    shake = show(frame(0.0, base=0.0), frame(0.6, base=40.0), frame(1.2, base=0.0), name="shake")
    top = layer_of(shake, "base", mode="add", from_s=1.5)
    robot = make_robot(speed=110.0, accel=700.0)
    assert not plan(shake, robot).stretched
    trajectory = plan(base_show(frame, layers=(top,)), robot)
    verify(trajectory, robot)
    assert trajectory.stretched
    assert all(1.4 < s.from_s < s.to_s < 3.2 for s in trajectory.stretched)
    assert trajectory.duration_s == pytest.approx(8.0 + sum(s.by_s for s in trajectory.stretched))


def test_a_layer_that_makes_an_anchor_late_is_refused(make_robot, frame):
    shake = show(frame(0.0, base=0.0), frame(0.6, base=40.0), frame(1.2, base=0.0))
    frames = list(base_show(frame).keyframes)
    frames[1] = frame(4.0, base=60.0, elbow=0.0, anchor=True, label="beat")
    top = layer_of(shake, "base", mode="add", from_s=1.5)
    with pytest.raises(PlanningError, match=r"anchor 'beat' at 4 s cannot be met with the layers"):
        plan(show(*frames, layers=(top,)), make_robot(speed=110.0, accel=700.0))


@pytest.mark.parametrize("fade_s", [0.0, 0.5])
def test_a_layer_may_not_make_a_joint_jump(make_robot, frame, fade_s):
    still = show(frame(0.0, base=-30.0, hold_s=9.0), name="still")
    top = layer_of(still, "base", from_s=2.0, to_s=6.0, fade_s=fade_s)
    layered = base_show(frame, layers=(top,))
    if fade_s == 0.0:
        with pytest.raises(InputError, match=r"'still' would make joint 'base' jump .* fade_s"):
            plan(layered, make_robot())
    else:
        assert plan(layered, make_robot()).duration_s >= 8.0


def test_a_sum_that_leaves_the_range_is_refused(make_robot, frame):
    top = layer_of(blink(frame, joint="base", top=40.0), "base", mode="add", from_s=3.5)
    with pytest.raises(PlanningError, match=r"'base' would be at .* allowed -80 to 80 deg"):
        plan(base_show(frame, layers=(top,)), make_robot(reach=80.0))


def test_an_offset_may_be_larger_than_the_range(make_robot, frame):
    low = show(frame(0.0, base=-70.0), frame(8.0, base=-70.0), name="low")
    far = show(frame(0.0, base=0.0), frame(4.0, base=140.0), frame(8.0, base=0.0), name="far")
    robot = make_robot(reach=80.0)
    trajectory = plan(replace(low, layers=(layer_of(far, "base", mode="add"),)), robot)
    assert at(trajectory, "base", 4.0) == pytest.approx(70.0, abs=1e-6)


@pytest.mark.parametrize("accel", [554.1776932524632, 970.3760891395077])
def test_a_layered_show_ends_at_rest_whatever_its_length(make_robot, frame, accel):
    """Found by the property tests: an end that rounding had moved past the last knot."""
    robot = make_robot(speed=3.6, accel=accel)
    late = show(frame(0.0, base=0.0), frame(0.0, base=30.0))
    top = layer_of(show(frame(0.0, base=0.0)), "base", weight=0.0, to_s=4.0, fade_s=0.05)
    trajectory = plan(replace(late, layers=(top,)), robot)
    assert at(trajectory, "base", trajectory.duration_s) == pytest.approx(30.0, abs=1e-9)


def test_an_endless_layer_lasts_as_long_as_the_show(make_robot, frame):
    top = layer_of(blink(frame, top=9.0, loop=None), "elbow", mode="add", fade_s=0.5)
    robot = make_robot()
    trajectory = plan(base_show(frame, layers=(top,)), robot)
    verify(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(8.0)
    assert at(trajectory, "elbow", 0.5, 6.5) == pytest.approx([9.0, 9.0], abs=1e-3)
    assert at(trajectory, "elbow", 8.0) == pytest.approx(0.0, abs=1e-9)


def test_layers_lie_on_tracks_and_lists_too(make_robot, frame):
    tracked = show(frame(0.0, base=0.0), frame(2.0, base=30.0), tracks=(blink(frame, loop=2),))
    listed = Sequence(name="list", play=(Step(sequence=tracked), Step(pause_s=1.0)))
    nod = show(frame(0.0, base=0.0), frame(1.0, base=10.0), frame(2.0, base=0.0), name="nod")
    robot = make_robot()
    trajectory = plan(
        replace(listed, layers=(layer_of(nod, "base", mode="add", from_s=0.5),)), robot
    )
    verify(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(3.0)
    plain = plan(listed, robot)
    assert at(trajectory, "base", 1.5) == pytest.approx(at(plain, "base", 1.5) + 10.0, abs=1e-4)
    assert at(trajectory, "elbow", 0.5) == pytest.approx(20.0, abs=1e-4)


def test_a_layered_plan_is_remembered(make_robot, frame, monkeypatch):
    top = layer_of(blink(frame, joint="base"), "base", mode="add", from_s=2.0, fade_s=0.2)
    first = plan(base_show(frame, layers=(top,)), make_robot())
    monkeypatch.setattr("lss_motion.trajectory.layers.verify", None)
    monkeypatch.setattr("lss_motion.trajectory.layers.slowed_windows", None)
    again = plan(base_show(frame, layers=(top,)), make_robot())
    times_s = np.linspace(0.0, 8.0, 99)
    assert np.array_equal(first.sample(times_s), again.sample(times_s))
