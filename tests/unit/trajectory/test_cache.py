from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lss_motion.sequence.model import Sequence, Timing
from lss_motion.trajectory import planner
from lss_motion.trajectory.planner import plan


@pytest.fixture
def show(frame):
    return Sequence(name="s", keyframes=(frame(0.0, base=0.0), frame(0.2, base=90.0)))


def test_a_plan_is_remembered_and_the_same_again(show, make_robot, monkeypatch):
    first = plan(show, make_robot())
    monkeypatch.setattr("lss_motion.trajectory.tracks.slowed_windows", None)
    monkeypatch.setattr("lss_motion.trajectory.tracks.verify", None)
    again = plan(show, make_robot())
    times_s = np.linspace(0.0, first.duration_s, 99)
    assert np.array_equal(first.sample(times_s), again.sample(times_s))
    assert (again.marks, again.stretched) == (first.marks, first.stretched)
    assert (again.name, again.joints, again.loop) == (first.name, first.joints, first.loop)


@pytest.mark.parametrize("loop", [2, 5, None])
def test_passes_that_differ_are_remembered_as_they_are(frame, make_robot, loop, monkeypatch):
    frames = [frame(0.0, base=0.0), frame(0.3, base=90.0), frame(0.9, base=-90.0)]
    show = Sequence(name="s", keyframes=(*frames, frame(1.2, base=0.0)), loop=loop)
    first = plan(show, make_robot())
    monkeypatch.setattr("lss_motion.trajectory.tracks.verify", None)
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
def test_another_wish_is_another_question(show, make_robot, change):
    assert planner.cache_name(show, make_robot()) != planner.cache_name(
        replace(show, **change), make_robot()
    )


def test_every_field_of_a_keyframe_and_every_limit_is_part_of_the_question(show, frame, make_robot):
    def asked(speed=180.0, accel=600.0, reach=170.0, **fields):
        frames = (frame(0.0, base=0.0), frame(**{"at_s": 0.2, "base": 90.0} | fields))
        robot = make_robot(speed=speed, accel=accel, reach=reach)
        return planner.cache_name(replace(show, keyframes=frames), robot)

    names = [
        asked(),
        asked(at_s=0.3),
        asked(base=91.0),
        asked(elbow=3.0),
        asked(hold_s=1.0),
        asked(ease="linear"),
        asked(label="x"),
        asked(anchor=True),
        asked(speed=181.0),
        asked(accel=601.0),
        asked(reach=171.0),
    ]
    assert len(set(names)) == len(names)


def test_other_limits_are_another_question(show, make_robot):
    quick, slow = plan(show, make_robot()), plan(show, make_robot(speed=90.0))
    assert slow.duration_s > quick.duration_s
    assert len(list(planner.cache_directory().glob(f"*{planner.SUFFIX}"))) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", None])
def test_a_damaged_entry_is_replaced(show, make_robot, damage):
    planned = plan(show, make_robot())
    (entry,) = planner.cache_directory().glob(f"*{planner.SUFFIX}")
    whole = entry.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 0xFF]) + whole[middle + 1 :]
    entry.write_bytes(flipped if damage is None else damage)
    assert plan(show, make_robot()).duration_s == planned.duration_s
    assert len(entry.read_bytes()) == len(whole)


def test_a_cache_that_cannot_be_written_is_no_error(show, make_robot, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(planner.DIRECTORY_VARIABLE, str(tmp_path / "file" / "below"))
    assert plan(show, make_robot()).duration_s > 0.2


def test_the_cache_stays_bounded(show, make_robot, monkeypatch):
    monkeypatch.setattr(planner, "BYTES_MAX", 60_000)
    for speed in range(60, 120, 5):
        plan(show, make_robot(speed=float(speed)))
    sizes = [entry.stat().st_size for entry in planner.cache_directory().iterdir()]
    assert 0 < sum(sizes) <= 60_000
