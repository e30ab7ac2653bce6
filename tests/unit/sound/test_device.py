"""Sound devices as PortAudio lists them, without one in this computer."""

from __future__ import annotations

import os
import sys
from types import SimpleNamespace

import pytest

from lss_motion.cli.main import main
from lss_motion.sound import device

NOISE = b"ALSA lib pcm_dsnoop.c:601:(snd_pcm_dsnoop_open) unable to open slave\n"
FOUND = {
    "name": "speaker",
    "hostapi": 0,
    "max_output_channels": 2,
    "max_input_channels": 0,
    "default_samplerate": 48000.0,
    "default_low_output_latency": 0.01,
}


def noisy(value):
    """Return a function that returns a value, and prints as a driver does."""

    def call(*_args, **_more):
        os.write(2, NOISE)
        return value

    return call


@pytest.fixture
def alsa(monkeypatch):
    """PortAudio on a computer where ALSA tries devices that are not there."""
    fake = SimpleNamespace(
        default=SimpleNamespace(device=[0, 0]),
        query_hostapis=noisy([{"name": "ALSA"}]),
        query_devices=noisy([FOUND]),
        PortAudioError=RuntimeError,
    )
    monkeypatch.setitem(sys.modules, "sounddevice", fake)
    return fake


@pytest.mark.parametrize("words", [["devices"], ["devices", "--json"], ["doctor"]])
@pytest.mark.usefixtures("alsa")
def test_what_drivers_try_is_not_seen(words, capfd):
    assert main(words) == 0
    assert "ALSA lib" not in capfd.readouterr().err


@pytest.mark.usefixtures("alsa")
def test_standard_error_is_open_again_afterwards(capfd):
    assert [found.name for found in device.devices()] == ["speaker"]
    os.write(2, b"heard\n")
    assert capfd.readouterr().err == "heard\n"
