"""Keyframes of one track with authored, fastest and fitted times, loops, and parallel tracks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Layer, PlaylistStep, Sequence, Timing
from tests.unit.trajectory.shows import at, blink, show, trapezoid_s


def test_legal_times_are_kept_exactly(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(1.5, base=60.0), frame(1.0 / 3.0 + 3.0, base=0.0)]
    trajectory = plan(show(*frames), make_robot())
    assert trajectory.stretched == ()
    assert [mark.planned_s for mark in trajectory.marks] == pytest.approx(
        [0.0, 1.5, 1.0 / 3.0 + 3.0], abs=1e-8
    )
    reached = trajectory.sample(np.array([0.0, 1.5, 1.0 / 3.0 + 3.0]))[:, 0]
    assert reached == pytest.approx([0.0, 60.0, 0.0], abs=1e-6)


def test_only_the_span_that_is_too_fast_is_slowed(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(2.0, base=50.0, hold_s=0.1),
        frame(2.3, base=-50.0),
        frame(4.3, base=-50.0),
        frame(6.0, base=0.0),
    ]
    trajectory = plan(show(*frames), make_robot())
    assert [mark.planned_s for mark in trajectory.marks][:2] == pytest.approx([0.0, 2.0], abs=1e-9)
    (stretch,) = trajectory.stretched
    least_s = trapezoid_s(100.0)
    assert 2.1 - 1e-6 <= stretch.from_s < stretch.to_s <= 2.1 + 1.02 * least_s
    assert stretch.by_s == pytest.approx(least_s - 0.2, rel=0.02)
    assert (stretch.joint, stretch.allowed) == ("base", 600.0)
    # A Hermite cubic of 100 deg in 0.2 s begins with 6 · 100 / 0.2² deg/s².
    assert stretch.authored == pytest.approx(15000.0, rel=1e-2)


def held_s(trajectory, joint, deg) -> float:
    """Return how long a joint stands at an angle, from samples 1 ms apart."""
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    return 0.001 * np.count_nonzero(np.abs(at(trajectory, joint, *times_s) - deg) < 1e-9)


def test_a_hold_is_kept_by_a_motion_that_is_late(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(0.1, base=100.0, hold_s=0.5), frame(2.0, base=0.0)]
    trajectory = plan(show(*frames), make_robot())
    assert trajectory.marks[1].planned_s == pytest.approx(trapezoid_s(100.0), rel=0.02)
    assert trajectory.marks[1].held_s == pytest.approx(0.5, abs=1e-9)
    assert held_s(trajectory, "base", 100.0) >= 0.499


def test_a_rest_beyond_the_hold_is_shortened_by_the_delay_before_it(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(0.2, base=100.0, hold_s=0.5),
        frame(2.2, base=100.0),
        frame(4.0, base=0.0),
    ]
    trajectory = plan(show(*frames), make_robot())
    assert trajectory.marks[1].planned_s > 0.8
    assert trajectory.marks[1].held_s == pytest.approx(0.5, abs=1e-9)
    assert trajectory.marks[2].planned_s == pytest.approx(2.2, abs=1e-9)
    assert trajectory.duration_s == pytest.approx(4.0, abs=1e-9)


def test_holds_that_overlap_are_kept_together(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, elbow=0.0),
        frame(0.2, base=100.0, hold_s=0.5),
        frame(0.4, elbow=0.0, hold_s=0.7),
        frame(3.0, base=100.0, elbow=0.0),
    ]
    trajectory = plan(show(*frames), make_robot())
    assert [mark.held_s for mark in trajectory.marks[1:3]] == pytest.approx([0.5, 0.7], abs=1e-9)
    assert trajectory.marks[3].planned_s == pytest.approx(3.0, abs=1e-9)


def test_a_hold_that_may_shrink_gives_up_the_delay_before_it(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(0.2, base=100.0, hold_s=2.0, may_shrink=True),
        frame(4.0, base=0.0),
    ]
    trajectory = plan(show(*frames), make_robot())
    late_s = trajectory.marks[1].planned_s - 0.2
    assert late_s > 0.6
    assert trajectory.marks[1].held_s == pytest.approx(2.0 - late_s, abs=1e-9)
    assert trajectory.marks[2].planned_s == pytest.approx(4.0, abs=1e-9)


def test_a_hold_that_may_shrink_and_is_shorter_than_the_delay_is_left_out(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(0.2, base=100.0, hold_s=0.3, may_shrink=True),
        frame(2.5, base=0.0),
    ]
    trajectory = plan(show(*frames), make_robot())
    assert trajectory.stretched[0].by_s > 0.3
    assert trajectory.marks[1].held_s == pytest.approx(0.0, abs=1e-9)
    assert trajectory.duration_s == pytest.approx(2.5, abs=1e-6)


def test_passes_of_a_loop_are_late_on_their_own(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(0.5, base=20.0),
        frame(0.6, base=100.0),
        frame(3.0, base=100.0),
        frame(5.0, base=0.0),
        frame(6.0, base=-20.0),
        frame(6.5, base=0.0),
    ]
    trajectory = plan(show(*frames, loop=4), make_robot())
    assert trajectory.is_periodic
    lengths_s = [trajectory.motion_of(index).duration_s for index in range(4)]
    assert min(lengths_s) >= 6.5 - 1e-9


def test_a_hold_is_kept_under_the_motion_of_another_joint(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, elbow=0.0),
        frame(0.2, base=100.0, hold_s=2.0),
        frame(4.0, base=0.0, elbow=90.0),
    ]
    trajectory = plan(show(*frames), make_robot())
    assert trajectory.marks[1].held_s >= 2.0 - 1e-9
    assert trajectory.marks[2].planned_s == pytest.approx(4.0, abs=1e-6)


def late_s(trajectory) -> list[float]:
    return [mark.planned_s - mark.authored_s for mark in trajectory.marks]


CASE_1 = ((0.0, 0.0), (1.0, 100.0), (1.2, 0.0), (8.0, 10.0))
CASE_2 = ((0.0, 0.0), (0.1, 100.0), (1.6, 0.0), (3.0, 100.0))


def test_slack_behind_a_slow_span_meets_an_anchor(make_robot, frame):
    frames = [frame(at_s, base=deg, anchor=at_s == 8.0) for at_s, deg in CASE_1]
    trajectory = plan(show(*frames), make_robot(speed=360.0, accel=1000.0))
    # The closed form of the optimum has 0.432 s at the third key and none elsewhere.
    assert late_s(trajectory) == pytest.approx([0.0, 0.0, 0.432, 0.0], abs=0.002)


def test_lateness_behind_a_hold_is_made_up_over_two_moves(make_robot, frame):
    frames = [frame(at_s, base=deg, hold_s=0.5 * (at_s == 0.1)) for at_s, deg in CASE_2]
    trajectory = plan(show(*frames), make_robot(speed=360.0, accel=1000.0))
    # Closed form: 0.532, 0.165, 0 with the hold kept.
    assert sum(late_s(trajectory)) <= 1.02 * 0.697
    assert trajectory.marks[1].held_s == pytest.approx(0.5, abs=1e-9)


def test_before_an_anchor_the_motion_is_faster_than_twice_the_authors_pace(make_robot, frame):
    slack = [frame(1.2, base=0.0), frame(1.72, base=0.5, anchor=True), frame(3.0, base=20.0)]
    frames = [frame(0.0, base=0.0), frame(1.0, base=100.0), *slack]
    robot = make_robot(speed=360.0, accel=1000.0)
    trajectory = plan(show(*frames), robot)
    assert late_s(trajectory)[2] > 0.4
    assert late_s(trajectory)[3:] == pytest.approx([0.0, 0.0], abs=2e-4)
    assert min(late_s(trajectory)) > -1e-6


def test_an_anchor_that_can_be_met_is_met(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(2.0, base=100.0, anchor=True), frame(4.0, base=0.0)]
    assert plan(show(*frames), make_robot()).marks[1].planned_s == pytest.approx(2.0, abs=1e-9)


def test_the_message_of_a_missed_anchor_names_anchor_delay_joint_and_limit(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, elbow=0.0),
        frame(0.2, base=100.0, elbow=1.0, anchor=True, label="beat", line=7),
    ]
    with pytest.raises(PlanningError) as caught:
        plan(show(*frames, path="show.yaml"), make_robot())
    message = str(caught.value)
    late_s = trapezoid_s(100.0) - 0.2
    assert caught.value.joint == "base"
    assert message.startswith("show.yaml:7: anchor 'beat' at 0.2 s")
    assert float(message.split("would be ")[1].split(" s late", maxsplit=1)[0]) == pytest.approx(
        late_s, rel=0.02
    )
    assert "allowed 600 deg/s²" in message


def test_the_message_of_a_much_too_short_move_has_the_needed_acceleration(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(0.05, base=100.0, anchor=True)]
    with pytest.raises(PlanningError, match=r"would need acceleration 240000 deg/s²"):
        plan(show(*frames), make_robot())


def test_an_anchor_after_a_rest_long_enough_is_met(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(0.2, base=100.0, hold_s=0.5),
        frame(2.2, base=100.0),
        frame(4.0, base=0.0, anchor=True),
    ]
    assert plan(show(*frames), make_robot()).marks[3].planned_s == pytest.approx(4.0, abs=1e-9)


def test_an_anchor_in_a_loop_counts_in_every_pass(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, anchor=True),
        frame(1.0, base=10.0),
        frame(1.1, base=-60.0),
        frame(1.6, base=0.0),
    ]
    assert plan(show(*frames), make_robot()).stretched
    with pytest.raises(PlanningError, match="anchor"):
        plan(show(*frames, loop=4), make_robot())


@pytest.mark.parametrize("deg", [0.01, 0.5, 30.0, 90.0, 170.0])
def test_a_single_move_is_as_quick_as_the_closed_form(make_robot, frame, deg):
    frames = [frame(base=0.0), frame(base=deg)]
    trajectory = plan(show(*frames, timing=Timing.FASTEST), make_robot())
    assert trajectory.duration_s == pytest.approx(trapezoid_s(deg), rel=0.005)
    assert trajectory.duration_s >= 0.999 * trapezoid_s(deg)


def test_the_slowest_joint_decides(make_robot, frame):
    robot = make_robot(elbow=(1.8, 6.0))
    frames = [frame(base=0.0, elbow=0.0), frame(base=90.0, elbow=9.0)]
    trajectory = plan(show(*frames, timing=Timing.FASTEST), robot)
    assert trajectory.duration_s == pytest.approx(trapezoid_s(9.0, 1.8, 6.0), rel=0.005)


def test_holds_are_rests_of_exactly_their_length(make_robot, frame):
    frames = [frame(base=0.0), frame(base=40.0, hold_s=0.7), frame(base=80.0)]
    trajectory = plan(show(*frames, timing=Timing.FASTEST), make_robot())
    reached_s = trajectory.marks[1].planned_s
    assert reached_s == pytest.approx(trapezoid_s(40.0), rel=0.005)
    resting = trajectory.sample(reached_s + np.linspace(0.0, 0.7, 50))[:, 0]
    assert resting == pytest.approx(40.0, abs=1e-9)
    assert trajectory.duration_s == pytest.approx(2 * trapezoid_s(40.0) + 0.7, rel=0.005)


def test_fastest_does_not_stop_between_moves_in_one_direction(make_robot, frame):
    frames = [frame(base=0.0), frame(base=40.0), frame(base=80.0)]
    trajectory = plan(show(*frames, timing=Timing.FASTEST), make_robot())
    assert trajectory.duration_s == pytest.approx(trapezoid_s(80.0), rel=0.01)


def test_fastest_ignores_authored_times(make_robot, frame):
    timed = [frame(0.0, base=0.0), frame(9.0, base=40.0)]
    untimed = [frame(base=0.0), frame(base=40.0)]
    lengths = [
        plan(show(*frames, timing=Timing.FASTEST), make_robot()).duration_s
        for frames in (timed, untimed)
    ]
    assert lengths[0] == lengths[1]


def test_fit_scales_authored_times(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(1.0, base=60.0, hold_s=0.5), frame(3.0, base=0.0)]
    trajectory = plan(show(*frames, timing=Timing.FIT, fit_duration_s=6.0), make_robot())
    assert [mark.planned_s for mark in trajectory.marks] == pytest.approx([0.0, 2.0, 6.0])


def test_fit_without_times_slows_the_fastest_and_keeps_its_holds(make_robot, frame):
    frames = [frame(base=0.0), frame(base=60.0, hold_s=0.5), frame(base=0.0)]
    trajectory = plan(show(*frames, timing=Timing.FIT, fit_duration_s=6.5), make_robot())
    assert trajectory.duration_s == pytest.approx(6.5, abs=1e-9)
    assert [mark.planned_s for mark in trajectory.marks] == pytest.approx([0.0, 3.0, 6.5])


def test_fit_that_is_too_short_names_the_least_duration(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(2.0, base=100.0), frame(4.0, base=0.0)]
    with pytest.raises(PlanningError, match="least duration is") as caught:
        plan(show(*frames, timing=Timing.FIT, fit_duration_s=1.0), make_robot())
    least_s = float(str(caught.value).rpartition("is ")[2].removesuffix(" s"))
    # 100 deg / 180 deg/s + 180 deg/s / 600 deg/s² for each half.
    assert least_s == pytest.approx(2.0 * (100.0 / 180.0 + 0.3), abs=0.004)
    exact = plan(show(*frames, timing=Timing.FIT, fit_duration_s=least_s), make_robot())
    assert exact.duration_s == pytest.approx(least_s, abs=1e-3)


def test_fit_without_times_that_is_too_short_names_the_fastest(make_robot, frame):
    frames = [frame(base=0.0), frame(base=90.0)]
    with pytest.raises(PlanningError, match=r"fastest takes 0\.80\d s"):
        plan(show(*frames, timing=Timing.FIT, fit_duration_s=0.5), make_robot())


def wave(frame, scale=1.0):
    return [
        frame(0.0, base=0.0),
        frame(1.0, base=30.0 * scale),
        frame(3.0, base=-30.0 * scale),
        frame(4.0, base=0.0),
    ]


def test_a_loop_does_not_stop_between_passes(make_robot, frame):
    trajectory = plan(show(*wave(frame), loop=5), make_robot())
    assert trajectory.is_periodic
    seams_s = np.array([trajectory.pass_start_s(index) for index in range(1, 5)])
    assert seams_s == pytest.approx([4.0, 8.0, 12.0, 16.0], abs=1e-9)
    speeds = trajectory.sample(seams_s, 1)[:, 0]
    assert speeds == pytest.approx(30.0, abs=1e-6)
    assert trajectory.sample(seams_s - 1e-9, 1)[:, 0] == pytest.approx(30.0, abs=1e-5)


def test_a_show_starts_and_ends_at_rest(make_robot, frame):
    trajectory = plan(show(*wave(frame), loop=3), make_robot())
    ends_s = np.array([0.0, trajectory.duration_s])
    assert trajectory.sample(ends_s, 1)[:, 0] == pytest.approx(0.0, abs=1e-9)
    assert trajectory.sample(ends_s, 0)[:, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("timing", [Timing.AUTHORED, Timing.FASTEST])
@pytest.mark.parametrize("loop", [2, 3, 7, None])
def test_a_slowed_loop_has_equal_speeds_on_both_sides_of_a_seam(make_robot, frame, loop, timing):
    trajectory = plan(show(*wave(frame, 5.0), loop=loop, timing=timing), make_robot())
    assert trajectory.is_periodic
    verify(trajectory, make_robot())
    ends = [trajectory.first.sample(np.array([trajectory.first.duration_s]), 1)]
    starts = [trajectory.last.sample(np.array([0.0]), 1)]
    if loop != 2:
        ends.append(trajectory.middle.sample(np.array([trajectory.middle.duration_s]), 1))
        starts.append(trajectory.middle.sample(np.array([0.0]), 1))
    assert np.ptp([*ends, *starts]) < 1e-3
    assert starts[0][0, 0] > 50.0


def test_a_hold_at_the_seam_is_a_rest_in_every_pass(make_robot, frame):
    frames = [*wave(frame)[:-1], frame(4.0, base=0.0, hold_s=0.5)]
    trajectory = plan(show(*frames, loop=3), make_robot())
    assert not trajectory.is_periodic
    assert trajectory.first is trajectory.middle is trajectory.last
    assert trajectory.duration_s == pytest.approx(13.5)


def test_a_loop_that_does_not_return_is_refused(make_robot, frame):
    with pytest.raises(InputError, match="ends a pass at 40 deg and starts it at 0 deg"):
        plan(show(frame(0.0, base=0.0), frame(1.0, base=40.0), loop=2), make_robot())


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
    assert max(late_s(trajectory)) > 0.6
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


def test_a_missed_anchor_of_a_track_is_refused(make_robot, frame):
    late = show(
        frame(0.0, elbow=0.0), frame(0.2, elbow=100.0, anchor=True, label="beat"), name="late"
    )
    with pytest.raises(PlanningError, match="anchor 'beat'"):
        plan(show(frame(0.0, base=0.0), tracks=(late,)), make_robot())


@pytest.mark.parametrize("part", ["tracks", "play", "layers"])
def test_a_track_holds_nothing_but_keyframes(make_robot, frame, part):
    inner = {
        "tracks": (blink(frame),),
        "play": (PlaylistStep(pause_s=1.0),),
        "layers": (Layer(sequence=blink(frame), joints=("elbow",)),),
    }
    track = replace(blink(frame), **{part: inner[part]})
    with pytest.raises(InputError, match="nothing else"):
        plan(Sequence(name="both", tracks=(track,)), make_robot())


def test_tracks_that_flow_for_ever_need_not_end_at_rest(make_robot, frame):
    def flowing(name: str) -> Sequence:
        frames = [frame(0.5 * k, **{name: [0.0, 20.0, 0.0, -20.0][k % 4]}) for k in range(5)]
        return show(*frames, name=name, loop=None)

    trajectory = plan(
        Sequence(name="both", tracks=(flowing("base"), flowing("elbow"))), make_robot()
    )
    assert trajectory.loop is None
    speeds = trajectory.sample(np.array([2.0, 4.0, 6.0]), 1)
    assert (speeds > 10.0).all(), "they pass every seam in motion"
