from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from lss_motion.errors import InputError, PlanningError
from lss_motion.sequence.model import Sequence, Timing
from lss_motion.trajectory.planner import plan
from lss_motion.trajectory.verify import verify


def sequence(*frames, **more):
    return Sequence(name="test", keyframes=frames, **more)


def trapezoid_s(deg, speed=180.0, accel=600.0):
    """The least time of a move from rest to rest, from first principles."""
    if deg <= speed**2 / accel:
        return 2.0 * (deg / accel) ** 0.5
    return deg / speed + speed / accel


# authored


def test_legal_times_are_kept_exactly(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(1.5, base=60.0), frame(1.0 / 3.0 + 3.0, base=0.0)]
    trajectory = plan(sequence(*frames), make_robot())
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
    trajectory = plan(sequence(*frames), make_robot())
    assert [mark.planned_s for mark in trajectory.marks][:2] == pytest.approx([0.0, 2.0], abs=1e-9)
    (stretch,) = trajectory.stretched
    least_s = trapezoid_s(100.0)
    assert 2.1 - 1e-6 <= stretch.from_s < stretch.to_s <= 2.1 + 1.02 * least_s
    assert stretch.by_s == pytest.approx(least_s - 0.2, rel=0.02)
    assert (stretch.joint, stretch.allowed) == ("base", 600.0)
    # A Hermite cubic of 100 deg in 0.2 s begins with 6 · 100 / 0.2² deg/s².
    assert stretch.authored == pytest.approx(15000.0, rel=1e-2)


def test_lost_time_is_won_back_in_the_next_rest(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(0.2, base=100.0, hold_s=2.0),
        frame(4.0, base=0.0),
    ]
    trajectory = plan(sequence(*frames), make_robot())
    assert trajectory.marks[1].planned_s > 0.8
    assert trajectory.marks[2].planned_s == pytest.approx(4.0, abs=1e-9)
    assert trajectory.duration_s == pytest.approx(4.0, abs=1e-9)


def test_a_rest_that_is_too_short_gives_all_it_has(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(0.2, base=100.0, hold_s=0.3), frame(2.5, base=0.0)]
    trajectory = plan(sequence(*frames), make_robot())
    lost_s = trajectory.stretched[0].by_s
    assert lost_s > 0.3
    assert trajectory.duration_s == pytest.approx(2.5 + lost_s - 0.3, abs=1e-6)


def test_a_joint_that_rests_while_another_moves_is_no_rest(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, elbow=0.0),
        frame(0.2, base=100.0, hold_s=2.0),
        frame(4.0, base=0.0, elbow=90.0),
    ]
    trajectory = plan(sequence(*frames), make_robot())
    assert trajectory.marks[2].planned_s > 4.5


def test_an_anchor_that_can_be_met_is_met(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(2.0, base=100.0, anchor=True), frame(4.0, base=0.0)]
    assert plan(sequence(*frames), make_robot()).marks[1].planned_s == pytest.approx(2.0, abs=1e-9)


def test_a_missed_anchor_says_which_by_how_much_and_why(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, elbow=0.0),
        frame(0.2, base=100.0, elbow=1.0, anchor=True, label="beat", line=7),
    ]
    with pytest.raises(PlanningError) as caught:
        plan(sequence(*frames, path="show.yaml"), make_robot())
    message = str(caught.value)
    late_s = trapezoid_s(100.0) - 0.2
    assert caught.value.joint == "base"
    assert message.startswith("show.yaml:7: anchor 'beat' at 0.2 s")
    assert float(message.split("would be ")[1].split(" s late", maxsplit=1)[0]) == pytest.approx(
        late_s, rel=0.02
    )
    assert "allowed 600 deg/s²" in message


def test_a_far_too_short_move_is_told_in_plain_numbers(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(0.05, base=100.0, anchor=True)]
    with pytest.raises(PlanningError, match=r"would need acceleration 240000 deg/s²"):
        plan(sequence(*frames), make_robot())


def test_an_anchor_after_a_rest_long_enough_is_met(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(0.2, base=100.0, hold_s=2.0),
        frame(4.0, base=0.0, anchor=True),
    ]
    assert plan(sequence(*frames), make_robot()).marks[2].planned_s == pytest.approx(4.0, abs=1e-9)


def test_an_anchor_in_a_loop_counts_in_every_pass(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, anchor=True),
        frame(1.0, base=10.0),
        frame(1.1, base=-60.0),
        frame(3.0, base=0.0),
    ]
    assert plan(sequence(*frames), make_robot()).stretched
    with pytest.raises(PlanningError, match="anchor"):
        plan(sequence(*frames, loop=4), make_robot())


# fastest


@pytest.mark.parametrize("deg", [0.01, 0.5, 30.0, 90.0, 170.0])
def test_a_single_move_is_as_quick_as_the_closed_form(make_robot, frame, deg):
    frames = [frame(base=0.0), frame(base=deg)]
    trajectory = plan(sequence(*frames, timing=Timing.FASTEST), make_robot())
    assert trajectory.duration_s == pytest.approx(trapezoid_s(deg), rel=0.005)
    assert trajectory.duration_s >= 0.999 * trapezoid_s(deg)


def test_the_slowest_joint_decides(make_robot, frame):
    robot = make_robot(elbow=(1.8, 6.0))
    frames = [frame(base=0.0, elbow=0.0), frame(base=90.0, elbow=9.0)]
    trajectory = plan(sequence(*frames, timing=Timing.FASTEST), robot)
    assert trajectory.duration_s == pytest.approx(trapezoid_s(9.0, 1.8, 6.0), rel=0.005)


def test_holds_are_rests_of_exactly_their_length(make_robot, frame):
    frames = [frame(base=0.0), frame(base=40.0, hold_s=0.7), frame(base=80.0)]
    trajectory = plan(sequence(*frames, timing=Timing.FASTEST), make_robot())
    reached_s = trajectory.marks[1].planned_s
    assert reached_s == pytest.approx(trapezoid_s(40.0), rel=0.005)
    resting = trajectory.sample(reached_s + np.linspace(0.0, 0.7, 50))[:, 0]
    assert resting == pytest.approx(40.0, abs=1e-9)
    assert trajectory.duration_s == pytest.approx(2 * trapezoid_s(40.0) + 0.7, rel=0.005)


def test_fastest_does_not_stop_where_the_direction_stays(make_robot, frame):
    frames = [frame(base=0.0), frame(base=40.0), frame(base=80.0)]
    trajectory = plan(sequence(*frames, timing=Timing.FASTEST), make_robot())
    assert trajectory.duration_s == pytest.approx(trapezoid_s(80.0), rel=0.01)


def test_fastest_ignores_authored_times(make_robot, frame):
    timed = [frame(0.0, base=0.0), frame(9.0, base=40.0)]
    untimed = [frame(base=0.0), frame(base=40.0)]
    lengths = [
        plan(sequence(*frames, timing=Timing.FASTEST), make_robot()).duration_s
        for frames in (timed, untimed)
    ]
    assert lengths[0] == lengths[1]


# fit


def test_fit_scales_authored_times(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(1.0, base=60.0, hold_s=0.5), frame(3.0, base=0.0)]
    trajectory = plan(sequence(*frames, timing=Timing.FIT, fit_duration_s=6.0), make_robot())
    assert [mark.planned_s for mark in trajectory.marks] == pytest.approx([0.0, 2.0, 6.0])


def test_fit_without_times_slows_the_fastest_and_keeps_its_holds(make_robot, frame):
    frames = [frame(base=0.0), frame(base=60.0, hold_s=0.5), frame(base=0.0)]
    trajectory = plan(sequence(*frames, timing=Timing.FIT, fit_duration_s=6.5), make_robot())
    assert trajectory.duration_s == pytest.approx(6.5, abs=1e-9)
    assert [mark.planned_s for mark in trajectory.marks] == pytest.approx([0.0, 3.0, 6.5])


def test_fit_that_is_too_short_names_the_least_duration(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(2.0, base=100.0), frame(4.0, base=0.0)]
    # 6 · 100 / t² = 600 deg/s² for each half: t = 1 s.
    with pytest.raises(PlanningError, match=r"least duration is 2\.000 s"):
        plan(sequence(*frames, timing=Timing.FIT, fit_duration_s=1.0), make_robot())
    exact = plan(sequence(*frames, timing=Timing.FIT, fit_duration_s=2.0), make_robot())
    assert exact.duration_s == pytest.approx(2.0, abs=1e-3)


def test_fit_without_times_that_is_too_short_names_the_fastest(make_robot, frame):
    frames = [frame(base=0.0), frame(base=90.0)]
    with pytest.raises(PlanningError, match=r"fastest takes 0\.80\d s"):
        plan(sequence(*frames, timing=Timing.FIT, fit_duration_s=0.5), make_robot())


# loops


def wave(frame, scale=1.0):
    return [
        frame(0.0, base=0.0),
        frame(1.0, base=30.0 * scale),
        frame(3.0, base=-30.0 * scale),
        frame(4.0, base=0.0),
    ]


def test_a_loop_does_not_stop_between_passes(make_robot, frame):
    trajectory = plan(sequence(*wave(frame), loop=5), make_robot())
    assert trajectory.is_periodic
    seams_s = np.array([trajectory.pass_start_s(index) for index in range(1, 5)])
    assert seams_s == pytest.approx([4.0, 8.0, 12.0, 16.0], abs=1e-9)
    speeds = trajectory.sample(seams_s, 1)[:, 0]
    assert speeds == pytest.approx(30.0, abs=1e-6)
    assert trajectory.sample(seams_s - 1e-9, 1)[:, 0] == pytest.approx(30.0, abs=1e-5)


def test_a_show_starts_and_ends_at_rest(make_robot, frame):
    trajectory = plan(sequence(*wave(frame), loop=3), make_robot())
    ends_s = np.array([0.0, trajectory.duration_s])
    assert trajectory.sample(ends_s, 1)[:, 0] == pytest.approx(0.0, abs=1e-9)
    assert trajectory.sample(ends_s, 0)[:, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("timing", [Timing.AUTHORED, Timing.FASTEST])
@pytest.mark.parametrize("loop", [2, 3, 7, None])
def test_a_loop_that_must_be_slowed_is_as_fast_on_both_sides_of_a_seam(
    make_robot, frame, loop, timing
):
    trajectory = plan(sequence(*wave(frame, 5.0), loop=loop, timing=timing), make_robot())
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
    trajectory = plan(sequence(*frames, loop=3), make_robot())
    assert not trajectory.is_periodic
    assert trajectory.first is trajectory.middle is trajectory.last
    assert trajectory.duration_s == pytest.approx(13.5)


def test_a_loop_that_does_not_return_is_refused(make_robot, frame):
    with pytest.raises(InputError, match="ends a pass at 40 deg and starts it at 0 deg"):
        plan(sequence(frame(0.0, base=0.0), frame(1.0, base=40.0), loop=2), make_robot())


# interpolation


def test_linear_moves_stay_on_a_straight_line(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, elbow=10.0),
        frame(2.0, base=80.0, elbow=-30.0, ease="linear"),
    ]
    deg = plan(sequence(*frames), make_robot()).sample(np.linspace(0.0, 2.0, 500))
    assert deg[:, 1] == pytest.approx(10.0 - deg[:, 0] / 2.0, abs=1e-9)


def test_hold_moves_as_late_as_the_limits_allow(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(3.0, base=90.0, ease="hold")]
    trajectory = plan(sequence(*frames), make_robot())
    start_s = 3.0 - trapezoid_s(90.0)
    assert not trajectory.stretched
    before, after = trajectory.sample(np.array([start_s - 1e-3, start_s + 0.02]))[:, 0]
    assert before == 0.0
    assert after == pytest.approx(0.5 * 600.0 * 0.02**2, rel=1e-3)


def test_smooth_rests_where_the_direction_turns_and_nowhere_else(make_robot, frame):
    frames = [
        frame(0.0, base=0.0),
        frame(1.0, base=30.0),
        frame(2.0, base=60.0),
        frame(3.0, base=0.0),
    ]
    speeds = plan(sequence(*frames), make_robot()).sample(np.array([1.0, 2.0]), 1)[:, 0]
    assert speeds[0] > 20.0
    assert speeds[1] == pytest.approx(0.0, abs=1e-9)


def test_a_spline_has_no_jump_of_acceleration_at_its_keys(make_robot, frame):
    frames = [
        frame(float(at_s), base=deg, ease="spline")
        for at_s, deg in enumerate([0.0, 30.0, 20.0, 50.0, 0.0])
    ]
    trajectory = plan(sequence(*frames), make_robot())
    inner_s = np.array([1.0, 2.0, 3.0])
    left, right = (trajectory.sample(inner_s + side, 2)[:, 0] for side in (-1e-9, 1e-9))
    assert left == pytest.approx(right, abs=1e-5)
    assert np.abs(left).min() > 1.0


def test_a_spline_that_swings_out_of_range_is_refused_by_name(make_robot, frame):
    frames = [
        frame(0.0, base=0.0, ease="spline"),
        frame(1.0, base=170.0, ease="spline", label="top", line=4),
        frame(1.5, base=168.0, ease="spline", label="rim", line=5),
        frame(4.0, base=0.0, ease="spline"),
    ]
    with pytest.raises(PlanningError, match=r"show.yaml:5: .*'rim'.*'base' would be at 17\d"):
        plan(sequence(*frames, path="show.yaml"), make_robot())


# odd input


@pytest.mark.parametrize("ease", ["smooth", "spline", "linear", "hold"])
def test_whole_numbers_mean_what_they_say(make_robot, frame, ease):
    whole = [frame(0, base=0), frame(2, base=45, ease=ease), frame(3, base=30, ease=ease)]
    exact = [
        frame(0.0, base=0.0),
        frame(2.0, base=45.0, ease=ease),
        frame(3.0, base=30.0, ease=ease),
    ]
    times_s = np.linspace(0.0, 3.0, 50)
    by_whole, by_exact = (
        plan(sequence(*frames), make_robot()).sample(times_s) for frames in (whole, exact)
    )
    assert np.array_equal(by_whole, by_exact)


def test_one_keyframe_lasts_as_long_as_its_hold(make_robot, frame):
    assert plan(sequence(frame(0.0, base=5.0)), make_robot()).duration_s == 0.0
    trajectory = plan(sequence(frame(0.0, base=5.0, hold_s=2.0)), make_robot())
    assert trajectory.duration_s == pytest.approx(2.0)
    assert trajectory.sample(np.array([-1.0, 1.0, 9.0]))[:, 0] == pytest.approx(5.0)


@pytest.mark.parametrize("timing", [Timing.AUTHORED, Timing.FASTEST])
def test_repeated_keyframes_change_nothing(make_robot, frame, timing):
    once = [frame(0.0, base=0.0), frame(1.0, base=50.0), frame(2.0, base=0.0)]
    twice = [each for each in once for _ in range(2)]
    single, double = (
        plan(sequence(*frames, timing=timing), make_robot()) for frames in (once, twice)
    )
    assert double.duration_s == pytest.approx(single.duration_s, abs=1e-9)
    times_s = np.linspace(0.0, single.duration_s, 100)
    assert double.sample(times_s) == pytest.approx(single.sample(times_s), abs=1e-9)


@pytest.mark.parametrize("step_s", [0.0, 1e-7, 1e-3])
def test_keys_at_nearly_one_instant_are_stretched_to_what_the_joint_can_do(
    make_robot, frame, step_s
):
    frames = [
        frame(0.0, base=0.0),
        frame(1.0, base=0.0),
        frame(1.0 + step_s, base=90.0),
        frame(4.0, base=0.0),
    ]
    trajectory = plan(sequence(*frames), make_robot())
    (stretch,) = trajectory.stretched
    assert stretch.by_s == pytest.approx(trapezoid_s(90.0) - step_s, rel=0.02)


def test_many_turns_and_limits_a_hundredfold_apart_are_planned(make_robot, frame):
    robot = make_robot(reach=3600.0, elbow=(1.8, 6.0))
    frames = [frame(0.0, base=-3600.0, elbow=0.0), frame(9.0, base=3600.0, elbow=5.0)]
    trajectory = plan(sequence(*frames), robot)
    assert trajectory.duration_s == pytest.approx(trapezoid_s(7200.0), rel=0.005)
    assert trajectory.sample(np.array([trajectory.duration_s]))[0] == pytest.approx([3600.0, 5.0])


def test_a_hump_inside_of_one_cell_is_repaired(make_robot, frame):
    """Found by the property tests: a joint that speeds up within a fraction of a grid cell."""
    robot = make_robot(4, speed=4.0, accel=20.0, reach=3600.0, j3=(14.0, 1166.0))
    frames = [
        frame(0.0, base=0.0, elbow=0.0, j2=5.0, j3=116.875),
        frame(0.0, base=0.01),
        frame(0.0, base=0.0, elbow=0.0, j2=0.0, j3=116.875),
        frame(0.0, base=0.0, elbow=0.0, j2=0.0, j3=7.5),
    ]
    assert verify(plan(sequence(*frames), robot), robot).speed_ratio <= 1.001


def test_ten_thousand_keyframes_are_planned(make_robot, frame):
    rng = np.random.default_rng(3)
    frames = [
        frame(0.25 * index, base=40.0 if index % 250 == 249 else float(deg), elbow=float(-deg))
        for index, deg in enumerate(rng.uniform(-3.0, 3.0, 10_000))
    ]
    trajectory = plan(sequence(*frames), make_robot())
    assert trajectory.duration_s >= 0.25 * 9_999
    assert len(trajectory.marks) == 10_000
    assert len(trajectory.stretched) >= 40


def test_joints_come_in_the_order_of_the_robot_and_only_if_keyed(make_robot, frame):
    trajectory = plan(
        sequence(frame(0.0, j2=1.0), frame(1.0, base=2.0), frame(2.0, j2=0.0)), make_robot(4)
    )
    assert trajectory.joints == ("base", "j2")


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "no keyframes"),
        ([{"at_s": 0.0, "elbwo": 3.0}], "did you mean 'elbow'"),
        ([{"at_s": 0.0, "base": 171.0}], "171 deg, allowed -170 to 170 deg"),
        ([{"at_s": 0.0, "base": float("nan")}], "nan deg, allowed"),
        ([{"at_s": float("inf"), "base": 1.0}], "time inf s"),
        ([{"at_s": 1.0, "base": 1.0}, {"at_s": 0.5, "base": 1.0}], "the one before is at 1 s"),
        ([{"at_s": 1.0, "base": 1.0}, {"base": 1.0}], "needs one for every keyframe"),
        ([{"at_s": 0.0, "hold_s": -1.0, "base": 1.0}], "hold -1.0 s"),
        (
            [{"at_s": 0.0, "hold_s": 2.0, "base": 1.0}, {"at_s": 1.0, "base": 3.0}],
            "held at 1 deg until 2 s",
        ),
        ([{"at_s": 0.0}], "moves no joint"),
    ],
)
def test_what_means_nothing_is_refused_with_its_reason(make_robot, frame, frames, message):
    with pytest.raises(InputError, match=message):
        plan(sequence(*(frame(**fields) for fields in frames)), make_robot())


def test_all_problems_are_told_at_once(make_robot, frame):
    with pytest.raises(InputError) as caught:
        plan(
            sequence(frame(0.0, base=999.0, line=3), frame(1.0, nose=1.0, line=4), path="a.yaml"),
            make_robot(),
        )
    assert [line.split(" ")[0] for line in str(caught.value).splitlines()] == [
        "a.yaml:3:",
        "a.yaml:4:",
    ]


def test_a_legal_show_and_a_remembered_one_need_no_toppra() -> None:
    script = textwrap.dedent(
        """
        import sys
        from lss_motion.robot.model import *
        from lss_motion.sequence.model import *
        from lss_motion.trajectory.planner import plan

        model = ServoModel(name="m", family=Family.LSS, speed_max_deg_s=360, wire_per_deg=10)
        joint = Joint(name="a", servo_id=1, bus="b", model=model, position_min_deg=-90,
                      position_max_deg=90, speed_max_deg_s=180, accel_max_deg_s2=600)
        robot = Robot(name="r", path=None, buses={}, joints={"a": joint})

        def show(step_s):
            return Sequence(name="s", keyframes=(
                Keyframe(at_s=0.0, deg={"a": 0.0}), Keyframe(at_s=step_s, deg={"a": 80.0})))

        def print_loaded(*names):
            print(*(name in sys.modules for name in names))

        plan(show(0.1), robot)
        print_loaded("toppra", "lss_motion.trajectory.tracks", "lss_motion.trajectory.verify")
        plan(show(3.0), robot)
        print_loaded("toppra", "scipy", "matplotlib")
        """
    )
    runs = [
        subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for _ in range(2)
    ]
    assert runs[0][0] == "True True True"
    assert runs[1] == ["False False False", "False False False"]


def test_samples_of_a_legal_motion_stay_where_their_author_put_them(make_robot, frame):
    """At full speed, 10 ms apart, they are closer than any move from rest to rest could be."""
    frames = [frame(0.0, base=-90.0), frame(1.0, base=-80.0)]
    frames += [frame(1.0 + 0.01 * n, base=-80.0 + 1.79 * n) for n in range(1, 60)]
    frames += [frame(3.0, base=60.0)]
    trajectory = plan(sequence(*frames), make_robot())
    assert trajectory.first.path.knots_s == pytest.approx(
        [keyframe.at_s for keyframe in frames], abs=1e-9
    )
