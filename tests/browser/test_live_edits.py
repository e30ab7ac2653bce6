"""A show is edited on the Timeline while it plays, judged at the horns of the servos."""

from __future__ import annotations

import json

import pytest

from tests.browser.test_robot_page import targets
from tests.browser.test_shaping import CHECKED, Shaped

pytestmark = pytest.mark.slow

SHOW = """\
sequence: evening
robot: two.yaml
keyframes:
  - {at_s: 0, deg: {pan: 0}}
  - {at_s: 1.5, deg: {pan: 10}, label: begun}
  - {at_s: 4, deg: {pan: 0}}
  - {at_s: 12, deg: {pan: 20}, hold_s: 2}
"""
BANNERS = "document.querySelector('.banners').textContent"


@pytest.fixture
def evening(studio, opened, two):
    path, bus = two
    path.write_text(SHOW, encoding="utf-8")
    with studio(path) as server, opened(server) as page:
        page.key("2")
        page.wait(CHECKED)
        page.click("[data-go]")
        page.wait("document.querySelector('.state').dataset.state === 'waits'", 20.0)
        page.run("new Promise((done) => setTimeout(done, 700))")
        page.click("[data-go].go-ready")
        page.wait("document.querySelector('.state').dataset.state === 'playing'", 20.0)
        yield Shaped(page, server, path), bus


def turned(own, deg, steps):
    """Turn the last key, which is at an angle, by steps of 5 degrees."""
    own.click(*own.place("pan", 12, deg)[:2])
    for _ in range(steps):
        own.page.key("Shift+ArrowUp")
    text = SHOW.replace("pan: 20}", f"pan: {deg + 5 * steps}}}")
    asked = f"fetch('/text/{own.path.name}').then((answer) => answer.text())"
    own.page.wait(f"{asked}.then((text) => text === {json.dumps(text)})", 20.0)


def press(page, scope, name):
    button = f"[...document.querySelectorAll('{scope} button')]"
    page.wait(f"{button}.some((one) => one.textContent === '{name}' && !one.disabled)", 20.0)
    page.run(f"{button}.find((one) => one.textContent === '{name}').click()")


def check_horn(page, bus, deg):
    """Wait for the end of the show; assert where its horn has come to."""
    page.wait(
        "!['playing', 'stopping'].includes(document.querySelector('.state').dataset.state)", 30.0
    )
    assert page.run("document.querySelector('.state').dataset.state") != "fault"
    commanded = targets(bus, 1)
    assert abs(commanded[-1] / 10.0) == pytest.approx(deg, abs=1.0)


def test_an_edit_ahead_is_taken_into_the_show_that_plays(evening):
    own, bus = evening
    page = own.page
    turned(own, 20, 2)
    page.wait(f"{BANNERS}.includes('has changed since START')")
    press(page, ".banners", "Play the edit now")
    page.wait(f"{BANNERS}.includes('goes on with the edit')", 20.0)
    page.wait(f"!{BANNERS}.includes('has changed since START')")
    check_horn(page, bus, 30.0)


def test_live_takes_what_it_can_and_says_why_the_rest_is_kept(evening):
    own, bus = evening
    page = own.page
    press(page, ".tools", "Live")
    turned(own, 20, 1)
    page.wait(f"{BANNERS}.includes('goes on with the edit')", 20.0)
    page.wait("Number(document.querySelector('.way-at').textContent.split(':')[1]) > 5", 20.0)
    turned(own, 25, 1)
    page.wait(f"{BANNERS}.includes('kept for the next START')", 20.0)
    assert page.run(f"{BANNERS}.includes('would have to jump')")
    check_horn(page, bus, 25.0)
