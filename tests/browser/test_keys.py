"""The conventions of the keyboard on the Timeline: each key does what people know it for."""

from __future__ import annotations

import pytest

from tests.browser.test_shaping import ROBOT, SHOW, shaping

pytestmark = pytest.mark.slow

SIDED = ROBOT + "mirror: {opposite: {pan: tilt}}\n"
DRAFT = "(document.querySelector('.board').dataset.draft ?? '')"


@pytest.fixture
def shaped(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path, robot=SIDED) as own:
        yield own


def chosen(own, at_s=4.0):
    """Choose the key of the lane at an instant."""
    x, y, per_s, _ = own.place("grüße", at_s)
    own.click(x, y)
    return x, y, per_s


def undone(own):
    own.page.key("Control+z")
    own.becomes(SHOW)


def test_chosen_keys_follow_the_pointer_or_the_arrows_until_a_click_or_enter(shaped):
    x, y, per_s = chosen(shaped)
    page = shaped.page
    page.key("g")
    page.pointer("mouseMoved", x + 0.5 * per_s, y)
    page.wait(f"{DRAFT}.includes('+0.5')")
    page.key("Escape")
    page.wait(f"{DRAFT} === ''")
    assert shaped.text() == SHOW, "Escape gives it up"
    page.pointer("mouseMoved", x, y)
    page.key("g")
    page.pointer("mouseMoved", x + 0.5 * per_s, y)
    page.press_pointer(x + 0.5 * per_s, y)
    page.pointer("mouseReleased", x + 0.5 * per_s, y)
    shaped.becomes(SHOW.replace("at_s: 4.0", "at_s: 4.5"))
    undone(shaped)
    for key in ("g", "ArrowRight", "Shift+ArrowRight", "Enter"):
        page.key(key)
    shaped.becomes(SHOW.replace("at_s: 4.0", "at_s: 4.11"))
    undone(shaped)


def test_keys_are_scaled_about_the_cursor_in_time_or_angle(shaped):
    page = shaped.page
    page.key("Home")
    chosen(shaped)
    page.key("Control+Home")
    for key in ("s", "Shift+ArrowRight", "Enter"):
        page.key(key)
    shaped.becomes(SHOW.replace("at_s: 4.0", "at_s: 4.4"))
    undone(shaped)
    page.key("Escape")
    chosen(shaped, 2.0)
    page.key("Control+Home")
    for key in ("s", "y", "Shift+ArrowDown", "Enter"):
        page.key(key)
    shaped.becomes(SHOW.replace("deg: {pan: 40, tilt: -20}", "deg: {pan: 36, tilt: -18}"))
    undone(shaped)


def test_keys_are_duplicated_and_mirrored(shaped):
    page = shaped.page
    chosen(shaped, 2.0)
    for key in ("Shift+D", *["Shift+ArrowRight"] * 5, "Enter"):
        page.key(key)
    copy = "  - {at_s: 2.5, deg: {pan: 40, tilt: -20}}\n"
    shaped.becomes(SHOW.replace("  - {at_s: 4.0", f"{copy}  - {{at_s: 4.0"))
    assert shaped.chosen() == "Key", "the copy is chosen"
    undone(shaped)
    chosen(shaped, 2.0)
    page.key("Control+m")
    shaped.becomes(SHOW.replace("{pan: 40, tilt: -20}", "{pan: 20, tilt: -40}"))
    undone(shaped)


def test_a_box_begins_on_a_key(shaped):
    x, y, per_s = chosen(shaped, 2.0)
    shaped.page.key("b")
    shaped.drag((x, y), (2.1 * per_s, 8))
    assert shaped.chosen() == "2 keys"
    assert shaped.text() == SHOW
