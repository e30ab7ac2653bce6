"""The conventions of the keyboard on the Timeline: each key does what people know it for."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lss_motion.planning.shows import compiled, load
from tests.browser.test_shaping import CHECKED, ROBOT, SHOW, shaping

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


def handle_end(own, side=1):
    """Return where the end of the handle of the chosen key of `pan` at 2 s is, for its slope."""
    x, y, per_s, per_deg = own.place("pan", 2, 40)
    slope = float(own.page.run("document.querySelector('[data-field=\"pan slope\"]').value"))
    rise = -slope / per_s * per_deg
    along = side * 42 / (1 + rise * rise) ** 0.5
    return x, y, x + along, y + along * rise


def test_slopes_are_given_by_v_by_typing_and_by_handles(shaped):
    page = shaped.page
    x, y, *_ = shaped.place("pan", 2, 40)
    shaped.click(x, y)
    page.key("v")
    given = SHOW.replace("label: up}", "label: up, slope_deg_s: {pan: 0}}")
    shaped.becomes(given)
    page.key("v")
    page.key("v")
    shaped.becomes(SHOW)
    page.key("v")
    shaped.becomes(given)
    x, y, end_x, end_y = handle_end(shaped)
    shaped.drag((end_x, end_y), (0, y - end_y - 30))
    page.wait(
        f"{CHECKED} && Number(document.querySelector('[data-field=\"pan slope\"]').value) > 10"
    )
    slope = re.search(r"slope_deg_s: \{pan: (\d+)\}", shaped.text()).group(1)
    path = shaped.path.with_name("sloped.yaml")
    path.write_text(shaped.text(), encoding="utf-8")
    trajectory = compiled(*load(path, None)).trajectory
    deg_s = trajectory.sample(np.array([2.0]), 1)[0, trajectory.joints.index("pan")]
    assert deg_s == pytest.approx(float(slope), abs=0.5), "it is planned so"
    page.key("Control+z")
    shaped.becomes(given)
    page.run("document.querySelector('[data-field=\"pan slope\"]').focus()")
    page.run("document.querySelector('[data-field=\"pan slope\"]').select()")
    page.call("Input.insertText", text="-12.5")
    page.key("Enter")
    shaped.becomes(given.replace("slope_deg_s: {pan: 0}", "slope_deg_s: {pan: -12.5}"))
    x, y, *_ = shaped.place("pan", 0, 0)
    shaped.click(x, y)
    page.key("v")
    page.wait("document.querySelector('.banners').textContent.includes('not its first or last')")


def test_the_four_motions_are_switched_in_the_legend(shaped):
    page = shaped.page
    shades = """import('/static/frames.js').then(async (frames) => {
      await frames.idle();
      const canvas = document.querySelector('.board-plan');
      const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
      const probe = document.createElement('canvas').getContext('2d');
      const rgb = ['--plan', '--predicted'].map((name) => {
        const style = getComputedStyle(document.querySelector('.board'));
        probe.fillStyle = style.getPropertyValue(name).trim();
        probe.fillRect(0, 0, 1, 1);
        return [...probe.getImageData(0, 0, 1, 1).data];
      });
      return rgb.map((own) => {
        let count = 0;
        for (let at = 0; at < data.length; at += 4) {
          count += [0, 1, 2].every((part) => Math.abs(data[at + part] - own[part]) < 6) ? 1 : 0;
        }
        return count;
      });
    })"""
    plan, predicted = page.run(shades)
    button = "[...document.querySelectorAll('.ghost')].find((one) => one.textContent === '%s')"
    page.run(button % "horn" + ".click()")
    assert page.run(shades)[1] > predicted + 100, "the predicted horn is drawn"
    page.run(button % "plan" + ".click()")
    assert page.run(shades)[0] < plan / 2, "the plan is not"
    assert page.run(button % "plan" + ".getAttribute('aria-pressed')") == "false"
