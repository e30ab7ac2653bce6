"""A headless browser, one for each worker, and the studio as a process of its own."""

from __future__ import annotations

import json
import os
from contextlib import contextmanager
from pathlib import Path

import cdp
import pytest
from running_studio import running
from served_bus import recording_bus, served_bus

from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.physics import ServoSpec

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
NO_WEBGL = """
const own = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith('webgl') ? null : own.call(this, kind, ...rest);
};
"""


@pytest.fixture(scope="session")
def browser():
    if cdp.found_browser() is None:
        text = "no browser for the tests of the pages; run: tools/browser"
        if os.environ.get("CI") == "true":
            pytest.fail(text)
        pytest.skip(text)
    with cdp.Browser() as found:
        yield found


@pytest.fixture
def studio():
    """Return a context: the studio runs for a file."""
    return running


@pytest.fixture
def opened(browser):
    """Return a context: the pages of a studio are open."""

    def open_(studio, **options):
        return opened_by(browser, studio, **options)

    return open_


@contextmanager
def opened_by(browser, studio, *, size=(1366, 768), has_webgl=False, token=True):
    """Open the pages of a studio. Most tests do without WebGL, which is computed here."""
    with browser.page(*size) as page:
        if not has_webgl:
            page.call("Page.addScriptToEvaluateOnNewDocument", source=NO_WEBGL)
        page.go(studio.url if token else f"{studio.origin}/")
        if token:
            page.wait("document.querySelector('.joints')")
        yield page
        assert page.errors == []


@pytest.fixture(scope="module")
def wave(tmp_path_factory):
    """The studio with an example and a simulated robot, for tests that leave it as it was."""
    with running(EXAMPLES / "wave.yaml") as studio:
        yield studio


ROBOT = """\
robot: two
buses:
  main: {port: PORT, baud_bps: 115200, firmware: 370}
joints:
  pan: {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 120, accel_max_deg_s2: 500}
  tilt: {id: 2, model: LSS-ST1, range_deg: [-45, 45], speed_max_deg_s: 120, accel_max_deg_s2: 500}
"""
SHOW = {
    "sequence": "to and fro",
    "robot": "two.yaml",
    "keyframes": [
        {"at_s": 2.0 * n, "label": f"part {n}", "deg": {"pan": 40 * (n % 2), "tilt": -20 * (n % 2)}}
        for n in range(11)
    ],
}


@pytest.fixture
def two(tmp_path):
    """A show of 20 s on two simulated servos behind a port; gives the bus, which records."""
    st1 = SERVO_MODELS["LSS-ST1"]
    bus = recording_bus(*(ServoSpec(servo_id=number, model=st1) for number in (1, 2)))
    port = tmp_path / "port"
    (tmp_path / "two.yaml").write_text(ROBOT.replace("PORT", str(port)), encoding="utf-8")
    (tmp_path / "show.yaml").write_text(json.dumps(SHOW), encoding="utf-8")
    with served_bus(bus, port):
        yield tmp_path / "show.yaml", bus
