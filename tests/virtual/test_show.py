"""Whole shows in virtual time: what the servos received, and where the horns were."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import BusError, InputError, PlaybackError
from lss_motion.playing.player.events import MarkPassed, PhaseEntered, Warned
from lss_motion.playing.player.session import COUNT_IN_NS
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim import bus as sim_bus
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import Physics
from tests.timed_moves import MOVE, is_move

QUIET = Physics(noise_deg=0.0)
HOLD, LIMP = b"#254H\r", b"#254L\r"
FAST_BPS = 57600
RESTORED = {b"#%dEM1\r", b"#%dAA100\r", b"#%dAD100\r", b"#%dSD3600\r"}
"""What an LSS-ST1 from the factory is set to (FACTS.md M20; top speed 360 deg/s: E1)."""


def assert_ended_safely(played, robot, safe=HOLD):
    """Every session setting as it was, then the safe state, and nothing after it."""
    for name, bus in played.buses.items():
        lines = [line for _, line in bus.lines]
        assert lines[-1] == safe
        ids = [joint.servo_id for joint in robot.joints.values() if joint.bus == name]
        restored = {line % servo_id for servo_id in ids for line in RESTORED}
        assert restored <= set(lines[-1 - len(restored) : -1])


# ---- the plain show


def test_the_moves_of_a_show_arrive_on_time_and_the_horns_make_them(stage, kit):
    played = stage.play()
    assert played.report.outcome == "finished"
    assert played.report.timing.missed == 0
    assert np.sqrt(np.mean(played.horn_error_deg() ** 2)) < 0.25
    assert np.abs(played.horn_error_deg()).max() < 0.8
    assert played.report.timing.commands > 30
    assert played.report.buses["bus0"].replies > 400
    assert played.report.buses["bus0"].garbage == 0


@pytest.mark.parametrize("act", ["nothing", "stop", "pause"])
def test_a_show_is_counted_in_and_may_be_stopped_meanwhile(stage, kit, act):
    """Making it ready takes a real host time; nothing may be due then.

    Without noise: a stop corrects what a reading is off.
    """
    begun_ns = []

    def in_count_in(player, now_ns):
        if player.phase == "playing" and not begun_ns:
            begun_ns.append(player.show.clock.instant_ns(0.0) - COUNT_IN_NS)
        return bool(begun_ns) and now_ns > begun_ns[0] + COUNT_IN_NS // 2

    robot = kit.robot(baud_bps=FAST_BPS)
    wishes = {
        "nothing": [(in_count_in, lambda player, now_ns: None)],
        "stop": [(in_count_in, kit.stop)],
        "pause": [(in_count_in, kit.rate(0.0)), (stands, kit.rate(1.0))],
    }[act]
    played = stage.play(robot, wishes=wishes, physics=Physics(noise_deg=0.0))
    moved = [at_ns for at_ns, line in played.bus.lines if is_move(line)]
    show = [at_ns for at_ns in moved if at_ns > begun_ns[0]]
    assert_ended_safely(played, robot)
    assert show == [] if act == "stop" else show[0] >= begun_ns[0] + COUNT_IN_NS
    assert played.report.outcome == ("stopped" if act == "stop" else "finished")
    assert np.abs(played.horn_error_deg()).max() < 0.8


def test_without_feedback_the_same_moves_arrive_and_no_query_in_the_show(stage, kit):
    played = stage.play(has_feedback=False)
    assert np.abs(played.horn_error_deg()).max() < 0.8
    moves = [at_ns for at_ns, line in played.bus.lines if is_move(line)]
    asked = [at_ns for at_ns, line in played.bus.lines if b"Q" in line]
    assert asked
    assert max(asked) < min(moves)


def test_the_session_is_set_before_the_first_move_and_restored_after_the_last(stage, kit):
    robot = kit.robot(settings={"AS": -2})
    played = stage.play(robot)
    lines = played.lines()
    first = next(i for i, line in enumerate(lines) if line in played.moves())
    for servo_id in (1, 2, 3):
        wanted = [b"#%dEM1\r", b"#%dAA72\r", b"#%dAD72\r", b"#%dSD1800\r", b"#%dAS-2\r"]
        assert {line % servo_id for line in wanted} <= set(lines[:first])
        assert b"#%dAS0\r" % servo_id in lines[-20:]
    assert lines[-1] == HOLD


def test_a_robot_that_should_end_limp_does_and_only_after_a_show_that_finished(stage, kit):
    robot = kit.robot(end="limp")
    assert_ended_safely(stage.play(robot), robot, LIMP)
    stopped = stage.play(robot, wishes=[(kit.in_show(1.0), kit.stop)])
    assert_ended_safely(stopped, robot, HOLD)


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not(stage, kit):
    runs = [stage.play(seed=seed) for seed in (7, 7, 8)]
    assert runs[0].sent == runs[1].sent
    assert runs[0].bus.lines == runs[1].bus.lines
    assert runs[0].report == runs[1].report
    assert runs[0].sent != runs[2].sent


def test_two_buses_are_played_side_by_side(stage, kit):
    robot = kit.robot(4, buses=2)
    played = stage.play(robot)
    assert np.abs(played.horn_error_deg()).max() < 0.8
    assert_ended_safely(played, robot)
    for bus, own in (("bus0", b"13"), ("bus1", b"24")):
        said = {line[1:2] for _, line in played.buses[bus].lines if is_move(line)}
        assert said == {bytes([digit]) for digit in own}


def test_the_approach_is_slow_and_ends_where_the_show_starts(stage, kit):
    played = stage.play(start_deg={"j0": 80.0, "j1": -60.0}, physics=QUIET)
    entered = [event.phase for event in played.events if isinstance(event, PhaseEntered)]
    assert entered == [
        "connecting", "preparing", "approaching", "playing", "restoring", "done",
    ]  # fmt: skip
    first_ns = next(at for at, line in played.bus.lines if line in played.moves())
    speed, _ = played.speeds(first_ns, first_ns + 2_500_000_000)
    assert 29.0 < np.abs(speed).max() < 30.5
    assert np.abs(played.horn_error_deg()[:10]).max() < 0.2


def test_a_correction_does_not_make_an_approach_faster(stage, kit, monkeypatch):
    """A servo that restarts under load is limp; its way back is its plan's and the correction."""
    robot = replace(kit.robot(), approach_speed_deg_s=5.0)
    reset = Fault(kind=FaultKind.RESET, servo_id=1, at_s=3.0)
    back = (kit.in_phase("approaching", after_s=3.0), lambda *_: None)
    again = (kit.in_phase("playing", after_s=3.1), lambda *_: None)
    loaded = partial(sim_bus.bus_from_robot, droop_deg={"j0": 2.8})
    monkeypatch.setattr(sim_bus, "bus_from_robot", loaded)
    played = stage.play(robot, faults=[reset], physics=QUIET, wishes=[back, again])
    from_ns, to_ns = played.acted_ns
    moves = [
        (at_ns, *map(int, MOVE.fullmatch(line).groups()))
        for at_ns, line in played.bus.lines
        if is_move(line) and line.startswith(b"#1D") and from_ns < at_ns < to_ns
    ]
    assert moves
    at_ns, _, wire, duration_ms = moves[0]
    way_deg = abs(wire / 10.0 - played.bus.horn_deg([at_ns])[0, 0])
    assert way_deg > 2.0
    assert way_deg * 1000.0 / duration_ms <= 5.1


def test_marks_are_passed_once_each_in_order(stage, kit):
    sequence = kit.sequence()
    played = stage.play(sequence=sequence)
    passed = [event.label for event in played.events if isinstance(event, MarkPassed)]
    assert passed == [keyframe.label for keyframe in sequence.keyframes]


def test_a_show_with_eighteen_joints_fits_the_line_and_the_horns(stage, kit):
    robot, show_s = kit.robot(18, baud_bps=FAST_BPS), 20.0
    played = stage.play(robot, kit.sequence(18, show_s, step_s=(0.8, 1.6)))
    assert played.report.outcome == "finished"
    assert played.report.timing.missed == 0
    assert played.report.timing.commands > 50 * show_s
    assert played.report.buses["bus0"].query_rate_hz > 300
    assert np.sqrt(np.mean(played.horn_error_deg() ** 2)) < 0.3
    assert_ended_safely(played, robot)


# ---- refused before anything moves


def assert_nothing_moved(played):
    assert played.moves() == []
    assert not any(b"H\r" in line or b"EM1" in line for line in played.lines())
    assert played.lines()[-1].startswith(b"#"), "something was sent"
    assert played.result.truth is None or not len(played.result.truth.times_s)


def test_a_missing_servo_is_named_and_nothing_moves(stage, kit):
    robot = kit.robot(3)
    wired = replace(robot, joints={n: j for n, j in robot.joints.items() if n != "j1"})
    program, _ = stage.compile(robot, kit.sequence(3))
    played = stage.play(robot, program=program, wired=wired)
    assert isinstance(played.result.error, BusError)
    assert "j1 (id 2 on bus 'bus0')" in str(played.result.error)
    assert "1 of 3" in str(played.result.error)
    assert_nothing_moved(played)


def test_a_servo_of_another_model_is_refused(stage, kit):
    robot = kit.robot(3)
    other = replace(robot.joints["j2"], model=SERVO_MODELS["LSS-HS1"])
    played = stage.play(robot, wired=replace(robot, joints={**robot.joints, "j2": other}))
    assert isinstance(played.result.error, InputError)
    said = str(played.result.error)
    assert "joint 'j2': servo 3 is an LSS-HS1, the robot file says LSS-ST1" in said
    assert "write `model: LSS-HS1` there" in said
    assert_nothing_moved(played)


def test_a_servo_in_safe_mode_is_refused(stage, kit):
    hot = Fault(kind=FaultKind.HOT, servo_id=2, temperature_c=95.0)
    played = stage.play(faults=[hot])
    assert isinstance(played.result.error, PlaybackError)
    assert "'j1': servo 2 reports safe mode" in str(played.result.error)
    assert_nothing_moved(played)


@pytest.mark.parametrize(
    ("keyword", "wire", "said"),
    [
        ("SD", 900, "requires 180 deg/s, but servo 2 is set to 90 deg/s (SD)"),
        ("AA", 30, "requires 600 deg/s², but servo 2 is set to 300 deg/s² (AA)"),
        ("AD", 59, "requires 600 deg/s², but servo 2 is set to 590 deg/s² (AD)"),
    ],
)
def test_a_servo_that_is_set_to_less_than_the_file_asks_is_refused(stage, kit, keyword, wire, said):
    def lower(bus):
        bus._servos[1].settings.session[keyword] = wire

    played = stage.play(on_bus=lower)
    assert isinstance(played.result.error, InputError)
    assert said in str(played.result.error)
    assert_nothing_moved(played)


def test_a_servo_that_is_too_old_to_be_streamed_is_named_with_its_firmware(stage, kit):
    robot = kit.robot(drive="streamed")
    old = replace(robot, buses={"bus0": replace(robot.buses["bus0"], firmware=362)})
    played = stage.play(robot, wired=old)
    assert isinstance(played.result.error, InputError)
    assert "servo 1 has firmware 362" in str(played.result.error)
    assert "firmware 368 or later" in str(played.result.error)
    assert_nothing_moved(played)


def test_a_delay_of_a_busy_computer_is_no_stall(stage, kit):
    sleep = Fault(kind=FaultKind.OVERSLEEP, at_s=4.0, until_s=4.05, late_s=0.1)
    played = stage.play(kit.robot(1), kit.sequence(1), faults=[sleep])
    assert played.report.outcome == "finished"
    assert not played.report.faults
    assert not played.report.warnings


def test_other_firmware_is_a_warning(stage, kit):
    robot = kit.robot()
    said = replace(robot.buses["bus0"], firmware=368)
    played = stage.play(replace(robot, buses={"bus0": said}), wired=robot)
    warnings = [event.text for event in played.events if isinstance(event, Warned)]
    assert len(warnings) == 3
    assert "servo 1 has firmware 370, the robot file says 368" in warnings[0]
    assert played.report.outcome == "finished"


def test_stopped_before_the_approach_nothing_ever_moves(stage, kit):
    played = stage.play(wishes=[(kit.in_phase("connecting", 0.01), kit.stop)])
    assert played.report.outcome == "stopped"
    assert_nothing_moved(played)


def test_stopped_while_settings_are_sent_they_are_given_back(stage, kit):
    def has_said(player, now_ns):
        return player.phase == "preparing" and player.lines["bus0"].sent_bytes > said[0]

    def count(player, now_ns):
        said.append(player.lines["bus0"].sent_bytes)

    said = [0]
    robot = kit.robot(settings={"AS": -2})
    complete = stage.play(robot)
    lines = complete.lines()
    position = lines.index(b"#1AS-2\r")
    said[0] = sum(map(len, lines[: position + 1]))
    played = stage.play(robot, wishes=[(has_said, count), (has_said, kit.stop)])
    assert b"#1AS-2\r" in played.lines()
    assert played.moves() == []
    assert b"#1AS0\r" in played.lines()[played.lines().index(b"#1AS-2\r") :]


# ---- stopping


@pytest.mark.parametrize("seed", range(8))
def test_stopped_anywhere_it_brakes_within_the_limits_and_ends_safely(stage, kit, seed):
    random = np.random.default_rng(seed)
    robot = kit.robot(4)
    sequence = kit.sequence(4, 6.0, seed=seed, swing_deg=60.0, step_s=(0.5, 1.2))
    stop_s = float(random.uniform(0.05, 5.9))
    played = stage.play(
        robot,
        sequence,
        wishes=[(kit.in_show(stop_s), kit.stop)],
        physics=QUIET,
        has_feedback=bool(seed % 2),
    )
    assert played.report.outcome == "stopped"
    assert_ended_safely(played, robot)
    end_ns = played.bus.lines[-1][0]
    (stopped_ns,) = played.acted_ns
    assert end_ns - stopped_ns < 1_500_000_000
    speed, accel = played.speeds(stopped_ns - 200_000_000, end_ns)
    assert np.abs(speed).max() <= 1.05 * 180.0
    assert np.abs(accel).max() <= 1.05 * 600.0
    assert np.abs(speed[-3:]).max() < 1.0, "it stands before it is told to hold"
    assert np.abs(played.horn_error_deg()).max() < 3.0, "it brakes on its path"


def test_stopped_in_the_approach_it_brakes_too(stage, kit):
    robot = kit.robot()
    played = stage.play(
        robot,
        start_deg={"j0": 80.0},
        wishes=[(kit.in_phase("approaching", 1.2), kit.stop)],
        physics=QUIET,
    )
    assert_ended_safely(played, robot)
    speed, accel = played.speeds(played.acted_ns[0] - 100_000_000, played.bus.lines[-1][0])
    assert np.abs(speed[0]).max() == pytest.approx(30.0, abs=0.5)
    assert np.abs(speed[-3:]).max() < 1.0
    assert np.abs(accel).max() <= 1.05 * 600.0


def test_a_second_stop_holds_at_once(stage, kit):
    later = []

    def after_first(player, now_ns):
        return player.phase == "stopping" and now_ns >= played_ns(player) + 50_000_000

    def played_ns(player):
        return player.show.clock.ramp_end_ns - 300_000_000

    def again(player, now_ns):
        later.append(now_ns)
        player.stop(now_ns)

    robot = kit.robot(baud_bps=FAST_BPS)
    played = stage.play(robot, wishes=[(kit.in_show(2.0), kit.stop), (after_first, again)])
    assert played.report.outcome == "stopped"
    at_ns, line = played.bus.lines[-1]
    assert line == HOLD
    assert at_ns - later[0] < 10_000_000


# ---- pausing, and other speeds


@pytest.mark.parametrize("seed", range(4))
def test_at_any_speed_and_through_pauses_the_horns_stay_on_their_path(stage, kit, seed):
    random = np.random.default_rng(seed)
    instants_s = np.sort(random.uniform(0.2, 7.0, 4))
    wishes = []
    for instant_s in instants_s:
        wishes.append((kit.in_show(float(instant_s)), kit.rate(float(random.uniform(0.0, 1.0)))))
        if random.random() < 0.5:
            wishes.append((kit.in_show(float(instant_s)), kit.rate(0.0)))
            wishes.append((stands, kit.rate(float(random.uniform(0.2, 1.0)))))
    wishes.append((stands_or(7.2, kit), kit.rate(1.0)))
    sequence = kit.sequence(3, 8.0, seed=seed, swing_deg=45.0, step_s=(0.5, 1.2))
    played = stage.play(sequence=sequence, wishes=wishes, has_feedback=seed != 0)
    assert played.report.outcome == "finished"
    assert len(played.acted_ns) == len(wishes)
    assert np.abs(played.horn_error_deg()).max() < 2.0
    assert np.sqrt(np.mean(played.horn_error_deg() ** 2)) < 0.4


def stands(player, now_ns):
    """The rate has been 0 for a second."""
    clock = player.show.clock
    return clock.target_rate == 0.0 and now_ns > clock.ramp_end_ns + 1_000_000_000


def stands_or(show_s, kit):
    return lambda player, now_ns: stands(player, now_ns) or kit.in_show(show_s)(player, now_ns)


def test_a_steady_lower_speed_leaves_the_path_no_more_than_full_speed(stage, kit):
    sequence = kit.sequence(3, 6.0, swing_deg=45.0, step_s=(0.5, 1.2))
    played = stage.play(sequence=sequence, wishes=[(kit.in_show(0.3), kit.rate(0.5))])
    assert played.report.run_s > 11.0
    in_approach = len(sequence.keyframes[0].deg)
    assert played.report.timing.commands == len(played.moves()) - in_approach
    assert np.abs(played.horn_error_deg(from_s=1.0)).max() < 1.0


def test_a_long_pause_is_silent_and_keeps_the_place(stage, kit):
    def paused_long(player, now_ns):
        return stands(player, now_ns) and now_ns > player.show.clock.ramp_end_ns + 20_000_000_000

    played = stage.play(
        has_feedback=False,
        wishes=[(kit.in_show(2.0), kit.rate(0.0)), (paused_long, kit.rate(1.0))],
        physics=QUIET,
    )
    from_ns, to_ns = played.acted_ns
    assert to_ns - from_ns > 20_000_000_000
    inside = [a for a, _ in played.bus.lines if from_ns + 1_500_000_000 < a < to_ns]
    assert inside == []
    speed, _ = played.speeds(from_ns + 1_500_000_000, to_ns)
    assert np.abs(speed).max() < 0.01
    assert played.report.outcome == "finished"


def test_from_a_later_time_it_starts_in_the_pose_of_that_time(stage, kit):
    sequence = kit.sequence()
    played = stage.play(sequence=sequence, start_s=2.5)
    begun = played.result.player.show.clock
    assert begun.show_s(begun.ramp_end_ns) >= 2.5
    error_deg = played.horn_error_deg(from_s=2.55)
    assert np.abs(error_deg).max() < 1.5
    assert played.report.outcome == "finished"
    passed = [event.label for event in played.events if isinstance(event, MarkPassed)]
    later = [k.label for k in sequence.keyframes if k.at_s >= 2.5]
    assert passed == later


def test_a_loop_without_end_goes_on_until_it_is_stopped(stage, kit):
    robot = kit.robot()
    sequence = kit.sequence(3, 4.0, loop=None)
    played = stage.play(robot, sequence, wishes=[(kit.in_show(30.0), kit.stop)])
    assert played.report.outcome == "stopped"
    assert played.report.planned_s is None
    assert 30.0 <= played.report.played_s < 31.0
    assert np.abs(played.horn_error_deg()).max() < 1.0
    assert_ended_safely(played, robot)


# ---- what goes wrong on the way


@pytest.mark.parametrize(
    "fault",
    [
        Fault(kind=FaultKind.LOST_REPLY, ratio=0.3),
        Fault(kind=FaultKind.LATE_REPLY, ratio=0.3, late_s=0.06, at_s=0.2),
        Fault(kind=FaultKind.DOUBLE_REPLY, ratio=0.3),
        Fault(kind=FaultKind.CORRUPT_REPLY, ratio=0.1, at_s=0.2),
    ],
    ids=lambda fault: fault.kind.value,
)
def test_bad_replies_disturb_no_horn(stage, kit, fault):
    played = stage.play(kit.robot(baud_bps=FAST_BPS), faults=[fault])
    assert played.report.outcome == "finished"
    assert np.abs(played.horn_error_deg()).max() < 1.5
    bus = played.report.buses["bus0"]
    assert bus.timeouts + bus.garbage + bus.rejected > 10


def test_an_exception_on_the_way_leaves_every_bus_in_the_safe_state(stage, kit):
    robot = kit.robot(4, buses=2)
    buses = []

    def fail(event):
        if isinstance(event, MarkPassed) and event.label.startswith("at"):
            raise RuntimeError("the display broke")

    with pytest.raises(RuntimeError, match="the display broke"):
        stage.play(robot, on_bus=buses.append, on_event=fail)
    assert len(buses) == 2
    for bus in buses:
        assert bus.lines[-1][1] == HOLD
        assert sum(is_move(line) for _, line in bus.lines) > 5


# ---- what refuses a robot before it moves


@pytest.mark.parametrize("settings", [{"G": -1}, {"O": 50}, {"G": -1, "O": 50}, {"AR": 3600}])
def test_a_servo_that_is_not_set_up_as_the_file_states_never_moves(stage, kit, settings):
    """Its angles mean other places: the show would play mirrored, or turned."""
    stored = Fault(kind=FaultKind.STORED, servo_id=2, settings=settings)
    played = stage.play(faults=[stored])
    assert isinstance(played.result.error, InputError)
    assert "joint 'j1': servo 2 has" in str(played.result.error)
    assert played.moves() == []
    assert set(played.lines()) - {HOLD} == {line for line in played.lines() if b"Q" in line}


def test_two_servos_with_one_id_never_move(stage, kit):
    played = stage.play(faults=[Fault(kind=FaultKind.TWIN, servo_id=2)])
    assert isinstance(played.result.error, BusError)
    assert "several servos" in str(played.result.error)
    assert played.moves() == []


def test_what_the_check_shows_is_judged_before_anything_moves(stage, kit):
    robot = kit.robot(voltage_min_v=13.0)
    warned = stage.play(robot)
    texts = [event.text for event in warned.events if isinstance(event, Warned)]
    assert "12.0 V, needed are 13 V" in texts[0]
    order = [type(event).__name__ for event in warned.events]
    assert order.index("Warned") < order.index("Checked")
    held = stage.play(replace(robot, on_fault={Cause.LOW_VOLTAGE: (FaultStep.HOLD,)}))
    assert isinstance(held.result.error, PlaybackError)
    assert held.moves() == []


def test_a_supply_that_is_too_low_from_the_start_is_noticed_before_motion(stage, kit):
    low = Fault(kind=FaultKind.LOW_VOLTAGE, supply_v=6.5)
    robot = replace(kit.robot(voltage_min_v=7.0), on_fault={Cause.LOW_VOLTAGE: (FaultStep.HOLD,)})
    played = stage.play(robot, faults=[low])
    assert "needed are 7 V" in str(played.result.error)
    assert played.moves() == []
