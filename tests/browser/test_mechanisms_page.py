"""A head with mechanisms and RC servos on the pages: jogged, posed and played, judged by servos."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from served_bus import served_bus

from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import bus_from_robot
from tests.browser.test_robot_page import click, lines_of, until

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
PLAYING = "document.querySelector('.word')?.textContent === 'playing'"
MOVE = re.compile(rb"#(\d+)D(-?\d+)(T\d+)?\r")


@pytest.fixture
def head(tmp_path):
    """The example on simulated servos behind a port; gives the show, the robot file and the bus."""
    robot = load_robot(EXAMPLES / "robots" / "head.yaml")
    bus = bus_from_robot(robot.servo_robot, "main", seed=1)
    bus.record()
    port = tmp_path / "port"
    text = (EXAMPLES / "robots" / "head.yaml").read_text(encoding="utf-8")
    path = tmp_path / "head_robot.yaml"
    path.write_text(text.replace('"sim://"', f'"{port}"'), encoding="utf-8")
    show = (EXAMPLES / "head.yaml").read_text(encoding="utf-8")
    (tmp_path / "show.yaml").write_text(
        show.replace("robots/head.yaml", path.name), encoding="utf-8"
    )
    with served_bus(bus, port):
        yield tmp_path / "show.yaml", path, bus


def moved(bus, since):
    """Return the ids of the servos that were moved."""
    found = (MOVE.fullmatch(line) for line in lines_of(bus, since))
    return {int(match[1]) for match in found if match}


def hold(page, bus, joint, ids):
    """Hold the button that turns a joint upwards until its servos turn, then let go."""
    begun = len(bus.lines)
    button = f"[aria-label='Jog {joint} up while held']"
    page.wait(f'document.querySelector("{button}")?.disabled === false')
    page.run(f'document.querySelector("{button}").scrollIntoView()')
    x, y = page.place(button)
    page.press_pointer(x, y)
    until(lambda: moved(bus, begun) >= ids, f"{joint} does not turn")
    page.run("new Promise((done) => setTimeout(done, 400))")
    page.pointer("mouseReleased", x, y)
    page.run("new Promise((done) => setTimeout(done, 600))")
    assert moved(bus, begun) == ids, f"{joint} moves no other servo"


def test_joints_of_mechanisms_and_rc_servos_are_jogged_posed_and_played(head, studio, opened):
    show, path, bus = head
    with studio(show) as own, opened(own) as page:
        page.key("3")
        page.wait("document.querySelector('.robot-page')")
        click(page, "Operate")
        click(page, "Connect")
        page.wait("document.querySelector('.robot-head b').textContent === 'connected'")
        hold(page, bus, "tilt", {2, 3})
        hold(page, bus, "jaw", {4})
        hold(page, bus, "eye_yaw", {211})
        begun = len(bus.lines)
        click(page, "Limp roll")
        until(lambda: {b"#2L\r", b"#3L\r"} <= {*lines_of(bus, begun)}, "the neck is not limp")
        click(page, "Hold roll")
        until(lambda: {b"#2H\r", b"#3H\r"} <= {*lines_of(bus, begun)}, "the neck is not held")
        page.run("document.querySelector('.robot-poses input').focus()")
        page.call("Input.insertText", text="looks")
        page.key("Enter")
        until(lambda: "looks" in load_robot(path).poses, "the pose is not written")
        robot = load_robot(path)
        pose, names = robot.poses["looks"], list(robot.servos)
        assert {*pose} == {*robot.joints}
        horn = dict(zip(names, bus.horn_deg([bus.lines[-1][0]])[0], strict=True))
        # The rows of the matrix of the neck, and its other side turns the other way.
        tilt = (horn["neck.left"] - horn["neck.right"]) / 3.6
        assert pose["tilt"] == pytest.approx(tilt, abs=0.6)
        assert tilt > 2.0
        assert pose["eye_yaw"] == pytest.approx(horn["eye_yaw"] / 1.3, abs=1.5)
        assert "unknown joint" not in page.run("document.body.innerText")
        click(page, "Disconnect")
        page.wait("document.querySelector('.robot-head b').textContent === 'not connected'")
        # The show plays from the studio, and the page shows the robot that plays it.
        page.run("document.activeElement.blur()")
        page.key("1")
        begun = len(bus.lines)
        page.key(" ")
        page.wait("document.querySelector('.state-detail')?.textContent === 'for GO'")
        page.key("Enter")
        page.wait(PLAYING)
        until(lambda: {1, 2, 3, 4} <= moved(bus, begun), "the show does not move the head")
        page.press_pointer(*page.place("#stop"))
        until(lambda: lines_of(bus)[-1] == b"#254H\r", "it does not end safely")
    times_ns = np.arange(bus.lines[begun][0], bus.lines[-1][0], 20_000_000)
    assert np.ptp(bus.horn_deg(times_ns.tolist()), axis=0).max() > 5.0
