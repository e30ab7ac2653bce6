"""Lateness of random shows against the least on a fine grid: holds, anchors and sums over keys."""

from __future__ import annotations

from argparse import Namespace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from campaign import anchors
from campaign.reach import Reach

from benches.shows import lively_show, robot_of
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Bus, Robot
from lss_motion.show.model import Keyframe, Sequence
from tests.joints import joint

if TYPE_CHECKING:
    from lss_motion.planning.trajectory.model import Trajectory

SHOWS = 24
RATIO = 1.02
SUM_S = 0.002
"""Sums that differ by less are equal: half a cell of the fine grid."""
PACE = 2.0
HARD = (15, 20, 27, 68, 71)
"""Braking counts most in the first three, the grid near a key in the others."""


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


def any_show(seed: int, ease: float = 1.0) -> tuple[Sequence, Robot]:
    """Return keyframes of one to three joints; a third of the moves are up to 12 times too fast.

    The others are at most `ease` times as far as they may be.
    """
    random = np.random.default_rng(seed)
    speed, accel = float(random.uniform(90.0, 360.0)), float(random.uniform(300.0, 1500.0))
    limits = {"speed_max_deg_s": speed, "accel_max_deg_s2": accel}
    reach = {"position_min_deg": -170.0, "position_max_deg": 170.0}
    names = ("base", "elbow", "wrist")[: int(random.integers(1, 4))]
    joints = {name: joint(name, k + 1, **reach, **limits) for k, name in enumerate(names)}
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    robot = Robot(name="arm", path=None, buses={"main": bus}, joints=joints)
    frames = [Keyframe(at_s=0.0, deg=dict.fromkeys(names, 0.0))]
    at_deg, free_s = dict.fromkeys(names, 0.0), dict.fromkeys(names, 0.0)
    at_s = 0.0
    for _ in range(int(random.integers(3, 8))):
        at_s = round(at_s + frames[-1].hold_s + float(random.choice([0.15, 0.3, 0.6, 1.0, 1.8])), 3)
        hold_s = float(random.choice([0.0, 0.0, 0.0, 0.2, 0.5]))
        for name in (chosen := [n for n in names if random.random() < 0.7] or [names[0]]):
            gap_s = at_s - free_s[name]
            most_deg = min(0.12 * accel * gap_s**2, 0.5 * speed * gap_s)
            most_deg *= float(random.uniform(2.0, 12.0)) if random.random() < 0.3 else ease
            move_deg = float(np.clip(random.normal(0.0, 60.0), -most_deg, most_deg))
            at_deg[name] = round(float(np.clip(at_deg[name] + move_deg, -160.0, 160.0)), 1)
            free_s[name] = at_s + hold_s
        deg = {name: at_deg[name] for name in chosen}
        frames.append(Keyframe(at_s=at_s, deg=deg, hold_s=hold_s))
    return Sequence(name=f"any {seed}", keyframes=tuple(frames)), robot


def late_of(trajectory: Trajectory) -> list[float]:
    """Return the lateness at each key."""
    return [mark.planned_s - (mark.authored_s or 0.0) for mark in trajectory.marks]


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, SHOWS, 6))
def test_lateness_is_the_least_holds_are_kept_and_nothing_is_early(first: int) -> None:
    hard = HARD if first == 0 else ()
    for seed in (*range(first, first + 6), *hard):
        show, robot = any_show(seed)
        trajectory = plan(show, robot)
        late_s = late_of(trajectory)
        assert min(late_s) > -1e-5, seed
        assert all(mark.held_s >= mark.hold_s - 1e-6 for mark in trajectory.marks), seed
        if sum(late_s) > SUM_S:
            allowed_s = RATIO * sum(Reach(show, robot, PACE).lateness()) + SUM_S
            assert sum(late_s) <= allowed_s, seed


def test_a_show_of_many_joints_that_is_late_again_and_again_is_never_early() -> None:
    """Here a slow part follows where the motion is on time, and braking cannot end before it."""
    robot = robot_of(18)
    trajectory = plan(lively_show(robot, 45.0, seed=1, infeasible_ratio=0.3), robot)
    late_s = late_of(trajectory)
    assert max(late_s) > 0.1
    assert min(late_s) > -1e-5
    assert trajectory.duration_s == pytest.approx(45.0, abs=1e-5)


@pytest.mark.parametrize("seed", [700_008, 700_411])
def test_an_anchor_that_can_be_met_is_met(seed) -> None:
    """The first is passed faster than authored; behind the second one cell exceeds a limit."""
    told = anchors.play(seed, Namespace(refused=False, layers=False))
    assert (told.outcome, told.broken) == ("met", ())
