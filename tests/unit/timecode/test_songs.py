"""Shows and cues that are bound to the name of what a Falcon Player plays."""

from __future__ import annotations

import pytest

from lss_motion.errors import InputError
from lss_motion.stage.model import CueTrigger, StageCue, TriggerKind
from lss_motion.stage.timecode.chase import FPP, Chase
from lss_motion.stage.timecode.messages import FppReading, fpp_packet
from lss_motion.stage.timecode.receive import FppReader
from lss_motion.stage.timecode.timecode import is_song, read_follow
from lss_motion.stage.triggering import TimecodeCues
from lss_motion.units import NS_PER_S

S = NS_PER_S


@pytest.mark.parametrize("wanted", ["one", "One.fseq", "one.fseq", "Halloween/one.fseq"])
def test_a_song_is_known_by_its_name_with_or_without_folder_and_ending(wanted: str) -> None:
    assert is_song(wanted, "Halloween/One.fseq")
    assert not is_song(wanted, "one more.fseq")
    assert not is_song(wanted, "")


def packets(name: str, from_s: float, lasts_s: float) -> list[tuple[bytes, float]]:
    """What a player sends while it plays from 0 on, each with its instant."""
    times = [n / 2 for n in range(int(2 * lasts_s))]
    sync = [(fpp_packet(FppReading("sync", "sequence", 0, t, name)), from_s + t) for t in times]
    start = fpp_packet(FppReading("start", "sequence", 0, 0.0, name))
    stop = fpp_packet(FppReading("stop", "sequence", 0, 0.0, name))
    return [(start, from_s), *sync, (stop, from_s + lasts_s)]


def chased(reader: FppReader) -> list[tuple[str, float, float]]:
    """Return song, position and rate of each leg of an evening of two songs."""
    chase, found = Chase(FPP), []
    for packet, at_s in packets("one.fseq", 10.0, 8.0) + packets("x/two.fseq", 18.0, 8.0):
        for observation, source in reader.take(packet, "10.0.0.2", round(at_s * S)):
            chase.take(observation, source)
        chase.advance(round(at_s * S))
        found += [(chase.song, leg.show_s, leg.rate) for leg in chase.take_legs()]
    return found


def test_each_leg_has_the_song_in_which_it_is() -> None:
    legs = chased(FppReader())
    assert [song for song, _, _ in legs] == sorted(song for song, _, _ in legs)
    one = [at_s for song, at_s, rate in legs if song == "one.fseq" and rate]
    two = [at_s for song, at_s, rate in legs if song == "x/two.fseq" and rate]
    for positions in (one, two):
        assert len(positions) > 8
        assert positions[0] < 1.0
        assert max(positions) == pytest.approx(7.5, abs=0.6)


def test_a_show_follows_only_the_song_to_which_it_is_bound() -> None:
    legs = chased(FppReader(song="two"))
    assert {song for song, _, _ in legs} == {"x/two.fseq"}
    assert read_follow("fpp:10.0.0.2", song="two").song == "two"
    with pytest.raises(InputError, match="ltc does not say which song is played"):
        read_follow("ltc", song="two")


def cue(name: str, at_s: float, song: str = "") -> StageCue:
    on = CueTrigger(kind=TriggerKind.TIMECODE, address=name, at_s=at_s, song=song)
    return StageCue(name=name, on=on, shows=("dance",))


def test_a_cue_fires_in_its_song_only() -> None:
    cues = [cue("any", 1.0), cue("first", 3.0, "one"), cue("second", 3.0, "two.fseq")]
    watched = TimecodeCues(cues, {"dance": 0.5})
    fired = []
    for from_s, song in ((0, "one.fseq"), (10, "two.fseq"), (20, "")):
        for tenths in range(50):
            now_ns = round((from_s + tenths / 10) * S)
            passed = [*watched.take(tenths / 10, 1.0, now_ns, song), *watched.tick(now_ns)]
            fired += [(one.name, song) for one, _ in passed]
    assert fired == [
        ("any", "one.fseq"), ("first", "one.fseq"), ("any", "two.fseq"), ("second", "two.fseq"),
        ("any", ""),
    ]  # fmt: skip


def test_another_song_at_the_same_place_is_a_jump() -> None:
    watched = TimecodeCues([cue("in two", 5.0, "two")], {"dance": 10.0})
    assert list(watched.take(7.0, 1.0, 0, "one")) == []
    assert watched.next_ns() is None
    ((found, show_s),) = watched.take(8.0, 1.0, S, "two")
    assert (found.name, show_s) == ("in two", 3.0)
    assert watched.is_within(found, S)
    assert list(watched.take(9.0, 1.0, 2 * S, "one")) == []
    assert not watched.is_within(found, 2 * S)
