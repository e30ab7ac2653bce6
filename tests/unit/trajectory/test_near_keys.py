"""Keyframes without times: the shape follows the points, and what repeats nearly is no stop."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Interpolation, Keyframe, Sequence, Timing

ALIKE_S = 0.01


def line(degs, ease="smooth", **fields) -> Sequence:
    frames = tuple(
        Keyframe(at_s=None, deg={"base": deg, "elbow": 0.5 * deg}, ease=Interpolation(ease))
        for deg in degs
    )
    return Sequence(name="line", keyframes=frames, **{"timing": Timing.FASTEST, **fields})


@pytest.mark.parametrize("ease", ["smooth", "spline"])
@pytest.mark.parametrize(
    "more",
    [(40.0,), (40.0001,), (40.05,), (40.1,), (40.3,), (45.0,), (41.0, 42.0), (79.0,), (0.5,)],
)
def test_a_key_nearby_on_a_line_costs_no_time(make_robot, ease, more):
    robot = make_robot()
    plain = plan(line((0.0, 40.0, 80.0), ease), robot)
    found = plan(line(sorted((0.0, 40.0, 80.0, *more)), ease), robot)
    verify(found, robot)
    assert found.duration_s == pytest.approx(plain.duration_s, abs=ALIKE_S)
    assert len(found.marks) == 3 + len(more)
    reached_s = [mark.planned_s for mark in found.marks]
    assert reached_s == sorted(reached_s)
    reached_deg = found.sample(np.array(reached_s))[:, 0]
    assert reached_deg == pytest.approx(sorted((0.0, 40.0, 80.0, *more)), abs=0.11)


def test_a_line_with_a_near_key_fits_as_without_it(make_robot):
    show = line((0.0, 40.0, 40.1, 80.0), timing=Timing.FIT, fit_duration_s=1.0)
    assert plan(show, make_robot()).duration_s == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("ease", ["smooth", "spline"])
def test_points_of_a_circle_that_repeat_nearly_are_one(make_robot, ease):
    robot = make_robot()
    angles = np.linspace(0.0, 2.0 * np.pi, 21)
    points = [(60.0 * np.cos(a), 60.0 * np.sin(a)) for a in angles]
    more = [
        point
        for k, (x, y) in enumerate(points)
        for point in ([(x, y), (x + 0.01, y - 0.02)] if k in (5, 10, 15) else [(x, y)])
    ]
    shows = [
        Sequence(
            name="circle",
            timing=Timing.FASTEST,
            keyframes=tuple(
                Keyframe(at_s=None, deg={"base": x, "elbow": y}, ease=Interpolation(ease))
                for x, y in found
            ),
        )
        for found in (points, more)
    ]
    plain, repeated = (plan(show, robot) for show in shows)
    assert repeated.duration_s == pytest.approx(plain.duration_s, abs=1e-6)


def test_a_slow_drift_survives_and_the_last_key_is_reached(make_robot):
    degs = np.round(np.arange(0.0, 3.001, 0.04), 2).tolist()
    found = plan(line(degs), make_robot())
    assert len(found.marks) == len(degs)
    at_deg = found.sample(np.array([mark.planned_s for mark in found.marks]))[:, 0]
    assert np.abs(at_deg - degs).max() <= 0.1 + 1e-6
    assert at_deg[-1] == pytest.approx(degs[-1], abs=1e-9)


def test_a_hold_tells_a_key_apart(make_robot):
    robot = make_robot()
    frames = list(line((0.0, 40.0, 40.05, 80.0)).keyframes)
    frames[2] = Keyframe(at_s=None, deg=frames[2].deg, hold_s=0.5, ease=frames[2].ease)
    found = plan(Sequence(name="held", timing=Timing.FASTEST, keyframes=tuple(frames)), robot)
    mark = found.marks[2]
    assert mark.held_s == pytest.approx(0.5)
    assert found.sample(np.array([mark.planned_s + 0.25]))[0, 0] == pytest.approx(40.05)


def test_a_fit_that_is_too_short_is_still_refused(make_robot):
    with pytest.raises(PlanningError, match="fastest takes"):
        plan(line((0.0, 40.0, 40.1, 80.0), timing=Timing.FIT, fit_duration_s=0.5), make_robot())
