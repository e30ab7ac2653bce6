from __future__ import annotations

import re

import pytest

from lss_motion.player.approach import approach
from lss_motion.player.health import SILENT_ASKS, STATUS_CAUSES, Watch, status_fault
from lss_motion.player.joint_state import make_joint_states
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
def track(kit):
    robot = kit.robot(kit.joint(following_deg=5.0))
    program = approach(robot, {"j0": 0.0}, {"j0": 0.0})
    return make_joint_states(program, robot, {"j0": 0.0}, 0.0, has_feedback=True)["j0"]


def causes(watch):
    return {cause for _, cause in watch.troubles}


def test_one_bad_status_is_asked_again_and_believed_when_it_is_said_twice(track):
    watch = Watch()
    watch.status(track, BLOCKED, 370)
    assert watch.troubles == {}
    assert watch.doubts == {"j0": "Q"}
    watch.status(track, BLOCKED, 370)
    assert causes(watch) == {Cause.BLOCKED}
    assert watch.doubts == {}
    assert "Find what is in its way" in watch.troubles["j0", Cause.BLOCKED]


def test_a_bad_status_between_good_ones_is_nothing(track):
    watch = Watch()
    for code in (HOLDING, BLOCKED, HOLDING, LIMP, HOLDING, BLOCKED, LIMP, HOLDING):
        watch.status(track, code, 370)
        assert watch.troubles == {}
    assert watch.doubts == {}


@pytest.mark.parametrize("status", STATUS_CAUSES)
def test_what_a_servo_reports_follows_its_name_and_says_what_to_do(kit, status):
    watch, firmware = Watch(), 780 if status in STATUS_CODES else PRO_STATUS_FIRMWARE
    track = kit.track(kit.joint(model=SERVO_MODELS["LSS-P-S1"]))
    for _ in range(2):
        watch.status(track, status_codes(Family.LSS_PRO, firmware).index(status), firmware)
    ((place, text),) = watch.troubles.items()
    assert place == ("j0", STATUS_CAUSES[status])
    assert re.match(r"(is|reports) .+[:.] .*(Find|Lighten|Look)", text)
    assert track.status is status


def test_a_limp_servo_has_restarted(track):
    watch = Watch()
    watch.status(track, LIMP, 370)
    watch.status(track, LIMP, 370)
    assert causes(watch) == {Cause.RESTARTED}


def test_heat_and_voltage_are_judged_by_the_joints_own_limits(track):
    watch = Watch()
    for celsius, volt in ((74.0, 6.1), (91.2, 1.2), (74.0, 6.1), (76.0, 5.9)):
        watch.temperature(track, celsius)
        watch.voltage(track, volt)
        assert watch.troubles == {}
    assert watch.doubts == {"j0": "QV"}, "asked again at once"
    watch.temperature(track, 77.0)
    assert watch.doubts == {"j0": "QV"}
    watch.voltage(track, 5.8)
    assert watch.doubts == {}
    assert causes(watch) == {Cause.HOT, Cause.LOW_VOLTAGE}
    assert "77 C, allowed is 75 C (temperature_max_c)" in watch.troubles["j0", Cause.HOT]
    assert (track.temperature_max_c, track.voltage_min_v) == (76.0, 5.9), "as two readings say"
    watch.temperature(track, 70.0)
    assert causes(watch) == {Cause.LOW_VOLTAGE}
    watch.temperature(track, 76.0)
    assert watch.doubts == {"j0": "QT"}


def test_what_is_just_allowed_is_no_trouble(track):
    watch = Watch()
    for _ in range(3):
        watch.temperature(track, 75.0)
        watch.voltage(track, 6.0)
    assert (watch.troubles, watch.doubts) == ({}, {})


def test_before_it_is_driven_a_servo_may_be_limp_and_must_have_no_fault():
    assert "Find what is in its way" in status_fault(Status.BLOCKED)
    assert "RESET" in status_fault(Status.SAFE_MODE)
    assert status_fault(Status.LIMP) is None
    assert status_fault(Status.HOLDING) is None


def test_a_joint_is_astray_after_half_a_second_and_back_at_half_the_tolerance(track):
    watch = Watch()
    for at_s, error_deg, is_astray in [
        (0.0, 6.0, False), (0.4, -6.0, False), (0.45, 4.0, False), (0.5, 6.0, False),
        (0.9, 6.0, False), (1.1, 7.5, True), (1.2, 4.0, True), (1.3, 2.4, False),
    ]:  # fmt: skip
        track.following.error_deg = error_deg
        watch.position(track, int(at_s * S))
        assert (("j0", Cause.ASTRAY) in watch.troubles) is is_astray, at_s


def test_a_servo_is_silent_after_its_time_and_so_many_questions(track):
    watch = Watch()
    for ask in range(1, SILENT_ASKS + 1):
        watch.advance(S + ask)
        assert watch.troubles == {}
        watch.unanswered(track, S + ask, 0)
    watch.advance(S + SILENT_ASKS)
    assert causes(watch) == {Cause.SILENT}
    watch.answered(track)
    for ask in range(20):
        watch.unanswered(track, 2 * S + ask * S // 50, 2 * S)
        watch.advance(2 * S + ask * S // 50)
        assert watch.troubles == {}, "not before its time"


def test_a_servo_is_silent_when_its_time_is_over_whenever_it_was_last_asked(track):
    watch = Watch()
    for ask in range(SILENT_ASKS):
        watch.unanswered(track, ask * S // 10, 0)
    assert watch.wakeups_ns() == [S]
    watch.advance(S - 1)
    assert watch.troubles == {}
    watch.advance(S)
    assert causes(watch) == {Cause.SILENT}
    assert watch.wakeups_ns() == []
    watch.advance(3 * S)
    assert "servo 1 has not answered for 3.0 s" in watch.troubles["j0", Cause.SILENT]
    watch.answered(track)
    watch.advance(5 * S)
    assert (watch.troubles, watch.wakeups_ns()) == ({}, [])


def test_a_servo_that_has_never_answered_is_silent_when_its_time_is_over_since_it_was_missed(track):
    watch = Watch()
    for ask in range(SILENT_ASKS):
        watch.unanswered(track, 7 * S + ask, 7 * S + ask)
    assert watch.wakeups_ns() == [8 * S]
    watch.advance(9 * S)
    assert "has not answered for 2.0 s" in watch.troubles["j0", Cause.SILENT]


def test_a_row_of_questions_that_is_lost_at_once_is_no_silence(track):
    """A servo that was not asked for long, as on a busy computer, is asked once more."""
    watch = Watch()
    for _ in range(2 * SILENT_ASKS):
        watch.unanswered(track, 5 * S, 0)
    watch.advance(5 * S)
    assert (watch.troubles, watch.wakeups_ns()) == ({}, [])
    watch.unanswered(track, 5 * S + 1, 0)
    watch.advance(5 * S + 1)
    assert causes(watch) == {Cause.SILENT}


def test_it_is_known_who_did_not_answer_the_last_question(track):
    watch = Watch()
    assert watch.quiet() == set()
    watch.unanswered(track, S, 0)
    assert watch.quiet() == {"j0"}
    watch.answered(track)
    assert watch.quiet() == set()
