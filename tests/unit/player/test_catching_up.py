"""How a timed joint that is not on its plan gets back there."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lss_motion.player import streamer
from lss_motion.player.show_clock import ShowClock
from lss_motion.player.streamer import JOIN_S, on_time_s, send_deferred
from tests.timed_moves import timed, travel

LATE_NS = 50_000_000
CLOCK = ShowClock(0, 0.0, 1.0)


def rejoin(state, line, show_s):
    """Say at rate 1 what is left of the move under way; return the bytes."""
    streamer.rejoin(state, line, CLOCK, lambda show_s: show_s, round(1e9 * show_s))
    return line.take()


def far_off_deg(state, from_s, to_s, offset_deg=0.0):
    """Return by how much the profile is off the plan between two instants, at the most."""
    instants_s = np.arange(from_s, to_s, 0.005)
    pairs = [(state.profile.at(s)[0], state.plan.at(s)[0]) for s in instants_s]
    return max(abs(told_deg - planned_deg - offset_deg) for told_deg, planned_deg in pairs)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("late_ns", "offset_deg"), [(LATE_NS, 0.0), (LATE_NS, 1.0), (15_000_000, 0.0)]
)
def test_one_that_is_behind_goes_faster_until_it_meets_its_plan_and_arrives_on_time(
    kit, line, sign, late_ns, offset_deg
):
    state = timed(kit, travel(40.0 * sign))
    state.disturbance.offset_deg = offset_deg
    state.note_sent(late_ns, round(10 * (40.0 * sign + offset_deg)), 1000)
    behind_deg = sign * (offset_deg + state.plan.at(0.3)[0] - state.profile.at(0.3)[0])
    rejoin(state, line, 0.3)
    resend_ns = state.deferred.resend_ns
    assert state.resend_ns == resend_ns
    _, speed_deg_s = state.profile.at(resend_ns / 1e9)
    assert 0.4 < resend_ns / 1e9 < 0.46
    assert speed_deg_s == pytest.approx(sign * (40.0 + behind_deg / JOIN_S), abs=1.0)
    send_deferred(state, line, resend_ns)
    assert state.deferred is None
    slows_down_s = behind_deg / JOIN_S / state.limits.ramp_deg_s2
    assert far_off_deg(state, resend_ns / 1e9 + slows_down_s, 1.2, offset_deg) < 0.15


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("way_deg", "show_s", "arrival_s"),
    [
        (20.0, 0.05, None),
        (20.0, 0.5, None),
        (40.0, 0.2, None),
        (80.0, 0.05, None),
        (80.0, 0.2, None),
        (80.0, 0.2, 0.15),
        (80.0, 0.1, 0.05),
    ],
)
def test_one_that_rests_or_gathers_speed_meets_its_plan_and_does_not_pass_it(
    kit, line, sign, way_deg, show_s, arrival_s
):
    state = timed(kit, travel(way_deg * sign))
    if arrival_s is not None:
        state.note_sent(round(1e9 * arrival_s), round(10 * way_deg * sign), 1000)
    rejoin(state, line, show_s)
    resend_ns = state.deferred.resend_ns
    send_deferred(state, line, resend_ns)
    instants_s = np.arange(show_s, 1.2, 0.005)
    ahead_deg = [sign * (state.profile.at(s)[0] - state.plan.at(s)[0]) for s in instants_s]
    assert max(ahead_deg) < 0.2
    assert far_off_deg(state, resend_ns / 1e9 + 0.2, 1.2) < 0.2


def test_how_fast_it_goes_on_counts_from_where_its_move_began(kit, line):
    further = travel(80.0, due_s=1.5)
    state = timed(kit, travel(40.0), further)
    state.note_sent(0, 400, 1000)
    state.begin_move(further)
    rejoin(state, line, 1.8)
    assert state.deferred.travel_deg_s == pytest.approx(40.0, abs=0.1)
    send_deferred(state, line, state.deferred.resend_ns)
    assert far_off_deg(state, 2.2, 2.7) < 0.2


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_is_far_behind_goes_as_fast_as_it_may(kit, line, sign):
    state = timed(kit, travel(80.0 * sign))
    assert rejoin(state, line, 0.3) == b"#1D%dT445\r" % (800 * sign)
    resend_ns = state.deferred.resend_ns
    send_deferred(state, line, resend_ns)
    assert state.deferred is None
    assert far_off_deg(state, 0.95, 1.2) < 0.2
    assert max(abs(state.profile.at(s)[1]) for s in np.arange(0.3, 1.2, 0.005)) <= 180.0


@pytest.mark.parametrize("show_s", [0.9, 1.5])
def test_one_that_cannot_meet_its_plan_any_more_arrives_as_soon_as_it_may(kit, line, show_s):
    state = timed(kit, travel(80.0))
    assert rejoin(state, line, show_s) == b"#1D800T445\r"
    assert state.deferred is None
    assert state.profile.at(show_s + 0.8) == (80.0, 0.0)


@pytest.mark.parametrize(
    ("arrival_s", "at_deg"), [(-0.05, 0.0), (0.003, 0.0), (None, 39.0), (None, 90.0)]
)
def test_one_that_is_not_behind_has_the_rest_of_its_time(kit, line, arrival_s, at_deg):
    state = timed(kit, travel(40.0))
    state.stand_at(at_deg)
    if arrival_s is not None:
        state.note_sent(round(1e9 * arrival_s), 400, 1000)
    assert rejoin(state, line, 0.3) == b"#1D400T700\r"
    assert state.deferred is None


def test_one_whose_move_ends_where_it_began_has_the_rest_of_its_time(kit, line):
    back = travel(18.7, due_s=0.5, lasts_s=0.4)
    state = timed(kit, travel(40.0), back)
    state.begin_move(back)
    assert state.plan.at(state.begun_s(line))[0] == pytest.approx(18.7, abs=0.1)
    state.stand_at(40.0)
    assert rejoin(state, line, 0.6) == b"#1D187T300\r"
    assert state.deferred is None


def test_what_is_owed_is_told_with_no_longer_t_than_any_move(kit, line):
    state = timed(kit, travel(80.0))
    state.defer(0, 80.0, 2.0)
    send_deferred(state, line, 0)
    assert line.take() == b"#1D800T9999\r"


def test_one_whose_plan_is_as_fast_as_it_may_go_has_the_rest_of_its_time(kit, line):
    state = timed(kit, travel(40.0), speed_max_deg_s=40.0)
    state.note_sent(LATE_NS, 400, 1000)
    assert re.fullmatch(rb"#1D400T7\d\d\r", rejoin(state, line, 0.3))
    assert state.deferred is None


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_is_turned_back_travels_as_fast_as_its_plan_however_far_off_it_is(kit, line, sign):
    there, back = travel(40.0 * sign), travel(-10.0 * sign, due_s=0.5, lasts_s=0.6)
    state = timed(kit, there, back)
    state.disturbance.offset_deg = 1.5
    state.note_sent(100_000_000, 400 * sign + 15, 1000)
    state.begin_move(back)
    state.send_active(line, on_time_s(state, line, CLOCK.show_s, 500_000_000), 500_000_000)
    for at_s in (0.7, 0.75, 0.8):
        assert state.profile.at(at_s)[1] == pytest.approx(state.plan.at(at_s)[1], abs=0.3)
    assert abs(state.plan.at(0.75)[1]) > 40.0, "it travels"


def test_else_it_has_its_own_time(kit, line):
    there, back = travel(40.0), travel(0.0, due_s=0.5, lasts_s=0.4)
    state = timed(kit, there, back)

    def travels_s(move, show_s=0.5):
        state.begin_move(move)
        return on_time_s(state, line, lambda _: show_s, 500_000_000)

    state.stand_at(10.0)
    assert travels_s(back) != 0.4
    assert travels_s(back._replace(duration_ms=None)) == 0.0
    assert travels_s(there) == 1.0, "it goes on"
    assert travels_s(back._replace(target_wire=-50), -1.0) == 0.4, "the plan rests"
    assert travels_s(there, 3.0) == 1.0, "the plan is there"
    for beyond_deg in (0.0, -10.0):
        state.stand_at(beyond_deg)
        assert travels_s(back) == 0.4, "it has been there"
