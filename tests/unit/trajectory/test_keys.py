"""The keys of a sequence: what is refused, and where keys lie along the path."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Timing
from tests.unit.trajectory.shows import show, trapezoid_s


def test_one_keyframe_lasts_as_long_as_its_hold(make_robot, frame):
    assert plan(show(frame(0.0, base=5.0)), make_robot()).duration_s == 0.0
    trajectory = plan(show(frame(0.0, base=5.0, hold_s=2.0)), make_robot())
    assert trajectory.duration_s == pytest.approx(2.0)
    assert trajectory.sample(np.array([-1.0, 1.0, 9.0]))[:, 0] == pytest.approx(5.0)


@pytest.mark.parametrize("timing", [Timing.AUTHORED, Timing.FASTEST])
def test_repeated_keyframes_change_nothing(make_robot, frame, timing):
    once = [frame(0.0, base=0.0), frame(1.0, base=50.0), frame(2.0, base=0.0)]
    twice = [each for each in once for _ in range(2)]
    single, double = (plan(show(*frames, timing=timing), make_robot()) for frames in (once, twice))
    assert double.duration_s == pytest.approx(single.duration_s, abs=1e-9)
    times_s = np.linspace(0.0, single.duration_s, 100)
    assert double.sample(times_s) == pytest.approx(single.sample(times_s), abs=1e-9)


@pytest.mark.parametrize("step_s", [0.0, 1e-7, 1e-3])
def test_keys_at_nearly_one_instant_are_moved_apart_to_the_least_duration(
    make_robot, frame, step_s
):
    frames = [
        frame(0.0, base=0.0),
        frame(1.0, base=0.0),
        frame(1.0 + step_s, base=90.0),
        frame(4.0, base=0.0),
    ]
    trajectory = plan(show(*frames), make_robot())
    (stretch,) = trajectory.stretched
    assert stretch.by_s == pytest.approx(trapezoid_s(90.0) - step_s, rel=0.02)


def test_joints_come_in_the_order_of_the_robot_and_only_if_keyed(make_robot, frame):
    trajectory = plan(
        show(frame(0.0, j2=1.0), frame(1.0, base=2.0), frame(2.0, j2=0.0)), make_robot(4)
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
def test_an_invalid_sequence_is_refused_with_its_reason(make_robot, frame, frames, message):
    with pytest.raises(InputError, match=message):
        plan(show(*(frame(**fields) for fields in frames)), make_robot())


def test_one_error_has_all_problems(make_robot, frame):
    with pytest.raises(InputError) as caught:
        plan(
            show(frame(0.0, base=999.0, line=3), frame(1.0, nose=1.0, line=4), path="a.yaml"),
            make_robot(),
        )
    assert [line.split(" ")[0] for line in str(caught.value).splitlines()] == [
        "a.yaml:3:",
        "a.yaml:4:",
    ]


def test_samples_of_a_legal_motion_keep_their_times(make_robot, frame):
    """At full speed, 10 ms apart, they are closer than any move from rest to rest could be."""
    frames = [frame(0.0, base=-90.0), frame(1.0, base=-80.0)]
    frames += [frame(1.0 + 0.01 * n, base=-80.0 + 1.79 * n) for n in range(1, 60)]
    frames += [frame(3.0, base=60.0)]
    trajectory = plan(show(*frames), make_robot())
    assert trajectory.first.path.knots_s == pytest.approx(
        [keyframe.at_s for keyframe in frames], abs=1e-9
    )
