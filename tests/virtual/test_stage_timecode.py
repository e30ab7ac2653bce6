"""A stage that follows timecode, in virtual time, judged at the bytes that the servos receive."""

from __future__ import annotations

import re
import time
from datetime import UTC, datetime

import numpy as np
import pytest
from campaign.outside import objections_to
from campaign.witness import Witness

from lss_motion.playing.remote.schema import Follow
from lss_motion.stage.check import plan_stage
from lss_motion.stage.file import TimecodeInput
from lss_motion.stage.load import load_stage
from lss_motion.stage.model import Signal, TriggerKind
from lss_motion.stage.running import Options, StageRun
from lss_motion.stage.stage_timecode import spec_of
from lss_motion.stage.timecode.source import TimecodeSource

S = 1_000_000_000
FILES = {
    "robot": """\
robot: puppet
defaults: {model: LSS-ST1, speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  neck: {id: 1, range_deg: [-90, 90]}
""",
    "idle": "sequence: idle\nkeyframes:\n  - {at_s: 0, deg: {neck: -1}}\n"
    "  - {at_s: 1, deg: {neck: -5}}\n  - {at_s: 2, deg: {neck: -1}}\n",
    "wink": "sequence: wink\nkeyframes:\n  - {at_s: 0, deg: {neck: 0}}\n"
    "  - {at_s: 0.5, deg: {neck: 3}}\n  - {at_s: 1, deg: {neck: 0}}\n",
    "dance": "sequence: dance\nkeyframes:\n"
    + "".join(
        f"  - {{at_s: {at_s}, deg: {{neck: {(10 + at_s) * (-1) ** at_s}}}}}\n" for at_s in range(31)
    ),
}
STAGE = """\
stage: hall
robot: robot.yaml
shows: {idle: idle.yaml, dance: dance.yaml, wink: wink.yaml}
idle: idle
cues:
  - {cue: twelve, on: {timecode: "00:00:10:00"}, play: dance, start: terminate}
  - {cue: later, on: {timecode: "00:01:30:00"}, play: wink, start: terminate, follow: false}
  - {cue: over, on: {timecode: "00:02:00:00"}, play: wink, start: terminate, follow: false}
sync: {timecode: {source: ltc, rate_fps: 25, offset_s: 3600.0, freewheel_s: 2, lost: LOST}}
"""
MOVE = re.compile(rb"#1D(-?\d+)")
SHOW_S = 10.0
"""Position at which `dance` begins."""


class TimecodeDesk:
    """A lighting desk: `at(seconds)` is its position and rate; None: it sends nothing."""

    def __init__(self, at, hand=None):
        self.at, self.run, self.next_ns, self.hand = at, None, 0, hand

    def filenos(self):
        return ()

    def take(self):
        legs = []
        if self.hand is not None and self.run.now_ns >= self.hand[0] * S:
            signal = Signal(kind=TriggerKind.CUE, address=self.hand[1])
            self.run.director.signal(signal, self.run.now_ns)
            self.hand = None
        while self.next_ns <= self.run.now_ns:
            led = self.at(self.next_ns / S)
            if led is not None:
                show_s, rate, *song = led
                legs.append(
                    Follow(
                        id=1, instant_ns=self.next_ns, show_s=show_s, rate=rate, song="".join(song)
                    )
                )
            self.next_ns += S // 10
        return legs

    def take_texts(self):
        return ()


class TimecodeJudge(Witness):
    """Keeps all bytes; ends nothing."""

    def act(self, driven, now_ns):
        self.end_ns = now_ns


class TimecodeEvening:
    """One evening with a desk, each horn judged."""

    def __init__(self, planned, at, lasts_s, hand=None, outs=()):
        self.records, self.states, self.judge = [], [], TimecodeJudge()
        begins = datetime(2026, 10, 30, 18, tzinfo=UTC)
        options = Options(is_virtual=True, begins=begins, lasts_s=lasts_s, seed=1)
        desk = TimecodeDesk(at, hand)
        run = StageRun(
            planned,
            options,
            note=self.records.append,
            tap=lambda _: self.judge,
            legs=desk,
            outs=outs,
        )
        desk.run, self.run, results = run, run, []
        self.end = run.play(lambda result, _: results.append(result))
        (result,) = results
        self.judge.end_ns = round(result.report.run_s * S)
        assert objections_to(result.player.robot, (), self.judge, result) == []
        self.moves = [
            (ns, int(found[1]))
            for ns, data in self.judge.writes["main"]
            for found in MOVE.finditer(data)
        ]
        self.fired = [
            (one["cue"], (datetime.fromisoformat(one["t"]) - begins).total_seconds())
            for one in self.records
            if one["kind"] == "fired"
        ]
        self.texts = [one["text"] for one in self.records if one["kind"] == "timecode"]
        self.over = [one["text"] for one in self.records if one["kind"] == "over"]

    def off_ms(self, program, at, from_s, to_s):
        """How late each move of `program` left, by the desk's clock."""
        found = []
        for ns, target in self.moves:
            if from_s * S <= ns < to_s * S:
                show_s = at(ns / S)[0] - SHOW_S
                due_s = [m.due_us / 1e6 for m in program.moves if abs(m.target_wire - target) <= 1]
                found.append(min((show_s - one for one in due_s), key=abs, default=np.inf))
        return 1000.0 * np.array(found)


def planned_in(folder, lost, more=""):
    for name, text in FILES.items():
        (folder / f"{name}.yaml").write_text(text)
    text = STAGE.replace("LOST", lost)
    (folder / "stage.yaml").write_text(text.replace("play: dance", f"play: dance{more}"))
    return plan_stage(load_stage(folder / "stage.yaml"))


def test_cues_fire_at_their_timecode_and_shows_stay_in_step_through_gaps_and_jumps(tmp_path):
    planned = planned_in(tmp_path, "go_on")
    program = planned.shows["dance"].program
    assert {name for name, show in planned.shows.items() if show.is_following} == {"dance"}

    def at(seconds):
        if 17.0 < seconds < 18.5 or seconds >= 58.0:
            return None
        for from_s, ahead_s in ((50, -38), (44, 81), (34, 52), (24, -6), (0, 0)):
            if seconds >= from_s:
                return seconds + ahead_s, 1.0
        return None

    evening = TimecodeEvening(planned, at, 82.0)
    assert [cue for cue, _ in evening.fired] == ["twelve", "later", "twelve"]
    assert [at_s for _, at_s in evening.fired] == pytest.approx([10.0, 38.0, 50.0], abs=0.021)
    for from_s, to_s, least in ((14, 17, 6), (18.6, 24, 6), (28, 34, 9), (54, 58, 5)):
        off_ms = evening.off_ms(program, at, from_s, to_s)
        assert len(off_ms) >= least
        assert np.abs(off_ms).max() < 30.0, "as near as it joins"
        assert abs(off_ms[-1]) < 2.0, "and then trimmed"
    assert [name for name in evening.over if "idle" not in name] == [
        "dance left", "wink finished", "dance finished",
    ]  # fmt: skip
    assert "timecode: the timecode has left the show" in evening.texts
    assert evening.texts[-2:] == [
        "timecode: lost, at 01:00:21",
        "timecode: no leader for 2 s: the show goes on",
    ]
    last = evening.run.timecode.state_of(evening.run.now_ns)
    assert (last["state"], last["source"], last["show"]) == ("lost", "ltc", None)


def test_cues_that_are_bound_to_songs_fire_in_theirs_and_a_show_ends_with_its_song(tmp_path):
    planned_in(tmp_path, "go_on")
    text = STAGE.replace("LOST", "go_on").replace("source: ltc", "source: fpp")
    text = text.replace('{timecode: "00:00:10:00"}', '{timecode: "00:00:10:00", song: one}')
    text = text.replace('{timecode: "00:01:30:00"}', '{timecode: "00:00:10:00", song: two.mp3}')
    (tmp_path / "stage.yaml").write_text(text)
    planned = plan_stage(load_stage(tmp_path / "stage.yaml"))

    def at(seconds):  # The second song is where the first one would be.
        song = "two.mp3" if 20.0 <= seconds < 40.0 else "one.mp3"
        return seconds % 40.0 - (12.0 if seconds % 40.0 >= 20.0 else 0.0), 1.0, song

    evening = TimecodeEvening(planned, at, 55.0)
    assert [cue for cue, _ in evening.fired] == ["twelve", "later", "twelve"]
    assert [at_s for _, at_s in evening.fired] == pytest.approx([10.0, 22.0, 50.0], abs=0.021)
    assert [one for one in evening.over if "idle" not in one][:2] == ["dance left", "wink finished"]


def test_a_show_whose_timecode_stands_and_then_is_silent_goes_on_and_ends(tmp_path):
    planned = planned_in(tmp_path, "go_on")

    def at(seconds):
        return (min(seconds, 14.0), float(seconds < 14.0)) if seconds < 15.0 else None

    evening = TimecodeEvening(planned, at, 55.0)
    assert evening.over == ["idle left", "dance finished", "idle stopped"]
    assert "timecode: no leader for 2 s: the show goes on" in evening.texts


def test_a_show_begins_in_step_where_the_timecode_comes_to_its_beginning(tmp_path):
    """The horn waits at the start; the first moves leave in time, also after a stand before it."""
    planned = planned_in(tmp_path, "go_on")
    program = planned.shows["dance"].program

    def at(seconds):  # It stands 2 s before the show from 8 s to 20 s, when a person presses play.
        return (seconds, 1.0) if seconds < 8 else (max(seconds - 12.0, 8.0), float(seconds > 20))

    evening = TimecodeEvening(planned, at, 30.0)
    assert evening.fired == [("twelve", pytest.approx(22.0, abs=0.021))]
    assert len(evening.off_ms(program, at, 10.5, 21.9)) == 0, "it waits"
    off_ms = evening.off_ms(program, at, 21.9, 26.0)
    assert len(off_ms) >= 8
    assert np.abs(off_ms).max() < 3.0
    assert evening.over == ["idle left", "dance stopped"]


def test_a_show_that_is_ready_waits_for_the_timecode_and_not_for_one_that_was_lost(tmp_path):
    planned = planned_in(tmp_path, "go_on", ", ready: true")
    program = planned.shows["dance"].program

    def at(seconds):  # Two seconds of it, which do not come to the show; then the show.
        if 6.0 < seconds < 8.0:
            return seconds - 1.0, 1.0
        return (seconds - 10.0, 1.0) if seconds > 18.0 else None

    evening = TimecodeEvening(planned, at, 26.0)
    assert evening.fired == [("twelve", pytest.approx(20.0, abs=0.021))]
    assert len(evening.off_ms(program, at, 4.0, 19.9)) == 0
    off_ms = evening.off_ms(program, at, 19.9, 24.0)
    assert len(off_ms) >= 8
    assert np.abs(off_ms).max() < 3.0

    lost = TimecodeEvening(
        planned_in(tmp_path, "go_on"), lambda s: (s, 1.0) if s < 7.5 else None, 16.0
    )
    assert lost.fired == []
    assert lost.over == ["idle left", "dance left", "idle stopped"], "it does not begin by itself"


def test_a_show_after_one_that_waited_begins_at_once(tmp_path):
    """What holds a show before its start holds that show only."""
    planned = planned_in(tmp_path, "go_on", ", ready: true")
    evening = TimecodeEvening(planned, lambda _: None, 12.0, hand=(6.0, "later"))
    began_ns = next(ns for ns, target in evening.moves if ns > 6.5 * S and target > 15)
    assert evening.over[:2] == ["dance left", "wink finished"]
    assert began_ns < 8.0 * S


def test_without_timecode_a_show_holds_if_it_is_to_and_rejoins(tmp_path):
    planned = planned_in(tmp_path, "hold")

    def at(seconds):
        return seconds, 1.0

    evening = TimecodeEvening(planned, lambda s: None if 14.0 < s < 20.0 else at(s), 27.0)
    assert [cue for cue, _ in evening.fired] == ["twelve"]
    program = planned.shows["dance"].program
    assert len(evening.off_ms(program, at, 14.0, 16.0)) >= 3, "it freewheels"
    assert len(evening.off_ms(program, at, 17.5, 20.0)) == 0, "it holds"
    off_ms = evening.off_ms(program, at, 23.5, 27.0)
    assert len(off_ms) >= 4
    assert np.abs(off_ms).max() < 30.0


def test_a_show_that_is_under_way_when_the_robot_is_ready_is_joined(tmp_path):
    planned = planned_in(tmp_path, "hold")

    def at(seconds):
        return seconds + 14.0, 1.0

    evening = TimecodeEvening(planned, at, 8.0)
    assert [cue for cue, _ in evening.fired] == ["twelve"]
    off_ms = evening.off_ms(planned.shows["dance"].program, at, 6.0, 8.0)
    assert len(off_ms) >= 2
    assert np.abs(off_ms).max() < 30.0


def test_a_show_plays_by_itself_where_there_is_nothing_to_follow(tmp_path):
    """It is fired by hand and no timecode comes, or it would be over before it has joined."""

    def at(seconds):
        return seconds, 1.0

    planned = planned_in(tmp_path, "hold")
    (tmp_path / "stage.yaml").write_text(
        (tmp_path / "stage.yaml").read_text().replace("play: dance", "play: wink")
    )
    short = plan_stage(load_stage(tmp_path / "stage.yaml"))
    assert short.shows["wink"].is_following
    evening = TimecodeEvening(short, at, 16.0)
    assert "wink finished" in evening.over

    by_hand = TimecodeEvening(planned, lambda _: None, 8.0, hand=(4.0, "twelve"))
    assert len(by_hand.off_ms(planned.shows["dance"].program, at, 6.0, 8.0)) >= 2
    assert by_hand.run.timecode.state_of(0)["state"] == "searching"


class TimecodeOutStub:
    """A receiver that keeps what it is sent."""

    def __init__(self):
        self.sent = []

    def send_clock(self, leg, show):
        if not self.sent or self.sent[-1][1] is not leg:
            self.sent.append((show, leg))


def test_the_clock_of_shows_that_cues_play_is_sent_and_stands_between_them(tmp_path):
    out = TimecodeOutStub()
    evening = TimecodeEvening(
        planned_in(tmp_path, "hold"), lambda _: None, 10.0, (4.0, "later"), [out]
    )
    assert evening.over == ["idle left", "wink finished", "idle stopped"]
    assert {show for show, _ in out.sent} == {"wink"}
    first, last = out.sent[0][1], out.sent[-1][1]
    assert (first.start_s, first.to_rate) == (0.0, 1.0)
    assert (last.from_rate, last.to_rate) == (0.0, 0.0)
    assert last.start_s == pytest.approx(1.0, abs=0.05)
    begun_ns = next(ns for ns, target in evening.moves if ns >= first.start_ns)
    assert begun_ns - first.start_ns < 0.3 * S, "its moves leave by this clock"


def test_a_source_that_cannot_be_opened_is_named_once_and_stops_nothing():
    spec = spec_of(TimecodeInput(source="mtc", input="no such port"))
    with TimecodeSource(spec, is_lasting=True) as source:
        texts, end_s = [], time.monotonic() + 20.0
        while not texts and time.monotonic() < end_s:
            assert source.take() == []
            texts += source.take_texts()
            time.sleep(0.02)
        assert len(texts) == 1
        assert "no timecode is read any more: " in texts[0]
        while source.filenos() and time.monotonic() < end_s:
            source.take()
        assert source.take_texts() == [], "that its process has ended says nothing more"
