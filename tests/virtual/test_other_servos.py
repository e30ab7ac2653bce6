"""A servo that was away is compared again with what it was before it is sent any move."""

from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.playing.player.checks import stored_limits
from lss_motion.playing.player.events import Phase
from lss_motion.robot.on_fault import Cause
from lss_motion.sim.faults import Fault, FaultKind

S = 1_000_000_000
AT_S = 2.4
SPEED_DEG_S = 180.0


def exchanged(at_s=AT_S, deaf_s=1.0, servo_id=2, **settings):
    return Fault(
        kind=FaultKind.EXCHANGED, servo_id=servo_id, at_s=at_s, deaf_s=deaf_s, settings=settings
    )


def factory(at_s=AT_S, deaf_s=1.0):
    return Fault(kind=FaultKind.FACTORY, servo_id=2, at_s=at_s, deaf_s=deaf_s)


def unplugged(at_s=AT_S, gone_s=1.0):
    return Fault(kind=FaultKind.UNPLUGGED, at_s=at_s, until_s=at_s + gone_s)


def play(stage, kit, faults, *, stored=None, must_ask=False, wishes=(), **fields):
    robot = kit.robot(3, **{"baud_bps": 115_200, **fields})
    joints = {n: replace(one, stored=stored or {}) for n, one in robot.joints.items()}
    robot = replace(robot, joints=joints)
    sequence = kit.sequence(3, 4.0, seed=5, swing_deg=70.0, step_s=(0.5, 0.8))
    start_deg = {"j0": 25.0, "j1": -20.0}
    given = {"must_ask": must_ask, "wishes": wishes}
    return stage.play(robot, sequence, faults=faults, start_deg=start_deg, **given)


def require_still(played, at_s=AT_S):
    """Require that no horn left its range or its speed, and no other servo got a move.

    A move that was due may leave shortly after the servo became deaf: all are deaf for longer.
    """
    end_ns = played.bus.lines[-1][0]
    speed, _ = played.speeds(0, end_ns)
    assert np.abs(speed).max() <= 1.05 * SPEED_DEG_S
    assert np.abs(played.bus.horn_deg(range(0, end_ns, 5_000_000))).max() <= 90.5
    after_ns = int((at_s + 0.2) * S)
    assert not [line for line in played.lines(after_ns=after_ns) if re.match(rb"#2D", line)]


@pytest.mark.parametrize("settings", [{"G": -1}, {"O": 900}, {"O": -300, "G": -1}, {"AR": 900}])
def test_a_servo_that_took_the_place_of_another_is_named_and_never_driven(stage, kit, settings):
    played = play(stage, kit, [exchanged(**settings)])
    assert played.report.outcome == "fault"
    text = str(played.result.error)
    assert "joint 'j1': servo 2" in text
    assert all(f"({name})" in text for name in settings)
    require_still(played)


@pytest.mark.parametrize("stored", [{"O": 30.0}, {"G": -1.0}])
def test_a_servo_that_is_back_from_the_factory_is_never_driven(stage, kit, stored):
    played = play(stage, kit, [factory()], stored=stored)
    assert played.report.outcome == "fault"
    assert "servo 2 has " in str(played.result.error)
    assert f"({next(iter(stored))})" in str(played.result.error)
    require_still(played)


@pytest.mark.parametrize("gone_s", [0.3, 1.0])
def test_another_robot_behind_the_port_is_never_driven(stage, kit, gone_s):
    other = exchanged(deaf_s=gone_s, servo_id=None, O=1200)
    played = play(stage, kit, [unplugged(gone_s=gone_s), other])
    assert played.report.outcome == "fault"
    assert "origin (O) 120 deg" in str(played.result.error)
    require_still(played)
    assert not [line for line in played.lines(after_ns=int(3 * S)) if re.match(rb"#\d+D", line)]


@pytest.mark.parametrize("waited_s", [0.7, 60.0])
def test_a_servo_that_is_exchanged_while_a_person_is_waited_for_is_never_driven(
    stage, kit, waited_s
):
    def is_asked_for(player, now_ns):
        return player.phase is Phase.READY and now_ns > waited_s * S

    played = play(
        stage,
        kit,
        [exchanged(at_s=0.4, deaf_s=0.1, O=900)],
        must_ask=True,
        wishes=[(is_asked_for, lambda player, _: player.go())],
    )
    assert played.report.outcome == "fault"
    assert "joint 'j1': servo 2" in str(played.result.error)
    assert "(O)" in str(played.result.error)
    assert not [line for line in played.lines(after_ns=0) if re.match(rb"#\d+D", line)]


@pytest.mark.parametrize("deaf_s", [0.5, 0.6, 0.9])
@pytest.mark.parametrize("settings", [{"G": -1}, {"O": 300}, {"O": -900}, {"AR": 900}])
def test_another_servo_that_stores_the_limits_is_never_driven_after_a_short_absence(
    stage, kit, settings, deaf_s
):
    """No query of a setting shows that it was away: all are as they were."""
    limits = stored_limits(next(iter(kit.robot(1).joints.values())))
    robot_limits = {"SD": SPEED_DEG_S, "AA": 600.0, "AD": 600.0}
    played = play(
        stage, kit, [exchanged(deaf_s=deaf_s, **{**limits, **settings})], stored=robot_limits
    )
    assert played.report.outcome == "fault"
    assert f"({next(iter(settings))})" in str(played.result.error)
    back_ns = int((AT_S + deaf_s) * S)
    assert not [one for one in played.lines(after_ns=back_ns) if one.startswith(b"#2D")]


@pytest.mark.parametrize("deaf_s", [0.5, 0.6, 0.9])
def test_the_same_servo_goes_on_after_a_short_absence(stage, kit, deaf_s):
    robot_limits = {"SD": SPEED_DEG_S, "AA": 600.0, "AD": 600.0}
    played = play(
        stage,
        kit,
        [Fault(kind=FaultKind.DEAF, servo_id=2, at_s=AT_S, until_s=AT_S + deaf_s)],
        stored=robot_limits,
    )
    assert played.report.outcome == "finished"
    assert np.abs(played.horn_error_deg()[-1]).max() < 1.0


@pytest.mark.parametrize("baud_bps", [9_600, 115_200])
@pytest.mark.parametrize(
    "later_s", [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0]
)
def test_a_servo_that_is_exchanged_while_another_is_waited_for_is_never_driven(
    stage, kit, baud_bps, later_s
):
    at_s = AT_S + later_s
    reset = Fault(kind=FaultKind.RESET, servo_id=1, at_s=AT_S, deaf_s=0.6)
    other = exchanged(at_s=at_s, deaf_s=0.6, G=-1)
    played = play(stage, kit, [reset, other], baud_bps=baud_bps)
    assert played.report.outcome == "fault"
    assert "(G) -1" in str(played.result.error)
    assert not [one for one in played.lines(after_ns=int((at_s + 0.6) * S)) if one[:3] == b"#2D"]


def test_a_servo_of_the_same_settings_goes_on_with_them(stage, kit):
    played = play(stage, kit, [factory()])
    assert played.report.outcome == "finished"
    assert {fault.kind for fault in played.report.faults} >= {Cause.RESTARTED}


def test_a_damaged_answer_about_a_servo_that_is_back_refuses_nothing(stage, kit):
    bad = Fault(kind=FaultKind.CORRUPT_REPLY, at_s=AT_S, ratio=0.2)
    reset = Fault(kind=FaultKind.RESET, servo_id=2, at_s=AT_S, deaf_s=1.0)
    played = play(stage, kit, [reset, bad])
    assert played.report.outcome == "finished"


# ---- two servos with one id


def renumbered(at_s):
    """Return the fault by which servo 3 takes the id 2 as well."""
    return Fault(kind=FaultKind.STORED, servo_id=3, at_s=at_s, settings={"ID": 2})


def play_six(stage, kit, faults, baud_bps):
    sequence = kit.sequence(3, 6.0, seed=7, swing_deg=60.0, step_s=(0.5, 0.7))
    return stage.play(kit.robot(3, baud_bps=baud_bps), sequence, faults=faults)


def late_moves(played, at_s):
    """Return the moves to id 2 that left 0.3 s after the first query that two servos answer.

    A reply that comes twice stops the next one; three that damage each other take 0.1 s.
    """
    asked_ns = [t for t, line in played.bus.lines if t > at_s * S and line.startswith(b"#2Q")]
    assert asked_ns
    return [
        line
        for at_ns, line in played.bus.lines
        if line.startswith(b"#2D") and at_ns > asked_ns[0] + int(0.3 * S)
    ]


EVERY_S = [round(0.5 + 0.1 * step, 1) for step in range(70)]
"""The show ends at 7.5 s. Every third instant is tried in the quick tier, all in the other."""


@pytest.mark.parametrize("baud_bps", [115_200, 500_000])
@pytest.mark.parametrize(
    "at_s",
    [pytest.param(s, marks=[pytest.mark.slow] if n % 3 else []) for n, s in enumerate(EVERY_S)],
)
def test_two_servos_get_no_move_after_their_replies_show_them(stage, kit, baud_bps, at_s):
    played = play_six(stage, kit, [renumbered(at_s)], baud_bps)
    assert played.report.outcome != "finished"
    assert late_moves(played, at_s) == []


@pytest.mark.parametrize("baud_bps", [500_000, 1_000_000])
@pytest.mark.parametrize("at_s", [2.9, 3.2, 3.41, 3.8, 4.2, 5.0])
def test_answers_that_come_twice_show_two_servos_and_neither_moves_on(stage, kit, baud_bps, at_s):
    played = play_six(stage, kit, [renumbered(at_s)], baud_bps)
    assert "several servos (serial numbers" in str(played.result.error)
    braking = next(e for e in played.events if getattr(e, "joint", "") == "j1")
    assert "answers every query twice" in braking.cause
    assert late_moves(played, at_s) == []


def test_answers_that_damage_each_other_are_named(stage, kit):
    played = play_six(stage, kit, [renumbered(2.03)], 115_200)
    assert played.report.outcome == "fault"
    causes = {fault.joint: fault.cause for fault in played.report.faults}
    assert "as when two servos have the id 2" in causes["j1"]
    assert late_moves(played, 2.03) == []


@pytest.mark.parametrize("ratio", [0.1, 0.2, 1.0])
def test_a_line_that_doubles_replies_is_not_taken_for_two_servos(stage, kit, ratio):
    played = play_six(stage, kit, [Fault(kind=FaultKind.DOUBLE_REPLY, ratio=ratio)], 115_200)
    assert played.report.outcome == "finished"
    suspected = [e for e in played.events if "answers every query twice" in getattr(e, "cause", "")]
    assert suspected == []


def test_a_line_that_doubles_replies_for_a_while_ends_no_show(stage, kit):
    doubled = Fault(kind=FaultKind.DOUBLE_REPLY, at_s=2.0, until_s=2.4)
    played = play_six(stage, kit, [doubled], 115_200)
    assert played.report.outcome == "finished"
