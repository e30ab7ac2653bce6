"""What an answer says about one joint: the lag that is learnt, and the course that it is on."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.player.estimators import DEAD_S

MS, LAG_S = 1_000_000, 0.03
"""A horn lags by so much more than is assumed."""


@pytest.fixture
def state(kit):
    """A joint that is told at 0 s to go to 40 deg in a second."""
    state = kit.state(kit.joint())
    state.note_sent(0, 400, 1000)
    return state


def horn_deg(state, at_s, lag_s=0.0):
    return state.profile.at(at_s - state.lead_s - lag_s)[0]


def read(state, at_s, measured_deg, planned_deg=0.0):
    return state.take_position(measured_deg, at_s, planned_deg)


def go_to_and_fro(state, lag_s, moves=20, droop_deg=0.0):
    """Let a horn that lags by `lag_s` more, and hangs lower, go to and fro for 10 s; read it."""
    state.disturbance.stand_at(-droop_deg)
    for index in range(moves):
        start_s = 2.0 + 0.5 * index
        state.note_sent(round(1e9 * start_s), 400 * (index % 2), 500)
        for at_s in start_s + np.arange(0.06, 0.5, 0.05):
            read(state, at_s, horn_deg(state, at_s, lag_s) - droop_deg)


def test_a_horn_on_its_course_is_not_disturbed_and_its_error_is_what_the_plan_misses(state):
    for at_s in (0.1, 0.2, 0.3, 0.4):
        own, deg = state.profile, horn_deg(state, at_s)
        assert read(state, at_s, deg, planned_deg=deg + 0.5) is False
        assert state.profile is own
    assert state.disturbance.error_deg == pytest.approx(0.5)
    assert state.disturbance.estimate_deg == pytest.approx(0.0, abs=1e-9)
    assert state.lag.estimate_s == pytest.approx(0.0, abs=1e-9)


def test_a_lag_is_learnt_led_by_and_not_taken_for_a_disturbance(state):
    go_to_and_fro(state, LAG_S)
    assert state.lag.estimate_s == pytest.approx(LAG_S, abs=2e-3)
    assert state.early_s == state.lag.extra_s > 0.9 * LAG_S
    assert abs(state.disturbance.estimate_deg) < 0.15


def test_a_load_is_no_lag(state):
    go_to_and_fro(state, 0.0, droop_deg=2.0)
    assert abs(state.lag.estimate_s) < DEAD_S
    assert state.disturbance.estimate_deg == pytest.approx(2.0, abs=0.1)


def test_the_first_reading_says_nothing_about_the_lag(state):
    assert read(state, 0.15, horn_deg(state, 0.15, 0.05)) is False
    assert state.lag.estimate_s == 0.0


def test_a_streamed_joint_is_led_by_what_was_learnt_only_from_its_next_rest_on(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    for index in range(200):
        at_s, deg = 0.1 + 0.02 * index, 30.0 * np.sin(0.1 * index)
        state.note_sent(round(1e9 * at_s), round(10 * deg), None)
        read(state, at_s, horn_deg(state, at_s, LAG_S))
    assert state.lag.extra_s > 0.8 * LAG_S
    assert state.early_s == 0.0
    read(state, 9.0, horn_deg(state, 9.0))
    assert state.early_s == state.lag.extra_s


def test_an_angle_that_no_servo_could_reach_is_not_believed(state):
    read(state, 0.1, horn_deg(state, 0.1))
    own = state.profile
    assert read(state, 0.11, 80.0) is None
    assert (state.profile, state.disturbance.readings) == (own, 1)


@pytest.mark.parametrize("droop_deg", [0.0, 3.0])
def test_a_horn_that_stays_where_it_was_has_missed_its_move(state, droop_deg):
    state.disturbance.stand_at(-droop_deg)
    state.disturbance.estimate_deg = droop_deg
    assert [read(state, at_s, -droop_deg) for at_s in (0.04, 0.1, 0.12)] == [False, False, True]
    assert state.profile.at(5.0) == (0.0, 0.0)
    assert state.disturbance.estimate_deg == pytest.approx(droop_deg, abs=0.05), "no load"
    assert state.lag.estimate_s == pytest.approx(0.0, abs=1e-4), "and no lag"


def test_a_servo_is_asked_for_its_target_and_one_that_names_the_old_one_has_missed_its_move(state):
    assert not state.needs_target(5 * MS)
    assert state.needs_target(10 * MS)
    assert state.take_target(40.0, 0.02) is False
    assert not state.needs_target(30 * MS)
    state.note_sent(500 * MS, 600, 500)
    assert state.take_target(40.0, 0.52) is True
    assert state.profile.at(5.0) == (40.0, 0.0)


def test_without_feedback_nobody_is_asked_for_a_target(kit):
    state = kit.state(kit.joint(), has_feedback=False)
    state.note_sent(0, 400, 1000)
    assert not state.needs_target(10 * MS)
