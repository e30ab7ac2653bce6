"""A client steers a stage over a socket: in virtual time, and in a process of its own."""

from __future__ import annotations

import contextlib
import json
import pickle
import socket
from datetime import UTC, datetime

import pytest
from msgspec.structs import replace

from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.message import Telemetry, plan_hash
from lss_motion.playing.remote.operator_end import Operator
from lss_motion.playing.remote.process import packed, start_process
from lss_motion.stage.check import plan_stage
from lss_motion.stage.file import Sync, TimecodeInput
from lss_motion.stage.job import StageJob, StageSteering, options_of
from lss_motion.stage.load import load_stage
from lss_motion.stage.model import CueTrigger, StageCue, TriggerKind
from lss_motion.stage.running import Options, StageRun
from lss_motion.system.messages import Kind, MessagePipe, PipeClosedError

NS = 1_000_000_000
FILES = {
    "robot": "robot: puppet\ndefaults: {model: LSS-ST1, speed_max_deg_s: 180, "
    "accel_max_deg_s2: 600}\njoints:\n  neck: {id: 1, range_deg: [-90, 90]}\n"
    "  jaw: {id: 2, range_deg: [-90, 90]}\n",
    "idle": "sequence: idle\nkeyframes:\n  - {at_s: 0, deg: {neck: 0}}\n"
    "  - {at_s: 2, deg: {neck: 9}}\n  - {at_s: 4, deg: {neck: 0}}\n",
    "hello": "sequence: hello\nkeyframes:\n  - {at_s: 0, deg: {neck: 0, jaw: 0}}\n"
    "  - {at_s: 1, deg: {neck: 20, jaw: 30}}\n",
    "stage": "stage: hall\nrobot: robot.yaml\nshows: {idle: idle.yaml, hello: hello.yaml}\n"
    "idle: idle\nlisten: {http: '127.0.0.1:8440'}\ncues:\n"
    "  - {cue: door, on: {http: door}, play: hello}\n"
    "  - {cue: button, on: {key: b}, play: hello, start: terminate}\n",
}


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("job")
    for name, text in FILES.items():
        (folder / f"{name}.yaml").write_text(text)
    return plan_stage(load_stage(folder / "stage.yaml"))


def read(link):
    events, telemetry, objects = [], [], []
    with contextlib.suppress(PipeClosedError, OSError):
        while got := link.receive():
            for kind, content in got:
                if kind is Kind.TELEMETRY:
                    telemetry.append(Telemetry.from_bytes(content))
                elif kind is Kind.EVENT:
                    events.append(m.parse_event(content))
                elif kind is Kind.OBJECT:
                    objects.append(pickle.loads(content))
    return events, telemetry, objects


class Scripted(StageSteering):
    """Sends what a client sends at virtual instants, and reads what it gets."""

    def __init__(self, script):
        own, other = socket.socketpair()
        for one in (own, other):
            one.setblocking(False)
        super().__init__(Operator(MessagePipe(other)))
        self.client, self.script = MessagePipe(own), list(script)
        self.events, self.telemetry = [], []

    def act(self, player, now_ns):
        while self.script and self._run.now_ns >= self.script[0][0] * NS:
            operation = self.script.pop(0)[1]
            self.client.send(Kind.OPERATION, operation.to_json())
        super().act(player, now_ns)
        events, telemetry, _ = read(self.client)
        self.events += events
        self.telemetry += telemetry

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]


def play(planned, script, lasts_s=None):
    steering = Scripted(script)
    run = StageRun(planned, Options(is_virtual=True, lasts_s=lasts_s), steerer=steering)
    steering.begin(run, run.robot, run.robot.joints, StageJob(planned=planned).plans)
    end = run.play()
    steering.end(m.Ended(outcome="stopped", error=None, report=None))
    steering.events += read(steering.client)[0]
    steering.client.close()
    steering.operator.link.close()
    return steering, end


def test_a_client_triggers_enables_and_stops_a_stage_and_sees_all_of_it(planned):
    steering, end = play(planned, [
        (3.0, s.Trigger(id=1, kind="http", address="door", source="10.0.0.7")),
        (9.0, s.Enable(id=2, cue="button", is_enabled=False)),
        (9.5, s.FireCue(id=3, label="button")),
        (10.0, s.FireCue(id=4, label="buton")),
        (11.0, m.Rate(id=5, ratio=0.5)),
        (13.0, s.StageRest(id=6)),
        (16.0, s.StageWake(id=7)),
        (17.0, s.StagePlay(id=8, show="hello")),
        (22.0, m.Stop(id=9)),
    ])  # fmt: skip
    assert end.error is None
    notes = [(one.kind, one.cue or one.show) for one in steering.of(s.StageNote)]
    assert ("fired", "door") in notes
    assert ("refused", "button") in notes
    assert notes.count(("started", "hello")) == 2
    refused = {one.id: one.text for one in steering.of(m.Refused)}
    assert list(refused) == [4]
    assert "did you mean 'button'?" in refused[4]
    states = steering.of(s.StageState)
    assert list(dict.fromkeys(state.state for state in states)) == [
        "connecting", "idle", "plays", "rests",
    ]  # fmt: skip
    last = states[-1]
    assert [(cue.name, cue.fired, cue.is_enabled) for cue in last.cues] == [
        ("door", 1, True), ("button", 0, False),
    ]  # fmt: skip
    assert last.cues[1].refused == "it is disabled"
    plans = list(dict.fromkeys(one.plan for one in steering.telemetry if one.plan))
    assert set(plans) <= {plan_hash(show.program) for show in planned.shows.values()}
    assert len(plans) == 2
    rates = [one.rate for one in steering.telemetry]
    assert min(rate for rate in rates if rate > 0.01) < 0.55
    assert [one.name for one in steering.of(m.ShowStarted)][:2] == ["idle", "hello"]


def test_a_cue_that_comes_as_the_stage_ends_is_noted(planned):
    steering, _ = play(planned, [
        (5.0, m.Stop(id=1)), (5.0, s.Trigger(id=2, kind="http", address="door")),
    ])  # fmt: skip
    notes = {(one.kind, one.cue) for one in steering.of(s.StageNote)}
    assert notes & {("refused", "door"), ("not_played", "door")}


def test_what_waits_as_the_stage_ends_is_noted(tmp_path):
    for name, text in FILES.items():
        queued = text.replace("door}, play: hello", "door}, play: hello, start: queue")
        (tmp_path / f"{name}.yaml").write_text(queued)
    steering = Scripted([
        (5.0, s.FireCue(id=1, label="button")), (5.5, s.FireCue(id=2, label="door")),
        (5.7, m.Stop(id=3)),
    ])  # fmt: skip
    planned = plan_stage(load_stage(tmp_path / "stage.yaml"))
    run = StageRun(planned, Options(is_virtual=True), steerer=steering)
    steering.begin(run, run.robot, run.robot.joints, StageJob(planned=planned).plans)
    run.play()
    run.note_counts(is_last=True)
    notes = [(one.kind, one.cue) for one in steering.of(s.StageNote)]
    notes += [
        (one.kind, one.cue) for one in read(steering.client)[0] if isinstance(one, s.StageNote)
    ]
    assert ("fired", "door") in notes
    assert ("not_played", "door") in notes
    steering.client.close()
    steering.operator.link.close()


def test_a_stage_in_its_own_process_writes_its_log_and_says_how_it_ended(planned, tmp_path):
    options = {"is_virtual": True, "lasts_s": 20.0, "log_folder": str(tmp_path), "seed": 3}
    process = start_process(packed(StageJob(planned=planned)), options=options)
    link = process.pipe
    link.set_blocking(is_blocking=True, timeout_s=30)
    events, objects = [], []
    while not objects:
        found, _, more = read(link)
        events += found
        objects += more
        if process.exit_code() is not None and not found:
            break
    assert process.wait(30) == 0
    link.close()
    assert objects[0].error is None
    assert [one.exit_code for one in events if isinstance(one, m.Ended)] == [None]
    (file,) = tmp_path.glob("stage-*.jsonl")
    records = [json.loads(line) for line in file.read_text().splitlines()]
    assert [one["kind"] for one in records][:4] == [
        "begins", "connecting", "connected", "started",
    ]  # fmt: skip


def test_a_time_of_day_between_two_processes_is_played_by_the_second_one(planned, tmp_path):
    """The first one wrote last at 17:59:40; the second one begins at 18:00:10."""
    on = CueTrigger(kind=TriggerKind.TIME, address="0 18 * * *")
    stage = replace(planned.stage, cues=(StageCue(name="six", on=on, shows=("hello",)),), zone=UTC)
    (tmp_path / "stage-2026-10-30-0000.jsonl").write_text('{"t": "2026-10-30T17:59:40+00:00"}\n')
    options = {
        "is_virtual": True, "lasts_s": 20.0, "log_folder": str(tmp_path),
        "begins": "2026-10-30T18:00:10+00:00",
    }  # fmt: skip
    process = start_process(
        packed(StageJob(planned=replace(planned, stage=stage))), options=options
    )
    assert process.wait(60) == 0
    process.pipe.close()
    lines = (tmp_path / "stage-2026-10-30-0000.jsonl").read_text().splitlines()
    records = [json.loads(line) for line in lines[1:]]
    fired = [one["t"] for one in records if one["kind"] == "fired"]
    assert len(fired) == 1
    assert fired[0] > "2026-10-30T18:00:10"
    assert ("hello", "finished") in [
        (one["show"], one["outcome"]) for one in records if one["kind"] == "over"
    ]


def test_options_are_those_of_a_run_and_the_rest_goes_to_the_player():
    options = options_of(
        {"start_at": "2026-10-30T18:00:00+00:00", "has_feedback": False, "log_folder": "x"}
    )
    assert options.start_at == datetime(2026, 10, 30, 18, tzinfo=UTC)
    assert options.more == {"has_feedback": False}


def test_timecode_starts_its_shows_also_in_their_middle(planned):
    """The legs are those of `playing.remote.schema.Follow`; their place is that of the timecode."""
    on = CueTrigger(kind=TriggerKind.TIMECODE, address="00:01:40:00", at_s=100.0)
    cue = StageCue(name="tc", on=on, shows=("hello",), follows=True, start="terminate")
    stage = replace(planned.stage, cues=(cue,), sync=Sync(timecode=TimecodeInput(source="ltc")))
    legs = [
        (
            at_s,
            m.Follow(id=number, instant_ns=round(at_s * NS), show_s=show_s, rate=1.0, source="t"),
        )
        for number, (at_s, show_s) in enumerate(
            [(2.0, 96.0), (3.0, 97.0), (4.0, 98.0), (5.0, 99.0), (12.0, 50.0), (14.0, 100.5)], 1
        )
    ]
    steering, _ = play(replace(planned, stage=stage), legs, lasts_s=25.0)
    begun = [(one.name, round(one.from_s, 1)) for one in steering.of(m.ShowStarted)]
    assert begun == [
        ("idle", 0.0), ("hello", 0.0), ("idle", 0.0), ("hello", 0.5), ("idle", 0.0),
    ]  # fmt: skip
