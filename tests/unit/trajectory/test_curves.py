"""The curves between keys."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Sequence
from tests.unit.trajectory.shows import show, trapezoid_s


def test_linear_moves_stay_on_a_straight_line(make_robot, frame):
    frames = [frame(0.0, base=0.0, elbow=10.0), frame(2.0, base=80.0, elbow=-30.0, ease="linear")]
    deg = plan(show(*frames), make_robot()).sample(np.linspace(0.0, 2.0, 500))
    assert deg[:, 1] == pytest.approx(10.0 - deg[:, 0] / 2.0, abs=1e-9)


def test_hold_moves_as_late_as_the_limits_allow(make_robot, frame):
    frames = [frame(0.0, base=0.0), frame(3.0, base=90.0, ease="hold")]
    trajectory = plan(show(*frames), make_robot())
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
    speeds = plan(show(*frames), make_robot()).sample(np.array([1.0, 2.0]), 1)[:, 0]
    assert speeds[0] > 20.0
    assert speeds[1] == pytest.approx(0.0, abs=1e-9)


def test_a_spline_has_no_jump_of_acceleration_at_its_keys(make_robot, frame):
    frames = [
        frame(float(at_s), base=deg, ease="spline")
        for at_s, deg in enumerate([0.0, 30.0, 20.0, 50.0, 0.0])
    ]
    trajectory = plan(show(*frames), make_robot())
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
        plan(show(*frames, path="show.yaml"), make_robot())


@pytest.mark.parametrize("ease", ["smooth", "spline", "linear", "hold"])
def test_integers_give_the_same_plan_as_floats(make_robot, frame, ease):
    whole = [frame(0, base=0), frame(2, base=45, ease=ease), frame(3, base=30, ease=ease)]
    exact = [
        frame(0.0, base=0.0),
        frame(2.0, base=45.0, ease=ease),
        frame(3.0, base=30.0, ease=ease),
    ]
    times_s = np.linspace(0.0, 3.0, 50)
    by_whole, by_exact = (
        plan(show(*frames), make_robot()).sample(times_s) for frames in (whole, exact)
    )
    assert np.array_equal(by_whole, by_exact)


def test_a_noisy_recording_does_not_swing_beyond_its_keys(make_robot, frame):
    random = np.random.default_rng(4)
    noisy = np.round(20.0 * np.sin(np.arange(300) / 20.0) + random.normal(0.0, 0.03, 300), 2)
    frames = [frame(0.05 * index, base=float(deg)) for index, deg in enumerate(noisy)]
    trajectory = plan(Sequence(name="trap", keyframes=tuple(frames)), make_robot())
    deg = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 20_000))[:, 0]
    assert noisy.min() - 1e-9 <= deg.min()
    assert deg.max() <= noisy.max() + 1e-9
    assert trajectory.duration_s == pytest.approx(0.05 * 299, abs=0.05)
