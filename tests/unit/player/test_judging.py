"""What an answer says about one joint: the lag that is learnt, and the course that it is on."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.player.estimators import DEAD_S
from lss_motion.player.polling import take_position, take_target, wants_target

MS, LAG_S = 1_000_000, 0.03
"""A horn lags by so much more than is assumed."""


@pytest.fixture
def track(kit):
    """A joint that is told at 0 s to go to 40 deg in a second."""
    track = kit.track(kit.joint())
    track.moved(0, 400, 1000)
    return track


def horn_deg(track, at_s, lag_s=0.0):
    return track.profile.at(at_s - track.lead_s - lag_s)[0]


def read(track, at_s, measured_deg, planned_deg=0.0):
    return take_position(track, measured_deg, at_s, planned_deg)


def go_to_and_fro(track, lag_s, moves=20, droop_deg=0.0):
    """Let a horn that lags by `lag_s` more, and hangs lower, go to and fro for 10 s; read it."""
    track.following.stand(-droop_deg)
    for index in range(moves):
        start_s = 2.0 + 0.5 * index
        track.moved(round(1e9 * start_s), 400 * (index % 2), 500)
        for at_s in start_s + np.arange(0.06, 0.5, 0.05):
            read(track, at_s, horn_deg(track, at_s, lag_s) - droop_deg)


def test_a_horn_on_its_course_is_not_disturbed_and_its_error_is_what_the_plan_misses(track):
    for at_s in (0.1, 0.2, 0.3, 0.4):
        own, deg = track.profile, horn_deg(track, at_s)
        assert read(track, at_s, deg, planned_deg=deg + 0.5) is False
        assert track.profile is own
    assert track.following.error_deg == pytest.approx(0.5)
    assert track.following.disturbance_deg == pytest.approx(0.0, abs=1e-9)
    assert track.lag.estimate_s == pytest.approx(0.0, abs=1e-9)


def test_a_lag_is_learnt_led_by_and_not_taken_for_a_disturbance(track):
    go_to_and_fro(track, LAG_S)
    assert track.lag.estimate_s == pytest.approx(LAG_S, abs=2e-3)
    assert track.early_s == track.lag.extra_s > 0.9 * LAG_S
    assert abs(track.following.disturbance_deg) < 0.15


def test_a_load_is_no_lag(track):
    go_to_and_fro(track, 0.0, droop_deg=2.0)
    assert abs(track.lag.estimate_s) < DEAD_S
    assert track.following.disturbance_deg == pytest.approx(2.0, abs=0.1)


def test_the_first_reading_says_nothing_about_the_lag(track):
    assert read(track, 0.15, horn_deg(track, 0.15, 0.05)) is False
    assert track.lag.estimate_s == 0.0


def test_a_streamed_joint_is_led_by_what_was_learnt_only_from_its_next_rest_on(kit):
    track = kit.track(kit.joint("j0", 2, drive="streamed"))
    for index in range(200):
        at_s, deg = 0.1 + 0.02 * index, 30.0 * np.sin(0.1 * index)
        track.moved(round(1e9 * at_s), round(10 * deg), None)
        read(track, at_s, horn_deg(track, at_s, LAG_S))
    assert track.lag.extra_s > 0.8 * LAG_S
    assert track.early_s == 0.0
    read(track, 9.0, horn_deg(track, 9.0))
    assert track.early_s == track.lag.extra_s


def test_an_angle_that_no_servo_could_reach_is_not_believed(track):
    read(track, 0.1, horn_deg(track, 0.1))
    own = track.profile
    assert read(track, 0.11, 80.0) is None
    assert (track.profile, track.following.readings) == (own, 1)


@pytest.mark.parametrize("droop_deg", [0.0, 3.0])
def test_a_horn_that_stays_where_it_was_has_missed_its_move(track, droop_deg):
    track.following.stand(-droop_deg)
    track.following.disturbance_deg = droop_deg
    assert [read(track, at_s, -droop_deg) for at_s in (0.04, 0.1, 0.12)] == [False, False, True]
    assert track.profile.at(5.0) == (0.0, 0.0)
    assert track.following.disturbance_deg == pytest.approx(droop_deg, abs=0.05), "no load"
    assert track.lag.estimate_s == pytest.approx(0.0, abs=1e-4), "and no lag"


def test_a_servo_is_asked_for_its_target_and_one_that_names_the_old_one_has_missed_its_move(track):
    assert not wants_target(track, 5 * MS)
    assert wants_target(track, 10 * MS)
    assert take_target(track, 40.0, 0.02) is False
    assert not wants_target(track, 30 * MS)
    track.moved(500 * MS, 600, 500)
    assert take_target(track, 40.0, 0.52) is True
    assert track.profile.at(5.0) == (40.0, 0.0)


def test_without_feedback_nobody_is_asked_for_a_target(kit):
    track = kit.track(kit.joint(), has_feedback=False)
    track.moved(0, 400, 1000)
    assert not wants_target(track, 10 * MS)
