"""Linear timecode against libltc, an independent program: both ways."""

from __future__ import annotations

import numpy as np
import pytest

from benches.libltc import STANDARDS, made_by_libltc, missing, read_by_libltc
from lss_motion.stage.timecode.ltc import LtcDecoder, sound_of
from lss_motion.stage.timecode.timecode import Timecode, timecode_of

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing() or "it is there")


def noisy(sound, seed):
    """The sound as it may come: of some level, polarity and offset, and with noise."""
    luck = np.random.default_rng(seed)
    level = luck.choice([-1, 1]) * luck.uniform(0.2, 0.9)
    noise = luck.normal(0.0, 0.05, len(sound))
    return (level * sound + noise + luck.uniform(-0.05, 0.05)).astype(np.float32)


def decoded(sound, rate_hz, block=512):
    decoder = LtcDecoder(rate_hz)
    sound = np.concatenate([sound, np.zeros(rate_hz // 50)])
    return [
        frame
        for start in range(0, len(sound), block)
        for frame in decoder.take(sound[start : start + block])
    ]


@pytest.mark.parametrize("rate_hz", [44100, 48000])
@pytest.mark.parametrize("rate", STANDARDS, ids=lambda rate: rate.name)
def test_what_libltc_makes_is_read_with_noise_at_its_place(rate, rate_hz):
    first = Timecode(0, 8, 59, 10).frame(rate)
    labels = [timecode_of(first + number, rate) for number in range(60)]
    sound = noisy(made_by_libltc(labels, rate, rate_hz), seed=rate_hz + rate.labels)
    frames = decoded(sound, rate_hz)
    read = {frame.timecode: frame for frame in frames}
    assert len(frames) == len(read)
    assert set(read) <= set(labels)
    missing = [number for number, label in enumerate(labels) if label not in read]
    assert all(number == 0 or number > 57 for number in missing), missing
    assert {frame.is_drop for frame in frames} == {rate.is_drop}
    samples = rate_hz / rate.frames_per_s
    off = [read[label].at - (n + 1) * samples for n, label in enumerate(labels) if label in read]
    assert np.abs(off).max() < 0.0001 * rate_hz, "within 0.1 ms"
    measured = np.median([frame.frame_samples for frame in frames[2:]])
    assert rate_hz / measured == pytest.approx(rate.frames_per_s, rel=1e-3)


@pytest.mark.parametrize("rate", STANDARDS, ids=lambda rate: rate.name)
def test_libltc_reads_what_is_made_here_forward_and_backward(rate):
    rate_hz = 48000
    start = timecode_of(Timecode(9, 59, 59, 10).frame(rate), rate)
    sound = 0.5 * sound_of(start, rate, 50, rate_hz)
    labels = [timecode_of(start.frame(rate) + number, rate) for number in range(50)]
    for is_reverse, made in ((False, sound), (True, sound[::-1])):
        read = read_by_libltc(made, rate, rate_hz)
        assert {label for label, *_ in read} <= set(labels)
        assert len(read) >= 47
        assert {is_drop for _, is_drop, _, _ in read} == {rate.is_drop}
        assert {way for _, _, way, _ in read} == {is_reverse}
        own = decoded(noisy(made, seed=4), rate_hz)
        assert len(own) >= 48
        assert {frame.timecode for frame in own} <= set(labels)
        assert {frame.is_reverse for frame in own} == {is_reverse}
