from __future__ import annotations

import numpy as np
import pytest

from lss_motion.gait.stepping import travel


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
