from __future__ import annotations

import numpy as np
import pytest

from lss_motion.sequence.model import Sequence
from lss_motion.trajectory import cache
from lss_motion.trajectory.planner import plan


@pytest.fixture
def show(frame):
    return Sequence(name="s", keyframes=(frame(0.0, base=0.0), frame(0.2, base=90.0)))


def test_a_plan_is_remembered_and_the_same_again(show, make_robot, monkeypatch):
    first = plan(show, make_robot())
    monkeypatch.setattr("lss_motion.trajectory.planner.slowed_windows", None)
    again = plan(show, make_robot())
    times_s = np.linspace(0.0, first.duration_s, 99)
    assert np.array_equal(first.sample(times_s), again.sample(times_s))


def test_other_limits_are_another_question(show, make_robot):
    quick, slow = plan(show, make_robot()), plan(show, make_robot(speed=90.0))
    assert slow.duration_s > quick.duration_s
    assert len(list(cache.directory().glob(f"*{cache.SUFFIX}"))) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", None])
def test_a_damaged_entry_is_replaced(show, make_robot, damage):
    planned = plan(show, make_robot())
    (entry,) = cache.directory().glob(f"*{cache.SUFFIX}")
    whole = entry.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 0xFF]) + whole[middle + 1 :]
    entry.write_bytes(flipped if damage is None else damage)
    assert plan(show, make_robot()).duration_s == planned.duration_s
    assert len(entry.read_bytes()) == len(whole)


def test_a_cache_that_cannot_be_written_is_no_error(show, make_robot, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(cache.DIRECTORY_VARIABLE, str(tmp_path / "file" / "below"))
    assert plan(show, make_robot()).duration_s > 0.2


def test_the_cache_stays_bounded(show, make_robot, monkeypatch):
    monkeypatch.setattr(cache, "BYTES_MAX", 10_000)
    for speed in range(60, 120, 5):
        plan(show, make_robot(speed=float(speed)))
    sizes = [entry.stat().st_size for entry in cache.directory().iterdir()]
    assert 0 < sum(sizes) <= 10_000
