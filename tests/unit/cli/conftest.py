from __future__ import annotations

import io

import pytest

from lss_motion.cli import play
from lss_motion.errors import EXIT_FINISHED

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {base: {id: 1}, elbow: {id: 2}, wrist: {id: 3}}
"""
SHOW = """\
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, deg: {base: 0, elbow: 0, wrist: 0}}
  - {at_s: 0.6, deg: {base: 30, elbow: -20}}
  - {at_s: 1.2, deg: {base: 0, elbow: 0, wrist: 10}}
"""


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """The log and report of a short show with lost answers, on a host that wakes late at times."""
    folder = tmp_path_factory.mktemp("played")
    faults = folder / "faults.yaml"
    (folder / "robot.yaml").write_text(ROBOT)
    (folder / "show.yaml").write_text(SHOW)
    faults.write_text(
        "faults:\n  - {kind: lost_reply, ratio: 0.02, at_s: 0.5}\n"
        "  - {kind: oversleep, ratio: 0.05, late_s: 0.004}\n"
    )
    words = [str(folder / "show.yaml"), "--virtual", "--quiet", "--faults", str(faults)]
    words += ["--log", str(folder / "a.log"), "--report", str(folder / "a.json")]
    assert play.main(words) == EXIT_FINISHED
    return folder


@pytest.fixture
def at_keyboard(monkeypatch):
    """Return a function that makes a person type an answer."""

    def types(text):
        monkeypatch.setattr("lss_motion.cli.terminal.is_at_keyboard", lambda: True)
        monkeypatch.setattr("sys.stdin", io.StringIO(text))

    return types
