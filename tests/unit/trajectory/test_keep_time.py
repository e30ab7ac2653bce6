"""Joints that keep their time: limits, exact keys, weights, loops, other joints that are late."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Cue, Layer, PlaylistStep, Timing
from tests.unit.trajectory.shows import at, show, trapezoid_s

BASE = frozenset({"base"})


def talk(frame, count=20, step_s=0.125, top=25.0, joint="base", **more):
    """Return a jaw that opens and closes: 4 Hz, where 1000 deg/s² allow 3.9 of 25 deg."""
    frames = [frame(0.0, **{joint: 0.0})]
    frames += [
        frame(1.0 + step_s * k, label=str(k), **{joint: top * (k % 2)}) for k in range(1, count + 1)
    ]
    frames.append(frame(2.0 + step_s * count, **{joint: 0.0}))
    return show(*frames, keeps_time=frozenset({joint}), **more)


def judged(trajectory, robot, passes_s=None):
    """Assert all limits from angles at 1 kHz, by differences; return the angles.

    What toppra has slowed may exceed them by 0.1 %, what keeps its time by rounding only.
    """
    kept = {span.joint for span in trajectory.given_up}
    end_s = passes_s or trajectory.duration_s
    times_s = np.arange(-3, int(end_s * 1000.0) + 4) * 0.001
    deg = trajectory.sample(times_s)
    for column, name in enumerate(trajectory.joints):
        joint, own = robot.joints[name], deg[:, column]
        assert own.min() >= joint.position_min_deg - 1e-6
        assert own.max() <= joint.position_max_deg + 1e-6
        speed, accel = (np.abs(np.diff(own, order)).max() for order in (1, 2))
        slack = 1e-4 if name in kept else 1e-3
        assert speed <= joint.speed_max_deg_s * 1e-3 * (1.0 + slack)
        assert accel <= joint.accel_max_deg_s2 * 1e-6 * (1.0 + slack)
    return deg


def test_a_feasible_motion_is_the_same_with_and_without(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(1.5, base=60.0), frame(4.0, base=0.0, hold_s=1.0)]
    robot = make_robot()
    kept, usual = (plan(show(*frames, keeps_time=own), robot) for own in (BASE, frozenset()))
    times_s = np.linspace(0.0, 5.0, 2001)
    assert np.array_equal(kept.sample(times_s), usual.sample(times_s))
    assert kept.given_up == ()


@pytest.mark.parametrize("step_s", [0.2, 0.125, 0.08])
def test_a_jaw_that_is_too_fast_keeps_its_time_and_its_limits(make_robot, frame, step_s):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    sequence = talk(frame, step_s=step_s)
    trajectory = plan(sequence, robot)
    assert trajectory.duration_s == pytest.approx(2.0 + 20 * step_s, abs=1e-9)
    assert [mark.planned_s for mark in trajectory.marks] == pytest.approx(
        [keyframe.at_s for keyframe in sequence.keyframes], abs=1e-9
    )
    deg = judged(trajectory, robot)[:, 0]
    # Opening and closing within the limit, the angle can change by a/(16 f²) at most.
    possible_deg = 1000.0 / 16.0 * (2.0 * step_s) ** 2
    middle = deg[1000 + int(8 * step_s * 1000) : 1000 + int(12 * step_s * 1000)]
    assert np.ptp(middle) == pytest.approx(possible_deg, rel=0.05)
    assert 0.5 * (middle.min() + middle.max()) == pytest.approx(12.5, abs=0.2)
    (span,) = trajectory.given_up
    assert span.joint == "base"
    assert span.by_deg == pytest.approx(12.5 - 0.5 * possible_deg, abs=2.0)
    # It never closes while it talks: each closure is named.
    closures = [key for key in span.missed if key.asked_deg == 0.0]
    assert {key.label for key in closures} >= {str(k) for k in range(2, 20, 2)}
    for key in closures:
        assert key.given_deg == pytest.approx(at(trajectory, "base", key.at_s)[0], abs=0.01)


def test_exact_keys_keep_time_and_angle(make_robot, frame):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    sequence = talk(frame)
    frames = [
        replace(own, is_exact=own.label in {"6", "13"}, hold_s=0.05 if own.label == "13" else 0.0)
        for own in sequence.keyframes
    ]
    trajectory = plan(replace(sequence, keyframes=tuple(frames)), robot)
    judged(trajectory, robot)
    assert at(trajectory, "base", 1.75)[0] == pytest.approx(0.0, abs=1e-4)
    held = at(trajectory, "base", *np.linspace(2.625, 2.675, 21))
    assert held == pytest.approx(25.0, abs=0.011)


def test_an_exact_key_that_is_impossible_is_named_with_its_degrees(make_robot, frame, tmp_path):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    frames = [
        frame(0.0, base=0.0, line=3),
        replace(frame(0.1, base=25.0, label="ah", line=4), is_exact=True),
        frame(3.0, base=0.0, line=5),
    ]
    sequence = show(*frames, keeps_time=BASE, path=tmp_path / "jaw.yaml")
    with pytest.raises(PlanningError) as caught:
        plan(sequence, robot)
    # From rest at 1000 deg/s², 5 deg are possible in 0.1 s.
    assert "jaw.yaml:4: keyframe 'ah' cannot be exact" in str(caught.value)
    assert "misses 25 deg at 0.1 s by 20." in str(caught.value)
    assert (caught.value.joint, caught.value.time_s) == ("base", 0.1)


def test_a_weight_brings_the_jaw_closer_to_its_closures(make_robot, frame):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    sequence = talk(frame)
    off_deg = []
    for weight in (1.0, 10.0, 100.0):
        frames = [
            replace(own, weight=weight if own.deg["base"] == 0.0 else 1.0)
            for own in sequence.keyframes
        ]
        trajectory = plan(replace(sequence, keyframes=tuple(frames)), robot)
        judged(trajectory, robot)
        off_deg.append(at(trajectory, "base", *np.arange(1.5, 3.0, 0.25)).mean())
    assert off_deg[0] > 10.0
    assert off_deg[1] < 0.5 * off_deg[0]
    assert off_deg[2] < 0.5 * off_deg[1]


def test_the_motion_stays_in_its_range(make_robot, frame):
    """Without bounds on the angle a motion that arrives fast would swing beyond it."""
    robot = make_robot(1, speed=360.0, accel=300.0, reach=25.0)
    frames = [
        frame(0.0, base=0.0),
        frame(0.5, base=25.0),
        frame(0.7, base=-25.0, hold_s=0.5),
        frame(2.0, base=25.0),
        frame(2.1, base=25.0),
    ]
    judged(plan(show(*frames, keeps_time=BASE), robot), robot)


def test_a_spline_that_leaves_the_range_is_bent_back(make_robot, frame):
    robot = make_robot(1, speed=360.0, accel=1000.0, reach=25.0)
    frames = [frame(0.3 * k, ease="spline", base=deg) for k, deg in enumerate((0, 25, 25, -25, 0))]
    with pytest.raises(PlanningError, match="allowed -25"):
        plan(show(*frames), robot)
    judged(plan(show(*frames, keeps_time=BASE), robot), robot)


def test_a_last_key_that_cannot_be_reached_ends_at_rest_nearby(make_robot, frame):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    trajectory = plan(show(frame(0.0, base=0.0), frame(0.2, base=40.0), keeps_time=BASE), robot)
    assert trajectory.duration_s == pytest.approx(0.2)
    # In 0.2 s from rest to rest 10 deg are possible.
    assert judged(trajectory, robot)[-1, 0] == pytest.approx(10.0, rel=0.02)


def test_two_angles_at_one_instant_are_refused(make_robot, frame):
    frames = [frame(0.0, base=0.0, hold_s=1.0), frame(1.0, base=5.0), frame(2.0, base=0.0)]
    with pytest.raises(InputError, match="from 0 to 5 deg in no time"):
        plan(show(*frames, keeps_time=BASE), make_robot(1))


def test_without_times_there_is_nothing_to_keep(make_robot, frame):
    frames = [frame(base=0.0), frame(base=50.0)]
    with pytest.raises(InputError, match="keep: time needs the author's times"):
        plan(show(*frames, timing=Timing.FASTEST, keeps_time=BASE), make_robot(1))


def test_fit_is_met_whatever_it_costs(make_robot, frame):
    robot = make_robot(1)
    sequence = replace(talk(frame), timing=Timing.FIT, fit_duration_s=1.0)
    trajectory = plan(sequence, robot)
    assert trajectory.duration_s == pytest.approx(1.0)
    judged(trajectory, robot)


def both(frame, **more):
    """Return a show whose elbow is 0.5 s late from 1.0 s on, while the base talks."""
    base = talk(frame, count=8).keyframes
    frames = [replace(own, deg={**own.deg}) for own in base]
    frames[0] = replace(frames[0], deg={"base": 0.0, "elbow": 0.0})
    frames[3] = replace(frames[3], deg={**frames[3].deg, "elbow": 90.0}, label="reach")
    frames[4] = replace(frames[4], deg={**frames[4].deg, "elbow": 0.0})
    frames[-1] = replace(frames[-1], deg={"base": 0.0, "elbow": 0.0}, hold_s=1.0)
    return show(*frames, keeps_time=BASE, **more)


def test_other_joints_may_be_late_and_delay_nothing(make_robot, frame):
    robot = make_robot()
    trajectory = plan(both(frame), robot)
    judged(trajectory, robot)
    alone = plan(talk(frame, count=8), robot)
    times_s = np.linspace(0.0, 3.0, 601)
    assert at(trajectory, "base", *times_s) == pytest.approx(at(alone, "base", *times_s), abs=1e-9)
    late = trajectory.marks[4]
    assert late.planned_s - late.authored_s == pytest.approx(trapezoid_s(90.0) - 0.125, rel=0.02)
    assert at(trajectory, "elbow", late.planned_s)[0] == pytest.approx(0.0, abs=1e-6)
    assert trajectory.marks[5].planned_s == pytest.approx(trajectory.marks[5].authored_s)
    assert {span.joint for span in trajectory.stretched} == {"elbow"}
    assert {span.joint for span in trajectory.given_up} == {"base"}


def test_events_stay_where_the_author_put_them(make_robot, frame):
    cue = Cue(at_s=1.6, say="bang")
    kept = plan(both(frame, events=(cue,)), make_robot())
    assert kept.cues[0].at_s == pytest.approx(1.6)
    late = plan(replace(both(frame, events=(cue,)), keeps_time=frozenset()), make_robot())
    assert late.cues[0].at_s > 1.9


@pytest.mark.parametrize("loop", [2, 3, 5, None])
def test_a_loop_that_flows_keeps_its_limits_at_every_seam(make_robot, frame, loop):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    frames = [frame(0.11 * k, base=[0.0, 20.0, 0.0, -20.0][k % 4]) for k in range(13)]
    trajectory = plan(show(*frames, loop=loop, keeps_time=BASE), robot)
    assert trajectory.is_periodic
    assert trajectory.middle.duration_s == pytest.approx(1.32)
    deg = judged(trajectory, robot, None if loop else 6.6)
    assert np.abs(np.diff(deg[1320 - 50 : 1320 + 50, 0])).max() > 0.05, "it does not stop there"


def test_a_pass_waits_for_joints_that_are_late_at_its_end(make_robot, frame):
    robot = make_robot()
    frames = [
        frame(0.0, base=0.0, elbow=0.0),
        frame(0.2, base=20.0),
        frame(0.4, base=0.0),
        frame(0.5, elbow=90.0),
        frame(0.6, base=20.0),
        frame(1.0, base=0.0, elbow=0.0),
    ]
    trajectory = plan(show(*frames, loop=3, keeps_time=BASE), robot)
    pass_s = trajectory.first.duration_s
    assert pass_s > 1.2
    assert trajectory.duration_s == pytest.approx(3.0 * pass_s)
    judged(trajectory, robot)
    first = at(trajectory, "base", *np.linspace(0.0, 1.0, 201))
    later = at(trajectory, "base", *(pass_s + np.linspace(0.0, 1.0, 201)))
    assert later == pytest.approx(first, abs=1e-6)


def test_tracks_and_play_lists_carry_what_is_given_up(make_robot, frame):
    robot = make_robot()
    arm = show(frame(0.0, elbow=0.0), frame(1.0, elbow=20.0), frame(2.0, elbow=0.0), name="arm")
    whole = show(name="whole", tracks=(talk(frame, name="jaw"), arm))
    twice = show(
        name="list", play=(PlaylistStep(pause_s=1.0), PlaylistStep(sequence=whole, times=2))
    )
    trajectory = plan(twice, robot)
    own_s = plan(whole, robot).duration_s
    first, second = trajectory.given_up
    assert second.from_s - first.from_s == pytest.approx(own_s)
    assert second.missed[0].at_s - first.missed[0].at_s == pytest.approx(own_s)
    asked = trajectory.asked[1]
    assert (asked.from_s, asked.to_s) == (second.from_s, second.to_s)
    assert max(asked.deg) == pytest.approx(25.0, abs=0.5)
    judged(trajectory, robot)


def test_a_looped_part_of_a_talk_is_closed(make_robot, frame):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    sequence = talk(frame, count=20, loop=4, loop_span_s=(1.5, 3.0))
    trajectory = plan(sequence, robot)
    assert trajectory.middle.duration_s == pytest.approx(1.5)
    judged(trajectory, robot)


@pytest.mark.parametrize("end_s", [0.7, 2.1, 5.2, 5.3])
def test_a_looped_part_may_end_with_the_show(make_robot, frame, end_s):
    robot = make_robot(1, accel=300.0)
    frames = [frame(end_s * k / 7.0, base=[0.0, 30.0][k % 2]) for k in range(7)]
    frames.append(frame(end_s, base=0.0))
    sequence = show(*frames, loop=3, loop_span_s=(0.0, end_s), smooth_s=0.05, keeps_time=BASE)
    trajectory = plan(sequence, robot)
    assert trajectory.middle.duration_s == pytest.approx(end_s)
    judged(trajectory, robot)


def test_a_stored_plan_is_the_same_and_an_old_one_is_not_used(make_robot, frame, monkeypatch):
    robot, sequence = make_robot(), both(frame)
    fresh = plan(sequence, robot)
    monkeypatch.setitem(sys.modules, "clarabel", None)  # A stored plan needs no solver.
    stored = plan(sequence, robot)
    times_s = np.linspace(0.0, 4.0, 801)
    assert np.array_equal(fresh.sample(times_s), stored.sample(times_s))
    assert (stored.given_up, stored.asked) == (fresh.given_up, fresh.asked)
    changed = [replace(own, weight=2.0) for own in sequence.keyframes]
    with pytest.raises(PlanningError, match="pip install clarabel"):
        plan(replace(sequence, keyframes=tuple(changed)), robot)


def test_without_the_solver_a_feasible_show_is_planned(make_robot, frame, monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    frames = [frame(0.0, base=0.0), frame(1.5, base=60.0)]
    assert plan(show(*frames, keeps_time=BASE), make_robot(1)).duration_s == 1.5


def nodding(frame, top=10.0, **more):
    """Return a show of the base and the elbow, over which a layer can talk."""
    return show(
        frame(0.0, base=0.0, elbow=0.0),
        frame(1.0, base=top, elbow=40.0),
        frame(2.0, base=0.0),
        frame(3.5, base=top, elbow=0.0),
        frame(4.5, base=0.0),
        name="nod",
        **more,
    )


@pytest.mark.parametrize("mode", ["override", "add"])
def test_a_layer_keeps_its_time_while_the_others_are_slowed(make_robot, frame, mode):
    robot = make_robot(accel=600.0)
    layer = Layer(sequence=talk(frame, step_s=0.15), joints=("base",), mode=mode, from_s=0.0)
    slow = show(frame(0.0, elbow=0.0), frame(0.4, elbow=90.0), frame(2.0, elbow=0.0), name="arm")
    over = Layer(sequence=slow, joints=("elbow",), from_s=0.5, fade_s=0.2)
    trajectory = plan(replace(nodding(frame), layers=(layer, over)), robot)
    judged(trajectory, robot)
    labelled = {mark.label: mark for mark in trajectory.marks if mark.label}
    assert labelled["20"].planned_s == pytest.approx(4.0)
    assert {span.joint for span in trajectory.given_up} == {"base"}
    assert {span.joint for span in trajectory.stretched} == {"elbow"}
    # The same again from the cache.
    again = plan(replace(nodding(frame), layers=(layer, over)), robot)
    times_s = np.linspace(0.0, trajectory.duration_s, 501)
    assert np.array_equal(again.sample(times_s), trajectory.sample(times_s))


def test_a_sum_that_is_too_fast_gives_up_angle_and_meets_exact_keys(make_robot, frame):
    """Each of both is possible alone, their sum is not."""
    robot = make_robot(1, accel=600.0)
    shake = [frame(0.25 * k, base=[0.0, 6.0, 0.0, -6.0][k % 4]) for k in range(17)]
    talk_frames = [frame(0.25 * k, label=f"t{k}", base=5.0 * (k % 2)) for k in range(17)]
    talk_frames[8] = replace(talk_frames[8], is_exact=True)
    base = show(*shake, keeps_time=BASE)
    top = show(*talk_frames, keeps_time=BASE, name="talk")
    assert plan(base, robot).given_up == ()
    assert plan(top, robot).given_up == ()
    layer = Layer(sequence=top, joints=("base",), mode="add")
    trajectory = plan(replace(base, layers=(layer,)), robot)
    judged(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(4.0)
    assert trajectory.given_up[0].by_deg > 0.2
    assert at(trajectory, "base", 2.0)[0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("loop", [2, 4, None])
def test_joints_that_are_late_in_every_pass_of_a_loop_that_flows(make_robot, frame, loop):
    """The late joint passes the seams in motion, at other times than the author's."""
    robot = make_robot(2, accel=400.0)
    frames = [
        frame(0.2 * k, base=[0.0, 20.0, 0.0, -20.0][k % 4], elbow=[0.0, 30.0, 0.0, -30.0][k % 4])
        for k in range(9)
    ]
    trajectory = plan(show(*frames, loop=loop, keeps_time=BASE), robot)
    assert trajectory.first.duration_s > 1.7
    deg = judged(trajectory, robot, None if loop else trajectory.pass_start_s(5))
    seam = round(1000.0 * trajectory.pass_start_s(1)) + 3
    assert abs(deg[seam + 5, 1] - deg[seam - 5, 1]) > 0.1, "the elbow does not stop at the seam"


@pytest.mark.parametrize("loop", [1, 3, None])
@pytest.mark.parametrize("by", ["smooth_s", "jerk_max_deg_s3"])
def test_a_jerk_limit_costs_angle_and_no_time(make_robot, frame, loop, by):
    robot = make_robot(1, speed=360.0, accel=1000.0)
    jerk = 20_000.0
    frames = [frame(0.15 * k, base=[0.0, 20.0, 0.0, -20.0][k % 4]) for k in range(13)]
    sequence = show(*frames, loop=loop, keeps_time=BASE)
    if by == "smooth_s":
        sequence = replace(sequence, smooth_s=2.0 * 1000.0 / jerk)
    else:
        joint = replace(robot.joints["base"], jerk_max_deg_s3=jerk)
        robot = replace(robot, joints={"base": joint})
    trajectory = plan(sequence, robot)
    assert trajectory.middle.duration_s == pytest.approx(1.8)
    deg = judged(trajectory, robot, None if loop else 7.2)[:, 0]
    assert np.abs(np.diff(deg, 3)).max() <= jerk * 1e-9 * 1.001
    assert trajectory.given_up[0].by_deg > 1.0
    rough = plan(replace(sequence, smooth_s=0.0), make_robot(1, speed=360.0, accel=1000.0))
    assert rough.given_up[0].rms_deg < trajectory.given_up[0].rms_deg
    if loop != 1:
        assert trajectory.is_periodic
