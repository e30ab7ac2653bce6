from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError, LineLoadError
from lss_motion.planning.program.compile import PREROLL_S, compile_program
from lss_motion.planning.program.model import received_us
from lss_motion.planning.program.verify import profiles
from lss_motion.robot.profile import profile_lead_s, ramp_deg_s2
from lss_motion.show.model import Timing
from lss_motion.units import line_time_ns

STEP_S = 0.001


def error_deg(program, trajectory, robot):
    """Return, per joint, how far the predicted horn is from the plan, every millisecond."""
    times_s = np.arange(-0.2, trajectory.duration_s + 0.2, STEP_S)
    planned = trajectory.sample(times_s)
    predicted = profiles(program, robot)
    errors = []
    for column, name in enumerate(trajectory.joints):
        joint = robot.joints[name]
        servo_deg = predicted[name].sample(times_s - profile_lead_s(joint))
        horn_deg = joint.direction * (servo_deg - joint.zero_deg)
        errors.append(horn_deg - planned[:, column])
    return np.array(errors)


def made(kit, sequence, *joints, **fields):
    robot = kit.robot(*joints)
    trajectory = kit.plan(sequence, robot)
    return compile_program(trajectory, robot, **fields), trajectory, robot


def test_a_trapezoid_is_one_move(kit):
    """A time-optimal move between two rests has the profile of one servo move."""
    sequence = kit.keys((0.0, {"j0": 0.0}), (2.0, {"j0": 60.0}), timing=Timing.FASTEST)
    program, trajectory, robot = made(kit, sequence)
    assert len(program.moves) == 1
    (move,) = program.moves
    assert move.target_wire == 600
    assert move.duration_ms == pytest.approx(1000.0 * 60.0 / 180.0, rel=0.04)
    assert np.abs(error_deg(program, trajectory, robot)).max() < 0.2


def test_a_slow_straight_line_is_a_few_long_moves(kit):
    sequence = kit.keys((0.0, {"j0": -80.0}), (8.0, {"j0": 80.0}))
    program, trajectory, robot = made(kit, sequence)
    assert len(program.moves) < 30
    assert np.abs(error_deg(program, trajectory, robot)).max() <= 0.201


@pytest.mark.parametrize("seed", range(3))
def test_a_time_optimal_reference_at_the_limit_of_the_ramp_is_followed(kit, seed):
    """No ramp is left there for corrections, so the error is larger than the tolerance."""
    random = np.random.default_rng(seed)
    rows = [(None, {"j0": float(deg)}) for deg in random.uniform(-80.0, 80.0, 12)]
    sequence = kit.keys(*rows, timing=Timing.FASTEST)
    program, trajectory, robot = made(kit, sequence)
    errors = error_deg(program, trajectory, robot)
    assert np.abs(errors).max() <= 1.5
    assert np.sqrt(np.mean(errors**2)) <= 0.25


def test_rests_are_reached_exactly_and_no_move_is_sent_during_them(kit):
    rows = [(0.0, {"j0": 0.0}), (1.0, {"j0": 33.333}, 1.0), (3.2, {"j0": -47.77}, 1.5)]
    program, _, robot = made(kit, kit.keys(*rows, (6.5, {"j0": 0.04})))
    plan, joint = profiles(program, robot)["j0"], robot.joints["j0"]
    for rest_s, wire in ((1.0, 333), (3.2, -478), (6.5, 0)):
        landed_s = rest_s - profile_lead_s(joint) + 0.15
        assert plan.at(landed_s) == (wire / 10, 0.0)
    received_s = np.array([received_us(move, 115200) / 1e6 for move in program.moves])
    for from_s, to_s in ((1.05, 1.9), (3.25, 4.6), (6.55, 99.0)):
        assert not np.any((received_s > from_s) & (received_s < to_s))
    assert len(received_s) > 6


def test_a_joint_that_does_not_move_is_sent_no_moves(kit):
    sequence = kit.keys((0.0, {"j0": 10.0, "j1": 0.0}), (2.0, {"j0": 10.0, "j1": 40.0}))
    program, _, _ = made(kit, sequence, kit.joint(), kit.joint("j1", 2))
    assert {move.servo_id for move in program.moves} == {2}
    assert program.start_deg == {"j0": 10.0, "j1": 0.0}


def test_targets_ahead_of_the_reference_stay_inside_the_range(kit):
    rows = [(0.7 * step, {"j0": 90.0 if step % 2 else -90.0}) for step in range(8)]
    program, _, _ = made(kit, kit.keys(*rows))
    wires = [move.target_wire for move in program.moves]
    assert len(wires) > 20
    assert min(wires) == -900
    assert max(wires) == 900


def test_rounding_never_leaves_a_range_that_ends_between_two_wire_values(kit):
    narrow = kit.joint(position_min_deg=-12.37, position_max_deg=12.37)
    sequence = kit.keys((0.0, {"j0": -12.37}), (1.0, {"j0": 12.37}), (2.0, {"j0": -12.37}))
    program, _, _ = made(kit, sequence, narrow)
    assert {
        min(m.target_wire for m in program.moves),
        max(m.target_wire for m in program.moves),
    } == {-123, 123}


def test_no_move_exceeds_the_speed_limit(kit):
    program, _, robot = made(kit, kit.lively(["j0"], 12.0, swing_deg=85.0))
    plan = profiles(program, robot)["j0"]
    for move in program.moves:
        start_deg, _ = plan.at(received_us(move, 115200) / 1e6 - 1e-9)
        commanded_deg_s = abs(move.target_wire / 10 - start_deg) / (move.duration_ms / 1e3)
        assert commanded_deg_s <= 180.0 + 1e-3


def test_direction_and_zero_are_respected(kit):
    mirrored = kit.joint(direction=-1, zero_deg=12.5)
    sequence = kit.keys((0.0, {"j0": 0.0}), (1.0, {"j0": 30.0}))
    program, trajectory, robot = made(kit, sequence, mirrored)
    assert program.moves[-1].target_wire == 125 - 300
    assert all(-900 + 125 <= move.target_wire <= 900 + 125 for move in program.moves)
    assert np.abs(error_deg(program, trajectory, robot)).max() <= 0.201


def test_lss_pro_joints_are_sent_hundredths_of_a_degree(kit):
    from lss_motion.robot.servo_models import SERVO_MODELS

    pro = kit.joint(model=SERVO_MODELS["LSS-P-S1"], speed_max_deg_s=90.0, accel_max_deg_s2=200.0)
    sequence = kit.keys((0.0, {"j0": 0.0}), (2.0, {"j0": 33.33}))
    program, trajectory, robot = made(kit, sequence, pro)
    assert program.moves[-1].target_wire == 3333
    assert profiles(program, robot)["j0"].at(5.0) == (33.33, 0.0)
    assert np.abs(error_deg(program, trajectory, robot)).max() <= 0.201


@pytest.mark.parametrize("law", ["cruise", "exact"])
def test_the_tolerance_is_kept_under_both_laws_of_t(kit, law):
    sequence = kit.lively(["j0"], 8.0, seed=4, swing_deg=30.0)
    program, trajectory, robot = made(kit, sequence, kit.joint(response=kit.Response(t_law=law)))
    errors = np.abs(error_deg(program, trajectory, robot))
    assert errors.max() <= 0.205
    assert program.error_max_deg["j0"] == pytest.approx(errors.max(), abs=0.02)


def test_moves_lead_by_the_lag_of_the_servo(kit):
    sequence = kit.keys((0.0, {"j0": 0.0}), (1.5, {"j0": 60.0}))
    quick, slow = (
        made(kit, sequence, kit.joint(response=kit.Response(lag_s=lag_s))) for lag_s in (0.0, 0.1)
    )
    first = [one[0].moves[0].due_us / 1e6 for one in (quick, slow)]
    assert first[0] - first[1] == pytest.approx(0.1, abs=0.006)
    assert first[1] >= -PREROLL_S


def test_the_ramp_is_the_largest_step_within_the_joints_limit(kit):
    limits = {595.0: 590, 599.9999999: 600, 600.0: 600, 601.0: 600, 10.0: 10, 5000.0: 1000}
    for accel_deg_s2, ramp in limits.items():
        assert ramp_deg_s2(kit.joint(accel_max_deg_s2=accel_deg_s2)) == ramp


def crowd(kit, count, baud_bps, length_s=8.0):
    joints = [kit.joint(f"j{index}", index + 1) for index in range(count)]
    robot = kit.robot(*joints, baud_bps=baud_bps)
    return kit.plan(kit.lively(list(robot.joints), length_s, swing_deg=40.0), robot), robot


def test_a_line_so_slow_that_moves_come_after_their_standstill_is_refused_as_well(kit):
    with pytest.raises(LineLoadError, match=r"would be .* ms late"):
        compile_program(*crowd(kit, 28, 9600, length_s=3.0))


def test_a_line_that_is_too_slow_is_refused_with_numbers_and_advice(kit):
    with pytest.raises(LineLoadError) as caught:
        compile_program(*crowd(kit, 26, 9600, length_s=3.0))
    message = str(caught.value)
    assert "'main' at 9600 bps" in message
    assert "commands need" in message
    assert "%" in message
    assert "1.2 deg" in message
    assert "baud" in message
    assert caught.value.bus == "main"
    assert caught.value.utilisation_ratio > 0.5
    assert f"{caught.value.utilisation_ratio:.0%}" in message


def test_a_slow_line_relaxes_the_tolerance_and_the_program_reports_it(kit):
    trajectory, robot = crowd(kit, 20, 19200)
    program = compile_program(trajectory, robot)
    assert 0.2 < program.tolerance_deg <= 1.0
    assert program.line_use["main"].overlaps == 0
    errors = np.abs(error_deg(program, trajectory, robot)).max(axis=1)
    assert errors.max() > 0.2
    for error, name in zip(errors, trajectory.joints, strict=True):
        assert error == pytest.approx(program.error_max_deg[name], abs=0.05)


def test_no_two_commands_overlap_on_the_line(kit):
    trajectory, robot = crowd(kit, 12, 57600)
    program = compile_program(trajectory, robot)
    ends_ns = [1000 * m.due_us + line_time_ns(len(m.data), 57600) for m in program.moves]
    for end_ns, successor in zip(ends_ns, program.moves[1:], strict=False):
        assert end_ns <= 1000 * successor.due_us + 1000
    assert program.line_use["main"].overlaps == 0
    assert program.line_use["main"].commands == len(program.moves)


def test_an_endless_program_repeats_a_pass_without_a_gap(kit):
    rows = [(0.0, {"j0": 0.0}), (1.0, {"j0": 50.0}), (2.4, {"j0": -40.0}), (3.2, {"j0": 0.0})]
    program, trajectory, _ = made(kit, kit.keys(*rows, loop=None))
    assert math.isinf(program.duration_s)
    assert program.repeat is not None
    period_us = program.repeat.to_us - program.repeat.from_us
    assert period_us == 3_200_000
    assert program.within(3.2 + 7 * 3.2 + 0.3) == pytest.approx(3.5)
    assert program.within(1.2) == 1.2
    unrolled = program.unrolled()
    dues_us = [next(unrolled)[0] for _ in range(5 * len(program.moves))]
    assert dues_us == sorted(dues_us)
    once = [m for m in program.moves if program.repeat.from_us <= m.due_us]
    later = [due for due in dues_us if 9_600_000 <= due < 12_800_000]
    assert later == [move.due_us + 2 * period_us for move in once]
    assert trajectory.is_periodic


def test_a_joint_that_the_robot_lacks_is_named(kit):
    trajectory = kit.plan(kit.keys((0.0, {"j0": 0.0}), (1.0, {"j0": 9.0})), kit.robot())
    with pytest.raises(InputError, match="no joint 'j0'"):
        compile_program(trajectory, kit.robot(kit.joint("other")))


@pytest.mark.parametrize("seed", range(3))
def test_a_faster_line_saves_commands_or_needs_next_to_no_more(kit, seed):
    """Below 115200 bps each line is fitted for itself, so counts differ by chance, but by no more
    than this; from there on a faster line needs no more at all.
    """
    joints = [kit.joint(f"j{index}", index + 1) for index in range(8)]
    robots = [kit.robot(*joints, baud_bps=baud_bps) for baud_bps in (57600, 115200, 500000)]
    show = kit.lively(list(robots[0].joints), 4.0, seed=seed)
    programs = [compile_program(kit.plan(show, robot), robot) for robot in robots]
    counts = [len(program.moves) for program in programs]
    assert counts[1] <= 1.03 * counts[0] + 2
    assert counts[2] <= counts[1]
    tolerances_deg = [program.tolerance_deg for program in programs]
    assert tolerances_deg == sorted(tolerances_deg, reverse=True)


def busy(kit, rate_min_hz):
    """Return a show whose commands take more than half of the line in the worst second."""
    joints = [kit.joint(f"j{index}", index + 1) for index in range(12)]
    robot = kit.robot(*joints, baud_bps=19200)
    bus = replace(robot.buses["main"], reading_rate_min_hz=rate_min_hz)
    robot = replace(robot, buses={"main": bus})
    return kit.plan(kit.lively(list(robot.joints), 4.0), robot), robot


def test_the_tolerance_is_relaxed_until_the_joints_can_be_read_often_enough(kit):
    trajectory, robot = busy(kit, 0.0)
    freely = compile_program(trajectory, robot)
    found_hz = freely.line_use["main"].reading_rate_hz
    _, stricter = busy(kit, 1.1 * found_hz)
    program = compile_program(trajectory, stricter)
    assert program.line_use["main"].reading_rate_hz >= 1.1 * found_hz
    assert program.tolerance_deg > freely.tolerance_deg


def test_a_line_without_room_for_readings_is_refused_with_figures(kit):
    trajectory, robot = busy(kit, 500.0)
    with pytest.raises(LineLoadError) as caught:
        compile_program(trajectory, robot)
    message = str(caught.value)
    assert "each joint could be read" in message
    assert "times, not 500" in message
    assert "reading_rate_min_hz" in message
    assert caught.value.bus == "main"
