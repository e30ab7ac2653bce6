"""What is not saved: a file that another program changes, and edits that a crash left behind."""

from __future__ import annotations

import json
import os
import signal

import pytest

from tests.browser.test_robot_page import until
from tests.browser.test_shaping import CHECKED, ROBOT, SHOW, Shaped, shaping

pytestmark = pytest.mark.slow

THERE = SHOW.replace("# she looks up", "# written elsewhere")
BANNERS = "document.querySelector('.banners').textContent"


def moved(own):
    """Move the key at 2 s by half a second with the keyboard; return the text."""
    x, y, *_ = own.place("grüße", 2)
    own.click(x, y)
    for _ in range(5):
        own.page.key("Shift+ArrowRight")
    text = SHOW.replace("at_s: 2,", "at_s: 2.5,")
    own.becomes(text)
    return text


def press(page, name):
    button = "[...document.querySelectorAll('.banners button')]"
    page.wait(f"{button}.some((one) => one.textContent === {json.dumps(name)})", 20.0)
    page.run(f"{button}.find((one) => one.textContent === {json.dumps(name)}).click()")


def differs(own):
    """Change the file elsewhere while it is edited; wait for the banner and its difference."""
    own.path.write_text(THERE, encoding="utf-8")
    own.page.wait(f"{BANNERS}.includes('changed on disk while it is edited here')", 20.0)
    own.page.run("document.querySelector('.banners summary').click()")
    lines = own.page.run("document.querySelector('.banners .difference').textContent").split("\n")
    assert "-  # written elsewhere" in lines
    assert "+  - {at_s: 2.5, deg: {pan: 40, tilt: -20}, label: up}" in lines


def test_a_file_changed_elsewhere_is_not_overwritten_before_a_person_has_chosen(
    studio, opened, tmp_path
):
    with shaping(studio, opened, tmp_path) as own:
        text = moved(own)
        differs(own)
        own.page.key("Control+s")
        own.page.wait(f"{BANNERS}.includes('✕')")
        assert own.path.read_text("utf-8") == THERE, "saving does not overwrite it"
        press(own.page, "Keep what is here")
        own.page.wait(f"!{BANNERS}.includes('changed on disk')")
        assert own.text() == text
        assert own.path.read_text("utf-8") == THERE
        own.page.key("Control+s")
        own.page.wait("[...document.querySelectorAll('.edits button')].at(-1).disabled")
        assert own.path.read_text("utf-8") == text


def test_what_is_on_disk_is_taken_and_can_be_undone(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        text = moved(own)
        differs(own)
        press(own.page, "Take what is on disk")
        own.becomes(THERE)
        own.page.wait(f"!{BANNERS}.includes('changed on disk')")
        own.page.key("Control+z")
        own.becomes(text)


def test_edits_that_a_crash_left_are_found_again_kept_or_given_up(studio, opened, tmp_path):
    (tmp_path / "two.yaml").write_text(ROBOT, encoding="utf-8")
    path = tmp_path / "show.yaml"
    path.write_text(SHOW, encoding="utf-8")
    kept = path.with_name(".show.yaml.unsaved")
    with studio(path) as server, opened(server) as page:
        page.key("2")
        page.wait(CHECKED)
        text = moved(Shaped(page, server, path))
        until(lambda: kept.exists() and "at_s: 2.5" in kept.read_text("utf-8"), "it is kept")
        os.kill(server.process.pid, signal.SIGKILL)
    assert path.read_text("utf-8") == SHOW
    with studio(path) as server, opened(server) as page:
        page.key("2")
        page.wait(f"{BANNERS}.includes('were found again: show.yaml')", 20.0)
        own = Shaped(page, server, path)
        own.becomes(text)
        page.key("Control+z")
        own.becomes(SHOW)
        page.key("Control+y")
        own.becomes(text)
        page.key("Control+s")
        page.wait("[...document.querySelectorAll('.edits button')].at(-1).disabled", 20.0)
        assert not page.run(f"{BANNERS}.includes('were found again')")
        assert path.read_text("utf-8") == text
        assert not kept.exists()
