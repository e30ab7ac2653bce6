from __future__ import annotations

import numpy as np

from lss_motion.program.course import GRID_S, SEGMENT_MAX_S, Course, ServoLimits
from lss_motion.program.fit import Fit
from lss_motion.program.moves import reference
from lss_motion.robot.model import Response

LIMITS = ServoLimits(
    position_min_deg=-90.0,
    position_max_deg=90.0,
    speed_max_deg_s=180.0,
    ramp_deg_s2=600.0,
    wire_per_deg=10,
    tolerance_deg=0.2,
    response=Response(),
)


def fitted(position_deg):
    """Return the moves for one course, all heard when they are wanted, and the profile they make"""
    course = Course(start_s=0.0, position_deg=np.asarray(position_deg))
    moves = Fit([course], [LIMITS]).moves(lambda: lambda _joints, wanted_us, _after_us: wanted_us)
    return moves, reference(moves, 0, course, LIMITS)


def test_no_course_is_run_past_the_begin_of_its_rest():
    """One long slow move could keep the tolerance for a while after the rest began."""
    random = np.random.default_rng(0)
    times_s = GRID_S * np.arange(1600)
    ramp = np.clip(np.minimum(times_s - 0.5, 7.5 - times_s) / 1.5, 0.0, 1.0)
    fade = ramp * ramp * (3.0 - 2.0 * ramp)
    for _ in range(190):
        waves = [
            (random.uniform(2.0, 8.0), random.uniform(0.05, 0.2), random.uniform(0.0, 6.28))
            for _ in range(random.integers(1, 4))
        ]
        swing = sum(size * np.sin(6.283 * rate * times_s + shift) for size, rate, shift in waves)
        moves, profile = fitted(swing * fade)
        assert moves.heard_s[-1] <= 7.5
        assert moves.target_wire[-1] == 0
        assert profile.at(7.75) == (0.0, 0.0)


def test_a_steady_speed_is_a_move_every_second_and_a_half():
    times_s = GRID_S * np.arange(2400)
    course_deg = -80.0 + 16.0 * np.clip(times_s - 0.5, 0.0, 10.0)
    moves, _ = fitted(course_deg)
    gaps_s = np.diff(moves.heard_s)
    assert len(moves) <= 12
    assert gaps_s.max() <= SEGMENT_MAX_S + GRID_S


def test_a_standstill_needs_no_move():
    assert len(fitted(np.full(400, 12.34))[0]) == 0


def test_what_is_less_than_half_a_wire_step_is_no_motion():
    times_s = GRID_S * np.arange(400)
    assert len(fitted(0.04 * np.sin(5.0 * times_s))[0]) == 0
