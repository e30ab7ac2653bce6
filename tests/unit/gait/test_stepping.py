"""Paths of body and feet over the ground."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.show.gait.stepping import steps, travel


def test_every_walk_covers_its_velocity_times_its_cycles(kit):
    way = travel([kit.walk(50.0, 20.0, cycles=3), kit.walk(-10.0, cycles=2)], 0.8)
    end = way.at(np.array([way.duration_s]))[0]
    np.testing.assert_allclose(end, [50 * 2.4 - 10 * 1.6, 20 * 2.4, 0.0], atol=1e-9)
    assert way.duration_s == pytest.approx(0.8 * 6)


def test_a_turn_ends_at_its_angle_and_a_bend_on_its_circle(kit):
    turned = travel([kit.walk(turn_deg_s=30.0, cycles=3)], 1.0)
    np.testing.assert_allclose(turned.at(np.array([9.0]))[0], [0, 0, np.radians(90)], atol=1e-9)
    # Speed and turning are blended alike, so the way is an arc of radius v / w all along.
    bend = travel([kit.walk(60.0, turn_deg_s=40.0, cycles=4)], 1.2)
    radius = 60.0 / np.radians(40.0)
    x, y, heading = bend.at(np.linspace(0.0, bend.duration_s, 301)).T
    np.testing.assert_allclose(np.hypot(x, y - radius), radius, atol=1e-4)
    np.testing.assert_allclose(x, radius * np.sin(heading), atol=1e-4)


def test_the_body_starts_and_ends_at_rest_and_its_velocity_never_jumps(kit):
    way = travel([kit.walk(60.0, turn_deg_s=20.0), kit.walk(-40.0, 30.0)], 1.0)
    at = np.linspace(-0.2, way.duration_s + 0.2, 9001)
    rates = np.gradient(way.at(at), at, axis=0)
    assert np.abs(rates[[0, -1]]).max() == 0.0
    assert np.abs(np.diff(rates, axis=0)).max() < 0.3
    steady = rates[(at > 1.05) & (at < 2.9)]
    np.testing.assert_allclose(np.hypot(*steady[:, :2].T), 60.0, atol=0.01)


def test_a_new_velocity_is_blended_in_over_the_first_cycle_of_its_walk(kit):
    way = travel([kit.walk(60.0), kit.walk(20.0)], 1.0)
    assert way.starts_s.tolist() == [0.0, 3.0]
    at = np.array([2.9, 3.5, 4.1])
    rates = (way.at(at + 1e-4) - way.at(at - 1e-4))[:, 0] / 2e-4
    np.testing.assert_allclose(rates, [60.0, 40.0, 20.0], atol=0.01)


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
