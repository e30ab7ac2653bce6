"""Keys with fitted angles: few, at few instants, within the tolerance, limits and range."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

from lss_motion.interchange.fitted_keys import fitted_together
from lss_motion.interchange.importing import imported
from lss_motion.interchange.reader import Channel, ForeignMotion, Measure
from lss_motion.interchange.recorded import JointLimits, Recorded, Spans
from lss_motion.interchange.reduce import ROUNDING_DEG, reduced
from lss_motion.show.load import load_sequence
from lss_motion.show.model import Interpolation
from lss_motion.show.write import write_sequence

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
        channels.append(Channel(name=name, unit=Measure.DEG, times_s=times_s, values=values))
    return ForeignMotion(
        path=Path("r.csv"), name="r", channels=tuple(channels), notes={}, is_recording=True
    )


def curve(
    values: np.ndarray, tolerance_deg: float, *, accel_max: float = np.inf, **more: object
) -> Recorded:
    """Return the curve of samples at 50 Hz, whose keys are samples."""
    return Recorded(
        times_s=np.arange(len(values)) / 50.0,
        values=values,
        wanted=values,
        key_values=values,
        speed_max_deg_s=np.full(len(values), np.inf),
        accel_max_deg_s2=np.full(len(values), accel_max),
        tolerance_deg=tolerance_deg,
        ease=Interpolation.SPLINE,
        **more,  # type: ignore[arg-type]
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
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


def monotone(times_s: np.ndarray, keys_deg: np.ndarray) -> PchipInterpolator:
    """Return the `smooth` curve: scipy's, at rest at both ends."""
    slopes = PchipInterpolator(times_s, keys_deg).derivative()(times_s)
    slopes[[0, -1]] = 0.0
    return CubicHermiteSpline(times_s, keys_deg, slopes)


def straight(times_s: np.ndarray, keys_deg: np.ndarray):
    """Return the `linear` curve: ramps of a quarter of each move, and even speed between them."""
    lengths_s = np.diff(times_s)[:, None]
    at_s = (times_s[:-1, None] + lengths_s * np.linspace(0.0, 1.0, 401)).ravel()
    speed = np.interp(np.linspace(0.0, 1.0, 401), [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, 1.0, 0.0])
    way = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])))
    deg = keys_deg[:-1, None] + np.diff(keys_deg)[:, None] * (way / way[-1])
    return lambda asked_s: np.interp(asked_s, at_s, deg.ravel())


@pytest.mark.parametrize(("ease", "made"), [("smooth", monotone), ("linear", straight)])
def test_other_eases_stay_within_the_tolerance_too(arm, tmp_path, ease: str, made) -> None:
    """Judged by scipy, and by sums of the speed, of the keys that the file holds."""
    whole = shown(7)
    result = imported(whole, arm, tolerance_deg=1.0, ease=Interpolation(ease))
    write_sequence(result.sequence, tmp_path / "r.yaml")
    keyframes = load_sequence(tmp_path / "r.yaml", robot=arm).keyframes
    for samples in whole.channels:
        own = [(k.at_s, k.deg[samples.name]) for k in keyframes if samples.name in k.deg]
        times_s, keys_deg = np.array(own).T
        inside_s = np.clip(samples.times_s, *times_s[[0, -1]])
        error_deg = np.abs(made(times_s, keys_deg)(inside_s) - samples.values)
        assert error_deg.max() <= 1.0 + 2.0 * ROUNDING_DEG


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ease", "keys_most", "keyframes_most"),
    [("spline", 220, 76), ("smooth", 222, 86), ("linear", 235, 105)],
)
def test_few_keys_are_at_few_instants(ease: str, keys_most: int, keyframes_most: int) -> None:
    """Keys at samples, each joint for itself, were 320 in 170 keyframes; 331, 178; 371, 216."""
    joints = [shown(seed).channels for seed in range(3)]
    channels = tuple(
        replace(channel, name=f"j{index}")
        for index, channel in enumerate(channel for pair in joints for channel in pair)
    )
    _, fit = reduced(replace(shown(0), channels=channels), 5.0, Interpolation(ease))
    assert fit.error_max_deg <= 5.0 + ROUNDING_DEG
    assert fit.keys_count <= keys_most
    assert fit.keyframes_count <= keyframes_most


def test_the_angles_of_a_motion_that_was_made_of_keys_are_found_again() -> None:
    times_s = np.arange(1001) / 50.0
    keys_s = np.array([0.0, 4.0, 8.0, 12.0, 16.0, 20.0])
    keys_deg = np.array([0.0, 40.0, -10.0, -15.0, 50.0, 0.0])
    values = CubicSpline(keys_s, keys_deg, bc_type="clamped")(times_s)
    (found,), (keys,) = fitted_together([curve(values, 0.5)], 1000, 0.0)
    assert len(keys) <= 2 * len(keys_s)
    spline = CubicSpline(times_s[keys], found.key_values[keys], bc_type="clamped")
    assert np.abs(spline(times_s) - values).max() <= 0.5


def test_joints_that_were_sampled_at_other_times_keep_their_own() -> None:
    one, other = shown(1).channels
    later = replace(other, times_s=other.times_s + 0.007)
    keys, fit = reduced(replace(shown(1), channels=(one, later)), 2.0, Interpolation.SPLINE)
    for own, samples in zip(keys.channels, (one, later), strict=True):
        assert np.isin(own.times_s, samples.times_s).all()
    assert fit.error_max_deg <= 2.0 + ROUNDING_DEG


def test_three_samples_whose_spline_breaks_a_limit_are_no_keys_and_no_error() -> None:
    """There are fewer spans than a curve changes in when a key moves."""
    steep = curve(np.array([0.0, 0.0, 3.0]), 0.5, accel_max=2800.0)
    steep = replace(steep, times_s=2.0 * steep.times_s, speed_max_deg_s=np.full(3, 180.0))
    assert fitted_together([steep], 4, 0.0) is None


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
    (found,), (kept,) = fitted_together([bounded], 2000, 0.0)
    assert 20 < len(kept) < 150
    assert (kept[0], kept[-1]) == (0, len(values) - 1)
    spline = CubicSpline(times_s[kept], found.key_values[kept], bc_type="clamped")
    assert np.abs(spline(times_s) - values).max() <= 1.0 + 1e-9
    finely_s = np.linspace(0.0, times_s[-1], 30_000)
    assert np.abs(spline(finely_s, 2)).max() <= accel_max * (1.0 + 1e-4)
    assert reach[0] - 1e-6 <= spline(finely_s).min() <= spline(finely_s).max() <= reach[1] + 1e-6


@pytest.mark.slow
def test_limits_that_a_recording_nearly_breaks_cost_a_spline_few_keys() -> None:
    """Before accelerations were pulled back to their limits: 160 keyframes with them, 84 without.

    The noise of the recording alone accelerates with 1,000 deg/s².
    """
    joints = [shown(seed).channels for seed in range(3)]
    channels = tuple(
        replace(channel, name=f"j{index}")
        for index, channel in enumerate(channel for pair in joints for channel in pair)
    )
    whole = replace(shown(0), channels=channels)
    most = JointLimits(speed_deg_s=360.0, accel_deg_s2=1500.0, range_deg=(-180.0, 180.0))
    limits = {channel.name: most for channel in channels}
    keys, fit = reduced(whole, 5.0, Interpolation.SPLINE, limits)
    _, free = reduced(whole, 5.0, Interpolation.SPLINE)
    assert fit.keyframes_count <= 1.1 * free.keyframes_count
    for own, samples in zip(keys.channels, channels, strict=True):
        spline = CubicSpline(own.times_s, own.values, bc_type="clamped")
        error_deg = np.abs(spline(np.clip(samples.times_s, *own.times_s[[0, -1]])) - samples.values)
        assert error_deg.max() <= 5.0 + ROUNDING_DEG


def test_a_recording_that_ends_in_motion_needs_few_keys_within_limits() -> None:
    """The stop within one sample breaks the limit in any case. Once every sample was a key."""
    times_s = np.arange(500) / 50.0
    values = 40.0 * np.sin(0.9 * times_s + 0.5)
    whole = ForeignMotion(
        path=Path("r.csv"),
        name="r",
        channels=(Channel(name="base", unit=Measure.DEG, times_s=times_s, values=values),),
        notes={},
        is_recording=True,
    )
    limits = JointLimits(speed_deg_s=180.0, accel_deg_s2=600.0, range_deg=(-90.0, 90.0))
    keys, fit = reduced(whole, 1.0, Interpolation.SPLINE, {"base": limits})
    assert fit.error_max_deg <= 1.0 + ROUNDING_DEG
    assert fit.keys_count <= 20
    (own,) = keys.channels
    inner = Spans.between(Interpolation.SPLINE, own.times_s, own.values).peaks()[1][3:-3]
    assert inner.max() <= 600.0
