"""The verifier finds every excess of a limit, and accepts what is within it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.curves import Path
from lss_motion.planning.trajectory.model import PathClock, PathMotion, Trajectory
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import extreme, verify
from lss_motion.show.model import Sequence, Timing

if TYPE_CHECKING:
    from collections.abc import Callable


def trajectory_of(knots_s, cubics, *, joint="base", **more):
    """Return one joint along a path that is followed at rate 1; `cubics` in rising powers."""
    path = Path(knots_s=np.array(knots_s), coefficients=np.array(cubics, dtype=float)[:, :, None])
    clock = PathClock(
        times_s=np.array([0.0, knots_s[-1]]),
        path_s=np.array([0.0, knots_s[-1]]),
        rates=np.ones(1),
        rate_slopes=np.zeros(1),
    )
    motion = PathMotion(path=path, clock=clock)
    return Trajectory(
        name="made", joints=(joint,), first=motion, middle=motion, last=motion, **more
    )


def bump(deg, seconds):
    """Return two smooth moves of `deg`, out and back, each in `seconds`."""
    there = [0.0, 0.0, 3.0 * deg / seconds**2, -2.0 * deg / seconds**3]
    back = [deg, 0.0, -3.0 * deg / seconds**2, 2.0 * deg / seconds**3]
    return [0.0, seconds, 2.0 * seconds], [there, back]


def test_the_shares_of_the_limits_are_those_of_the_curve(make_robot):
    found = verify(trajectory_of(*bump(60.0, 1.0)), make_robot())
    assert found.speed_ratio == pytest.approx(1.5 * 60.0 / 180.0, rel=1e-3)
    assert found.accel_ratio == pytest.approx(6.0 * 60.0 / 600.0, rel=2e-3)
    assert found.speed_joint == found.accel_joint == "base"
    assert found.samples >= 2000


def test_too_much_speed_is_refused_with_joint_time_and_limit(make_robot):
    with pytest.raises(
        PlanningError, match=r"'base' would reach speed .* allowed 180 deg/s"
    ) as caught:
        verify(trajectory_of(*bump(140.0, 1.1)), make_robot(accel=5000.0))
    assert caught.value.joint == "base"
    assert caught.value.time_s % 1.1 == pytest.approx(0.55, abs=0.01)


@pytest.mark.parametrize(("excess", "is_refused"), [(1.0005, False), (1.003, True)])
def test_a_limit_may_be_exceeded_by_a_thousandth(make_robot, excess, is_refused):
    trajectory = trajectory_of(*bump(60.0, 1.0))
    robot = make_robot(accel=360.0 / excess)
    if is_refused:
        with pytest.raises(PlanningError, match="acceleration"):
            verify(trajectory, robot)
    else:
        verify(trajectory, robot)


def test_an_angle_that_is_not_a_number_is_refused(make_robot):
    with pytest.raises(PlanningError, match="nan"):
        verify(trajectory_of([0.0, 1.0], [[0.0, 0.0, float("nan"), 0.0]]), make_robot())


def test_a_plan_for_a_stronger_robot_is_refused_for_a_weaker_one(make_robot, frame):
    frames = (frame(base=0.0, elbow=0.0), frame(base=90.0, elbow=40.0))
    planned = plan(Sequence(name="s", keyframes=frames, timing=Timing.FASTEST), make_robot())
    with pytest.raises(PlanningError):
        verify(planned, make_robot(speed=178.0))
    with pytest.raises(PlanningError):
        verify(planned, make_robot(accel=595.0))


@dataclass
class Made:
    """A pass of any curve: deg over seconds. It counts what it is samples_count for."""

    curve: Callable[[np.ndarray], np.ndarray]
    duration_s: float
    parts: tuple[Trajectory, ...] = ()
    seams_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    inner_knots_s: tuple[float, ...] = ()
    samples_count: int = 0

    @property
    def knots_s(self):
        return np.array([0.0, *self.inner_knots_s, self.duration_s])

    def sample(self, times_s, order=0):
        assert order == 0, "the verifier derives speed and acceleration itself"
        self.samples_count += len(times_s)
        deg = self.curve(np.clip(times_s, 0.0, self.duration_s))
        return deg if deg.ndim == 2 else deg[:, None]


def shown(*passes, joints=("base",), loop=None):
    """Return a show of the given passes, the middle one repeated to make `loop` passes."""
    return Trajectory(
        name="made",
        joints=joints,
        first=passes[0],
        middle=passes[len(passes) // 2],
        last=passes[-1],
        loop=loop or len(passes),
    )


def still(times_s):
    return np.zeros(len(times_s))


def swing(deg, seconds):
    """Return a pass out and back, with knots at its ends only."""
    return Made(lambda t: 0.5 * deg * (1.0 - np.cos(2.0 * np.pi * t / seconds)), seconds)


def test_a_show_at_rest_uses_no_share_of_the_limits(make_robot):
    motion = Made(lambda t: np.zeros((len(t), 2)), 1.0)
    found = verify(shown(motion, joints=("base", "elbow")), make_robot())
    assert (found.speed_ratio, found.accel_ratio) == (0.0, 0.0)
    assert (found.speed_joint, found.speed_at_s) == ("base", 0.0)
    assert (found.accel_joint, found.accel_at_s) == ("base", 0.0)
    assert found.samples == motion.samples_count > 1000


def cornered(at_s, duration_s=20.0):
    """Return rest, then a second down to a corner of 4 deg/s, and a second up to rest."""

    def curve(t):
        away_s = np.minimum(np.abs(t - at_s), 1.0)
        return 2.0 * away_s - away_s**2

    return Made(curve, duration_s)


@pytest.mark.parametrize("at_s", [0.0007, 4.2, *np.arange(8.186, 8.192, 5e-4), 16.38, 18.9])
def test_a_corner_is_found_at_any_time(make_robot, at_s):
    # 4 deg/s within no time: at least 2000 deg/s² from one millisecond to the next.
    with pytest.raises(PlanningError, match="acceleration") as caught:
        verify(shown(cornered(at_s)), make_robot(accel=1500.0), is_from_rest=at_s > 1.0)
    assert caught.value.time_s == pytest.approx(at_s, abs=0.002)


def test_a_motion_that_begins_with_speed_is_checked_from_its_start_on(make_robot):
    gentle = Made(lambda t: 60.0 - 60.0 * (1.0 - t / 2.0) ** 2, 2.0)
    with pytest.raises(PlanningError, match="acceleration"):
        verify(shown(gentle), make_robot())
    verify(shown(gentle), make_robot(), is_from_rest=False)
    with pytest.raises(PlanningError, match=r"speed 59\.99"):
        verify(shown(gentle), make_robot(speed=59.0), is_from_rest=False)
    with pytest.raises(PlanningError, match="speed 314"):
        verify(shown(swing(110.0, 1.1)), make_robot(speed=300.0, accel=5e3), is_from_rest=False)


def test_the_joint_that_leaves_its_range_is_named_with_the_time_and_the_angle(make_robot):
    for side in (1.0, -1.0):
        dip = swing(side * 170.01, 8.0).curve
        motion = Made(lambda t, dip=dip: np.stack([0.5 * dip(t), dip(t)], axis=1), 8.0)
        with pytest.raises(
            PlanningError, match=rf"'elbow' would be at {side * 170:.0f}.00"
        ) as caught:
            verify(shown(motion, joints=("base", "elbow")), make_robot())
        # It is beyond 170 deg from 3.98 s on.
        assert caught.value.time_s == pytest.approx(3.98, abs=0.005)
        assert caught.value.joint == "elbow"


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_range_may_be_exceeded_by_rounding(make_robot, side):
    verify(shown(Made(lambda t: still(t) + side * (170.0 + 9e-7), 1.0)), make_robot())
    with pytest.raises(PlanningError, match="would be at"):
        verify(shown(Made(lambda t: still(t) + side * (170.0 + 2e-6), 1.0)), make_robot())


@pytest.mark.parametrize("is_at_its_end", [True, False])
@pytest.mark.parametrize("at_s", [1.0, 0.0], ids=["on the way", "first"])
def test_an_acceleration_above_the_limit_at_one_end_of_a_polynomial_only_is_found(
    make_robot, is_at_its_end, at_s
):
    # From 0 to 900 deg/s² within 2 ms, then 100 deg/s² until it rests again: no average over the
    # steps of a millisecond is near 600.
    jerk, brake, short_s = 4.5e5, 100.0, 0.002
    peak_deg_s = 0.5 * jerk * short_s**2
    knots_s = (short_s, short_s + peak_deg_s / brake)

    def nudge(t):
        up_s = np.clip(t, 0.0, knots_s[0])
        down_s = np.clip(t - knots_s[0], 0.0, knots_s[1] - knots_s[0])
        return jerk * up_s**3 / 6.0 + peak_deg_s * down_s - 0.5 * brake * down_s**2

    length_s = 2.0 * at_s + knots_s[1]
    inner_s = tuple(at_s + knot_s for knot_s in (0.0, *knots_s) if 0.0 < at_s + knot_s < length_s)
    if is_at_its_end:
        motion = Made(lambda t: nudge(t - at_s), length_s, inner_knots_s=inner_s)
    else:
        turned_s = tuple(length_s - knot_s for knot_s in reversed(inner_s))
        motion = Made(lambda t: -nudge(length_s - t - at_s), length_s, inner_knots_s=turned_s)
    verify(shown(motion), make_robot(accel=901.0))
    with pytest.raises(PlanningError, match=r"reach acceleration 786.375 deg/s² at"):
        verify(shown(motion), make_robot())


def test_passes_that_repeat_are_sampled_once(make_robot):
    motion = swing(30.0, 2.0)
    verify(shown(motion), make_robot())
    once, motion.samples_count = motion.samples_count, 0
    found = verify(shown(motion, loop=1000), make_robot())
    assert once <= motion.samples_count == found.samples < 1.05 * once
    motion.samples_count = 0
    verify(replace(shown(motion), loop=None), make_robot())
    assert once <= motion.samples_count < 1.05 * once


GOOD = swing(30.0, 2.0)
UP = Made(lambda t: 15.0 * (1.0 - np.cos(np.pi * t)), 1.0)
"""To 30 deg, where it rests."""
AT_30 = Made(lambda t: still(t) + 30.0, 1.0)


@pytest.mark.parametrize(
    ("passes", "loop"),
    [
        ((GOOD, AT_30, GOOD), 3),
        ((UP, AT_30, GOOD), 9),
        ((UP, UP, AT_30), 9),
        ((UP, AT_30, UP), 9),
        ((GOOD, cornered(1.5, 3.0), GOOD), 3),
        ((GOOD, GOOD, cornered(1.5, 3.0)), 6),
    ],
    ids=["first seam", "last seam", "middle seam", "end", "middle", "last"],
)
def test_every_kind_of_pass_and_of_seam_is_checked(make_robot, passes, loop):
    with pytest.raises(PlanningError):
        verify(shown(*passes, loop=loop), make_robot(accel=1500.0))


def test_a_legal_show_of_three_different_passes_is_accepted(make_robot):
    down = Made(lambda t: 15.0 * (1.0 + np.cos(np.pi * t)), 1.0)
    verify(shown(UP, AT_30, down, loop=9), make_robot())


def assembled(curve, duration_s, part, *seams_s):
    """Return a pass of trajectories: `part` is checked as its part, `curve` gives its samples."""
    return Made(curve, duration_s, parts=(part,), seams_s=np.array(seams_s))


def test_the_parts_of_a_pass_are_checked_as_shows_of_their_own(make_robot):
    whole, robot = swing(60.0, 2.0), make_robot()
    made = verify(shown(assembled(whole.curve, 2.0, shown(whole))), robot)
    alone = verify(shown(swing(60.0, 2.0)), robot)
    assert (made.speed_ratio, made.accel_ratio) == (alone.speed_ratio, alone.accel_ratio)
    assert (made.speed_joint, made.accel_joint) == ("base", "base")
    assert alone.samples < made.samples < 1.05 * alone.samples
    bad = assembled(still, 2.0, shown(cornered(1.0, 2.0)))
    with pytest.raises(PlanningError, match="acceleration"):
        verify(shown(bad), make_robot(accel=1500.0))
    verify(shown(bad), make_robot(accel=1500.0), has_parts=False)


def test_of_several_parts_the_largest_shares_are_kept(make_robot):
    parts = [shown(swing(deg, 2.0)) for deg in (20.0, 60.0, 40.0)]
    motion = Made(still, 6.0, parts=tuple(parts), seams_s=np.array([2.0, 4.0]))
    most = verify(parts[1], make_robot())
    found = verify(shown(motion), make_robot())
    assert (found.speed_ratio, found.accel_ratio) == (most.speed_ratio, most.accel_ratio)


def test_the_seams_between_parts_are_checked_in_every_pass(make_robot):
    part, robot = shown(GOOD), make_robot()
    rest = assembled(still, 5.0, part, 2.0)
    stepped = assembled(lambda t: np.where(t < 2.0, 0.0, 0.01), 5.0, part, 2.0)
    lifted = assembled(lambda t: still(t) + 0.01, 5.0, part, 2.0)
    verify(shown(rest, rest, rest), robot)
    for passes in ((rest, rest, stepped), (stepped, lifted, lifted), (rest, lifted, lifted)):
        with pytest.raises(PlanningError):
            verify(shown(*passes), robot)


def test_a_show_of_parts_ends_at_rest(make_robot):
    part = shown(GOOD)
    running = assembled(lambda t: np.maximum(t - 4.0, 0.0), 5.0, part)
    with pytest.raises(PlanningError, match=r"acceleration .* at [45]\."):
        verify(shown(running), make_robot())


def test_differences_at_knots_stay_within_a_short_polynomial(make_robot):
    # 700 deg/s² for 0.2 ms: over any longer time it looks harmless.
    short_s, up_deg_s2, down_deg_s2 = 0.0002, 700.0, 70.0
    peak_deg_s = up_deg_s2 * short_s
    cubics = [
        [0.0, 0.0, up_deg_s2 / 2.0, 0.0],
        [up_deg_s2 * short_s**2 / 2.0, peak_deg_s, -down_deg_s2 / 2.0, 0.0],
    ]
    nudge = trajectory_of([0.0, short_s, short_s + peak_deg_s / down_deg_s2], cubics)
    verify(nudge, make_robot(accel=700.0))
    with pytest.raises(PlanningError, match=r"acceleration 699.998"):
        verify(nudge, make_robot(accel=600.0))


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_extreme_covers_every_row_and_gives_nan_if_there_is_one(count):
    samples = np.random.default_rng(count).normal(size=(count, 3))
    assert extreme(np.maximum, samples).tolist() == samples.max(axis=0).tolist()
    assert extreme(np.minimum, samples).tolist() == samples.min(axis=0).tolist()
    samples[-1, 1] = np.nan
    assert np.isnan(extreme(np.maximum, samples)).tolist() == [False, True, False]
