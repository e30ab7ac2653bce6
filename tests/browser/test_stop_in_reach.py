"""STOP and E-STOP in reach, whatever is open: pressed by pointer and touch over every dialog."""

from __future__ import annotations

import json
from contextlib import contextmanager

import pytest

from tests.browser.test_robot_page import click, live, until  # noqa: F401
from tests.browser.test_stop import SAFE, lines_of

pytestmark = pytest.mark.slow

NOTED = """
(() => {
  window.sent = [];
  const fetched = window.fetch, told = WebSocket.prototype.send;
  window.fetch = (address, options) => {
    const kind = /\\/(e?stop)$/.exec(String(address))?.[1];
    if (kind === undefined) return fetched(address, options);
    window.sent.push(kind);
    return Promise.resolve(new Response());
  };
  WebSocket.prototype.send = function (data) {
    if (typeof data !== 'string' || !/"op": ?"e?stop"/.test(data)) told.call(this, data);
  };
  window.sendAgain = () => { window.fetch = fetched; WebSocket.prototype.send = told; };
})();
"""
"""Stops are noted and not sent, so that one page can be pressed often."""
STOPS = "import('/static/stop.js').then((stops) => "
SIZES = {"wide": (1366, 768), "tablet": (820, 1180)}
TITLE = "document.querySelector('dialog h2')?.textContent"


def press(page, way, x, y):
    if way == "pointer":
        page.press_pointer(x, y)
        page.pointer("mouseReleased", x, y)
    else:
        page.touch(x, y)
        page.touch()


def check_in_reach(page, state):
    """Assert that each button is on top of everything, and that each press of it is a stop."""
    page.idle()
    for kind in ("stop", "estop"):
        box = page.run(
            f"(({{x, y, width, height}}) => [x, y, width, height])"
            f"(document.getElementById('{kind}').getBoundingClientRect())"
        )
        x, y, width, height = box
        for right, down in ((0.5, 0.5), (0.05, 0.1), (0.95, 0.1), (0.05, 0.9), (0.95, 0.9)):
            at = (x + right * width, y + down * height)
            found = page.run(f"document.elementFromPoint({at[0]}, {at[1]})?.closest('button')?.id")
            assert found == kind, (state, kind, at)
        for way in ("pointer", "touch"):
            page.run(STOPS + "stops.confirmStop(true))")  # Else the press before is repeated.
            before = page.run("window.sent.length")
            press(page, way, x + width / 2, y + height / 2)
            sent = page.run("window.sent")[before:]
            assert sent, (state, kind, way)
            assert set(sent) == {kind}, (state, kind, way)
    page.run(STOPS + "stops.confirmStop(true))")


@contextmanager
def noted(opened, studio, **options):
    with opened(studio, **options) as page:
        page.run(NOTED)
        yield page


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_over_help_pairing_and_questions(studio, opened, two, size):
    show, _ = two
    with studio(show, "--listen", "127.0.0.2") as own, noted(opened, own, size=size) as page:
        check_in_reach(page, "nothing open")
        for number in ("2", "3", "1"):
            page.key(f"Alt+{number}")
            check_in_reach(page, f"page {number}")
        page.key("?")
        page.wait(f"{TITLE} === 'Keys'")
        check_in_reach(page, "help")
        page.key("Escape")
        click(page, "Pair a tablet")
        page.wait(f"{TITLE} === 'Pair another device'")
        check_in_reach(page, "pairing")
        click(page, "Close", "document.querySelector('dialog')")
        page.run(
            "import('/static/stop.js').then((stops) => stops.showTrouble('trouble '.repeat(999)))"
        )
        check_in_reach(page, "a message as long as the page")
        page.run("import('/static/stop.js').then((stops) => stops.showTrouble(''))")
        with opened(own) as other:
            page.wait("document.querySelector('.operator').textContent.includes('you operate')")
            other.key("Enter")
            other.wait(f"{TITLE}?.startsWith('Take over from')")
            other.run(NOTED)
            check_in_reach(other, "take over")
            other.key("Escape")
            other.wait(f"{TITLE} === undefined")


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_over_the_questions_of_the_robot_page_and_when_stopped(live, size):  # noqa: F811
    page, bus, path = live
    text = path.read_text()
    path.write_text(f"{text}poses: {{up: {{pan: 10}}}}\n", encoding="utf-8")
    page.resize(*size)
    page.run(NOTED)
    for button, title in (("Limp all …", "Limp all?"), ("Save over up …", "Save over up?")):
        click(page, button)
        page.wait(f"{TITLE} === {json.dumps(title)}")
        check_in_reach(page, title)
        page.key("Escape")
        page.wait(f"{TITLE} === undefined")
    # And one that is sent: the robot is halted, and the question stays open.
    page.run("window.sendAgain()")
    click(page, "Limp all …")
    page.wait(f"{TITLE} === 'Limp all?'")
    begun = len(bus.lines)
    page.touch(*page.place("#estop"))
    until(lambda: SAFE in lines_of(bus)[begun:], "the robot is not halted")
    page.touch()
    page.wait("document.body.dataset.latched === 'true'")
    assert b"#254L\r" not in lines_of(bus)[begun:]
    click(page, "No", "document.querySelector('dialog')")
    click(page, "Arm again…")
    page.wait(f"{TITLE} === 'Arm again?'")
    page.run(NOTED)
    check_in_reach(page, "arm again")


def test_zoomed_in_by_two_fingers(wave, opened):
    with noted(opened, wave, size=SIZES["tablet"]) as page:
        page.call("Emulation.setPageScaleFactor", pageScaleFactor=3)
        page.wait("visualViewport.scale > 2.9")
        page.idle()
        seen = page.run(
            "((own, v) => [own.left - v.offsetLeft, own.top - v.offsetTop, v.offsetLeft + v.width"
            " - own.right, v.offsetTop + v.height - own.bottom])"
            "(document.getElementById('stops').getBoundingClientRect(), visualViewport)"
        )
        assert min(seen) > -1.0, "within what the screen shows"
        assert page.run("window.sent.length") == 0


def test_before_a_device_is_paired(wave, opened):
    with noted(opened, wave, token=False) as page:
        page.wait("document.querySelector('.entry')")
        check_in_reach(page, "not paired")


def test_escape_closes_what_is_open_and_stops_only_where_nothing_is(studio, opened, two):
    show, _ = two
    with studio(show) as own, noted(opened, own) as page:
        page.key("?")
        page.wait(f"{TITLE} === 'Keys'")
        page.key("Escape")
        page.wait(f"{TITLE} === undefined")
        page.key("2")
        page.wait("document.querySelector('.board-plan')")
        page.key("]")
        page.wait("document.querySelector('.about h2')?.textContent.startsWith('Key')")
        page.key("Escape")
        page.wait("!document.querySelector('.about h2')?.textContent.startsWith('Key')")
        click(page, "Pair a tablet")  # Refused: the studio does not listen to the network.
        page.wait("document.querySelector('.banner-warn')")
        page.key("Escape")
        page.wait("document.querySelector('.banner-warn') === null")
        assert page.run("window.sent") == []
        page.key("?")
        page.wait(f"{TITLE} === 'Keys'")
        page.key("Shift+Escape")
        assert set(page.run("window.sent")) == {"estop"}, "always, whatever is open"
        page.run(STOPS + "stops.confirmStop(true))")
        page.key("Escape")
        page.run("window.sent.length = 0")
        page.key("Escape")
        assert set(page.run("window.sent")) == {"stop"}
