"""What becomes of a show when something goes wrong, judged at the servos."""

from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import BusError, LostPortError
from lss_motion.playing.player import checks
from lss_motion.playing.player.estimators import OFFSET_MAX_DEG
from lss_motion.playing.player.events import PhaseEntered, Warned
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.servo import Servo
from tests.timed_moves import is_move

S = 1_000_000_000
HOLD = b"#254H\r"
RESET_S = 1.25


def phases(played):
    return [event.phase for event in played.events if isinstance(event, PhaseEntered)]


def faults(played):
    return [(f.joint, f.kind, f.step) for f in played.report.faults]


def at_rest(played, from_ns, to_ns):
    horn_deg = played.bus.horn_deg(np.arange(from_ns, to_ns, 10_000_000))
    return float(np.ptp(horn_deg, axis=0).max())


def test_a_servo_that_stays_silent_is_waited_for_and_named_and_the_robot_holds(stage, kit):
    robot = kit.robot(resume_s=4.0)
    played = stage.play(robot, faults=[Fault(kind=FaultKind.DEAF, servo_id=2, at_s=2.5)])
    assert played.report.outcome == "fault"
    assert faults(played) == [("j1", "silent", "hold")]
    assert "servo 2 did not answer, and was not back after 4 s" in played.report.faults[0].cause
    assert 2.5 + 1.0 + 4.0 < played.report.run_s < 2.5 + 1.4 + 4.0 + 0.5
    assert played.lines()[-1] == HOLD
    assert b"#1SD3600\r" in played.lines()[-30:]
    end_ns = played.bus.lines[-1][0]
    assert at_rest(played, end_ns - 3 * S, end_ns) < 0.3


@pytest.mark.parametrize("at_s", [1.0, 2.58, 3.3])
def test_a_servo_that_restarts_gets_its_settings_back_before_it_is_driven_on(stage, kit, at_s):
    sequence = kit.sequence(3, 6.0, swing_deg=50.0, step_s=(0.5, 0.9))
    reset = Fault(kind=FaultKind.RESET, servo_id=2, at_s=at_s)
    played = stage.play(sequence=sequence, faults=[reset])
    assert played.report.outcome == "finished"
    assert ("j1", "restarted", "resume") in faults(played)
    back_ns = int((at_s + RESET_S) * S)
    received = [line for line in played.lines(after_ns=back_ns) if line.startswith(b"#2")]
    first = next(i for i, line in enumerate(received) if line.startswith(b"#2D"))
    assert {b"#2EM1\r", b"#2AA60\r", b"#2AD60\r", b"#2SD1800\r"} <= set(received[:first])
    assert any(line.startswith(b"#2D") for line in received[first + 1 :]), "and then it goes on"
    speed, accel = played.speeds(back_ns, played.bus.lines[-1][0])
    assert np.abs(speed[:, 1]).max() <= 1.05 * 180.0
    assert np.abs(accel[:, 1]).max() <= 1.1 * 600.0
    # All rest for the last 0.15 s; just before, the third one brakes from its fastest move.
    ends = played.horn_error_deg(from_s=played.result.truth.times_s[-1] - 0.2)
    assert np.abs(ends).max() < 0.5, "it ends where the plan ends"


def test_a_servo_that_restarts_on_the_way_to_the_start_is_noticed_before_the_show(stage, kit):
    resets = [Fault(kind=FaultKind.RESET, servo_id=2, at_s=0.15)]
    played = stage.play(kit.robot(baud_bps=115200), kit.sequence(3, 3.0), faults=resets)
    assert played.report.outcome == "finished"
    assert faults(played) == [("j1", "silent", "resume"), ("j1", "restarted", "resume")]
    received = [
        line for line in played.lines(after_ns=int((0.15 + RESET_S) * S)) if line[:2] == b"#2"
    ]
    first = next(i for i, line in enumerate(received) if line.startswith(b"#2D"))
    assert {b"#2AA60\r", b"#2SD1800\r"} <= set(received[:first])


def test_a_servo_that_does_not_report_its_limits_is_sent_them_all_the_same(stage, kit, monkeypatch):
    obey = Servo.obey
    monkeypatch.setattr(
        Servo,
        "obey",
        lambda self, order, at_ns: obey(self, order, at_ns) if order.keyword != "QAA" else None,
    )
    played = stage.play(kit.robot(1, baud_bps=115200), kit.sequence(1, 2.0))
    assert played.report.outcome == "finished"
    received = played.lines()
    first = next(i for i, line in enumerate(received) if line.startswith(b"#1D"))
    assert b"#1AA60\r" in received[:first]


def test_a_servo_that_does_not_take_its_limits_is_not_driven(stage, kit, monkeypatch):
    asked = [word for word in checks.QUERIES if word != "QAA"]
    monkeypatch.setattr(checks, "QUERIES", asked)
    obey = Servo.obey
    monkeypatch.setattr(
        Servo,
        "obey",
        lambda self, order, at_ns: obey(self, order, at_ns) if order.keyword != "AA" else None,
    )
    played = stage.play(kit.robot(1, baud_bps=115200), kit.sequence(1, 2.0))
    assert "set to AA 60 4 times and answers 100" in str(played.result.error)
    assert not played.moves()


def test_the_show_slows_down_for_a_weak_joint_and_gets_to_its_end(stage, kit):
    weak = Fault(kind=FaultKind.WEAK, servo_id=1, at_s=1.5, until_s=5.0, speed_ratio=0.03)
    robot = kit.robot(following_deg=5.0, patience_s=10.0, baud_bps=57600)
    rates = []

    def look(player, now_ns):
        if player.phase == "playing":
            rates.append(player.show.clock.rate(now_ns))
        return False

    played = stage.play(robot, faults=[weak], wishes=[(look, None)])
    assert played.report.outcome == "finished"
    assert faults(played) == [("j0", "astray", "slow")]
    assert min(rates) <= 0.5
    assert rates[-1] == 1.0
    assert np.abs(played.horn_error_deg(from_s=5.5)).max() < OFFSET_MAX_DEG, "it has caught up"
    assert np.abs(played.horn_error_deg()[-1]).max() < 1.0, "and its last move is not corrected"


def test_a_joint_that_cannot_catch_up_ends_the_show(stage, kit):
    robot = kit.robot(following_deg=3.0, patience_s=1.0)
    weak = Fault(kind=FaultKind.WEAK, servo_id=1, at_s=1.5, speed_ratio=0.01)
    played = stage.play(robot, faults=[weak])
    assert played.report.outcome == "fault"
    assert ("j0", "astray", "hold") in faults(played)
    assert "off its course, allowed is 3 deg" in played.report.faults[0].cause
    assert played.lines()[-1] == HOLD


@pytest.mark.parametrize("baud_bps", [19200, 115200])
def test_the_first_step_comes_within_a_tenth_of_a_second(stage, kit, baud_bps):
    """Of the first reading that shows the error: when the servo received its query."""
    stuck = Fault(kind=FaultKind.STUCK, servo_id=2, at_s=2.0)
    robot = kit.robot(
        following_deg=4.0, baud_bps=baud_bps, on_fault={Cause.ASTRAY: (FaultStep.HOLD,)}
    )
    shown_ns, took_ns = [], []

    def look(player, now_ns):
        if player.phase == "playing" and not shown_ns:
            joint = player.show.joint_states["j1"]
            if abs(joint.disturbance.error_deg) > 4.0:
                shown_ns.append(joint.disturbance.read_s * S)
        if not took_ns and any(fault.kind is Cause.ASTRAY for fault in player.faults):
            took_ns.append(now_ns)
        return False

    sequence = kit.sequence(3, 6.0, swing_deg=60.0, step_s=(0.5, 0.9))
    played = stage.play(robot, sequence, faults=[stuck], wishes=[(look, None)])
    assert ("j1", "astray", "hold") in faults(played)
    assert took_ns[0] - shown_ns[0] <= 0.1 * S


@pytest.mark.parametrize(
    ("fields", "outcome", "steps"),
    [
        ({"goal_tolerance_deg": 2.0}, "fault", [("j0", "astray", "hold")]),
        ({"goal_tolerance_deg": 5.5}, "finished", []),
        ({}, "finished", []),
        (
            {"goal_tolerance_deg": 2.0, "astray": (FaultStep.WARN,)},
            "finished",
            [("j0", "astray", "warn")],
        ),
    ],
)
def test_a_joint_that_is_not_at_its_goal_is_named_with_tolerance_and_distance(
    stage, kit, fields, outcome, steps
):
    fields = dict(fields)
    frames = kit.sequence(1, 2.0).keyframes
    up = replace(frames[0], deg={"j0": 5.0}, at_s=3.0, label="up")
    sequence = replace(kit.sequence(1, 2.0), keyframes=(*frames, up))
    stuck = Fault(kind=FaultKind.STUCK, servo_id=1, at_s=2.8)
    warn = dict.fromkeys((Cause.STUCK, Cause.BLOCKED), (FaultStep.WARN,))
    astray = fields.pop("astray", (FaultStep.SLOW, FaultStep.HOLD))
    robot = kit.robot(
        1, baud_bps=57600, goal_time_s=0.4, on_fault={**warn, Cause.ASTRAY: astray}, **fields
    )
    played = stage.play(robot, sequence, faults=[stuck])
    assert played.report.outcome == outcome
    assert [fault for fault in faults(played) if fault[1] == "astray"] == steps
    for fault in (fault for fault in played.report.faults if fault.kind == "astray"):
        assert re.search(
            r"is [345]\.\d deg from its goal 0.4 s after the show, allowed is 2 deg \(goal_",
            fault.cause,
        )


def test_where_the_only_step_is_a_warning_the_show_goes_on(stage, kit):
    weak = Fault(kind=FaultKind.WEAK, servo_id=1, at_s=1.5, until_s=3.0, speed_ratio=0.01)
    robot = kit.robot(following_deg=3.0, on_fault={Cause.ASTRAY: (FaultStep.WARN,)})
    played = stage.play(robot, faults=[weak])
    assert played.report.outcome == "finished"
    assert faults(played) == [("j0", "astray", "warn")]
    assert played.report.played_s == 6.0
    assert phases(played).count("playing") == 1


def test_a_blocked_joint_goes_limp_alone_where_its_step_is_limp(stage, kit):
    robot = kit.robot()
    limp = dict.fromkeys((Cause.STUCK, Cause.BLOCKED), (FaultStep.LIMP,))
    robot = replace(
        robot, joints={**robot.joints, "j2": replace(robot.joints["j2"], on_fault=limp)}
    )
    played = stage.play(robot, faults=[Fault(kind=FaultKind.STUCK, servo_id=3, at_s=2.0)])
    assert played.report.outcome == "fault"
    assert "limp" in [step for _, _, step in faults(played)]
    lines = played.lines()
    let_go = lines.index(b"#3L\r")
    assert not any(line.startswith(b"#3D") for line in lines[let_go:])
    assert any(line.startswith(b"#1D") for line in lines[let_go:]), "the others brake on their way"
    assert lines[-2:] == [HOLD, b"#3L\r"], "and it stays so"


def test_a_joint_that_is_silent_may_be_left_out_of_the_show(stage, kit):
    warn = dict.fromkeys((Cause.SILENT, Cause.RESTARTED), (FaultStep.WARN,))
    robot = kit.robot(on_fault=warn)
    reset = Fault(kind=FaultKind.RESET, servo_id=2, at_s=2.0)
    played = stage.play(robot, faults=[reset])
    assert played.report.outcome == "finished"
    assert ("j1", "silent", "warn") in faults(played)
    after = played.lines(after_ns=int((2.0 + RESET_S) * S))
    assert not any(line.startswith(b"#2D") for line in after)
    assert any(line.startswith(b"#1D") for line in after)
    assert [e.text for e in played.events if isinstance(e, Warned)] == [
        "joint 'j1' is sent no move until it is back and has its settings again "
        "(`on_fault`: `restarted: resume`)"
    ]


@pytest.mark.parametrize("kind", [FaultKind.RESET, FaultKind.DEAF])
def test_one_that_was_left_out_is_taken_up_again_when_it_answers(stage, kit, kind):
    sequence = kit.sequence(3, 9.0, swing_deg=30.0, step_s=(0.5, 0.9))
    robot = kit.robot(on_fault={Cause.SILENT: (FaultStep.WARN,)})
    gone = Fault(kind=kind, servo_id=2, at_s=2.0, until_s=4.0)
    played = stage.play(robot, sequence, faults=[gone])
    assert played.report.outcome == "finished"
    assert ("j1", "silent", "warn") in faults(played)
    assert phases(played).count("playing") == 2
    after = [line for line in played.lines(after_ns=int(3.5 * S)) if line.startswith(b"#2")]
    moved = next(at for at, line in enumerate(after) if is_move(line))
    assert any(line.startswith(b"#2QSD") for line in after[:moved]), "it has its settings first"
    horn_deg = played.bus.horn_deg(np.array([played.bus.lines[-1][0]]))[0, 1]
    assert horn_deg == pytest.approx(sequence.keyframes[-1].deg["j1"], abs=1.5)


def test_after_the_warning_comes_the_next_step_for_one_that_stays_silent(stage, kit):
    robot = kit.robot(on_fault={Cause.SILENT: (FaultStep.WARN, FaultStep.HOLD)})
    played = stage.play(robot, faults=[Fault(kind=FaultKind.DEAF, servo_id=2, at_s=2.0)])
    assert (played.report.outcome, faults(played)) == ("fault", [("j1", "silent", "hold")])
    assert played.lines()[-1] == HOLD


@pytest.mark.parametrize(
    ("steps", "outcome"), [((FaultStep.WARN,), "finished"), ((FaultStep.HOLD,), "fault")]
)
def test_heat_does_what_the_file_says(stage, kit, steps, outcome):
    robot = kit.robot(temperature_max_c=50.0, on_fault={Cause.HOT: steps})
    hot = Fault(kind=FaultKind.HOT, servo_id=2, at_s=2.0, temperature_c=70.0)
    played = stage.play(robot, faults=[hot])
    assert played.report.outcome == outcome
    assert faults(played) == [("j1", "hot", steps[0].value)]


def test_a_stop_while_it_waits_is_heeded(stage, kit):
    robot = kit.robot(resume_s=60.0)
    deaf = Fault(kind=FaultKind.DEAF, servo_id=2, at_s=2.5)
    played = stage.play(robot, faults=[deaf], wishes=[(kit.in_phase("recovering", 6.0), kit.stop)])
    assert played.report.outcome == "stopped"
    assert played.report.run_s < 7.0
    assert played.lines()[-1] == HOLD
    assert b"#1SD3600\r" in played.lines()[-30:]


def test_a_pause_that_is_set_during_recovery_is_kept(stage, kit):
    reset = Fault(kind=FaultKind.RESET, servo_id=2, at_s=2.5)

    def paused(player, now_ns):
        return player.phase == "playing" and now_ns > 12 * S

    played = stage.play(
        faults=[reset],
        wishes=[(kit.in_phase("recovering"), kit.rate(0.0)), (paused, kit.rate(1.0))],
    )
    assert played.report.outcome == "finished"
    assert at_rest(played, 8 * S, 12 * S) < 0.3
    assert played.report.run_s > 12.0 + 2.0


def test_a_start_that_is_never_reached_is_named(stage, kit):
    stuck = Fault(kind=FaultKind.STUCK, servo_id=3)
    robot = kit.robot(
        on_fault={cause: (FaultStep.WARN,) for cause in Cause if cause.value != "lost_port"}
    )
    played = stage.play(robot, faults=[stuck], start_deg={"j2": 60.0})
    assert played.report.outcome == "fault"
    assert "deg from where the show begins after 3 approaches" in str(played.report.faults)
    assert played.result.player.show is None


def test_an_approach_that_was_lost_on_the_line_is_repeated(stage, kit):
    lost = Fault(kind=FaultKind.LOST_COMMAND, at_s=0.3, until_s=1.2, ratio=0.5)
    for seed in range(4):
        played = stage.play(
            faults=[lost], start_deg={"j0": 60.0, "j1": -60.0, "j2": 60.0}, seed=seed
        )
        assert played.report.outcome == "finished"
        assert np.abs(played.horn_error_deg(from_s=0.0)[:20]).max() < 4.0


def test_a_show_goes_on_with_settings_sent_again_when_a_port_comes_back(stage, kit):
    gone = Fault(kind=FaultKind.UNPLUGGED, at_s=2.0, until_s=5.0)
    played = stage.play(faults=[gone])
    assert played.report.outcome == "finished"
    assert faults(played) == [("", "lost_port", "resume")]
    after = played.lines(after_ns=5 * S)
    first = next(i for i, line in enumerate(after) if is_move(line))
    assert {b"#1AA60\r", b"#2SD1800\r", b"#3EM1\r"} <= set(after[:first])
    assert played.lines()[-1] == HOLD
    assert np.abs(played.horn_error_deg(from_s=2.5)).max() < 1.0
    _, accel = played.speeds(5 * S, played.bus.lines[-1][0])
    assert np.abs(accel).max() <= 1.1 * 600.0


def test_without_feedback_the_fault_of_a_port_ends_with_the_recovery(stage, kit):
    """Virtual time stood still for ever when patience ended in the approach."""
    gone = Fault(kind=FaultKind.UNPLUGGED, at_s=2.0, until_s=3.0)
    robot = kit.robot(1, patience_s=1.5)
    played = stage.play(robot, kit.sequence(1, 3.0), faults=[gone], has_feedback=False)
    assert played.report.outcome == "finished"
    assert faults(played) == [("", "lost_port", "resume")]


def test_a_port_that_is_back_while_the_robot_brakes_gets_no_move_before_its_settings(stage, kit):
    gone = Fault(kind=FaultKind.UNPLUGGED, at_s=2.0, until_s=2.15)
    sequence = kit.sequence(3, 3.5, swing_deg=50.0, step_s=(0.5, 0.9))
    played = stage.play(sequence=sequence, faults=[gone])
    assert played.report.outcome == "finished"
    after = played.lines(after_ns=int(2.15 * S))
    for servo in (b"#1", b"#2", b"#3"):
        received = [line for line in after if line.startswith(servo)]
        first = next(i for i, line in enumerate(received) if line.startswith(servo + b"D"))
        assert {servo + b"AA60\r", servo + b"SD1800\r"} <= set(received[:first])


def test_when_one_of_two_ports_stays_away_the_other_is_restored_and_holds(stage, kit):
    robot = kit.robot(4, buses=2, resume_s=2.0)
    gone = Fault(kind=FaultKind.UNPLUGGED, at_s=2.0, bus="bus1")
    played = stage.play(robot, faults=[gone])
    assert played.report.outcome == "lost"
    assert isinstance(played.result.error, BusError)
    assert "and was not back after 2 s" in str(played.result.error)
    assert faults(played) == [("", "lost_port", "hold")]
    lines = [line for _, line in played.buses["bus0"].lines]
    assert lines[-1] == HOLD
    assert {b"#1SD3600\r", b"#3SD3600\r"} <= set(lines[-17:])
    assert played.report.run_s < 5.0


def test_where_a_lost_port_is_not_waited_for_it_ends_at_once(stage, kit):
    robot = kit.robot(on_fault={Cause.LOST_PORT: (FaultStep.HOLD,)})
    played = stage.play(robot, faults=[Fault(kind=FaultKind.UNPLUGGED, at_s=2.0, until_s=2.5)])
    assert played.report.outcome == "lost"
    assert "lost port" in str(played.result.error)
    assert played.report.run_s < 2.1


FULL_STOP_S = 0.7
"""A blocked port is lost after 0.5 s without a byte, and the line time of what waits."""


def blocked(at_s, until_s=float("inf"), **fields):
    return Fault(kind=FaultKind.BLOCKED_PORT, at_s=at_s, until_s=until_s, **fields)


def test_a_port_that_takes_no_bytes_for_a_moment_is_waited_for(stage, kit):
    played = stage.play(faults=[blocked(2.0, 2.3)])
    assert (played.report.outcome, faults(played)) == ("finished", [])
    _, accel = played.speeds(2 * S, played.bus.lines[-1][0])
    assert np.abs(accel).max() <= 1.1 * 600.0


def test_a_show_goes_on_when_a_blocked_port_takes_bytes_again(stage, kit):
    """The port stays there, and each second of waiting for it would be another lost port."""
    played = stage.play(faults=[blocked(2.0, 7.0)])
    assert played.report.outcome == "finished"
    assert faults(played) == [("", "lost_port", "resume")]
    assert sum(getattr(event, "kind", None) == "lost_port" for event in played.events) == 1
    after = [line for line in played.lines(after_ns=int(7.01 * S)) if line != b"#\r"]
    first = next(i for i, line in enumerate(after) if is_move(line))
    assert {b"#1AA60\r", b"#2SD1800\r", b"#3EM1\r"} <= set(after[:first])
    assert played.lines()[-1] == HOLD
    _, accel = played.speeds(0, played.bus.lines[-1][0])
    assert np.abs(accel).max() <= 1.1 * 600.0


def test_a_port_that_stays_blocked_is_given_up_like_one_that_is_gone(stage, kit):
    robot = kit.robot(4, buses=2, resume_s=2.0)
    played = stage.play(robot, faults=[blocked(2.0, bus="bus1")])
    assert played.report.outcome == "lost"
    assert "takes no bytes" in str(played.result.error)
    assert "and was not back after 2 s" in str(played.result.error)
    assert [line for _, line in played.buses["bus0"].lines][-1] == HOLD
    assert played.report.run_s < 2.0 + FULL_STOP_S + 2.0 + 2 * FULL_STOP_S


@pytest.mark.parametrize("at_s", [0.0, 0.004, 0.02, 0.1, 0.4, 0.8, 1.2])
def test_a_port_that_takes_no_bytes_before_the_show_ends_it_within_a_bound(stage, kit, at_s):
    robot = kit.robot(resume_s=2.0)
    played = stage.play(robot, faults=[blocked(at_s)], start_deg={"j0": 20.0})
    assert played.report.outcome in ("lost", "stopped", "fault")
    assert isinstance(played.result.error, LostPortError)
    assert played.report.run_s < at_s + FULL_STOP_S + 2.0 + 2 * FULL_STOP_S


@pytest.mark.parametrize("stops", [1, 2, 3])
@pytest.mark.parametrize("stop_s", [2.1, 2.4, 3.5])
def test_a_run_whose_port_is_blocked_can_be_ended(stage, kit, stops, stop_s):
    wish = (kit.in_phase("playing", stop_s), kit.stop), *[(lambda *_: True, kit.stop)] * (stops - 1)
    if stop_s > 3.0:
        wish = (kit.in_phase("recovering", stop_s), kit.stop), *wish[1:]
    played = stage.play(faults=[blocked(2.0)], wishes=wish)
    assert len(played.acted_ns) == stops
    assert played.report.run_s < stop_s + 3.0
    assert isinstance(played.result.error, LostPortError)


def test_the_safe_state_is_the_last_that_a_port_gets_that_was_blocked_when_it_was_ended(stage, kit):
    wishes = [(kit.in_phase("playing", 2.1), kit.stop), (lambda *_: True, kit.stop)]
    played = stage.play(faults=[blocked(2.0, 2.4)], wishes=wishes)
    assert played.report.outcome == "stopped"
    assert played.result.error is None
    assert played.lines()[-1] == HOLD
