"""Streamed, stepped and chosen drives: what is fitted, and what it predicts."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lss_motion.errors import InputError, PlanningError
from lss_motion.program.compile import compile_program
from lss_motion.program.model import Driving
from lss_motion.program.stepped import PULSE_S
from lss_motion.program.streamed import FilterProfile
from lss_motion.program.text import from_text, to_text
from lss_motion.program.verify import profiles, verify_program
from lss_motion.robot.model import Response
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sequence.model import Keyframe, Sequence

PERIOD_S = 0.02


def mixed(kit, **fields):
    return kit.robot(
        kit.joint(),
        kit.joint("j1", 2, drive="streamed", **fields),
        kit.joint("j2", 209, model=SERVO_MODELS["LSS-2IO"], drive="stepped"),
    )


def compiled(kit, robot, *, seed=0, duration_s=8.0, swing_deg=50.0, **options):
    trajectory = kit.plan(
        kit.lively(list(robot.joints), duration_s, seed=seed, swing_deg=swing_deg), robot
    )
    return compile_program(trajectory, robot, **options), trajectory


def horn_error_deg(program, robot, trajectory, name, lag_s):
    """Return how far the predicted horn is from the plan, (instants)."""
    times_s = np.arange(0.0, trajectory.duration_s, 0.005)
    joint = robot.joints[name]
    servo_deg = profiles(program, robot)[name].sample(times_s - lag_s)
    planned = trajectory.sample(times_s)[:, trajectory.joints.index(name)]
    return np.abs(joint.direction * (servo_deg - joint.zero_deg) - planned)


# ---- the model of the filter


def test_the_filter_steps_as_its_maker_says():
    servo = FilterProfile(0.0, count=5, response=Response(), step_s=0.0)
    servo.retarget(0.001, 90.0, None)
    assert [round(servo.value(step), 3) for step in range(3)] == [0.0, 18.0, 32.4]
    assert servo.value(100) == 90.0
    at_deg, speed_deg_s = servo.at(1.5 * PERIOD_S)
    assert at_deg == pytest.approx(18.0)
    assert speed_deg_s == pytest.approx((32.4 - 18.0) / PERIOD_S)


def test_what_is_received_in_the_last_loop_before_a_step_counts_from_the_next_one():
    servo = FilterProfile(0.0, count=2, response=Response(), step_s=0.0)
    assert servo.acts_on(0.0149) == 1
    assert servo.acts_on(0.0151) == 2
    assert servo.acts_on(0.020) == 2
    assert (
        servo.acts_on(servo.receive_s(7) - 0.009) == servo.acts_on(servo.receive_s(7) + 0.009) == 7
    )


def test_a_long_rest_takes_no_memory_and_is_forgotten():
    servo = FilterProfile(0.0, count=3, response=Response(), step_s=0.0)
    for hour in range(5):
        servo.retarget(3600.0 * hour + 1.0, 10.0 * hour, None)
    assert len(list(servo.pieces())) < 300
    servo.forget_before(3600.0 * 4 - 1.0)
    assert servo.at(3600.0 * 3.9) == (30.0, 0.0)
    assert servo.at(math.inf) == (40.0, 0.0)


# ---- what is compiled


@pytest.mark.parametrize("count", [2, 4, 8])
@pytest.mark.parametrize("seed", range(3))
def test_a_streamed_horn_keeps_the_tolerance_and_the_lag_of_its_filter_is_gone(kit, seed, count):
    robot = kit.robot(kit.joint("j1", 2, drive="streamed", filter_count=count, zero_deg=3.3))
    program, trajectory = compiled(kit, robot, seed=seed)
    error_deg = horn_error_deg(program, robot, trajectory, "j1", 0.02)
    assert error_deg.max() < 0.35, "0.2, and what a course bends between two steps"
    assert np.sqrt(np.mean(error_deg**2)) < 0.1
    assert program.drives == {"j1": Driving("streamed", count)}
    assert {move.duration_ms for move in program.moves} == {None}
    late_deg = np.abs(np.diff(trajectory.sample(np.arange(0.0, 7.0, (count - 1) * PERIOD_S))[:, 0]))
    assert late_deg.max() > 10 * error_deg.max() or count == 2, "what the lag would have been"


def test_fewer_commands_do_for_a_longer_filter_and_a_wider_tolerance(kit):
    counts = []
    for filter_count, tolerance_deg in ((2, 0.2), (4, 0.2), (8, 0.2), (8, 0.5)):
        robot = kit.robot(kit.joint("j1", 2, drive="streamed", filter_count=filter_count))
        counts.append(len(compiled(kit, robot, tolerance_deg=tolerance_deg)[0].moves))
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < 0.6 * counts[0]


@pytest.mark.parametrize("seed", range(3))
def test_targets_of_a_streamed_joint_never_leave_its_range_or_outrun_its_speed(kit, seed):
    robot = kit.robot(
        kit.joint("j1", 2, drive="streamed", position_min_deg=-50.0, position_max_deg=50.0)
    )
    program, _ = compiled(kit, robot, seed=seed)
    targets = [move.target_wire / 10 for move in program.moves]
    assert max(map(abs, targets)) <= 50.0
    assert max(map(abs, targets)) > 45.0
    _, position_deg, speed_deg_s, _ = profiles(program, robot)["j1"].table
    assert np.abs(position_deg).max() <= 50.0
    assert np.abs(speed_deg_s).max() <= 180.0 + 0.05 / (4 * PERIOD_S) + 1e-6


def test_a_rest_at_the_end_of_a_range_that_the_wire_cannot_say_comes_to_an_end(kit):
    robot = kit.robot(
        kit.joint("j1", 2, drive="streamed", position_min_deg=-50.0, position_max_deg=43.27)
    )
    frames = (Keyframe(deg={"j1": 0.0}, at_s=0.0), Keyframe(deg={"j1": 43.27}, at_s=1.0))
    trajectory = kit.plan(Sequence(name="to the end", keyframes=frames), robot)
    program = compile_program(trajectory, robot)
    assert program.moves[-1].target_wire == 432
    assert program.duration_s < 1.5


def test_the_end_is_said_until_a_filter_that_missed_some_of_it_has_settled(kit):
    robot = kit.robot(kit.joint("j1", 2, drive="streamed"))
    plan = kit.plan(kit.keys((0.0, {"j1": 0.0}), (0.4, {"j1": 20.0}), (5.0, {"j1": 20.0})), robot)
    program = compile_program(plan, robot)
    last = [move for move in program.moves if move.target_wire == 200]
    said = [move for move in program.moves[-len(last) :] if move.target_wire == 200]
    assert 3 <= len(said) <= 15
    assert said[-1].due_us < 1_000_000, "and then it is silent"
    gaps_us = [b.due_us - a.due_us for a, b in pairwise(said)]
    assert gaps_us == pytest.approx([20_000] * len(gaps_us), abs=1500)
    assert profiles(program, robot)["j1"].at(2.0) == (20.0, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_stepped_horn_is_at_the_nearest_whole_degree(kit, seed):
    model = SERVO_MODELS["LSS-2IO"]
    robot = kit.robot(kit.joint("j2", 209, model=model, drive="stepped", direction=-1))
    program, trajectory = compiled(kit, robot, seed=seed, swing_deg=20.0)
    error_deg = horn_error_deg(program, robot, trajectory, "j2", 0.0225)
    assert np.sqrt(np.mean(error_deg**2)) < 0.45, "0.29 for rounding alone"
    assert all(move.target_wire % 10 == 0 and move.duration_ms is None for move in program.moves)
    dues = [move.due_us for move in program.moves]
    assert min(b - a for a, b in pairwise(dues)) >= 1e6 * PULSE_S - 1000, (
        "but for the line time of a byte"
    )
    values = [move.target_wire for move in program.moves]
    assert all(a != b for a, b in pairwise(values)), "nothing is said twice"


def test_a_mixed_robot_shares_its_line_without_overlap_and_passes_the_verifier(kit):
    robot = mixed(kit)
    program, _ = compiled(kit, robot)
    assert program.line_use["main"].overlaps == 0
    assert program.drives == {"j1": Driving("streamed", 4), "j2": Driving("stepped")}
    assert max(len(move.data) for move in program.moves) <= 16
    verify_program(program, robot)
    jump = program.moves[-1]._replace(servo_id=209, target_wire=800, duration_ms=None)
    with pytest.raises(PlanningError, match="'j2' would jump faster than 180 deg/s"):
        verify_program(replace(program, moves=(*program.moves, jump)), robot)
    far = program.moves[-1]._replace(servo_id=2, target_wire=850, duration_ms=None)
    with pytest.raises(PlanningError, match=r"'j1' would reach .* allowed 180 deg/s"):
        verify_program(replace(program, moves=(*program.moves, far)), robot)


def test_a_repeated_pass_leaves_no_step_behind(kit):
    robot = mixed(kit)
    names = list(robot.joints)
    rows = [(at_s, dict.fromkeys(names, 37.4 * math.sin(at_s))) for at_s in (0.0, 0.7, 1.4, 2.2)]
    plan = kit.plan(kit.keys(*rows, (3.0, dict.fromkeys(names, 0.0)), loop=None), robot)
    program = compile_program(plan, robot)
    repeat = program.repeat
    period_us = repeat.to_us - repeat.from_us
    again = [m for m in program.moves if m.due_us >= repeat.from_us]
    passes = [m._replace(due_us=m.due_us + n * period_us) for n in range(1, 4) for m in again]
    longer = replace(program, moves=(*program.moves, *passes))
    late_s = repeat.from_us / 1e6 + np.arange(0.1, period_us / 1e6, 0.01)
    for name, curve in profiles(longer, robot).items():
        first = curve.sample(late_s)
        third = curve.sample(late_s + 2 * period_us / 1e6)
        allowed = {"j0": 0.6, "j1": 1.6, "j2": 1.01}[name]
        assert np.abs(third - first).max() < allowed, name


# ---- text


def test_text_carries_the_drives_and_reads_them_back(kit):
    robot = mixed(kit, filter_count=6)
    program, _ = compiled(kit, robot)
    text = to_text(program)
    assert "# drives: j1=streamed:6 j2=stepped\n" in text
    other = replace(robot, joints={**robot.joints, "j1": kit.joint("j1", 2)})
    again = from_text(text, other)
    assert to_text(again) == text
    assert again.drives == program.drives
    assert again.moves == program.moves
    expected = profiles(program, robot)["j1"].sample(np.arange(0.0, 8.0, 0.1))
    assert profiles(again, other)["j1"].sample(np.arange(0.0, 8.0, 0.1)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("drives", "moves", "said"),
    [
        ("j1=streamed", "", "'j1=streamed' is neither"),
        ("j1=streamed:0", "", "'j1=streamed:0' is neither"),
        ("j1=timed", "", "'j1=timed' is neither"),
        ("j9=stepped", "", "no joint 'j9'"),
        ("j1=streamed:4", "0 main #2D10T500", "'j1' is streamed: its D takes no T"),
        ("j2=stepped", "0 main #209D15", "D15 is not a multiple of 10"),
        ("j1=stepped", "0 main #2D10", "an LSS-ST1 cannot be stepped"),
        ("j1=streamed:4", "0 main #209D10T50", "an LSS-2IO cannot be timed"),
        ("j2=streamed:4", "0 main #209D10", "an LSS-2IO cannot be streamed"),
    ],
)
def test_drives_that_do_not_fit_the_robot_are_refused(kit, drives, moves, said):
    head = "# lss_motion program 1\n# name: x\n# robot: bench\n# duration_us: 9\n"
    text = f"{head}# tolerance_deg: 0.2\n# start_deg: j0=0 j1=0 j2=0\n# drives: {drives}\n{moves}\n"
    with pytest.raises(InputError, match=said):
        from_text(text, mixed(kit))


# ---- auto


def test_auto_takes_what_predicts_best_and_says_why(kit):
    auto = {"drive": "auto"}
    robot = kit.robot(
        kit.joint("plain", 1, **auto),
        kit.joint("jerky", 2, response=Response(retarget="from_rest"), **auto),
        kit.joint("hasty", 3, accel_max_deg_s2=1500.0, **auto),
        kit.joint("rc", 209, model=SERVO_MODELS["LSS-2IO"], **auto),
        kit.joint("pro", 5, model=SERVO_MODELS["LSS-P-S1"], **auto),
    )
    program, _ = compiled(kit, robot)
    chosen = {name: driving.drive for name, driving in program.drives.items()}
    assert chosen == {"jerky": "streamed", "hasty": "streamed", "rc": "stepped"}
    reasons = program.drive_reasons
    assert reasons["plain"].startswith("timed: timed predicts 0.")
    assert "1500 deg/s² is more than its ramps can express, 1000" in reasons["hasty"]
    assert "supports no other drive" in reasons["rc"]
    assert "supports no other drive" in reasons["pro"]


def test_auto_gives_up_streaming_where_the_line_has_no_room_for_it(kit):
    jerky = Response(retarget="from_rest")
    joints = [kit.joint(f"j{n}", n + 1, drive="auto", response=jerky) for n in range(6)]
    wide, _ = compiled(kit, kit.robot(*joints), tolerance_deg=0.5)
    assert len(wide.drives) == 6
    narrow, _ = compiled(kit, kit.robot(*joints, baud_bps=9600), tolerance_deg=0.5, swing_deg=12.0)
    given_up = [n for n in narrow.drive_reasons if n not in narrow.drives]
    assert given_up
    assert "the line has no room to stream it" in narrow.drive_reasons[given_up[0]]


def test_old_firmware_has_no_filter_to_choose(kit):
    robot = kit.robot(kit.joint(drive="auto", response=Response(retarget="from_rest")))
    bus = replace(robot.buses["main"], firmware=367)
    program, _ = compiled(kit, replace(robot, buses={"main": bus}), tolerance_deg=1.0)
    assert not program.drives
    assert program.drive_reasons["j0"] == "timed: streaming needs firmware 368"
