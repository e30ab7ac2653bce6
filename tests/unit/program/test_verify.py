from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import PlanningError
from lss_motion.program.compile import compile_program
from lss_motion.program.model import Move, Program
from lss_motion.program.predict import profiles
from lss_motion.program.verify import verify_program


def program(*moves, **fields) -> Program:
    """A program of `(due_s, target_deg, T in ms)` for joint j0, which starts at 0."""
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
    wishes = {"duration_s": 9.0, "start_deg": {"j0": 0.0}, "tolerance_deg": 0.2, **fields}
    return Program(name="any", robot="bench", moves=made, **wishes)


def test_a_move_that_the_servo_can_make_is_good(kit):
    verify_program(program((0.0, 90.0, 1000), (2.0, -90.0, 1000)), kit.robot())


def test_a_horn_that_cannot_brake_before_the_end_of_its_range_is_refused(kit):
    # At 180 deg/s and 600 deg/s² it needs 27 deg to stop: turned back on its way it swings on.
    moves = program((0.0, 90.0, 10), (0.6, -90.0, 10))
    reference = profiles(moves, kit.robot())["j0"]
    farthest_deg = reference.sample(np.arange(0.0, 2.0, 1e-4)).max()
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
