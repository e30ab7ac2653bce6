"""The open file, its planner, and what both make of every kind of file, right or wrong."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.studio.document import VIEWS_MAX, Document
from lss_motion.studio.planner import PlannerReply, Request, reply_to
from lss_motion.studio.planning import DIED, Planner

EXAMPLES = Path("sequences").resolve()
ROBOT = """\
robot: arm
buses: {main: {port: "sim://", baud_bps: 115200, firmware: 370}}
joints:
  a: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
"""
SHOW = """\
sequence: swing
robot: arm.yaml
keyframes:
  - {at_s: 0, deg: {a: 0}}
  - {at_s: 1, deg: {a: 30}}
  - {at_s: 2, deg: {a: 0}}
"""


@pytest.fixture
def folder(tmp_path):
    Path(tmp_path, "arm.yaml").write_text(ROBOT)
    Path(tmp_path, "swing.yaml").write_text(SHOW)
    return tmp_path


def plan(path, **fields):
    return reply_to(Request(number=3, path=path, **fields))


def test_a_show_becomes_a_plan_a_view_and_a_job(folder):
    reply = plan(folder / "swing.yaml")
    assert (reply.number, reply.kind, reply.title) == (3, "sequence", "swing")
    assert not reply.problems
    assert json.loads(reply.view)["plan"] == reply.plan
    assert json.loads(reply.robot)["joints"][0]["name"] == "a"
    assert reply.job
    assert reply.is_simulated
    assert set(reply.files) == {folder / "swing.yaml", folder / "arm.yaml"}
    assert reply.summary[0].startswith("swing: 2.000 s")
    other = plan(folder / "swing.yaml", port="/dev/ttyUSB7")
    assert (other.port, other.is_simulated) == ("/dev/ttyUSB7", False)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("hexapod_walk.yaml", "gait"),
        ("robots/desk_arm.yaml", "robot"),
        ("playlist.yaml", "playlist"),
    ],
)
def test_every_kind_of_file_can_be_opened(name, kind):
    reply = plan(EXAMPLES / name)
    assert (reply.kind, reply.problems) == (kind, ())
    assert (reply.plan is None) == (kind == "robot")
    assert reply.live_job
    assert json.loads(reply.robot)["figure"]


WRONG = {
    "no file": None,
    "empty": "",
    "no yaml": "sequence: [",
    "binary": "\0\0",
    "no joint": SHOW.replace("a: 30", "b: 30"),
    "no robot": SHOW.replace("arm.yaml", "leg.yaml"),
    "no plan": SHOW.replace("{at_s: 1, ", "{at_s: 0.01, anchor: true, "),
    "a program": "# lss program\n",
    "too deep": "[" * 3000,
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_stands_at_its_place(folder, name):
    path = folder / ("swing.lss" if name == "a program" else "swing.yaml")
    path.unlink(missing_ok=True)
    if WRONG[name] is not None:
        path.write_text(WRONG[name])
    reply = plan(path)
    assert reply.plan is None
    (first, line, text), *_ = reply.problems
    assert Path(first) == path
    assert text
    assert "Traceback" not in text
    assert (line == 5) == (name == "no joint")
    assert Path(first) in reply.files, "it is looked at until it is there"


def test_functions_of_a_show_are_named_and_none_is_called(folder):
    Path(folder, "tricks.py").write_text("def wave(show):\n    raise SystemExit\n")
    Path(folder, "swing.yaml").write_text(SHOW + "events:\n  - {at_s: 1, run: 'tricks:wave'}\n")
    reply = plan(folder / "swing.yaml")
    assert reply.functions == ("tricks:wave",)
    assert any("tricks.py" in note for note in reply.notes)
    assert [one.data for one in reply.modules] == [Path(folder, "tricks.py").read_bytes()]
    assert Path(folder, "tricks.py") in reply.files, "it is planned again when this changes"


# ---- the document


class AskedPlans(list):
    """The requests that a document made; `told` counts what clients were told."""

    told = 0

    def tell(self):
        self.told += 1


@pytest.fixture
def asked():
    return AskedPlans()


def test_a_change_on_disk_is_planned_again_and_the_last_good_plan_stays(folder, asked):
    document = Document(Request(number=0, path=folder / "swing.yaml"), asked.append, asked.tell)
    assert len(asked) == 1
    document.take(PlannerReply(number=1, plan="a", view=b"1", files=(folder / "arm.yaml",)))
    document.look()
    assert len(asked) == 1
    message = document.message()
    assert (message.plan, message.is_current, message.is_planning) == ("a", True, False)
    Path(folder, "arm.yaml").write_text(ROBOT + "\n")  # What the show includes.
    document.look()
    document.look()
    assert len(asked) == 2
    assert document.message().is_planning
    assert not document.message().is_current
    wrong = (str(folder / "arm.yaml"), 4, "no"), (str(folder.parent / "x.yaml"), None, "far")
    document.take(PlannerReply(number=2, problems=wrong, files=(folder.parent / "x.yaml",)))
    message = document.message()
    assert (message.plan, message.is_current) == ("a", False)
    assert [(one.path, one.line) for one in message.errors] == [
        ("arm.yaml", 4),
        (str(folder.parent / "x.yaml"), None),
    ]
    Path(folder, "arm.yaml").write_text(ROBOT)
    document.look()
    assert len(asked) == 3, "what was included is looked at while there is an error"
    document.take(PlannerReply(number=3, problems=wrong))
    Path(folder, "new.yaml").write_text("")
    document.look()
    assert len(asked) == 4, "and files that come to be"
    revision = document.revision
    document.take(PlannerReply(number=3, plan="b", view=b"2"))
    assert document.revision == revision
    assert (document.view("a"), document.view("b")) == (b"1", b"2")
    for number in range(VIEWS_MAX):
        document.take(PlannerReply(number=4, plan=str(number), view=b"3"))
    assert document.view("a") is None


def test_only_files_below_the_folder_are_opened(folder, asked):
    document = Document(Request(number=0, path=folder / "swing.yaml"), asked.append, asked.tell)
    document.take(PlannerReply(number=1, plan="a", view=b"1"))
    for name in ("../swing.yaml", "/etc/passwd", "none.yaml", "\0", "x" * 5000 + ".yaml", "."):
        with pytest.raises(InputError):
            document.load(name)
    assert (document.path, len(asked)) == (folder / "swing.yaml", 1)
    document.load("arm.yaml")
    assert asked[-1].path == folder / "arm.yaml"
    assert document.message().plan is None
    assert document.view("a") is None


# ---- the planner process


def test_the_latest_request_wins_and_a_planner_that_is_gone_is_started_again(folder, monkeypatch):
    monkeypatch.setattr("lss_motion.studio.planning.PATIENCE_S", 0.2)
    replies = []

    async def use():
        planner = Planner(replies.append)

        async def until_idle():
            async with asyncio.timeout(60.0):
                while planner.is_busy:
                    await asyncio.sleep(0.02)

        wrong = Request(number=0, path=folder / "none.yaml")
        planner.ask(wrong)
        await until_idle()
        first = planner.pid
        # It stands still while it is asked twice: the second request gets a planner of its own.
        os.kill(first, signal.SIGSTOP)
        planner.ask(wrong)
        planner.ask(Request(number=0, path=folder / "swing.yaml"))
        await until_idle()
        assert planner.pid != first
        # One that ends at a request is tried once more.
        for _ in range(2):
            os.kill(planner.pid, signal.SIGSTOP)
            pid = planner.pid
            if not planner.is_busy:
                planner.ask(wrong)
            os.kill(pid, signal.SIGKILL)
            async with asyncio.timeout(60.0):
                while planner.pid == pid:
                    await asyncio.sleep(0.02)
        await until_idle()
        planner.close()

    asyncio.run(use())
    assert [bool(reply.problems) for reply in replies] == [True, False, True]
    assert replies[1].title == "swing"
    assert replies[2].problems[0][2] == DIED
