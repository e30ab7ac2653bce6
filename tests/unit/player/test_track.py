"""One joint: what its servo is told, when it is told again, and what is known of it then."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lss_motion.player.joint_state import REST_DEG_S
from lss_motion.player.serial_line import SerialLine
from lss_motion.player.show_clock import ShowClock
from lss_motion.robot.model import Bus
from lss_motion.robot.servo_models import SERVO_MODELS
from tests.timed_moves import timed, travel

STEP_NS, LATE_NS = 20_000_000, 50_000_000
CLOCK = ShowClock(0, 0.0, 1.0)


def commanded(state, target_deg):
    """Say a target, and whatever is owed after that; return `(heard_ns, degrees)` of each."""
    now_ns, said = STEP_NS, []
    while True:
        wire = state.wire_for(target_deg, now_ns)
        state.note_sent(now_ns, wire, None)
        said.append((now_ns, wire / 10))
        if state.deferred is None:
            return said
        now_ns, target_deg, _ = state.deferred
        assert len(said) < 200, "it arrives some time"


def test_a_target_that_the_plan_would_ask_for_is_said_as_it_is(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    assert commanded(state, 2.0) == [(STEP_NS, 2.0)]
    assert state.guide_ns is None


def test_what_is_too_much_is_taken_off_and_the_joint_is_led(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed"))
    ((_, said_deg),) = commanded(state, 60.0)
    assert 2.0 < said_deg < 10.0
    acts_on = state.profile.acts_on
    assert acts_on(state.guide_ns / 1e9) == acts_on(STEP_NS / 1e9) + 1, "with the next step"


@pytest.mark.parametrize("baud_bps", [9600, 115200])
def test_a_joint_that_is_led_is_told_so_early_that_it_hears_it_half_a_step_before(kit, baud_bps):
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
    assert said[-1][0] - said[0][0] >= 0.8 * 37.0 / 150.0 * 1e9


def test_however_long_a_stepped_joint_stood_it_jumps_no_further_than_in_two_pulses(kit):
    joint = kit.joint("j0", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    state = kit.state(replace(joint, speed_max_deg_s=100.0))
    state.note_sent(0, state.wire_for(80.0, 0), None)
    assert state.place(1)[0] == 3.0, "one pulse, and what whole degrees take"
    assert state.resend_ns == 20_000_000
    state.note_sent(STEP_NS, state.wire_for(80.0, STEP_NS), None)
    assert state.place(STEP_NS)[0] == 6.0
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


def test_what_is_left_of_a_move_is_run_time_from_when_it_is_heard(kit, line):
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


def test_t_counts_from_where_the_servo_is_when_it_hears_it(kit):
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


def test_one_that_is_not_driven_is_told_nothing(kit, line):
    state = timed(kit, travel(40.0))
    state.suspend()
    state.send(line, 40.0, 1.0, 0)
    assert (line.take(), state.last_arrival_ns) == (b"", None)


def test_what_was_sent_counts_from_when_its_last_byte_is_heard(kit, line):
    state = timed(kit, travel(40.0))
    line.send(b"." * 115, 0)
    state.send(line, 40.0, 1.0, 0)
    assert state.last_arrival_ns == line.free_ns == pytest.approx(11e6, rel=0.01)
    assert state.profile.at(0.011)[0] == 0.0
    assert state.profile.at(0.5)[0] == pytest.approx(state.plan.at(0.49)[0], abs=0.05)
    assert state.lost_moves.last.arrival_s == state.last_arrival_ns / 1e9
    assert state.lost_moves.last.target_deg == 40.0
    assert state.lost_moves.alternatives[-1].profile.at(5.0) == (0.0, 0.0), (
        "as if it had not heard it"
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
    state.suspend()
    state.leave_program(9)
    assert state.resend_ns is None
    state = timed(kit, travel(40.0))
    state.defer(9, 40.0)
    state.leave_program(7)
    assert state.resend_ns is None


def test_what_was_learnt_about_a_joint_is_kept(kit):
    earlier, state = timed(kit, travel(40.0)), timed(kit, travel(40.0))
    for _ in range(200):
        earlier.lag.take(40.0 * 0.03, 40.0, 0.05)
        earlier.lag.take(-40.0 * 0.03, -40.0, 0.05)
    earlier.disturbance.estimate_deg, earlier.disturbance.offset_deg = 1.5, 1.2
    earlier.lost_moves.mismatches = 3
    state.take_over(earlier)
    assert state.lag is earlier.lag
    assert state.early_s == pytest.approx(0.03, abs=2e-3)
    assert (state.disturbance.estimate_deg, state.disturbance.offset_deg) == (1.5, 1.2)
    assert state.lost_moves.mismatches == 3
    open_loop = kit.state(kit.joint(), has_feedback=False)
    assert open_loop.lost_moves is None
    assert (open_loop.resent, open_loop.health_count) == (0, 0)
    open_loop.take_over(earlier)
    state.take_over(open_loop)
    assert state.lost_moves.mismatches == 3
