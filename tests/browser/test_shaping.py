"""A show is shaped by hand on the Timeline: pointer, touch and keyboard, judged by the file."""

from __future__ import annotations

import json
import os
import re
import signal
from contextlib import contextmanager

import pytest

from lss_motion.planning.shows import compiled, load
from tests.browser.test_pure import modules

pytestmark = pytest.mark.slow

ROBOT = """\
robot: two
buses:
  main: {port: "sim://", baud_bps: 115200, firmware: 370}
joints:
  pan: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 120, accel_max_deg_s2: 500}
  tilt: {id: 2, model: LSS-ST1, range_deg: [-45, 45], speed_max_deg_s: 120, accel_max_deg_s2: 500}
"""
SHOW = """\
sequence: grüße  # by hand
robot: two.yaml
keyframes:
  - {at_s: 0, deg: {pan: 0, tilt: 0}}
  # she looks up
  - {at_s: 2, deg: {pan: 40, tilt: -20}, label: up}
  - {at_s: 4.0, deg: {pan: 0}}
  - {at_s: 6, deg: {pan: 30, tilt: 10}}
  - {at_s: 8, deg: {pan: 0, tilt: 0}}
"""
CHECKED = "document.querySelector('.edits .chip')?.textContent.includes('checked')"
PLACES = """
.then(async ([messages, layout, draw, curves, frames]) => {
  await frames.idle();
  const name = performance.getEntriesByType('resource').filter((one) => one.name.includes('/view/'))
    .at(-1).name;
  const view = messages.viewFrom(await (await fetch(name, { cache: 'reload' })).json());
  const box = document.querySelector('.board').getBoundingClientRect();
  const used_deg = Object.fromEntries(view.joints.map((one) =>
    [one.name, curves.usedOf(view.curves[one.name].plan, view.view_s)]));
  const rows = layout.rowsInSight(layout.layoutOf(view, box.height), 0, box.height);
  const row = rows.find((one) => one.name === OF_ROW && one.kind !== 'line');
  const across = (box.width - layout.NAMES_PX - 48) / view.view_s;
  const isFlat = row.kind !== 'joint';
  const y = isFlat ? row.y_px + row.height_px / 2
    : draw.scaleOf({ view, order: 0, used_deg }, row).y(OF_DEG);
  return [box.left + layout.NAMES_PX + 24 + across * AT_S, box.top + y, across,
    isFlat ? 0 : draw.scaleOf({ view, order: 0, used_deg }, row).y(0)
      - draw.scaleOf({ view, order: 0, used_deg }, row).y(1)];
})
"""


class Shaped:
    """The Timeline of a show in a folder: what a person does there, and what the text is then."""

    def __init__(self, page, studio, path):
        self.page, self.studio, self.path = page, studio, path

    def place(self, name, at_s, deg=0.0):
        """Return where an instant (and an angle) of a row is, and pixels a second and a degree."""
        script = PLACES.replace("OF_ROW", json.dumps(name)).replace("OF_DEG", str(deg))
        names = ("messages", "timeline/layout", "timeline/draw", "curves", "frames")
        return self.page.run(modules(*names) + script.replace("AT_S", str(at_s)))

    def drag(self, start, by, modifiers=0):
        (x, y), (dx, dy) = start, by
        self.page.press_pointer(x, y)
        for share in (0.3, 0.7, 1.0):
            at = (x + share * dx, y + share * dy)
            self.page.pointer("mouseMoved", *at, buttons=1, modifiers=modifiers)
        self.page.pointer("mouseReleased", x + dx, y + dy, modifiers=modifiers)

    def click(self, x, y, count=1, **more):
        self.page.pointer("mouseMoved", x, y)
        for number in range(1, count + 1):
            for kind in ("mousePressed", "mouseReleased"):
                self.page.pointer(kind, x, y, clickCount=number, **more)

    def text(self):
        """Return the text that the server has, when its plan is shown."""
        self.page.wait(CHECKED)
        return self.page.run(f"fetch('/text/{self.path.name}').then((answer) => answer.text())")

    def becomes(self, text):
        """Wait until the text is this one, and what is seen is its plan."""
        asked = f"fetch('/text/{self.path.name}').then((answer) => answer.text())"
        self.page.wait(f"{asked}.then((text) => text === {json.dumps(text)})", 20.0)
        self.page.wait(CHECKED)

    def chosen(self):
        self.page.idle()
        return self.page.run("document.querySelector('.about h2').textContent.trim()")


@contextmanager
def shaping(studio, opened, folder, show=SHOW, robot=ROBOT):
    (folder / "two.yaml").write_text(robot, encoding="utf-8")
    path = folder / "show.yaml"
    path.write_text(show, encoding="utf-8")
    with studio(path) as own, opened(own) as page:
        page.run("performance.setResourceTimingBufferSize(100000)")  # `PLACES` needs the last one.
        page.key("2")
        page.wait("document.querySelector('.board-plan')")
        page.wait(CHECKED)
        yield Shaped(page, own, path)
        assert page.run("document.body.dataset.latched") == "false", "no key was a STOP"


def test_keys_are_dragged_in_time_and_angle_and_undo_restores_the_bytes(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        x, y, per_s, _ = own.place("grüße", 2)
        own.drag((x, y), (0.5 * per_s, 0))
        moved = SHOW.replace("{at_s: 2,", "{at_s: 2.5,")
        own.becomes(moved)
        assert own.chosen() == "Key up", "it stays chosen"
        x, y, _, per_deg = own.place("pan", 4, 0)
        own.drag((x, y), (2, -10 * per_deg))
        turned = moved.replace("deg: {pan: 0}}", "deg: {pan: 10}}")
        assert own.text().startswith(turned[: turned.index("at_s: 4.0")])
        assert "pan: 10" in own.text().splitlines()[6] or "pan: 9.5" in own.text().splitlines()[6]
        own.page.key("Control+z")
        own.becomes(moved)
        own.page.key("Control+z")
        own.becomes(SHOW)
        assert own.path.read_text("utf-8") == SHOW, "nothing is saved yet"
        own.page.key("Control+y")
        own.becomes(moved)
        own.page.wait("!document.querySelector('.edits button:nth-child(3)').disabled")
        own.page.key("Control+s")
        own.page.wait("document.querySelector('.edits button:nth-child(3)').disabled")
        assert own.path.read_text("utf-8") == moved, "only what was touched differs"


def test_keys_are_chosen_by_click_shift_and_box_then_copied_and_deleted(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        x, y, per_s, _ = own.place("grüße", 2)
        own.click(x, y)
        assert own.chosen() == "Key up"
        own.click(x + 2 * per_s, y, modifiers=8)
        assert own.chosen() == "2 keys"
        own.click(x + 2 * per_s, y, modifiers=8)
        assert own.chosen() == "Key up", "once more, and it is not chosen"
        own.page.key("Escape")
        assert own.chosen() == "grüße"
        own.drag((x - 0.5 * per_s, y - 8), (3 * per_s, 16))
        assert own.chosen() == "2 keys"
        own.page.key("Control+c")
        own.page.key("Control+End")
        own.page.key("Control+v")
        wanted = SHOW.replace("  - {at_s: 8, deg: {pan: 0, tilt: 0}}\n", "")
        assert own.page.wait(f"{CHECKED} && document.querySelector('.about h2')") is True
        lines = own.text().splitlines()
        assert any("at_s: 10" in line and "pan: 0" in line for line in lines), lines
        own.page.key("Control+z")
        own.becomes(SHOW)
        x, y, *_ = own.place("grüße", 8)
        own.click(x, y)
        own.page.key("Delete")
        own.becomes(wanted)
        own.page.key("Control+z")
        own.becomes(SHOW)


def test_double_click_menu_and_long_touch(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        page = own.page
        x, y, *_ = own.place("pan", 3, 25)
        own.click(x, y, count=2)
        page.wait("document.querySelector('.about h2').textContent.startsWith('Key')")
        assert re.search(r"{at_s: [23]\.?\d*, deg: {pan: 2[456]\.?5?}}", own.text()), own.text()
        page.key("Control+z")
        own.becomes(SHOW)
        x, y, *_ = own.place("grüße", 4)
        own.click(x, y, button="right")
        page.wait("document.querySelector('.menu [role=menuitem]')")
        assert page.run("document.activeElement.getAttribute('role')") == "menuitem"
        page.key("Escape")
        page.wait("document.querySelector('.menu') === null")
        own.click(x, y, button="right")
        page.run(
            "[...document.querySelectorAll('.menu button')]"
            ".find((one) => one.textContent.startsWith('Delete')).click()"
        )
        own.becomes(SHOW.replace("  - {at_s: 4.0, deg: {pan: 0}}\n", ""))
        page.key("Control+z")
        own.becomes(SHOW)
        page.touch(x + 15, y)  # Not on the key: within reach of a finger.
        page.wait("document.querySelector('.menu [role=menuitem]')")
        page.touch()
        assert own.chosen() == "Key"
        page.key("Escape")


def test_values_are_typed_and_the_keyboard_does_what_the_pointer_does(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        page = own.page
        page.key("]")  # The lane has the focus: its second key.
        page.key("Enter")
        page.wait("document.activeElement.dataset.field === 'at'")
        page.call("Input.insertText", text="2.25")
        page.key("Enter")
        moved = SHOW.replace("{at_s: 2,", "{at_s: 2.25,")
        own.becomes(moved)
        page.key("ArrowRight")
        page.key("ArrowRight")
        own.becomes(SHOW.replace("{at_s: 2,", "{at_s: 2.27,"))
        page.key("Control+z")
        own.becomes(moved)
        page.key("n")
        own.becomes(moved.replace("label: up}", "label: up, anchor: true}"))
        page.key("Control+z")
        own.becomes(moved)
        page.key("t")
        own.becomes(moved.replace("label: up}", "label: up, ease: spline}"))
        page.key("Control+z")
        own.becomes(moved)
        page.key("h")
        page.wait("document.activeElement.dataset.field === 'hold'")
        page.call("Input.insertText", text="0.5")
        page.key("Enter")
        own.becomes(moved.replace("label: up}", "label: up, hold_s: 0.5}"))
        page.key("Control+z")
        own.becomes(moved)
        page.key("l")
        page.wait("document.activeElement.dataset.field === 'label'")
        page.call("Input.insertText", text="away")
        page.key("Escape")
        assert own.text() == moved, "Escape gives a field back"
        page.key("Escape")  # The key is not chosen any more.
        page.key("ArrowDown")  # The first joint.
        page.key("]")
        page.key("ArrowUp")
        page.wait(f"{CHECKED} && document.querySelector('[data-field=pan]').value === '40.5'")


DRAFT = "(document.querySelector('.board').dataset.draft ?? '')"
SLOWED = "document.querySelector('.edits .chip').textContent.includes('slowed')"


def test_a_limit_answers_while_a_key_is_dragged_and_then_for_sure(studio, opened, tmp_path):
    late = SHOW.replace("at_s: 4.0", "at_s: 2.2")
    with shaping(studio, opened, tmp_path) as own:
        page = own.page
        path = tmp_path / "late.yaml"
        path.write_text(late, encoding="utf-8")
        (span,) = compiled(*load(path, None)).trajectory.stretched
        x, y, per_s, _ = own.place("grüße", 4)
        page.press_pointer(x, y)
        os.kill(own.studio.process.pid, signal.SIGSTOP)
        try:
            page.pointer("mouseMoved", x - 0.9 * per_s, y, buttons=1)
            page.pointer("mouseMoved", x - 1.8 * per_s, y, buttons=1)
            page.wait(f"{DRAFT}.includes('estimate: pan at least 0.')", 10.0)
        finally:
            os.kill(own.studio.process.pid, signal.SIGCONT)
        page.wait(f"{DRAFT}.includes({json.dumps(span.text)})", 20.0)
        page.wait("document.querySelector('.edits .chip').textContent.includes('draft')")
        page.key("Escape")
        page.wait(f"{CHECKED} && {DRAFT} === ''")
        page.pointer("mouseReleased", x - 1.8 * per_s, y)
        assert own.text() == SHOW, "Escape gives the drag up, and stops nothing"
        own.drag((x, y), (-1.8 * per_s, 0))
        page.wait(SLOWED)
        reason = page.wait("document.querySelector('.about .reasons li')?.textContent")
        assert reason == span.text, "as `check` says it"
        assert own.text() == late
        # What the planner has found to bring it in time is one click, and does.
        chips = "[...document.querySelectorAll('.repairs button')]"
        page.wait(f"{chips}.length > 0", 20.0)
        found = page.run(f"{chips}.map((one) => one.textContent)")
        assert found[0] == "+0.38 s here", found
        page.run(f"{chips}[0].click()")
        own.becomes(SHOW.replace("at_s: 4.0", "at_s: 2.58"))
        assert not page.run(SLOWED)
        assert page.wait("document.querySelector('[data-spare]')?.textContent").startswith(
            "to spare"
        )
        page.key("Control+z")
        own.becomes(late)
        for chip in found[1:]:
            page.wait(f"{chips}.length === {len(found)}", 20.0)
            page.run(f"{chips}.find((one) => one.textContent === {json.dumps(chip)}).click()")
            page.wait(f"{CHECKED} && !({SLOWED})", 20.0)
            page.key("Control+z")
            own.becomes(late)


def test_the_text_is_changed_in_the_page_with_the_same_checks(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        page = own.page
        page.key("]")
        page.click(".about .file-line")
        page.wait("document.querySelector('.file-text [aria-current]')")
        page.run(
            "[...document.querySelectorAll('dialog button')]"
            ".find((one) => one.textContent === 'Change the text').click()"
        )
        page.wait("document.querySelector('textarea.file-text')")

        def typed(text):
            page.run(
                "(() => { const own = document.querySelector('textarea.file-text');"
                f" own.value = {json.dumps(text)};"
                " own.dispatchEvent(new InputEvent('input', { bubbles: true })); })()"
            )
            page.click("dialog .primary")

        typed(SHOW.replace("pan: 40", "pan: 41"))
        own.becomes(SHOW.replace("pan: 40", "pan: 41"))
        page.key("Escape")
        page.key("Control+z")
        own.becomes(SHOW)


def test_posing_at_the_cursor_makes_a_key(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        page = own.page
        x, y, *_ = own.place("grüße", 3)
        own.click(x, y)  # Beside keys: the cursor goes there.
        slider = "document.querySelector('[data-pose=tilt]')"
        page.run(
            f"(() => {{ const own = {slider}; own.value = 12.5;"
            " own.dispatchEvent(new Event('input', { bubbles: true })); })()"
        )
        page.wait(
            "document.querySelector('.pose label:nth-child(2) output').textContent === '12.5°'"
        )
        page.run(f"{slider}.dispatchEvent(new Event('change', {{ bubbles: true }}))")
        page.wait("!document.querySelector('.edits button').disabled")
        added = re.search(r"  - {at_s: (\S+), deg: {tilt: 12.5}}\n", own.text())
        assert added is not None, own.text()
        assert abs(float(added[1]) - 3) < 0.03
        assert own.text().replace(added[0], "") == SHOW


def test_a_finger_drags_a_key_and_pans_beside_it(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        page = own.page

        def finger(start, by_px):
            x, y = start
            page.touch(x, y)
            for share in (0.4, 0.7, 1.0):
                point = [{"x": x + share * by_px, "y": y}]
                page.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=point)
            page.touch()

        x, y, per_s, _ = own.place("grüße", 2)
        finger((x + 14, y), 0.5 * per_s)  # Beside the key, within reach of a finger.
        own.becomes(SHOW.replace("{at_s: 2,", "{at_s: 2.5,"))
        page.key("Control+z")
        own.becomes(SHOW)
        finger((x + per_s, y), 60)
        assert own.text() == SHOW


def test_two_clients_shape_one_text(studio, opened, tmp_path):
    with shaping(studio, opened, tmp_path) as own:
        page = own.page
        with opened(own.studio) as other:
            other.key("2")
            other.wait("document.querySelector('.board-plan')")
            x, y, *_ = own.place("grüße", 4)
            own.click(x, y)
            page.key("Delete")
            own.becomes(SHOW.replace("  - {at_s: 4.0, deg: {pan: 0}}\n", ""))
            keys = "document.querySelector('#mirror [role=rowheader]').textContent"
            other.wait(f"{keys} === 'track grüße, 4 keys'")
            other.key("Control+z")
            own.becomes(SHOW)
