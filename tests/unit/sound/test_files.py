import re
import sys

import numpy as np
import pytest

from lss_motion.errors import InputError, install_command
from lss_motion.sound.files import SoundReader, sound_info

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)

RATE_HZ = 22050


def chirp(seconds=3.0, rate_hz=RATE_HZ):
    times_s = np.arange(round(seconds * rate_hz)) / rate_hz
    return 0.5 * np.sin(2.0 * np.pi * (150.0 * times_s + 200.0 * times_s**2))


@pytest.mark.parametrize("suffix", ["wav", "flac", "ogg", "mp3"])
def test_every_position_is_exact_to_the_frame(tmp_path, suffix):
    path, wave = tmp_path / f"a.{suffix}", chirp()
    soundfile.write(path, wave, RATE_HZ)
    assert sound_info(path).duration_s == pytest.approx(3.0)
    with SoundReader(path) as reader:
        for frame in (0, 40001, 12345, 40001, 13000):
            piece = reader.read_at(frame, 500)
            assert piece.shape == (500, 2)
            assert np.abs(piece[:, 0] - wave[frame : frame + 500]).max() < 0.06
        assert len(reader.read_at(len(wave) - 7, 500)) == 7
        assert len(reader.read_at(len(wave) + 7, 500)) == 0


def test_channels_of_a_surround_file_are_mixed_to_two_sides(tmp_path):
    path = tmp_path / "eight.wav"
    soundfile.write(path, np.tile([0.8, 0.4] * 4, (100, 1)), 192_000, subtype="FLOAT")
    with SoundReader(path) as reader:
        assert (reader.info.channels, reader.info.rate_hz) == (8, 192_000)
        assert np.allclose(reader.read_at(0, 100), [0.8, 0.4])
    soundfile.write(path, np.full(100, 0.3), RATE_HZ, subtype="FLOAT")
    with SoundReader(path) as reader:
        assert np.allclose(reader.read_at(0, 100), [0.3, 0.3])


def test_samples_that_are_no_numbers_are_silent(tmp_path):
    path = tmp_path / "nan.wav"
    soundfile.write(path, np.array([0.5, np.nan, np.inf, -np.inf]), RATE_HZ, subtype="FLOAT")
    with SoundReader(path) as reader:
        assert reader.read_channels(0, 9)[:, 0].tolist() == [0.5, 0.0, 1.0, -1.0]


def bad_files(folder):
    (folder / "text.wav").write_text("this is no sound")
    (folder / "nothing.mp3").write_bytes(b"")
    (folder / "folder.ogg").mkdir()
    soundfile.write(folder / "silent.wav", np.zeros(0), RATE_HZ)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("text.wav", "is not a sound that can be read; WAV, FLAC, OGG or MP3 can"),
        ("nothing.mp3", "is empty"),
        ("folder.ogg", "is no file"),
        ("silent.wav", "holds no sound"),
        ("absent.wav", "not found"),
    ],
)
def test_what_is_no_sound_is_refused_with_its_name_and_reason(tmp_path, name, reason):
    bad_files(tmp_path)
    with pytest.raises(InputError, match=rf"{name}: .*{reason}"):
        sound_info(tmp_path / name)


def test_without_the_extra_the_error_has_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "soundfile", None)
    with pytest.raises(InputError, match=re.escape(install_command("sound"))):
        sound_info(tmp_path / "a.wav")
