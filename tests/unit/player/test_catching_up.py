"""How a timed joint that is not on its plan gets back there."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lss_motion.player import streamer
from lss_motion.player.joint_state import Owed
from lss_motion.player.show_clock import ShowClock
from lss_motion.player.streamer import JOIN_S, on_time_s, tell_owed
from tests.timed_moves import timed, travel

LATE_NS = 50_000_000
CLOCK = ShowClock(0, 0.0, 1.0)


def rejoin(track, line, show_s):
    """Say at rate 1 what is left of the move under way; return the bytes."""
    streamer.rejoin(track, line, CLOCK, lambda show_s: show_s, round(1e9 * show_s))
    return line.take()


def far_off_deg(track, from_s, to_s, offset_deg=0.0):
    """Return by how much the profile is off the plan between two instants, at the most."""
    instants_s = np.arange(from_s, to_s, 0.005)
    pairs = [(track.profile.at(s)[0], track.plan.at(s)[0]) for s in instants_s]
    return max(abs(told_deg - planned_deg - offset_deg) for told_deg, planned_deg in pairs)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("late_ns", "offset_deg"), [(LATE_NS, 0.0), (LATE_NS, 1.0), (15_000_000, 0.0)]
)
def test_one_that_is_behind_goes_faster_until_it_meets_its_plan_and_arrives_on_time(
    kit, line, sign, late_ns, offset_deg
):
    track = timed(kit, travel(40.0 * sign))
    track.following.offset_deg = offset_deg
    track.moved(late_ns, round(10 * (40.0 * sign + offset_deg)), 1000)
    behind_deg = sign * (offset_deg + track.plan.at(0.3)[0] - track.profile.at(0.3)[0])
    rejoin(track, line, 0.3)
    again_ns = track.owed.again_ns
    assert track.again_ns == again_ns
    _, speed_deg_s = track.profile.at(again_ns / 1e9)
    assert 0.4 < again_ns / 1e9 < 0.46
    assert speed_deg_s == pytest.approx(sign * (40.0 + behind_deg / JOIN_S), abs=1.0)
    tell_owed(track, line, again_ns)
    assert track.owed is None
    slows_down_s = behind_deg / JOIN_S / track.limits.ramp_deg_s2
    assert far_off_deg(track, again_ns / 1e9 + slows_down_s, 1.2, offset_deg) < 0.15


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("way_deg", "show_s", "heard_s"),
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
    kit, line, sign, way_deg, show_s, heard_s
):
    track = timed(kit, travel(way_deg * sign))
    if heard_s is not None:
        track.moved(round(1e9 * heard_s), round(10 * way_deg * sign), 1000)
    rejoin(track, line, show_s)
    again_ns = track.owed.again_ns
    tell_owed(track, line, again_ns)
    instants_s = np.arange(show_s, 1.2, 0.005)
    ahead_deg = [sign * (track.profile.at(s)[0] - track.plan.at(s)[0]) for s in instants_s]
    assert max(ahead_deg) < 0.2
    assert far_off_deg(track, again_ns / 1e9 + 0.2, 1.2) < 0.2


def test_how_fast_it_goes_on_counts_from_where_its_move_began(kit, line):
    further = travel(80.0, due_s=1.5)
    track = timed(kit, travel(40.0), further)
    track.moved(0, 400, 1000)
    track.active = further
    rejoin(track, line, 1.8)
    assert track.owed.travel_deg_s == pytest.approx(40.0, abs=0.1)
    tell_owed(track, line, track.owed.again_ns)
    assert far_off_deg(track, 2.2, 2.7) < 0.2


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_is_far_behind_goes_as_fast_as_it_may(kit, line, sign):
    track = timed(kit, travel(80.0 * sign))
    assert rejoin(track, line, 0.3) == b"#1D%dT445\r" % (800 * sign)
    again_ns = track.owed.again_ns
    tell_owed(track, line, again_ns)
    assert track.owed is None
    assert far_off_deg(track, 0.95, 1.2) < 0.2
    assert max(abs(track.profile.at(s)[1]) for s in np.arange(0.3, 1.2, 0.005)) <= 180.0


@pytest.mark.parametrize("show_s", [0.9, 1.5])
def test_one_that_cannot_meet_its_plan_any_more_arrives_as_soon_as_it_may(kit, line, show_s):
    track = timed(kit, travel(80.0))
    assert rejoin(track, line, show_s) == b"#1D800T445\r"
    assert track.owed is None
    assert track.profile.at(show_s + 0.8) == (80.0, 0.0)


@pytest.mark.parametrize(
    ("heard_s", "at_deg"), [(-0.05, 0.0), (0.003, 0.0), (None, 39.0), (None, 90.0)]
)
def test_one_that_is_not_behind_has_the_rest_of_its_time(kit, line, heard_s, at_deg):
    track = timed(kit, travel(40.0))
    track.stand(at_deg)
    if heard_s is not None:
        track.moved(round(1e9 * heard_s), 400, 1000)
    assert rejoin(track, line, 0.3) == b"#1D400T700\r"
    assert track.owed is None


def test_one_whose_move_ends_where_it_began_has_the_rest_of_its_time(kit, line):
    back = travel(18.7, due_s=0.5, lasts_s=0.4)
    track = timed(kit, travel(40.0), back)
    track.active = back
    assert track.plan.at(track.begun_s(line))[0] == pytest.approx(18.7, abs=0.1)
    track.stand(40.0)
    assert rejoin(track, line, 0.6) == b"#1D187T300\r"
    assert track.owed is None


def test_what_is_owed_is_told_with_no_longer_t_than_any_move(kit, line):
    track = timed(kit, travel(80.0))
    track.owed = Owed(0, 80.0, 2.0)
    tell_owed(track, line, 0)
    assert line.take() == b"#1D800T9999\r"


def test_one_whose_plan_is_as_fast_as_it_may_go_has_the_rest_of_its_time(kit, line):
    track = timed(kit, travel(40.0), speed_max_deg_s=40.0)
    track.moved(LATE_NS, 400, 1000)
    assert re.fullmatch(rb"#1D400T7\d\d\r", rejoin(track, line, 0.3))
    assert track.owed is None


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_is_turned_back_travels_as_fast_as_its_plan_however_far_off_it_is(kit, line, sign):
    there, back = travel(40.0 * sign), travel(-10.0 * sign, due_s=0.5, lasts_s=0.6)
    track = timed(kit, there, back)
    track.following.offset_deg = 1.5
    track.moved(100_000_000, 400 * sign + 15, 1000)
    track.active = back
    track.send_active(line, on_time_s(track, line, CLOCK.show_s, 500_000_000), 500_000_000)
    for at_s in (0.7, 0.75, 0.8):
        assert track.profile.at(at_s)[1] == pytest.approx(track.plan.at(at_s)[1], abs=0.3)
    assert abs(track.plan.at(0.75)[1]) > 40.0, "it travels"


def test_else_it_has_its_own_time(kit, line):
    there, back = travel(40.0), travel(0.0, due_s=0.5, lasts_s=0.4)
    track = timed(kit, there, back)

    def travels_s(move, show_s=0.5):
        track.active = move
        return on_time_s(track, line, lambda _: show_s, 500_000_000)

    track.stand(10.0)
    assert travels_s(back) != 0.4
    assert travels_s(back._replace(duration_ms=None)) == 0.0
    assert travels_s(there) == 1.0, "it goes on"
    assert travels_s(back._replace(target_wire=-50), -1.0) == 0.4, "the plan rests"
    assert travels_s(there, 3.0) == 1.0, "the plan is there"
    for beyond_deg in (0.0, -10.0):
        track.stand(beyond_deg)
        assert travels_s(back) == 0.4, "it has been there"
