"""Anchors a little above the least time are met: single moves, and a share of the campaign."""

from __future__ import annotations

import math
from argparse import Namespace

import numpy as np
import pytest
from campaign import anchors

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.robot.model import Bus, Robot
from lss_motion.show.model import Interpolation, Keyframe, Sequence
from tests.joints import joint

SEEDS = 16
MOST_S = 0.002
FAST = ((60.0, 180.0, 600.0), (20.0, 180.0, 600.0), (60.0, 360.0, 1000.0), (5.0, 180.0, 600.0))


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


def move(deg: float, speed: float, accel: float, within_s: float, ease: str) -> tuple:
    limits = {"speed_max_deg_s": speed, "accel_max_deg_s2": accel}
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    robot = Robot(name="arm", path=None, buses={"main": bus}, joints={"j0": joint(**limits)})
    end = Keyframe(at_s=within_s, deg={"j0": deg}, is_anchor=True, ease=Interpolation(ease))
    return Sequence(name="one", keyframes=(Keyframe(at_s=0.0, deg={"j0": 0.0}), end)), robot


@pytest.mark.parametrize("ease", ["smooth", "spline", "linear"])
@pytest.mark.parametrize(("deg", "speed", "accel"), FAST)
def test_a_move_meets_its_anchor_as_soon_as_the_limits_allow(deg, speed, accel, ease) -> None:
    is_short = deg < speed**2 / accel
    least_s = 2.0 * math.sqrt(deg / accel) if is_short else deg / speed + speed / accel
    for ratio in (1.0, 1.005, 1.05, 1.1, 1.15):
        within_s = ratio * least_s + MOST_S
        show, robot = move(deg, speed, accel, within_s, ease)
        trajectory = plan(show, robot)
        verify(trajectory, robot)
        assert trajectory.duration_s == pytest.approx(within_s, abs=1e-3)
    show, robot = move(deg, speed, accel, least_s - MOST_S, ease)
    with pytest.raises(PlanningError, match="late"):
        plan(show, robot)


@pytest.mark.parametrize("seed", range(SEEDS))
def test_every_anchor_that_a_fine_grid_can_meet_is_met(seed: int) -> None:
    told = anchors.play(seed, Namespace(refused=False, layers=False))
    assert not told.broken


def test_the_grid_finds_the_least_time_of_a_move() -> None:
    for deg, speed, accel in FAST:
        show, robot = move(deg, speed, accel, 0.1, "smooth")
        is_short = deg < speed**2 / accel
        least_s = 2.0 * math.sqrt(deg / accel) if is_short else deg / speed + speed / accel
        late_s = anchors.Reach(show, robot).lateness()[-1]
        assert np.isclose(0.1 + late_s, least_s, atol=MOST_S)
        assert 0.1 + late_s >= least_s


@pytest.mark.parametrize("seed", range(6))
def test_advice_that_is_followed_suffices(seed: int) -> None:
    told = anchors.play(seed, Namespace(refused=True, layers=False))
    assert told.outcome == "refused"
    assert not told.broken


@pytest.mark.parametrize("seed", range(8))
def test_anchors_under_layers_are_met_or_the_speed_that_is_named_suffices(seed: int) -> None:
    told = anchors.play(seed, Namespace(refused=False, layers=True))
    assert not told.broken
