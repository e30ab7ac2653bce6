"""The chase: from observations to state and legs."""

from __future__ import annotations

import random

import numpy as np
import pytest

from lss_motion.stage.timecode import chase
from lss_motion.stage.timecode.chase import Chase, ChaseState, TimecodeObservation
from lss_motion.stage.timecode.ltc import levels, sound_of
from lss_motion.stage.timecode.messages import FppReading, fpp_packet
from lss_motion.stage.timecode.receive import ArtNetReader, FppReader, LtcReader, MtcReader
from lss_motion.stage.timecode.timecode import (
    FPS_23_976,
    FPS_24,
    FPS_25,
    FPS_29_97,
    FPS_30,
    Timecode,
    TimecodeStart,
)

FRAME_NS = 40_000_000


class Deck:
    """A tape deck of 25 frames a second, heard by a chase."""

    def __init__(self, style=chase.LTC, jitter_s=2e-5, **options):
        self.chase = Chase(style, **options)
        self.now_ns, self.at_s = 1_000_000_000, 100.0
        self.luck, self.jitter_s = random.Random(3), jitter_s
        self.legs, self.states, self.errors_s = [], [], []

    def run(self, seconds, rate=1.0, source="a", is_heard=True, direction=1, step=None):
        for _ in range(round(seconds * 25)):
            self.now_ns += FRAME_NS
            self.at_s += rate * 0.04 if step is None else step
            late_ns = abs(round(1e9 * self.luck.gauss(0.0, self.jitter_s)))
            if is_heard:
                observation = TimecodeObservation(self.now_ns + late_ns, self.at_s, direction)
                self.chase.take(observation, source)
            self.chase.advance(self.now_ns + late_ns)
            for leg in self.chase.take_legs():
                self.legs.append(leg)
                self.errors_s.append(leg.at_s(self.now_ns) - self.at_s)
            self.states.append(self.chase.state)
        return self


def test_two_consistent_frames_lock_and_a_single_one_does_not():
    deck = Deck().run(0.04)
    assert deck.chase.state is ChaseState.SEARCHING
    assert deck.run(0.04).chase.state is ChaseState.LOCKED
    assert deck.errors_s[-1] == pytest.approx(0.0, abs=2e-4)


@pytest.mark.parametrize("rate", [1.0, 0.9999, 1.0001, 0.999, 1.004])
def test_phase_and_rate_are_those_of_the_leader(rate):
    deck = Deck().run(10.0, rate=rate)
    assert deck.chase.rate == pytest.approx(rate, abs=1e-5)
    assert np.abs(deck.errors_s[20:]).max() < 1e-4
    said = " ".join(deck.chase.take_texts())
    assert ("23.976" in said) is (rate == 0.999)


def test_the_rate_is_fitted_also_where_every_frame_is_read_after_a_turn():
    leader, luck = Chase(chase.LTC), random.Random(3)
    for frame in range(150):
        at_ns = 1_000_000_000 + frame * FRAME_NS + abs(round(1e9 * luck.gauss(0.0, 2e-5)))
        for turn in range(5):
            leader.advance(at_ns + turn * FRAME_NS // 10)
        leader.take(TimecodeObservation(at_ns, 100.0 + frame * 0.04 * 0.9999, 1), "a")
    assert leader.rate == pytest.approx(0.9999, abs=1e-5)


def test_a_leader_beyond_half_a_percent_is_held_and_said_and_followed_again():
    deck = Deck().run(3.0).run(4.0, rate=1.02)
    assert deck.chase.state is ChaseState.OFF_SPEED
    assert deck.legs[-1].rate == 0.0
    assert any("more than 0.5 % off" in text for text in deck.chase.take_texts())
    deck.run(8.0)
    assert deck.chase.state is ChaseState.LOCKED
    assert deck.errors_s[-1] == pytest.approx(0.0, abs=2e-4)


def verdicts(style, fps, late_ms, seconds, rate=1.0, seeds=8):
    """Return texts and states of leaders whose packets are 0 to `late_ms` late."""
    texts, states = [], set()
    for seed in range(seeds):
        luck, chased = random.Random(seed), Chase(style)
        for number in range(int(seconds * fps)):
            late_ns = round(1e6 * late_ms * luck.random())
            now_ns = 1_000_000_000 + round(1e9 * number / fps) + late_ns
            chased.take(TimecodeObservation(now_ns, rate * number / fps), "desk")
            chased.advance(now_ns)
        texts += chased.take_texts()
        states.add(chased.state)
    return texts, states


@pytest.mark.parametrize("late_ms", [5, 10, 20, 40, 60, 100])
@pytest.mark.parametrize(("style", "fps"), [(chase.ART_NET, 25), (chase.MTC, 30), (chase.FPP, 2)])
def test_the_speed_of_a_true_leader_is_not_judged_by_the_jitter_of_its_way(style, fps, late_ms):
    texts, _ = verdicts(style, fps, late_ms, 15.0)
    assert not any("of its speed" in text for text in texts), texts


@pytest.mark.parametrize("late_ms", [5, 10])
def test_a_speed_that_is_known_through_the_jitter_is_said(late_ms):
    texts, _ = verdicts(chase.ART_NET, 30, late_ms, 12.0, rate=0.999)
    assert sum("23.976" in text for text in texts) == 8
    texts, states = verdicts(chase.ART_NET, 25, late_ms, 5.0, rate=1.01)
    assert sum("more than 0.5 % off" in text for text in texts) == 8
    assert states == {ChaseState.OFF_SPEED}


def test_one_wrong_frame_changes_nothing_and_a_jump_locks_at_its_second():
    deck = Deck().run(3.0)
    deck.chase.take(TimecodeObservation(deck.now_ns + 10, 4000.0), "a")
    deck.run(2.0)
    assert np.abs(deck.errors_s[20:]).max() < 2e-4
    deck.at_s += 50.0
    deck.run(0.08)
    assert deck.chase.state is ChaseState.LOCKED
    assert deck.errors_s[-1] == pytest.approx(0.0, abs=2e-4)
    assert any("jumps by +50.00" in text for text in deck.chase.take_texts())


def test_a_drop_out_freewheels_then_is_lost_and_found_again():
    deck = Deck(freewheel_s=2.0).run(5.0).run(1.0, is_heard=False)
    assert deck.chase.state is ChaseState.FREEWHEELING
    count = len(deck.legs)
    deck.run(0.04)
    assert deck.chase.state is ChaseState.LOCKED, "it fits what was expected"
    deck.run(2.4, is_heard=False)
    assert deck.chase.state is ChaseState.LOST
    assert len(deck.legs) < count + 12, "no legs are made up"
    assert deck.run(0.08).chase.state is ChaseState.LOCKED


def test_backward_winding_and_standing_hold():
    deck = Deck().run(2.0).run(0.5, rate=-1.0, direction=-1)
    assert deck.chase.state is ChaseState.REVERSE
    assert deck.legs[-1].rate == 0.0
    deck.run(1.0)
    assert deck.chase.state is ChaseState.LOCKED
    deck.run(1.0, rate=1.7)
    assert deck.chase.state is ChaseState.OFF_SPEED
    deck.run(1.0)
    assert deck.chase.state is ChaseState.LOCKED
    deck.run(1.0, step=0.0)
    assert deck.chase.state is ChaseState.STANDING
    assert deck.legs[-1].rate == 0.0
    assert deck.legs[-1].show_s == deck.at_s
    assert deck.run(0.2).chase.state is ChaseState.LOCKED


@pytest.mark.parametrize("state", chase.HELD)
def test_after_whatever_a_leader_does_silence_ends_in_lost(state):
    deck = Deck(freewheel_s=2.0).run(2.0)
    match state:
        case ChaseState.STANDING:
            deck.run(1.0, step=0.0)
        case ChaseState.REVERSE:
            deck.run(0.5, rate=-1.0, direction=-1)
        case _:
            deck.run(1.0, rate=1.7)
    assert deck.chase.state is state
    count = len(deck.legs)
    deck.run(2.1, is_heard=False)
    assert deck.chase.state is ChaseState.LOST
    assert len(deck.legs) <= count + 1, "no legs are made up"
    assert deck.run(0.08).chase.state is ChaseState.LOCKED


def test_whatever_comes_before_it_silence_ends_in_lost():
    for seed in range(200):
        luck, deck = random.Random(seed), Deck(freewheel_s=1.0)
        for _ in range(luck.randint(1, 8)):
            rate, direction = luck.choice([(1.0, 1), (0.0, 0), (0.0, 1), (-1.0, -1), (1.7, 1)])
            deck.at_s += luck.choice([0.0, 0.0, 30.0])
            is_heard, source = luck.random() < 0.8, luck.choice("aab")
            deck.run(luck.uniform(0.04, 1.0), rate, source, is_heard, direction)
        had_state = deck.chase.state is not ChaseState.SEARCHING
        deck.run(1.6, is_heard=False)
        assert deck.chase.state is (ChaseState.LOST if had_state else ChaseState.SEARCHING), seed


def test_of_two_sources_the_first_is_kept_until_it_is_gone():
    deck = Deck().run(2.0)
    for _ in range(50):
        deck.run(0.04)
        deck.chase.take(TimecodeObservation(deck.now_ns + 5_000_000, 7.0 + deck.at_s), "b")
    assert deck.chase.source == "a"
    assert np.abs(deck.errors_s[10:]).max() < 2e-4
    assert any("of b is ignored" in text for text in deck.chase.take_texts())
    deck.run(2.2, is_heard=False)
    deck.run(0.2, source="b")
    assert deck.chase.source == "b"
    assert deck.chase.state is ChaseState.LOCKED


def test_garbage_never_locks():
    chased, luck = Chase(chase.LTC), random.Random(1)
    for number in range(20000):
        observation = TimecodeObservation(
            number * 1_000_000, luck.uniform(0, 86400), luck.choice((1, 1, -1))
        )
        chased.take(observation, luck.choice("ab"))
        chased.advance(number * 1_000_000)
    assert all(leg.rate == 0.0 for leg in chased.take_legs())
    assert chased.state is not ChaseState.LOCKED


def test_an_hour_with_a_drifting_clock_stays_within_a_tenth_of_a_millisecond():
    deck = Deck()
    for part in range(36):  # From -100 to +100 ppm and back, 100 s each.
        deck.run(10.0, rate=1.0 + 1e-4 * np.sin(part / 3.0))
    assert np.abs(deck.errors_s[20:]).max() < 2e-4
    assert set(deck.states[2:]) == {ChaseState.LOCKED}


def test_a_show_begins_at_its_offset_also_across_midnight():
    chased, start = Chase(chase.LTC), TimecodeStart(86390.0)
    for number in range(400):
        frame = (86388 * 25 + number) % FPS_25.frames_per_day
        chased.take(TimecodeObservation(number * FRAME_NS, start.show_s(frame, FPS_25)), "")
    leg = chased.take_legs()[-1]
    assert leg.at_s(399 * FRAME_NS) == pytest.approx(0.04 * 399 - 2.0, abs=1e-6)


# ---- readers


def heard(reader, sound, block=480):
    found = []
    for start in range(0, len(sound), block):
        found += reader.take(sound[start : start + block], lambda at: 1e9 * at / 48000)
    return found


def test_the_rate_of_ltc_is_measured_and_a_wrong_one_is_said():
    said = []
    for rate in (FPS_24, FPS_25, FPS_30):
        sound = sound_of(Timecode(1, 0, 0, 0), rate, 12, 48000)
        found = heard(LtcReader(48000, None, said.append), sound)
        last = found[-1]
        assert last.position_s - 3600.0 == pytest.approx(last.instant_ns / 1e9, abs=1e-4)
    assert said == []
    assert heard(LtcReader(48000, FPS_24, said.append), sound) == []
    assert "30 frames a second, but 24 are asked for" in said[0]
    slow = sound_of(Timecode(1, 0, 0, 0), FPS_23_976, 12, 48000)
    found = heard(LtcReader(48000, FPS_23_976, said.append), slow)
    assert found[-1].position_s - 3603.6 == pytest.approx(found[-1].instant_ns / 1e9, abs=1e-4)


def test_the_label_at_which_a_show_begins_is_read_at_the_rate_of_the_frames():
    start = TimecodeStart(label=Timecode(1, 0, 0, 29))
    for rate, code in ((FPS_30, 3), (FPS_29_97, 3)):
        wanted = None if rate is FPS_30 else rate
        reader = ArtNetReader(wanted, [].append, start)
        packet = b"Art-Net\0\x00\x97\x00\x0e\x00\x00" + bytes((29, 0, 0, 1, code))
        ((observation, _),) = reader.take(packet, "desk", 5)
        assert observation.position_s == pytest.approx(0.0, abs=1e-9)


def test_ltc_is_read_after_noise_silence_and_other_speeds():
    luck = np.random.default_rng(2)
    slow = levels(90000 + 25 * np.arange(0, 0.5, 0.8 / 48000), FPS_25)
    parts = [luck.normal(0, 0.5, 24000), np.zeros(24000), slow, luck.normal(0, 1e-5, 9000)]
    tape = np.concatenate([*parts, sound_of(Timecode(2, 0, 0, 0), FPS_25, 25, 48000)])
    found = heard(LtcReader(48000, None, [].append), tape.astype(np.float32))
    assert len([one for one in found if one.position_s >= 7200.0]) >= 22
    assert heard(LtcReader(48000, None, [].append), np.full(9600, np.nan, np.float32)) == []


class Playlist:
    """A Falcon Player, heard by a reader and a chase."""

    def __init__(self):
        self.reader, self.chase = FppReader(), Chase(chase.FPP)
        self.now_ns, self.legs = 1_000_000_000, []

    def send(self, action, kind, seconds, name, address="10.0.0.1"):
        packet = fpp_packet(FppReading(action, kind, round(40 * seconds), seconds, name))
        for observation, source in self.reader.take(packet, address, self.now_ns):
            self.chase.take(observation, source)
        self.chase.advance(self.now_ns)
        self.legs += self.chase.take_legs()

    def play(self, *items, stops=True):
        """Play (kind, name) beside each other for nine seconds; return the legs of that time."""
        self.legs = []
        for action in ("open", "start"):
            for item in items:
                self.send(action, item[0], 0.0, item[1])
        for half in range(18):
            for item in items:
                self.send("sync", item[0], half / 2, item[1])
            self.now_ns += 500_000_000
        for item in items if stops else ():
            self.send("stop", item[0], 0.0, item[1])
        return self.legs


@pytest.mark.parametrize("stops", [True, False])
@pytest.mark.parametrize("pause_s", [0, 1, 30])
def test_each_item_of_a_playlist_is_followed_as_the_first(stops, pause_s):
    player = Playlist()
    for items in (
        [("sequence", "one.fseq")],
        [("sequence", "two.fseq"), ("media", "two.mp4")],
        [("media", "three.mp4"), ("sequence", "three.fseq")],
        [("media", "clip.mp4")],
        [("media", "clip.mp4")],
        [("sequence", "one.fseq")],
    ):
        if items[0][0] == "media" and not stops:
            player.now_ns += 4_000_000_000  # The sequence before it is still taken to play.
        start_ns = player.now_ns
        running = [leg for leg in player.play(*items, stops=stops) if leg.rate > 0.0]
        first = next(leg for leg in running if leg.show_s < 5.0 and leg.instant_ns >= start_ns)
        assert first.show_s <= 0.6, items
        for leg in running[running.index(first) :]:
            assert leg.at_s(start_ns) == pytest.approx(0.0, abs=0.02)
        player.now_ns += pause_s * 1_000_000_000
    assert not any("ignored" in text for text in player.chase.take_texts())


def test_another_player_is_ignored_and_a_stop_of_what_played_before_too():
    player = Playlist()
    player.play(("sequence", "one.fseq"), stops=False)
    player.send("sync", "sequence", 3.0, "one.fseq", address="10.0.0.2")
    player.send("stop", "sequence", 0.0, "none.fseq")
    assert player.chase.state is ChaseState.LOCKED
    assert player.chase.source == "10.0.0.1"
    assert any("10.0.0.2 is ignored" in text for text in player.chase.take_texts())


def test_readers_of_messages_say_a_wrong_rate_and_take_no_garbage():
    said = []
    reader = ArtNetReader(FPS_25, said.append)
    packet = bytes.fromhex("4172742D4E65740000 97 000E 0000 02 3B 09 17 03".replace(" ", ""))
    assert list(reader.take(packet, "10.0.0.1", 5)) == []
    assert "comes with 30 frames" in said[0]
    assert list(ArtNetReader(None, said.append).take(packet, "10.0.0.1", 5)) == [
        (TimecodeObservation(5, pytest.approx(-50 * 60 - 1 + 2 / 30)), "10.0.0.1")
    ]
    assert list(FppReader().take(b"FPPD", "10.0.0.1", 5)) == []
    assert list(MtcReader(None, said.append).take(b"\xf1", 5)) == []
