"""A stored plan is nobody's word: a damaged, foreign or poisoned entry is a miss."""

from __future__ import annotations

import hashlib
import io
import json
import os
import random
import zipfile

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.files import cache
from lss_motion.planning.trajectory.curves import Path as JointPath
from lss_motion.planning.trajectory.model import PathClock, PathMotion
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.recheck import _Limits, _pieces_within, is_within_limits
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Layer, Sequence
from tests.unit.trajectory.shows import show


@pytest.fixture
def fast_show(frame):
    """Moves that must be slowed, so that their plan is stored."""
    angles = (0.0, 90.0, -60.0, 40.0, 0.0)
    frames = [frame(0.3 * index, base=deg, elbow=-deg) for index, deg in enumerate(angles)]
    return show(*frames, loop=3)


def entry():
    (path,) = cache.cache_directory().glob(f"*{cache.PLAN_SUFFIX}")
    return path


def content_of(path):
    with np.load(io.BytesIO(path.read_bytes()[32:])) as stored:
        return {name: stored[name].copy() for name in stored.files}


def put(path, arrays, *, save=np.savez):
    """Write an entry as the program does, with a digest that is right."""
    content = io.BytesIO()
    save(content, **arrays)
    seal(path, content.getvalue())


def seal(path, content):
    name = path.name.removesuffix(cache.PLAN_SUFFIX)
    path.write_bytes(hashlib.sha256(name.encode() + content).digest() + content)


def sampled(trajectory):
    times_s = np.linspace(0.0, trajectory.duration_s, 500)
    return trajectory.sample(times_s)


def faster(arrays):
    arrays["0.times_s"] /= 2.0
    arrays["0.rates"] *= 2.0
    arrays["0.rate_slopes"] *= 4.0


def further(arrays):
    arrays["0.coefficients"][:, 0] += 500.0


def elsewhere(arrays):
    """A plan within all limits, but of another show."""
    arrays["0.coefficients"] *= 0.5
    for number in ("1", "2"):
        if f"{number}.coefficients" in arrays:
            arrays[f"{number}.coefficients"] *= 0.5


def jumping(arrays):
    arrays["0.coefficients"][3:, 0] += 5.0


def in_motion(arrays):
    arrays["0.rates"][0] = 1.0
    arrays["0.coefficients"][0, 1] = 50.0


def backwards(arrays):
    arrays["0.rates"] *= -1.0


def endless_number(arrays):
    arrays["0.times_s"][2] = np.nan


def infinite(arrays):
    arrays["0.coefficients"][0, 3, 0] = np.inf


def unordered(arrays):
    arrays["0.knots_s"] = arrays["0.knots_s"][::-1].copy()


def short(arrays):
    arrays["0.rates"] = arrays["0.rates"][:-1]


def flat(arrays):
    arrays["0.coefficients"] = arrays["0.coefficients"].ravel()


def texts(arrays):
    arrays["0.rates"] = arrays["0.rates"].astype(str)


def empty(arrays):
    for name in list(arrays):
        if name != "facts":
            arrays[name] = arrays[name][:0]


def missing(arrays):
    del arrays["0.rates"]


def facts(**changes):
    def change(arrays):
        stored = json.loads(arrays["facts"].tobytes())
        for key, value in changes.items():
            stored[key] = value(stored[key]) if callable(value) else value
        arrays["facts"] = np.frombuffer(json.dumps(stored).encode(), dtype=np.uint8)

    return change


POISONS = [
    *(faster, further, elsewhere, jumping, in_motion, backwards, endless_number, infinite),
    *(unordered, short, flat, texts, empty, missing),
    *(facts(joints=["elbow", "base"]), facts(joints=["base", "nobody"]), facts(joints=["base"])),
    *(facts(joints=7), facts(loop=9), facts(loop="3"), facts(loop=None), facts(parts=[0, 0, 9])),
    *(facts(parts=[]), facts(parts="abc"), facts(parts=[10**30] * 3), facts(is_periodic="no")),
    *(facts(marks=[]), facts(marks=[{}]), facts(marks=None), facts(name="other")),
    facts(marks=lambda marks: [{**mark, "planned_s": "0"} for mark in marks]),
    facts(marks=lambda marks: [{**mark, "planned_s": float("nan")} for mark in marks]),
    facts(marks=lambda marks: [{**mark, "label": 3} for mark in marks]),
    facts(marks=lambda marks: [{**mark, "more": 3} for mark in marks]),
    facts(stretched=lambda spans: [{**span, "by_s": None} for span in spans]),
]


def test_an_entry_as_it_was_stored_is_used(fast_show, make_robot, monkeypatch):
    planned = plan(fast_show, make_robot())
    put(entry(), content_of(entry()))
    monkeypatch.setattr("lss_motion.planning.trajectory.tracks.planned_track", None)
    monkeypatch.setattr("lss_motion.planning.trajectory.recheck.verify", None)
    again = plan(fast_show, make_robot())
    assert np.array_equal(sampled(again), sampled(planned))
    assert (again.marks, again.stretched) == (planned.marks, planned.stretched)
    assert planned.stretched


@pytest.mark.parametrize("poison", POISONS)
def test_a_poisoned_entry_is_a_miss(poison, fast_show, make_robot):
    planned = plan(fast_show, make_robot())
    path = entry()
    whole = path.read_bytes()
    arrays = content_of(path)
    poison(arrays)
    put(path, arrays)
    assert path.read_bytes() != whole
    again = plan(fast_show, make_robot())
    assert np.array_equal(sampled(again), sampled(planned))
    assert path.read_bytes() == whole


def test_an_entry_under_another_name_is_a_miss(fast_show, make_robot):
    plan(fast_show, make_robot(speed=180.0))
    quick = entry()
    whole = quick.read_bytes()
    quick.unlink()
    slow = plan(fast_show, make_robot(speed=60.0))
    path = entry()
    path.write_bytes(whole)
    assert np.array_equal(sampled(plan(fast_show, make_robot(speed=60.0))), sampled(slow))


@pytest.mark.parametrize(
    "content", [b"", b"\0" * 40, b"PK\x03\x04", b"[]", b"\x93NUMPY\x01\x00" + b"\xff" * 60]
)
def test_sealed_nonsense_is_a_miss(content, fast_show, make_robot):
    planned = plan(fast_show, make_robot())
    seal(entry(), content)
    assert np.array_equal(sampled(plan(fast_show, make_robot())), sampled(planned))


def test_an_entry_that_would_grow_is_a_miss(fast_show, make_robot):
    planned = plan(fast_show, make_robot())
    arrays = content_of(entry())
    arrays["more"] = np.zeros(10_000_000)
    put(entry(), arrays, save=np.savez_compressed)
    assert np.array_equal(sampled(plan(fast_show, make_robot())), sampled(planned))


def test_an_array_larger_than_the_memory_is_a_miss(fast_show, make_robot):
    planned = plan(fast_show, make_robot())
    path = entry()
    with zipfile.ZipFile(io.BytesIO(path.read_bytes()[32:])) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117)
    parts["0.rates.npy"] = b"\x93NUMPY\x01\x00" + bytes([118, 0]) + head + b"\n"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    seal(path, content.getvalue())
    assert np.array_equal(sampled(plan(fast_show, make_robot())), sampled(planned))


def test_a_pipe_in_place_of_an_entry_is_a_miss(fast_show, make_robot):
    planned = plan(fast_show, make_robot())
    path = entry()
    path.unlink()
    os.mkfifo(path)
    assert np.array_equal(sampled(plan(fast_show, make_robot())), sampled(planned))


@pytest.mark.slow
def test_whatever_bytes_change_the_plan_keeps_the_limits(fast_show, make_robot):
    """Sealed entries with random changes: each is the plan, or a miss, or legal all the same."""
    robot, generator = make_robot(), random.Random(21)
    planned = plan(fast_show, robot)
    path = entry()
    whole = path.read_bytes()
    for _ in range(150):
        content = bytearray(whole[32:])
        for _ in range(generator.choice((1, 1, 3, 30))):
            content[generator.randrange(len(content))] = generator.randrange(256)
        seal(path, bytes(content))
        again = plan(fast_show, robot)
        verify(again, robot)
        keys_s = [mark.planned_s for mark in planned.marks]
        got_s = [mark.planned_s for mark in again.marks]
        assert again.sample(np.array(got_s)) == pytest.approx(
            planned.sample(np.array(keys_s)), abs=1e-5
        )


@pytest.mark.slow
def test_a_poisoned_layer_is_a_miss(make_robot, frame):
    top = Sequence(name="top", keyframes=(frame(0.0, base=0.0), frame(1.0, base=5.0)))
    layer = Layer(sequence=top, joints=("base",), mode="add", from_s=1.0, fade_s=0.2)
    angles = [frame(0.25 * n, base=10.0 * (-1) ** n, elbow=float(n)) for n in range(40)]
    layered = replace(show(*angles), layers=(layer,))
    planned = plan(layered, make_robot())
    for path in cache.cache_directory().iterdir():
        arrays = content_of(path)
        arrays["0.coefficients"] *= 0.5
        put(path, arrays)
    assert np.array_equal(sampled(plan(layered, make_robot())), sampled(planned))


def test_the_closed_form_finds_what_the_samples_find(make_robot, frame):
    """Random legal plans pass both checks; the same, a little beyond one limit, pass neither."""
    generator = np.random.default_rng(7)
    robot = make_robot()
    for _ in range(30):
        times_s = np.cumsum(generator.uniform(0.1, 1.0, 12))
        frames = [
            frame(at_s, base=base, elbow=elbow)
            for at_s, base, elbow in zip(
                times_s.tolist(), *generator.uniform(-100.0, 100.0, (2, 12)).tolist(), strict=True
            )
        ]
        trajectory = plan(show(*frames), robot)
        assert is_within_limits(trajectory, robot)
        found = verify(trajectory, robot)
        for limits, ratio in (
            ({"speed": 180.0 * found.speed_ratio * 0.99}, found.speed_ratio),
            ({"accel": 600.0 * found.accel_ratio * 0.99}, found.accel_ratio),
        ):
            assert ratio > 0.0
            weaker = make_robot(**limits)
            with pytest.raises(PlanningError):
                verify(trajectory, weaker)
            assert not is_within_limits(trajectory, weaker)


WIDTH_S = 0.5
CLOSE_RATIO = 1e-4
"""A limit is that much above or below an extreme, which a fine grid shows to a tenth of it."""


@pytest.mark.parametrize("kind", ["angle", "speed", "accel"])
def test_an_extreme_within_a_piece_is_found(kind):
    generator, inner = np.random.default_rng(5), 0
    u = np.linspace(0.0, WIDTH_S, 4001)
    for _ in range(200):
        c0, c1 = generator.uniform(50.0, 90.0), generator.uniform(-40.0, 40.0)
        c2, c3 = generator.uniform(-200.0, 200.0, 2)
        start, end = generator.uniform(0.3, 1.0, 2)
        slope = (end**2 - start**2) / (2.0 * WIDTH_S)
        rate = np.sqrt(start**2 + 2.0 * slope * u)
        first, second = c1 + u * (2.0 * c2 + 3.0 * u * c3), 2.0 * c2 + 6.0 * u * c3
        found = {
            "angle": c0 + u * (c1 + u * (c2 + u * c3)),
            "speed": np.abs(first * rate),
            "accel": np.abs(second * rate**2 + first * slope),
        }[kind]
        inner += 0 < found.argmax() < len(u) - 1
        cubic = np.array([c0, c1, c2, c3]).reshape(1, 4, 1)
        path = JointPath(knots_s=np.array([0.0, WIDTH_S]), coefficients=cubic)
        clock = PathClock(
            times_s=np.array([0.0, (end - start) / slope]),
            path_s=np.array([0.0, WIDTH_S]),
            rates=np.array([start]),
            rate_slopes=np.array([slope]),
        )
        for ratio, is_kept in ((1.0 + CLOSE_RATIO, True), (1.0 - CLOSE_RATIO, False)):
            limits = limited(kind, ratio * float(found.max()))
            assert (
                _pieces_within(PathMotion(path=path, clock=clock), limits) is not None
            ) == is_kept
    assert inner > 5


def limited(kind, most):
    """Return limits of one joint, all of them infinite but one."""
    limits = object.__new__(_Limits)
    limits.low_deg, limits.high_deg = np.array([-np.inf]), np.array([np.inf])
    limits.speed_deg_s, limits.accel_deg_s2 = np.array([np.inf]), np.array([np.inf])
    limits.jump_deg_s = np.array([np.inf])
    name = {"angle": "high_deg", "speed": "speed_deg_s", "accel": "accel_deg_s2"}[kind]
    setattr(limits, name, np.array([most]))
    return limits


def test_a_jump_between_two_blocks_of_pieces_is_found(fast_show, make_robot, monkeypatch):
    def refuse(*_):
        raise PlanningError("not proved")

    trajectory, robot = plan(fast_show, make_robot()), make_robot()
    monkeypatch.setattr("lss_motion.planning.trajectory.recheck.verify", refuse)
    monkeypatch.setattr("lss_motion.planning.trajectory.recheck.BLOCK_PIECES", 1)
    assert is_within_limits(trajectory, robot)
    path = trajectory.middle.path
    coefficients = path.coefficients.copy()
    coefficients[2, 0] += 0.5
    jumping = replace(trajectory.middle, path=replace(path, coefficients=coefficients))
    assert not is_within_limits(replace(trajectory, middle=jumping), robot)
