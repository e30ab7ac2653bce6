"""Edits of the open files: revisions, undo, two clients, the disk, and recovery."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.files.source import bounded_data
from lss_motion.playing.remote import edit_messages as e
from lss_motion.playing.remote import schema as m
from lss_motion.robot.write import write_pose
from lss_motion.studio.access import Role
from lss_motion.studio.document import Document
from lss_motion.studio.drafts import recovery_path
from lss_motion.studio.hub import Hub
from lss_motion.studio.planner import PlannerReply, Request, reply_to

ROBOT = """\
robot: arm
buses: {main: {port: "sim://", baud_bps: 115200, firmware: 370}}
joints:
  a: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
poses:
  up: {a: 20}
"""
SHOW = """\
\ufeff# ümläut\r
sequence: swing\r
robot: arm.yaml\r
keyframes:\r
  - {at_s: 0, deg: {a: 0}}\r
  - {at_s: 1, deg: {a: 30}}   # here\r
  - {at_s: 2, pose: up}\r
layers:\r
  - {file: nod.yaml, mode: add}\r
events:\r
  - {at_s: 1, run: "tricks:wave"}\r
"""
NOD = """\
sequence: nod
robot: arm.yaml
keyframes:
  - {at_s: 0, deg: {a: 0}}
  - {at_s: 0.5, deg: {a: 5}}
  - {at_s: 1, deg: {a: 0}}
"""


class Desk:
    """What the hub needs of a desk, with the edits of a document."""

    def __init__(self, document):
        self.document = document

    def obey(self, operation, _key):
        self.document.edit(operation)
        return True

    def state(self):
        return (self.document.message().to_json().decode(),)

    def operator_lost(self):
        pass


class Server:
    """A document with its hub and, in place of the planner process, its function."""

    def __init__(self, folder, *, plans=False):
        self.folder, self.requests, self.document = folder, [], None
        self.hub = Hub(self._welcome)
        request = Request(number=0, path=folder / "swing.yaml")
        self.document = Document(request, self.requests.append, self._changed)
        self.hub.desk = Desk(self.document)
        files = (folder / "swing.yaml", folder / "nod.yaml", folder / "arm.yaml")
        poses = json.dumps({"poses": {"up": {"a": 20}}}).encode()
        self.document.take(PlannerReply(number=1, plan="p", robot=poses, files=files))
        self.clients = []
        self.plans = plans

    def _welcome(self, client):
        return m.Welcome(
            client=client.number,
            role=client.role.word,
            stop_origin="",
            version="0",
            file="swing.yaml",
            kind="sequence",
            title="swing",
            is_network_readable=False,
        )

    def _changed(self):
        if self.document is not None:
            self.hub.broadcast(self.document.message())

    def join(self, role=Role.EDIT):
        client = self.hub.join(role, "a", 0.0)
        self.clients.append(client)
        return client

    def send(self, client, op, **fields):
        """Send an operation; return the refusal, or None."""
        given = {"revision": self.document.revision, **fields}
        self.hub.receive(client, json.dumps({"op": op, "id": 9, **given}), 0.0)
        refused = [event["text"] for event in taken(client) if event["event"] == "refused"]
        return refused[0] if refused else None

    @property
    def editing(self):
        return self.document.message().editing

    def text(self, name="swing.yaml"):
        return self.document.text(self.folder / name)


def taken(client):
    texts = [client._events.popleft() for _ in range(len(client._events))]
    return [json.loads(text) for text in texts]


def key(index, file="swing.yaml"):
    return {"file": file, "place": ["keyframes", index]}


@pytest.fixture
def folder(tmp_path):
    Path(tmp_path, "arm.yaml").write_text(ROBOT)
    Path(tmp_path, "swing.yaml").write_bytes(SHOW.encode())
    Path(tmp_path, "nod.yaml").write_text(NOD)
    Path(tmp_path, "tricks.py").write_text("def wave(show):\n    pass\n")
    return tmp_path


@pytest.fixture
def server(folder):
    return Server(folder)


def test_an_edit_is_planned_from_what_is_not_saved_and_undone_to_the_byte(server, folder):
    client = server.join()
    before = server.document.revision
    assert server.send(client, "key.move", keys=[key(1)], by_s=0.25) is None
    assert server.document.revision == before + 1
    (text,) = server.requests[-1].texts.values()
    assert text == SHOW.replace("at_s: 1, deg", "at_s: 1.25, deg").encode()
    assert (folder / "swing.yaml").read_bytes() == SHOW.encode()
    assert server.editing.unsaved == ("swing.yaml",)
    assert (server.editing.undo, server.editing.redo) == ("move 1 key", None)
    assert server.send(client, "undo") is None
    assert server.requests[-1].texts == {}
    assert (server.editing.undo, server.editing.redo) == (None, "move 1 key")
    assert server.send(client, "redo") is None
    assert server.send(client, "save") is None
    assert (folder / "swing.yaml").read_bytes() == text
    assert server.editing.unsaved == ()
    assert server.send(client, "undo") is None
    assert server.send(client, "save") is None
    assert (folder / "swing.yaml").read_bytes() == SHOW.encode()
    assert "nothing to undo" in server.send(client, "undo")


def test_the_planner_plans_what_is_edited(server, folder):
    client = server.join()
    server.send(client, "key.set", keys=[key(1)], deg={"a": 12})
    reply = reply_to(server.requests[-1])
    assert not reply.problems
    (lane, *_) = json.loads(reply.view)["lanes"]
    assert [(one["deg"], one["place"]) for one in lane["keys"]][1] == (
        {"a": 12.0},
        ["keyframes", 1],
    )
    server.send(client, "key.move", keys=[key(1)], by_s=-0.99)
    assert not reply_to(server.requests[-1]).problems, "what is too fast is slower, not wrong"
    server.send(client, "key.set", keys=[key(1)], deg={"b": 12})
    ((path, line, text),) = reply_to(server.requests[-1]).problems
    assert (Path(path).name, line) == ("swing.yaml", 6)
    assert "unknown joint 'b'" in text


def test_steps_across_files_and_gestures_are_undone_at_once(server):
    client = server.join()
    both = [key(1), key(1, "nod.yaml")]
    assert server.send(client, "key.move", keys=both, by_s=0.1) is None
    assert "at_s: 0.6" in server.text("nod.yaml")
    for angle in (31, 32, 33):
        fields = {"keys": [key(1)], "deg": {"a": angle}, "gesture": "drag"}
        assert server.send(client, "key.set", **fields) is None
    assert "a: 33" in server.text()
    assert server.editing.unsaved == ("swing.yaml", "nod.yaml")
    server.send(client, "undo")
    assert "{at_s: 1.1, deg: {a: 30}}" in server.text()
    server.send(client, "undo")
    assert server.editing.unsaved == ()
    server.send(client, "redo"), server.send(client, "redo")
    assert "{at_s: 1.1, deg: {a: 33}}" in server.text()


def test_a_stale_edit_of_a_second_client_is_refused(server):
    first, second = server.join(), server.join()
    taken(first), taken(second)
    stale = server.document.revision
    assert server.send(first, "key.set", keys=[key(1)], deg={"a": 1}) is None
    (event,) = [event for event in taken(second) if event["event"] == "document"]
    assert event["revision"] == stale + 1
    text = server.text()
    refused = server.send(second, "key.set", keys=[key(1)], deg={"a": 2}, revision=stale)
    assert "have changed since then" in refused
    assert server.text() == text
    newest = event["revision"]
    assert not server.send(second, "key.set", keys=[key(1)], deg={"a": 2}, revision=newest)
    assert server.send(first, "undo") is None
    assert server.text() == text, "undo is that of the files, not that of a client"


@pytest.mark.parametrize("role", [Role.VIEW, Role.OPERATE])
def test_only_who_may_edit_edits(server, role):
    other = server.join(Role.EDIT)
    client = server.join(role)
    assert "needs the role edit" in server.send(client, "key.set", keys=[key(1)], deg={"a": 1})
    server.hub.receive(other, '{"op": "lease", "want": "take"}', 0.0)
    assert "needs the role edit" in server.send(client, "undo")


# ---- the disk


def test_a_change_on_disk_is_a_step_where_all_is_saved_and_else_a_difference(server, folder):
    client = server.join()
    server.send(client, "key.set", keys=[key(1)], deg={"a": 1})
    server.send(client, "save")
    saved = (folder / "swing.yaml").read_bytes()
    theirs = saved.replace(b"sequence: swing", b"sequence: SWING")
    (folder / "swing.yaml").write_bytes(theirs)
    server.document.look()
    assert "SWING" in server.text()
    assert server.editing.unsaved == ()
    server.send(client, "undo")
    assert server.editing.unsaved == ("swing.yaml",)
    assert server.requests[-1].texts[folder / "swing.yaml"] == saved
    server.send(client, "redo")

    server.send(client, "key.set", keys=[key(1)], deg={"a": 2})
    newer = theirs.replace(b"here", b"there")
    (folder / "swing.yaml").write_bytes(newer)
    assert "has changed on disk" in server.send(client, "save")
    assert (folder / "swing.yaml").read_bytes() == newer
    (conflict,) = server.editing.conflicts
    assert "-  - {at_s: 1, deg: {a: 1}}   # there" in conflict.difference
    assert "+  - {at_s: 1, deg: {a: 2}}   # here" in conflict.difference
    assert server.send(client, "disk.keep", file="swing.yaml", what="ours") is None
    (folder / "swing.yaml").write_bytes(theirs)
    assert "has changed on disk" in server.send(client, "save"), "since it was looked at"
    assert server.send(client, "disk.keep", file="swing.yaml", what="disk") is None
    assert (server.editing.unsaved, server.editing.conflicts) == ((), ())
    server.send(client, "undo")
    assert "a: 2" in server.text()
    assert server.send(client, "save") is None
    assert b"a: 2" in (folder / "swing.yaml").read_bytes()


def test_a_file_that_changes_while_it_is_written_is_not_overwritten(server, folder, monkeypatch):
    client = server.join()
    server.send(client, "key.set", keys=[key(1)], deg={"a": 1})
    path, read = folder / "swing.yaml", []

    def late(one, *most):
        if one == path and not read:  # Just before the new file takes its place.
            read.append(one)
            path.write_text(NOD)
        return bounded_data(one, *most)

    monkeypatch.setattr("lss_motion.studio.drafts.bounded_data", late)
    assert "just changed on disk" in server.send(client, "save")
    assert path.read_text() == NOD
    assert server.editing.unsaved == ("swing.yaml",)
    assert not list(folder.glob(".*.part"))


# ---- recovery


def test_unsaved_edits_come_back_after_a_crash_and_go_when_they_are_saved(server, folder):
    client = server.join()
    server.send(client, "key.move", keys=[key(1), key(1, "nod.yaml")], by_s=0.1)
    server.document.look()
    edited = server.text(), server.text("nod.yaml")
    assert recovery_path(folder / "swing.yaml").exists()
    server = Server(folder)  # The one before was killed.
    assert (server.text(), server.text("nod.yaml")) == edited
    assert server.editing.recovered == ("swing.yaml", "nod.yaml")
    assert server.requests[-1].texts[folder / "nod.yaml"] == edited[1].encode()
    client = server.join()
    server.send(client, "undo"), server.send(client, "undo")
    assert server.editing.unsaved == ()
    server.send(client, "redo"), server.send(client, "redo")
    assert server.send(client, "save") is None
    assert server.editing.recovered == ()
    assert not list(folder.glob(".*.unsaved"))
    assert (folder / "nod.yaml").read_text() == edited[1]
    assert Server(folder).editing.recovered == ()


def test_a_stage_is_never_played_from_what_is_not_saved(server, folder, tmp_path):
    client = server.join()
    server.send(client, "key.set", keys=[key(1)], deg={"a": 1})
    server.document.close()
    (folder / "night.yaml").write_text("stage: night\nrobot: arm.yaml\nshows: {a: swing.yaml}\n")
    requests = []
    request = Request(number=0, path=folder / "night.yaml", views=tmp_path)
    stage = Document(request, requests.append, lambda: None)
    stage.take(PlannerReply(number=1, plan="p", files=(folder / "swing.yaml",)))
    stage.look()
    assert [one.texts for one in requests] == [{}]
    with pytest.raises(InputError, match="runs a stage"):
        stage.edit(e.Undo(revision=stage.revision))
    assert recovery_path(folder / "swing.yaml").exists()


def test_recovered_edits_of_a_file_that_has_changed_since_are_a_difference(server, folder):
    client = server.join()
    server.send(client, "key.set", keys=[key(1)], deg={"a": 1})
    server.document.look()
    (folder / "swing.yaml").write_bytes(SHOW.replace("here", "there").encode())
    server = Server(folder)
    assert "a: 1" in server.text()
    assert [one.file for one in server.editing.conflicts] == ["swing.yaml"]
    assert "has changed on disk" in server.send(server.join(), "save")


@pytest.mark.parametrize(
    "kept",
    [
        b"",
        b"sequence: x\n",
        b"# lss_motion: unsaved edits of swing.yaml; sha256 of the file: 00\n\xff\xfe\0",
        b"# lss_motion: unsaved edits of swing.yaml; sha256 of the file: 00\nsequence: [",
        b"# lss_motion: unsaved edits of swing.yaml; sha256 of the file: 00\n"
        + SHOW.replace("tricks:wave", "os:abort").encode()[3:],
    ],
)
def test_what_is_no_recovery_or_would_add_a_function_is_left_alone(folder, kept):
    recovery_path(folder / "swing.yaml").write_bytes(kept)
    server = Server(folder)
    assert server.editing.recovered == ()
    assert server.text() == SHOW[1:]
    assert recovery_path(folder / "swing.yaml").read_bytes() == kept


def test_what_is_kept_does_not_make_the_planner_plan_again(server, folder):
    """A file with an error is planned again when its folder changes."""
    problem = (str(folder / "swing.yaml"), 1, "no")
    server.document.take(PlannerReply(number=2, problems=(problem,)))
    client = server.join()
    server.send(client, "key.set", keys=[key(1)], deg={"a": 1})
    server.document.take(PlannerReply(number=3, problems=(problem,)))
    count = len(server.requests)
    for _ in range(3):
        server.document.look()
    assert recovery_path(folder / "swing.yaml").exists()
    assert server.send(client, "save") is None
    server.document.look()
    assert len(server.requests) == count


# ---- what an edit may not do

HOSTILE = [
    ("value.set", {"place": ["events", 0, "run"], "value": "os:abort"}, "neither added nor"),
    ("value.set", {"place": ["events", 0], "value": {"at_s": 1, "run": "os:abort"}}, "neither"),
    (
        "item.insert",
        {"place": ["events"], "index": 1, "value": {"at_s": 2, "run": "tricks:wave"}},
        "neither added nor changed",
    ),
    ("value.set", {"place": ["layers", 0, "file"], "value": "../nod.yaml"}, "out of the folder"),
    ("value.set", {"place": ["layers", 0, "file"], "value": "/etc/passwd"}, "out of the folder"),
    ("value.set", {"place": ["layers", 0, "file"], "value": "link/x.yaml"}, "out of the folder"),
    ("value.set", {"place": ["sound"], "value": {"file": "~/x.wav"}}, "out of the folder"),
    ("value.set", {"place": ["robot"], "value": "x\0y"}, "out of the folder"),
    ("value.set", {"place": ["loop"], "value": "x" * 5000}, "loop"),
    ("value.set", {"place": ["keyframes", 1, "at_s"], "value": "soon"}, "at_s"),
    ("value.set", {"place": ["keyframes", 1, "at_s"], "value": True}, "at_s"),
    ("value.set", {"place": ["keyframes"], "value": {}}, "keyframes"),
    ("value.set", {"place": ["sequence"], "value": None}, "stays what it is"),
    ("value.set", {"place": ["nothing"], "value": 1}, "unknown key"),
    ("value.set", {"place": ["x"] * 16, "value": 1}, "nested|unknown key"),
    ("value.set", {"place": ["loop"], "value": json.loads("[" * 400 + "]" * 400)}, "nested"),
    ("value.rename", {"place": ["sequence"], "name": "stage"}, "stays what it is"),
    ("text.set", {"from_line": 1, "to_line": 3, "lines": ["run: ["]}, "not YAML|must hold|:"),
    ("text.set", {"from_line": 11, "to_line": 12, "lines": ['  - {at_s: 1, run: "os:abort"}']},
     "neither"),
    ("text.set", {"from_line": 1, "to_line": 2, "lines": ["a: &a [1]\nb: *a"]}, "line end"),
    ("text.set", {"from_line": 1, "to_line": 1, "lines": ["\ud800"]}, "."),
]  # fmt: skip


@pytest.mark.parametrize(("op", "fields", "why"), HOSTILE)
def test_no_function_port_or_path_out_of_the_folder_is_added(server, folder, op, fields, why):
    (folder / "link").symlink_to(folder.parent)
    client = server.join()
    text = server.text()
    refused = server.send(client, op, file="swing.yaml", **fields)
    assert refused is not None
    assert re.search(why, refused), refused
    assert server.text() == text
    assert server.editing.unsaved == ()


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (["buses", "main", "port"], "/dev/ttyUSB0"),
        (["buses", "more"], {"port": "sim://", "baud_bps": 115200, "firmware": 370}),
    ],
)
def test_no_port_of_a_robot_file_is_added_or_changed(server, place, value):
    client = server.join()
    refused = server.send(client, "value.set", file="arm.yaml", place=place, value=value)
    assert "port" in refused
    fields = {"place": ["poses", "up", "a"], "value": 25}
    assert server.send(client, "value.set", file="arm.yaml", **fields) is None


@pytest.mark.parametrize(
    "file", ["../x.yaml", "/etc/passwd", "tricks.py", "none.yaml", ".", "\0", "x" * 999]
)
def test_only_files_of_the_folder_are_edited(server, file):
    client = server.join()
    assert server.send(client, "value.set", file=file, place=["loop"], value=2)
    assert server.send(client, "key.set", keys=[key(0, file)], deg={"a": 1})
    assert server.editing.unsaved == ()


def test_whatever_is_sent_is_refused_in_words(server):
    """Random values at random places: the text stays a file, and no error is a fault of ours."""
    draw, client = random.Random(5), server.join()
    values = [0, -1, 1e300, True, "x", "", "\n", "é😀", [], {}, [[1]], {"a": {"b": [1, 2]}}, None]
    values += [
        "- x",
        "a: b",
        "# no",
        "*a",
        "&a",
        "!t",
        "'",
        '"',
        "{",
        "@",
        "\x07",
        "\u2028",
        "1:30",
    ]
    parts = ["keyframes", "layers", "events", "deg", "a", 0, 1, 2, 99, "robot", "at_s", "label"]
    ops = ["value.set", "item.insert", "item.delete", "item.move", "value.rename", "key.set"]
    done = 0
    for _ in range(600):
        op = draw.choice(ops)
        place = [draw.choice(parts) for _ in range(draw.randint(0, 4))]
        value = draw.choice(values)
        index = draw.choice([0, 1, 5])
        fields = {
            "value.set": {"place": place, "value": value},
            "item.insert": {"place": place, "index": index, "value": value},
            "item.delete": {"place": place, "index": index},
            "item.move": {"place": place, "index": index, "to": draw.choice([0, 1, 7])},
            "value.rename": {"place": place, "name": draw.choice(["a", "say", "é", "# x", "-"])},
            "key.set": {"keys": [key(1)], "values": {draw.choice(["label", "ease"]): value}},
        }[op]
        more = {} if op == "key.set" else {"file": "swing.yaml"}
        done += server.send(client, op, **more, **fields) is None
    assert done > 20
    while server.editing.undo:
        assert server.send(client, "undo") is None
    assert server.text() == SHOW[1:]


def test_any_edits_and_undos_give_the_bytes_back(server, folder):
    draw, client = random.Random(7), server.join()
    for _ in range(200):
        count = len(server.document.model()["files"]["swing.yaml"]["value"]["keyframes"])
        one = key(draw.randrange(count), "swing.yaml")
        match draw.randrange(8):
            case 0 | 1:
                server.send(client, "undo")
            case 2:
                server.send(client, "redo")
            case 3:
                new = {"file": "swing.yaml", "place": ["keyframes"], "at_s": draw.random() * 3}
                server.send(client, "key.add", keys=[{**new, "deg": {"a": draw.random()}}])
            case 4:
                server.send(client, "key.delete", keys=[one], ripple=draw.random() < 0.5)
            case 5:
                server.send(client, "key.set", keys=[one], values={"label": draw.choice("äöü")})
            case _:
                server.send(client, "key.move", keys=[one], by_s=draw.uniform(-1, 1))
    while server.editing.undo:
        assert server.send(client, "undo") is None
    assert server.editing.unsaved == ()
    assert server.send(client, "save") is None
    assert (folder / "swing.yaml").read_bytes() == SHOW.encode()
    while server.editing.redo:
        assert server.send(client, "redo") is None
    while server.editing.undo:
        assert server.send(client, "undo") is None
    assert server.text() == SHOW[1:]


def test_clients_that_know_late_converge(server):
    """Each edits what it knew last; it is accepted or refused, and all end with one text."""
    draw = random.Random(3)
    clients = [server.join() for _ in range(4)]
    known = {client.number: server.document.revision for client in clients}
    accepted = 0
    for number in range(300):
        client = draw.choice(clients)
        angle = float(number % 90)
        before = server.document.revision
        refused = server.send(
            client,
            "key.set",
            keys=[key(1)],
            deg={"a": angle},
            revision=known[client.number],
        )
        assert (refused is None) == (known[client.number] == before)
        accepted += refused is None
        assert (f"deg: {{a: {angle:g}}}" in server.text()) or refused
        if draw.random() < 0.5 or refused:
            known[client.number] = server.document.revision
    assert 50 < accepted < 300


def test_the_model_is_what_the_files_hold_now(server):
    client = server.join()
    server.send(client, "key.move", keys=[key(1)], by_s=0.5)
    model = server.document.model()
    assert model["revision"] == server.document.revision
    assert sorted(model["files"]) == ["arm.yaml", "nod.yaml", "swing.yaml"]
    (own,) = model["files"]["swing.yaml"]["lists"]
    assert own == {"place": ("keyframes",), "times_s": [0.0, 1.5, 2.0], "lines": [5, 6, 7]}


SMALL = "sequence: new\nrobot: arm.yaml\nkeyframes:\n  - {at_s: 0, deg: {a: 0}}\n"


def test_a_new_file_is_made_once_and_holds_nothing_that_no_edit_may_add(server, folder):
    client = server.join()
    assert server.send(client, "file.new", file="new.yaml", text=SMALL) is None
    assert (folder / "new.yaml").read_text() == SMALL
    assert "not overwritten" in server.send(client, "file.new", file="new.yaml", text=SMALL)
    (folder / "away.yaml").symlink_to(folder.parent / "away.yaml")
    robot = "robot: b\n{}joints:\n  a: {{id: 1, model: LSS-ST1, range_deg: [0, 9]}}\n"
    for name, text, words in (
        ("away.yaml", SMALL, "not in the folder"),
        ("../n.yaml", SMALL, "not in the folder"),
        ("n.py", SMALL, "ends in .yaml"),
        (".n.yaml", SMALL, "ends in .yaml"),
        ("n.yaml", SMALL + "events: [{at_s: 0, run: 'tricks:wave'}]\n", "a function that is run"),
        ("n.yaml", SMALL.replace("arm.yaml", "../arm.yaml"), "leads out"),
        ("n.yaml", SMALL + "sound: /etc/passwd\n", "leads out"),
        ("n.yaml", robot.format('buses: {main: {port: "/dev/ttyUSB0"}}\n'), "a port"),
        ("n.yaml", "stage: hall\nlisten: {http: ':80'}\n", "way out"),
        ("n.yaml", "stage: hall\n", "stage"),
        ("n.yaml", "notes: 1\n", "is no sequence"),
        ("n.yaml", "sequence: [", ""),
        ("n.yaml", SMALL + "lop: 3\n", "lop"),
    ):
        assert words in server.send(client, "file.new", file=name, text=text), (name, text)
        assert not (folder / "n.yaml").exists()
    assert not (folder.parent / "away.yaml").exists()
    assert server.send(client, "file.new", file="b.yaml", text=robot.format("")) is None
    assert server.send(server.join(Role.OPERATE), "file.new", file="n.yaml", text=SMALL)
    assert server.text() == SHOW.removeprefix("\ufeff"), "the open file is as it was"


def test_in_a_folder_nothing_is_open_until_a_file_of_it_is_loaded(folder):
    request = Request(number=0, path=folder)
    assert reply_to(request).kind == "folder"
    document = Document(request, lambda _: None, lambda: None)
    document.take(reply_to(request))
    message = document.message()
    assert (message.kind, message.file, message.errors, message.plan) == ("folder", "", (), None)
    new = e.FileNew(id=1, revision=document.revision, file="new.yaml", text=SMALL)
    assert document.edit(new) is True
    with pytest.raises(InputError, match="not in the folder"):
        document.load("../new.yaml")
    document.load("new.yaml")
    assert document.path == folder / "new.yaml"
    assert document.message().file == "new.yaml"


def test_long_lists_of_numbers_are_written_in_rows_with_the_ends_of_their_file(server):
    client = server.join()
    beats = [round(0.5 * n, 3) for n in range(1, 60)]
    assert server.send(client, "value.set", file="swing.yaml", place=["beats"], value=beats) is None
    lines = server.text().split("\n")
    assert max(map(len, lines)) <= 101
    assert all(line.endswith("\r") for line in lines[:-1])
    assert server.send(client, "undo") is None
    assert server.text() == SHOW.removeprefix("\ufeff")


def test_a_pose_that_is_saved_from_the_robot_is_a_step_of_undo(server, folder):
    client = server.join()
    server.document.expect_change(folder / "arm.yaml")
    write_pose(folder / "arm.yaml", "down", {"a": -20.0})
    server.document.look()
    assert "down: {a: -20}" in server.text("arm.yaml")
    assert server.send(client, "undo") is None
    assert server.editing.unsaved == ("arm.yaml",)
    with pytest.raises(InputError, match="not saved"):
        server.document.expect_change(folder / "arm.yaml")
    assert server.send(client, "save") is None
    assert (folder / "arm.yaml").read_text() == ROBOT
