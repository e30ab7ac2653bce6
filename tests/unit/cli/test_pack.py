"""`pack-report`: what a fault report needs is in it, and no secret is."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import pytest

from lss_motion.cli import play
from lss_motion.cli.main import main

SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"
SECRETS = ("hunter2", "T0PSECRET", "hooks-of-mine", "robin")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copytree(SEQUENCES, tmp_path / "robin", ignore=shutil.ignore_patterns("my_*"))
    monkeypatch.setenv("HOME", str(tmp_path / "robin"))
    return tmp_path / "robin"


def packed(folder, *words):
    path = folder / "fault.zip"
    assert main(["pack-report", *map(str, words), "-o", str(path)]) == 0
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


def test_a_show_is_packed_with_all_that_it_is_made_of_and_its_log(folder, capsys):
    log = folder / "show.log"
    assert play.main([str(folder / "tracks.yaml"), "--virtual", "--quiet", "--log", str(log)]) == 0
    found = packed(folder, folder / "tracks.yaml", log)
    about = json.loads(found["report.json"])
    assert {"files/tracks.yaml", "files/show.log", "files/figure.yaml"} <= set(found)
    assert about["check"]["kind"] == "show"
    assert about["versions"]["lss_motion"]
    assert any(finding["subject"] == "Python" for finding in about["doctor"])
    assert "look into it before you send it" in capsys.readouterr().out


def test_a_show_that_is_wrong_is_packed_with_its_error(folder):
    show = folder / "wave.yaml"
    show.write_text(show.read_text().replace("robot:", "robt:"), encoding="utf-8")
    found = packed(folder, show)
    error = json.loads(found["report.json"])["check"]
    assert error["error"] == "InputError"
    assert "robt" in error["text"]
    assert "files/wave.yaml" in found


def test_no_secret_is_packed(folder):
    stage = folder / "stages" / "haunted_hall.yaml"
    more = (
        'listen: {mqtt: "mqtt://me:hunter2@hub:1883"}\n'
        'alerts: {webhook: "https://x.org/hooks-of-mine"}\n'
    )
    stage.write_text(stage.read_text(encoding="utf-8") + more, encoding="utf-8")
    log = folder / "own.log"
    log.write_text(
        f'{{"file":"{folder}/x.yaml","token": "T0PSECRET","url":"https://x.org/a?key=T0PSECRET"}}\n'
    )
    found = packed(folder, stage, log)
    assert "files/haunted_hall.yaml" in found
    for name, content in found.items():
        assert not [secret for secret in SECRETS if secret in content], name
    assert "(left out)@hub:1883" in found["files/haunted_hall.yaml"]
    assert '"file":"~/x.yaml"' in found["files/own.log"]


def test_what_is_no_text_is_named_only(folder):
    (folder / "laugh.wav").write_bytes(b"RIFF")
    found = packed(folder, folder / "wave.yaml", folder / "laugh.wav")
    (named,) = json.loads(found["report.json"])["named_only"]
    assert named["file"].endswith("laugh.wav")
    assert not any("laugh" in name for name in found)


def test_nothing_of_the_user_is_replaced(folder, capsys):
    mine = folder / "mine.zip"
    mine.write_text("not an archive")
    for words in (
        ["wave.yaml", "-o", "mine.zip"],
        ["wave.yaml", "-o", "wave.yaml"],
        ["absent.yaml", "-o", "new.zip"],
    ):
        paths = [word if word == "-o" else str(folder / word) for word in words]
        assert main(["pack-report", *paths]) == 2
    assert mine.read_text() == "not an archive"
