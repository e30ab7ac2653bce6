"""Some seeds of `tools/fuzz.py`, and that its judge can tell good from bad."""

from __future__ import annotations

import pytest
from campaign import judge, witness
from campaign.shows import show

from lss_motion.player import settings, setup, streamer, track

SEEDS, CHUNKS = range(200), 20
FOUND_BPS = 19_200
FOUND = (
    46,  # A servo that restarted on the way to the start was driven without its limits.
    85,  # The same, and half deaf besides.
    113,  # Two servos restarted at once; the second, not missed yet, was still told to brake.
    272,  # A trouble of the approach woke the player without end while it asked who had arrived.
    514,  # A host that overslept made up for it with more than the acceleration allowed in EM0.
    1310,  # A servo that did not hear what it was asked at first was not given its limits.
    1420,  # A late host made up for it, in EM0, with what the instants of a filter's steps allow,
    3076,  # if they are those assumed.
    1634,  # One still deaf from its restart at the end of the approach was not missed.
    2098,  # A garbled word put a horn out of its range, and it was led back from there.
)


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path_factory.getbasetemp() / "plans"))


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_whatever_goes_wrong_no_promise_is_broken(chunk):
    played = {seed: judge.judged(seed) for seed in SEEDS[chunk::CHUNKS]}
    assert {seed: result.broken for seed, result in played.items() if result.broken} == {}
    assert "finished" in {result.outcome for result in played.values()}


@pytest.mark.parametrize("seed", FOUND)
def test_what_once_broke_a_promise_breaks_none(seed):
    assert judge.judged(seed, slow_bps=FOUND_BPS).broken == ()


def test_a_second_trouble_is_waited_for_as_long_as_the_first():
    assert judge.judged(768, slow_bps=FOUND_BPS).outcome == "finished"


def broken(name):
    return " ".join(judge.judged_with(show(name), (), 1)[1])


def test_a_run_that_does_not_end_is_seen(monkeypatch):
    monkeypatch.setattr(witness, "RUN_MAX_S", 1.0)
    assert "it hangs" in broken("arm")


def test_a_crash_is_seen(monkeypatch):
    monkeypatch.setattr(setup, "check_latency", lambda *_: 1 / 0)
    assert "it crashed: ZeroDivisionError" in broken("arm")


def test_a_horn_beyond_its_limits_is_seen(monkeypatch):
    monkeypatch.setattr(settings, "session_orders", lambda *_: [])
    monkeypatch.setattr(streamer.Streamer, "_left_s", lambda *_: 0.01)
    monkeypatch.setattr(streamer, "ON_TIME_NS", -1)
    assert "acceleration" in broken("arm")


def test_a_command_that_was_moved_too_far_is_seen(monkeypatch):
    wire_for = track.Track.wire_for
    monkeypatch.setattr(
        track.Track,
        "wire_for",
        lambda self, target, at_ns: wire_for(self, target + 4.0, at_ns),
    )
    assert "in place of" in broken("arm")


def test_a_missing_safe_state_is_seen(monkeypatch):
    monkeypatch.setattr(setup, "safe_bytes", lambda *_, **__: {})
    assert "the last bytes on bus main" in broken("arm")


def test_a_horn_that_is_not_where_the_show_ends_is_seen(monkeypatch):
    arm = show("arm")
    monkeypatch.setattr(judge, "RESTS_WITHIN_DEG", -1.0)
    assert "nothing is said" in " ".join(judge.judged_with(arm, (), 1)[1])
