"""STOP and E-STOP from a real page, judged by the bytes that the servos receive."""

from __future__ import annotations

import os
import re
import signal

import pytest

MOVE = re.compile(rb"#\d+D")
SAFE = b"#254H\r"


def lines_of(bus):
    return [line for _, line in list(bus.lines)]


def begin(page):
    """Start the show as a person does, and wait until it moves."""
    page.click("[data-go]")
    page.wait("document.querySelector('.state').dataset.state === 'waits'")
    # A second GO at once is taken for a slip of the finger (`GO_DEBOUNCE_MS` of actions.js).
    page.run("new Promise((done) => setTimeout(done, 700))")
    page.click("[data-go].go-ready")
    page.wait("document.querySelector('[data-now]').textContent === 'part 0'")
    page.wait("/^0:0[1-9]/.test(document.querySelector('[data-clock]').textContent)")


def press(page, button):
    """Press a button and do not let go: a stop must not wait for that."""
    page.press_pointer(*page.place(button))


def check_safe_end(bus, page):
    """Wait until all servos were halted; assert that no move follows."""
    for _ in range(500):
        if SAFE in lines_of(bus):
            break
        page.run("new Promise((done) => setTimeout(done, 10))")
    lines = lines_of(bus)
    assert SAFE in lines, lines[-6:]
    halted = lines.index(SAFE)
    assert any(MOVE.match(line) for line in lines[:halted]), "nothing moved before"
    assert not [line for line in lines[halted:] if MOVE.match(line)]


def test_estop_with_the_planner_frozen_then_armed_again(studio, opened, two):
    show, bus = two
    with studio(show) as own, opened(own) as page:
        begin(page)
        planner = own.parts()["lss_motion.studio.planner"]
        os.kill(planner, signal.SIGSTOP)
        try:
            press(page, "#estop")
            page.wait("document.body.dataset.latched === 'true'")
            check_safe_end(bus, page)
        finally:
            os.kill(planner, signal.SIGCONT)
        page.wait("document.querySelector('.word').textContent === 'emergency stop'")
        page.wait("document.querySelector('.rearm').disabled === false")
        # It stays stopped until a person has said yes to a question.
        page.pointer("mouseReleased", *page.place("#estop"))
        page.click(".word")
        page.key(" ")
        page.wait("document.querySelector('dialog h2')?.textContent === 'Arm again?'")
        page.click("dialog .primary")
        page.wait("document.body.dataset.latched === 'false'")
        page.wait("document.querySelector('.rearm') === null")


@pytest.mark.slow
def test_stop_from_a_second_client_that_does_not_operate(studio, opened, two):
    show, bus = two
    with studio(show) as own, opened(own) as page:
        begin(page)
        with opened(own, size=(820, 1180)) as other:
            # It does not operate: it has to take over first, and stops without that.
            other.wait("document.querySelector('.operator').textContent.includes('operates')")
            other.touch(*other.place("#stop"))  # A finger that stays there.
            page.wait("document.body.dataset.latched === 'true'")
            check_safe_end(bus, page)
            page.wait("document.querySelector('.word').textContent === 'stopped'")


@pytest.mark.slow
def test_estop_with_the_server_frozen_goes_the_other_way(studio, opened, two):
    show, bus = two
    with studio(show) as own, opened(own) as page:
        begin(page)
        os.kill(own.process.pid, signal.SIGSTOP)
        try:
            press(page, "#estop")
            check_safe_end(bus, page)
            page.wait("document.querySelector('.state').dataset.state === 'no_link'")
        finally:
            os.kill(own.process.pid, signal.SIGCONT)
        page.wait("document.body.dataset.latched === 'true'")
        page.wait("document.querySelector('.state').dataset.state !== 'no_link'")


@pytest.mark.slow
def test_a_server_that_is_killed_ends_the_show_by_its_rule(studio, opened, two):
    show, bus = two
    with studio(show, "--on-operator-lost", "stop") as own, opened(own) as page:
        begin(page)
        os.kill(own.process.pid, signal.SIGKILL)
        page.wait("document.querySelector('.state').dataset.state === 'no_link'")
        check_safe_end(bus, page)
