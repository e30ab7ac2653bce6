from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.planning.program.fit import TimedFit
from lss_motion.planning.program.moves import fitted_profiles, profiles_from_rest
from lss_motion.planning.program.reference_grid import (
    GRID_S,
    SEGMENT_MAX_S,
    Reference,
    servo_limits,
)
from lss_motion.planning.program.segments import segments_of
from lss_motion.robot.model import Response
from tests.joints import joint

LIMITS = servo_limits(joint(), 0.2)


def all_fitted(rows_deg, limits=LIMITS):
    """Return moves and profile for each reference, with each move granted as requested."""
    references = [Reference(start_s=0.0, position_deg=np.asarray(row)) for row in rows_deg]
    each = [limits] * len(references)
    moves = TimedFit(references, each).moves(
        lambda: lambda _joints, requested_us, _after_us: requested_us
    )
    profiles = fitted_profiles(moves, references, each)
    return [(moves.of(joint), profile) for joint, profile in enumerate(profiles)]


def fitted(position_deg):
    return all_fitted([position_deg])[0]


def swings(count, seed=0, longest_s=7.5):
    """Return smooth references from rest to rest, no two alike."""
    random = np.random.default_rng(seed)
    times_s = GRID_S * np.arange(1600)
    ramp = np.clip(np.minimum(times_s - 0.5, longest_s - times_s) / 1.5, 0.0, 1.0)
    fade = ramp * ramp * (3.0 - 2.0 * ramp)
    for _ in range(count):
        waves = [
            (random.uniform(2.0, 8.0), random.uniform(0.05, 0.2), random.uniform(0.0, 6.28))
            for _ in range(random.integers(1, 4))
        ]
        swing = sum(size * np.sin(6.283 * rate * times_s + shift) for size, rate, shift in waves)
        yield swing * fade


def test_a_segment_from_a_turning_point_begins_after_the_landing_there():
    """Otherwise the stop would be refused, and all of that part fitted again."""
    reference = Reference(start_s=0.0, position_deg=8.0 * np.sin(4.0 * GRID_S * np.arange(12000)))
    segments = list(segments_of(0, reference, LIMITS, 0.16, ()))
    assert len(segments) > 3
    for before, segment in pairwise(segments):
        first, last = before.stop
        assert first == last == segment.first
        assert segment.after_s == pytest.approx(reference.time_s(last) + GRID_S)
        assert segment.after_s <= segment.onset_s <= segment.departs_s <= segment.latest_s
    lines = []
    TimedFit([reference], [LIMITS]).moves(
        lambda: lines.append(1) or (lambda _joints, requested_us, _after_us: requested_us)
    )
    assert len(lines) == 1


def test_a_turning_point_at_which_the_line_is_late_is_no_stop():
    reference = Reference(start_s=0.0, position_deg=8.0 * np.sin(4.0 * GRID_S * np.arange(12000)))
    segments = list(segments_of(0, reference, LIMITS, 0.16, ()))
    turn_us = round(1e6 * reference.time_s(segments[1].first))
    runs = []

    def new_line():
        runs.append(len(runs))

        def grant(_joints, requested_us, _after_us):
            is_late = (requested_us > turn_us - 800_000) & (requested_us < turn_us + 30_000)
            return requested_us + 150_000 * (is_late & (len(runs) == 1))

        return grant

    moves = TimedFit([reference], [LIMITS]).moves(new_line)
    assert len(runs) == 2
    profile = profiles_from_rest(moves, [LIMITS], np.zeros(1))[0]
    times_s = np.arange(0.0, 59.0, 0.01)
    stray_deg = np.abs(profile.sample(times_s) - 8.0 * np.sin(4.0 * times_s))
    assert stray_deg[times_s > turn_us / 1e6 - 2.0].max() < 2.0 * LIMITS.tolerance_deg


def test_no_profile_runs_past_the_begin_of_a_rest():
    """One long slow move could keep the tolerance for a while after the rest began."""
    for moves, profile in all_fitted(swings(190)):
        assert moves.received_s[-1] <= 7.5
        assert moves.target_wire[-1] == 0
        assert profile.at(7.75) == (0.0, 0.0)


def test_a_steady_speed_needs_a_move_every_second_and_a_half():
    times_s = GRID_S * np.arange(2400)
    reference_deg = -80.0 + 16.0 * np.clip(times_s - 0.5, 0.0, 10.0)
    moves, _ = fitted(reference_deg)
    gaps_s = np.diff(moves.received_s)
    assert len(moves) <= 12
    assert gaps_s.max() <= SEGMENT_MAX_S + GRID_S


def test_a_standstill_needs_no_move():
    assert len(fitted(np.full(400, 12.34))[0]) == 0


def test_less_than_half_a_wire_step_needs_no_move():
    times_s = GRID_S * np.arange(400)
    assert len(fitted(0.04 * np.sin(5.0 * times_s))[0]) == 0


@pytest.mark.parametrize("law", ["cruise", "exact"])
@pytest.mark.parametrize("wire_per_deg", [10, 100])
@pytest.mark.parametrize(("scale", "most"), [(1.0, 218), (4.0, 421)])
def test_the_tolerance_is_kept_with_few_moves(scale, most, wire_per_deg, law):
    """`most`: the measured number of moves of 24 references, and two or three more."""
    limits = replace(LIMITS, wire_per_deg=wire_per_deg, response=Response(t_law=law))
    rows_deg = [scale * row_deg for row_deg in swings(24, seed=3)]
    found = all_fitted(rows_deg, limits)
    assert sum(len(moves) for moves, _ in found) <= most
    for (_, profile), row_deg in zip(found, rows_deg, strict=True):
        stray_deg = np.abs(profile.sample(GRID_S * np.arange(len(row_deg))) - row_deg)
        assert stray_deg.max() <= LIMITS.tolerance_deg + 0.002  # Rounding of the wire.


@pytest.mark.parametrize(("accel_deg_s2", "most"), [(300.0, 35), (450.0, 47), (580.0, 50)])
def test_a_reference_near_the_ramp_is_followed(accel_deg_s2, most):
    times_s = GRID_S * np.arange(1200)
    fade = np.clip(times_s / 3.0, 0.0, 1.0) ** 2
    row_deg = accel_deg_s2 / 25.0 * np.sin(5.0 * times_s) * fade
    moves, profile = fitted(row_deg)
    assert len(moves) <= most
    assert np.abs(profile.sample(times_s) - row_deg).max() <= 1.1 * LIMITS.tolerance_deg
