from __future__ import annotations

import pytest

from lss_motion.player.approach import approach
from lss_motion.player.track import make_tracks
from lss_motion.player.watch import SILENT_ASKS, Watch
from lss_motion.robot.on_fault import Cause

S = 1_000_000_000
BLOCKED, HOLDING, LIMP = 9, 6, 1


@pytest.fixture
def track(kit):
    robot = kit.robot(kit.joint(following_deg=5.0))
    program = approach(robot, {"j0": 0.0}, {"j0": 0.0})
    return make_tracks(program, robot, {"j0": 0.0}, 0.0, has_feedback=True)["j0"]


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
    watch.temperature(track, 77.0)
    watch.voltage(track, 5.8)
    assert causes(watch) == {Cause.HOT, Cause.LOW_VOLTAGE}
    assert "77 C, allowed is 75 C (temperature_max_c)" in watch.troubles["j0", Cause.HOT]
    assert (track.temperature_max_c, track.voltage_min_v) == (76.0, 5.9), "as two readings say"
    watch.temperature(track, 70.0)
    assert causes(watch) == {Cause.LOW_VOLTAGE}


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
    watch.answered(track, 0)
    for ask in range(1, SILENT_ASKS + 1):
        watch.advance(S + ask)
        assert watch.troubles == {}
        watch.unanswered(track, S + ask)
    watch.advance(S + SILENT_ASKS)
    assert causes(watch) == {Cause.SILENT}
    watch.answered(track, 2 * S)
    for ask in range(20):
        watch.unanswered(track, 2 * S + ask * S // 50)
        watch.advance(2 * S + ask * S // 50)
        assert watch.troubles == {}, "not before its time"


def test_a_servo_is_silent_when_its_time_is_over_whenever_it_was_last_asked(track):
    watch = Watch()
    watch.answered(track, 0)
    for ask in range(SILENT_ASKS):
        watch.unanswered(track, ask * S // 10)
    assert watch.wakeups_ns() == [S]
    watch.advance(S - 1)
    assert watch.troubles == {}
    watch.advance(S)
    assert causes(watch) == {Cause.SILENT}
    assert watch.wakeups_ns() == []
    watch.answered(track, S)
    watch.advance(3 * S)
    assert (watch.troubles, watch.wakeups_ns()) == ({}, [])
