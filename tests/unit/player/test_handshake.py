from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from lss_motion.errors import BusError, InputError
from lss_motion.player import handshake
from lss_motion.player.approach import approach
from lss_motion.program.verify import profiles
from lss_motion.protocol.line import encode
from lss_motion.robot.servo_models import SERVO_MODELS

ANSWERS = {"QMS": "LSS-ST1", "QF": 370, "Q": 1, "QSD": 3600, "QAA": 100, "QAD": 100, "QEM": 1}


def answers(servo_id=1, **changed):
    values = {**ANSWERS, "QD": 0, **changed}
    return {("main", servo_id, key): value for key, value in values.items() if value != "silent"}


def sent(items):
    return [encode(item.command) for item in items]


def test_good_answers_raise_nothing_and_warn_of_nothing(kit):
    assert handshake.check_answers([kit.joint()], answers(), kit.robot()) == []


@pytest.mark.parametrize("said", ["silent", None, "DIS"])
def test_a_servo_that_does_not_report_its_position_counts_as_silent(kit, said):
    with pytest.raises(BusError, match=r"j0 \(id 1 on bus 'main'\)"):
        handshake.check_answers([kit.joint()], answers(QD=said), kit.robot())


def test_a_servo_that_answers_little_but_its_place_is_driven_and_given_its_limits(kit):
    known = answers(**dict.fromkeys(ANSWERS, "silent"))
    assert handshake.check_answers([kit.joint()], known, kit.robot()) == []
    assert handshake.session_orders([kit.joint()], known) == []
    limits = [b"#1EM1\r", b"#1AA60\r", b"#1AD60\r", b"#1SD1800\r"]
    assert sent(handshake.unconfirmed_orders([kit.joint()], known)) == limits
    assert handshake.unconfirmed_orders([kit.joint()], answers()) == []
    assert handshake.restoring_orders([kit.joint()], known) == []


def test_the_session_gets_the_joints_own_limits(kit):
    one = kit.joint(accel_max_deg_s2=455.0, speed_max_deg_s=123.4, settings={"AS": -2})
    orders = handshake.session_orders([one], answers())
    assert sent(orders) == [b"#1EM1\r", b"#1AA45\r", b"#1AD45\r", b"#1SD1234\r", b"#1AS-2\r"]


def test_what_was_read_is_given_back_to_the_letter(kit):
    one = kit.joint(settings={"AS": -2})
    had = answers(QEM=0, QAA=77, QAD=33, QSD=2000, QAS=4)
    orders = handshake.restoring_orders([one], had)
    once = [b"#1EM0\r", b"#1AA77\r", b"#1AD33\r", b"#1SD2000\r", b"#1AS4\r"]
    assert sent(orders) == handshake.RESTORING_TIMES * once


def test_the_settings_of_the_file_are_queried_too(kit):
    one = kit.joint(settings={"AS": -2, "AH": 3})
    assert {b"#1QAS\r", b"#1QAH\r", b"#1QD\r"} <= set(sent(handshake.queries([one])))


@pytest.mark.parametrize("drive", ["timed", "streamed", "stepped"])
def test_the_first_question_is_one_that_all_documents_have(kit, drive):
    """By it a servo counts as silent: QFPC is nothing that an old firmware knows."""
    model = SERVO_MODELS["LSS-2IO" if drive == "stepped" else "LSS-ST1"]
    asked = sent(handshake.queries([kit.joint(model=model, drive=drive, settings={"AS": -2})]))
    assert asked[0] == b"#1QMS\r"
    assert asked[-1] == b"#1QAS\r"
    assert len(set(asked)) == len(asked) > 3


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


def test_a_servo_of_another_model_is_refused_at_the_line_that_names_the_model(kit):
    robot = replace(kit.robot(one := kit.joint(lines={"model": 7})), path=Path("arm.yaml"))
    with pytest.raises(InputError, match=r"^arm.yaml:7: joint 'j0': servo 1 is an LSS-HT1"):
        handshake.check_answers([one], answers(QMS="LSS-HT1"), robot)


@pytest.mark.parametrize(("wire", "is_said"), [(-905, False), (905, False), (1201, True)])
def test_a_joint_outside_of_its_range_is_named_with_angle_and_range(kit, wire, is_said):
    one = kit.joint(position_min_deg=-90.0, position_max_deg=90.0, direction=-1)
    texts = handshake.check_range([one], answers(QD=wire))
    assert [text.partition(", and")[0] for text in texts] == [
        "joint 'j0' stands at -120.1 deg, outside of its range of -90 to 90 deg"
    ] * is_said


def test_a_limp_servo_is_reported_before_it_moves(kit):
    one = kit.joint()
    said = [
        handshake.found([one], answers(Q=code), kit.robot(one), {"j0": 0.0})[0].status
        for code in (1, 6, "silent")
    ]
    assert said == ["limp", "holding", None]
