from __future__ import annotations

import re

import pytest

from lss_motion.playing.player.health import (
    SILENT_QUERIES,
    STATUS_CAUSES,
    HealthMonitor,
    status_fault,
)
from lss_motion.playing.player.joint_state import make_joint_states
from lss_motion.playing.player.servo_model import Observation
from lss_motion.playing.player.session import approach
from lss_motion.protocol.constants import (
    PRO_STATUS_FIRMWARE,
    STATUS_CODES,
    Family,
    Status,
    status_codes,
)
from lss_motion.robot.on_fault import Cause
from lss_motion.robot.servo_models import SERVO_MODELS

S = 1_000_000_000
BLOCKED, HOLDING, LIMP = 9, 6, 1


@pytest.fixture
def state(kit):
    robot = kit.robot(kit.joint(following_deg=5.0))
    program = approach(robot, {"j0": 0.0}, {"j0": 0.0})
    return make_joint_states(program, robot, {"j0": 0.0}, 0.0, has_feedback=True)["j0"]


def causes(health):
    return {cause for _, cause in health.active_faults}


def test_a_bad_status_is_polled_again_and_accepted_when_it_is_repeated(state):
    health = HealthMonitor()
    health.status(state, BLOCKED)
    assert health.active_faults == {}
    assert health.unconfirmed == {"j0": "Q"}
    health.status(state, BLOCKED)
    assert causes(health) == {Cause.BLOCKED}
    assert health.unconfirmed == {}
    assert "Find what is in its way" in health.active_faults["j0", Cause.BLOCKED]


def test_a_bad_status_between_good_ones_is_nothing(state):
    health = HealthMonitor()
    for code in (HOLDING, BLOCKED, HOLDING, LIMP, HOLDING, BLOCKED, LIMP, HOLDING):
        health.status(state, code)
        assert health.active_faults == {}
    assert health.unconfirmed == {}


@pytest.mark.parametrize("status", STATUS_CAUSES)
def test_the_text_of_a_fault_follows_the_joint_name_and_names_a_remedy(kit, status):
    health, firmware = HealthMonitor(), 779 if status in STATUS_CODES else PRO_STATUS_FIRMWARE
    state = kit.state(kit.joint(model=SERVO_MODELS["LSS-P-S1"]))
    state.firmware = firmware
    for _ in range(2):
        health.status(state, status_codes(Family.LSS_PRO, firmware).index(status))
    ((place, text),) = health.active_faults.items()
    assert place == ("j0", STATUS_CAUSES[status])
    assert re.match(r"(is|reports) .+[:.] .*(Find|Lighten|Look)", text)
    assert state.status is status


def test_a_limp_servo_has_restarted(state):
    health = HealthMonitor()
    health.status(state, LIMP)
    health.status(state, LIMP)
    assert causes(health) == {Cause.RESTARTED}


def test_heat_and_voltage_are_judged_by_the_joints_own_limits(state):
    health = HealthMonitor()
    for celsius, volt in ((74.0, 6.1), (91.2, 1.2), (74.0, 6.1), (76.0, 5.9)):
        health.temperature(state, celsius)
        health.voltage(state, volt)
        assert health.active_faults == {}
    assert health.unconfirmed == {"j0": "QV"}, "asked again at once"
    health.temperature(state, 77.0)
    assert health.unconfirmed == {"j0": "QV"}
    health.voltage(state, 5.8)
    assert health.unconfirmed == {}
    assert causes(health) == {Cause.HOT, Cause.LOW_VOLTAGE}
    assert "77 C, allowed is 75 C (temperature_max_c)" in health.active_faults["j0", Cause.HOT]
    assert (state.temperature_max_c, state.voltage_min_v) == (76.0, 5.9), "as two readings say"
    health.temperature(state, 70.0)
    assert causes(health) == {Cause.LOW_VOLTAGE}
    health.temperature(state, 76.0)
    assert health.unconfirmed == {"j0": "QT"}


def test_what_is_just_allowed_is_no_trouble(state):
    health = HealthMonitor()
    for _ in range(3):
        health.temperature(state, 75.0)
        health.voltage(state, 6.0)
    assert (health.active_faults, health.unconfirmed) == ({}, {})


def test_before_it_is_driven_a_servo_may_be_limp_and_must_have_no_fault():
    assert "Find what is in its way" in status_fault(Status.BLOCKED)
    assert "RESET" in status_fault(Status.SAFE_MODE)
    assert status_fault(Status.LIMP) is None
    assert status_fault(Status.HOLDING) is None


def test_a_joint_is_astray_after_a_twentieth_of_a_second_and_back_at_half_the_tolerance(state):
    health = HealthMonitor()
    for at_ms, error_deg, is_astray, is_asked_again in [
        (0, 6.0, False, True), (45, -6.0, False, True), (47, 4.0, False, False),
        (50, 6.0, False, True), (90, 6.0, False, True), (110, 7.5, True, False),
        (120, 4.0, True, False), (130, 2.4, False, False),
    ]:  # fmt: skip
        seen = Observation(has_lost_move=False, error_deg=error_deg, model_error_deg=error_deg)
        health.position(state.joint, seen, at_ms * S // 1000)
        assert (("j0", Cause.ASTRAY) in health.active_faults) is is_astray, at_ms
        assert health.unconfirmed == ({"j0": "QD"} if is_asked_again else {}), at_ms


def test_a_joint_that_is_where_its_moves_took_it_is_not_astray(state):
    """This program was late; its moves lead the joint back."""
    health = HealthMonitor()
    for model_error_deg in (0.5, -4.9):
        seen = Observation(False, 20.0, model_error_deg)
        for at_ms in (0, 100, 200):
            health.position(state.joint, seen, at_ms * S // 1000)
    assert (health.active_faults, health.unconfirmed) == ({}, {})


def test_a_servo_is_silent_after_its_time_and_so_many_questions(state):
    health = HealthMonitor()
    for ask in range(1, SILENT_QUERIES + 1):
        health.advance(S + ask)
        assert health.active_faults == {}
        health.unanswered(state, S + ask, 0)
    health.advance(S + SILENT_QUERIES)
    assert causes(health) == {Cause.SILENT}
    health.answered(state)
    for ask in range(20):
        health.unanswered(state, 2 * S + ask * S // 50, 2 * S)
        health.advance(2 * S + ask * S // 50)
        assert health.active_faults == {}, "not before its time"


def test_a_servo_is_silent_after_its_time_whenever_it_was_last_polled(state):
    health = HealthMonitor()
    for ask in range(SILENT_QUERIES):
        health.unanswered(state, ask * S // 10, 0)
    assert health.wakeups_ns() == [S]
    health.advance(S - 1)
    assert health.active_faults == {}
    health.advance(S)
    assert causes(health) == {Cause.SILENT}
    assert health.wakeups_ns() == []
    health.advance(3 * S)
    assert "servo 1 has not answered for 3.0 s" in health.active_faults["j0", Cause.SILENT]
    health.answered(state)
    health.advance(5 * S)
    assert (health.active_faults, health.wakeups_ns()) == ({}, [])


def test_a_servo_that_has_never_answered_is_silent_when_its_time_is_over_since_it_was_missed(state):
    health = HealthMonitor()
    for ask in range(SILENT_QUERIES):
        health.unanswered(state, 7 * S + ask, 7 * S + ask)
    assert health.wakeups_ns() == [8 * S]
    health.advance(9 * S)
    assert "has not answered for 2.0 s" in health.active_faults["j0", Cause.SILENT]


def test_a_row_of_questions_that_is_lost_at_once_is_no_silence(state):
    """A servo without queries for long, as on a busy computer, is polled once more."""
    health = HealthMonitor()
    for _ in range(2 * SILENT_QUERIES):
        health.unanswered(state, 5 * S, 0)
    health.advance(5 * S)
    assert (health.active_faults, health.wakeups_ns()) == ({}, [])
    health.unanswered(state, 5 * S + 1, 0)
    health.advance(5 * S + 1)
    assert causes(health) == {Cause.SILENT}


def test_servos_that_did_not_answer_the_last_query_are_known(state):
    health = HealthMonitor()
    assert health.awaited.keys() == set()
    health.unanswered(state, S, 0)
    assert health.awaited.keys() == {"j0"}
    health.answered(state)
    assert health.awaited.keys() == set()
