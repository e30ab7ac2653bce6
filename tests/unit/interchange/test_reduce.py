"""Recordings to keys: within the tolerance, as few as possible, as the planner plays them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.importing import imported
from lss_motion.interchange.reader import Channel, ForeignMotion, Measure
from lss_motion.interchange.recorded import (
    BSPLINE_SHIFT_MAX_DEG,
    JointLimits,
    Spans,
    bspline_values,
    interpolated,
)
from lss_motion.interchange.reduce import ROUNDING_DEG, reduced
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Interpolation, Keyframe, Sequence

EASES = (Interpolation.SPLINE, Interpolation.SMOOTH, Interpolation.LINEAR)


def recording(*curves: np.ndarray, rate_hz: float = 100.0, names=("base", "elbow", "lift")):
    return ForeignMotion(
        path=Path("r.csv"),
        name="r",
        channels=tuple(
            Channel(
                name=name,
                unit=Measure.DEG,
                times_s=np.round(np.arange(len(values)) / rate_hz, 6),
                values=values,
            )
            for name, values in zip(names, curves, strict=False)
        ),
        notes={},
        is_recording=True,
    )


def lively(seed: int, seconds: float = 20.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    times_s = np.arange(int(seconds * 100)) / 100.0
    waves = zip(rng.uniform(3, 15, 5), rng.uniform(0.05, 0.8, 5), rng.uniform(0, 6, 5), strict=True)
    curve = sum(a * np.sin(2 * np.pi * f * times_s + p) for a, f, p in waves)
    return np.round(curve + rng.normal(0.0, 0.05, len(times_s)), 1)


@pytest.mark.parametrize("ease", EASES)
@pytest.mark.parametrize("tolerance_deg", [0.3, 1.0, 5.0])
def test_keys_stay_within_the_tolerance_at_every_sample(ease, tolerance_deg: float) -> None:
    whole = recording(lively(1), lively(2))
    keys, fit = reduced(whole, tolerance_deg, ease)
    for samples, own in zip(whole.channels, keys.channels, strict=True):
        error = interpolated(ease, own.times_s, own.values, samples.times_s) - samples.values
        assert np.abs(error).max() <= tolerance_deg + ROUNDING_DEG
        assert np.isin(own.times_s, samples.times_s).all()
    assert fit.error_max_deg <= tolerance_deg + ROUNDING_DEG
    assert fit.keys_count == sum(len(channel.times_s) for channel in keys.channels)
    assert fit.samples_count == 4000
    assert keys.ease is ease


@pytest.mark.parametrize("ease", EASES)
def test_every_key_is_needed(ease) -> None:
    (samples,) = recording(lively(3)).channels
    keys, _ = reduced(recording(samples.values), 1.0, ease)
    (own,) = keys.channels
    assert len(own.times_s) < len(samples.times_s) / 4
    for left_out in range(1, len(own.times_s) - 1):
        fewer = interpolated(
            ease, np.delete(own.times_s, left_out), np.delete(own.values, left_out), samples.times_s
        )
        assert np.abs(fewer - samples.values).max() > 1.0 - ROUNDING_DEG


def taught(seed: int) -> np.ndarray:
    """Moves from rest to rest, as in a recording by hand."""
    rng = np.random.default_rng(seed)
    pieces: list[np.ndarray] = []
    here_deg = 0.0
    for _ in range(12):
        there_deg = rng.uniform(-80.0, 80.0)
        share = np.arange(int(rng.uniform(40, 200))) / 200.0
        share = share / share[-1]
        pieces.append(here_deg + (there_deg - here_deg) * share**2 * (3.0 - 2.0 * share))
        pieces.append(np.full(int(rng.uniform(30, 150)), there_deg))
        here_deg = there_deg
    curve = np.concatenate(pieces)
    return np.round(curve + rng.normal(0.0, 0.05, len(curve)), 1)


def test_a_spline_needs_fewer_keys_and_less_acceleration_for_smooth_motion(arm) -> None:
    counts, late_s = [], []
    for ease in (Interpolation.SPLINE, Interpolation.SMOOTH):
        made = imported(recording(np.minimum(1.0, np.arange(6000) / 100) * lively(4, 60.0)), arm,
                        ease=ease)  # fmt: skip
        assert made.fit is not None
        counts.append(made.fit.keys_count)
        late_s.append(plan(made.sequence, arm).duration_s - 59.99)
    assert counts[0] < 0.9 * counts[1]
    assert late_s[0] <= 0.01 + late_s[1] / 10.0


def test_moves_between_rests_need_few_keys_besides_their_ends() -> None:
    assert reduced(recording(taught(5)), 1.0, Interpolation.SMOOTH)[1].keys_count <= 2 * 24


def test_a_joint_with_noise_within_the_tolerance_has_one_key() -> None:
    still = 20.0 + 0.4 * np.sin(np.arange(1000.0))
    _, fit = reduced(recording(still), 1.0, Interpolation.SPLINE)
    assert (fit.keys_count, fit.keyframes_count) == (1, 1)


@pytest.mark.parametrize("ease", EASES)
def test_the_planner_follows_the_interpolation_that_the_error_was_measured_with(arm, ease) -> None:
    times_s = np.array([0.0, 1.0, 2.5, 3.0, 4.0, 6.0])
    values = np.array([0.0, 30.0, 40.0, 20.0, 20.0, -35.0])
    keyframes = tuple(
        Keyframe(at_s=at_s, deg={"base": deg}, ease=ease)
        for at_s, deg in zip(times_s.tolist(), values.tolist(), strict=True)
    )
    trajectory = plan(Sequence(name="s", keyframes=keyframes), arm)
    assert not trajectory.stretched
    at_s = np.linspace(0.0, 6.0, 601)
    planned = trajectory.sample(at_s)[:, 0]
    np.testing.assert_allclose(interpolated(ease, times_s, values, at_s), planned, atol=1e-6)


@pytest.mark.slow
def test_joints_share_times_if_there_are_more_times_than_keyframes(monkeypatch) -> None:
    monkeypatch.setattr("lss_motion.interchange.reduce.KEYFRAMES_MAX", 200)
    names = tuple(f"j{n}" for n in range(8))
    whole = recording(*[lively(n) for n in range(8)], names=names)
    keys, fit = reduced(whole, 1.5, Interpolation.SPLINE)
    assert fit.keys_count > 200
    assert fit.error_max_deg <= 1.5 + ROUNDING_DEG
    assert len(np.unique(np.concatenate([c.times_s for c in keys.channels]))) <= 200
    assert fit.keyframes_count <= 200


def test_a_recording_that_needs_too_many_keyframes_is_refused_with_the_error(monkeypatch) -> None:
    monkeypatch.setattr("lss_motion.interchange.reduce.KEYFRAMES_MAX", 20)
    with pytest.raises(InputError, match=r"needs more than 20 keyframes: joint 'base' would be"):
        reduced(recording(lively(8)), 0.5, Interpolation.SPLINE)


def test_a_spline_that_would_leave_the_range_is_replaced_by_a_smooth_curve(arm) -> None:
    stop = np.minimum(180.0, 120.0 + 70.0 * np.sin(np.arange(1500) / 80.0))
    made = imported(recording(stop), arm, ease=Interpolation.SPLINE)
    assert {keyframe.ease for keyframe in made.sequence.keyframes} == {Interpolation.SMOOTH}
    assert "A spline would swing joint base out of its range: smooth instead." in made.comments
    assert not np.any(plan(made.sequence, arm).sample(np.linspace(0, 14.99, 9000)) > 180.0)
    inside = imported(recording(stop - 20.0), arm, ease=Interpolation.SPLINE)
    assert inside.sequence.keyframes[0].ease is Interpolation.SPLINE


def test_tolerance_zero_keeps_every_sample(arm) -> None:
    curve = lively(9)
    made = imported(recording(curve), arm, tolerance_deg=0.0)
    assert made.fit is None
    kept_deg = np.array([keyframe.deg["base"] for keyframe in made.sequence.keyframes])
    assert len(kept_deg) == len(curve)
    assert np.abs(kept_deg - curve).max() <= BSPLINE_SHIFT_MAX_DEG


LIMITS = JointLimits(speed_deg_s=180.0, accel_deg_s2=600.0, range_deg=(-10.0, 170.0))


def bang_bang(accel_deg_s2: float = 600.0) -> np.ndarray:
    """A motion from rest to rest that is always at its acceleration limit."""
    signs = np.repeat([1, -1, -1, 1, 1, -1], [30, 30, 50, 50, 20, 20])
    speeds = np.concatenate([[0.0], np.cumsum(signs * accel_deg_s2 / 100.0)])
    return np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) / 100.0)])


def test_the_b_spline_of_the_samples_needs_no_more_acceleration_than_the_recording() -> None:
    values = bang_bang()
    times_s = np.arange(len(values)) / 100.0
    through = Spans.between(Interpolation.SPLINE, times_s, values)
    beside = bspline_values(times_s, values, BSPLINE_SHIFT_MAX_DEG)
    assert through.peaks()[1].max() > 1.1 * 600.0
    assert Spans.between(Interpolation.SPLINE, times_s, beside).peaks()[1].max() <= 600.0 + 1e-6
    assert 0.0 < np.abs(beside - values).max() <= 600.0 * 0.01**2 / 6.0 + 1e-9


def test_samples_that_would_move_too_far_are_not_moved() -> None:
    values = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
    times_s = np.arange(5) / 100.0
    np.testing.assert_array_equal(bspline_values(times_s, values, BSPLINE_SHIFT_MAX_DEG), values)
    kept = bspline_values(times_s**1.5, bang_bang()[:5], 1.0)  # Their times are uneven.
    np.testing.assert_array_equal(kept[1:-1], bang_bang()[1:4])


@pytest.mark.parametrize("tolerance_deg", [0.04, 0.5])
def test_keys_keep_the_limits_that_the_recording_keeps(tolerance_deg: float) -> None:
    whole = recording(bang_bang())
    free, _ = reduced(whole, tolerance_deg, Interpolation.SPLINE)
    kept, fit = reduced(whole, tolerance_deg, Interpolation.SPLINE, {"base": LIMITS})

    def hardest(motion: ForeignMotion) -> float:
        (own,) = motion.channels
        spans = Spans.between(Interpolation.SPLINE, own.times_s, own.values)
        return float(spans.peaks()[1].max())

    assert hardest(free) > 630.0
    assert hardest(kept) <= 600.0 * (1.0 + 1e-4)
    assert fit.error_max_deg <= tolerance_deg + ROUNDING_DEG
    assert fit.keys_count < len(bang_bang()) / 2


def test_keys_of_a_recording_at_the_end_of_its_range_stay_within_it(arm) -> None:
    low, high = arm.joints["base"].position_min_deg, arm.joints["base"].position_max_deg
    times_s = np.arange(700) / 100.0
    share = np.clip((times_s - 1.0) / 4.0, 0.0, 1.0)
    values = high * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)  # There it stays.
    free, _ = reduced(recording(values), 1.0, Interpolation.SPLINE)
    (own,) = free.channels
    assert Spans.between(Interpolation.SPLINE, own.times_s, own.values).extremes()[1].max() > high
    made = imported(recording(values), arm)
    assert not any("smooth instead" in comment for comment in made.comments)
    assert {keyframe.ease for keyframe in made.sequence.keyframes} == {Interpolation.SPLINE}
    planned_deg = plan(made.sequence, arm).sample(np.arange(8000) / 1000.0)
    assert planned_deg.max() == pytest.approx(high, abs=0.5)
    assert low - 1e-6 <= planned_deg.min() <= planned_deg.max() <= high + 1e-6
    assert made.fit is not None
    assert made.fit.keys_count < 60


def moves(seed: int, *, rate_hz: float = 50.0, duration_s: float = 20.0) -> np.ndarray:
    """A joint that moves and rests at random, faster than its limits here and there."""
    random = np.random.default_rng(seed)
    times_s = np.arange(int(duration_s * rate_hz)) / rate_hz
    values, at_s, here_deg = np.zeros(len(times_s)), random.uniform(0.0, 2.0), 0.0
    while at_s < duration_s:
        move_s, there_deg = random.uniform(0.3, 1.5), random.uniform(-60.0, 60.0)
        share = np.clip((times_s - at_s) / move_s, 0.0, 1.0)
        values += (there_deg - here_deg) * (10 * share**3 - 15 * share**4 + 6 * share**5)
        here_deg, at_s = there_deg, at_s + move_s + random.exponential(0.5)
    return np.round(values / 0.29) * 0.29


def many(count: int) -> ForeignMotion:
    times_s = np.round(np.arange(1000) / 50.0, 6)
    channels = [
        Channel(name=f"j{n}", unit=Measure.DEG, times_s=times_s, values=moves(n))
        for n in range(count)
    ]
    return ForeignMotion(
        path=Path("r.csv"), name="r", channels=tuple(channels), notes={}, is_recording=True
    )


def test_joints_share_the_times_of_their_keys() -> None:
    """With times of their own, these four joints have 136 keys in 123 keyframes."""
    whole = many(4)
    keys, fit = reduced(whole, 5.0, Interpolation.SPLINE)
    assert fit.error_max_deg <= 5.0 + ROUNDING_DEG
    assert fit.keys_count <= 140
    assert fit.keyframes_count <= 80
    for own, recorded in zip(keys.channels, whole.channels, strict=True):
        error_deg = (
            interpolated(Interpolation.SPLINE, own.times_s, own.values, recorded.times_s)
            - recorded.values
        )
        assert np.abs(error_deg).max() <= 5.0 + ROUNDING_DEG


@pytest.mark.slow
def test_where_a_recording_breaks_a_limit_the_limit_costs_few_keys() -> None:
    """The planner slows such spans down in any case; keys would not help. Once 1,146 instead."""
    whole = many(4)
    limits = {channel.name: LIMITS for channel in whole.channels}
    _, free = reduced(whole, 5.0, Interpolation.SPLINE)
    _, kept = reduced(whole, 5.0, Interpolation.SPLINE, limits)
    assert kept.keys_count <= 2 * free.keys_count
