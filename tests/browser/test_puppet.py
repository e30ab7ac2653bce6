"""Joints follow the pointer on a pad within their limits, and hold when it lets go."""

from __future__ import annotations

import numpy as np
import pytest

from tests.browser.test_pure import modules
from tests.browser.test_robot_page import click, open_robot_page, targets, until

pytestmark = pytest.mark.slow

LED = "document.querySelector('.pad') && !document.querySelector('.pad-off')"
STEP_S = 0.01


def test_places_become_angles_within_the_ranges(wave, opened):
    with opened(wave) as page:
        found = page.run(
            modules("pages/puppet")
            + """.then(([puppet]) => {
              const joints = [{ name: 'a', range_deg: [-90, 90] },
                { name: 'b', range_deg: [0, 20] }];
              const button = (pressed) => ({ buttons: [{ pressed }], axes: [-1, -1, 0, 1] });
              return [puppet.targetsOf(joints, ['b', 'a'], [0.5, 2]),
                puppet.targetsOf(joints, ['b', '–', 'gone'], [0.25, 0.5, 0.5]),
                puppet.heldAxes([null, button(false)]), puppet.heldAxes([button(true)])];
            })"""
        )
    assert found == [{"a": 90, "b": 10}, {"b": 5}, None, [0, 1, 0.5, 0]]


def test_joints_follow_the_pad_within_their_limits_and_hold(studio, opened, two):
    show, bus = two
    with studio(show) as own, opened(own) as page:
        open_robot_page(page)
        page.wait("document.querySelector('.robot-joint, .robot-main')")
        click(page, "Puppeteer …")
        page.wait("document.querySelector('.pad-off')")
        assert "ms later at most" in page.run("document.querySelector('dialog').innerText")
        click(page, "Begin", "document.querySelector('dialog')")
        page.wait(LED)
        page.wait("document.querySelector('.head-state').innerText.includes('playing')")
        box = page.run(
            "(() => { const own = document.querySelector('.pad').getBoundingClientRect();"
            "return [own.left, own.top, own.width, own.height]; })()"
        )
        left, top, width, height = box
        begun = len(bus.lines)
        # Pan to 45 of -90 to 90 degrees, tilt to -22.5 of -45 to 45.
        page.press_pointer(left + 0.75 * width, top + 0.75 * height)
        until(lambda: abs(at(bus)[0] - 45) < 1 and abs(at(bus)[1] + 22.5) < 1, "they do not follow")
        page.pointer("mouseMoved", left + 3 * width, top + 0.75 * height, buttons=1)
        until(lambda: abs(at(bus)[0] - 90) < 1, "it does not go to the end of its range")
        page.pointer("mouseMoved", left, top + 0.75 * height, buttons=1)
        until(lambda: at(bus)[0] < 80, "it does not turn back")
        page.pointer("mouseReleased", left, top + 0.75 * height)
        until(lambda: is_at_rest(bus), "it does not come to rest")
        assert at(bus)[0] > -85, "it braked on the way, since no target came any more"
        assert targets(bus, 1, begun)
        times_ns = np.arange(bus.lines[begun][0], bus.lines[-1][0], round(1e9 * STEP_S))
        speeds = np.abs(np.diff(bus.horn_deg(times_ns), axis=0)) / STEP_S
        assert speeds.max() < 1.05 * 120, "the limit of speed holds"
        click(page, "End it", "document.querySelector('dialog')")
        page.wait("document.querySelector('.robot-head b').textContent === 'not connected'")
        assert page.run("document.body.dataset.latched") == "false", "ending it is no STOP"


def at(bus):
    return bus.horn_deg([bus.lines[-1][0]])[0]


def is_at_rest(bus):
    """Return whether the horns stood still for the last quarter of a second."""
    last_ns = bus.lines[-1][0]
    past = bus.horn_deg([last_ns - 250_000_000, last_ns])
    return bool(np.abs(past[1] - past[0]).max() < 0.05)
