from __future__ import annotations

import pytest

from lss_motion.planning.program.verify import profiles
from lss_motion.playing.player import handshake
from lss_motion.playing.player.session import approach
from lss_motion.protocol.framing import encode
from lss_motion.robot.servo_models import SERVO_MODELS

ANSWERS = {"QMS": "LSS-ST1", "QF": 370, "Q": 1, "QSD": 3600, "QAA": 100, "QAD": 100, "QEM": 1}


def answers(servo_id=1, **changed):
    values = {**ANSWERS, "QD": 0, **changed}
    return {("main", servo_id, key): value for key, value in values.items() if value != "silent"}


def sent(items):
    return [encode(item.command) for item in items]


def test_the_session_gets_the_joints_own_limits(kit):
    one = kit.joint(accel_max_deg_s2=455.0, speed_max_deg_s=123.4, settings={"AS": -2})
    orders = handshake.session_orders([one], answers())
    assert sent(orders) == [b"#1EM1\r", b"#1AA55\r", b"#1AD55\r", b"#1SD1234\r", b"#1AS-2\r"]


def test_what_was_read_is_given_back_to_the_letter(kit):
    one = kit.joint(settings={"AS": -2})
    had = answers(QEM=0, QAA=77, QAD=33, QSD=2000, QAS=4)
    orders = handshake.restoring_orders([one], had)
    once = [b"#1EM0\r", b"#1AA77\r", b"#1AD33\r", b"#1SD2000\r", b"#1AS4\r"]
    assert sent(orders) == handshake.RESTORING_TIMES * once


def test_an_order_counts_as_taken_only_when_the_servo_answers_with_it(kit):
    orders = handshake.session_orders([kit.joint()], answers())
    said = {("main", 1, f"Q{order.command.keyword}"): order.command.value for order in orders}
    assert sent(handshake.read_back(orders)) == [b"#1QEM\r", b"#1QAA\r", b"#1QAD\r", b"#1QSD\r"]
    assert handshake.not_applied(orders, said) == []
    assert sent(handshake.not_applied(orders, {**said, ("main", 1, "QAD"): 100})) == [b"#1AD60\r"]
    said.pop(("main", 1, "QSD"))
    (order,) = handshake.not_applied(orders, said)
    error = handshake.not_applied_error(order, said, [kit.joint()])
    assert "joint 'j0': servo 1 was set to SD 1800 4 times and answers nothing" in str(error)


def test_the_approach_brings_all_joints_home_together_at_the_slow_speed(kit):
    robot = kit.robot(kit.joint(), kit.joint("j1", 2, direction=-1), approach_speed_deg_s=30.0)
    program = approach(robot, {"j0": 60.0, "j1": 10.0}, {"j0": 0.0, "j1": 10.0})
    first, second = program.moves
    assert (first.target_wire, second.target_wire) == (0, -100)
    assert first.duration_ms == second.duration_ms == 2000
    assert second.due_us > first.due_us
    ends = {name: plan.at(program.duration_s) for name, plan in profiles(program, robot).items()}
    assert ends == {"j0": (0.0, 0.0), "j1": (-10.0, 0.0)}


def test_units_of_a_reading_belong_to_the_family(kit):
    pro = kit.joint(model=SERVO_MODELS["LSS-P-S1"])
    assert handshake.reported(pro, answers(QD=1234), "QD") == 12.34
    assert handshake.reported(kit.joint(), answers(QD=1234), "QD") == 123.4
    assert handshake.reported(kit.joint(), answers(), "QT") is None


def test_the_safe_state_goes_to_every_bus(kit):
    assert handshake.safe_bytes(kit.robot()) == {"main": b"#254H\r"}
    assert handshake.safe_bytes(kit.robot(), is_limp=True) == {"main": b"#254L\r"}


def test_a_joint_that_was_let_go_stays_so(kit):
    one = kit.joint()
    assert handshake.safe_bytes(kit.robot(one), limp=[one]) == {"main": b"#254H\r#1L\r"}


def speeds_deg_s(program, standing_deg):
    """Return the speeds that the moves of a program ask for: way by T, in order of time."""
    at_deg, speeds = dict(standing_deg), []
    for move in sorted(program.moves, key=lambda move: move.due_us):
        target_deg = move.target_wire / 10.0
        way_deg = abs(target_deg - at_deg[move.servo_id])
        speeds.append(way_deg * 1000.0 / move.duration_ms)
        at_deg[move.servo_id] = target_deg
    return speeds


def test_a_joint_far_outside_of_its_range_is_led_back_no_faster_than_asked(kit):
    """The first of two moves ends in the range: its way is the longer one, and so is its T."""
    robot = kit.robot(kit.joint(), kit.joint("j1", 2), approach_speed_deg_s=30.0)
    program = approach(robot, {"j0": -350.0, "j1": 10.0}, {"j0": 0.0, "j1": -20.0})
    assert len(program.moves) == 4
    assert all(-900 <= move.target_wire <= 900 for move in program.moves)
    assert max(speeds_deg_s(program, {1: -350.0, 2: 10.0})) == pytest.approx(30.0, rel=0.01)


def test_where_every_joint_is_left_out_the_approach_ends_at_once(kit):
    program = approach(kit.robot(kit.joint()), {"j0": 0.0}, {})
    assert (program.duration_s, program.moves) == (0.0, ())


def test_the_way_back_into_the_range_may_be_too_long_for_one_move(kit):
    robot = kit.robot(kit.joint(), approach_speed_deg_s=10.0)
    program = approach(robot, {"j0": -250.0}, {"j0": 0.0})
    assert max(speeds_deg_s(program, {1: -250.0})) <= 10.05
    assert program.moves[-1].target_wire == 0
