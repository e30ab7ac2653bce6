"""What a device would play, judged by its frames."""

import time

import numpy as np
import pytest

from benches.sound import hour_off_s
from lss_motion.sound.mixer import Mixer, PrefetchedSound, Voice
from lss_motion.system.clock_leg import ClockLeg

soundfile = pytest.importorskip(
    "soundfile", reason="sound files: pip install 'lss-motion[sound]'", exc_type=ImportError
)

RATE_HZ = 8000
BLOCK = 256
START_NS = 10_000_000_000
NS_PER_FRAME = 1e9 / RATE_HZ


def wave_file(folder, wave, rate_hz=RATE_HZ, name="a.wav"):
    path = folder / name
    soundfile.write(path, np.asarray(wave), rate_hz, subtype="FLOAT")
    return path


def tone(seconds, rate_hz=RATE_HZ, hz=100.0):
    return 0.5 * np.sin(2.0 * np.pi * hz * np.arange(round(seconds * rate_hz)) / rate_hz)


def ramp(seconds, rate_hz=RATE_HZ):
    """Return a sound whose value is its own time, so that its place can be read."""
    return np.arange(round(seconds * rate_hz)) / rate_hz / 10.0


class MixerDesk:
    """A device that plays block after block; the first frame sounds at `START_NS`."""

    def __init__(self, *voices, ns_per_frame=NS_PER_FRAME):
        self.mixer = Mixer(RATE_HZ)
        self.mixer.voices += voices
        self.ns_per_frame = ns_per_frame
        self.played = np.zeros(0)

    def wait(self, heard_ns):
        """Wait until what is due is read: a device that is no device is faster than its reader."""
        for voice in self.mixer.voices:
            show_s = self.mixer.legs[-1].show_s(heard_ns) if self.mixer.legs else 0.0
            place = voice.frame
            if place is None:
                place = max(show_s - voice.at_s, 0.0) * RATE_HZ
            if voice.is_looped:
                place %= voice.source.frames
            voice.source.want(place, wraps=voice.is_looped)
            end_s = time.monotonic() + 10.0
            while not voice.source.is_ready(place, 4 * BLOCK) and time.monotonic() < end_s:
                time.sleep(0.0005)

    def leg(self, at_s, from_rate=1.0, to_rate=1.0, over_s=0.0, start_s=None):
        before = self.mixer.legs[-1] if self.mixer.legs else None
        start_ns = START_NS + round(at_s * 1e9)
        if start_s is None:
            start_s = before.show_s(start_ns) if before else 0.0
        self.mixer.set_leg(ClockLeg(start_ns, start_s, from_rate, to_rate, round(over_s * 1e9)))

    def play(self, until_s):
        blocks = [self.played]
        frame = len(self.played)
        while frame < until_s * RATE_HZ:
            heard_ns = START_NS + frame * self.ns_per_frame
            self.wait(heard_ns)
            blocks.append(self.mixer.render(heard_ns, self.ns_per_frame, BLOCK)[:, 0])
            frame += BLOCK
        self.played = np.concatenate(blocks)
        return self.played

    def at(self, at_s):
        return self.played[round(at_s * RATE_HZ)]


def test_a_sound_is_placed_again_where_the_device_has_skipped_frames(tmp_path):
    """Without that the show would follow by 300 ppm, for half a minute."""
    source = PrefetchedSound(wave_file(tmp_path, ramp(6.0)), RATE_HZ)
    desk = MixerDesk(Voice(number=1, source=source, at_s=0.0, is_bed=True))
    desk.leg(0.0)
    desk.play(2.0)
    mixer, frame = desk.mixer, len(desk.played)
    late_ns = 0.01e9
    blocks = []
    for first in range(frame, frame + RATE_HZ, BLOCK):
        heard_ns = START_NS + first * NS_PER_FRAME + late_ns
        desk.wait(heard_ns)
        blocks.append(mixer.render(heard_ns, NS_PER_FRAME, BLOCK)[:, 0])
    played = np.concatenate(blocks)
    at_s = (frame + np.arange(len(played))) / RATE_HZ + 0.01
    assert np.abs(np.diff(played)).max() < 0.01, "no click"
    settled = at_s > 2.25
    assert 10.0 * played[settled] == pytest.approx(at_s[settled], abs=0.001)


def voice(path, at_s=0.0, **values):
    return Voice(number=1, source=PrefetchedSound(path, RATE_HZ), at_s=at_s, **values)


def test_the_first_frame_sounds_at_its_instant_with_its_full_strength(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, np.full(800, 0.7)), at_s=0.6))
    desk.leg(0.25)  # The show begins at 0.25 s of the device.
    played = desk.play(1.2)
    first = int(np.nonzero(played)[0][0])
    assert first == round(0.85 * RATE_HZ)
    assert np.allclose(played[first : first + 800], 0.7)
    assert not played[first + 800 :].any()


def test_a_pause_fades_and_goes_on_where_it_was_without_a_click(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, tone(10.0))))
    desk.leg(0.2)
    desk.play(1.0)
    desk.leg(1.0, 1.0, 0.0, 0.3)
    desk.play(2.0)
    desk.leg(2.0, 0.0, 1.0, 0.3)
    played = desk.play(4.0)
    assert not played[round(1.15 * RATE_HZ) : round(2.0 * RATE_HZ)].any()
    step = 0.5 * 2.0 * np.pi * 100.0 / RATE_HZ + 1.0 / (0.05 * RATE_HZ)
    assert np.abs(np.diff(played)).max() < step
    # 0.8 s before the ramps, 0.15 s in each: at 3.0 s of the device 1.8 s of the show.
    shown_s = 0.8 + 0.15 + 0.15 + (np.arange(len(played)) / RATE_HZ - 2.3)
    late = slice(round(2.6 * RATE_HZ), None)
    assert np.abs(played[late] - 0.5 * np.sin(2.0 * np.pi * 100.0 * shown_s[late])).max() < 0.04


def test_a_rate_near_1_is_resampled_and_another_is_mute(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, ramp(9.0))))
    desk.leg(0.1)
    desk.play(1.0)
    desk.leg(1.0, 1.0, 0.97, 0.1)
    desk.play(2.0)
    show_s = desk.mixer.legs[-1].show_s(START_NS + 2_000_000_000)
    assert 10.0 * desk.at(1.99) == pytest.approx(show_s - 0.0097, abs=1e-3)
    desk.leg(2.0, 0.97, 0.8, 0.1)
    played = desk.play(3.0)
    assert not played[round(2.2 * RATE_HZ) :].any()
    desk.leg(3.0, 0.8, 1.0, 0.1)
    desk.play(4.0)
    show_s = desk.mixer.legs[-1].show_s(START_NS + 3_900_000_000)
    assert 10.0 * desk.at(3.9) == pytest.approx(show_s, abs=1e-3)


def test_a_show_that_starts_in_the_middle_fades_into_its_sounds(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, np.full(16000, 0.6))))
    desk.leg(0.0, 0.0, 1.0, 0.3, start_s=1.0)
    played = desk.play(1.0)
    assert np.abs(np.diff(played)).max() < 1.1 * 0.6 / (0.05 * RATE_HZ)
    assert played[-1] == pytest.approx(0.6)


def test_a_bed_ends_with_its_pass_and_ducks_below_another_sound(tmp_path):
    flat = wave_file(tmp_path, np.full(80000, 0.4))
    short = wave_file(tmp_path, np.zeros(4000), name="b.wav")
    desk = MixerDesk(
        voice(flat, is_bed=True, until_s=2.0),
        voice(short, at_s=1.0, duck_ratio=0.25, gain_ratio=1.0),
    )
    desk.leg(0.1)
    played = desk.play(3.0)
    assert desk.at(1.0) == pytest.approx(0.4)
    assert desk.at(1.4) == pytest.approx(0.1)
    assert desk.at(1.8) == pytest.approx(0.4)
    assert 0.1 < desk.at(2.08) < 0.3
    assert not played[round(2.1 * RATE_HZ) + 1 :].any()
    assert np.abs(np.diff(played))[2000:].max() < 2.0 / (0.05 * RATE_HZ)


def test_a_looped_sound_has_no_seam(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, tone(0.5)), is_looped=True))
    desk.leg(0.0)
    played = desk.play(2.3)
    times_s = np.arange(len(played)) / RATE_HZ
    late = times_s > 0.1
    assert np.abs(played - 0.5 * np.sin(2.0 * np.pi * 100.0 * times_s))[late].max() < 1e-5


def test_an_offset_makes_all_later_at_once(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, ramp(9.0))))
    desk.leg(0.0)
    desk.play(1.0)
    desk.mixer.set_offset(0.25)
    desk.play(2.0)
    assert 10.0 * desk.at(0.9) == pytest.approx(0.9, abs=1e-3)
    assert 10.0 * desk.at(1.9) == pytest.approx(1.65, abs=1e-3)


def test_a_file_of_another_rate_keeps_its_time_and_its_tone(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, tone(2.0, 44100, 440.0), 44100)))
    desk.leg(0.0)
    played = desk.play(1.9)
    times_s = np.arange(len(played)) / RATE_HZ
    inside = (times_s > 0.1) & (times_s < 1.8)
    wanted = 0.5 * np.sin(2.0 * np.pi * 440.0 * times_s)
    assert np.abs(played - wanted)[inside].max() < 2e-3


def test_a_sound_that_does_not_lead_stays_with_the_show_on_a_device_that_is_off(tmp_path):
    off = NS_PER_FRAME / (1.0 + 200e-6)
    desk = MixerDesk(voice(wave_file(tmp_path, ramp(70.0))), ns_per_frame=off)
    desk.mixer.leads = False
    desk.leg(0.0)
    blocks = desk.play(9.0)
    heard_s = np.arange(len(blocks)) * off / 1e9
    assert np.abs(10.0 * blocks - heard_s)[RATE_HZ:].max() < 3e-4


def test_what_is_muted_by_order_is_silent_within_the_fade(tmp_path):
    desk = MixerDesk(voice(wave_file(tmp_path, tone(9.0))))
    desk.leg(0.0)
    desk.play(1.0)
    desk.mixer.is_muted = True
    played = desk.play(2.0)
    assert desk.mixer.is_silent
    assert not played[round(1.1 * RATE_HZ) :].any()


@pytest.mark.slow
def test_a_device_that_is_off_and_its_show_are_within_2_ms_for_an_hour():
    assert hour_off_s(200.0) < 0.002


def test_a_show_that_is_sent_back_forgets_its_voices_without_a_click(tmp_path):
    path = wave_file(tmp_path, ramp(9.0))
    desk = MixerDesk(voice(path))
    desk.leg(0.0)
    desk.play(3.0)
    desk.mixer.clear()
    desk.mixer.voices.append(voice(path, at_s=0.5))
    desk.leg(3.0, start_s=1.0)
    played = desk.play(4.0)
    assert len(desk.mixer.voices) == 1
    assert 10.0 * desk.at(3.9) == pytest.approx(1.4, abs=1e-3)
    assert np.abs(np.diff(played[100:])).max() < 2.0 * 0.3 / (0.05 * RATE_HZ)


def test_a_sound_that_comes_while_the_show_stops_waits_for_it(tmp_path):
    desk = MixerDesk()
    desk.leg(0.0)
    desk.play(1.0)
    desk.leg(1.0, 0.0, 0.0)
    desk.mixer.voices.append(voice(wave_file(tmp_path, np.full(8000, 0.5)), at_s=0.9))
    played = desk.play(2.0)
    desk.leg(2.0, 1.0, 1.0)
    later = desk.play(2.5)
    assert np.abs(np.diff(played)).max() < 1.1 * 0.5 / (0.05 * RATE_HZ)
    assert not played[round(1.1 * RATE_HZ) :].any()
    assert later[-1] == pytest.approx(0.5)
