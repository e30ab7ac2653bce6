from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import PlanningError
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.program.model import Move, Program
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.verify import profiles, verify_profiles, verify_program
from lss_motion.robot.profile import Piece
from lss_motion.robot.servo_models import SERVO_MODELS


def program(*moves, **fields) -> Program:
    """Return a program of `(due_s, target_deg, T in ms)` for joint j0, which starts at 0."""
    made = tuple(
        Move(
            due_us=round(1e6 * due_s),
            bus="main",
            servo_id=1,
            target_wire=round(10 * target_deg),
            duration_ms=duration_ms,
        )
        for due_s, target_deg, duration_ms in moves
    )
    requests = {"duration_s": 9.0, "start_deg": {"j0": 0.0}, "tolerance_deg": 0.2, **fields}
    return Program(name="any", robot="bench", moves=made, **requests)


def test_a_move_that_the_servo_can_make_passes(kit):
    verify_program(program((0.0, 90.0, 1000), (2.0, -90.0, 1000)), kit.robot())


def test_a_horn_that_cannot_brake_before_the_end_of_its_range_is_refused(kit):
    # At 180 deg/s and 600 deg/s² it needs 27 deg to stop: turned back on its way it swings on.
    moves = program((0.0, 90.0, 10), (0.6, -90.0, 10))
    curve = profiles(moves, kit.robot())["j0"]
    farthest_deg = curve.sample(np.arange(0.0, 2.0, 1e-4)).max()
    verify_program(moves, kit.robot(kit.joint(position_max_deg=farthest_deg)))
    with pytest.raises(PlanningError, match=r"'j0' would be at 9\d\.\d\d deg, allowed -90 to 85"):
        verify_program(moves, kit.robot(kit.joint(position_max_deg=85.0)))


def test_the_time_and_the_joint_are_named(kit):
    with pytest.raises(PlanningError) as caught:
        verify_program(program((3.0, 95.0, 10)), kit.robot())
    assert caught.value.joint == "j0"
    assert caught.value.time_s == pytest.approx(3.6, abs=0.3)


def test_ramps_that_break_the_acceleration_limit_are_refused(kit):
    with pytest.raises(PlanningError, match=r"would reach 10 deg/s², allowed 5 deg/s²"):
        verify_program(program((0.0, 9.0, 900)), kit.robot(kit.joint(accel_max_deg_s2=5.0)))


def test_every_compiled_program_passes(kit):
    joints = [kit.joint(f"j{index}", index + 1, accel_max_deg_s2=600.0) for index in range(6)]
    robot = kit.robot(*joints)
    verify_program(
        compile_program(kit.plan(kit.lively(list(robot.joints), 9.0), robot), robot), robot
    )


def verify_pieces(joint, kit, *pieces):
    """Verify a profile of `(start_s, deg, deg/s, deg/s²)`."""
    verify_profiles({"j0": PiecewiseProfile(Piece(*piece) for piece in pieces)}, kit.robot(joint))


def sprint(deg_s, *, from_deg=0.0, at_s=2.0):
    """From rest to rest, at `deg_s` for an instant, with 500 deg/s²."""
    ramp_s = deg_s / 500.0
    middle_deg = from_deg + 0.5 * deg_s * ramp_s
    end_deg = from_deg + deg_s * ramp_s
    return (
        (0.0, from_deg, 0.0, 0.0),
        (at_s, from_deg, 0.0, 500.0),
        (at_s + ramp_s, middle_deg, deg_s, -500.0),
        (at_s + 2.0 * ramp_s, end_deg, 0.0, 0.0),
    )


def test_an_excess_speed_of_a_thousandth_passes_and_no_more(kit):
    verify_pieces(kit.joint(), kit, *sprint(180.17))
    with pytest.raises(PlanningError, match=r"would reach 180.2 deg/s, allowed 180 deg/s at 2.0"):
        verify_pieces(kit.joint(), kit, *sprint(180.2))


def test_an_excess_acceleration_of_a_thousandth_passes_and_no_more(kit):
    verify_pieces(kit.joint(accel_max_deg_s2=499.6), kit, *sprint(90.0))
    with pytest.raises(PlanningError, match=r"would reach 500 deg/s², allowed 499 deg/s² at 2.000"):
        verify_pieces(kit.joint(accel_max_deg_s2=499.0), kit, *sprint(90.0))


def test_the_speed_at_the_end_of_a_piece_is_checked(kit):
    # Only the jump back to rest shows the speed at the end of the first piece.
    ramp = (0.0, 0.0, 0.0, 500.0), (0.4, 40.0, 0.0, 0.0)
    with pytest.raises(PlanningError, match=r"would reach 200 deg/s"):
        verify_pieces(kit.joint(), kit, *ramp)


def test_pieces_that_do_not_meet_are_refused(kit):
    def stepped(deg):
        first, *others = sprint(90.0)
        return first, *((at_s, at_deg + deg, *rest) for at_s, at_deg, *rest in others)

    verify_pieces(kit.joint(), kit, *stepped(0.9e-6))
    with pytest.raises(PlanningError, match=r"'j0' would jump at 2.000 s") as caught:
        verify_pieces(kit.joint(), kit, *stepped(2e-6))
    assert caught.value.time_s == pytest.approx(2.0)


def test_a_profile_may_be_a_wire_unit_outside_of_the_range_and_no_more(kit):
    for side in (1.0, -1.0):
        verify_pieces(kit.joint(), kit, (0.0, side * 90.09, 0.0, 0.0))
        with pytest.raises(PlanningError, match=rf"at {side * 90.11:.2f} deg, allowed -90 to 90"):
            verify_pieces(kit.joint(), kit, (0.0, side * 90.11, 0.0, 0.0))


def test_a_profile_that_turns_round_outside_of_the_range_is_refused(kit):
    # Up and back within one piece: 16 deg further than where it begins and ends.
    swing = (0.0, 75.0, 0.0, 0.0), (1.0, 75.0, 178.885, -1000.0), (1.35777, 75.0, 0.0, 0.0)
    joint = kit.joint(accel_max_deg_s2=1000.0)
    verify_pieces(kit.joint(accel_max_deg_s2=1000.0, position_max_deg=91.0), kit, *swing)
    with pytest.raises(PlanningError, match=r"would be at 91.00 deg, allowed -90 to 90 deg at 1.0"):
        verify_pieces(joint, kit, *swing)


def test_a_streamed_joint_may_exceed_its_speed_by_the_rounding_of_the_wire(kit):
    # Half a wire unit in each step of its filter: 0.05 deg / (4 × 20 ms) = 0.625 deg/s.
    streamed = kit.joint(drive="streamed", filter_count=4)
    verify_pieces(streamed, kit, *sprint(180.18 + 0.62))
    with pytest.raises(PlanningError, match=r"would reach 180.81 deg/s, allowed 180"):
        verify_pieces(streamed, kit, *sprint(180.18 + 0.63))
    with pytest.raises(PlanningError, match=r"would reach 180.8 deg/s, allowed 180"):
        verify_pieces(kit.joint(), kit, *sprint(180.18 + 0.62))


def stairs(*steps):
    """Return a staircase of `(at_s, deg)` whose first step has no begin."""
    (_, first_deg), *others = steps
    return (-np.inf, first_deg, 0.0, 0.0), *((at_s, deg, 0.0, 0.0) for at_s, deg in others)


def test_a_stepped_joint_jumps_as_far_as_its_speed_and_the_time_since_allow(kit):
    board = kit.joint(drive="stepped", model=SERVO_MODELS["LSS-2IO"], speed_max_deg_s=100.0)
    # The wire rounds to a whole degree; 0.5 s allow another 50.05 deg.
    verify_pieces(board, kit, *stairs((0.0, 0.0), (1.0, 5.0), (1.5, 56.0)))
    with pytest.raises(PlanningError, match=r"would jump faster than 100 deg/s at 1.500 s"):
        verify_pieces(board, kit, *stairs((0.0, 0.0), (1.0, 5.0), (1.5, 56.1), (2.0, 56.0)))


def test_steps_within_one_pulse_period_are_judged_over_the_period(kit):
    board = kit.joint(drive="stepped", model=SERVO_MODELS["LSS-2IO"], speed_max_deg_s=100.0)
    verify_pieces(board, kit, *stairs((0.0, 0.0), (1.0, 1.0), (1.001, 4.0)))
    with pytest.raises(PlanningError, match="would jump faster"):
        verify_pieces(board, kit, *stairs((0.0, 0.0), (1.0, 1.0), (1.001, 4.1)))


def test_a_stepped_joint_keeps_its_range(kit):
    board = kit.joint(drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    verify_pieces(board, kit, *stairs((0.0, 80.0), (1.0, 91.0)))
    with pytest.raises(
        PlanningError, match=r"would be at 91.10 deg, allowed -90 to 90 deg at 1.000"
    ):
        verify_pieces(board, kit, *stairs((0.0, 80.0), (1.0, 91.1)))
