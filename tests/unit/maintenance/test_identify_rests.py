"""Load and play, read from rests that were made up."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.maintenance.identify.estimate import read_rests
from lss_motion.maintenance.identify.fit import SentMove
from lss_motion.maintenance.identify.trials import Kind, Recording, Trial, Window

WINDOW = Window(-20.0, 20.0)


def rests(missing_deg, *, noise_deg=0.01):
    """Read the rests of two stairs up and down; `missing_deg(target, way)` is what lacks there."""
    random = np.random.default_rng(1)
    trials, at_deg = [], -16.0
    for target_deg in [-8.0, 0.0, 8.0, 16.0, 8.0, 0.0, -8.0, -16.0] * 2:
        way = np.sign(target_deg - at_deg)
        rest_deg = target_deg - missing_deg(target_deg, way)
        readings = rest_deg + random.normal(0.0, noise_deg, 30)
        trial = Trial(Kind.STEP, 0.0, at_deg, [SentMove(0.0, target_deg, 0.3)])
        trial.times_s = [0.7 + 0.01 * index for index in range(30)]
        trial.readings_deg = readings.tolist()
        trials.append(trial)
        at_deg = target_deg
    return read_rests(Recording(WINDOW, 600.0, 180.0, trials), trials)


def test_no_load_and_no_play_are_none():
    found = rests(lambda target, way: 0.0)
    assert found.play.value == 0.0
    assert np.abs(found.droop_deg).max() < 0.02


def test_a_load_is_a_parabola_over_the_window():
    found = rests(lambda target, way: 2.0 + 0.5 * (target / 20.0) - 0.3 * (target / 20.0) ** 2)
    assert found.droop_deg == pytest.approx((2.0, 0.5, -0.3), abs=0.02)
    assert found.play.value == 0.0


def test_play_shows_in_the_way_from_which_a_rest_was_reached():
    found = rests(lambda target, way: 0.4 + 0.35 * way)
    assert found.play.value == pytest.approx(0.7, abs=0.02)
    assert not found.is_falling
    assert found.droop_deg[0] == pytest.approx(0.4, abs=0.02)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_gears_that_fall_to_their_other_side_show_their_play_there(side):
    found = rests(lambda target, way: side * (0.04 * (target - 3.0) + 0.4 * np.sign(target - 3.0)))
    assert found.is_falling
    assert found.play.value == pytest.approx(0.8, abs=0.05)


def test_scatter_is_not_play():
    random = np.random.default_rng(5)
    found = rests(lambda target, way: random.normal(0.0, 0.1), noise_deg=0.1)
    assert found.play.value == 0.0
