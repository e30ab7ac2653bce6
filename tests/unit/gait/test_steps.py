from __future__ import annotations

import numpy as np
import pytest

from lss_motion.gait.stepping import steps, travel

NEUTRAL = np.array([80.0, 150.0])


def stepped(kit, lift_ratio=0.0, walks=None, **fields):
    way = travel(walks or [kit.walk(60.0, turn_deg_s=15.0)], 1.0)
    fields = {"duty_ratio": 0.6, "cycle_s": 1.0, "height_mm": 25.0, **fields}
    return steps(NEUTRAL, way, lift_ratio=lift_ratio, **fields), way


@pytest.mark.parametrize("lift_ratio", [0.0, 0.2, 0.5, 0.9])
def test_a_foot_starts_and_ends_neutral_under_the_body(kit, lift_ratio):
    own, way = stepped(kit, lift_ratio)
    assert own.places_mm[0].tolist() == NEUTRAL.tolist()
    x, y, heading = way.at(np.array([1e9]))[0]
    rotation = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    np.testing.assert_allclose(own.places_mm[-1], [x, y] + rotation @ NEUTRAL, atol=1e-6)
    assert own.lands_s[-1] < way.duration_s + 1.4, "home within one more cycle"


def test_a_foot_stands_still_or_is_up_and_leaves_and_lands_without_speed(kit):
    own, _ = stepped(kit)
    at = np.linspace(0.0, own.lands_s[-1] + 0.5, 20_001)
    foot, is_down = own.at(at)
    assert not is_down.all()
    stays = is_down[1:] & is_down[:-1]
    assert np.abs(np.diff(foot, axis=0)[stays]).max() == 0.0
    assert foot[is_down, 2].max() == 0.0
    speed = np.gradient(foot, at, axis=0)
    next_to = np.flatnonzero(np.diff(is_down.astype(int)))
    assert np.abs(speed[next_to]).max() < 1.0
    assert foot[:, 2].max() == pytest.approx(25.0, abs=0.01)
    assert len(own.lifts_s) >= 4


def test_in_a_steady_walk_a_foot_reaches_as_far_ahead_as_behind(kit):
    own, way = stepped(kit, walks=[kit.walk(60.0, cycles=6)])
    lands_s, lifts_s = own.lands_s[2], own.lifts_s[3]
    ahead = own.at(np.array([lands_s]))[0][0, 0] - way.at(np.array([lands_s]))[0, 0]
    behind = own.at(np.array([lifts_s]))[0][0, 0] - way.at(np.array([lifts_s]))[0, 0]
    assert ahead - 80.0 == pytest.approx(80.0 - behind)
    assert ahead - behind == pytest.approx(60.0 * 0.6)


def test_a_walk_on_the_spot_marches(kit):
    own, way = stepped(kit, walks=[kit.walk(cycles=3)])
    assert (own.lifts_s < way.duration_s).all()
    assert len(own.lifts_s) == 4
    np.testing.assert_allclose(own.places_mm, np.tile(NEUTRAL, (5, 1)))
