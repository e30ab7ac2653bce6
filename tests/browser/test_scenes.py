"""Every state and dialog on every page: its word and colour, STOP in reach, no text cut or covered.

The states come from the real thing (`tools/scenes.py`); what is asked of them is measured on the
page that the browser drew.
"""

from __future__ import annotations

import json
import re
from contextlib import closing

import pytest
import scenes

from tests.browser.test_stop_in_reach import NOTED, check_in_reach

pytestmark = pytest.mark.slow

TABLE = "import('/static/states.js').then(({ STATES }) => STATES)"
TONES = {"good": "--good", "warn": "--warn", "bad": "--bad", "busy": "--accent", "quiet": "--muted"}
SHOWN = """
(() => {
  const own = document.querySelector('.state');
  const probe = document.createElement('i');
  probe.style.color = 'var(TONE)';
  own.append(probe);
  const wanted = getComputedStyle(probe).color;
  probe.remove();
  const word = own.querySelector('.word');
  return { word: word.textContent, colour: getComputedStyle(word).color, wanted,
    sign: own.querySelector('.state-sign').textContent,
    count: document.querySelectorAll('.state').length };
})()
"""
WATCHED = """
(() => {
  if (window.writtenTexts !== undefined) return;
  window.writtenTexts = new Map();
  const { fillRect, fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillRect = function (left, top, width, height) {
    const ratio = this.getTransform().a;
    const isAll = left === 0 && top === 0 && height * ratio >= this.canvas.height - 2;
    if (isAll && width * ratio >= this.canvas.width - 2) window.writtenTexts.set(this.canvas, []);
    fillRect.call(this, left, top, width, height);
  };
  CanvasRenderingContext2D.prototype.fillText = function (text, left, middle) {
    const width = this.measureText(text).width;
    window.writtenTexts.get(this.canvas)?.push({ text, left, right: left + width, middle });
    fillText.call(this, text, left, middle);
  };
})()
"""
"""Notes what is written on each canvas since it was painted over."""

MEASURED = """
(() => {
  const problems = [];
  const UNSEEN = '.hidden, .mirror, script, style, [hidden], details:not([open]) > :not(summary)';
  const dialog = document.querySelector('dialog, .menu');
  const said = (node) => `“${node.textContent.trim().slice(0, 40)}”`;
  /** What is seen of a box: its part in every ancestor that clips, and in the window. */
  const seen = (box, element) => {
    let [left, top, right, bottom] = [box.left, box.top, box.right, box.bottom];
    let isCut = left < -1 || right > innerWidth + 1;
    for (let own = element; own !== null && own !== document.body; own = own.parentElement) {
      const style = getComputedStyle(own);
      if (style.position === 'fixed' && style.overflow === 'visible') break;
      if (style.overflowX === 'visible' && style.overflowY === 'visible') continue;
      const edge = own.getBoundingClientRect();
      // What can be scrolled to is not cut.
      const across = style.overflowX === 'auto' || style.overflowX === 'scroll';
      const down = style.overflowY === 'auto' || style.overflowY === 'scroll';
      if (!across && (left < edge.left - 1.5 || right > edge.right + 1.5)) isCut = true;
      if (!down && (top < edge.top - 2.5 || bottom > edge.bottom + 2.5)) isCut = true;
      left = Math.max(left, edge.left); right = Math.min(right, edge.right);
      top = Math.max(top, edge.top); bottom = Math.min(bottom, edge.bottom);
    }
    return { left, top, right, bottom, isCut, isSeen: right - left > 2 && bottom - top > 2 };
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const texts = [];
  for (let node = walker.nextNode(); node !== null; node = walker.nextNode()) {
    const parent = node.parentElement;
    const isShown = parent.closest(UNSEEN) === null;
    if (node.textContent.trim() === '' || !isShown) continue;
    if (dialog !== null && !dialog.contains(parent) && parent.closest('#stops') === null) continue;
    if (getComputedStyle(parent).visibility !== 'visible') continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const box of range.getClientRects()) {
      if (box.width < 2 || box.height < 2) continue;
      const own = seen(box, parent);
      // A name that a person gave may be long: it is whole in its tooltip.
      if (own.isCut && parent.closest('.name[title]') === null) problems.push(`cut: ${said(node)}`);
      if (own.isSeen) texts.push({ ...own, node, parent });
    }
  }
  for (const [index, one] of texts.entries()) {
    for (const other of texts.slice(index + 1)) {
      if (one.node === other.node) continue;
      const across = Math.min(one.right, other.right) - Math.max(one.left, other.left);
      const down = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
      if (across > 2 && down > 4) {
        problems.push(`overlap: ${said(one.node)} and ${said(other.node)}`);
      }
    }
    const middle = [(one.left + one.right) / 2, (one.top + one.bottom) / 2];
    const top = document.elementFromPoint(...middle);
    const isOwn = top === null || top.contains(one.parent) || one.parent.contains(top);
    const cover = isOwn ? '' : `${top.tagName} ${top.className || top.id}`;
    if (!isOwn) problems.push(`covered: ${said(one.node)} by ${cover}`);
  }
  for (const own of document.querySelectorAll('textarea, input')) {
    if (own.scrollWidth > own.clientWidth + 1) problems.push(`cut: ${own.value.slice(0, 40)}`);
  }
  for (const [canvas, all] of dialog === null ? window.writtenTexts : []) {
    if (!canvas.isConnected) continue;
    for (const [index, one] of all.entries()) {
      const isIn = one.left >= 0 && one.right <= canvas.clientWidth + 1;
      if (!isIn) problems.push(`cut on a canvas: ${one.text}`);
      for (const other of all.slice(index + 1)) {
        const across = Math.min(one.right, other.right) - Math.max(one.left, other.left);
        const isApart = across < 1 || Math.abs(one.middle - other.middle) > 9;
        if (!isApart) problems.push(`overlap on a canvas: ${one.text} and ${other.text}`);
      }
    }
  }
  const buttons = [...document.querySelectorAll('button, input')]
    .filter((one) => one.closest(UNSEEN) === null)
    .filter((one) => dialog === null || dialog.contains(one) || one.closest('#stops') !== null)
    .map((element) => ({ element, ...seen(element.getBoundingClientRect(), element) }))
    .filter((one) => one.isSeen);
  for (const [index, one] of buttons.entries()) for (const other of buttons.slice(index + 1)) {
    const across = Math.min(one.right, other.right) - Math.max(one.left, other.left);
    const down = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
    if (across > 2 && down > 2) {
      problems.push(`buttons overlap: ${said(one.element)} and ${said(other.element)}`);
    }
  }
  for (const own of document.querySelectorAll('.page, dialog, .menu, .scroll')) {
    const isWide = own.scrollWidth > own.clientWidth + 1;
    if (isWide) problems.push(`${own.tagName} ${own.className} is wider than there is room`);
  }
  return [...new Set(problems)];
})()
"""


SAID = {
    "robot_file": "This is a robot file, which has no show.",
    "pair_refused": "lss-motion studio owl.yaml --listen ",
    "stage_file": "It is run by: lss-motion serve hall.yaml",
    "fault": "arm is silent: servo 3 has not answered",
    "quiet_hours": "quiet hours (until ",
    "stage_waits": "for the cable of the robot",
    "no_link": "STOP is still sent",
    "planner_frozen": "the planner has not answered for ",
    "stage_given_up": "arm is silent: servo 3 has not answered",
    "stopping": "brakes",
    "conflict": "it is not overwritten.",
}
"""What a page has to say in a scene, on the Show page."""
STANDS = {"rests", "at_rest", "ended", "fault", "connected", "stopped", "emergency"}
"""States in which nothing plays that could be paused or sent to another instant."""


FIGURE_AS = "document.querySelector('.figure-legend .is-solid')?.textContent"


def check_state(page, scene, table):
    """Assert that the page shows the word, sign and colour that the table has for the state."""
    wanted = table[scene.state]
    shown = page.run(SHOWN.replace("TONE", TONES[wanted["tone"]]))
    assert (shown["word"], shown["sign"]) == (wanted["word"], wanted["sign"]), scene.name
    assert shown["colour"] == shown["wanted"], (scene.name, "its colour")
    assert shown["count"] == 1, "it is said once"
    if scene.state in STANDS:
        way = page.run("document.querySelector('.way-name')?.textContent ?? 'Cursor'")
        assert way == "Cursor", (scene.name, "nothing plays")
    coming = page.run("document.querySelector('[data-next]')?.textContent ?? ''")
    if scene.state == "playing" and coming:
        assert re.search(r" in \d", coming), (scene.name, coming)
        present = "document.querySelector('.cue-list .present .cue-text')?.textContent"
        now = page.run("document.querySelector('[data-now]').textContent")
        assert page.run(present) in (None, now), "the cue that is marked is the present one"
    else:
        assert not re.search(r" in \d", coming), (scene.name, coming, "nothing counts down")


def check_reach(page, what):
    """Assert that both stops can be pressed; none is sent."""
    latched = page.run("document.body.dataset.latched === 'true'")
    page.run(NOTED)
    try:
        check_in_reach(page, what)
    finally:
        page.run("window.sendAgain()")
    page.run(f"import('/static/stop.js').then((stops) => stops.confirmStop({json.dumps(latched)}))")


@pytest.mark.parametrize("group", scenes.GROUPS)
def test_states_are_said_alike_and_nothing_is_cut_or_covered(browser, tmp_path, monkeypatch, group):
    monkeypatch.setenv("LSS_MOTION_STATE_DIR", str(tmp_path / "state"))
    problems, states = [], set()
    with closing(scenes.GROUPS[group](browser, tmp_path)) as found:
        for scene in found:
            page, states, known = scene.page, states | {scene.state}, set()
            page.run(WATCHED)
            table = page.run(TABLE)
            back = scenes.shown_page(page)
            for theme, size in zip(("dark", "light", "dark"), scenes.SIZES, strict=True):
                for own in scenes.pages_of(scene.name):
                    scenes.look(page, own, theme, scenes.SIZES[size])
                    check_state(page, scene, table)
                    if own != "timeline" and (drawn_as := page.run(FIGURE_AS)) is not None:
                        known.add(drawn_as == "read")
                    what = f"{scene.name} on {own} at {size}"
                    problems += [f"{what}: {text}" for text in page.run(MEASURED)]
                    if size != "1920":
                        check_reach(page, what)
            assert len(known) < 2, (scene.name, "where the robot stands is known on every page")
            scenes.look(page, scenes.pages_of(scene.name)[0], "dark", scenes.SIZES["1366"])
            assert SAID.get(scene.name, "") in page.run("document.body.innerText"), scene.name
            scenes.look(page, back, "dark", scenes.SIZES["1366"])
            assert page.errors == []
            if scene.name == "stage_plays":
                when = page.run(
                    "document.querySelector('[data-stage-cue=strikes] .cue-when').textContent"
                )
                assert re.fullmatch(r"next \d\d:00", when), when
    assert not problems, "\n".join(problems)
    assert states, "nothing was seen"
