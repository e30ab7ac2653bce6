"""Corrections do no harm in a show so short and fast that few readings tell of its servos."""

from __future__ import annotations

import numpy as np
import pytest

from benches.in_phase import horn_rms_deg, with_and_without_feedback
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from tests.virtual.conftest import make_robot, make_sequence

ROBOT = make_robot(6, speed_max_deg_s=360.0, accel_max_deg_s2=1000.0, baud_bps=921600)
SHOW = make_sequence(6, 2.5, swing_deg=60.0, step_s=(0.2, 0.5), seed=4)
HARM_RATIO = 1.02


@pytest.fixture(scope="module")
def compiled():
    trajectory = plan(SHOW, ROBOT)
    return trajectory, compile_program(trajectory, ROBOT)


@pytest.mark.parametrize("seed", range(4))
def test_feedback_makes_no_horn_of_a_robot_as_assumed_worse(seed, compiled) -> None:
    """From the same phase of the control loops: what differs is the queries and corrections."""
    trajectory, program = compiled
    ours, other = with_and_without_feedback(program, ROBOT, trajectory, seed=seed)
    assert ours.report.outcome == other.report.outcome == "finished"
    assert horn_rms_deg(ours, trajectory) <= HARM_RATIO * horn_rms_deg(other, trajectory)
    for name, joint in ours.report.joints.items():
        assert joint.readings > 5
        most_deg = HARM_RATIO * other.report.joints[name].horn_error_max_deg + 0.02
        assert joint.horn_error_max_deg <= most_deg, name
    assert np.array_equal(ours.truth.times_s, other.truth.times_s)
