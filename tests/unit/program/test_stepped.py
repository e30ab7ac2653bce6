"""The stepped drive: whole degrees for RC servos."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from lss_motion.planning.program.streamed import PULSE_S
from lss_motion.robot.servo_models import SERVO_MODELS


@pytest.mark.parametrize("seed", range(3))
def test_a_stepped_horn_is_at_the_nearest_whole_degree(kit, seed):
    model = SERVO_MODELS["LSS-2IO"]
    robot = kit.robot(kit.joint("j2", 209, model=model, drive="stepped", direction=-1))
    program, trajectory = kit.compiled(robot, seed=seed, swing_deg=20.0)
    error_deg = kit.horn_error_deg(program, robot, trajectory, "j2", 0.0225)
    assert np.sqrt(np.mean(error_deg**2)) < 0.45, "0.29 for rounding alone"
    assert all(move.target_wire % 10 == 0 and move.duration_ms is None for move in program.moves)
    dues = [move.due_us for move in program.moves]
    assert min(b - a for a, b in pairwise(dues)) >= 1e6 * PULSE_S - 1000, (
        "but for the line time of a byte"
    )
    values = [move.target_wire for move in program.moves]
    assert all(a != b for a, b in pairwise(values)), "nothing is message twice"
