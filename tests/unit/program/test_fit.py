from __future__ import annotations

import numpy as np

from lss_motion.program.cone import GRID_S, Course, ServoLimits
from lss_motion.program.fit import SEGMENT_MAX_S, Fitter
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


def fitted(position_deg) -> Fitter:
    fitter = Fitter(Course(start_s=0.0, position_deg=np.asarray(position_deg)), LIMITS)
    wanted_s = fitter.wanted(None)
    while wanted_s is not None:
        fitter.grant(wanted_s)
        wanted_s = fitter.wanted(wanted_s)
    return fitter


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
        fitter = fitted(swing * fade)
        assert fitter.moves[-1].heard_s <= 7.5
        assert fitter.moves[-1].target_wire == 0
        assert fitter.reference().at(7.75) == (0.0, 0.0)


def test_a_steady_speed_is_a_move_every_second_and_a_half():
    times_s = GRID_S * np.arange(2400)
    course_deg = -80.0 + 16.0 * np.clip(times_s - 0.5, 0.0, 10.0)
    moves = fitted(course_deg).moves
    gaps_s = np.diff([move.heard_s for move in moves])
    assert len(moves) <= 12
    assert gaps_s.max() <= SEGMENT_MAX_S + GRID_S


def test_a_standstill_needs_no_move():
    assert fitted(np.full(400, 12.34)).moves == []


def test_what_is_less_than_half_a_wire_step_is_no_motion():
    times_s = GRID_S * np.arange(400)
    assert fitted(0.04 * np.sin(5.0 * times_s)).moves == []
