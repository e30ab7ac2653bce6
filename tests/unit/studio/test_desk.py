"""The desk: one process at a time, the stop that is kept, and what comes after what."""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.show.functions import ModuleSource
from lss_motion.stage.load import load_stage
from lss_motion.studio import desk as desks
from lss_motion.studio.access import Role
from lss_motion.studio.desk import Desk, DeskOptions
from lss_motion.studio.document import Document
from lss_motion.studio.hub import Hub
from lss_motion.studio.planner import PlannerReply, Request

PLAN = "0123456789abcdef"
SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"


class Stops:
    """Stands for the process that only stops."""

    def __init__(self):
        self.done, self.on_latch, self.latch = [], None, None

    def stop(self, kind):
        self.done.append(kind)
        self.latch = kind

    def rearm(self):
        self.done.append("rearm")
        self.latch = None


class PlayerStub:
    """Stands for the process that plays; the test says what it sends."""

    all: ClassVar[list[PlayerStub]] = []

    def __init__(self, job, stops, *, on_event, on_telemetry, on_end, on_lost, options):
        self.job, self.options, self.on_lost = job, options, on_lost
        self.on_event, self.on_end, self.sent = on_event, on_end, []
        PlayerStub.all.append(self)

    def send(self, operation):
        self.sent.append(operation)

    def tell(self, kind, **fields):
        event = {"event": kind, **fields}
        self.on_event(event, json.dumps(event))

    def end(self, outcome="finished", error=None):
        self.tell("ended", outcome=outcome, error=error, report={})
        self.on_end(self)


class DeskStage:
    """A desk with its hub, its file and one client that operates."""

    def __init__(self, folder, **options):
        PlayerStub.all = []
        self.hub = Hub(lambda client: m.Links(clients=0))
        self.stops = Stops()
        self.desk = Desk(self.hub, self.stops, DeskOptions(**options))
        self.hub.desk = self.desk
        request = Request(number=0, path=Path(folder, "swing.yaml"))
        self.document = Document(request, lambda _: None, self.desk_changed)
        self.desk.document = self.document
        self.client = self.hub.join(Role.EDIT, "a", 0.0)
        self.next_id = 0

    def desk_changed(self):
        if self.desk.document is not None:
            self.desk.document_changed()

    def plan(self, **fields):
        given = {"plan": PLAN, "job": b"show", "live_job": b"live", "scan_job": b"scan"}
        reply = {"robot": b"{}", "is_simulated": True, "port": "sim://", **given, **fields}
        self.document.take(PlannerReply(number=1, **reply))

    def ask(self, op, **fields):
        """Send an operation; return its answer, None if it has none yet."""
        self.next_id += 1
        before = len(self.client._events)
        text = json.dumps({"op": op, "id": self.next_id, **fields})
        self.hub.receive(self.client, text, 0.0)
        return self.answer(self.next_id, before)

    def answer(self, id_, before=0):
        events = [json.loads(text) for text in list(self.client._events)[before:]]
        found = [e for e in events if e["event"] in ("accepted", "refused") and e["id"] == id_]
        return found[-1].get("text", "accepted") if found else None

    def last(self, kind):
        events = [json.loads(text) for text in self.client._events]
        return next(event for event in reversed(events) if event["event"] == kind)

    @property
    def robot(self):
        return json.loads(self.client._newest["robot"])


@pytest.fixture
def stage(tmp_path, monkeypatch):
    monkeypatch.setattr(desks, "PlayerProcess", PlayerStub)
    return DeskStage(tmp_path)


def test_a_show_is_played_once_it_is_planned(stage):
    assert "being planned" in stage.ask("play")
    stage.document.take(PlannerReply(number=1, problems=(("swing.yaml", 4, "no"),)))
    assert "swing.yaml:4: there is no plan: no" in stage.ask("play")
    stage.plan(functions=("tricks:wave",))
    assert "--allow-run" in stage.ask("play")
    stage.plan()
    assert "has changed" in stage.ask("play", plan="f" * 16)
    assert stage.ask("pause") == "no show plays now"
    assert stage.ask("play", plan=PLAN, from_s=2.5) == "accepted"
    (player,) = PlayerStub.all
    assert (player.job, player.options["start_s"]) == (b"show", 2.5)
    assert not player.options["must_ask"]
    assert stage.last("player")["state"] == "starting"
    assert stage.robot["state"] == "playing"
    for op in ("play", "connect", "scan"):
        assert stage.ask(op).startswith("a show plays")
    assert stage.ask("jog", joint="a", speed_ratio=1).startswith("the robot is off")
    player.tell("phase", phase="playing")
    assert stage.ask("pause") is None
    key = player.sent[-1].id
    player.tell("accepted", id=key, op="pause")
    assert stage.answer(stage.next_id) == "accepted"
    player.tell("rate", ratio=1.0, is_paused=True)
    assert stage.last("player")["state"] == "paused"
    assert stage.ask("resume") is None
    player.tell("ended", outcome="finished", error=None, report={})
    assert stage.last("player")["state"] == "paused", "it owns the ports until it has ended"
    player.on_end(player)
    assert (stage.last("player")["state"], stage.robot["state"]) == ("ended", "off")
    assert "has ended" in stage.answer(stage.next_id)


def test_a_real_robot_waits_for_go_and_a_player_that_is_gone_is_said(stage):
    stage.plan(is_simulated=False)
    stage.ask("play")
    assert PlayerStub.all[0].options["must_ask"]
    PlayerStub.all[0].tell("phase", phase="ready")
    assert stage.last("player")["state"] == "ready"
    PlayerStub.all[0].tell("ended", outcome="lost", error="gone", report=None)
    PlayerStub.all[0].on_end(PlayerStub.all[0])
    assert stage.last("player")["state"] == "gone"


def test_a_stop_is_kept_until_it_is_armed_again(stage):
    stage.plan()
    stage.ask("play")
    assert stage.ask("estop") == "accepted"
    assert isinstance(PlayerStub.all[0].sent[-1], m.Estop)
    assert stage.stops.done == ["estop"]
    assert stage.last("player")["latch"] == "estop"
    assert "wait until it has ended" in stage.ask("rearm")
    PlayerStub.all[0].end("stopped")
    assert stage.last("player")["latch"] == "estop", "which it was"
    for op in ("play", "connect", "scan"):
        assert "rearm" in stage.ask(op)
    assert stage.ask("rearm") == "accepted"
    assert stage.ask("play") == "accepted"
    stage.stops.latch = "stop"  # By the process that only stops.
    assert "rearm" in stage.ask("connect")
    stage.stops.on_latch()
    assert stage.last("player")["latch"] == "stop"


def test_a_connected_robot_is_given_up_for_the_show_unless_that_is_stopped(stage):
    stage.plan()
    assert stage.ask("connect") == "accepted"
    live = PlayerStub.all[0]
    assert (live.job, stage.robot["state"]) == (b"live", "connecting")
    live.tell("robot", state="live")
    assert stage.robot["state"] == "live"
    assert stage.ask("play") is None
    assert isinstance(live.sent[-1], m.Disconnect)
    waiting = stage.next_id
    live.end("stopped")
    assert stage.answer(waiting) == "accepted"
    assert PlayerStub.all[1].job == b"show"
    PlayerStub.all[1].end()
    stage.ask("connect")
    assert stage.ask("play") is None
    waiting = stage.next_id
    stage.ask("stop")
    PlayerStub.all[2].end("stopped", error="no port")
    assert "has ended" in stage.answer(waiting)
    assert len(PlayerStub.all) == 3
    assert stage.robot["text"] == "no port"


def test_the_end_of_the_server_is_not_forgotten_over_a_stop(stage):
    stage.plan()
    freed = []
    stage.desk.close(lambda: freed.append(1))
    assert freed == [1]
    stage.ask("play")
    stage.desk.close(lambda: freed.append(2))
    assert isinstance(PlayerStub.all[0].sent[-1], m.Stop)
    stage.desk.stop(is_emergency=True)
    PlayerStub.all[0].end("stopped")
    assert freed == [1, 2]


@pytest.mark.parametrize(("rule", "sent"), [("stop", "stop"), ("hold", "pause"), ("go_on", None)])
def test_a_lost_operator_is_the_rule_for_a_show_and_holds_a_robot(
    tmp_path, monkeypatch, rule, sent
):
    monkeypatch.setattr(desks, "PlayerProcess", PlayerStub)
    stage = DeskStage(tmp_path, on_lost=rule)
    stage.desk.operator_lost()
    stage.plan()
    stage.ask("play")
    assert PlayerStub.all[0].on_lost == rule
    stage.desk.operator_lost()
    assert [one.op for one in PlayerStub.all[0].sent] == ([] if sent is None else [sent])
    PlayerStub.all[0].end()
    stage.ask("connect")
    stage.desk.operator_lost()
    assert [one.op for one in PlayerStub.all[1].sent] == ["stop"]


def test_a_stage_that_begins_anew_calls_what_a_person_has_agreed_to(tmp_path, monkeypatch):
    """A stranger, or a half-saved file, changes it meanwhile: nobody is there at night."""
    monkeypatch.setattr(desks, "PlayerProcess", PlayerStub)
    stage = DeskStage(tmp_path, may_run=True, stage={})
    wave = ModuleSource("shows", "tricks", "shows/tricks.py", b"safe", is_package=False)
    other = replace(wave, name="other", path="shows/other.py")
    hall = load_stage(Path(SEQUENCES, "stages", "haunted_hall.yaml"))

    def begin(*modules):
        stage.plan(stage=hall, functions=("tricks:wave",), modules=modules)
        stage.desk.start()
        PlayerStub.all[-1].end()
        return PlayerStub.all[-1].options["modules"]

    assert begin(wave) == (wave,)
    changed = replace(wave, data=b"evil")
    assert begin(changed) == (wave,)
    assert stage.desk.changed_functions(stage.document.good) == ["shows/tricks.py"]
    with pytest.raises(InputError, match=r"not there when --allow-run was given \(shows/other\.py"):
        begin(wave, other)
    assert len(PlayerStub.all) == 2
    assert begin(wave) == (wave,)


def test_a_show_of_the_studio_calls_what_was_planned(stage):
    stage = DeskStage(stage.document.path.parent, may_run=True)
    for data in (b"one", b"two"):
        module = ModuleSource("shows", "tricks", "shows/tricks.py", data, is_package=False)
        stage.plan(functions=("tricks:wave",), modules=(module,))
        assert stage.ask("play") == "accepted"
        assert PlayerStub.all[-1].options["modules"] == (module,)
        PlayerStub.all[-1].end()


def test_a_pose_is_not_written_into_a_file_that_has_changed(stage, tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("a: 1\n")
    stage.plan(robot_path=path, robot_digest=desks.file_digest(path))
    stage.ask("connect")
    assert stage.ask("pose.save", pose="up", is_new=True) is None
    path.write_text("a: 2\n")
    assert "has just changed on disk" in stage.ask("pose.save", pose="up", is_new=True)


def test_joints_follow_a_client_from_where_they_were_read_and_a_stop_is_kept(stage):
    stage.plan(puppet_job=b"puppet")
    assert "connect it first" in stage.ask("puppeteer")
    assert "begin with puppeteer" in stage.ask("target", deg={"a": 1})
    stage.ask("connect")
    (live,) = PlayerStub.all
    joints = {"a": {"deg": 5.0, "is_limp": False}, "b": {"deg": None, "is_limp": True}}
    live.tell("robot", state="live", port="", is_simulated=True, joints=joints, text="")
    assert "no joint 'c'" in stage.ask("puppeteer", joints=["c"])
    assert "not every joint was read" in stage.ask("puppeteer", joints=["b"])
    assert stage.ask("puppeteer") is None, "the robot is given up first"
    assert [one.op for one in live.sent] == ["disconnect"]
    live.end("stopped")
    puppet = PlayerStub.all[-1]
    assert (puppet.job, puppet.options) == (b"puppet", {"standing_deg": {"a": 5.0}})
    assert stage.last("player")["state"] == "starting"
    assert stage.ask("target", deg={"a": 9}) == "accepted"
    assert puppet.sent[-1].deg == {"a": 9}
    assert "follow a client" in stage.ask("play")
    assert stage.ask("disconnect") == "accepted"
    assert puppet.sent[-1].op == "stop"
    assert stage.stops.done == [], "ending it is no stop that is kept"
    puppet.end("stopped")
    assert stage.robot["state"] == "off"
    assert "begin with puppeteer" in stage.ask("target", deg={"a": 1})


def test_a_stop_while_the_robot_is_given_up_keeps_joints_from_following(stage):
    stage.plan(puppet_job=b"puppet")
    stage.ask("connect")
    (live,) = PlayerStub.all
    joints = {"a": {"deg": 5.0, "is_limp": False}}
    live.tell("robot", state="live", port="", is_simulated=True, joints=joints, text="")
    stage.ask("puppeteer")
    stage.ask("stop")
    live.end("stopped")
    assert PlayerStub.all == [live], "nothing begins after a stop"
    assert "arm it again" in stage.ask("puppeteer")
