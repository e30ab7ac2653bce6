"""A kept plan counts if this user's program kept it under this name, and it passes the verifier."""

import pickle

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.files import cache
from lss_motion.planning import kept
from lss_motion.planning.trajectory.model import Trajectory
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Layer, Sequence
from tests.unit.trajectory.shows import show


@pytest.fixture
def fast_show(frame):
    """Moves that must be slowed, so that their plan is kept."""
    angles = (0.0, 90.0, -60.0, 40.0, 0.0)
    frames = [frame(0.3 * index, base=deg, elbow=-deg) for index, deg in enumerate(angles)]
    return show(*frames, loop=3)


def entry():
    (path,) = cache.cache_directory().glob(f"*{cache.PLAN_SUFFIX}")
    return path


def stored(path):
    return pickle.loads(path.read_bytes()[cache.MARK_BYTES :])


def put(path, value):
    """Write an entry as the program does, with a mark that is right."""
    kept.keep(cache.PLAN_SUFFIX, path.name.removesuffix(cache.PLAN_SUFFIX), value)


def sampled(trajectory):
    return trajectory.sample(np.linspace(0.0, trajectory.duration_s, 500))


def with_path(trajectory, change):
    coefficients = trajectory.middle.path.coefficients.copy()
    change(coefficients)
    path = replace(trajectory.middle.path, coefficients=coefficients)
    return replace(trajectory, middle=replace(trajectory.middle, path=path))


def faster(trajectory: Trajectory) -> Trajectory:
    clock = trajectory.middle.clock
    quick = replace(
        clock,
        times_s=clock.times_s / 2.0,
        rates=clock.rates * 2.0,
        rate_slopes=clock.rate_slopes * 4.0,
    )
    return replace(trajectory, middle=replace(trajectory.middle, clock=quick))


def further(trajectory):
    def change(coefficients):
        coefficients[:, 0] += 500.0

    return with_path(trajectory, change)


def jumping(trajectory):
    def change(coefficients):
        coefficients[3:, 0] += 5.0

    return with_path(trajectory, change)


def test_a_kept_plan_is_used(fast_show, make_robot, monkeypatch):
    planned = plan(fast_show, make_robot())
    monkeypatch.setattr("lss_motion.planning.trajectory.tracks.planned_track", None)
    again = plan(fast_show, make_robot())
    assert np.array_equal(sampled(again), sampled(planned))
    assert (again.marks, again.stretched) == (planned.marks, planned.stretched)
    assert planned.stretched


@pytest.mark.parametrize("change", [faster, further, jumping, lambda _: 7])
def test_a_kept_plan_that_breaks_a_limit_is_made_again(change, fast_show, make_robot):
    planned = plan(fast_show, make_robot())
    path = entry()
    put(path, change(stored(path)))
    assert np.array_equal(sampled(plan(fast_show, make_robot())), sampled(planned))
    assert np.array_equal(sampled(stored(path)), sampled(planned))


def test_an_entry_under_another_name_is_a_miss(fast_show, make_robot):
    plan(fast_show, make_robot(speed=180.0))
    quick = entry()
    whole = quick.read_bytes()
    quick.unlink()
    slow = plan(fast_show, make_robot(speed=60.0))
    entry().write_bytes(whole)
    assert np.array_equal(sampled(plan(fast_show, make_robot(speed=60.0))), sampled(slow))


def test_kept_layers_are_used_and_checked(make_robot, frame):
    top = Sequence(name="top", keyframes=(frame(0.0, base=0.0), frame(1.0, base=5.0)))
    layer = Layer(sequence=top, joints=("base",), mode="add", from_s=1.0, fade_s=0.2)
    angles = [frame(0.25 * n, base=10.0 * (-1) ** n, elbow=float(n)) for n in range(40)]
    layered = replace(show(*angles), layers=(layer,))
    planned = plan(layered, make_robot())
    paths = list(cache.cache_directory().iterdir())
    assert paths
    for path in paths:
        put(path, further(stored(path)))
    assert np.array_equal(sampled(plan(layered, make_robot())), sampled(planned))
