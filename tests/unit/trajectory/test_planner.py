"""The speed of a show, the cache of plans, and what planning imports."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.files import cache
from lss_motion.planning.trajectory.kept_plans import cache_name
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Sequence, Timing
from tests.unit.trajectory.shows import show


@pytest.fixture
def fast_move(frame):
    """Return a move that is faster than the limits allow."""
    return Sequence(name="s", keyframes=(frame(0.0, base=0.0), frame(0.2, base=90.0)))


def test_a_legal_show_and_a_cached_plan_do_not_import_toppra() -> None:
    script = textwrap.dedent(
        """
        import sys
        from lss_motion.robot.model import *
        from lss_motion.show.model import *
        from lss_motion.planning.trajectory.planner import plan

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
        modules = ("trajectory.tracks", "trajectory.solver")
        print_loaded("toppra", *(f"lss_motion.planning.{name}" for name in modules))
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


def test_a_speed_ratio_divides_authored_times(make_robot, frame):
    slow = show(frame(0.0, base=0.0), frame(1.0, base=30.0, hold_s=1.0), speed_ratio=0.5)
    trajectory = plan(slow, make_robot())
    assert trajectory.duration_s == pytest.approx(4.0)
    assert trajectory.marks[1].planned_s == pytest.approx(2.0)


def test_a_fastest_show_is_slowed_as_a_whole(make_robot, frame):
    frames = (frame(base=0.0), frame(base=30.0, hold_s=1.0), frame(base=0.0))
    quick = plan(show(*frames, timing=Timing.FASTEST), make_robot())
    slow = plan(show(*frames, timing=Timing.FASTEST, speed_ratio=0.5), make_robot())
    times_s = np.linspace(0.0, quick.duration_s, 50)
    assert slow.sample(2.0 * times_s) == pytest.approx(quick.sample(times_s), abs=1e-9)
    assert slow.marks[2].planned_s == pytest.approx(2.0 * quick.marks[2].planned_s)


def test_a_plan_is_loaded_from_the_cache_and_equal(fast_move, make_robot, monkeypatch):
    first = plan(fast_move, make_robot())
    monkeypatch.setattr("lss_motion.planning.trajectory.tracks.timed", None)
    monkeypatch.setattr("lss_motion.planning.trajectory.tracks.verify", None)
    again = plan(fast_move, make_robot())
    times_s = np.linspace(0.0, first.duration_s, 99)
    assert np.array_equal(first.sample(times_s), again.sample(times_s))
    assert (again.marks, again.stretched) == (first.marks, first.stretched)
    assert (again.name, again.joints, again.loop) == (first.name, first.joints, first.loop)


@pytest.mark.parametrize("loop", [2, 5, None])
def test_passes_that_differ_are_cached_and_equal(frame, make_robot, loop, monkeypatch):
    frames = [frame(0.0, base=0.0), frame(0.3, base=90.0), frame(0.9, base=-90.0)]
    show = Sequence(name="s", keyframes=(*frames, frame(1.2, base=0.0)), loop=loop)
    first = plan(show, make_robot())
    monkeypatch.setattr("lss_motion.planning.trajectory.tracks.verify", None)
    again = plan(show, make_robot())
    assert again.is_periodic
    assert again.first is not again.middle
    times_s = np.linspace(0.0, 5.0, 99)
    assert np.array_equal(first.sample(times_s, 1), again.sample(times_s, 1))


@pytest.mark.parametrize(
    "change",
    [
        {"timing": Timing.FASTEST},
        {"timing": Timing.FIT, "fit_duration_s": 3.0},
        {"loop": 2},
        {"name": "other"},
    ],
)
def test_timing_loop_and_name_change_the_cache_name(fast_move, make_robot, change):
    assert cache_name(fast_move, make_robot()) != cache_name(
        replace(fast_move, **change), make_robot()
    )


def test_every_field_of_a_keyframe_and_every_limit_changes_the_cache_name(
    fast_move, frame, make_robot
):
    def name(speed=180.0, accel=600.0, reach=170.0, **fields):
        frames = (frame(0.0, base=0.0), frame(**{"at_s": 0.2, "base": 90.0} | fields))
        robot = make_robot(speed=speed, accel=accel, reach=reach)
        return cache_name(replace(fast_move, keyframes=frames), robot)

    names = [
        name(),
        name(at_s=0.3),
        name(base=91.0),
        name(elbow=3.0),
        name(hold_s=1.0),
        name(ease="linear"),
        name(label="x"),
        name(anchor=True),
        name(speed=181.0),
        name(accel=601.0),
        name(reach=171.0),
    ]
    assert len(set(names)) == len(names)


def test_other_limits_give_another_entry(fast_move, make_robot):
    quick, slow = plan(fast_move, make_robot()), plan(fast_move, make_robot(speed=90.0))
    assert slow.duration_s > quick.duration_s
    assert len(list(cache.cache_directory().glob(f"*{cache.PLAN_SUFFIX}"))) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", None])
def test_a_damaged_entry_is_replaced(fast_move, make_robot, damage):
    planned = plan(fast_move, make_robot())
    (entry,) = cache.cache_directory().glob(f"*{cache.PLAN_SUFFIX}")
    whole = entry.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 0xFF]) + whole[middle + 1 :]
    entry.write_bytes(flipped if damage is None else damage)
    assert plan(fast_move, make_robot()).duration_s == planned.duration_s
    assert len(entry.read_bytes()) == len(whole)


def test_a_cache_that_cannot_be_written_is_no_error(fast_move, make_robot, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(cache.DIRECTORY_VARIABLE, str(tmp_path / "file" / "below"))
    assert plan(fast_move, make_robot()).duration_s > 0.2


def test_the_cache_stays_bounded(fast_move, make_robot, monkeypatch):
    monkeypatch.setattr(cache, "BYTES_MAX", 60_000)
    for speed in range(60, 120, 5):
        plan(fast_move, make_robot(speed=float(speed)))
    sizes = [entry.stat().st_size for entry in cache.cache_directory().iterdir()]
    assert 0 < sum(sizes) <= 60_000
