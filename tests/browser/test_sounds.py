"""A sound is brought into a show by dropping it; its beats are confirmed, and a jaw follows it."""

from __future__ import annotations

import base64
import json
import re
import wave

import numpy as np
import pytest

from lss_motion.planning.shows import compiled, load
from tests.browser.test_contents import Contents
from tests.browser.test_shaping import shaping
from tests.speech import spoken

pytestmark = pytest.mark.slow

ROBOT = """\
robot: two
buses:
  main: {port: "sim://", baud_bps: 115200, firmware: 370}
joints:
  pan: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 120, accel_max_deg_s2: 500}
  jaw: {id: 2, model: LSS-ST1, range_deg: [0, 15], speed_max_deg_s: 360, accel_max_deg_s2: 1000}
"""
SHOW = "sequence: talk\nrobot: two.yaml\nkeyframes:\n  - {at_s: 0, deg: {pan: 0}}\n"
RATE_HZ = 22_050
PEAKS_S = (0.5, 0.8, 1.2, 1.5, 2.2, 2.6)


def sound(path, samples):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        file.writeframes((32767 * samples).astype("<i2").tobytes())
    return path.read_bytes()


def drop(page, name, data):
    """Drop a file on the timeline, as from the desktop."""
    page.run(
        f"(() => {{ const own = new DataTransfer(); const bytes = Uint8Array.from(atob("
        f"'{base64.b64encode(data).decode()}'), (one) => one.charCodeAt(0));"
        f"own.items.add(new File([bytes], {json.dumps(name)}));"
        "document.querySelector('.timeline').dispatchEvent(new DragEvent('drop', "
        "{ bubbles: true, cancelable: true, dataTransfer: own })); })()"
    )


@pytest.fixture
def voice(tmp_path_factory):
    path = tmp_path_factory.mktemp("sounds") / "voice.wav"
    return sound(path, spoken(PEAKS_S, 3.0, rate_hz=RATE_HZ))


def test_a_dropped_voice_becomes_sound_and_jaw(studio, opened, tmp_path, voice):
    with shaping(studio, opened, tmp_path, SHOW, ROBOT) as own:
        page = own.page
        drop(page, "voice.wav", voice)
        page.wait("document.querySelector('[aria-label=\"Beats of voice.wav\"]')")
        assert (tmp_path / "voice.wav").read_bytes() == voice
        assert own.text() == SHOW, "what it is for says the person"
        panel = Contents(own)
        panel.press("voice.wav is the sound of the show")
        own.becomes(SHOW + "sound: voice.wav\n")
        page.wait("document.querySelector('[aria-label=\"Last as long as the sound\"]')")
        panel.press("Last as long as the sound")
        page.wait("document.querySelector('[aria-label=\"Last as long as the sound\"]') === null")
        base = own.text()
        assert re.fullmatch(
            re.escape(SHOW) + r"  - \{at_s: 3(\.1)?, deg: \{pan: 0\}\}\nsound: voice.wav\n", base
        )
        panel.press("A joint follows voice.wav")
        panel.press("Let jaw follow")
        shown = base + "layers:\n  - {file: voice_jaw.yaml, joints: [jaw]}\n"
        own.becomes(shown)
        made = (tmp_path / "voice_jaw.yaml").read_text("utf-8")
        assert "# Made by: import voice.wav --robot two.yaml --joint jaw" in made
        page.wait("document.querySelector('[data-slider=\"release\"]')")
        panel.slide("open", 9)
        page.wait(
            "fetch('/text/voice_jaw.yaml').then((answer) => answer.text())"
            ".then((text) => text.includes('--open-deg 9'))"
        )
        page.key("Control+z")
        page.wait(
            "fetch('/text/voice_jaw.yaml').then((answer) => answer.text())"
            f".then((text) => text === {json.dumps(made)})"
        )
        own.text()
        page.key("Control+y")
        page.wait("!document.querySelector('.edits button:nth-child(3)').disabled")
        page.key("Control+s")
        page.wait("document.querySelector('.edits button:nth-child(3)').disabled")
        jaw = compiled(*load(own.path, None)).trajectory
        times_s = np.arange(0.0, 3.0, 0.01)
        angles = jaw.sample(times_s)[:, list(jaw.joints).index("jaw")]
        assert 6.0 < angles.max() < 9.1, "it opens as far as the slider says"
        assert all(angles[round(100 * t)] > angles.max() / 4 for t in PEAKS_S), "with each syllable"


def test_another_sound_of_that_name_is_not_overwritten_and_no_other_file_comes(
    studio, opened, tmp_path, voice
):
    with shaping(studio, opened, tmp_path, SHOW, ROBOT) as own:
        (tmp_path / "voice.wav").write_bytes(b"RIFF....WAVE mine")
        for name, data, words in (
            ("voice.wav", voice, "is not overwritten"),
            ("show.yaml", b"sequence: x", "a sound has a name"),
            ("text.wav", b"no sound at all", "is no sound"),
        ):
            drop(own.page, name, data)
            own.page.wait(
                f"document.querySelector('.banners [role=alert]')?.textContent.includes('{words}')"
            )
        assert (tmp_path / "voice.wav").read_bytes() == b"RIFF....WAVE mine"
        assert own.path.read_text("utf-8") == SHOW
        assert not (tmp_path / "text.wav").exists()
        assert not list(tmp_path.glob(".*.part*")), "nothing half is left"


def test_beats_are_a_proposal_that_a_person_takes(studio, opened, tmp_path):
    times_s = np.arange(20 * RATE_HZ) / RATE_HZ
    ticks = np.exp(-((times_s * 2.0) % 1.0) * 40.0) * np.sin(2 * np.pi * 300 * times_s)
    sound(tmp_path / "song.wav", 0.6 * ticks)
    show = SHOW + "  - {at_s: 20, deg: {pan: 30}}\nsound: song.wav\n"
    with shaping(studio, opened, tmp_path, show, ROBOT) as own:
        panel = Contents(own)
        panel.press("Beats of song.wav")
        panel.press("Take these beats")
        own.page.wait("document.querySelector('[aria-label=\"Remove the beats\"]')")
        text = own.text()
        assert text.startswith(show + "beats: [\n    ")
        assert max(map(len, text.splitlines())) <= 100
        (_, _, listed) = text.partition("beats: ")
        beats_s = json.loads(listed)
        assert np.allclose(np.diff(beats_s), 0.5, atol=0.03)
        own.page.key("Control+z")
        own.becomes(show)
