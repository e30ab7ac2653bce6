"""A stage file becomes a `Stage`; each mistake is reported with its line and what is allowed."""

from __future__ import annotations

import re
from datetime import time

import jsonschema
import pytest

from lss_motion.errors import InputError, install_command
from lss_motion.files.yaml_source import read_yaml
from lss_motion.robot.on_fault import Cause
from lss_motion.stage import is_stage_file
from lss_motion.stage.file import Budget
from lss_motion.stage.load import load_stage, stage_schema, timecode_s
from lss_motion.stage.model import TriggerKind
from lss_motion.stage.triggering import cron_problem

WHOLE = """\
cues:
  - {cue: visitor, on: {sensor: door, below_mm: 800}, play: scare, cooldown_s: 20}
  - {cue: go, on: {osc: /lss/go}, play: hello, start: only_if_idle}
  - {cue: ten, on: {time: "*/10 18-23 * * fri,sat"}, play: [hello, scare], choose: random}
  - {cue: cue12, on: {timecode: "01:02:03:10"}, play: hello, priority: 5}
  - {cue: lamp, on: {sacn: 1, slot: 12}, play: scare, start: add}
  - {cue: note, on: {note: 60, channel: 2}, do: rest, disable: [go]}
sync:
  timecode: {source: ltc, rate_fps: 25, freewheel_s: 1.5, lost: hold, offset_s: -0.5}
  send: [{kind: mtc, output: Desk}]
listen:
  {http: "127.0.0.1:8440", osc: "[::1]:9000", midi: Keys, sacn: 10.0.0.2, allow: [10.0.0.0/8]}
duty:
  {work_s: 1800, rest: sleep, limp: true, temperature_c: {slow: 55, rest: 65},
   quiet: ["23:00-08:30"]}
on_fault: {attempts: {silent: 5, blocked: 1}, total: 6}
alerts: {webhook: "https://example.org/alert"}
log: {folder: nights, max_mb: 20}
time_zone: Europe/Berlin
"""


def test_every_value_of_a_stage_is_read(kit):
    stage = kit.load(WHOLE)
    by_name = {cue.name: cue for cue in stage.cues}
    assert (stage.name, stage.robot.name, stage.idle) == ("hall", "puppet", "idle")
    assert stage.shows["scare"].path == kit.folder / "scare.yaml"
    visitor = by_name["visitor"]
    assert (visitor.on.kind, visitor.on.address, visitor.on.side) == (
        TriggerKind.SENSOR,
        "door",
        "below",
    )
    assert (visitor.on.threshold, visitor.cooldown_s, visitor.line) == (800.0, 20.0, 6)
    assert by_name["ten"].shows == ("hello", "scare")
    assert by_name["ten"].choice == "random"
    assert by_name["cue12"].on.at_s == 3723 + 10 / 25
    assert by_name["cue12"].follows
    assert (by_name["lamp"].on.address, by_name["lamp"].on.threshold) == ("1/12", 127.0)
    assert (by_name["note"].on.channel, by_name["note"].deed) == (2, "rest")
    assert by_name["note"].disables == ("go",)
    assert (stage.sync.timecode.lost, stage.sync.timecode.offset_s) == ("hold", -0.5)
    assert stage.sync.send[0].output == "Desk"
    assert stage.listen.osc == ("::1", 9000)
    assert stage.listen.allow == ("10.0.0.0/8",)
    assert stage.duty.temperature_c == Budget(slow=55, rest=65)
    assert stage.duty.quiet == ((time(23), time(8, 30)),)
    assert stage.retry.allowed(Cause.SILENT) == 5
    assert stage.retry.allowed(Cause.RESTARTED) == 3
    assert stage.log.folder == kit.folder / "nights"
    assert str(stage.zone) == "Europe/Berlin"
    assert stage.addresses(TriggerKind.SENSOR) == ("door",)


BAD = [
    ("idle: idel", 5, "no show 'idel'; did you mean 'idle'?"),
    ("cues:\n  - {cue: a, on: {osc: /go}, play: hello}", 6, "give 'osc' under listen"),
    ("cues:\n  - {cue: a, on: {key: g}, play: helo}", 6, "did you mean 'hello'?"),
    ("cues:\n  - {cue: a, on: {key: g}}", 6, "does nothing"),
    ("cues:\n  - {cue: a, on: {}, play: hello}", 6, "a trigger is one of: sensor"),
    ("cues:\n  - {cue: a, on: {key: g, slot: 3}, play: hello}", 6, "slot does not belong to key"),
    ("cues:\n  - {cue: a, on: {key: g}, play: hello, do: stop}", 6, "'play' or 'do', not both"),
    ("cues:\n  - {cue: a, on: {key: g}, do: stop, start: add}", 6, "start belongs to play"),
    ("cues:\n  - {cue: a, on: {sensor: dor, below_mm: 9}, do: stop}", 6, "did you mean 'door'?"),
    ("cues:\n  - {cue: a, on: {sensor: door, below_raw: 9}, do: stop}", 6, "needs one of below_mm"),
    ("cues:\n  - {cue: a, on: {time: '5 25 * * *'}, do: stop}", 6, "is no time of day"),
    ("cues:\n  - {cue: a, on: {time: '5 2 * *'}, do: stop}", 6, "has 4 fields, not 5"),
    ("cues:\n  - {cue: a, on: {timecode: '00:00:01:00'}, do: stop}", 6, "there is no timecode"),
    (
        "sync: {timecode: {source: ltc}}\ncues:\n"
        "  - {cue: a, on: {timecode: '00:00:01:00', song: one}, play: hello}",
        7,
        "ltc does not say which song is played",
    ),
    ("cues:\n  - {cue: a, on: {key: g, song: one}, do: stop}", 6, "song does not belong to key"),
    ("cues:\n  - {cue: a, on: {go: false}, do: stop}", 6, "go can only be true"),
    ("cues:\n  - {cue: a, on: {key: g}, do: stop, enable: [b]}", 6, "no cue 'b'"),
    ("cues:\n  - {cue: a, on: {key: g}, do: stop, follow: true}", 6, "follow belongs to"),
    ("cues:\n  - {cue: a, on: {key: g}, play: hello, ready: true}", 6, "ready belongs to a cue"),
    (
        "sync: {timecode: {source: ltc}}\ncues:\n"
        "  - {cue: a, on: {timecode: '00:00:01:00'}, play: hello, ready: true}\n"
        "  - {cue: b, on: {timecode: '00:01:01:00'}, play: hello, ready: true}",
        8,
        "waits for one cue only, 'a' in line 6",
    ),
    ("cues:\n  - {cue: a, on: {key: g}, play: hello, start: now}", 6, "there are: only_if_idle"),
    ("cues: []\nlisten: {http: '127.0.0.1:99999'}", 6, "port 99999 is not from 1 to 65535"),
    ("listen: {allow: [10.0.0.1/8]}", 5, "is no network"),
    ("duty: {limp: true}", 5, "limp needs rest"),
    ("duty: {temperature_c: {slow: 70, rest: 60}}", 5, "must be below rest"),
    ("duty: {quiet: ['23:00-25:00']}", 5, "two times such as 23:00-08:00"),
    ("on_fault: {attempts: {silence: 3}}", 5, "did you mean 'silent'?"),
    ("time_zone: Europe/Berln", 5, "did you mean 'Europe/Berlin'?"),
    ("conductor: left", 5, "no figure 'left'"),
    ("figures: {left: {robot: robot.yaml}}", 3, "robot does not go with figures"),
]


@pytest.mark.parametrize(("more", "line", "reason"), BAD, ids=lambda value: str(value)[-30:])
def test_a_mistake_is_reported_with_its_line(kit, more, line, reason):
    text = kit.stage.replace("idle: idle\n", "")
    path = kit.write(f"{more}\n", text)
    with pytest.raises(InputError) as caught:
        load_stage(path)
    assert str(caught.value).startswith(f"{path}:{line - 1}: "), caught.value
    assert reason in caught.value.reason
    assert caught.value.more == ()


def test_all_mistakes_come_at_once_with_those_of_the_robot(kit):
    (kit.folder / "robot.yaml").write_text("robot: puppet\njoints: {neck: {id: 1}}\n", "utf-8")
    with pytest.raises(InputError) as caught:
        kit.load("cues:\n  - {cue: a, on: {key: g}}\n  - {cue: a, on: {key: h}, do: stop}\n")
    text = str(caught.value)
    assert "stage.yaml:6: does nothing" in text
    assert "stage.yaml:7: 'a' is given twice, first in line 6" in text
    assert "robot.yaml:2:" in text


def test_a_missing_show_names_the_place_where_it_was_looked_for(kit):
    (kit.folder / "hello.yaml").unlink()
    with pytest.raises(InputError, match=r"stage.yaml:3: show 'hello.yaml' not found; looked for"):
        kit.load()


def test_figures_have_their_own_robots_and_shows(kit):
    text = """\
stage: duet
figures: {left: {robot: robot.yaml, address: "left:7447"}, right: {robot: robot.yaml}}
shows: {hello: {left: hello.yaml, right: scare.yaml}, all: hello.yaml}
"""
    stage = kit.load(text=text)
    assert stage.robot is None
    assert stage.conductor == "left"
    assert stage.figures["left"].address == ("left", 7447)
    assert stage.shows["hello"].paths["right"].name == "scare.yaml"
    with pytest.raises(InputError, match=r"stage.yaml:3: no figure 'rigth'; did you mean 'right'"):
        kit.load(text=text.replace("right: scare", "rigth: scare"))
    with pytest.raises(InputError, match=r"\('left'\): must be written as in '192.168.1.20:7447'"):
        kit.load(text=text.replace("left:7447", "left"))


@pytest.mark.parametrize(
    ("text", "rate_fps", "expected"),
    [
        ("01:02:03:10", 25, 3723.4),
        ("00:00:01:12", 24, 1.5),
        # SMPTE ST 12-1: ten minutes of drop-frame have 17,982 frames.
        ("00:10:00;00", 29.97, 17_982 * 1001 / 30_000),
        ("00:01:00;02", 29.97, 1800 * 1001 / 30_000),
        ("00:01:00;00", 29.97, None),
        ("23:00:00:00", 29.97, 23 * 3603.6),
        ("23:00:00:00", 23.976, 23 * 3603.6),
        ("00:00:01:49", 50, 1.98),
        ("00:00:00:25", 25, None),
        ("24:00:00:00", 25, None),
    ],
)
def test_a_timecode_is_a_time(text, rate_fps, expected):
    assert timecode_s(text, rate_fps) == (
        None if expected is None else pytest.approx(expected, abs=1e-6)
    )


def test_the_schema_accepts_a_stage(kit):
    jsonschema.validate(read_yaml(kit.write(WHOLE)).value, stage_schema())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"stage": "x", "shows": {"a": "b"}, "ides": 3}, stage_schema())


def test_a_stage_file_is_told_from_a_show(kit):
    assert is_stage_file(kit.write())
    assert not is_stage_file(kit.folder / "hello.yaml")


def test_times_of_day_say_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cronsim", None)
    with pytest.raises(InputError, match=re.escape(install_command("stage"))):
        cron_problem("* * * * *")
