"""The morning after a night: sums by hand, broken lines, text, JSON and a page."""

from __future__ import annotations

import json
import re
from datetime import datetime
from xml.etree import ElementTree as ET

import pytest

from lss_motion.cli.main import main
from lss_motion.errors import EXIT_INPUT
from lss_motion.stage.morning import read_night, text_of

LINES = [
    ("2026-10-30T10:00:00", "over", {"show": "old", "outcome": "finished", "played_s": 1,
     "missed": 0, "error_max_deg": 50.0, "worst": "neck"}),
    ("2026-10-30T18:00:00", "connected", {}),
    ("2026-10-30T18:00:05", "fired", {"cue": "door", "what": "plays scare"}),
    ("2026-10-30T18:00:08", "over", {"show": "scare", "outcome": "finished", "played_s": 3.0,
     "missed": 2, "error_max_deg": 6.5, "worst": "jaw"}),
    ("2026-10-30T18:00:09", "refused", {"cue": "door", "reason": "cooldown, for 5.0 s",
     "count": 1}),
    ("2026-10-30T18:00:59", "refused", {"cue": "door", "reason": "cooldown", "count": 41}),
    ("2026-10-30T18:01:00", "sample", {"hottest_c": 61.0, "hottest": "jaw", "current_a": 0.5,
     "voltage_min_v": 11.5}),
    ("2026-10-30T19:00:00", "refused", {"cue": "bell", "reason": "it is disabled", "count": 1}),
    ("2026-10-30T20:00:00", "fault", {"cause": "silent"}),
    ("2026-10-30T20:00:00", "alert", {"alert": "fault"}),
    ("2026-10-30T20:00:00", "rest", {"reasons": ["waits after a fault (for 10 s)"]}),
    ("2026-10-30T20:02:00", "rest", {"reasons": []}),
    ("2026-10-30T23:00:00", "rest", {"reasons": ["quiet hours"]}),
    ("2026-10-31T00:00:00", "fault", {"cause": "silent"}),
    ("2026-10-31T00:00:00", "alert", {"alert": "given_up"}),
    ("2026-10-31T00:30:00", "lost", {"count": 7}),
]  # fmt: skip
TEXTS = {"fault": "joint 'jaw' is silent", "alert": "joint 'jaw' is silent; waits after a fault"}


@pytest.fixture
def folder(tmp_path):
    for day in ("2026-10-30", "2026-10-31"):
        lines = [
            json.dumps({"t": f"{t}+01:00", "kind": kind, "text": TEXTS.get(kind, ""), **more})
            for t, kind, more in LINES
            if t.startswith(day)
        ]
        (tmp_path / f"stage-{day}-0000.jsonl").write_text("\n".join([*lines, ""]))
    with (tmp_path / "stage-2026-10-31-0000.jsonl").open("a") as file:
        file.write('{"t": "2026-10-31T00:31:00+01:00", "kin')
    return tmp_path


def test_a_night_is_summed_up(folder):
    night = read_night(folder, datetime.fromisoformat("2026-10-30T18:00:00"))
    assert list(night.shows) == ["scare"]
    assert (night.shows["scare"].plays, night.shows["scare"].missed) == (1, 2)
    assert night.cues["door"].fired == 1
    assert night.cues["door"].refused == {"cooldown": 42}
    assert (night.hottest, night.hottest_c) == ("jaw", 61.0)
    assert (night.worst, night.error_max_deg, night.worst_show) == ("jaw", 6.5, "scare")
    assert night.rests_s == {"waits after a fault": 120.0, "quiet hours": 5400.0}
    assert (night.fault_count, night.given_up, night.lost_lines) == (2, 1, 7)
    assert night.broken_lines == 1
    assert "old" in read_night(folder).shows


def test_the_text_names_what_to_look_at(folder):
    text = "\n".join(text_of(read_night(folder, datetime.fromisoformat("2026-10-30T18:00:00"))))
    assert "6.5 h): 1 play, 2 faults, GAVE UP" in text
    assert "42 x cooldown" in text
    look = text.partition("look at\n")[2]
    for words in (
        "gave up", "2 x joint 'jaw' is silent", "jaw was 61 C", "jaw was 6.5 deg off",
        "sent too late in scare", "bell was always refused", "8 lines of the log are missing",
    ):  # fmt: skip
        assert words in look, words


def test_the_command_prints_json_and_writes_a_page_with_plots(folder, tmp_path, capsys):
    page = tmp_path / "night.html"
    assert main(["morning", str(folder), "--json", "--html", str(page)]) == 0
    assert json.loads(capsys.readouterr().out)["cues"]["door"]["fired"] == 1
    text = page.read_text("utf-8")
    assert "gave up after faults" in text
    assert "<script" not in text
    assert "<pre" not in text
    for cells in (["scare", "1", "1", "0", "0.1", "6.5 deg jaw"], ["door", "1", "42 x cooldown"]):
        assert re.search("".join(rf"<td[^>]*>{re.escape(cell)}</td>" for cell in cells), text)
    assert text.index("<h2>look at</h2>") < text.index("<h2>shows</h2>") < text.index("<svg")
    assert not re.findall(r'(?:src|href)="http', text.partition("<svg")[0])
    ET.fromstring(text[text.index("<svg") : text.index("</svg>") + 6])
    assert main(
        ["morning", str(folder), "--html", str(folder / "stage-2026-10-30-0000.jsonl")]
    ) == (EXIT_INPUT)
    assert main(["morning", str(folder), "--since", "yesterday"]) == EXIT_INPUT
    assert main(["morning", str(tmp_path / "no")]) == EXIT_INPUT
    assert "has no log of a stage" in capsys.readouterr().err


def of_lines(tmp_path, *lines):
    texts = [
        json.dumps({"t": f"2026-10-30T{t}+01:00", "kind": kind, "text": "", **more})
        for t, kind, more in lines
    ]
    (tmp_path / "stage-2026-10-30-0000.jsonl").write_text("\n".join([*texts, ""]))
    return read_night(tmp_path)


@pytest.mark.parametrize("cut", ["must_restart", "begins"])
def test_a_rest_ends_with_its_process_and_restarts_are_counted(tmp_path, cut):
    """New files end a process with a line, a power cut without one."""
    night = of_lines(
        tmp_path,
        ("18:00:00", "begins", {}),
        ("18:10:00", "rest", {"reasons": ["quiet hours"]}),
        ("18:20:00", "connecting", {}),
        ("18:20:00" if cut == "must_restart" else "19:00:00", cut, {}),
        ("19:00:01", "begins", {}),
        ("21:00:00", "rest", {"reasons": ["too hot (jaw)"]}),
        ("21:01:00", "rest", {"reasons": []}),
        ("22:00:00", "note", {}),
    )
    assert night.rests_s == {"quiet hours": 600.0, "too hot": 60.0}
    assert night.restarts == (1 if cut == "must_restart" else 2)
    assert f"began anew: {night.restarts} time" in "\n".join(text_of(night))
