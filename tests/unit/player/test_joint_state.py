"""Tests of `playing.player.joint_state`.

One joint: what its servo is told, when it is told again, and what is known of it then.
What an answer says about one joint: the lag that is learnt, and the course that it is on.
What a streamed joint may be told next, and how it closes up on its plan.
What is kept for a picture covers a show of any length evenly, in bounded room.
"""

from __future__ import annotations

import math
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import event, example, given
from hypothesis import strategies as st
from msgspec.structs import replace

from lss_motion.planning.program.moves import nearest_wire
from lss_motion.planning.program.reference_grid import servo_limits
from lss_motion.playing.player.estimators import DEAD_S, POINTS_MAX, Trace
from lss_motion.playing.player.joint_state import REST_DEG_S
from lss_motion.playing.player.query_tracker import SerialLine
from lss_motion.playing.player.servo_model import (
    CLOSING_RATIO,
    STEP_OFFSETS,
    Setpoints,
    closing_deg,
)
from lss_motion.playing.player.show_clock import MISSED_NS, ShowClock, Statistics
from lss_motion.robot.model import Bus
from lss_motion.robot.servo_models import SERVO_MODELS
from tests.filters import FILTER_S, felt, staircase
from tests.joints import joint
from tests.timed_moves import timed, travel

# ---- track

STEP_NS, LATE_NS = 20_000_000, 50_000_000
CLOCK = ShowClock(0, 0.0, 1.0)


def commanded(state, target_deg):
    """Send a target, and all deferred ones; return `(arrival_ns, degrees)` of each."""
    now_ns, said = STEP_NS, []
    while True:
        wire = state.wire_for(target_deg, now_ns)
        state.note_sent(now_ns, wire, None)
        said.append((now_ns, wire / 10))
        if state.deferred is None:
            return said
        now_ns, target_deg, _ = state.deferred
        assert len(said) < 200, "it arrives some time"


def test_a_target_within_the_limits_is_sent_unchanged(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    assert commanded(state, 2.0) == [(STEP_NS, 2.0)]
    assert state.guide_ns is None


def test_a_target_beyond_the_limits_is_cut_and_the_joint_is_guided(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    ((_, said_deg),) = commanded(state, 60.0)
    assert 2.0 < said_deg < 10.0
    acts_on = state.profile.acts_on
    assert acts_on(state.guide_ns / 1e9) == acts_on(STEP_NS / 1e9) + 1, "with the next step"


@pytest.mark.parametrize("baud_bps", [9600, 115200])
def test_a_guiding_target_arrives_half_a_step_before_it_counts(kit, baud_bps):
    line = SerialLine(Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370))
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    state.guide_at(STEP_NS)
    state.send(line, 60.0, 0.0, STEP_NS)
    arrival_s = (state.resend_ns + line.time_ns(len(line.take()))) / 1e9
    profile = state.profile
    assert arrival_s == pytest.approx(profile.receive_s(profile.acts_on(arrival_s)), abs=1e-6)


def test_a_stepped_joint_jumps_no_further_than_its_speed_allows(kit):
    joint = kit.joint("j0", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    state = kit.state(replace(joint, speed_max_deg_s=100.0))
    said = commanded(state, 37.0)
    assert said[-1][1] == 37.0
    values = [0.0, *(deg for _, deg in said)]
    jumps = [b - a for a, b in pairwise(values)]
    assert max(jumps) <= 1.0 + 100.0 * 0.02
    took_s = (said[-1][0] - said[0][0]) / 1e9
    assert 0.98 * 100.0 <= (37.0 - values[1]) / took_s <= 100.0


def test_a_stepped_joint_that_catches_up_is_no_faster_than_its_limit_in_the_long_run(kit):
    """Whole degrees are no reason: 2.4 deg a pulse are jumps of 2 and of 3 deg in turn."""
    joint = kit.joint("j0", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    state = kit.state(replace(joint, speed_max_deg_s=120.0))
    said = commanded(state, 61.0)
    jumps = [b - a for (_, a), (_, b) in pairwise(said)]
    assert set(jumps[:-1]) == {2.0, 3.0}
    took_s = (said[-1][0] - said[0][0]) / 1e9
    assert (61.0 - said[0][1]) / took_s <= 1.02 * 120.0


def test_however_long_a_stepped_joint_stood_it_jumps_no_further_than_in_two_pulses(kit):
    joint = kit.joint("j0", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    state = kit.state(replace(joint, speed_max_deg_s=100.0))
    state.note_sent(0, state.wire_for(80.0, 0), None)
    assert state.place(1)[0] == 3.0, "one pulse, and what whole degrees take"
    assert state.resend_ns == 20_000_000
    state.note_sent(STEP_NS, state.wire_for(80.0, STEP_NS), None)
    assert state.place(STEP_NS)[0] == 5.0
    for at_s, sign in ((5.0, 1), (9.0, -1)):
        before_deg, _ = state.place(round(1e9 * at_s))
        state.note_sent(round(1e9 * at_s), state.wire_for(80.0 * sign, round(1e9 * at_s)), None)
        assert state.place(round(1e9 * at_s))[0] - before_deg == 5.0 * sign


def test_a_servo_that_is_believed_to_go_on_for_ever_is_waited_for_as_long_as_the_longest_move(kit):
    # It took a garbled word for its target, and said so when it was asked.
    state = kit.state(kit.joint("j0", 1))
    state.note_sent(8_000_000_000, 100_000, 200)
    assert not state.is_at_rest(17_000_000_000)
    assert state.is_at_rest(19_000_000_000)


# ---- timed joints


def test_the_rest_of_a_move_is_run_time_from_its_arrival(kit, line):
    state = timed(kit, travel(40.0, due_s=0.1))
    assert state.left_s(line, CLOCK, 400_000_000) == pytest.approx(0.7, abs=1e-4)
    line.send(b"." * 115, 400_000_000)
    assert state.left_s(line, CLOCK, 400_000_000) == pytest.approx(0.69, abs=1e-4)
    assert state.left_s(SerialLine(line.bus), ShowClock(0, 0.0, 0.5), 800_000_000) == pytest.approx(
        1.4, abs=2e-3
    )
    state.begin_move(state.active._replace(duration_ms=None))
    assert state.left_s(line, CLOCK, 0) == 0.0
    idle = kit.state(kit.joint())
    assert idle.left_s(line, CLOCK, 0) == 0.0


def test_t_is_what_is_left_and_never_so_short_that_the_speed_limit_breaks(kit, line):
    state = timed(kit, travel(40.0))
    for left_s, said in ((0.5, b"T500"), (0.1, b"T223"), (0.0, b"T223"), (0.3004, b"T300")):
        state.stand_at(0.0)
        state.send(line, 40.0, left_s, 0)
        assert line.take() == b"#1D400%b\r" % said
    state.stand_at(40.0)
    state.send(line, 40.0, 0.0, 0)
    assert line.take() == b"#1D400T1\r"


def test_t_counts_from_the_position_of_the_servo_on_arrival(kit):
    slow = SerialLine(Bus(name="main", port="sim://", baud_bps=9600, firmware=370))
    state = timed(kit, travel(-80.0))
    state.note_sent(0, -800, 400)
    before = state.profile.copy()
    state.send(slow, 80.0, 0.5, 300_000_000)
    position_deg, speed_deg_s = before.at(state.last_arrival_ns / 1e9)
    assert speed_deg_s < -150.0, "a byte sooner it is elsewhere"
    assert slow.take() == b"#1D800T%d\r" % math.ceil((80.0 - position_deg) / 0.18)


def test_a_target_is_corrected_and_within_the_range(kit, line):
    state = timed(kit, travel(40.0), position_max_deg=41.0)
    state.disturbance.offset_deg = 0.7
    state.send(line, 40.0, 1.0, 0)
    state.send(line, 40.9, 1.0, 0)
    assert line.take() == b"#1D407T1000\r#1D410T1000\r"
    assert (state.deferred, state.resend_ns) == (None, None)


def test_a_joint_that_is_not_driven_is_sent_nothing(kit, line):
    state = timed(kit, travel(40.0))
    state.drive(is_driven=False)
    state.send(line, 40.0, 1.0, 0)
    assert (line.take(), state.last_arrival_ns) == (b"", None)


def test_a_move_counts_from_the_arrival_of_its_last_byte(kit, line):
    state = timed(kit, travel(40.0))
    line.send(b"." * 115, 0)
    state.send(line, 40.0, 1.0, 0)
    assert state.last_arrival_ns == line.free_ns == pytest.approx(11e6, rel=0.01)
    assert state.profile.at(0.011)[0] == 0.0
    assert state.profile.at(0.5)[0] == pytest.approx(state.plan.at(0.49)[0], abs=0.05)
    assert state.lost_moves.last.arrival_s == state.last_arrival_ns / 1e9
    assert state.lost_moves.last.target_deg == 40.0
    assert state.lost_moves.alternatives[-1].profile.at(5.0) == (0.0, 0.0), (
        "as if it had not received it"
    )


def test_an_hour_of_moves_takes_no_more_room_than_a_few_seconds(kit):
    state = timed(kit, travel(40.0))
    for index in range(500):
        state.note_sent(index * 100_000_000, 400 * (index % 2), 100)
    assert sum(1 for _ in state.profile.pieces()) < 100
    assert state.profile.at(48.0)[0] != state.profile.at(48.05)[0], "two seconds are kept"


def test_where_it_turns_round_it_is_not_at_rest(kit):
    state = timed(kit, travel(40.0))
    assert state.is_at_rest(0)
    state.note_sent(0, 400, 1000)
    state.note_sent(500_000_000, 0, 500)
    slow_s = min(np.arange(0.5, 0.7, 0.001), key=lambda s: abs(state.profile.at(s)[1]))
    assert abs(state.profile.at(slow_s)[1]) < REST_DEG_S
    assert not state.is_at_rest(round(1e9 * slow_s))
    assert not state.is_at_rest(900_000_000)
    assert state.is_at_rest(1_300_000_000)
    state.note_sent(1_300_000_000, 400, 500)
    assert not state.is_at_rest(1_500_000_000)
    assert state.is_at_rest(2_000_000_000)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_streamed_joint_is_at_rest_when_its_filter_is(kit, sign):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    state.note_sent(STEP_NS, 100 * sign, None)
    assert not state.is_at_rest(STEP_NS + 100_000_000)
    assert state.is_at_rest(STEP_NS + 500_000_000)


def test_one_that_stands_elsewhere_owes_nothing_and_goes_on_from_there(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    state.note_sent(STEP_NS, 800, None)
    state.guide_at(5)
    state.defer(5, 80.0)
    state.stand_at(-30.0)
    assert state.place(10**9) == (-30.0, 0.0)
    assert (state.resend_ns, state.disturbance.standing_deg) == (None, -30.0)
    low_deg, high_deg = state.setpoints.allowed(0.5)
    assert low_deg + high_deg == pytest.approx(-60.0)


def test_off_the_program_one_that_is_streamed_and_driven_is_led_and_none_is_owed_a_move(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    state.leave_program(7)
    state.leave_program(9)
    assert state.resend_ns == 7
    state.drive(is_driven=False)
    state.leave_program(9)
    assert state.resend_ns is None
    state = timed(kit, travel(40.0))
    state.defer(9, 40.0)
    state.leave_program(7)
    assert state.resend_ns is None


def test_what_was_learnt_about_a_joint_is_kept(kit):
    earlier, state = timed(kit, travel(40.0)), timed(kit, travel(40.0))
    horn = earlier.disturbance.horn
    for step in range(400):
        speed = 40.0 if step % 2 else -40.0
        late_deg = -0.03 * speed
        horn.take(late_deg, (0.0, -horn.lag_s * speed, speed, 40.0), 0.0, 0.05)
    earlier.disturbance.offset_deg = 1.2
    earlier.lost_moves.mismatches, earlier.lost_moves.prompt = 3, 2
    state.take_over(earlier)
    assert state.disturbance.horn is horn
    assert state.early_s == pytest.approx(0.03, abs=2e-3)
    assert state.disturbance.offset_deg == 1.2
    assert state.lost_moves.prompt == 2
    assert state.lost_moves.mismatches == 3
    open_loop = kit.state(kit.joint(), has_feedback=False)
    assert open_loop.lost_moves is None
    assert (open_loop.resent, open_loop.health_count) == (0, 0)
    open_loop.take_over(earlier)
    state.take_over(open_loop)
    assert state.lost_moves.mismatches == 3


@pytest.mark.parametrize(("swing_deg", "correction_deg"), [(12.0, 0.6), (2.0, 0.0)])
def test_play_is_corrected_where_swings_take_it_up(kit, swing_deg, correction_deg):
    state = timed(kit, travel(40.0))
    state.begin_move(state.active._replace(target_wire=400, duration_ms=1000))
    for step in range(400):
        way = 1.0 if step % 2 else -1.0
        profile_deg = 7.0 * step % 80.0
        course = profile_deg, profile_deg, 0.0, 0.0
        state.disturbance.horn.take(profile_deg - 0.6 * way, course, way, 0.2)
    for step in range(4):
        state.swing.take(swing_deg * (step % 2))
    state.aim(1.0, 0)
    assert state.disturbance.offset_deg == pytest.approx(correction_deg, abs=0.03)


# ---- judging

MS, LAG_S = 1_000_000, 0.03
"""A horn lags by so much more than is assumed."""


@pytest.fixture
def state(kit):
    """A joint whose move to 40 deg in a second arrives at 0 s."""
    state = kit.state(kit.joint())
    state.note_sent(0, 400, 1000)
    return state


def horn_deg(state, at_s, lag_s=0.0):
    return state.profile.at(at_s - state.lead_s - lag_s)[0]


def read(state, at_s, measured_deg, planned_deg=0.0):
    seen = state.observe(measured_deg, at_s, planned_deg)
    return None if seen is None else seen.has_lost_move


def go_to_and_fro(state, lag_s, moves=20, droop_deg=0.0):
    """Let a horn that lags by `lag_s` more, and hangs lower, go to and fro for 10 s; read it."""
    state.disturbance.stand_at(-droop_deg)
    for index in range(moves):
        start_s = 2.0 + 0.5 * index
        state.note_sent(round(1e9 * start_s), 400 * (index % 2), 500)
        for at_s in start_s + np.arange(0.06, 0.5, 0.05):
            read(state, at_s, horn_deg(state, at_s, lag_s) - droop_deg, horn_deg(state, at_s))


def test_a_horn_on_its_course_is_not_disturbed_and_its_error_is_what_the_plan_misses(state):
    for at_s in (0.1, 0.2, 0.3, 0.4):
        own, deg = state.profile, horn_deg(state, at_s)
        assert read(state, at_s, deg, planned_deg=deg + 0.5) is False
        assert state.profile is own
    assert state.disturbance.error_deg == pytest.approx(0.5)
    assert state.disturbance.estimate_deg == 0.0
    assert state.disturbance.horn.lag_s == pytest.approx(0.0, abs=1e-9)


def test_a_lag_is_learnt_led_by_and_not_taken_for_a_disturbance(state):
    go_to_and_fro(state, LAG_S)
    horn = state.disturbance.horn
    assert horn.lag_s == pytest.approx(LAG_S, abs=3e-3)
    assert horn.early_s > 0.9 * LAG_S
    half_a_tick_s = 0.5 * state.joint.response.loop_s
    assert state.early_s == pytest.approx(horn.early_s, abs=half_a_tick_s), "less shifts its phase"
    assert state.disturbance.estimate_deg == 0.0


def test_a_load_is_no_lag(state):
    go_to_and_fro(state, 0.0, droop_deg=2.0)
    assert abs(state.disturbance.horn.lag_s) < DEAD_S
    assert state.disturbance.estimate_deg == pytest.approx(2.0, abs=0.1)


def test_a_wrong_reading_of_a_joint_at_rest_is_no_wrong_model(state):
    """A lost minus sign, for one: it seems to move, and is where it was before."""
    go_to_and_fro(state, 0.0, droop_deg=2.0)
    horn, learnt_deg = state.disturbance.horn, state.disturbance.estimate_deg
    for step, wrong_deg in enumerate((0.0, 0.0, 0.0, 12.0, 0.0, 0.0)):
        read(state, 14.0 + 0.06 * step, horn_deg(state, 14.0) - 2.0 + wrong_deg)
    assert (horn.model_ratio, horn.unexplained_s < 0.01) == (1.0, True)
    assert horn.correction_deg(40.0, 0.0) == pytest.approx(learnt_deg, abs=0.1)


def test_the_first_reading_sends_nothing_earlier(state):
    assert read(state, 0.15, horn_deg(state, 0.15, 0.05)) is False
    assert state.early_s == 0.0


def test_on_the_way_to_the_start_only_its_end_is_learnt_from(state):
    """Where the profile of the servo began is not known: its load has moved the horn."""
    state.limit_speed(30.0)
    go_to_and_fro(state, LAG_S, moves=4, droop_deg=2.0)
    assert (state.disturbance.horn.lag_s, state.disturbance.offset_deg) == (0.0, 0.0)
    state.learn_droop(state.place(20_000 * MS)[0] - 2.0, 20_000 * MS, 3.0)
    assert state.disturbance.offset_deg == pytest.approx(2.0, abs=0.1)


def test_a_joint_at_rest_is_sent_one_correction_with_its_own_t(kit, line):
    state = kit.state(kit.joint())
    state.note_sent(0, 400, 1000)
    for at_s in np.arange(1.6, 2.2, 0.1):
        read(state, at_s, 39.0, planned_deg=40.0)
    offset_deg = state.standing_offset_deg(2200 * MS)
    assert offset_deg == pytest.approx(1.0, abs=0.01)
    state.correct_standing(line, offset_deg, 40.0, 2200 * MS)
    assert line.take() == b"#1D410T100\r"
    assert state.standing_offset_deg(2400 * MS) is None, "first it must show that it helped"


def test_a_streamed_joint_is_led_by_what_was_learnt_only_from_its_next_rest_on(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    for index in range(200):
        at_s, deg = 0.1 + 0.02 * index, 30.0 * np.sin(0.1 * index)
        state.note_sent(round(1e9 * at_s), round(10 * deg), None)
        read(state, at_s, horn_deg(state, at_s, LAG_S))
    assert state.disturbance.horn.early_s > 0.8 * LAG_S
    assert state.early_s == 0.0
    read(state, 9.0, horn_deg(state, 9.0))
    assert state.early_s == state.disturbance.horn.early_s


def test_one_reading_uses_no_more_than_a_quarter_of_the_acceleration_in_em0(kit):
    joint = kit.joint("j0", 2, drive="streamed", accel_max_deg_s2=1000.0)
    state = kit.state(joint)
    most_deg = 0.25 * joint.filter_count * 1000 * 0.02**2
    for step in range(4):
        before_deg = state.disturbance.offset_deg
        state.observe(3.0, 1.0 + 0.1 * step, 0.0)
        assert 0.0 <= before_deg - state.disturbance.offset_deg <= most_deg + 1e-9
    assert state.disturbance.offset_deg < -2.0 * most_deg, "it goes on if it is true"


def test_an_angle_that_no_servo_could_reach_is_not_believed(state):
    read(state, 0.1, horn_deg(state, 0.1))
    own = state.profile
    assert read(state, 0.11, 80.0) is None
    assert (state.profile, state.disturbance.readings) == (own, 1)


@pytest.mark.parametrize("droop_deg", [0.0, 3.0])
def test_a_horn_that_stays_where_it_was_has_missed_its_move(state, droop_deg):
    state.disturbance.stand_at(-droop_deg)
    state.disturbance.horn.rest(droop_deg, -droop_deg)
    assert [read(state, at_s, -droop_deg) for at_s in (0.04, 0.1, 0.12)] == [False, False, True]
    assert state.profile.at(5.0) == (0.0, 0.0)
    assert state.disturbance.estimate_deg == pytest.approx(droop_deg, abs=0.1), "no load"
    assert state.early_s == 0.0, "and no lag"


def test_a_servo_that_reports_its_old_target_has_lost_its_move(state):
    assert state.target_due_ns / 1e9 > 0.001 * 5
    assert state.target_due_ns / 1e9 <= 0.001 * 10
    assert state.take_target(40.0, 0.02) is False
    assert state.target_due_ns / 1e9 > 0.001 * 30
    state.note_sent(500 * MS, 600, 500)
    assert state.take_target(40.0, 0.52) is False, "it may take moves up late"
    assert state.take_target(40.0, 0.63) is True
    assert state.profile.at(5.0) == (40.0, 0.0)


def test_without_feedback_no_servo_is_polled_for_its_target(kit):
    state = kit.state(kit.joint(), has_feedback=False)
    state.note_sent(0, 400, 1000)
    assert state.target_due_ns / 1e9 > 0.001 * 10


# ---- setpoints

TOLERANCE_DEG, WEEK_S = 0.2, 7 * 86400.0
STEP_GAIN_DEG = 600.0 * FILTER_S**2
"""So much a step may differ from the last one within 600 deg/s²."""


@pytest.fixture
def limits(kit):
    return servo_limits(kit.joint(drive="streamed"), TOLERANCE_DEG)


def test_from_rest_the_first_step_keeps_the_acceleration_that_the_horn_feels(limits):
    low_deg, high_deg = Setpoints(10.0, count=3, limits=limits).allowed(0.5)
    assert high_deg - 10.0 == pytest.approx(10.0 - low_deg)
    felt = 1.0 - 2.718281828**-1.0
    assert high_deg - 10.0 == pytest.approx(3 * (STEP_GAIN_DEG + TOLERANCE_DEG) / felt)


def test_a_horn_without_lag_feels_all_of_a_step(limits):
    limits = replace(limits, response=replace(limits.response, lag_s=0.0))
    _, high_deg = Setpoints(10.0, count=3, limits=limits).allowed(0.5)
    assert high_deg - 10.0 == pytest.approx(3 * (STEP_GAIN_DEG + TOLERANCE_DEG))


@pytest.mark.parametrize("rest_s", [0.4, WEEK_S])
def test_a_filter_that_has_settled_is_at_rest_however_long(limits, rest_s):
    setpoints = Setpoints(0.0, count=3, limits=limits)
    setpoints.commanded(0.1, 10.0)
    at_rest = Setpoints(10.0, count=3, limits=limits).allowed(0.1)
    assert setpoints.allowed(0.1 + rest_s) == pytest.approx(at_rest, abs=1e-6)


def test_a_target_counts_from_its_arrival(limits):
    setpoints = Setpoints(0.0, count=3, limits=limits)
    setpoints.commanded(0.1, 10.0)
    setpoints.commanded(1.1, 60.0)
    at_rest = Setpoints(10.0, count=3, limits=limits).allowed(1.1)
    assert setpoints.allowed(1.1) == pytest.approx(at_rest)


def test_where_the_possible_instants_disagree_a_target_is_half_way_between_them(limits):
    setpoints = Setpoints(0.0, count=3, limits=limits)
    setpoints.commanded(0.0199, 60.0)
    _, before_deg = setpoints.allowed(0.0199)
    low_deg, high_deg = setpoints.allowed(0.0301)
    after_deg, _ = setpoints.allowed(0.0399)
    assert before_deg < after_deg - 20.0
    assert low_deg == high_deg == pytest.approx(0.5 * (before_deg + after_deg))


def run_to_the_end(limits, count, sign):
    """Tell a servo to go as far as is allowed, step by step; return the targets and the filter."""
    setpoints = Setpoints(0.0, count=count, limits=limits)
    value, said, values = 0.0, [], [0.0]
    for step in range(1, 100):
        at_s = step * FILTER_S + 0.001
        span = setpoints.allowed(at_s)
        said.append(span[1] if sign > 0 else span[0])
        setpoints.commanded(at_s, said[-1])
        value += (said[-1] - value) / count
        values.append(value)
    return said, values


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("sign", [1, -1])
def test_it_brakes_before_the_end_of_the_range_and_no_sooner_than_it_must(limits, count, sign):
    limits = replace(limits, response=replace(limits.response, lag_s=0.0))
    said, values = run_to_the_end(limits, count, sign)
    assert max(sign * deg for deg in said) <= 90.0 + 1e-9
    assert sign * values[-1] > 89.8
    steps = [sign * (b - a) for a, b in pairwise(values)]
    gain_deg = STEP_GAIN_DEG + TOLERANCE_DEG
    assert max(steps) == pytest.approx(180.0 * FILTER_S)
    assert max(a - b for a, b in pairwise(steps)) <= gain_deg + 1e-9
    braked = zip(said[1:], pairwise(steps), strict=True)
    partly = [deg for deg, (a, b) in braked if 0.01 < a - b < gain_deg - 0.01]
    assert sum(abs(deg) < 89.99 for deg in partly) <= 1, "it brakes with all it may"


@pytest.mark.parametrize("sign", [1, -1])
def test_at_the_end_of_the_range_there_is_no_way_on(limits, sign):
    span = Setpoints(sign * 90.0, count=3, limits=limits).allowed(0.5)
    assert (span[1] if sign > 0 else span[0]) == pytest.approx(sign * 90.0)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("steps", [8, 20])
def test_what_closes_up_from_afar_brakes_evenly_until_it_is_there(limits, sign, steps):
    less_deg = CLOSING_RATIO * STEP_GAIN_DEG
    off_deg = sign * less_deg * sum(range(steps + 1))
    assert closing_deg(off_deg, limits) == pytest.approx(sign * steps * less_deg)


def test_what_is_near_closes_up_by_half_a_step_at_a_time(limits):
    assert closing_deg(0.0, limits) == 0.0
    assert closing_deg(-0.1, limits) == pytest.approx(-0.05)


@given(
    st.lists(
        st.tuples(st.integers(1_000, 20_000), st.floats(-90.0, 90.0)), min_size=1, max_size=60
    ),
    st.sampled_from([2, 3, 5]),
)
@example(asked=[(20_000, 90.0)] * 60, count=3)
def test_no_filter_leaves_its_limits_whatever_targets_arrive_when(asked, count):
    limits = servo_limits(joint(drive="streamed"), TOLERANCE_DEG)
    setpoints = Setpoints(0.0, count=count, limits=limits)
    at_us, received = 0.3, []
    for gap_us, wanted_deg in asked:
        at_us += gap_us
        low_deg, high_deg = setpoints.allowed(at_us / 1e6)
        if high_deg - low_deg < 1e-9:
            event("the instants disagree")
            break
        target_deg = min(max(wanted_deg, low_deg, -90.0), high_deg, 90.0)
        setpoints.commanded(at_us / 1e6, target_deg)
        received.append((1e3 * at_us, target_deg))
    for phase in range(STEP_OFFSETS):
        values = staircase(received, count, phase * FILTER_S / STEP_OFFSETS, at_us / 1e6 + FILTER_S)
        assert np.abs(np.diff(values)).max(initial=0.0) <= 180.0 * FILTER_S + 0.05
        most_deg_s2 = 600.0 + (TOLERANCE_DEG + 0.05) / FILTER_S**2
        assert np.abs(felt(values)).max(initial=0.0) <= most_deg_s2


# ---- trace


@pytest.mark.parametrize("count", [1, POINTS_MAX, POINTS_MAX + 1, 54_321])
def test_few_points_cover_the_whole_evenly(count):
    trace = Trace()
    for index in range(count):
        trace.add(float(index), 2.0 * index, 3.0 * index)
    at_s = [point[0] for point in trace.points]
    steps = {after - before for before, after in pairwise(at_s)}
    assert at_s[0] == 0.0
    assert steps <= {float(trace.stride)}
    assert count - 1 - at_s[-1] < trace.stride
    assert min(count, POINTS_MAX / 2) <= len(at_s) <= POINTS_MAX
    assert all(point == (t, 2.0 * t, 3.0 * t) for t, point in zip(at_s, trace.points, strict=True))


# ---- statistics


def test_lateness_becomes_percentiles():
    statistics = Statistics()
    for late_us in range(100):
        statistics.sent(1000 * late_us)
    assert statistics.timing() == {
        "commands": 100,
        "missed": 0,
        "late_p50_us": 50,
        "late_p99_us": 99,
        "late_max_us": 99,
    }


def test_percentiles_are_right_to_a_bin_and_an_hour_takes_no_more_room_than_a_minute():
    random = Random(1)
    lates_ns = [int(random.lognormvariate(11.0, 1.5)) for _ in range(40_000)]
    statistics, sizes = Statistics(), []
    for index, late_ns in enumerate(lates_ns):
        statistics.sent(late_ns)
        if index in (20_000, 39_999):
            sizes.append(len(statistics._bins) + len(statistics.latest_ns))
    ordered_us, said = [late_ns / 1000 for late_ns in sorted(lates_ns)], statistics.timing()
    assert said["commands"] == len(lates_ns)
    assert said["late_p50_us"] == pytest.approx(ordered_us[20_000], rel=0.016, abs=1.0)
    assert said["late_p99_us"] == pytest.approx(ordered_us[39_600], rel=0.016, abs=1.0)
    assert said["late_max_us"] == int(ordered_us[-1])
    assert sizes[1] < 1.1 * sizes[0] < 1500
    assert list(statistics.latest_ns) == lates_ns[-100:]


@pytest.mark.parametrize("late_us", [129, 255, 1025, 4094, 20_000, 65_537])
def test_a_percentile_is_the_upper_end_of_a_narrow_bin(late_us):
    statistics = Statistics()
    for late_ns in (1000 * late_us, 1000 * late_us, 10**9):
        statistics.sent(late_ns)
    assert late_us <= statistics.timing()["late_p50_us"] <= late_us * (1.0 + 2.0**-6)


def test_a_histogram_doubles_from_bar_to_bar_and_holds_every_move():
    statistics = Statistics()
    for late_us in [0] * 5 + [7, 20, 31, 33, 1000, 1500]:
        statistics.sent(1000 * late_us)
    assert statistics.histogram_us() == [(8, 6), (32, 2), (64, 1), (1024, 1), (2048, 1)]


def test_early_is_not_late():
    statistics = Statistics()
    statistics.sent(-5_000_000)
    assert statistics.max_ns == 0
    assert statistics.timing() | {"commands": 0} == Statistics().timing()


def test_later_than_a_move_reaches_is_missed():
    statistics = Statistics()
    for late_ns in (MISSED_NS, MISSED_NS + 1):
        statistics.sent(late_ns)
    assert statistics.timing()["missed"] == 1
    statistics.left_out()
    assert statistics.timing()["missed"] == 2
    assert statistics.timing()["commands"] == 2


def test_nothing_sent_is_all_zeros():
    assert set(Statistics().timing().values()) == {0}


def test_a_joint_that_is_led_back_into_its_range_is_not_led_out_again(kit):
    joint = kit.joint("j0", 2, drive="streamed")
    least_deg, most_deg = joint.servo_range_deg
    state = kit.state(replace(joint, position_max_deg=joint.position_max_deg + 40.0))
    state.range_deg = (least_deg, most_deg)
    sent_deg = []
    for number, off_deg in enumerate((40.0, 30.0, 35.0, 10.0, 38.0, -5.0, 20.0)):
        wire = nearest_wire(most_deg + off_deg, state.limits)
        state.note_sent(STEP_NS * (1 + number), wire, None)
        sent_deg.append(wire / joint.model.wire_per_deg - most_deg)
    assert sent_deg == [40.0, 30.0, 30.0, 10.0, 10.0, -5.0, 0.0]
    assert state.limits.position_min_deg == least_deg
