"""What `compile` predicts of the horns bounds what the simulated ones do."""

from __future__ import annotations

from pathlib import Path

import pytest
from motion_table import map_for, robot_for
from msgspec.structs import replace

from benches.in_phase import bound_ratios
from lss_motion.interchange.importing import imported, read_motion
from lss_motion.interchange.mapping import load_map
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing import api
from lss_motion.playing.run import perform
from tests.virtual.conftest import make_robot, make_sequence

ROOT = Path(__file__).resolve().parents[2]
MOTIONS = ROOT.parent / "shared" / "motions"


def errors_over_bounds(robot, trajectory, seed=0):
    """Return by joint the largest error of the simulated horn over the predicted bound."""
    program = compile_program(trajectory, robot)
    result = perform(
        program, robot, is_virtual=True, seed=seed, trajectory=trajectory, has_feedback=False
    )
    assert result.report.outcome == "finished"
    assert result.report.joints.keys() == program.bound_deg.keys()
    return bound_ratios(program, result)


@pytest.mark.skipif(not MOTIONS.is_dir(), reason="the collection of real motions is not here")
@pytest.mark.parametrize(
    ("file", "name", "seed"),
    [
        ("throw.json", "throw", 0),
        ("webots_op2_hand_high.motion", "webots_op2_hand_high", 0),
        ("op3_motion_4095.bin", "see_rightup", 0),
        ("op3_motion_4095.bin", "keep_re", 1),
    ],
)
def test_a_real_motion_stays_within_what_was_predicted(file, name, seed, tmp_path) -> None:
    """`keep_re` is furthest off amid its moves, not at their ends."""
    motion = read_motion(MOTIONS / file, motion_name=name)
    robot = robot_for(motion, tmp_path)
    made = imported(motion, robot, motion_map=load_map(map_for(motion, robot, tmp_path)))
    ratios = errors_over_bounds(robot, plan(made.sequence, robot), seed=seed)
    assert max(ratios.values()) <= 1.0


@pytest.mark.parametrize("seed", [1])
def test_quick_random_moves_stay_within_what_was_predicted_and_not_within_less(seed) -> None:
    """The bound is no more than 2.5 times what happens, and the moves alone would not be enough."""
    robot = make_robot(speed_max_deg_s=360.0, accel_max_deg_s2=1000.0, baud_bps=115200)
    show = make_sequence(swing_deg=60.0, step_s=(0.4, 0.8), seed=seed)
    trajectory = plan(show, robot)
    ratios = errors_over_bounds(robot, trajectory, seed=seed)
    assert 0.4 < min(ratios.values()) <= max(ratios.values()) <= 1.0
    program = compile_program(trajectory, robot)
    assert all(program.bound_deg[n] > program.error_max_deg[n] for n in program.bound_deg)


def test_a_lag_and_a_loop_that_the_robot_file_states_widen_the_bound() -> None:
    robot = make_robot(1, speed_max_deg_s=300.0)
    joints = {
        name: replace(joint, response=replace(joint.response, lag_s=0.06, loop_s=0.02))
        for name, joint in robot.joints.items()
    }
    slow = replace(robot, joints=joints)
    show = make_sequence(1, swing_deg=60.0, step_s=(0.5, 0.8))
    bounds = [compile_program(plan(show, one), one).bound_deg["j0"] for one in (robot, slow)]
    assert bounds[1] > bounds[0] + 0.5


def test_our_own_wave_stays_within_what_was_predicted() -> None:
    robot = api.load_robot(ROOT / "sequences" / "robots" / "desk_arm.yaml")
    trajectory = api.plan(api.load_sequence(ROOT / "sequences" / "wave.yaml"), robot)
    ratios = errors_over_bounds(robot, replace(trajectory, loop=1))
    assert max(ratios.values()) <= 1.0
