"""Syllables, swells and sides of a sound: where they are, and files that are no help."""

import tracemalloc

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.sound.envelope import (
    MouthStyle,
    above,
    loudness,
    openings,
    sides,
    slowed,
    swell_keys,
    syllable_keys,
)
from lss_motion.sound.files import SoundPart
from tests.speech import spoken

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)
BAND_HZ = (150.0, 5000.0)
PEAKS_S = [0.3, 0.52, 0.71, 1.4, 1.66]


def written(folder, samples, rate_hz=22_050, name="a.wav", **how):
    path = folder / name
    soundfile.write(path, samples, rate_hz, **how)
    return SoundPart(path=path)


def turns_of(part, style=MouthStyle()):  # noqa: B008  (a frozen value)
    curve = loudness(part, style.band_hz)
    return syllable_keys(openings(curve, style), curve.step_s, style.opening_min)


@pytest.mark.parametrize("rate_hz", [8000, 22_050, 48_000])
def test_each_syllable_is_one_key_at_its_loudest_instant_and_pauses_are_closed(tmp_path, rate_hz):
    part = written(tmp_path, spoken(PEAKS_S, 2.2, rate_hz=rate_hz), rate_hz)
    turns = turns_of(part)
    peaks_s = [turn.at_s for turn in turns if turn.is_peak]
    assert peaks_s == pytest.approx(PEAKS_S, abs=0.006)
    rests = [turn for turn in turns if turn.hold_s > 0.1]
    assert [turn.ratio for turn in rests] == [0.0, 0.0, 0.0]
    assert (rests[0].at_s, rests[1].at_s) == pytest.approx((0.0, 0.8), abs=0.06)
    assert turns[-1].at_s + turns[-1].hold_s == pytest.approx(2.2, abs=0.006)


def test_a_soft_syllable_opens_as_far_as_wanted_and_hum_does_not_count(tmp_path):
    soft = spoken([0.3, 1.1], 1.6) + spoken([0.7], 1.6, loud=0.04)
    soft += 0.3 * np.sin(2.0 * np.pi * 50.0 * np.arange(len(soft)) / 22_050)
    part = written(tmp_path, soft)
    ratios = {round(turn.at_s, 1): turn.ratio for turn in turns_of(part) if turn.is_peak}
    assert ratios.keys() == {0.3, 1.1}, "below the prominence it is none"
    louder = turns_of(part, MouthStyle(gain_db=6.0, opening_min=0.4))
    ratios = {round(turn.at_s, 1): turn.ratio for turn in louder if turn.is_peak}
    assert ratios[0.7] == 0.4
    assert ratios[0.3] == pytest.approx(1.0)
    none = turns_of(part, MouthStyle(gain_db=6.0, threshold_db=-12.0))
    assert len([turn for turn in none if turn.is_peak]) == 2


def test_a_part_and_a_channel_are_analysed_alone(tmp_path):
    both = np.stack([spoken([0.3, 1.1], 1.6), spoken([0.7], 1.6)], axis=1)
    path = written(tmp_path, both).path

    def peaks_s(**part):
        return [turn.at_s for turn in turns_of(SoundPart(path=path, **part)) if turn.is_peak]

    assert peaks_s(channel="left") == pytest.approx([0.3, 1.1], abs=0.006)
    assert peaks_s(channel=2) == pytest.approx([0.7], abs=0.006)
    assert peaks_s(from_s=0.5, to_s=1.6) == pytest.approx([0.2, 0.6], abs=0.006)
    with pytest.raises(InputError, match="has no channel 3; it has 2"):
        loudness(SoundPart(path=path, channel=3), BAND_HZ)
    with pytest.raises(InputError, match="has no sound from 2 s to its end: it is 1"):
        loudness(SoundPart(path=path, from_s=2.0), BAND_HZ)


def test_opening_and_closing_take_their_time_and_no_peak_moves():
    values = np.zeros(200)
    values[100], values[110] = 1.0, 0.4
    found = above(values, 0.01, 10.0, 2.0)
    assert np.diff(found).max() == pytest.approx(0.1)
    assert np.diff(found).min() == pytest.approx(-0.02)
    assert (found >= values).all()
    assert found.argmax() == 100


def test_a_slowed_curve_keeps_its_speed_and_is_as_close_as_can_be():
    rng = np.random.default_rng(4)
    values = np.cumsum(rng.normal(0.0, 0.05, 500))
    found = slowed(values, 0.01, 1.5)
    assert np.abs(np.diff(found)).max() <= 0.015 + 1e-12
    # No curve with that speed is closer than half of what two samples exceed it by.
    gaps = np.abs(values[:, None] - values) - 0.015 * np.abs(
        np.subtract.outer(range(500), range(500))
    )
    assert np.abs(found - values).max() == pytest.approx(0.5 * gaps.max())


def test_swells_are_the_ends_and_the_turns():
    times_s = np.linspace(0.0, 4.0, 401)
    turns = swell_keys(0.5 - 0.5 * np.cos(np.pi * times_s), 0.01, 0.1)
    assert [turn.at_s for turn in turns] == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0])
    assert [turn.ratio for turn in turns] == pytest.approx([0.0, 1.0, 0.0, 1.0, 0.0], abs=1e-9)


def test_the_side_is_where_the_sound_comes_from_and_the_middle_in_pauses(tmp_path):
    voice, silence = spoken([0.2, 0.4, 0.6, 0.8], 1.0), np.zeros(22_050)
    left, right = (
        np.concatenate(p) for p in ((voice, silence, silence), (silence, silence, voice))
    )
    step_s, side = sides(written(tmp_path, np.stack([left, right], axis=1)), BAND_HZ, 0.1)
    at = [side[round(at_s / step_s)] for at_s in (0.5, 1.5, 2.5)]
    assert at == pytest.approx([0.0, 0.5, 1.0], abs=0.05)
    with pytest.raises(InputError, match="has one channel, so there is no left one"):
        sides(written(tmp_path, voice, name="mono.wav"), BAND_HZ, 0.1)


def test_silence_is_refused_and_what_is_no_sound(tmp_path):
    with pytest.raises(InputError, match="is silent between 150 and 5000 Hz"):
        loudness(written(tmp_path, np.zeros(4000)), BAND_HZ)
    (tmp_path / "b.wav").write_bytes(b"RIFF not a sound")
    with pytest.raises(InputError, match="is not a sound that can be read"):
        loudness(SoundPart(path=tmp_path / "b.wav"), BAND_HZ)


def test_eight_channels_at_192_khz_take_no_more_memory_than_a_few_pieces(tmp_path):
    path = tmp_path / "long.wav"
    noise = np.random.default_rng(1).normal(0.0, 0.1, (192_000, 8)).astype(np.float32)
    with soundfile.SoundFile(path, "w", 192_000, 8, subtype="PCM_16") as file:
        for _ in range(6):
            file.write(noise)
    loudness(SoundPart(path=path, to_s=0.1), BAND_HZ)  # Imports are none of it.
    tracemalloc.start()
    curve = loudness(SoundPart(path=path, channel=8), BAND_HZ)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(curve.level) == 1201
    assert peak_bytes < 15e6, "six seconds of it are 37 MB"
