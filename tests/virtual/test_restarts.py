"""A servo that restarts in a show is sent no move at its stored limits, judged by its bytes."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.sim.faults import Fault, FaultKind

S = 1_000_000_000
SPEED_DEG_S = 180.0
MOVE = re.compile(rb"#2D-?\d+(T\d+)?\r")
SETTINGS = {b"#2EM1\r", b"#2AA60\r", b"#2AD60\r", b"#2SD1800\r"}


def restart(at_s, deaf_s):
    return Fault(kind=FaultKind.RESET, servo_id=2, at_s=at_s, deaf_s=deaf_s)


def moves_without_settings(played, at_s, deaf_s):
    """Return when servo 2 received moves between a restart and its settings."""
    back_ns = int((at_s + deaf_s) * S)
    missing, moves_ns = set(SETTINGS), []
    for at_ns, line in played.bus.lines:
        if at_ns < back_ns:
            continue
        missing.discard(line)
        if not missing:
            break
        if MOVE.fullmatch(line):
            moves_ns.append(at_ns - back_ns)
    return moves_ns


def show(stage, kit, faults, **fields):
    robot = kit.robot(3, baud_bps=115200, **fields)
    sequence = kit.sequence(3, 4.0, seed=5, swing_deg=70.0, step_s=(0.5, 0.8))
    return stage.play(robot, sequence, faults=faults, start_deg={"j0": 25.0, "j1": -20.0})


@pytest.mark.parametrize("deaf_s", [0.02, 0.1, 0.3, 0.6, 1.25])
@pytest.mark.parametrize("at_s", [0.5, 2.4, 3.1])
def test_a_servo_that_was_away_for_however_short_gets_its_settings_before_it_moves_on(
    stage, kit, at_s, deaf_s
):
    played = show(stage, kit, [restart(at_s, deaf_s)], silent_s=60.0)
    assert played.report.outcome == "finished"
    assert [(f.joint, f.kind, f.step) for f in played.report.faults] == [
        ("j1", Cause.RESTARTED, FaultStep.RESUME)
    ]
    late_ns = moves_without_settings(played, at_s, deaf_s)
    # A restart that no query met is found by the next read-back.
    assert max(late_ns, default=0) <= (0.3 if deaf_s < 0.05 else 0.06) * S
    speed, _ = played.speeds(0, played.bus.lines[-1][0])
    assert np.abs(speed[:, 1]).max() <= 1.05 * SPEED_DEG_S
    (end_deg,) = played.bus.horn_deg([played.bus.lines[-1][0]])
    assert np.abs(end_deg).max() < 1.0


@pytest.mark.parametrize("at_s", [1.5, 1.58, 1.62, 1.66, 1.7, 1.74])
def test_servos_that_restart_while_they_are_set_up_again_get_their_settings(stage, kit, at_s):
    """All restart while a slow line gives them their settings after one was away."""
    first = Fault(kind=FaultKind.DEAF, servo_id=3, at_s=at_s - 0.6, until_s=at_s - 0.55)
    again = Fault(kind=FaultKind.RESET, at_s=at_s, deaf_s=1.25)
    sequence = kit.sequence(3, 4.0, seed=5, swing_deg=50.0, step_s=(0.9, 1.3))
    played = stage.play(kit.robot(3, baud_bps=9600), sequence, faults=[first, again])
    assert played.report.outcome == "finished"
    assert moves_without_settings(played, at_s, 1.25) == []


@pytest.mark.parametrize("lost", [0.3, 0.5])
def test_servos_that_restart_again_and_again_while_they_are_set_up_end_the_run(stage, kit, lost):
    """On a line that loses answers besides: each round of set-up meets a servo that was away."""
    faults = [Fault(kind=FaultKind.LOST_REPLY, at_s=0.5, ratio=lost)]
    faults += [Fault(kind=FaultKind.RESET, at_s=1.0 + 0.7 * n, deaf_s=0.3) for n in range(60)]
    sequence = kit.sequence(3, 4.0, seed=5, swing_deg=50.0, step_s=(0.9, 1.3))
    played = stage.play(kit.robot(3, baud_bps=19200), sequence, faults=faults)
    assert played.report.outcome == "fault"
    assert {fault.kind for fault in played.report.faults} <= {Cause.RESTARTED, Cause.SILENT}


def test_two_restarts_around_the_approach(stage, kit):
    played = show(stage, kit, [restart(0.4, 0.1), restart(1.0, 0.1)])
    assert played.report.outcome == "finished"
    assert {f.kind for f in played.report.faults} == {Cause.RESTARTED}
    speed, _ = played.speeds(0, played.bus.lines[-1][0])
    assert np.abs(speed[:, 1]).max() <= 1.05 * SPEED_DEG_S


def test_a_restart_ends_the_show_where_the_robot_file_requires_it(stage, kit):
    on_fault = {Cause.RESTARTED: (FaultStep.HOLD,)}
    played = show(stage, kit, [restart(2.4, 0.1)], on_fault=on_fault)
    assert played.report.outcome == "fault"
    assert "to Q" in played.report.faults[0].cause
    assert "It has restarted" in played.report.faults[0].cause


@pytest.mark.parametrize("kind", [FaultKind.CORRUPT_REPLY, FaultKind.SHORT_REPLY,
                                  FaultKind.LOST_REPLY, FaultKind.LATE_REPLY])  # fmt: skip
@pytest.mark.parametrize("seed", [1, 2])
def test_damaged_answers_are_no_restart(stage, kit, kind, seed):
    bad = Fault(kind=kind, at_s=0.8, ratio=0.1, late_s=0.02)
    robot = kit.robot(3, baud_bps=115200)
    played = stage.play(robot, kit.sequence(3, 4.0, seed=seed), faults=[bad], seed=seed)
    assert played.report.outcome == "finished"
    assert not [f for f in played.report.faults if f.kind == Cause.RESTARTED]
    assert np.abs(played.horn_error_deg()).max() < 6.0
