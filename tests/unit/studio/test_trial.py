"""What an edit would do is told before it is made: as the plan of the whole says afterwards."""

from __future__ import annotations

import asyncio
import base64
from pathlib import Path

import msgspec
import numpy as np
import pytest

from lss_motion.playing.remote import schema as m
from lss_motion.studio.operations import RobotNames, new_texts
from lss_motion.studio.planner import EditTrial, Request, reply_to
from lss_motion.studio.planning import Planner
from lss_motion.studio.trial import tried

ROBOT = """\
robot: arm
buses: {main: {port: "sim://", baud_bps: 115200, firmware: 370}}
joints:
  a: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
  b: {id: 2, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
"""
KEYS = "".join(
    f"  - {{at_s: {2 * index}, deg: {{a: {angle}}}, hold_s: 0.5}}\n"
    for index, angle in enumerate((0, 30, -20, 10, 0, 25, 0, 15, 0))
)
SHOW = f"sequence: swing\nrobot: arm.yaml\nkeyframes:\n{KEYS}"
TRACKS = SHOW + (
    "tracks:\n  second:\n    keyframes:\n      - {at_s: 0, deg: {b: 0}}\n"
    "      - {at_s: 1, deg: {b: 10}, hold_s: 1}\n      - {at_s: 3, deg: {b: 0}}\n"
)
LAYERED = SHOW + "layers:\n  - {file: swing.yaml, mode: add, weight: 0.1}\n"


class Show:
    """A show with its plan, of which edits are tried."""

    def __init__(self, folder, text):
        self.folder, self.path = folder.resolve(), folder.resolve() / "show.yaml"
        (folder / "arm.yaml").write_text(ROBOT)
        (folder / "swing.yaml").write_text(SHOW)
        self.path.write_text(text)
        kept = []
        assert not reply_to(Request(number=0, path=self.path), kept.append).problems
        (self.whole,) = kept

    def operation(self, op, **fields):
        return msgspec.convert({"op": op, "revision": 0, **fields}, m.AnyOperation)

    def tried(self, operation):
        return tried(operation, {}, self.whole)

    def planned(self, operation):
        """Return the plan of the whole after the edit."""
        texts = new_texts(operation, lambda name: (self.path, self.path.read_text()), RobotNames())
        kept = []
        data = {path: after.encode() for path, (_, after) in texts.items()}
        reply_to(Request(number=0, path=self.path, texts=data), kept.append)
        return kept[0].show.trajectory


def key(index=None, *place):
    item = [] if index is None else [index]
    return {"file": "show.yaml", "place": [*place, "keyframes", *item]}


EDITS = [
    ("key.set", {"keys": [key(3)], "deg": {"a": 12.5}}),
    ("key.move", {"keys": [key(3)], "by_s": 0.4}),
    ("key.move", {"keys": [key(3)], "by_s": -1.3}),
    ("key.move", {"keys": [key(3)], "by_s": 0.8, "ripple": True}),
    ("key.set", {"keys": [key(3)], "deg": {"a": 80}, "values": {"at_s": 4.65}}),
    ("key.delete", {"keys": [key(3)]}),
    ("key.add", {"keys": [{**key(), "at_s": 7, "deg": {"a": 1}}]}),
]


@pytest.mark.parametrize(("op", "fields"), EDITS)
def test_a_window_is_the_part_of_the_plan_of_the_whole(tmp_path, op, fields):
    show = Show(tmp_path, SHOW)
    operation = show.operation(op, **fields)
    problem, window = show.tried(operation)
    assert problem is None
    assert window.is_joined
    whole = show.planned(operation)
    deg = np.frombuffer(base64.b64decode(window.deg["a"]), "<f4")
    times_s = window.from_s + window.step_s * np.arange(len(deg))
    column = whole.joints.index("a")
    assert deg == pytest.approx(whole.sample(times_s, 0)[:, column], abs=0.02)
    late_s = [one.planned_s - one.authored_s for one in window.keys]
    marks = {mark.place: mark.planned_s - mark.authored_s for mark in whole.marks}
    assert max(late_s) == pytest.approx(max(marks.values()), abs=1e-3)
    assert bool(window.slow) == bool(whole.stretched)


def test_an_edit_of_a_track_has_the_window_of_its_track(tmp_path):
    show = Show(tmp_path, TRACKS)
    problem, window = show.tried(
        show.operation("key.set", keys=[key(1, "tracks", "second")], deg={"b": 20})
    )
    assert (problem, list(window.deg)) == (None, ["b"])
    problem, window = show.tried(show.operation("key.set", keys=[key(1)], deg={"a": 20}))
    assert (problem, list(window.deg)) == (None, ["a"])


def test_where_only_the_whole_can_tell_there_is_no_window(tmp_path):
    show = Show(tmp_path, LAYERED)
    assert show.tried(show.operation("key.set", keys=[key(1)], deg={"a": 20})) == (None, None)


@pytest.mark.parametrize(
    ("op", "fields", "why"),
    [
        ("key.set", {"keys": [key(1)], "deg": {"c": 1}}, "unknown joint"),
        ("key.set", {"keys": [key(1)], "deg": {"a": 91}}, "range"),
        ("key.move", {"keys": [key(1)], "by_s": -9}, "before the start"),
        ("value.set", {"file": "show.yaml", "place": ["robot"], "value": "/etc/x"}, "leads out"),
        ("value.set", {"file": "../x.yaml", "place": ["robot"], "value": "x"}, "not in the folder"),
        (
            "value.set",
            {"file": "show.yaml", "place": ["events"], "value": [{"at_s": 1, "run": "os:abort"}]},
            "neither added nor changed",
        ),
        ("key.delete", {"keys": [key(1) | {"file": "\0"}]}, "no name of a file"),
        ("key.delete", {"keys": [key(1) | {"file": "x" * 999}]}, "cannot be read"),
    ],
)
def test_what_cannot_be_is_told_in_words(tmp_path, op, fields, why):
    show = Show(tmp_path, SHOW)
    problem, window = show.tried(show.operation(op, **fields))
    assert window is None
    assert why in problem


def test_trials_wait_for_the_plan_and_the_newest_wins(tmp_path):
    show = Show(tmp_path, SHOW)
    replies, results = [], []

    async def use():
        planner = Planner(replies.append, results.append)

        async def until(is_done):
            async with asyncio.timeout(60.0):
                while not is_done():
                    await asyncio.sleep(0.02)

        planner.ask(Request(number=0, path=show.path, texts={Path("/x"): b"x" * 3_000_000}))
        for number in range(1, 4):
            operation = show.operation("key.set", keys=[key(3)], deg={"a": 10 + number})
            planner.try_edit(EditTrial(number=number, operation=operation, texts={}))
        await until(lambda: len(results) == 3)
        assert [(one.number, one.is_dropped) for one in results] == [
            (1, True),
            (2, True),
            (3, False),
        ]
        assert results[-1].window is not None
        assert len(replies) == 1
        planner.try_edit(EditTrial(number=5, operation=operation, texts={}))
        planner.ask(Request(number=0, path=show.path))
        assert results[-1].is_dropped
        await until(lambda: len(replies) == 2)
        planner.close()

    asyncio.run(use())
