import random

import pytest

from lss_motion.sound.device import DeviceClock

RATE_HZ = 48000
BLOCK = 480


def driven(seconds, *, ppm=0.0, jitter_s=0.0, seed=1, skip_at_s=None, ratio=1.0, clock=None):
    """Return a clock that was told of each block of a device, and when the last frame sounded."""
    clock, rng = clock or DeviceClock(RATE_HZ), random.Random(seed)
    heard_s, skipped_s = 0.0, 0.0
    for frame in range(0, round(seconds * RATE_HZ), BLOCK):
        if skip_at_s is not None and not skipped_s and frame >= skip_at_s * RATE_HZ:
            skipped_s = 0.03
        heard_s = frame / RATE_HZ / ratio / (1.0 + ppm * 1e-6) + skipped_s
        stated_s = heard_s + rng.uniform(-jitter_s, jitter_s)
        clock.take(frame, 7_000_000_000 + round(stated_s * 1e9))
    return clock, frame, 7_000_000_000 + heard_s * 1e9


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 150.0])
def test_a_crystal_that_is_off_is_measured_through_the_jitter_of_the_driver(ppm):
    clock, frame, heard_ns = driven(60.0, ppm=ppm, jitter_s=0.002)
    assert (clock.rate_ratio - 1.0) * 1e6 == pytest.approx(ppm, abs=12.0)
    assert clock.heard_ns(frame) == pytest.approx(heard_ns, abs=300_000)
    assert clock.wrong_ratio is None
    assert clock.skips == 0


def test_the_first_seconds_are_right_although_the_slope_is_not_known():
    clock, frame, heard_ns = driven(5.0, ppm=100.0, jitter_s=0.001)
    assert clock.heard_ns(frame) == pytest.approx(heard_ns, abs=500_000)


def test_the_first_second_is_not_settled():
    for seconds, is_settled in ((0.9, False), (1.1, True)):
        clock, frame, _ = driven(seconds)
        assert clock.is_settled(frame) is is_settled


def test_skipped_frames_are_noticed_and_the_fit_begins_anew():
    clock, frame, heard_ns = driven(20.0, skip_at_s=12.0, jitter_s=0.0005)
    assert clock.skips == 1
    assert clock.wrong_ratio is None
    assert clock.heard_ns(frame) == pytest.approx(heard_ns, abs=500_000)


@pytest.mark.parametrize(("is_reported", "wait_s"), [(True, 0.26), (False, 0.51)])
def test_a_skip_that_the_driver_reports_is_taken_over_sooner(is_reported, wait_s):
    clock, frame, _ = driven(12.0, jitter_s=0.0005)
    if is_reported:
        clock.note_dropout()
    for later in range(frame + BLOCK, frame + round((wait_s + 0.02) * RATE_HZ), BLOCK):
        assert clock.skips == 0 or later > frame + (wait_s - 0.02) * RATE_HZ
        clock.take(later, 7_000_000_000 + round((later / RATE_HZ + 0.01) * 1e9))
    assert clock.skips == 1
    assert clock.heard_ns(later) == pytest.approx(7e9 + (later / RATE_HZ + 0.01) * 1e9, abs=1e5)


@pytest.mark.parametrize("ratio", [0.91, 1.01])
def test_a_device_that_does_not_run_at_its_rate_is_named(ratio):
    clock, frame, heard_ns = driven(6.0, ratio=ratio)
    assert clock.wrong_ratio == pytest.approx(ratio, abs=1e-3)
    assert clock.heard_ns(frame) == pytest.approx(heard_ns, abs=1e6)
