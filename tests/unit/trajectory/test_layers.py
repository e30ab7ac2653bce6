"""Layers on top of a show."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.playlist import all_cues
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Cue, Layer, PlaylistStep, Sequence
from tests.unit.trajectory.shows import at, blink, show


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


def test_a_sum_is_slowed_only_where_it_exceeds_a_limit(make_robot, frame):
    shake = show(frame(0.0, base=0.0), frame(0.6, base=40.0), frame(1.2, base=0.0), name="shake")
    top = layer_of(shake, "base", mode="add", from_s=1.5)
    robot = make_robot(speed=101.0, accel=700.0)
    assert not plan(shake, robot).stretched
    trajectory = plan(base_show(frame, layers=(top,)), robot)
    verify(trajectory, robot)
    assert trajectory.stretched
    assert all(1.4 < s.from_s < s.to_s < 3.2 for s in trajectory.stretched)
    assert trajectory.duration_s == pytest.approx(8.0)


def test_a_layer_that_is_late_itself_names_its_slow_spans(make_robot, frame):
    jaw = show(frame(0.0, elbow=0.0), frame(0.1, elbow=100.0), frame(0.2, elbow=0.0), name="jaw")
    robot = make_robot()
    alone = plan(jaw, robot)
    trajectory = plan(base_show(frame, layers=(layer_of(jaw, "elbow", from_s=2.0),)), robot)
    assert alone.stretched
    assert {span.joint for span in trajectory.stretched} == {"elbow"}
    for own in alone.stretched:
        wanted = pytest.approx((2.0 + own.from_s, 2.0 + own.to_s, own.by_s), abs=0.005)
        assert wanted in [(span.from_s, span.to_s, span.by_s) for span in trajectory.stretched]


@pytest.mark.parametrize("may_shrink", [False, True])
def test_a_sum_that_is_late_keeps_the_holds_below_it(make_robot, frame, may_shrink):
    below = show(
        frame(0.0, base=0.0),
        frame(2.0, base=60.0, hold_s=1.0, may_shrink=may_shrink, label="up"),
        frame(6.0, base=0.0),
    )
    shake = show(frame(0.0, base=0.0), frame(0.6, base=40.0), frame(1.2, base=0.0), name="shake")
    top = layer_of(shake, "base", mode="add", from_s=0.8)
    trajectory = plan(replace(below, layers=(top,)), make_robot(speed=75.0, accel=700.0))
    (up,) = [mark for mark in trajectory.marks if mark.label == "up"]
    late_s = up.planned_s - 2.0
    assert late_s > 0.05
    assert up.held_s == pytest.approx(1.0 - late_s if may_shrink else 1.0, abs=1e-6)


def test_a_layer_that_makes_an_anchor_late_is_refused(make_robot, frame):
    shake = show(frame(0.0, base=0.0), frame(0.6, base=40.0), frame(1.2, base=0.0))
    frames = list(base_show(frame).keyframes)
    frames[1] = frame(4.0, base=60.0, elbow=0.0, anchor=True, label="beat")
    top = layer_of(shake, "base", mode="add", from_s=2.8)
    late, robot = show(*frames, layers=(top,)), make_robot(speed=75.0, accel=700.0)
    words = (
        r"anchor 'beat' at 4 s cannot be met with the layers, .* late; write `speed_ratio: (.*?)`"
    )
    with pytest.raises(PlanningError, match=words) as caught:
        plan(late, robot)
    ratio = float(re.search(words, str(caught.value))[1])
    for speed_ratio in (ratio, 0.7 * ratio):
        (beat,) = [
            mark
            for mark in plan(replace(late, speed_ratio=speed_ratio), robot).marks
            if mark.label == "beat"
        ]
        assert beat.planned_s == pytest.approx(4.0 / speed_ratio, abs=1e-3)
    with pytest.raises(PlanningError, match=r"late; write"):
        plan(replace(late, speed_ratio=ratio + 0.01), robot)


@pytest.mark.parametrize("fade_s", [0.0, 0.5])
def test_a_layer_that_makes_a_joint_jump_is_refused(make_robot, frame, fade_s):
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
    layered = replace(base_show(frame, layers=(top,)), path=Path("top.yaml"))
    reason = r"top.yaml: with the layers, joint 'base' would be at .* allowed -80 to 80 deg. Lower"
    with pytest.raises(PlanningError, match=reason):
        plan(layered, make_robot(reach=80.0))


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


def endless_sway(frame, **more):
    return show(
        frame(0.0, base=0.0), frame(1.0, base=30.0), frame(3.0, base=-30.0), frame(4.0, base=0.0),
        name="sway", loop=None, **more,
    )  # fmt: skip


def test_a_layer_that_ends_is_played_once_on_a_show_that_never_ends(make_robot, frame):
    nod = show(frame(0.0, elbow=0.0), frame(1.0, elbow=20.0), frame(2.0, elbow=0.0), name="nod")
    nod = replace(nod, events=(Cue(at_s=1.0, say="nod"),))
    top = layer_of(nod, "elbow", from_s=5.0)
    robot = make_robot()
    events = (Cue(at_s=3.0, say="sway"),)
    trajectory = plan(endless_sway(frame, layers=(top,), events=events), robot)
    verify(trajectory, robot, has_parts=False)
    assert math.isinf(trajectory.duration_s)
    plain = plan(endless_sway(frame), robot)
    times_s = np.linspace(0.0, 100.0, 1001)
    assert at(trajectory, "base", *times_s) == pytest.approx(at(plain, "base", *times_s), abs=1e-4)
    assert at(trajectory, "elbow", 6.0) == pytest.approx(20.0, abs=1e-4)
    assert at(trajectory, "elbow", *times_s[80:]) == pytest.approx(0.0, abs=1e-9)
    said = [(cue.say, round(cue.at_s, 3)) for cue in all_cues(trajectory, 30.0)]
    assert said[:6] == [
        ("sway", 3.0), ("nod", 6.0), ("sway", 7.0), ("sway", 11.0), ("sway", 15.0), ("sway", 19.0)
    ]  # fmt: skip
    program = compile_program(trajectory, robot)
    assert program.is_endless


def test_an_endless_layer_repeats_with_an_endless_show(make_robot, frame):
    fast = show(
        frame(0.0, base=0.0), frame(0.75, base=8.0), frame(1.5, base=0.0), name="b", loop=None
    )
    top = layer_of(fast, "base", mode="add", from_s=0.5, fade_s=1.0)
    robot = make_robot()
    trajectory = plan(endless_sway(frame, layers=(top,)), robot)
    verify(trajectory, robot, has_parts=False)
    assert trajectory.middle.duration_s == pytest.approx(12.0)
    plain, added = plan(endless_sway(frame), robot), plan(fast, robot)
    times_s = np.linspace(20.0, 200.0, 1801)
    wanted = np.array(at(plain, "base", *times_s)) + np.array(at(added, "base", *(times_s - 0.5)))
    assert at(trajectory, "base", *times_s) == pytest.approx(wanted, abs=1e-3)


def test_limits_hold_where_layers_make_an_endless_show_too_fast(make_robot, frame):
    hard = show(frame(0.0, base=0.0), frame(0.25, base=40.0), frame(1.5, base=0.0), name="hard")
    top = layer_of(hard, "base", mode="add", from_s=1.0)
    robot = make_robot()
    trajectory = plan(endless_sway(frame, layers=(top,)), robot)
    verify(trajectory, robot, has_parts=False)
    assert trajectory.stretched
    assert trajectory.middle.duration_s == pytest.approx(4.0, abs=1e-3)


def test_an_endless_show_and_a_layer_that_never_meet_are_refused(make_robot, frame):
    odd = show(frame(0.0, elbow=0.0), frame(math.pi, elbow=0.0, hold_s=0.1), loop=None, name="odd")
    with pytest.raises(PlanningError, match="the show and its layers loop forever, but"):
        plan(endless_sway(frame, layers=(layer_of(odd, "elbow"),)), make_robot())


def test_layers_on_endless_tracks_that_never_rest_are_refused(make_robot, frame):
    turn = show(
        frame(0.0, base=0.0), frame(1.0, base=30.0), frame(3.0, base=-30.0), frame(4.0, base=0.0),
        loop=None, name="turn",
    )  # fmt: skip
    both = Sequence(name="both", tracks=(turn,), layers=(layer_of(blink(frame), "elbow"),))
    with pytest.raises(InputError, match="tracks of 'both' never rest together"):
        plan(both, make_robot())


def test_layers_can_be_on_top_of_tracks_and_play_lists(make_robot, frame):
    tracked = show(frame(0.0, base=0.0), frame(2.0, base=30.0), tracks=(blink(frame, loop=2),))
    listed = Sequence(name="list", play=(PlaylistStep(sequence=tracked), PlaylistStep(pause_s=1.0)))
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


def test_a_layered_plan_is_loaded_from_the_cache(make_robot, frame, monkeypatch):
    top = layer_of(blink(frame, joint="base"), "base", mode="add", from_s=2.0, fade_s=0.2)
    first = plan(base_show(frame, layers=(top,)), make_robot())
    monkeypatch.setattr("lss_motion.planning.trajectory.layers.verify", None)
    monkeypatch.setattr("lss_motion.planning.trajectory.layers.timed_windows", None)
    again = plan(base_show(frame, layers=(top,)), make_robot())
    times_s = np.linspace(0.0, 8.0, 99)
    assert np.array_equal(first.sample(times_s), again.sample(times_s))
