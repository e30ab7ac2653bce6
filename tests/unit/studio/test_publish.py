"""A published page: consistent as it is, and what was changed in it is found."""

from __future__ import annotations

import json
import re
import shutil
import wave
from pathlib import Path

import pytest

from lss_motion.cli.main import main
from lss_motion.studio.publish import data_of, page_of, published, verified

SEQUENCES = Path(__file__).resolve().parents[3] / "sequences"
MARKUP = "<script>document.title='x'</script>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("publish") / "shows"
    shutil.copytree(SEQUENCES, path, ignore=shutil.ignore_patterns("my_*", "pictures"))
    with wave.open(str(path / "bell.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(8000))
    text = (path / "wave.yaml").read_text(encoding="utf-8")
    text += "events:\n  - {at_s: 1.0, sound: bell.wav}\n"
    (path / "bell.yaml").write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page(folder):
    return page_of(published(folder / "bell.yaml"))


@pytest.mark.parametrize("name", ["fastest", "owl", "playlist", "tracks"])
def test_an_example_is_published_and_consistent(folder, name, tmp_path, capsys):
    out = tmp_path / "show.html"
    assert main(["publish", str(folder / f"{name}.yaml"), "-o", str(out)]) == 0
    assert main(["verify", str(out)]) == 0
    assert "consistent: the files in it give this plan" in capsys.readouterr().out


def test_a_page_has_all_files_and_sounds_and_loads_nothing(page):
    data = data_of(page)
    assert {"bell.yaml", "bell.wav", "robots/desk_arm.yaml"} <= set(data["files"])
    assert data["cues"][0] == {"at_s": 1.0, "sound": "bell.wav"}
    shown = page.split('<script type="application/json"')[0]
    assert not re.findall(r"(?:src|href)\s*=|url\(|@import", shown)


CHANGES = {
    "a verdict": (lambda page: page.replace("every keyframe is on time", "all is well"), "shown"),
    "a picture": (
        lambda page: page.replace('<polyline points="0.0,', '<polyline points="9.0,'),
        "shown",
    ),
    "a limit that was kept": (
        lambda page: changed(page, "check", "joints", "wrist", "accel_deg_s2", 100.0),
        "check.joints.wrist.accel_deg_s2",
    ),
    "a late keyframe without its name": (
        lambda page: changed(page, "check", "late_keyframes", [{"late_s": 1.0}]),
        "the show cannot be made again",
    ),
    "a frame of the plan": (
        lambda page: changed(page, "plan", "deg", 20, [0.0] * 5),
        "plan.deg[20]",
    ),
    "a file": (
        lambda page: changed(page, "files", "bell.yaml", "text", "sequence: other\n"),
        "not the file that its hash names",
    ),
    "a file outside": (
        lambda page: changed(page, "files", "../bell.yaml", {"text": "", "sha256": ""}),
        "lies outside of the folder",
    ),
    "a sound": (
        lambda page: changed(page, "files", "bell.wav", "base64", "AAAA"),
        "not the file that its hash names",
    ),
    "another instant of a sound": (
        lambda page: changed(page, "cues", 0, "at_s", 2.0),
        "cues[0].at_s",
    ),
}


def changed(page, *place_and_value):
    """Return the page of data that were changed at a place."""
    *place, key, value = place_and_value
    data = inner = data_of(page)
    for part in place:
        inner = inner[part]
    inner[key] = value
    return page_of(data) if key != "late_keyframes" else rewritten(page, data)


def rewritten(page, data):
    """Return the page with other data, whose shown text stays as it was."""
    text = json.dumps(data).replace("</", "<\\/")
    return re.sub(
        r'(id="lss_motion">\n).*?(\n</script>)', lambda m: m[1] + text + m[2], page, flags=re.DOTALL
    )


@pytest.mark.parametrize("what", CHANGES)
def test_what_was_changed_is_found(page, what, tmp_path, capsys):
    change, said = CHANGES[what]
    other = change(page)
    assert other != page
    assert any(said in problem for problem in verified(other)), verified(other)
    path = tmp_path / "show.html"
    path.write_text(other, encoding="utf-8")
    assert main(["verify", str(path)]) == 5
    assert "not consistent" in capsys.readouterr().err


def test_rounding_of_another_processor_is_no_change(page):
    data = data_of(page)
    data["plan"]["deg"] = [[deg + 0.002 for deg in row] for row in data["plan"]["deg"]]
    data["check"]["joints"]["wrist"]["bound_deg"] += 1e-6
    assert verified(page_of(data)) == []


@pytest.mark.parametrize("content", ["", "<!doctype html><p>hello", "plain"])
def test_another_page_is_refused(tmp_path, capsys, content):
    path = tmp_path / "other.html"
    path.write_text(content)
    assert main(["verify", str(path)]) == 2
    assert "is no page of lss-motion publish" in capsys.readouterr().err


def test_markup_in_names_is_text(folder):
    text = (folder / "wave.yaml").read_text(encoding="utf-8")
    (folder / "markup.yaml").write_text(
        re.sub(r"^sequence: .*$", f'sequence: "{MARKUP}"', text, count=1, flags=re.MULTILINE)
    )
    page = page_of(published(folder / "markup.yaml"))
    assert MARKUP not in page
    assert verified(page) == []
