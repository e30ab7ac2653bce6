"""Fitted values of spline keys: fewer keys, and still within the tolerance, limits and range."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from lss_motion.interchange import Channel, ForeignMotion, Unit, imported, reduced
from lss_motion.interchange.fitted_keys import fitted_keys
from lss_motion.interchange.reduce import (
    ROUNDING_DEG,
    Curve,
    Limits,
    Spans,
    refined_keys,
    rough_keys,
)
from lss_motion.sequence.load import load_sequence
from lss_motion.sequence.model import Interpolation
from lss_motion.sequence.write import write_sequence

JOINTS = ("base", "elbow")


def shown(seed: int, rate_hz: float = 50.0, duration_s: float = 25.0) -> ForeignMotion:
    """Return what a hand shows: moves and rests of two joints, in motion at both ends, noisy."""
    random = np.random.default_rng(seed)
    times_s = np.round(np.arange(int(duration_s * rate_hz)) / rate_hz, 6)
    channels = []
    for name in JOINTS:
        values = np.zeros(len(times_s))
        at_s, here_deg = random.uniform(-1.0, 1.0), 0.0
        while at_s < duration_s:
            move_s, there_deg = random.uniform(0.4, 1.5), random.uniform(-60.0, 60.0)
            share = np.clip((times_s - at_s) / move_s, 0.0, 1.0)
            values += (there_deg - here_deg) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
            here_deg, at_s = there_deg, at_s + move_s + random.exponential(0.3)
        values += 5.0 * np.sin(2.0 * np.pi * random.uniform(0.2, 0.9) * times_s)
        values = np.round(values + random.normal(0.0, 0.1, len(values)), 1)
        channels.append(Channel(name=name, unit=Unit.DEG, times_s=times_s, values=values))
    return ForeignMotion(
        path=Path("r.csv"), name="r", channels=tuple(channels), notes={}, is_recording=True
    )


def curve(
    values: np.ndarray, tolerance_deg: float, *, accel_max: float = np.inf, **more: object
) -> Curve:
    """Return the curve of samples at 50 Hz, whose keys are samples."""
    return Curve(
        times_s=np.arange(len(values)) / 50.0,
        values=values,
        key_values=values,
        speed_max_deg_s=np.full(len(values), np.inf),
        accel_max_deg_s2=np.full(len(values), accel_max),
        tolerance_deg=tolerance_deg,
        ease=Interpolation.SPLINE,
        **more,  # type: ignore[arg-type]
    )


def as_samples(monkeypatch: pytest.MonkeyPatch, motion: ForeignMotion, tolerance_deg: float):
    """Return the reduction whose keys are all samples."""
    with monkeypatch.context() as patch:
        patch.setattr(
            "lss_motion.interchange.reduce.fitted_keys", lambda c, keys, _margin: (c, keys)
        )
        return reduced(motion, tolerance_deg, Interpolation.SPLINE)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("tolerance_deg", [0.5, 2.0, 5.0])
def test_the_written_keys_stay_within_the_tolerance_at_every_sample(
    arm, tmp_path, seed: int, tolerance_deg: float
) -> None:
    """Judged by scipy's spline through the keys that the file holds."""
    whole = shown(seed)
    made = imported(whole, arm, tolerance_deg=tolerance_deg)
    write_sequence(made.sequence, tmp_path / "r.yaml")
    keyframes = load_sequence(tmp_path / "r.yaml", robot=arm).keyframes
    assert {keyframe.ease for keyframe in keyframes} == {Interpolation.SPLINE}
    assert all(a.at_s < b.at_s for a, b in pairwise(keyframes))
    for samples in whole.channels:
        own = [(k.at_s, k.deg[samples.name]) for k in keyframes if samples.name in k.deg]
        times_s, keys_deg = np.array(own).T
        assert np.isin(times_s, samples.times_s).all()
        spline = CubicSpline(times_s, keys_deg, bc_type="clamped")
        error_deg = np.abs(spline(np.clip(samples.times_s, *times_s[[0, -1]])) - samples.values)
        assert error_deg.max() <= tolerance_deg + ROUNDING_DEG


def test_fitted_values_need_fewer_keys_at_the_times_that_the_joints_share(monkeypatch) -> None:
    fewer, all_of_them = [], []
    for seed in range(4):
        whole = shown(seed)
        fitted, fit = reduced(whole, 5.0, Interpolation.SPLINE)
        plain, plain_fit = as_samples(monkeypatch, whole, 5.0)
        for own, before in zip(fitted.channels, plain.channels, strict=True):
            assert np.isin(own.times_s, before.times_s).all()
        assert fit.keyframes_count <= plain_fit.keyframes_count
        fewer.append(fit.keys_count)
        all_of_them.append(plain_fit.keys_count)
    assert sum(fewer) <= 0.88 * sum(all_of_them)


def test_where_no_key_can_be_removed_no_value_changes() -> None:
    share = np.linspace(0.0, 1.0, 51)
    there = 60.0 * share**2 * (3.0 - 2.0 * share)
    up_and_down = curve(np.concatenate([there, there[-2::-1]]), 0.5)
    keys = np.array([0, 50, 100])
    assert up_and_down.fits(keys)
    found, kept = fitted_keys(up_and_down, keys, 0.0)
    assert found is up_and_down
    assert kept is keys


def test_keys_that_do_not_fit_stay_as_they_are() -> None:
    (samples, _) = shown(1).channels
    wild = curve(samples.values, 0.5)
    keys = np.array([0, 300, 600, 900, len(samples.values) - 1])
    assert fitted_keys(wild, keys, 0.0) == (wild, keys)


@pytest.mark.parametrize("seed", range(4))
def test_fitted_splines_keep_the_acceleration_and_the_range(seed: int) -> None:
    random = np.random.default_rng(seed)
    times_s = np.arange(1500) / 50.0
    fade = np.clip(np.minimum(times_s, times_s[-1] - times_s) - 0.6, 0.0, 1.0)
    waves = sum(
        random.uniform(5, 20) * np.sin(2 * np.pi * random.uniform(0.1, 0.7) * times_s + phase)
        for phase in random.uniform(0.0, 6.0, 4)
    )
    values = np.clip(fade**2 * (3.0 - 2.0 * fade) * waves, -40.0, 40.0)
    bell = np.hanning(51)
    values = np.convolve(np.pad(values, 25, "edge"), bell / bell.sum(), "valid")
    accel_max = 1.1 * np.abs(np.diff(values, 2)).max() * 50.0**2
    reach = (float(values.min()) - 0.1, float(values.max()) + 0.1)
    bounded = curve(values, 1.0, accel_max=accel_max, range_deg=reach)
    keys = refined_keys(bounded, rough_keys(bounded))
    assert bounded.fits(keys)
    found, kept = fitted_keys(bounded, keys, 0.0)
    assert len(kept) < len(keys)
    assert np.isin(kept, keys).all()
    assert (kept[0], kept[-1]) == (keys[0], keys[-1])
    spline = CubicSpline(times_s[kept], found.key_values[kept], bc_type="clamped")
    assert np.abs(spline(times_s) - values).max() <= 1.0 + 1e-9
    finely_s = np.linspace(0.0, times_s[-1], 30_000)
    assert np.abs(spline(finely_s, 2)).max() <= accel_max * (1.0 + 1e-4)
    assert reach[0] - 1e-6 <= spline(finely_s).min() <= spline(finely_s).max() <= reach[1] + 1e-6


def test_a_recording_that_ends_in_motion_needs_few_keys_within_limits() -> None:
    """The stop within one sample breaks the limit in any case. Once every sample was a key."""
    times_s = np.arange(500) / 50.0
    values = 40.0 * np.sin(0.9 * times_s + 0.5)
    whole = ForeignMotion(
        path=Path("r.csv"),
        name="r",
        channels=(Channel(name="base", unit=Unit.DEG, times_s=times_s, values=values),),
        notes={},
        is_recording=True,
    )
    limits = Limits(speed_deg_s=180.0, accel_deg_s2=600.0, range_deg=(-90.0, 90.0))
    keys, fit = reduced(whole, 1.0, Interpolation.SPLINE, {"base": limits})
    assert fit.error_max_deg <= 1.0 + ROUNDING_DEG
    assert fit.keys_count <= 20
    (own,) = keys.channels
    inner = Spans.between(Interpolation.SPLINE, own.times_s, own.values).peaks()[1][3:-3]
    assert inner.max() <= 600.0
