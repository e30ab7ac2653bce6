"""A streamed joint that is off its program: judged by what the filter of its servo then does."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest

from lss_motion.player.serial_line import SerialLine
from lss_motion.player.streamer import guide
from lss_motion.program.model import Move
from lss_motion.robot.model import Bus
from tests.filters import FILTER_S, felt, staircase

STEP_NS, TOLERANCE_DEG, UNIT_DEG = 20_000_000, 0.2, 0.1


@pytest.fixture
def state(kit):
    return kit.state(kit.joint("j0", 2, drive="streamed"))


def led(
    state,
    planned_deg,
    *,
    until_s=None,
    now_ns=STEP_NS,
    period_ns=STEP_NS,
    is_even=False,
    baud_bps=115200,
):
    """Lead a joint along `planned_deg(instant_s)` until it is told no more, or until `until_s`.

    Return when it heard which target: `(ns, degrees)`.
    """
    line = SerialLine(Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370))
    state.guide_at(now_ns)
    heard = []

    def planned(_, at_ns):
        return planned_deg(at_ns / 1e9)

    while state.guide_ns is not None and (until_s is None or state.guide_ns < until_s * 1e9):
        now_ns = max(state.guide_ns, line.free_ns)
        guide(state, line, planned, now_ns, period_ns, is_even=is_even)
        target = re.fullmatch(rb"#2D(-?\d+)\r", line.take())
        heard.append((state.last_arrival_ns, int(target[1]) / 10))
        assert now_ns < 10e9, "it arrives some time"
    return heard


@pytest.mark.parametrize("target_deg", [80.0, -80.0])
def test_a_joint_that_is_led_far_keeps_its_limits_and_arrives(state, target_deg):
    heard = led(state, lambda _: target_deg)
    end_s = heard[-1][0] / 1e9
    assert 0.8 < end_s < 1.6, "80 deg at 180 deg/s, and two ramps of 0.3 s"
    assert state.profile.at(end_s + 1.0) == (target_deg, 0.0)
    for phase_s in np.arange(0.0, FILTER_S, 0.001):
        values = staircase(heard, state.joint.filter_count, phase_s, end_s + 0.5)
        assert np.abs(np.diff(values)).max() <= 180.0 * FILTER_S + 0.05
        assert np.abs(felt(values)).max() <= 1.1 * 600.0 + TOLERANCE_DEG / FILTER_S**2
        assert np.abs(values).max() <= 80.05, "it does not go beyond"


def test_correction_and_range_hold_for_bare_targets_too(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed", position_max_deg=20.0))
    state.disturbance.offset_deg = 1.5
    heard = led(state, lambda _: 10.0)
    assert state.profile.at(5.0) == (11.5, 0.0)
    led(state, lambda _: 20.0, now_ns=heard[-1][0] + STEP_NS)
    assert state.profile.at(9.0) == (20.0, 0.0)


@pytest.mark.parametrize("speed_deg_s", [40.0, -40.0])
@pytest.mark.parametrize(("offset_deg", "early_s"), [(0.0, 0.0), (1.5, 0.015)])
def test_it_closes_up_on_a_plan_that_moves_and_keeps_to_it(state, speed_deg_s, offset_deg, early_s):
    state.disturbance.offset_deg, state.early_s = offset_deg, early_s
    led(state, lambda at_s: speed_deg_s * at_s, until_s=1.5)
    for at_s in np.arange(0.8, 1.45, 0.01):
        horn_s = at_s + state.lead_s + early_s
        position_deg, _ = state.profile.at(at_s)
        assert position_deg == pytest.approx(speed_deg_s * horn_s + offset_deg, abs=UNIT_DEG)


def test_where_the_line_is_busy_it_is_on_its_plan_after_every_second_step(state):
    heard = led(state, lambda at_s: 40.0 * at_s, until_s=1.5, period_ns=2 * STEP_NS)
    steps = [state.profile.acts_on(at_ns / 1e9) for at_ns, _ in heard]
    assert {b - a for a, b in pairwise(steps)} == {2}
    for step in steps[-10:-1]:
        wanted_deg = 40.0 * (state.profile.step_s(step) - FILTER_S / 2 + state.lead_s)
        assert state.profile.value(step - 1) == pytest.approx(wanted_deg, abs=UNIT_DEG)


def test_it_hears_every_target_half_a_step_before_it_counts_however_long_the_line_takes(state):
    heard = led(state, lambda at_s: -60.0 - 8.0 * at_s, until_s=1.5, baud_bps=19200)
    profile = state.profile
    for at_ns, _ in heard[-20:]:
        best_s = profile.receive_s(profile.acts_on(at_ns / 1e9))
        assert at_ns / 1e9 == pytest.approx(best_s, abs=1e-5)


@pytest.mark.parametrize(("off_deg", "steps"), [(0.5, 4), (-2.0, 7), (5.0, 10)])
def test_what_is_near_closes_up_in_little_more_than_half_the_time_of_the_filter(
    state, off_deg, steps
):
    begun = state.profile.acts_on(led(state, lambda _: off_deg)[0][0] / 1e9) - 1
    assert state.profile.value(begun + steps) == pytest.approx(off_deg, abs=UNIT_DEG)
    count = state.joint.filter_count
    assert abs(off_deg) * (1.0 - 1.0 / count) ** steps > UNIT_DEG, "the filter alone is not there"


def move_to(target_deg):
    return Move(0, "main", 2, round(10 * target_deg), None)


def test_a_joint_that_is_on_its_plan_gets_the_move_of_the_program_and_is_led_no_more(state):
    state.begin_move(move_to(1.9))
    assert led(state, lambda _: 0.9 * TOLERANCE_DEG, is_even=True) == [(state.last_arrival_ns, 1.9)]
    assert state.resend_ns is None


@pytest.mark.parametrize(
    ("off_deg", "is_even", "active"),
    [
        (1.5 * TOLERANCE_DEG, True, move_to(1.9)),
        (-1.5 * TOLERANCE_DEG, True, move_to(1.9)),
        (0.9 * TOLERANCE_DEG, False, move_to(1.9)),
        (0.9 * TOLERANCE_DEG, True, None),
    ],
    ids=["too far", "too far back", "the show is slowed down", "no move of the program yet"],
)
def test_else_it_is_led_on(state, off_deg, is_even, active):
    state.begin_move(active)
    ((_, target_deg),) = led(state, lambda _: off_deg, is_even=is_even, until_s=0.021)
    assert abs(target_deg) < 1.0
    assert state.guide_ns is not None
